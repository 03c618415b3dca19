"""Missions as the paper flies them, without a vehicle, and what they cost."""

import itertools
import math
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from typing import Any, final

from rich import box
from rich.table import Table

from companion.config import load_mission, load_world
from companion.errors import CompanionError, InputError
from companion.geodesy import FloatArray
from companion.library import route_terms
from companion.paper.compare.violations import Violations, violations
from companion.planner.offline import fly_offline
from companion.planner.settings import Task
from companion.planning import OURS, planner_of
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

    heading: str
    """What it is a part of, in tables."""
    label: str
    """Which part."""
    world: str
    terrain: PeakTerrain
    task: Task
    start_nea_m: tuple[float, float, float]
    target_ne_m: tuple[float, float]
    planner: str = OURS
    """Who plans (`planning.planner_of`): ours plans by the task's profile."""
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
    j: float
    """Length, height and radar of eq. 5 along what was flown (`library.route_terms`)."""
    took_s: float
    """Processor time."""
    route_nea_m: FloatArray  # (S, 3)
    """The path as flown, every 100 m."""
    scans_nea_m: tuple[tuple[float, float, float], ...]
    violations: Violations


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """A case, flown with some seeds."""

    case: Case
    runs: tuple[Run, ...]

    @property
    def costs(self) -> list[float]:
        """Of the runs that reached the target: only they have a cost from start to target."""
        return [run.cost for run in self.runs if run.arrived]

    @property
    def arrivals(self) -> str:
        """How many arrived."""
        return f"{len(self.costs)}/{len(self.runs)}"

    @property
    def shown(self) -> Run:
        """The run of median cost: the one in pictures."""
        return sorted(self.runs, key=lambda run: run.cost)[(len(self.runs) - 1) // 2]

    def mean(self, measure: Callable[[Run], float] = lambda run: run.cost) -> float:
        """Mean of a measure over the runs that arrived; not a number when none did."""
        values = [measure(run) for run in self.runs if run.arrived]
        return statistics.fmean(values) if values else math.nan

    @property
    def deviation(self) -> float:
        """Standard deviation of the costs; not a number with fewer than two."""
        return statistics.stdev(self.costs) if len(self.costs) > 1 else math.nan

    @property
    def violations(self) -> dict[str, dict[str, float]]:
        """Of each kind the share of missions that break it, and the mean metres that do."""
        rows = [asdict(run.violations) for run in self.runs]
        return {
            kind.removesuffix("_m"): {
                "missions": statistics.fmean(row[kind] > 0.0 for row in rows),
                "mean_m": statistics.fmean(row[kind] for row in rows),
            }
            for kind in rows[0]
        }

    def facts(self) -> dict[str, Any]:
        """All its numbers, for --json."""
        return {
            "heading": self.case.heading,
            "label": self.case.label,
            "world": self.case.world,
            "evaluations": self.case.task.settings.evaluations,
            "arrived": [run.arrived for run in self.runs],
            "costs": [run.cost if run.arrived else None for run in self.runs],
            "lengths_m": [run.length_m for run in self.runs],
            "highest_amsl_m": [float(run.route_nea_m[:, 2].max()) for run in self.runs],
            "j": [run.j for run in self.runs],
            "violations": self.violations,
        }


def bundled_case(name: str) -> Case:
    """A bundled environment as published: L = V T + d_s (eq. 4), where a scan takes no time."""
    mission, world = load_mission(name, PAPER.name), load_world(name)
    if not isinstance(world.terrain, PeakTerrain):
        raise InputError("world", name, "its terrain is not made of peaks", "Give another.")
    case = Case(
        heading=name,
        label="",
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


def fly(case: Case) -> Run:
    """Fly a case: simulated scans and perfect tracking."""
    limits, began_s = case.task.limits, time.process_time()
    blank = empty_map(case.task.cell_m, limits.north_m, limits.east_m)
    flight = fly_offline(
        case.task,
        blank=blank,
        truth=true_map(case.terrain, blank),
        start_nea_m=case.start_nea_m,
        targets_ne_m=(case.target_ne_m,),
        seed=case.seed,
        planner=planner_of(case.planner),
    )
    took_s, route = time.process_time() - began_s, flight.route_nea_m(_SPACING_M)
    pieces = [(leg.subpath, m) for leg, m in zip(flight.legs, flight.flown_m, strict=True)]
    return Run(
        arrived=flight.failure is None,
        cost=sum(planned.cost for planned in flight.plans),
        legs=len(flight.legs),
        length_m=sum(flight.flown_m),
        j=sum(route_terms(route, case.task).values()),
        took_s=took_s,
        route_nea_m=route,
        scans_nea_m=tuple(flight.scans_nea_m),
        violations=violations(pieces, case.task, case.terrain),
    )


def fly_all(
    cases: Sequence[Case],
    runs: int,
    seed: int,
    jobs: int,
    shown: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> list[Outcome]:
    """Fly each case with so many seeds, from this one on, in that many processes.

    The results do not depend on the number of processes, and these end with their parent.  shown:
    what is iterated over goes through it, to show how far it is.
    """
    every = [replace(case, seed=seed + run) for case in cases for run in range(runs)]
    if jobs == 1:
        flown = [fly(case) for case in shown(every)]
    else:
        try:
            with worker_pool(min(jobs, len(every))) as submit:
                futures = [submit(fly, case) for case in every]
                for done in shown(as_completed(futures)):
                    done.result()
                flown = [future.result() for future in futures]
        except BrokenProcessPool as error:
            raise CompanionError("a worker process ended early. Try fewer --jobs.") from error
    parts = (flown[k : k + runs] for k in range(0, len(flown), runs))
    return [Outcome(case=case, runs=tuple(part)) for case, part in zip(cases, parts, strict=True)]


def narrow_table(title: str, *headings: str) -> Table:
    """A table whose cells stay whole in a terminal of 80 columns."""
    result = Table(title=title, box=box.SIMPLE_HEAD, padding=0)
    result.add_column("", no_wrap=True)
    for heading in headings:
        result.add_column(heading, justify="right")
    return result


def add_rows(
    table: Table, found: Sequence[Outcome], cells: Callable[[Outcome], Iterable[str]]
) -> Table:
    """Add a row for each outcome, and one for each heading."""
    for heading, part in itertools.groupby(found, lambda outcome: outcome.case.heading):
        table.add_row(heading)
        for outcome in part:
            table.add_row(f"  {outcome.case.label}", *cells(outcome))
    return table
