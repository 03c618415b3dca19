"""A* over a grid, and over a roadmap of Voronoi edges between obstacles (as in paper 1)."""

import heapq
import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.sparse import csr_array
from scipy.spatial import Voronoi

from companion.caches import compiled
from companion.geodesy import FloatArray
from companion.paper.rivals.routes import Field, IntArray, RouteProblem

EIGHT = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
SIXTEEN = (*EIGHT, *((i, j) for i in (-2, -1, 1, 2) for j in (-2, -1, 1, 2) if abs(i) != abs(j)))
_STRIDE = 4  # points of the field to a step of the grid: R / 40
_THREAT = 2.5  # what a metre costs where ground is taken for an obstacle: within a radar's range
_APART = 4  # points of the field between sites of the diagram, at least
_JOINED = 25  # corners of a roadmap that start and target are joined to


def a_star(problem: RouteProblem, rng: np.random.Generator) -> FloatArray | str:
    """The cheapest way over a grid with 16 directions, pulled straight."""
    del rng
    field = problem.field
    graph = grid(step_costs(field.rate, _STRIDE, SIXTEEN) * field.spacing_m, SIXTEEN)
    nodes = np.indices([(size - 1) // _STRIDE + 1 for size in field.rate.shape]).reshape(2, -1).T
    return over(problem, field.place_m(_STRIDE * nodes), *graph)


def voronoi(problem: RouteProblem, rng: np.random.Generator) -> FloatArray | str:
    """The cheapest way over a roadmap as far as can be from obstacles, pulled straight."""
    del rng
    field, far = problem.field, np.array(problem.field.rate.shape) - 1
    diagram = Voronoi(_sites(field))
    lines = np.array([pair for pair in diagram.ridge_vertices if min(pair) >= 0]).reshape(-1, 2)
    corners = np.asarray(diagram.vertices)
    low, high = field.place_m(0 * far), field.place_m(far)
    inside = np.all((corners >= low) & (corners <= high), axis=1)
    a, b = lines[inside[lines].all(axis=1)].T
    cost = np.array([field.line_cost(*pair) for pair in zip(corners[a], corners[b], strict=True)])
    both = np.tile(np.isfinite(cost), 2)
    a, b, cost = np.append(a, b)[both], np.append(b, a)[both], np.tile(cost, 2)[both]
    return over(problem, corners, a, b, cost)


def over(
    problem: RouteProblem, places_m: FloatArray, a: IntArray, b: IntArray, cost: FloatArray
) -> FloatArray | str:
    """The cheapest way over lines from places a to places b, pulled straight; (K, 2), (E,) x3.

    Start and target are joined to the places next to them, and to each other, by free lines.
    """
    start, target, field = len(places_m), len(places_m) + 1, problem.field
    every = np.concatenate([places_m, [problem.start_ne_m, problem.target_ne_m]])
    used = np.unique(np.append(a, b))
    joined = [(start, target)]
    for node in (start, target):
        away_m = np.linalg.norm(places_m[used] - every[node], axis=-1)
        near = used[np.argsort(away_m, kind="stable")[:_JOINED]]
        joined += [(start, k) if node == start else (k, target) for k in near.tolist()]
    ends = np.array(joined, dtype=np.intp)
    costs = np.array([field.line_cost(every[i], every[j]) for i, j in ends])
    free = np.isfinite(costs)
    a, b = np.append(a, ends[free, 0]), np.append(b, ends[free, 1])
    graph = csr_array((np.append(cost, costs[free]), (a, b)), shape=(len(every), len(every)))
    left_m = np.linalg.norm(every - problem.target_ne_m, axis=-1)
    found, way = compiled(search)(graph.indptr, graph.indices, graph.data, left_m, start, target)
    return problem.straight(every[way]) if math.isfinite(found) else "there is no way over its map"


def search(
    first: IntArray, there: IntArray, cost: FloatArray, left: FloatArray, start: int, end: int
) -> tuple[float, IntArray]:
    """A*: the cost of the cheapest way over a graph, and its nodes (K,); infinite: there is none.

    first (N + 1,), there (E,), cost (E,): the edges from each node, as of a CSR matrix; left (N,):
    of each node no more than what the rest of the way costs.
    """
    best, before = np.full(len(left), np.inf), np.full(len(left), -1)
    done = np.zeros(len(left), dtype=np.bool_)
    best[start] = 0.0
    heap = [(float(left[start]), start)]
    while len(heap) > 0 and not done[end]:
        _, here = heapq.heappop(heap)
        if done[here]:
            continue
        done[here] = True
        for k in range(first[here], first[here + 1]):
            node, paid = int(there[k]), float(best[here] + cost[k])
            if paid < best[node]:
                best[node], before[node] = paid, here
                heapq.heappush(heap, (paid + float(left[node]), node))
    if not done[end]:
        return np.inf, np.empty(0, dtype=np.int64)
    way = [end]
    while before[way[-1]] >= 0:
        way.append(int(before[way[-1]]))
    return float(best[end]), np.array(way)[::-1].copy()


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
        mean = 0.5 * (rate[row, column] + rate[row + stride * i, column + stride * j]) / stride
        for step in range(1, stride):
            mean += rate[row + i * step, column + j * step] / stride
        result[r, c, k] = mean * (stride * math.hypot(i, j))
    return result


def grid(
    costs: FloatArray, ways: Sequence[tuple[int, int]]
) -> tuple[IntArray, IntArray, FloatArray]:
    """A grid as a graph: of each step that is free the node before, the node after, the cost."""
    row, column, way = np.nonzero(np.isfinite(costs))
    before = row * costs.shape[1] + column
    return before, before + np.array(ways)[way] @ (costs.shape[1], 1), costs[row, column, way]


def _sites(field: Field) -> FloatArray:
    """Edges of what is closed or costs much, and the edge of the map, thinned.  -> (K, 2)."""
    barred = np.pad(~(field.rate < _THREAT), 1, constant_values=True)
    index = np.argwhere(barred & ~binary_erosion(barred, border_value=1)) - 1
    _, first = np.unique(index // _APART, axis=0, return_index=True)
    return field.place_m(index[np.sort(first)])
