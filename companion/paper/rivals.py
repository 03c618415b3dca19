"""Planners of whole routes that the paper's introduction names, flown leg by leg as ours is.

A rival is a point: it turns on the spot and climbs without limit, chooses its way in the plane and
flies it at the lowest safe altitude.  It knows the map that ours knows.  What nobody has seen is
free for it; what it flies of its route ends with what was seen, or at the end of sight.

A* over a grid, and over a roadmap of Voronoi edges between obstacles; an ant colony (a max-min ant
system) on a grid, whose ants walk from node to node, drawn by pheromone and, as what an ant may
know, by the cost of a step and how much nearer it brings the target; RRT* of OMPL.
"""

import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_erosion
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import Voronoi

from companion import extras
from companion.entry_points import Parts
from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.paper.plan import reported
from companion.planner.request import NotPlanned, Planned, PlanRequest, Refusal
from companion.world.columns import safe_surface
from companion.world.radars import detection_probability

IntArray = NDArray[np.intp]
Lines = tuple[FloatArray, IntArray]
"""What lines cost, (E,), and the places that they join, (E, 2), each line once."""

_CONTROL = 121  # points of a subpath: R / 120 apart, less than a cell
_SPARE = 0.5  # of a cell, kept beside the clearance: the curve lies between points of the lattice
_AHEAD = 2.0  # of R: how far ahead a route is pulled straight; beyond, it will be planned again
_HIGH_M = 1e6  # above every ceiling
_AT_M = 0.01  # an end of a route is there
_SHORTEST = 4  # points of half a spacing: what is shorter is no way on
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
    ahead_m: float  # flown before the next question: further on, details do not count

    def place_m(self, index: IntArray) -> FloatArray:
        """North and east of points of the lattice.  (..., 2) -> (..., 2)."""
        return self.corner_ne_m + self.spacing_m * np.asarray(index)

    def index(self, at_ne_m: FloatArray) -> IntArray:
        """Row and column of the nearest points.  (..., 2) -> (..., 2)."""
        index = np.rint((at_ne_m - self.corner_ne_m) / self.spacing_m).astype(np.intp)
        return np.clip(index, 0, np.array(self.rate.shape) - 1)

    @property
    def sides_m(self) -> FloatArray:
        """The south-western and the north-eastern corner.  (2, 2)."""
        return self.place_m(np.array([(0, 0), np.subtract(self.rate.shape, 1)]))

    def line_cost(self, a_ne_m: FloatArray, b_ne_m: FloatArray) -> float:
        """Cost of a straight line, in metres of level flight; infinite: it is not free."""
        length_m = math.dist(a_ne_m, b_ne_m)
        share = np.linspace(0.0, 1.0, max(math.ceil(2.0 * length_m / self.spacing_m), 2) + 1)
        row, column = self.index(a_ne_m + share[:, None] * (b_ne_m - a_ne_m)).T
        return length_m * float(self.rate[row, column].mean())

    def straight(self, route_ne_m: FloatArray) -> FloatArray:
        """A route with lines in place of its bends where they cost no more, as far as ahead_m.

        A piece that a grid took for free, and that is not quite, counts double its length.
        """
        lengths_m = np.hypot(*np.diff(route_ne_m, axis=0).T)
        costs = np.array([self.line_cost(*ends) for ends in pairwise(route_ne_m)])
        cost = np.append(0.0, np.cumsum(np.where(np.isfinite(costs), costs, 2.0 * lengths_m)))
        last, kept = int(np.sum(np.cumsum(lengths_m) <= self.ahead_m)), [0]
        while (newest := kept[-1]) < last:
            farther = (
                there
                for there in range(last, newest + 1, -1)
                if self.line_cost(route_ne_m[newest], route_ne_m[there])
                <= cost[there] - cost[newest]
            )
            kept.append(next(farther, newest + 1))
        return np.concatenate([route_ne_m[kept], route_ne_m[newest + 1 :]])


