"""The planner alone, ours or a rival, flown through a drawn world without a vehicle."""

import time
from dataclasses import dataclass, replace
from typing import Literal, final

import numpy as np

from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.families import unseen
from companion.geodesy import FloatArray
from companion.planner.offline import OfflineFlight, fly_offline
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

    whole: OfflineFlight
    points_nea_m: FloatArray
    """(S, 3), from the start as far as it came."""
    plan_s: tuple[float, ...]
    """Processor time of each plan."""

    @property
    def why(self) -> str:
        """Why it did not arrive; empty if it did."""
        failure = self.whole.failure
        return "" if failure is None else f"{failure.refusal.name}: {failure.refusal.value}"

    @property
    def subpaths_nea_m(self) -> tuple[FloatArray, ...]:
        """Control points (N, 3) of each, tail included."""
        return tuple(leg.subpath.control_nea_m for leg in self.whole.legs)


def fly(
    world: DrawnWorld, planner: str = OURS, *, knowledge: Knowledge = "scans", seed: int = 1
) -> AloneFlight:
    """Fly a world's mission; with full knowledge all of the ground is on the map before it."""
    plan_s, blank, plan = list[float](), unseen(world), planner_of(planner)
    if knowledge == "full":
        every = np.ones(blank.upper_m.shape, dtype=bool)
        upper_m = true_map(world.terrain, blank).upper_m
        blank = replace(blank, upper_m=upper_m, seen=every, given=every)

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
    points = flight.route_nea_m(world.task.settings.scan_range_m / _POINTS_PER_RANGE)
    return AloneFlight(whole=flight, points_nea_m=points, plan_s=tuple(plan_s))
