"""The online procedure without a vehicle: simulated scans and perfect tracking."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

from companion.planner.plan import NotPlanned, Planned, PlanOutcome, PlanRequest, plan
from companion.planner.procedure import Leg, hover_pose
from companion.planner.settings import Task
from companion.world.known_map import KnownMap
from companion.world.simulated_scan import simulated_scan

_MOST_LEGS = 60


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class OfflineFlight:
    """All legs, the points where they were planned from, and what was known in the end."""

    legs: tuple[Leg, ...]
    plans: tuple[Planned, ...]
    scans_nea_m: tuple[tuple[float, float, float], ...]
    known: KnownMap
    failure: NotPlanned | None
    """Why it ended before the target."""


def fly_offline(
    task: Task,
    *,
    blank: KnownMap,
    truth: KnownMap,
    start_nea_m: tuple[float, float, float],
    targets_ne_m: tuple[tuple[float, float], ...],
    seed: int,
    planner: Callable[[PlanRequest], PlanOutcome] = plan,
) -> OfflineFlight:
    """Scan, plan, go on to p_prog, until the last target is reached or nothing can be planned.

    At a target that is not the last the vehicle stops and begins again.
    """
    left = list(targets_ne_m)
    known, pose, scan_nea_m, from_rest = blank, hover_pose(start_nea_m), start_nea_m, True
    legs: list[Leg] = []
    plans: list[Planned] = []
    scans: list[tuple[float, float, float]] = []
    while True:
        scans.append(scan_nea_m)
        known = known.with_scan(simulated_scan(truth, scan_nea_m, task.settings.scan_range_m))
        outcome = planner(
            PlanRequest(
                plan_id=len(legs) + 1,
                seed=seed,
                task=task,
                known=known,
                scan_nea_m=scan_nea_m,
                start=pose,
                from_rest=from_rest,
                target_ne_m=left[0],
            )
        )
        failure = outcome if isinstance(outcome, NotPlanned) else None
        if isinstance(outcome, Planned):
            plans.append(outcome)
            legs.append(Leg.of(outcome, len(legs) + 1))
        if legs and legs[-1].reaches_target and not failure:
            left.pop(0)
        if failure or not left or len(legs) == _MOST_LEGS:
            return OfflineFlight(
                legs=tuple(legs),
                plans=tuple(plans),
                scans_nea_m=tuple(scans),
                known=known,
                failure=failure,
            )
        leg = legs[-1]
        from_rest = leg.reaches_target
        if from_rest:
            scan_nea_m = leg.subpath.pose(leg.subpath.length_m).point_nea_m
            pose = hover_pose(scan_nea_m)
        else:
            scan_nea_m = leg.subpath.pose(leg.scan_at_m(task)).point_nea_m
            pose = leg.subpath.pose(leg.successor_at_m(task))
