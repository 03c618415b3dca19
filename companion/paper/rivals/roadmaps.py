"""A* over a grid, and over a roadmap of Voronoi edges between obstacles (as in paper 1)."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import Voronoi

from companion.geodesy import FloatArray
from companion.paper.rivals.routes import IntArray, RouteProblem

EIGHT = ((0, 1), (1, 0), (1, 1), (1, -1))  # and back
SIXTEEN = (*EIGHT, (1, 2), (2, 1), (2, -1), (1, -2))
_STRIDE = 4  # points of the lattice to a step of the grid: R / 40
_THREAT = 2.5  # what a metre costs where ground is taken for an obstacle: within a radar's range
_APART = 4  # points of the lattice between sites of the diagram, at least
_JOINED = 25  # corners of a roadmap that start and target are joined to
Edges = tuple[IntArray, IntArray, FloatArray]
"""Lines between places a and b, each once, and their costs.  (E,) x3."""
Search = Callable[[csr_array, FloatArray], list[int]]
"""Of a graph and its places, the last but one the start, the last the target: the way's nodes."""


def a_star(problem: RouteProblem, _rng: np.random.Generator) -> FloatArray | str:
    """The cheapest way over a grid, pulled straight."""
    return over_grid(problem, _STRIDE, _cheapest_to_last)


def voronoi(problem: RouteProblem, _rng: np.random.Generator) -> FloatArray | str:
    """The cheapest way over a roadmap as far as can be from obstacles, pulled straight.

    The diagram is that of the edges of what is closed or costs much, and of the map, thinned.
    """
    barred = np.pad(~(problem.rate < _THREAT), 1, constant_values=True)
    edges = np.argwhere(barred & ~binary_erosion(barred, border_value=1)) - 1
    _, first = np.unique(edges // _APART, axis=0, return_index=True)
    diagram = Voronoi(problem.place_m(edges[np.sort(first)]))
    corners = np.asarray(diagram.vertices)
    low, high = problem.place_m(np.array([(0, 0), problem.rate.shape]) - [[0], [1]])
    inside = np.append(np.all((corners >= low) & (corners <= high), axis=1), False)  # -1: far away
    lines = np.array(diagram.ridge_vertices)
    a, b = lines[inside[lines].all(axis=1)].T
    cost = np.array([problem.line_cost(*pair) for pair in zip(corners[a], corners[b], strict=True)])
    free = np.isfinite(cost)
    return over(problem, corners, (a[free], b[free], cost[free]), _cheapest_to_last)


def over_grid(problem: RouteProblem, stride: int, search: Search) -> FloatArray | str:
    """The way over a grid with 16 directions, whose nodes are every stride-th point of the rate."""
    costs = step_costs(problem.rate, stride, SIXTEEN) * problem.spacing_m
    nodes = np.indices(costs.shape[:2]).reshape(2, -1).T
    return over(problem, problem.place_m(stride * nodes), edges(costs, SIXTEEN), search)


def over(
    problem: RouteProblem, places_m: FloatArray, lines: Edges, search: Search
) -> FloatArray | str:
    """The way over lines between places (K, 2), pulled straight.

    Start and target are joined to the places next to them, and to each other, by free lines.
    """
    count, (a, b, cost) = len(places_m), lines
    every = np.concatenate([places_m, [problem.start_ne_m, problem.target_ne_m]])
    used, joined = np.unique(np.append(a, b)), [(count, count + 1)]
    for end in (count, count + 1):
        away_m = np.linalg.norm(places_m[used] - every[end], axis=-1)
        joined += [(end, k) for k in used[np.argsort(away_m, kind="stable")[:_JOINED]].tolist()]
    ends = np.array(joined, dtype=np.intp)
    costs = np.array([problem.line_cost(every[i], every[j]) for i, j in ends])
    ends, costs = ends[np.isfinite(costs)], costs[np.isfinite(costs)]
    between = np.append(a, ends[:, 0]), np.append(b, ends[:, 1])
    graph = csr_array((np.append(cost, costs), between), shape=(len(every), len(every)))
    way = search(graph, every)
    return problem.straight(every[way]) if way else "there is no way over its map"


def _cheapest_to_last(graph: csr_array, places_m: FloatArray) -> list[int]:
    return cheapest(graph, len(places_m) - 2, len(places_m) - 1)


def cheapest(graph: csr_array, start: int, end: int) -> list[int]:
    """Nodes of the cheapest way over an undirected graph, as A* finds it; empty: there is none."""
    _, (before,) = dijkstra(graph, directed=False, indices=[start], return_predecessors=True)
    way = [end]
    while before[way[-1]] >= 0:
        way.append(int(before[way[-1]]))
    return way[::-1] if way[-1] == start else []


def step_costs(rate: FloatArray, stride: int, ways: Sequence[tuple[int, int]]) -> FloatArray:
    """Costs of all steps of a grid whose nodes are every stride-th point of a rate, in its points.

    The mean rate along a step counts, at its ends and stride - 1 places between.
    -> (rows, columns, ways); infinite where a step leaves the grid.
    """
    rows, columns = ((size - 1) // stride + 1 for size in rate.shape)
    result = np.full((rows, columns, len(ways)), np.inf)
    for k, (i, j) in enumerate(ways):
        r, c = slice(max(0, -i), rows - max(0, i)), slice(max(0, -j), columns - max(0, j))
        row = stride * np.arange(r.start, r.stop)[:, None]
        column = stride * np.arange(c.start, c.stop)[None, :]
        along = [rate[row + i * step, column + j * step] for step in range(stride + 1)]
        result[r, c, k] = math.hypot(i, j) * np.trapezoid(along, axis=0)
    return result


def edges(costs: FloatArray, ways: Sequence[tuple[int, int]]) -> Edges:
    """A grid as a graph: of each step that is free the node before, the node after, the cost."""
    row, column, way = np.nonzero(np.isfinite(costs))
    before = row * costs.shape[1] + column
    return before, before + np.array(ways)[way] @ (costs.shape[1], 1), costs[row, column, way]