RoutePlanner = Callable[[RouteProblem, np.random.Generator], FloatArray | None]
"""Answers with points (N, 2) from the start to the target; None: there is no route.  Also what an
entry point `companion.planners` names."""


# --- a route, asked for and flown


def leg_by_leg(route_planner: RoutePlanner) -> Callable[[PlanRequest], Planned | NotPlanned]:
    """A planner of whole routes as one of subpaths: of each route, what may be flown by the map."""

    def plan(request: PlanRequest) -> Planned | NotPlanned:
        problem = problem_of(request)
        answer = route_planner(problem, request.rng(0))
        if answer is not None:
            flown = _flown(_checked(answer, problem), problem, request)
            if flown is not None:
                return flown
        return request.refused(Refusal.NOTHING_SAFE)

    return plan


def problem_of(request: PlanRequest) -> RouteProblem:
    """The question of a plan: what nobody has seen is free."""
    task, known = request.task, request.known
    floor, ceiling = task.band_amsl_m
    sides = task.limits.north_m, task.limits.east_m
    surface = safe_surface(
        replace(known, upper_m=np.where(known.surveyed, known.upper_m, np.inf)),
        centre_ne_m=(0.5 * sum(sides[0]), 0.5 * sum(sides[1])),
        reach_m=0.5 * max(high - low for low, high in sides),
        clearance_m=_clear_m(request),
        unknown_m=-_HIGH_M,
    )
    axes = [np.arange(low, high + _AT_M, surface.cell_m) for low, high in sides]
    north, east = np.meshgrid(*axes, indexing="ij")
    need_m = surface.altitude_m(north, east)
    points = np.stack([north, east, np.clip(need_m, floor, ceiling)], axis=-1)
    level, *others = task.settings.weights.per_metre(task.settings.scan_range_m)
    high, seen = (weight / level for weight in others)  # in metres of level flight
    rate = 1.0 + high * (points[..., 2] - floor) / (ceiling - floor)
    for radar in task.radars:
        rate += seen * detection_probability(radar.distance_m(points), radar.range_m)
    for zone in task.zones:
        rate[zone.distance_m(north, east) < _clear_m(request)] = np.inf
    rate[need_m > ceiling] = np.inf
    problem = RouteProblem(
        start_ne_m=np.array(request.start.point_nea_m[:2]),
        target_ne_m=np.array(request.target_ne_m),
        corner_ne_m=points[0, 0, :2],
        spacing_m=surface.cell_m,
        rate=rate,
        lines=_LINES * task.settings.evaluations,
        ahead_m=_AHEAD * task.settings.scan_range_m,
    )
    rate[tuple(problem.index(problem.start_ne_m))] = 1.0 + high  # it is there
    return problem


def _clear_m(request: PlanRequest) -> float:
    return request.task.required_clearance_m + _SPARE * request.known.cell_m


def _checked(answer: FloatArray, problem: RouteProblem) -> FloatArray:
    """The answer, (N, 2); InputError if it is no route from the start to the target."""
    ends = problem.start_ne_m, problem.target_ne_m
    try:
        route = np.asarray(answer, dtype=np.float64)
    except (TypeError, ValueError):  # no numbers
        route = np.empty(0)
    is_line = route.shape[1:] == (2,) and len(route) > 1 and np.isfinite(route).all()
    if is_line and np.allclose(route[[0, -1]], ends, rtol=0.0, atol=_AT_M):
        return route
    rule = "a route is (N, 2), finite, from the start to the target"
    raise InputError("planner", f"an answer of shape {route.shape}", rule, "Correct the planner.")


