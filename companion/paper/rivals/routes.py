"""What planners of whole routes are asked, and how what they answer becomes a subpath.

A rival is a point: it turns on the spot and climbs without limit, chooses its way in the plane and
flies it at the lowest safe altitude.  It knows the map that ours knows.  What nobody has seen is
free for it; what it flies of its route ends with what was seen, or at the end of sight.
"""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing

from companion.entry_points import Parts
from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.paper.plan import reported
from companion.planner.request import NotPlanned, Planned, PlanRequest, Refusal
from companion.world.columns import Surface, safe_surface
from companion.world.known_map import KnownMap
from companion.world.radars import detection_probability

IntArray = NDArray[np.intp]

_CONTROL = 121  # points of a subpath: R / 120 apart, less than a cell
_SPARE = 0.5  # of a cell, kept beside the clearance: the curve lies between points of the lattice
_AHEAD = 2.0  # of R: how far ahead a route is pulled straight; beyond, it will be planned again
_HIGH_M = 1e6  # above every ceiling
_AT_M = 0.01  # an end of a route is there
_LEAST = 4  # points of half a spacing: what is shorter is no way on
_GRAZE = np.ones(_LEAST + 1, dtype=bool)  # so little of what is closed is within the spare
_LINES = 7  # lines for each evaluation of ours: 20,000 for 3,000, about a second by RRT*


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RouteProblem:
    """From a start to a target by what is known now, on a square lattice; places are (2,)."""

    start_ne_m: FloatArray
    target_ne_m: FloatArray
    corner_ne_m: FloatArray  # of point (0, 0), the south-west corner of the map
    spacing_m: float
    rate: FloatArray
    """(rows, columns): what a metre costs at the lowest safe altitude, in metres of level flight at
    the floor, so never below 1; infinite: no one may be there."""
    lines: int  # how many lines may be costed; a planner that does not sample needs no limit
    ahead_m: float
    """How far ahead it will be flown before the next question: further on, details do not count."""

    def place_m(self, index: IntArray) -> FloatArray:
        """North and east of points of the lattice.  (..., 2) -> (..., 2)."""
        return self.corner_ne_m + self.spacing_m * np.asarray(index)

    def index(self, at_ne_m: FloatArray) -> IntArray:
        """Row and column of the nearest points.  (..., 2) -> (..., 2)."""
        index = np.rint((at_ne_m - self.corner_ne_m) / self.spacing_m).astype(np.intp)
        return np.clip(index, 0, np.array(self.rate.shape) - 1)

    def rate_at(self, at_ne_m: FloatArray) -> FloatArray:
        """The rate at the nearest points.  (..., 2) -> (...)."""
        row, column = np.moveaxis(self.index(at_ne_m), -1, 0)
        return self.rate[row, column]

    def line_cost(self, a_ne_m: FloatArray, b_ne_m: FloatArray) -> float:
        """Cost of a straight line, in metres of level flight; infinite: it is not free."""
        length_m = math.dist(a_ne_m, b_ne_m)
        share = np.linspace(0.0, 1.0, max(math.ceil(2.0 * length_m / self.spacing_m), 2) + 1)
        return length_m * float(self.rate_at(a_ne_m + share[:, None] * (b_ne_m - a_ne_m)).mean())

    def straight(self, route_ne_m: FloatArray) -> FloatArray:
        """A route with lines in place of its bends where they cost no more, as far as ahead_m.

        A piece that a grid took for free, and that is not quite, counts double its length.
        """
        pieces = [(self.line_cost(a, b), math.dist(a, b)) for a, b in pairwise(route_ne_m)]
        cost = np.cumsum([0.0, *(c if math.isfinite(c) else 2.0 * m for c, m in pieces)])
        last, kept = sum(np.cumsum([m for _, m in pieces]) <= self.ahead_m), [0]
        while (here := kept[-1]) < last:
            farther = (
                there
                for there in range(last, here + 1, -1)
                if self.line_cost(route_ne_m[here], route_ne_m[there]) <= cost[there] - cost[here]
            )
            kept.append(next(farther, here + 1))
        return np.concatenate([route_ne_m[kept], route_ne_m[here + 1 :]])


RoutePlanner = Callable[[RouteProblem, np.random.Generator], FloatArray | str]
"""Answers with points (N, 2) from the start to the target, or with why there is no route; also what
an entry point `companion.planners` names."""


def _wrong_with(planner: RoutePlanner) -> str | None:
    """Why it cannot be asked; None: it can."""
    try:
        inspect.signature(planner).bind(None, None)
    except TypeError as error:
        return f"it does not take a problem and a random generator: {error}"
    return None


PLANNERS = Parts[RoutePlanner](
    "companion.planners",
    {
        "a-star": "companion.paper.rivals.roadmaps:a_star",
        "voronoi": "companion.paper.rivals.roadmaps:voronoi",
        "ants": "companion.paper.rivals.roadmaps:ants",
        "rrt-star": "companion.paper.rivals.sampling:rrt_star",
        "bit-star": "companion.paper.rivals.sampling:bit_star",
    },
    what="planner",
    check=_wrong_with,
)
"""Every planner of whole routes by its name; other distributions add theirs."""


def leg_by_leg(route_planner: RoutePlanner) -> Callable[[PlanRequest], Planned | NotPlanned]:
    """A planner of whole routes as one of subpaths: of each route, what may be flown by the map."""

    def plan(request: PlanRequest) -> Planned | NotPlanned:
        problem = problem_of(request)
        route = route_planner(problem, request.rng(0))
        if not isinstance(route, str):
            control, arrives = _flown(_checked(route, problem), problem, request)
            if len(control):
                return reported(request, control, reaches_target=arrives)
        return NotPlanned(plan_id=request.plan_id, refusal=Refusal.NOTHING_SAFE)

    return plan


