"""The planner alone, ours or a rival, flown through a drawn world without a vehicle."""

import time
from dataclasses import dataclass, replace
from typing import Literal, final

import numpy as np

from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.families import unseen
from companion.geodesy import FloatArray
from companion.planner.offline import fly_offline
from companion.planner.request import PlanOutcome, PlanRequest
from companion.planning import OURS, planner_of
from companion.world.known_map import KnownMap, Scan
from companion.world.simulated_scan import simulated_scan, true_map

Knowledge = Literal["scans", "full"]
"""Of the ground before the flight: none, or all of it."""
_POINTS_PER_RANGE = 1_000


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AloneFlight:
    """What was flown."""

    points_nea_m: FloatArray
    """(S, 3), from the start as far as it came."""
    arrived: bool
    why: str
    """Why it did not arrive; empty if it did."""
    plan_s: tuple[float, ...]
    """Processor time of each plan."""
    holds: int
    """How often it stopped at the end of a leg, for want of a successor."""
    subpaths_nea_m: tuple[FloatArray, ...]
    """Control points (N, 3) of each, tail included."""


def fly(
    world: DrawnWorld, planner: str = OURS, *, knowledge: Knowledge = "scans", seed: int = 1
) -> AloneFlight:
    """Fly a world's mission; with full knowledge all of the ground is on the map before it."""
    plan_s, blank, plan = list[float](), _known(world, knowledge), planner_of(planner)

    def timed(request: PlanRequest) -> PlanOutcome:
        began_s = time.process_time()
        outcome = plan(request)
        plan_s.append(time.process_time() - began_s)
        return outcome

    def scanned(_: KnownMap, at_nea_m: tuple[float, float, float], range_m: float) -> Scan:
        return simulated_scan(blank, at_nea_m, range_m, world.terrain)

    flight = fly_offline(
        world.task,
        blank=blank,
        truth=blank,  # the scanner makes it where it is looked at
        scanner=scanned,
        start_nea_m=world.start_nea_m,
        targets_ne_m=world.targets_ne_m,
        seed=seed,
        planner=timed,
    )
    failure = flight.failure
    return AloneFlight(
        points_nea_m=flight.route_nea_m(world.task.settings.scan_range_m / _POINTS_PER_RANGE),
        arrived=failure is None,
        why="" if failure is None else f"{failure.refusal.name}: {failure.refusal.value}",
        plan_s=tuple(plan_s),
        holds=flight.holds,
        subpaths_nea_m=tuple(leg.subpath.control_nea_m for leg in flight.legs),
    )


def _known(world: DrawnWorld, knowledge: Knowledge) -> KnownMap:
    """The map before the flight."""
    blank = unseen(world)
    if knowledge == "scans":
        return blank
    every = np.ones(blank.upper_m.shape, dtype=bool)
    known = true_map(world.terrain, blank)
    return replace(blank, upper_m=known.upper_m, seen=every, given=every)