def _flown(route: FloatArray, problem: RouteProblem, request: PlanRequest) -> Planned | None:
    """What may be flown of a route, pulled straight; None: nothing."""
    task, known, scan_ne_m = request.task, request.known, request.scan_nea_m[:2]
    range_m, (floor, ceiling) = task.settings.scan_range_m, task.band_amsl_m
    surface = safe_surface(
        known,
        centre_ne_m=scan_ne_m,
        reach_m=range_m,
        clearance_m=_clear_m(request),
        unknown_m=_HIGH_M,
    )
    route = problem.straight(route)
    length_m = np.hypot(*np.diff(route, axis=0).T).sum()
    points = _evenly(route, math.ceil(2.0 * length_m / problem.spacing_m) + 1)
    nodes = problem.index(points)
    cells = np.array([known.cell_of(*point) for point in points.tolist()])
    may_be = np.isfinite(problem.rate[tuple(nodes.T)])
    may_be &= surface.altitude_m(*problem.place_m(nodes).T) <= ceiling
    may_be &= known.surveyed[tuple(np.clip(cells, 0, np.array(known.surveyed.shape) - 1).T)]
    may_be |= (nodes == nodes[0]).all(axis=1)  # it is there
    may_be |= binary_closing(may_be, np.ones(_SHORTEST + 1, dtype=bool))  # within the spare
    may_be &= np.hypot(*(points - scan_ne_m).T) < range_m
    arrives = bool(may_be.all())
    points = points if arrives else points[: np.argmin(may_be)]
    if len(points) < _SHORTEST:
        return None
    points = _evenly(points, _CONTROL)
    altitude_m = np.clip(surface.altitude_m(*points.T), floor, ceiling)
    altitude_m[0] = request.start.point_nea_m[2]
    return reported(request, np.column_stack([points, altitude_m]), reaches_target=arrives)


def _evenly(route: FloatArray, count: int) -> FloatArray:
    """So many points evenly along a route.  (N, 2) -> (count, 2)."""
    along_m = np.cumsum([0.0, *np.hypot(*np.diff(route, axis=0).T)])
    at_m = np.linspace(0.0, along_m[-1], count)
    return np.stack([np.interp(at_m, along_m, column) for column in route.T], axis=-1)


# --- the cheapest ways over graphs

SIXTEEN = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (2, -1), (1, -2))  # and back
_STRIDE, _ANTS_STRIDE = 4, 10  # points of the lattice to a step of the grid: R / 40, R / 16
_THREAT = 2.5  # what a metre costs where ground is taken for an obstacle: within a radar's range
_APART = 4  # points of the lattice between sites of the diagram, at least
_JOINED = 25  # places that start and target are joined to


def a_star(problem: RouteProblem, _rng: np.random.Generator) -> FloatArray | None:
    """The cheapest way over a grid."""
    return _cheapest(*_grid(problem, _STRIDE))


