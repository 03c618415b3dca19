"""Missions as the paper flies them, without a vehicle, what they cost, and what they violate.

Violations are looked at every 10 m: the paper's ten samples a subpath miss them.
"""

import itertools
import math
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from companion.config import load_mission, load_world
from companion.errors import CompanionError
from companion.geodesy import FloatArray
from companion.library import route_terms
from companion.path.subpath import Subpath
from companion.planner.offline import fly_offline
from companion.planner.settings import Task
from companion.planning import OURS, planner_of
from companion.profiles import PAPER
from companion.runtime.worker_pool import worker_pool
from companion.world.known_map import empty_map
from companion.world.simulated import true_map
from companion.world.terrain import PeakTerrain

_ROUTE_SPACING_M, _DENSE_M = 100.0, 10.0
_TOLERANCE = 1e-6  # relative: what lies on a bound has not crossed it
KINDS = {
    "clearance": "nearer than d_s",  # to a peak or to the ground
    "radar": "seen by radars",  # within the range of one (eq. 3)
    "turn": "turn",  # more tightly than the vehicle can, joins included
    "climb": "climb",  # or dive more steeply than it can
    "band": "altitude",  # below the floor or above the ceiling
}
"""What may be violated, and how tables say it."""


Point = tuple[float, float]  # north and east, metres
Line = tuple[str, Point, Point]
"""What a route does that passes between two points; any other goes round."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A mission to fly, and how it is planned; tables call it by its label under its heading."""

    heading: str
    label: str = ""
    world: str
    terrain: PeakTerrain
    task: Task
    start_nea_m: tuple[float, float, float]
    target_ne_m: Point
    planner: str = OURS  # who plans (`planning.planner_of`): ours plans by the task's profile
    papers_cost: tuple[float, ...] = ()  # mean and standard deviation (Table 1)
    papers_way: str = ""  # which way the paper's route goes (Fig. 3, Fig. 4)
    line: Line | None = None


def bundled_case(name: str, **settings: Any) -> Case:
    """A bundled environment as published, with some settings of the planner.

    L = V T + d_s (eq. 4): a scan takes no time.
    """
    mission, world = load_mission(name, PAPER.name), load_world(name)
    assert isinstance(world.terrain, PeakTerrain)
    timeless = {"scan_time_s": 0.0, "position_period_s": 0.0, "scan_distance_m": None}
    planned_with = replace(mission.task.settings, **timeless | settings)
    return Case(
        heading=name,
        world=name,
        terrain=world.terrain,
        task=replace(mission.task, settings=planned_with),
        start_nea_m=(*world.start_ne_m, mission.task.take_off_amsl_m),
        target_ne_m=mission.targets_ne_m[-1],
    )


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """How a case went with one seed."""

    arrived: bool
    cost: float  # sum of the subpaths' f: the "fitness from start to target" (row 24)
    legs: int
    length_m: float
    highest_amsl_m: float
    j: float  # length, height and radar of eq. 5 along what was flown (`library.route_terms`)
    took_s: float  # processor time
    route_nea_m: FloatArray  # (S, 3); the path as flown, every 100 m
    scans_nea_m: tuple[tuple[float, float, float], ...]
    violations: dict[str, float]  # metres of each kind


def fly(case: Case, seed: int) -> Run:
    """Fly a case: simulated scans and perfect tracking."""
    limits, began_s = case.task.limits, time.process_time()
    blank = empty_map(case.task.cell_m, limits.north_m, limits.east_m)
    flight = fly_offline(
        case.task,
        blank=blank,
        truth=true_map(case.terrain, blank),
        start_nea_m=case.start_nea_m,
        targets_ne_m=(case.target_ne_m,),
        seed=seed,
        planner=planner_of(case.planner),
    )
    took_s, route = time.process_time() - began_s, flight.route_nea_m(_ROUTE_SPACING_M)
    flown = zip((leg.subpath for leg in flight.legs), flight.flown_m, strict=True)
    return Run(
        arrived=flight.failure is None,
        cost=sum(planned.cost for planned in flight.plans),
        legs=len(flight.legs),
        length_m=sum(flight.flown_m),
        highest_amsl_m=float(route[:, 2].max()),
        j=sum(route_terms(route, case.task).values()),
        took_s=took_s,
        route_nea_m=route,
        scans_nea_m=tuple(flight.scans_nea_m),
        violations=violations(flown, case.task, case.terrain),
    )


