"""The cheapest ways over graphs, pulled straight: the paper's introduction names them.

A* over a grid, and over a roadmap of Voronoi edges between obstacles; an ant colony (a max-min ant
system) on a grid, whose ants walk from node to node, drawn by pheromone and, as what an ant may
know, by the cost of a step and how much nearer it brings the target.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import Voronoi

from companion.geodesy import FloatArray
from companion.paper.rivals.routes import IntArray, RouteProblem

EIGHT = ((0, 1), (1, 0), (1, 1), (1, -1))  # and back
SIXTEEN = (*EIGHT, (1, 2), (2, 1), (2, -1), (1, -2))
_STRIDE, _ANTS_STRIDE = 4, 10  # points of the lattice to a step of the grid: R / 40, R / 16
_THREAT = 2.5  # what a metre costs where ground is taken for an obstacle: within a radar's range
_APART = 4  # points of the lattice between sites of the diagram, at least
_JOINED = 25  # corners of a roadmap that start and target are joined to
_ANTS, _GENERATIONS, _EVAPORATES = 40, 60, 0.1
_GREED = 4.0  # how strongly what lies in the target's direction draws, beside the pheromone
_LEAST = 0.01  # of the most pheromone
Edges = tuple[IntArray, IntArray, FloatArray]
"""Lines between places a and b, each once, and their costs.  (E,) x3."""
Search = Callable[[csr_array, FloatArray], list[int]]
"""Of a graph and its places, the last but one the start, the last the target: the way's nodes."""


def a_star(problem: RouteProblem, _rng: np.random.Generator) -> FloatArray | str:
    """The cheapest way over a grid."""
    return _over_grid(problem, _STRIDE, _cheapest_to_last)


def ants(problem: RouteProblem, rng: np.random.Generator) -> FloatArray | str:
    """The best way over a coarser grid that the colony has found."""
    return _over_grid(problem, _ANTS_STRIDE, partial(_best_walk, rng=rng))


def voronoi(problem: RouteProblem, _rng: np.random.Generator) -> FloatArray | str:
    """The cheapest way over a roadmap as far as can be from obstacles.

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
    lines = lines[inside[lines].all(axis=1)]
    return _over(problem, corners, _free(problem, corners, lines), _cheapest_to_last)


def _over_grid(problem: RouteProblem, stride: int, search: Search) -> FloatArray | str:
    """The way over a grid with 16 directions, whose nodes are every stride-th point of the rate."""
    a, b, cost = grid_edges(problem.rate, stride, SIXTEEN)
    nodes = np.indices(problem.rate[::stride, ::stride].shape).reshape(2, -1).T
    lines = a, b, cost * problem.spacing_m
    return _over(problem, problem.place_m(stride * nodes), lines, search)


def grid_edges(rate: FloatArray, stride: int, ways: Sequence[tuple[int, int]]) -> Edges:
    """The free steps of a grid whose nodes are every stride-th point of a rate, by rows.

    Costs are in points of the rate; its mean along a step counts, at both ends and stride - 1
    places between.
    """
    rows, columns = rate[::stride, ::stride].shape
    found = []
    for up, right in ways:
        row, column = np.ogrid[: rows - up, max(0, -right) : columns - max(0, right)]
        along = [
            rate[stride * row + up * k, stride * column + right * k] for k in range(stride + 1)
        ]
        cost = (math.hypot(up, right) * np.trapezoid(along, axis=0)).ravel()
        here = (row * columns + column).ravel()
        found.append(np.stack([here, here + up * columns + right, cost])[:, np.isfinite(cost)])
    a, b, cost = np.concatenate(found, axis=1)
    return a.astype(np.intp), b.astype(np.intp), cost


def _free(problem: RouteProblem, places_m: FloatArray, lines: IntArray) -> Edges:
    """Straight lines between places (K, 2), as far as they are free.  lines: (E, 2)."""
    costs = np.array([problem.line_cost(*places_m[pair]) for pair in lines])
    a, b = lines[np.isfinite(costs)].T
    return a, b, costs[np.isfinite(costs)]


def _over(
    problem: RouteProblem, places_m: FloatArray, lines: Edges, search: Search
) -> FloatArray | str:
    """The way over lines between places (K, 2), pulled straight.

    Start and target are joined to the places next to them, and to each other, by free lines.
    """
    start, target = len(places_m), len(places_m) + 1
    every = np.concatenate([places_m, [problem.start_ne_m, problem.target_ne_m]])
    used, joined = np.unique(lines[:2]), [(start, target)]
    for end in (start, target):
        away_m = np.linalg.norm(places_m[used] - every[end], axis=-1)
        joined += [(end, k) for k in used[np.argsort(away_m, kind="stable")[:_JOINED]].tolist()]
    ends = _free(problem, every, np.array(joined, dtype=np.intp))
    a, b, cost = (np.append(*both) for both in zip(lines, ends, strict=True))
    way = search(csr_array((cost, (a, b)), shape=(len(every), len(every))), every)
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


def _best_walk(graph: csr_array, places_m: FloatArray, rng: np.random.Generator) -> list[int]:
    """The cheapest walk of a colony from the last place but one to the last; none: []."""
    graph = graph.maximum(graph.T).tocsr()  # a step is an index of its data
    here, there = np.repeat(np.arange(len(places_m)), np.diff(graph.indptr)), graph.indices
    left_m = np.linalg.norm(places_m - places_m[-1], axis=-1)
    length_m = np.linalg.norm(places_m[here] - places_m[there], axis=-1)
    draw = np.exp(-_GREED * (graph.data + left_m[there] - left_m[here]) / length_m)
    pheromone, least, best = np.ones(graph.nnz), math.inf, list[int]()
    for _ in range(_GENERATIONS):
        weights = pheromone * draw
        weights /= np.bincount(here, weights)[here]
        for steps in _walks(graph, np.append(0.0, np.cumsum(weights)), rng):
            last = dict(zip(here[steps].tolist(), steps.tolist(), strict=True))
            walk, place = list[int](), len(places_m) - 2
            while place in last:  # the last step from each place that it was in: without loops
                walk.append(last[place])
                place = int(there[walk[-1]])
            if (cost := graph.data[walk].sum()) < least:
                least, best = cost, walk
        pheromone *= 1.0 - _EVAPORATES
        pheromone[best] += _EVAPORATES
        pheromone = np.clip(pheromone, _LEAST, 1.0)
    return [*here[best].tolist(), len(places_m) - 1] if best else []


def _walks(graph: csr_array, total: FloatArray, rng: np.random.Generator) -> list[IntArray]:
    """The walks of a generation that came to the last place, as steps.

    total: of the probabilities of all steps before each, (steps + 1,); those from a place sum to 1.
    """
    end = len(graph.indptr) - 2
    at, walks = np.full(_ANTS, end - 1), list[IntArray]()
    for _ in range(8 * math.isqrt(end)):  # four times from edge to edge of the grid, and back
        low, high = total[graph.indptr[at]], total[graph.indptr[at + 1]]
        going = (at != end) & (high > low)  # else it is there, or stuck
        if not going.any():
            break
        drawn = low + rng.random(_ANTS) * (high - low)
        step = np.where(going, np.searchsorted(total, drawn, side="right") - 1, -1)
        at = np.where(going, graph.indices[step], at)
        walks.append(step)
    came = np.stack(walks, axis=1)[at == end] if walks else []
    return [walk[walk >= 0] for walk in came]