def voronoi(problem: RouteProblem, _rng: np.random.Generator) -> FloatArray | None:
    """The cheapest way over a roadmap as far as can be from obstacles.

    The diagram is that of the edges of what is closed or costs much, and of the map, thinned.
    """
    barred = np.pad(~(problem.rate < _THREAT), 1, constant_values=True)
    edges = np.argwhere(barred & ~binary_erosion(barred, border_value=1)) - 1
    _, first = np.unique(edges // _APART, axis=0, return_index=True)
    diagram = Voronoi(problem.place_m(edges[np.sort(first)]))
    corners, (low, high) = np.asarray(diagram.vertices), problem.sides_m
    inside = np.append(np.all((corners >= low) & (corners <= high), axis=1), False)  # -1: far away
    lines = np.array(diagram.ridge_vertices)
    lines = lines[inside[lines].all(axis=1)]
    return _cheapest(*_graph(problem, corners, _free(problem, corners, lines)))


def _grid(problem: RouteProblem, stride: int) -> tuple[csr_array, FloatArray]:
    """Every stride-th point of the rate, in 16 directions, and the ends."""
    nodes = np.indices(problem.rate[::stride, ::stride].shape).reshape(2, -1).T
    costs, steps = grid_steps(problem.rate, stride, SIXTEEN)
    return _graph(problem, problem.place_m(stride * nodes), (costs * problem.spacing_m, steps))


def grid_steps(rate: FloatArray, stride: int, ways: Sequence[tuple[int, int]]) -> Lines:
    """The free steps of a grid whose nodes are every stride-th point of a rate, by rows.

    Costs are in points of the rate; its mean along a step counts, at both ends and
    stride - 1 places between.
    """
    (rows, columns), steps_found = rate[::stride, ::stride].shape, []
    for up, right in ways:
        row, column = np.ogrid[: rows - up, max(0, -right) : columns - max(0, right)]
        along = [
            rate[stride * row + up * k, stride * column + right * k] for k in range(stride + 1)
        ]
        cost = (math.hypot(up, right) * np.trapezoid(along, axis=0)).ravel()
        starts = (row * columns + column).ravel()
        steps_found.append(
            np.stack([cost, starts, starts + up * columns + right])[:, np.isfinite(cost)]
        )
    costs, *steps = np.concatenate(steps_found, axis=1)
    return costs, np.stack(steps, axis=-1).astype(np.intp)


def _free(problem: RouteProblem, places_m: FloatArray, lines: IntArray) -> Lines:
    """Straight lines between places (K, 2), as far as they are free."""
    costs = np.array([problem.line_cost(*places_m[pair]) for pair in lines])
    free = np.isfinite(costs)
    return costs[free], lines[free]


def _graph(
    problem: RouteProblem, places_m: FloatArray, lines: Lines
) -> tuple[csr_array, FloatArray]:
    """A graph of lines between places (K, 2), with start and target as the last two places.

    These are joined to the places next to them, and to each other, by free lines.
    """
    start, target = len(places_m), len(places_m) + 1
    every = np.concatenate([places_m, [problem.start_ne_m, problem.target_ne_m]])
    used, joined = np.unique(lines[1]), [(start, target)]
    for end in (start, target):
        away_m = np.linalg.norm(places_m[used] - every[end], axis=-1)
        joined += [(end, k) for k in used[np.argsort(away_m, kind="stable")[:_JOINED]].tolist()]
    ends = _free(problem, every, np.array(joined))
    costs, pairs = (np.concatenate(both) for both in zip(lines, ends, strict=True))
    return csr_array((costs, pairs.T), shape=(len(every), len(every))), every


def _cheapest(graph: csr_array, places_m: FloatArray) -> FloatArray | None:
    """The cheapest way from the last place but one to the last."""
    way = cheapest(graph, len(places_m) - 2, len(places_m) - 1)
    return places_m[way] if way else None


def cheapest(graph: csr_array, start: int, end: int) -> list[int]:
    """Nodes of the cheapest way over an undirected graph, as A* finds it; empty: there is none."""
    _, (before,) = dijkstra(graph, directed=False, indices=[start], return_predecessors=True)
    way = [end]
    while before[way[-1]] >= 0:
        way.append(int(before[way[-1]]))
    return way[::-1] if way[-1] == start else []


# --- the ant colony

_ANTS, _GENERATIONS, _EVAPORATES = 40, 60, 0.1  # not tuned: it is a rival
_GREED = 4.0  # how strongly what lies in the target's direction draws, beside the pheromone
_LEAST = 0.01  # of the most pheromone


def ants(problem: RouteProblem, rng: np.random.Generator) -> FloatArray | None:
    """The cheapest walk over a coarser grid that a colony has found."""
    graph, places_m = _grid(problem, _ANTS_STRIDE)
    graph = graph.maximum(graph.T).tocsr()  # a step is an index of its data
    start, end = len(places_m) - 2, len(places_m) - 1
    starts, there = np.repeat(np.arange(end + 1), np.diff(graph.indptr)), graph.indices
    if not cheapest(graph, start, end):
        return None
    left_m = np.linalg.norm(places_m - places_m[end], axis=-1)
    length_m = np.linalg.norm(places_m[starts] - places_m[there], axis=-1)
    draw = np.exp(-_GREED * (graph.data + left_m[there] - left_m[starts]) / length_m)
    pheromone, least, best = np.ones(graph.nnz), math.inf, list[int]()
    for _ in range(_GENERATIONS):
        weights = pheromone * draw
        weights /= np.bincount(starts, weights)[starts]
        total = np.append(0.0, np.cumsum(weights))  # those from a place sum to 1
        at, walks = np.full(_ANTS, start), list[IntArray]()
        while (at != end).any() and len(walks) < 8 * math.isqrt(end):  # four times across and back
            low, high = total[graph.indptr[at]], total[graph.indptr[at + 1]]
            drawn = low + rng.random(_ANTS) * (high - low)
            walks.append(np.searchsorted(total, drawn, side="right") - 1)
            at = np.where(at == end, end, there[walks[-1]])
        for steps in np.transpose(walks)[at == end]:
            last = dict(zip(starts[steps].tolist(), steps.tolist(), strict=True))
            walk, place = list[int](), start
            while place != end:  # the last step from each place that it was in: without loops
                walk.append(last[place])
                place = int(there[walk[-1]])
            if (cost := graph.data[walk].sum()) < least:
                least, best = cost, walk
        pheromone *= 1.0 - _EVAPORATES
        pheromone[best] += _EVAPORATES
        pheromone = np.clip(pheromone, _LEAST, 1.0)
    return places_m[[*starts[best].tolist(), end]] if best else None


# --- RRT* of OMPL


def rrt_star(problem: RouteProblem, rng: np.random.Generator) -> FloatArray | None:
    """The best route of OMPL's RRT*, with its own defaults, in the plane and by our objective.

    It stops when so many lines have been costed.  OMPL's own generator is seeded before each plan,
    so a plan is a function of problem and seed.
    """
    extras.need("compare", "planner", "rrt-star")
    from ompl import base, geometric, util  # slow to import

    @cache
    def known(*ends: float) -> float:
        return problem.line_cost(np.array(ends[:2]), np.array(ends[2:]))

    def cost(a: Any, b: Any) -> float:
        return known(a[0], a[1], b[0], b[1])

    def is_spent() -> bool:
        return known.cache_info().currsize >= problem.lines

    class Validator(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, a: Any, b: Any, _last: Any = None) -> bool:
            return cost(a, b) < np.inf

    class Objective(base.PathLengthOptimizationObjective):  # type: ignore[misc]
        def motionCost(self, a: Any, b: Any) -> Any:
            return base.Cost(cost(a, b))

    util.noOutputHandler()
    util.RNG.setSeed(int(rng.integers(1, 2**31)))
    space, bounds = base.RealVectorStateSpace(2), base.RealVectorBounds(2)
    for axis, (low, high) in enumerate(problem.sides_m.T):
        bounds.setLow(axis, low)
        bounds.setHigh(axis, high)
    space.setBounds(bounds)
    ends = [space.allocState(), space.allocState()]
    for state, place in zip(ends, (problem.start_ne_m, problem.target_ne_m), strict=True):
        state[0], state[1] = place.tolist()
    setup = geometric.SimpleSetup(space)
    information = setup.getSpaceInformation()
    validator, objective = Validator(information), Objective(information)  # OMPL does not keep them
    information.setMotionValidator(validator)
    setup.setStateValidityChecker(lambda _state: True)  # no free line leads to one that is closed
    setup.setOptimizationObjective(objective)
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(geometric.RRTstar(information))
    setup.solve(base.PlannerTerminationCondition(is_spent))
    if not setup.haveExactSolutionPath():
        return None
    return np.array([[state[0], state[1]] for state in setup.getSolutionPath().getStates()])


# --- all of them


def _wrong_with(planner: RoutePlanner) -> str | None:
    """Why it cannot be asked; None: it can."""
    try:
        inspect.signature(planner).bind(None, None)
    except TypeError as error:
        return f"it does not take a problem and a random generator: {error}"
    return None


PLANNERS = Parts[RoutePlanner](
    "companion.planners",
    {"a-star": a_star, "voronoi": voronoi, "ants": ants, "rrt-star": rrt_star},
    what="planner",
    check=_wrong_with,
)
"""Every planner of whole routes by its name; other distributions add theirs."""
