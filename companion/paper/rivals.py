"""Planners of whole routes that the paper's introduction names, flown leg by leg as ours is.

A rival is a point: it turns on the spot and climbs without limit, chooses its way in the plane and
flies it at the lowest safe altitude.  It knows the map that ours knows.  What nobody has seen is
free for it; what it flies of its route ends with what was seen, or at the end of sight.

A* over a grid, and along the Voronoi diagram of the obstacles on it; an ant colony (a max-min ant
system) on a coarser grid; RRT* of OMPL.
"""

import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import count, pairwise
from typing import Any, final

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_dilation, distance_transform_edt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from companion import extras
from companion.entry_points import Parts
from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.paper.plan import reported
from companion.planner.request import NotPlanned, Planned, PlanRequest, Refusal
from companion.world.columns import safe_surface
from companion.world.radars import detection_probability

IntArray = NDArray[np.intp]

_CONTROL = 121  # points of a subpath: R / 120 apart, less than a cell
_SPARE = 0.5  # of a cell, kept beside the clearance: the curve lies between points of the lattice
_AHEAD = 2.0  # of R: how far ahead a route is pulled straight; beyond, it will be planned again
_HIGH_M = 1e6  # above every ceiling
_AT_M = 0.01  # what is nearer to the edge of the map is on it
_SHORTEST = 4  # points of half a spacing: what is shorter is no way on


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RouteProblem:
    """From a start to a target by what is known now, on a square lattice; places are (2,)."""

    start_ne_m: FloatArray
    target_ne_m: FloatArray
    corner_ne_m: FloatArray  # of point (0, 0): it may lie off the map, where no one may be
    spacing_m: float
    rate: FloatArray
    """(rows, columns): what a metre costs at the lowest safe altitude, in metres of level flight at
    the floor, so never below 1; infinite: no one may be there."""
    evaluations: int  # of our search: so many samples may be drawn, if it draws any

    def place_m(self, index: IntArray) -> FloatArray:
        """North and east of points of the lattice.  (..., 2) -> (..., 2)."""
        return self.corner_ne_m + self.spacing_m * np.asarray(index)

    def index(self, at_ne_m: FloatArray) -> IntArray:
        """Row and column of the nearest points.  (..., 2) -> (..., 2)."""
        index = np.rint((at_ne_m - self.corner_ne_m) / self.spacing_m).astype(np.intp)
        return np.clip(index, 0, np.array(self.rate.shape) - 1)

    def line_cost(self, a_ne_m: FloatArray, b_ne_m: FloatArray) -> float:
        """Cost of a straight line, in metres of level flight; infinite: it is not free."""
        length_m = math.dist(a_ne_m, b_ne_m)
        share = np.linspace(0.0, 1.0, max(math.ceil(2.0 * length_m / self.spacing_m), 2) + 1)
        row, column = self.index(a_ne_m + share[:, None] * (b_ne_m - a_ne_m)).T
        return length_m * float(self.rate[row, column].mean())

    def straight(self, route_ne_m: FloatArray, most_m: float = math.inf) -> FloatArray:
        """A route with lines in place of its bends where they cost no more, as far as most_m.

        A piece that a grid took for free, and that is not quite, counts double its length.
        """
        lengths_m = np.hypot(*np.diff(route_ne_m, axis=0).T)
        costs = np.array([self.line_cost(*ends) for ends in pairwise(route_ne_m)])
        cost = np.append(0.0, np.cumsum(np.where(np.isfinite(costs), costs, 2.0 * lengths_m)))
        last, kept = int(np.sum(np.cumsum(lengths_m) <= most_m)), [0]
        while (here := kept[-1]) < last:
            there = last
            while there > here + 1 and (
                self.line_cost(route_ne_m[here], route_ne_m[there]) > cost[there] - cost[here]
            ):
                there -= 1
            kept.append(there)
        return np.concatenate([route_ne_m[kept], route_ne_m[last + 1 :]])


RoutePlanner = Callable[[RouteProblem, np.random.Generator], FloatArray | None]
"""Answers with points (N, 2) between the start and the target; None: there is no route.  Also what
an entry point `companion.planners` names."""


# --- a route, asked for and flown


