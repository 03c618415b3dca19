"""One mission as the paper flies it, without a vehicle, and what it cost."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from companion.compare.violations import Violations, violations
from companion.config import load_mission, load_world
from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.objective.scene import PAPER
from companion.path.subpath import Subpath
from companion.planner.offline import fly_offline
from companion.planner.settings import Task
from companion.world.known_map import empty_map
from companion.world.simulated_scan import true_map
from companion.world.terrain import PeakTerrain

_SPACING_M = 100.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A mission to fly: where, how it is planned, and the seed of the search."""

    world: str
    terrain: PeakTerrain
    task: Task
    start_nea_m: tuple[float, float, float]
    target_ne_m: tuple[float, float]
    seed: int = 1


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """How a case went."""

    arrived: bool
    cost: float
    """Sum of the subpaths' f: the "fitness from start to target" (part A, row 24)."""
    legs: int
    route_nea_m: FloatArray  # (S, 3)
    """The path as flown, about every 100 m."""
    scans_nea_m: tuple[tuple[float, float, float], ...]
    violations: Violations

    @property
    def length_m(self) -> float:
        """Length of the route, metres."""
        return self.violations.route_m


def bundled_case(name: str) -> Case:
    """A bundled environment, planned as published."""
    mission, world = load_mission(name, PAPER.name), load_world(name)
    if not isinstance(world.terrain, PeakTerrain):
        raise InputError("world", name, "its terrain is not made of peaks", "Give another.")
    return Case(
        world=name,
        terrain=world.terrain,
        task=as_published(mission.task),
        start_nea_m=(*world.start_ne_m, mission.task.take_off_amsl_m),
        target_ne_m=mission.targets_ne_m[-1],
    )


def as_published(task: Task) -> Task:
    """A task in profile `paper`, with L = V T + d_s (eq. 4): there a scan takes no time."""
    settings = replace(
        task.settings,
        profile=PAPER,
        scan_time_s=0.0,
        position_period_s=0.0,
        scan_distance_m=None,
    )
    return replace(task, settings=settings)


def planned_with(
    case: Case, *, optimiser: str, planning_time_s: float, evaluations: int, seed: int
) -> Case:
    """The case with another search, T (seconds) and budget."""
    settings = replace(
        case.task.settings,
        optimiser=optimiser,
        planning_time_s=planning_time_s,
        evaluations=evaluations,
    )
    return replace(case, task=replace(case.task, settings=settings), seed=seed)


def fly(case: Case) -> Run:
    """Fly a case: simulated scans, perfect tracking, nothing verified before it is flown."""
    limits = case.task.limits
    blank = empty_map(case.task.cell_m, limits.north_m, limits.east_m)
    flight = fly_offline(
        case.task,
        blank=blank,
        truth=true_map(case.terrain, blank),
        start_nea_m=case.start_nea_m,
        targets_ne_m=(case.target_ne_m,),
        seed=case.seed,
    )
    subpaths = [leg.subpath for leg in flight.legs]
    flown = list(zip(subpaths, flight.flown_m, strict=True))
    return Run(
        arrived=flight.failure is None and bool(flight.legs) and flight.legs[-1].reaches_target,
        cost=sum(plan.cost for plan in flight.plans),
        legs=len(flight.legs),
        route_nea_m=_route(flown),
        scans_nea_m=flight.scans_nea_m,
        violations=violations(flown, case.task, case.terrain),
    )


def _route(flown: Sequence[tuple[Subpath, float]]) -> FloatArray:
    """Each subpath as far as it was flown, about every 100 m.  -> (S, 3)."""
    pieces = [np.empty((0, 3))]
    for subpath, flown_m in flown:
        points = subpath.sampled(_SPACING_M).points_nea_m
        at_m = np.linspace(0.0, subpath.length_m, len(points))
        pieces += [points[at_m < flown_m], subpath.pose(flown_m).position_nea_m[None]]
    return np.concatenate(pieces)
