"""Our own planner in a drawn world, flown without a vehicle, told of as rivals are."""

import time
from dataclasses import replace

import numpy as np

from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.families import unseen, unseen_with_elevation
from companion.campaign.rivals.flight import Knowledge, RouteFlight
from companion.planner.offline import fly_offline
from companion.planner.plan import plan
from companion.planner.request import PlanOutcome, PlanRequest
from companion.world.known_map import KnownMap, Scan
from companion.world.simulated_scan import Truth, simulated_scan, true_map

_POINTS_PER_RANGE = 1_000
_STOPS_M = 1.0  # who has flown a leg to within this of its end has stopped there


def fly(world: DrawnWorld, *, knowledge: Knowledge = "scans", seed: int = 1) -> RouteFlight:
    """Fly a world's mission; with full knowledge all of the ground is on the map before it."""
    plan_s, blank = list[float](), _known(world, knowledge)
    truth = Truth.of(world.terrain, blank)

    def timed(request: PlanRequest) -> PlanOutcome:
        began_s = time.process_time()
        outcome = plan(request)
        plan_s.append(time.process_time() - began_s)
        return outcome

    def scanned(_: KnownMap, at_nea_m: tuple[float, float, float], range_m: float) -> Scan:
        return simulated_scan(truth, at_nea_m, range_m)

    flight = fly_offline(
        world.task,
        blank=blank,
        truth=blank,  # the scanner has its own, which is rasterised where it is looked at
        scanner=scanned,
        start_nea_m=world.start_nea_m,
        targets_ne_m=world.targets_ne_m,
        seed=seed,
        planner=timed,
    )
    step_m = world.task.settings.scan_range_m / _POINTS_PER_RANGE
    flown_m, failure = np.array(flight.flown_m), flight.failure
    lengths_m = np.array([leg.subpath.length_m for leg in flight.legs])
    ends = np.cumsum(np.maximum(np.ceil(flown_m / step_m), 1.0)).astype(int)  # points so far
    return RouteFlight(
        points_nea_m=flight.route_nea_m(step_m),
        arrived=failure is None,
        why="" if failure is None else f"{failure.refusal.name}: {failure.refusal.value}",
        scans=len(flight.scans_nea_m),
        plan_s=tuple(plan_s),
        stops=tuple(ends[lengths_m - flown_m < _STOPS_M].tolist()),
        subpaths_nea_m=tuple(leg.subpath.control_nea_m for leg in flight.legs),
    )


def _known(world: DrawnWorld, knowledge: Knowledge) -> KnownMap:
    """The map before the flight."""
    if knowledge == "elevation":
        return unseen_with_elevation(world, int(world.fingerprint[:8], 16))
    blank = unseen(world)
    if knowledge == "scans":
        return blank
    every = np.ones(blank.upper_m.shape, dtype=bool)
    known = true_map(world.terrain, blank)
    return replace(blank, upper_m=known.upper_m, seen=every, given=every)
