"""Missions as the paper flies them, without a vehicle, and what comes of them.

They are flown and judged as campaigns do it, every 10 m: the paper's ten samples a subpath miss
much of what breaks a bound.
"""

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from companion import extras
from companion.campaign import drawn_world, truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.execute import worked
from companion.campaign.run import fly_alone
from companion.geodesy import FloatArray
from companion.library import route_terms
from companion.planning import OURS
from companion.profiles import PAPER

_ROUTE_SPACING_M, _DENSE_M = 100.0, 10.0
_TOLERANCE = 1e-6  # relative: what lies on a bound has not crossed it
KINDS = {
    "clearance": "nearer than d_s",  # to the ground
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
    """A mission to fly, and who plans it; tables call it by its label under its heading."""

    heading: str
    label: str
    world: DrawnWorld
    planner: str = OURS  # ours plans by the task's profile, others as `planning.planner_of` says
    papers_cost: tuple[float, ...] = ()  # mean and standard deviation (Table 1)
    papers_way: str = ""  # which way the paper's route goes (Fig. 3, Fig. 4)
    line: Line | None = None


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
    legs: int
    length_m: float
    j: float  # length, height and radar of eq. 5 along what was flown (`library.route_terms`)
    plan_s: float  # processor time of all plans
    route_nea_m: FloatArray  # (S, 3); the path as flown, every 100 m
    scans_nea_m: tuple[tuple[float, float, float], ...]
    violations: dict[str, float]  # metres of each kind


def fly(case: Case, seed: int) -> Run:
    """Fly a case: simulated scans and perfect tracking."""
    alone = fly_alone(case.world, case.planner, seed=seed)
    flight, route = alone.whole, alone.whole.route_nea_m(_ROUTE_SPACING_M)
    curves = (leg.subpath.control_nea_m for leg in flight.legs)
    return Run(
        arrived=flight.failure is None,
        cost=sum(planned.cost for planned in flight.plans),
        legs=len(flight.legs),
        length_m=sum(flight.flown_m),
        j=sum(route_terms(route, case.world.task).values()),
        plan_s=sum(alone.plan_s),
        route_nea_m=route,
        scans_nea_m=tuple(flight.scans_nea_m),
        violations=violations(zip(curves, flight.flown_m, strict=True), case.world),
    )


def violations(flown: Iterable[tuple[FloatArray, float]], world: DrawnWorld) -> dict[str, float]:
    """Metres that break a bound, by kind, of curves (K, 3), each as far as it was flown, metres."""
    task, limits, more, less = world.task, world.task.limits, 1.0 + _TOLERANCE, 1.0 - _TOLERANCE
    slack_m = _TOLERANCE * (limits.ceiling_amsl_m - limits.floor_amsl_m)
    d_s, total = task.settings.safety_distance_m, dict.fromkeys(KINDS, 0.0)
    for control_nea_m, flown_m in flown:
        curve = truth.sampled(control_nea_m, _DENSE_M)
        at_m, points, altitude_m = curve.length_m, curve.points_nea_m, curve.points_nea_m[:, 2]
        edges_m = np.concatenate([[0.0], 0.5 * (at_m[1:] + at_m[:-1]), at_m[-1:]])
        speed = np.linalg.norm(curve.first, axis=1)
        corner = speed < 1e-6 * speed.max()  # r2 = 0: the join is a corner, and has no direction
        climb_rad = np.where(corner, 0.0, curve.climb_rad)
        seen = [each.distance_m(points) < each.range_m * less for each in task.radars]
        broken = {
            "clearance": truth.terrain_distance_m(points, world.terrain, d_s) < d_s * less,
            "radar": np.any([*seen, np.zeros_like(corner)], axis=0),
            "turn": corner | (np.abs(curve.curvature_1_m) * limits.turn_radius_m > more),
            "climb": (climb_rad > limits.climb_angle_rad + _TOLERANCE)
            | (climb_rad < -limits.dive_angle_rad - _TOLERANCE),
            "band": (altitude_m < limits.floor_amsl_m - slack_m)
            | (altitude_m > limits.ceiling_amsl_m + slack_m),
        }
        for kind, where in broken.items():
            total[kind] += float(where @ np.diff(edges_m.clip(max=flown_m)))
    return total


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
    runs: Sequence[Run]

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
        return {
            kind: {
                "missions": statistics.fmean(run.violations[kind] > 0.0 for run in self.runs),
                "mean_m": statistics.fmean(run.violations[kind] for run in self.runs),
            }
            for kind in KINDS
        }

    @property
    def arrivals(self) -> str:
        """How many arrived."""
        return f"{len(self.costs)}/{len(self.runs)}"

    def mean(self, measure: str = "cost") -> float:
        """Mean of a number of `Run` over the runs that arrived; not a number when none did."""
        values = [getattr(run, measure) for run in self.runs if run.arrived]
        return statistics.fmean(values) if values else math.nan

    def facts(self) -> dict[str, Any]:
        """All its numbers and the paper's, for --json."""
        case, names = self.case, ("paper_mean_cost", "paper_st_dev_cost")
        paper: dict[str, Any] = dict(zip(names, case.papers_cost, strict=False))
        if case.line is not None:
            paper = {"papers_way": case.papers_way, "ways": self.ways}
        return {
            "heading": case.heading,
            "label": case.label,
            "world": case.world.name,
            "evaluations": case.world.task.settings.evaluations,
            "arrived": [run.arrived for run in self.runs],
            "costs": [run.cost if run.arrived else None for run in self.runs],
            "lengths_m": [run.length_m for run in self.runs],
            "highest_amsl_m": [float(run.route_nea_m[:, 2].max()) for run in self.runs],
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

    The results do not depend on the number of processes, for more than one of which the extra
    `campaign` is needed.  shown: what is iterated over goes through it, to show how far it is.
    """
    every = [(case, seed + k) for case in cases for k in range(runs)]
    if jobs == 1:
        flown = [fly(*each) for each in shown(every)]
    else:
        extras.need("campaign", "--jobs", jobs)
        found = dict[int, Run]()
        with closing(worked(lambda each: fly(*each), every, jobs=min(jobs, len(every)))) as working:
            for number, run in shown(working):
                if isinstance(run, Exception):
                    raise run
                found[number] = run
        flown = [found[number] for number in range(len(every))]
    parts = (flown[k : k + runs] for k in range(0, len(flown), runs))
    return [Outcome(case=case, runs=part) for case, part in zip(cases, parts, strict=True)]