def leg_by_leg(route_planner: RoutePlanner) -> Callable[[PlanRequest], Planned | NotPlanned]:
    """A planner of whole routes as one of subpaths: of each route, what may be flown by the map."""

    def plan(request: PlanRequest) -> Planned | NotPlanned:
        problem, leg = problem_of(request), None
        answer = route_planner(problem, request.rng(0))
        if answer is not None:
            if np.shape(answer)[1:] != (2,) or not np.isfinite(answer).all():
                rule, told = "a route is (N, 2) and finite", f"shape {np.shape(answer)}"
                raise InputError("planner", told, rule, "Correct the planner.")
            route = np.concatenate([[problem.start_ne_m], answer, [problem.target_ne_m]])
            ahead_m = _AHEAD * request.task.settings.scan_range_m
            leg = _flown(problem.straight(route, ahead_m), problem, request)
        return leg or NotPlanned(plan_id=request.plan_id, refusal=Refusal.NOTHING_SAFE)

    return plan


def problem_of(request: PlanRequest) -> RouteProblem:
    """The question of a plan: what nobody has seen is free."""
    task, known, (floor, ceiling) = request.task, request.known, request.task.band_amsl_m
    south_west, north_east = np.array([task.limits.north_m, task.limits.east_m]).T
    surface = safe_surface(
        replace(known, upper_m=np.where(known.surveyed, known.upper_m, np.inf)),
        centre_ne_m=tuple(0.5 * (south_west + north_east)),
        reach_m=0.5 * max(north_east - south_west),
        clearance_m=_clear_m(request),
        unknown_m=-_HIGH_M,
    )
    need_m = surface.vertex_m
    altitude_m = np.clip(need_m, floor, ceiling)
    level, *others = task.settings.weights.per_metre(task.settings.scan_range_m)
    high, seen = (each / level for each in others)  # in metres of level flight
    problem = RouteProblem(
        start_ne_m=np.array(request.start.point_nea_m[:2]),
        target_ne_m=np.array(request.target_ne_m),
        corner_ne_m=np.array(surface[:2]),
        spacing_m=surface.cell_m,
        rate=1.0 + high * (altitude_m - floor) / (ceiling - floor),
        evaluations=task.settings.evaluations,
    )
    rate, places = problem.rate, problem.place_m(np.moveaxis(np.indices(need_m.shape), 0, -1))
    for radar in task.radars:
        away_m = radar.distance_m(np.dstack([places, altitude_m]))
        rate += seen * detection_probability(away_m, radar.range_m)
    for zone in task.zones:
        rate[zone.distance_m(*np.moveaxis(places, -1, 0)) < _clear_m(request)] = np.inf
    off_map = (places < south_west - _AT_M) | (places > north_east + _AT_M)
    rate[off_map.any(axis=-1) | (need_m > ceiling)] = np.inf
    rate[tuple(problem.index(problem.start_ne_m))] = 1.0 + high  # it is there
    return problem


def _clear_m(request: PlanRequest) -> float:
    return request.task.required_clearance_m + _SPARE * request.known.cell_m


def _flown(route: FloatArray, problem: RouteProblem, request: PlanRequest) -> Planned | None:
    """What may be flown of a route, as far as sight; None: nothing."""
    task, known, scan_ne_m = request.task, request.known, request.scan_nea_m[:2]
    range_m, (floor, ceiling) = task.settings.scan_range_m, task.band_amsl_m
    surface = safe_surface(
        known,
        centre_ne_m=scan_ne_m,
        reach_m=range_m,
        clearance_m=_clear_m(request),
        unknown_m=_HIGH_M,
    )
    points = shapely.get_coordinates(
        shapely.segmentize(shapely.LineString(route), 0.5 * problem.spacing_m)
    )
    nodes = problem.index(points)
    cells = (points - (known.north_min_m, known.east_min_m)) // known.cell_m
    rows, columns = np.clip(cells.astype(np.intp), 0, np.array(known.shape) - 1).T
    may_be = np.isfinite(problem.rate[tuple(nodes.T)]) & known.surveyed[rows, columns]
    may_be &= surface.altitude_m(*problem.place_m(nodes).T) <= ceiling
    may_be |= (nodes == nodes[0]).all(axis=1)  # it is there
    may_be |= binary_closing(may_be, np.ones(_SHORTEST + 1, dtype=bool))  # within the spare
    may_be &= np.hypot(*(points - scan_ne_m).T) < range_m
    arrives = bool(may_be.all())
    points = points if arrives else points[: np.argmin(may_be)]
    if len(points) < _SHORTEST:
        return None
    line, shares = shapely.LineString(points), np.linspace(0.0, 1.0, _CONTROL)
    points = shapely.get_coordinates(line.interpolate(shares, normalized=True))
    altitude_m = np.clip(surface.altitude_m(*points.T), floor, ceiling)
    altitude_m[0] = request.start.point_nea_m[2]
    return reported(request, np.column_stack([points, altitude_m]), reaches_target=arrives)