def violations(
    flown: Iterable[tuple[Subpath, float]], task: Task, terrain: PeakTerrain
) -> dict[str, float]:
    """Metres of subpaths, each as far as it was flown (metres), that break a bound, by kind."""
    limits, more, less = task.limits, 1.0 + _TOLERANCE, 1.0 - _TOLERANCE
    slack_m = _TOLERANCE * (limits.ceiling_amsl_m - limits.floor_amsl_m)
    total = dict.fromkeys(KINDS, 0.0)
    for subpath, flown_m in flown:
        points, first, second = subpath.sampled(_DENSE_M)
        at_m = np.linspace(0.0, subpath.length_m, len(points))
        edges_m = np.concatenate([[0.0], 0.5 * (at_m[1:] + at_m[:-1]), [subpath.length_m]])
        stands_for_m = np.diff(edges_m.clip(max=flown_m)) * (at_m <= flown_m + 1e-9)
        speed = np.linalg.norm(first, axis=1)
        corner = speed < 1e-6 * speed.max()  # r2 = 0: the join is a corner, and has no direction
        (north, east, up), (turn_n, turn_e, _) = first.T, second.T
        level, altitude = np.hypot(north, east), points[:, 2]
        curvature = np.abs(north * turn_e - turn_n * east) / np.maximum(level, 1e-9) ** 3
        climb = np.where(corner, 0.0, np.arctan2(up, level))
        seen = np.zeros(len(points), dtype=bool)
        for radar in task.radars:
            seen |= radar.distance_m(points) < radar.range_m * less
        broken = {
            "clearance": peak_distance_m(points, terrain) < task.settings.safety_distance_m * less,
            "radar": seen,
            "turn": corner | (curvature * limits.turn_radius_m > more),
            "climb": (climb > limits.climb_angle_rad + _TOLERANCE)
            | (climb < -limits.dive_angle_rad - _TOLERANCE),
            "band": (altitude < limits.floor_amsl_m - slack_m)
            | (altitude > limits.ceiling_amsl_m + slack_m),
        }
        for kind, where in broken.items():
            total[kind] += float(where @ stands_for_m)
    return total


def peak_distance_m(points_nea_m: FloatArray, terrain: PeakTerrain) -> FloatArray:
    """Distance to the nearest true peak or the ground, negative below it, metres.  (S, 3) -> (S,).

    To first order, as the paper has it: (z - h) / sqrt(1 + |grad h|^2) (row 12 of its page).
    """
    north, east, altitude = points_nea_m.T
    nearest = altitude - terrain.ground_amsl_m
    for peak in terrain.peaks:
        n = (north - peak.north_m) / peak.spread_north_m
        e = (east - peak.east_m) / peak.spread_east_m
        height = peak.height_amsl_m * np.exp(-(n**2) - e**2)
        slope = 2.0 * height * np.hypot(n / peak.spread_north_m, e / peak.spread_east_m)
        nearest = np.minimum(nearest, (altitude - height) / np.hypot(1.0, slope))
    return nearest


def crosses(route_nea_m: FloatArray, one_ne_m: Point, two_ne_m: Point) -> bool:
    """Whether a route passes between two points, seen from above.  (S, 3)."""
    one = complex(*one_ne_m)
    place = (route_nea_m[:, 0] + 1j * route_nea_m[:, 1] - one) / (complex(*two_ne_m) - one)
    before = np.nonzero(np.diff(place.imag < 0.0))[0]  # the points lie at 0 and 1
    here, there = place[before], place[before + 1]
    at = here.real + here.imag / (here.imag - there.imag) * (there.real - here.real)
    return bool(np.any((at > 0.0) & (at < 1.0)))


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
    def shown(self) -> Run:
        """The run of median cost: the one in pictures."""
        return sorted(self.runs, key=lambda run: run.cost)[(len(self.runs) - 1) // 2]

    @property
    def ways(self) -> list[str]:
        """Which way each run goes, where the case has a line."""
        assert self.case.line is not None
        across, one, two = self.case.line
        crossed = (crosses(run.route_nea_m, one, two) for run in self.runs)
        return [across if each else "goes round" for each in crossed]

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

    @property
    def arrivals(self) -> str:
        """How many arrived."""
        return f"{len(self.costs)}/{len(self.runs)}"

    def mean(self, measure: str = "cost") -> float:
        """Mean of a number of `Run` over the runs that arrived; not a number when none did."""
        values = [getattr(run, measure) for run in self.runs if run.arrived]
        return statistics.fmean(values) if values else math.nan

    @property
    def deviation(self) -> float:
        """Standard deviation of the costs; not a number with fewer than two."""
        return statistics.stdev(self.costs) if len(self.costs) > 1 else math.nan

    def facts(self) -> dict[str, Any]:
        """All its numbers and the paper's, for --json."""
        case, names = self.case, ("paper_mean_cost", "paper_st_dev_cost")
        paper: dict[str, Any] = dict(zip(names, case.papers_cost, strict=False))
        if case.line is not None:
            paper = {"papers_way": case.papers_way, "ways": self.ways}
        return {
            "heading": case.heading,
            "label": case.label,
            "world": case.world,
            "evaluations": case.task.settings.evaluations,
            "arrived": [run.arrived for run in self.runs],
            "costs": [run.cost if run.arrived else None for run in self.runs],
            "lengths_m": [run.length_m for run in self.runs],
            "highest_amsl_m": [run.highest_amsl_m for run in self.runs],
            "j": [run.j for run in self.runs],
            "violations": self.violations,
            **paper,
        }


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
    every = list(itertools.product(cases, range(seed, seed + runs)))
    if jobs == 1:
        flown = [fly(*each) for each in shown(every)]
    else:
        try:
            with worker_pool(min(jobs, len(every))) as submit:
                futures = [submit(fly, *each) for each in every]
                for done in shown(as_completed(futures)):
                    done.result()
                flown = [future.result() for future in futures]
        except BrokenProcessPool as error:
            raise CompanionError("a worker process ended early. Try fewer --jobs.") from error
    parts = (tuple(flown[k : k + runs]) for k in range(0, len(flown), runs))
    return [Outcome(case=case, runs=part) for case, part in zip(cases, parts, strict=True)]
