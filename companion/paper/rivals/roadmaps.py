"""A* over a grid, and over a roadmap of Voronoi edges between obstacles (as in paper 1)."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import Voronoi

from companion.geodesy import FloatArray
from companion.paper.rivals.routes import IntArray, RouteProblem

EIGHT = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
SIXTEEN = (*EIGHT, *((i, j) for i in (-2, -1, 1, 2) for j in (-2, -1, 1, 2) if abs(i) != abs(j)))
_STRIDE = 4  # points of the lattice to a step of the grid: R / 40
_THREAT = 2.5  # what a metre costs where ground is taken for an obstacle: within a radar's range
_APART = 4  # points of the lattice between sites of the diagram, at least
_JOINED = 25  # corners of a roadmap that start and target are joined to


def a_star(problem: RouteProblem, _rng: np.random.Generator) -> FloatArray | str:
    """The cheapest way over a grid with 16 directions, pulled straight."""
    costs = step_costs(problem.rate, _STRIDE, SIXTEEN) * problem.spacing_m
    nodes = np.indices(costs.shape[:2]).reshape(2, -1).T
    return over(problem, problem.place_m(_STRIDE * nodes), *grid(costs, SIXTEEN))


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
    return over(problem, corners, a[free], b[free], cost[free])


def over(
    problem: RouteProblem, places_m: FloatArray, a: IntArray, b: IntArray, cost: FloatArray
) -> FloatArray | str:
    """The cheapest way over lines between places a and b, pulled straight; (K, 2), (E,) x3.

    Start and target are joined to the places next to them, and to each other, by free lines.
    """
    start, target = len(places_m), len(places_m) + 1
    every = np.concatenate([places_m, [problem.start_ne_m, problem.target_ne_m]])
    used = np.unique(np.append(a, b))
    joined = [(start, target)]
    for node in (start, target):
        away_m = np.linalg.norm(places_m[used] - every[node], axis=-1)
        joined += [(node, k) for k in used[np.argsort(away_m, kind="stable")[:_JOINED]].tolist()]
    ends = np.array(joined, dtype=np.intp)
    costs = np.array([problem.line_cost(every[i], every[j]) for i, j in ends])
    free = np.isfinite(costs)
    a, b = np.append(a, ends[free, 0]), np.append(b, ends[free, 1])
    graph = csr_array((np.append(cost, costs[free]), (a, b)), shape=(len(every), len(every)))
    way = cheapest(graph, start, target)
    return problem.straight(every[way]) if way else "there is no way over its map"


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


def grid(
    costs: FloatArray, ways: Sequence[tuple[int, int]]
) -> tuple[IntArray, IntArray, FloatArray]:
    """A grid as a graph: of each step that is free the node before, the node after, the cost."""
    row, column, way = np.nonzero(np.isfinite(costs))
    before = row * costs.shape[1] + column
    return before, before + np.array(ways)[way] @ (costs.shape[1], 1), costs[row, column, way]