def problem_of(request: PlanRequest) -> RouteProblem:
    """The question of a plan: what nobody has seen is free."""
    task, sides = request.task, (request.task.limits.north_m, request.task.limits.east_m)
    seen_m = np.where(request.known.surveyed, request.known.upper_m, np.inf)
    surface = _safe_surface(
        request,
        replace(request.known, upper_m=seen_m),
        centre_ne_m=(0.5 * sum(sides[0]), 0.5 * sum(sides[1])),
        reach_m=0.5 * max(high - low for low, high in sides),
        unknown_m=-_HIGH_M,
    )
    axes = []
    for first, size, (low, high) in zip(surface[:2], surface.vertex_m.shape, sides, strict=True):
        axis = first + surface.cell_m * np.arange(size)
        axes.append(axis[(axis >= low - _AT_M) & (axis <= high + _AT_M)])
    north, east = np.meshgrid(*axes, indexing="ij")
    need_m = surface.altitude_m(north, east)
    (floor, ceiling), weights = task.band_amsl_m, task.settings.weights
    altitude_m = np.clip(need_m, floor, ceiling)
    # eq. 5 to 7 and 10 a metre, as in `library.route_terms`, in metres of level flight
    high, seen = (2.4 * weight / weights.length for weight in (weights.height, 3.0 * weights.radar))
    rate = 1.0 + high * (altitude_m - floor) / (ceiling - floor)
    for radar in task.radars:
        points = np.stack([north, east, altitude_m], axis=-1)
        rate += seen * detection_probability(radar.distance_m(points), radar.range_m)
    for zone in task.zones:
        rate[zone.distance_m(north, east) < _clear_m(request)] = np.inf
    rate[need_m > ceiling] = np.inf
    problem = RouteProblem(
        start_ne_m=np.array(request.start.point_nea_m[:2]),
        target_ne_m=np.array(request.target_ne_m),
        corner_ne_m=np.array([axes[0][0], axes[1][0]]),
        spacing_m=surface.cell_m,
        rate=rate,
        lines=_LINES * task.settings.evaluations,
        ahead_m=_AHEAD * task.settings.scan_range_m,
    )
    rate[tuple(problem.index(problem.start_ne_m))] = 1.0 + high  # it is there
    return problem


def _clear_m(request: PlanRequest) -> float:
    return request.task.required_clearance_m + _SPARE * request.known.cell_m


def _safe_surface(request: PlanRequest, known: KnownMap, **where: Any) -> Surface:
    return safe_surface(known, clearance_m=_clear_m(request), **where)


def _checked(answer: FloatArray, problem: RouteProblem) -> FloatArray:
    """The answer, (N, 2); InputError if it is no route from the start to the target."""
    route, ends = np.asarray(answer, dtype=np.float64), (problem.start_ne_m, problem.target_ne_m)
    is_line = route.shape[1:] == (2,) and len(route) > 1 and np.isfinite(route).all()
    if not is_line or not np.allclose(route[[0, -1]], ends, rtol=0.0, atol=_AT_M):
        rule = "a route is (N, 2), finite, from the start to the target"
        answered = f"an answer of shape {route.shape}"
        raise InputError("planner", answered, rule, "Correct the planner.")
    return route


def _flown(
    route: FloatArray, problem: RouteProblem, request: PlanRequest
) -> tuple[FloatArray, bool]:
    """Control points (K, 3) of what may be flown of a route, none if nothing; whether all of it."""
    task, known, scan_ne_m = request.task, request.known, request.scan_nea_m[:2]
    range_m, (floor, ceiling) = task.settings.scan_range_m, task.band_amsl_m
    surface = _safe_surface(
        request, known, centre_ne_m=scan_ne_m, reach_m=range_m, unknown_m=_HIGH_M
    )
    length_m = np.hypot(*np.diff(route, axis=0).T).sum()
    points = resampled(route, math.ceil(2.0 * length_m / problem.spacing_m) + 1)
    nodes = problem.index(points)
    cells = np.array([known.cell_of(*point) for point in points.tolist()])
    may_be = np.isfinite(problem.rate[tuple(nodes.T)])
    may_be &= surface.altitude_m(*problem.place_m(nodes).T) <= ceiling
    may_be &= known.surveyed[tuple(np.clip(cells, 0, np.array(known.surveyed.shape) - 1).T)]
    may_be |= (nodes == nodes[0]).all(axis=1)  # it is there
    may_be |= binary_closing(may_be, _GRAZE)
    may_be &= np.hypot(*(points - scan_ne_m).T) < range_m
    arrives = bool(may_be.all())
    points = points if arrives else points[: np.argmin(may_be)]
    if len(points) < _LEAST:
        return np.empty((0, 3)), False
    points = resampled(points, _CONTROL)
    altitude_m = np.clip(surface.altitude_m(*points.T), floor, ceiling)
    altitude_m[0] = request.start.point_nea_m[2]
    return np.column_stack([points, altitude_m]), arrives


def resampled(route: FloatArray, count: int) -> FloatArray:
    """So many points evenly along a route.  (N, 2) -> (count, 2)."""
    along_m = np.cumsum([0.0, *np.hypot(*np.diff(route, axis=0).T)])
    at_m = np.linspace(0.0, along_m[-1], count)
    return np.stack([np.interp(at_m, along_m, column) for column in route.T], axis=-1)
