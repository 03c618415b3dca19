"""Missions as the paper flies them, without a vehicle, what they cost, and what is told of them."""

import itertools
import math
import statistics
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from typing import Any, final

from rich import box
from rich.table import Table

from companion.config import load_mission, load_world
from companion.errors import CompanionError
from companion.geodesy import FloatArray
from companion.library import route_terms
from companion.paper.compare.violations import KINDS, violations
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
    papers_cost: tuple[float, float] = (math.nan, math.nan)
    """The mean and the standard deviation that the paper has."""
    papers_way: str = ""
    """Which way the paper's route goes."""

    def planned_with(self, **settings: Any) -> "Case":
        """The case with other settings of the planner."""
        task = replace(self.task, settings=replace(self.task.settings, **settings))
        return replace(self, task=task)


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
    violations: dict[str, float]
    """Metres of each kind."""

    @property
    def highest_amsl_m(self) -> float:
        """The highest point of the route."""
        return float(self.route_nea_m[:, 2].max())


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

    def mean(self, measure: str = "cost") -> float:
        """Mean of a number of `Run` over the runs that arrived; not a number when none did."""
        values = [getattr(run, measure) for run in self.runs if run.arrived]
        return statistics.fmean(values) if values else math.nan

    @property
    def deviation(self) -> float:
        """Standard deviation of the costs; not a number with fewer than two."""
        return statistics.stdev(self.costs) if len(self.costs) > 1 else math.nan

    @property
    def violations(self) -> dict[str, dict[str, float]]:
        """Of each kind the share of missions that break it, and the mean metres that do."""
        metres = {kind: [run.violations[kind] for run in self.runs] for kind in KINDS}
        return {
            kind: {
                "missions": statistics.fmean(each > 0.0 for each in found),
                "mean_m": statistics.fmean(found),
            }
            for kind, found in metres.items()
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
            "highest_amsl_m": [run.highest_amsl_m for run in self.runs],
            "j": [run.j for run in self.runs],
            "violations": self.violations,
        }


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """Cases that are flown, and how what came of them is told."""

    cases: Sequence[Case]
    tables: Mapping[str, Mapping[str, Callable[[Outcome], str]]]
    """By title and column what a cell says of an outcome."""
    remarks: Callable[[Sequence[Outcome]], list[str]]
    """What the tables cannot say by themselves."""
    more: Callable[[Outcome], dict[str, Any]] = lambda _: {}
    """What is told beside the numbers of an outcome, for --json."""


def table(
    title: str, columns: Mapping[str, Callable[[Outcome], str]], found: Sequence[Outcome]
) -> Table:
    """A row for each outcome, and one for each heading if there are several.

    Its cells stay whole in a terminal of 80 columns.
    """
    result = Table(title=title, box=box.SIMPLE_HEAD, padding=0)
    result.add_column("", no_wrap=True)
    for name in columns:
        result.add_column(name, justify="right")
    parts = by_heading(found)
    for part in parts:
        if len(parts) > 1:
            result.add_row(part[0].case.heading)
        for outcome in part:
            label = ("  " if len(parts) > 1 else "") + outcome.case.label
            result.add_row(label, *(cell(outcome) for cell in columns.values()))
    return result


def by_heading(found: Sequence[Outcome]) -> list[list[Outcome]]:
    """Outcomes in parts of the same heading, as they follow each other."""
    return [list(part) for _, part in itertools.groupby(found, lambda each: each.case.heading)]


def bundled_case(name: str) -> Case:
    """A bundled environment as published: L = V T + d_s (eq. 4), where a scan takes no time."""
    mission, world = load_mission(name, PAPER.name), load_world(name)
    assert isinstance(world.terrain, PeakTerrain)
    return Case(
        heading=name,
        label="",
        world=name,
        terrain=world.terrain,
        task=mission.task,
        start_nea_m=(*world.start_ne_m, mission.task.take_off_amsl_m),
        target_ne_m=mission.targets_ne_m[-1],
    ).planned_with(scan_time_s=0.0, position_period_s=0.0, scan_distance_m=None)


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
