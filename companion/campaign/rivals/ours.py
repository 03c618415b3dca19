"""Our own planner in a drawn world, flown without a vehicle, told of as rivals are."""

import time
from dataclasses import replace

import numpy as np

from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.families import unseen
from companion.campaign.rivals.flight import Knowledge, RouteFlight
from companion.planner.offline import fly_offline
from companion.planner.plan import plan
from companion.planner.request import PlanOutcome, PlanRequest
from companion.runtime.compiler import load_kernel
from companion.world.known_map import KnownMap
from companion.world.simulated_scan import true_map

_POINTS_PER_RANGE = 1_000
_STOPS_M = 1.0  # who has flown a leg to within this of its end has stopped there


def fly(world: DrawnWorld, *, knowledge: Knowledge = "scans", seed: int = 1) -> RouteFlight:
    """Fly a world's mission; with full knowledge all of the ground is on the map before it."""
    plan_s, kernel, blank = list[float](), load_kernel(), unseen(world)
    truth = true_map(world.terrain, blank)

    def timed(request: PlanRequest) -> PlanOutcome:
        began_s = time.process_time()
        outcome = plan(request, kernel=kernel)
        plan_s.append(time.process_time() - began_s)
        return outcome

    flight = fly_offline(
        world.task,
        blank=_told(blank, truth) if knowledge == "full" else blank,
        truth=truth,
        start_nea_m=world.start_nea_m,
        targets_ne_m=world.targets_ne_m,
        seed=seed,
        planner=timed,
    )
    step_m = world.task.settings.scan_range_m / _POINTS_PER_RANGE
    pieces, stops = [np.array([world.start_nea_m])], list[int]()
    for leg, flown_m in zip(flight.legs, flight.flown_m, strict=True):
        count = max(int(np.ceil(flown_m / step_m)), 1)
        if leg.subpath.length_m - flown_m < _STOPS_M:
            stops.append(sum(len(each) for each in pieces) + count - 1)
        pieces.append(leg.subpath.points_nea_m(np.linspace(0.0, flown_m, count + 1)[1:]))
    failure = flight.failure
    return RouteFlight(
        points_nea_m=np.concatenate(pieces),
        arrived=failure is None,
        why="" if failure is None else f"{failure.refusal.name}: {failure.refusal.value}",
        scans=len(flight.scans_nea_m),
        plan_s=tuple(plan_s),
        stops=tuple(stops),
    )


def _told(blank: KnownMap, truth: KnownMap) -> KnownMap:
    """The map with the highest ground of each cell on it."""
    every = np.ones(blank.upper_m.shape, dtype=bool)
    return replace(blank, upper_m=truth.upper_m, seen=every, given=every)
