"""A* on a grid, the route pulled straight (string pulling) where that costs no more."""

import heapq
import math
from collections.abc import Sequence

import numpy as np

from companion.campaign.rivals.problem import Field, FloatArray, IntArray, NoRoute, RouteProblem
from companion.planner.kernels import compiled_alone

EIGHT = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
SIXTEEN = (*EIGHT, *((i, j) for i in (-2, -1, 1, 2) for j in (-2, -1, 1, 2) if abs(i) != abs(j)))
_STRIDE = 4  # points of the field to a step of the grid
_NEAR = 2  # steps about the start from which the grid may be entered


def plan(problem: RouteProblem, rng: np.random.Generator) -> FloatArray | NoRoute:
    """The cheapest way over the grid with 16 directions, pulled straight."""
    del rng
    field, start, target = problem.field, problem.start_ne_m, problem.target_ne_m
    direct = np.array([start, target])
    near = math.dist(start, target) < 3.0 * _STRIDE * field.spacing_m
    if near and math.isfinite(field.line_cost(start, target)):
        return problem.route(direct)
    costs = step_costs(field.rate, _STRIDE, SIXTEEN)
    ways = np.array(SIXTEEN)
    nodes, first = entrances(field, start, costs.shape[:2], _STRIDE)
    end = nearest(field, target, costs.shape[:2], _STRIDE)
    if not len(nodes):
        return NoRoute(why="the start is shut in")
    cost, way = compiled_alone(a_star)(costs / _STRIDE, ways, nodes, first, end)
    if not math.isfinite(cost):
        return NoRoute(why="no way over the grid")
    route = np.concatenate([[start], field.place_m(_STRIDE * way)])
    route[-1] = target
    return problem.route(route)


def step_costs(rate: FloatArray, stride: int, ways: Sequence[tuple[int, int]]) -> FloatArray:
    """Costs of all steps of a grid whose nodes are every stride-th point of a rate.

    In spacings of the rate times `rate`'s unit; the mean rate along a step counts, at its ends
    and stride - 1 places between.  -> (rows, columns, ways); infinite where a step leaves the grid.
    """
    rows, columns = ((size - 1) // stride + 1 for size in rate.shape)
    result = np.full((rows, columns, len(ways)), np.inf)
    for k, (i, j) in enumerate(ways):
        r = slice(max(0, -i), rows - max(0, i))
        c = slice(max(0, -j), columns - max(0, j))
        row = stride * np.arange(r.start, r.stop)[:, None]
        column = stride * np.arange(c.start, c.stop)[None, :]
        mean = np.zeros((len(row), column.shape[1]))
        for step in range(stride + 1):
            weight = (0.5 if step in (0, stride) else 1.0) / stride
            mean += weight * rate[row + i * step, column + j * step]
        result[r, c, k] = mean * (stride * math.hypot(i, j))
    return result


def nearest(field: Field, at_ne_m: FloatArray, shape: tuple[int, ...], stride: int) -> IntArray:
    """The node of the grid nearest to a place; (2,)."""
    step = (at_ne_m - np.asarray(field.corner_ne_m)) / (stride * field.spacing_m)
    return np.clip(np.rint(step).astype(np.intp), 0, np.array(shape) - 1)


def entrances(
    field: Field, at_ne_m: FloatArray, shape: tuple[int, ...], stride: int
) -> tuple[IntArray, FloatArray]:
    """Nodes about a place that a free line leads to (K, 2), and what it costs, in grid steps."""
    middle = nearest(field, at_ne_m, shape, stride)
    nodes, costs = [], []
    for i in range(max(middle[0] - _NEAR, 0), min(middle[0] + _NEAR + 1, shape[0])):
        for j in range(max(middle[1] - _NEAR, 0), min(middle[1] + _NEAR + 1, shape[1])):
            cost = field.line_cost(at_ne_m, field.place_m(stride * np.array([i, j])))
            if math.isfinite(cost):
                nodes.append((i, j))
                costs.append(cost / (stride * field.spacing_m))
    return np.array(nodes, dtype=np.intp).reshape(-1, 2), np.array(costs)


def a_star(
    costs: FloatArray, ways: IntArray, starts: IntArray, first: FloatArray, end: IntArray
) -> tuple[float, IntArray]:
    """The cheapest way over a grid: its cost, and its nodes (K, 2); infinite and none: no way.

    costs: (rows, columns, ways) of the steps, none below its length; starts: (K, 2) where it may
    begin, at costs first, (K,).  Guided by the straight distance to the end.
    """
    rows, columns, count = costs.shape
    best, before = np.full((rows, columns), np.inf), np.full((rows, columns, 2), -1)
    done = np.zeros((rows, columns), dtype=np.bool_)
    end_row, end_column = int(end[0]), int(end[1])
    heap = [(0.0, 0, 0)]
    heap.pop()
    for k in range(len(starts)):
        row, column = int(starts[k, 0]), int(starts[k, 1])
        best[row, column] = first[k]
        left = math.hypot(row - end_row, column - end_column)
        heapq.heappush(heap, (float(first[k]) + left, row, column))
    while len(heap) > 0 and not done[end_row, end_column]:
        _, row, column = heapq.heappop(heap)
        if done[row, column]:
            continue
        done[row, column] = True
        for k in range(count):
            cost = best[row, column] + costs[row, column, k]
            if not cost < np.inf:
                continue
            i, j = row + int(ways[k, 0]), column + int(ways[k, 1])
            if cost < best[i, j]:
                best[i, j] = cost
                before[i, j, 0], before[i, j, 1] = row, column
                left = math.hypot(i - end_row, j - end_column)
                heapq.heappush(heap, (float(cost) + left, i, j))
    if not done[end_row, end_column]:
        return np.inf, np.empty((0, 2), dtype=np.int64)
    cells = [(end_row, end_column)]
    while before[cells[-1][0], cells[-1][1], 0] >= 0:
        row, column = cells[-1]
        cells.append((int(before[row, column, 0]), int(before[row, column, 1])))
    return best[end_row, end_column], np.array(cells)[::-1].copy()
