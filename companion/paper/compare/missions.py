"""Missions as the paper flies them, without a vehicle, and what they cost."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from typing import Any, final

from companion.config import load_mission, load_world
from companion.errors import CompanionError, InputError
from companion.geodesy import FloatArray
from companion.paper.compare.violations import Violations, violations
from companion.planner.offline import OfflineFlight, fly_offline
from companion.planner.settings import Task
from companion.planning import Planner, plan
from companion.profiles import PAPER
from companion.runtime.worker_pool import worker_pool
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
    """Sum of the subpaths' f: the "fitness from start to target" (row 24)."""
    legs: int
    length_m: float
    route_nea_m: FloatArray  # (S, 3)
    """The path as flown, every 100 m."""
    scans_nea_m: tuple[tuple[float, float, float], ...]
    violations: Violations


def bundled_case(name: str) -> Case:
    """A bundled environment as published: L = V T + d_s (eq. 4), where a scan takes no time."""
    mission, world = load_mission(name, PAPER.name), load_world(name)
    if not isinstance(world.terrain, PeakTerrain):
        raise InputError("world", name, "its terrain is not made of peaks", "Give another.")
    case = Case(
        world=name,
        terrain=world.terrain,
        task=mission.task,
        start_nea_m=(*world.start_ne_m, mission.task.take_off_amsl_m),
        target_ne_m=mission.targets_ne_m[-1],
    )
    return planned_with(case, scan_time_s=0.0, position_period_s=0.0, scan_distance_m=None)


def planned_with(case: Case, *, seed: int = 1, **settings: Any) -> Case:
    """The case with other settings of the planner."""
    task = replace(case.task, settings=replace(case.task.settings, **settings))
    return replace(case, task=task, seed=seed)


def flown(case: Case, planner: Planner = plan) -> OfflineFlight:
    """Fly a case: simulated scans and perfect tracking."""
    limits = case.task.limits
    blank = empty_map(case.task.cell_m, limits.north_m, limits.east_m)
    return fly_offline(
        case.task,
        blank=blank,
        truth=true_map(case.terrain, blank),
        start_nea_m=case.start_nea_m,
        targets_ne_m=(case.target_ne_m,),
        seed=case.seed,
        planner=planner,
    )


def fly(case: Case) -> Run:
    """Fly a case as the paper does: nothing is verified before it is flown."""
    flight = flown(case)
    pieces = [(leg.subpath, m) for leg, m in zip(flight.legs, flight.flown_m, strict=True)]
    return Run(
        arrived=flight.failure is None and bool(flight.legs) and flight.legs[-1].reaches_target,
        cost=sum(planned.cost for planned in flight.plans),
        legs=len(flight.legs),
        length_m=sum(flight.flown_m),
        route_nea_m=flight.route_nea_m(_SPACING_M),
        scans_nea_m=flight.scans_nea_m,
        violations=violations(pieces, case.task, case.terrain),
    )


def fly_all(
    cases: Sequence[Any],
    jobs: int,
    shown: Callable[[Iterable[Any]], Iterable[Any]],
    one: Callable[[Any], Any] = fly,
) -> list[Any]:
    """Fly all cases, in that many processes; the results in the order of the cases.

    They do not depend on the number of processes, and these end with their parent.  shown: what is
    iterated over goes through it, to show how far it is.  one: flies one of them.
    """
    if jobs == 1:
        return [one(case) for case in shown(cases)]
    try:
        with worker_pool(min(jobs, len(cases))) as submit:
            futures = [submit(one, case) for case in cases]
            for done in shown(as_completed(futures)):
                done.result()
            return [future.result() for future in futures]
    except BrokenProcessPool as error:
        raise CompanionError("a worker process ended early. Try fewer --jobs.") from error