# --- the cheapest ways over grids

SIXTEEN = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (2, -1), (1, -2))  # and back
_STRIDE, _ANTS_STRIDE = 4, 10  # points of the lattice to a step of the grid: R / 40, R / 16
_THREAT = 2.5  # what a metre costs where ground is taken for an obstacle: within a radar's range
_APART = 8  # points of the lattice between what is nearest to both sides of an edge of the diagram
_ASIDE = 4.0  # how much dearer it is to fly where there is none


def a_star(problem: RouteProblem, _rng: np.random.Generator) -> FloatArray | None:
    """The cheapest way over a grid."""
    return _cheapest(problem, problem.rate)


def voronoi(problem: RouteProblem, _rng: np.random.Generator) -> FloatArray | None:
    """The cheapest way to, along and from the diagram, which is as far as can be from obstacles.

    These are what is closed or costs much, and what lies off the map.
    """
    free = np.pad(problem.rate < _THREAT, 1)
    nearest = distance_transform_edt(free, return_distances=False, return_indices=True)
    steps = np.gradient(nearest.astype(np.float64), axis=(1, 2))
    edges = np.any([np.linalg.norm(step, axis=0) > 0.5 * _APART for step in steps], axis=0)
    edges = binary_dilation(edges, iterations=_STRIDE // 2)[1:-1, 1:-1]  # for the grid to meet
    return _cheapest(problem, np.where(edges, 1.0, _ASIDE) * problem.rate)


def _cheapest(problem: RouteProblem, rate: FloatArray) -> FloatArray | None:
    graph, places_m, start, target = _grid(problem, rate, _STRIDE)
    way = cheapest(graph, start, target)
    return places_m[way] if way else None


def _grid(
    problem: RouteProblem, rate: FloatArray, stride: int
) -> tuple[csr_array, FloatArray, int, int]:
    """The graph of every stride-th point of a rate, in 16 directions.

    -> it, with costs in metres; its places (K, 2); of these the free ones next to start and target.
    """
    thin = rate[::stride, ::stride]
    places_m = problem.place_m(stride * np.indices(thin.shape).reshape(2, -1).T)
    closed_m = np.where(np.isfinite(thin.ravel()), 0.0, np.inf)
    start, target = (
        int(np.argmin(np.linalg.norm(places_m - end, axis=1) + closed_m))
        for end in (problem.start_ne_m, problem.target_ne_m)
    )
    return problem.spacing_m * grid_graph(rate, stride, SIXTEEN), places_m, start, target


def grid_graph(rate: FloatArray, stride: int, ways: Sequence[tuple[int, int]]) -> csr_array:
    """The free steps of a grid whose nodes are every stride-th point of a rate, by rows.

    Each is in it once.  Costs are in points of the rate; its mean along a step counts, at both ends
    and stride - 1 places between.
    """
    rows, columns = rate[::stride, ::stride].shape
    found = []
    for up, right in ways:
        row, column = np.ogrid[: rows - up, max(0, -right) : columns - max(0, right)]
        parts = range(stride + 1)
        along = [rate[stride * row + up * k, stride * column + right * k] for k in parts]
        cost = (math.hypot(up, right) * np.trapezoid(along, axis=0)).ravel()
        here = (row * columns + column).ravel()
        found.append(np.stack([here, here + up * columns + right, cost])[:, np.isfinite(cost)])
    *ends, cost = np.concatenate(found, axis=1)
    return csr_array((cost, np.array(ends, dtype=np.intp)), shape=2 * (rows * columns,))


def cheapest(graph: csr_array, start: int, end: int) -> list[int]:
    """Nodes of the cheapest way over an undirected graph, as A* finds it; empty: there is none."""
    _, (before,) = dijkstra(graph, directed=False, indices=[start], return_predecessors=True)
    way = [end]
    while before[way[-1]] >= 0:
        way.append(int(before[way[-1]]))
    return way[::-1] if way[-1] == start else []


# --- the ant colony

_ANTS, _GENERATIONS, _EVAPORATES = 40, 60, 0.1
_GREED = 4.0  # how strongly what lies in the target's direction draws, beside the pheromone
_LEAST = 0.01  # of the most pheromone


def ants(problem: RouteProblem, rng: np.random.Generator) -> FloatArray | None:
    """The cheapest walk that a colony has found.

    Ants walk from node to node, drawn by pheromone and, as what an ant may know, by the cost of a
    step and how much nearer it brings the target.
    """
    graph, places_m, start, target = _grid(problem, problem.rate, _ANTS_STRIDE)
    graph = graph.maximum(graph.T).tocsr()  # a step is an index of its data
    here, there = np.repeat(np.arange(len(places_m)), np.diff(graph.indptr)), graph.indices
    left_m = np.linalg.norm(places_m - places_m[target], axis=-1)
    length_m = np.linalg.norm(places_m[here] - places_m[there], axis=-1)
    draw = np.exp(-_GREED * (graph.data + left_m[there] - left_m[here]) / length_m)
    pheromone, least, best = np.ones(graph.nnz), math.inf, here[:0]
    for _ in range(_GENERATIONS):
        weights = pheromone * draw
        total = np.append(0.0, np.cumsum(weights / np.bincount(here, weights)[here]))
        low, high = total[graph.indptr[:-1]], total[graph.indptr[1:]]
        at, walks = np.full(_ANTS, start), list[IntArray]()
        for _ in range(8 * math.isqrt(len(places_m))):  # four times from edge to edge, and back
            drawn = low[at] + rng.random(_ANTS) * (high - low)[at]
            step = np.searchsorted(total, drawn, side="right") - 1
            step[(at == target) | (high == low)[at]] = -1  # it is there, or stuck
            if (step < 0).all():
                break
            at = np.where(step < 0, at, there[step])
            walks.append(step)
        steps = np.stack(walks, axis=1) if walks else np.empty((_ANTS, 0), dtype=np.intp)
        costs = np.where(steps < 0, 0.0, graph.data[steps]).sum(axis=1)
        costs[at != target] = math.inf
        if costs.min() < least:
            least, walk = costs.min(), steps[np.argmin(costs)]
            best = walk[walk >= 0]
        pheromone *= 1.0 - _EVAPORATES
        pheromone[best] += _EVAPORATES
        pheromone = np.clip(pheromone, _LEAST, 1.0)
    return places_m[[start, *there[best]]] if least < math.inf else None


# --- RRT* of OMPL


def rrt_star(problem: RouteProblem, rng: np.random.Generator) -> FloatArray | None:
    """The best route of OMPL's RRT*, with its own defaults, in the plane and by our objective.

    OMPL's own generator is seeded before each plan, so a plan is a function of problem and seed.
    """
    extras.need("compare", "planner", "rrt-star")
    from ompl import base, geometric, util  # an extra, and slow to import

    corner, drawn = problem.corner_ne_m, count()

    @cache
    def known(*ends: float) -> float:
        return problem.line_cost(corner + ends[:2], corner + ends[2:])

    def cost(a: Any, b: Any) -> float:
        return known(a[0], a[1], b[0], b[1])

    class Validator(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, a: Any, b: Any, _last: Any = None) -> bool:
            return cost(a, b) < np.inf

    class Objective(base.PathLengthOptimizationObjective):  # type: ignore[misc]
        def motionCost(self, a: Any, b: Any) -> Any:
            return base.Cost(cost(a, b))

    util.noOutputHandler()
    util.RNG.setSeed(int(rng.integers(1, 2**31)))
    space = base.RealVectorStateSpace(2)
    space.setBounds(0.0, problem.spacing_m * max(problem.rate.shape))
    setup = geometric.SimpleSetup(space)
    information = setup.getSpaceInformation()
    validator, objective = Validator(information), Objective(information)  # OMPL does not keep them
    information.setMotionValidator(validator)
    setup.setStateValidityChecker(lambda state: cost(state, state) < np.inf)
    setup.setOptimizationObjective(objective)
    start, target = space.allocState(), space.allocState()
    start[0], start[1] = (problem.start_ne_m - corner).tolist()
    target[0], target[1] = (problem.target_ne_m - corner).tolist()
    setup.setStartAndGoalStates(start, target)
    setup.setPlanner(geometric.RRTstar(information))
    setup.solve(base.PlannerTerminationCondition(lambda: next(drawn) >= problem.evaluations))
    if not setup.haveExactSolutionPath():
        return None
    return corner + [(state[0], state[1]) for state in setup.getSolutionPath().getStates()]


# --- all of them


def _is_asked(planner: RoutePlanner) -> None:
    """TypeError: it does not take a problem and a random generator."""
    inspect.signature(planner).bind(None, None)


PLANNERS = Parts[RoutePlanner](
    "companion.planners",
    {"a-star": a_star, "voronoi": voronoi, "ants": ants, "rrt-star": rrt_star},
    what="planner",
    check=_is_asked,
)
"""Every planner of whole routes by its name; other distributions add theirs."""
