"""Missions as the paper flies them, without a vehicle, and what comes of them.

They are flown and judged as campaigns do it, every 10 m: the paper's ten samples a subpath miss
much of what breaks a bound.
"""

import math
import statistics
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from typing import Any, final

import numpy as np
import shapely

from companion import extras
from companion.campaign import drawn_world, truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.execute import worked
from companion.campaign.run import fly_alone
from companion.geodesy import FloatArray
from companion.library import route_terms
from companion.planning import OURS
from companion.profiles import PAPER

_ROUTE_SPACING_M, _DENSE_M = 100.0, 10.0  # of what is drawn, and of what is checked: d_s / 50
_LESS = 1.0 - 1e-6  # what lies on a bound has not crossed it
_STANDS = 1e-6  # of the fastest: r2 = 0, the join is a corner
KINDS = {
    "clearance": "nearer than d_s",  # to the ground
    "radar": "seen by radars",  # within the range of one (eq. 3)
    "turn": "turn",  # more tightly than the vehicle can, joins included
}
"""What may be violated, and how tables say it."""
ROUND = "goes round"

Point = tuple[float, float]  # north and east, metres


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A mission to fly, and who plans it; tables call it by its label under its heading."""

    heading: str
    label: str
    world: DrawnWorld
    planner: str = OURS  # ours plans by the task's profile, others as `planning.planner_of` says
    papers_cost: tuple[float, ...] = ()  # mean and standard deviation (Table 1)
    papers_way: str = ""  # which way the paper's route goes (Fig. 3, Fig. 4)
    across: str = ""  # what a route does that passes between the two points; any other goes round
    between_ne_m: tuple[Point, ...] = ()


def as_published(name: str, **settings: Any) -> DrawnWorld:
    """A bundled environment in profile `paper`, with some settings of the planner.

    L = V T + d_s (eq. 4): a scan takes no time.
    """
    timeless = {"scan_time_s": 0.0, "position_period_s": 0.0, "scan_distance_m": None}
    return with_settings(drawn_world.bundled(name), profile=PAPER, **timeless | settings)


def with_settings(world: DrawnWorld, **settings: Any) -> DrawnWorld:
    """A world whose mission is planned with other settings."""
    task = replace(world.task, settings=replace(world.task.settings, **settings))
    start_nea_m = (*world.start_nea_m[:2], task.take_off_amsl_m)
    return replace(world, task=task, start_nea_m=start_nea_m)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """How a case went with one seed."""

    arrived: bool
    cost: float  # sum of the subpaths' f: the "fitness from start to target" (row 24)
    length_m: float
    highest_amsl_m: float
    j: float  # length, height and radar of eq. 5 along what was flown (`library.route_terms`)
    plan_s: float  # processor time of all plans
    way: str  # between the points of the case, or round them
    violations_m: dict[str, float]  # metres of each kind
    route_nea_m: FloatArray  # (S, 3); the path as flown, every 100 m
    scans_nea_m: tuple[tuple[float, float, float], ...]


def fly(case: Case, seed: int) -> Run:
    """Fly a case: simulated scans and perfect tracking."""
    flight, plan_s = fly_alone(case.world, case.planner, seed=seed)
    route = flight.route_nea_m(_ROUTE_SPACING_M)
    curves = (leg.subpath.control_nea_m for leg in flight.legs)
    return Run(
        arrived=flight.failure is None,
        cost=sum(planned.cost for planned in flight.plans),
        length_m=sum(flight.flown_m),
        highest_amsl_m=float(route[:, 2].max()),
        j=sum(route_terms(route, case.world.task).values()),
        plan_s=sum(plan_s),
        way=case.across if crosses(route, case.between_ne_m) else ROUND,
        violations_m=violations(zip(curves, flight.flown_m, strict=True), case.world),
        route_nea_m=route,
        scans_nea_m=tuple(flight.scans_nea_m),
    )


def crosses(route_nea_m: FloatArray, between_ne_m: Sequence[Point]) -> bool:
    """Whether a route, (S, 3), passes between two points, seen from above."""
    route = shapely.LineString(np.repeat(route_nea_m[:, :2], 2, axis=0))  # one point is no line
    return bool(route.intersects(shapely.LineString(between_ne_m)))


def violations(flown: Iterable[tuple[FloatArray, float]], world: DrawnWorld) -> dict[str, float]:
    """Metres that break a bound, by kind, of curves (K, 3), each as far as it was flown, metres."""
    task, total = world.task, dict.fromkeys(KINDS, 0.0)
    d_s, tightest_m = task.settings.safety_distance_m, task.limits.turn_radius_m * _LESS
    for control_nea_m, flown_m in flown:
        curve = truth.sampled(control_nea_m, _DENSE_M)
        at_m, points = curve.length_m, curve.points_nea_m
        edges_m = np.concatenate([[0.0], 0.5 * (at_m[1:] + at_m[:-1]), at_m[-1:]])
        speed = np.linalg.norm(curve.first, axis=1)
        corner = speed < _STANDS * speed.max()
        seen = [radar.distance_m(points) < radar.range_m * _LESS for radar in task.radars]
        broken = {
            "clearance": truth.terrain_distance_m(points, world.terrain, d_s) < d_s * _LESS,
            "radar": np.any([*seen, np.zeros_like(corner)], axis=0),
            "turn": corner | (np.abs(curve.curvature_1_m) * tightest_m > 1.0),
        }
        for kind, where in broken.items():
            total[kind] += float(where @ np.diff(edges_m.clip(max=flown_m)))
    return total


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """A case, flown with some seeds."""

    case: Case
    runs: Sequence[Run]

    @property
    def costs(self) -> list[float]:
        """Of the runs that reached the target: only they have a cost from start to target."""
        return [run.cost for run in self.runs if run.arrived]

    @property
    def shown(self) -> Run:
        """The run of median cost: the one in pictures."""
        return sorted(self.runs, key=lambda run: run.cost)[(len(self.runs) - 1) // 2]

    def share(self, ways: str = "") -> str:
        """How many arrived; of a figure: how many go such a way."""
        counted = [run.way == ways if ways else run.arrived for run in self.runs]
        return f"{sum(counted)}/{len(self.runs)}"

    def mean(self, measure: str = "cost") -> float:
        """Mean of a number of `Run` over the runs that arrived; not a number when none did."""
        values = [getattr(run, measure) for run in self.runs if run.arrived]
        return statistics.fmean(values) if values else math.nan

    def violated(self, kind: str) -> tuple[float, float]:
        """The share of missions with a violation, and the mean metres of it in all missions."""
        found_m = [run.violations_m[kind] for run in self.runs]
        return statistics.fmean(each_m > 0.0 for each_m in found_m), statistics.fmean(found_m)

    def facts(self) -> dict[str, Any]:
        """All its numbers and the paper's, for --json."""
        case, runs = self.case, [asdict(run) for run in self.runs]
        for run in runs:
            del run["route_nea_m"], run["scans_nea_m"]
        names = ("heading", "label", "papers_cost", "papers_way")
        evaluations = case.world.task.settings.evaluations
        of_case = {name: getattr(case, name) for name in names}
        return of_case | {"evaluations": evaluations, "runs": runs}


def fly_all(
    cases: Sequence[Case],
    runs: int,
    seed: int,
    jobs: int,
    shown: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> list[Outcome]:
    """Fly each case with so many seeds, from this one on, in that many processes.

    The results do not depend on the number of processes, for more than one of which the extra
    `campaign` is needed.  shown: what is iterated over goes through it, to show how far it is.
    """
    every = [(case, seed + k) for case in cases for k in range(runs)]
    flying: Generator[tuple[int, Any]] = ((k, fly(*each)) for k, each in enumerate(every))
    if jobs > 1:
        extras.need("campaign", "--jobs", jobs)
        flying = worked(lambda each: fly(*each), every, jobs=min(jobs, len(every)))
    flown = dict[int, Run]()
    with closing(flying):
        for number, run in shown(flying):
            if isinstance(run, Exception):
                raise run
            flown[number] = run
    by_case = [[flown[k * runs + n] for n in range(runs)] for k in range(len(cases))]
    return [Outcome(case=case, runs=its) for case, its in zip(cases, by_case, strict=True)]
