"""Cheapest ways over a grid of costs, repaired where costs have changed.

Plain Python that numba compiles as it is (`companion.jit`).

Lattice points are every second sample of the costs, and edges lead from each to 48 others: a way
is at most 0.75 % too long in any direction, 0.25 % in the mean.  `repair` is LPA* (Koenig,
Likhachev and Furcy 2004; Ramalingam and Reps 1996): it looks at points only whose cost may have
changed, those first over which the cheapest ways from a window may lead.  What it leaves is the
only solution of cost = min(seed, min(cost of a neighbour + edge)), to the last digit, whatever was
there before: edges cost the same from both of their ends, and of ways that cost the same the first
direction is taken.
"""

import heapq
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.geodesy import BoolArray, FloatArray

IndexArray = NDArray[np.int64]
Box = tuple[int, int, int, int]
"""First row, the row behind the last; first column, the column behind the last."""

_FARTHEST = 4  # lattice points north or east that an edge leads at most
_ROUNDED = 1.0 - 1e-9  # a mean of costs, 1 or more, may be lower than that by so much
_ROUNDED_UP = 1.0 + 1e-9  # and a line along a way may cost more than its parts by so much
_LOOKS = 32  # between two looks how far it has come: each takes as long as one of them
_PARTS = 8  # of an edge, at whose ends its ground is looked at: one for each sample of the longest


def _directions() -> IndexArray:
    """Rows and columns to the 48 neighbours: 24, then their opposites.  (48, 2)."""
    half = [
        (north, east)
        for north in range(_FARTHEST + 1)
        for east in range(-_FARTHEST, _FARTHEST + 1)
        if math.gcd(north, east) == 1 and (north > 0 or east > 0)
    ]
    return np.array(half + [(-north, -east) for north, east in half], dtype=np.int64)


DIRECTIONS = _directions()
_LENGTHS = np.hypot(DIRECTIONS[:, 0], DIRECTIONS[:, 1])  # in cells of the lattice
_HALF = len(DIRECTIONS) // 2  # the others are these, back


_PIECES = 2 * np.abs(DIRECTIONS[:_HALF]).max(axis=1)
"""Of edges of 24 directions, between the rows or columns of samples that they cross: twice as many
as the longer side has points of the lattice."""


def _on_edges() -> tuple[IndexArray, IndexArray, FloatArray]:
    """Where the edges of 24 directions cross rows or columns, from their beginnings on.

    -> for each the rows and columns of the two samples beside it, (24, 9, 2) x2, and the share of
    the second, (24, 9).  Beyond an edge's end they mean nothing.
    """
    pieces, crossing = _PIECES[:, None, None], np.arange(2 * _FARTHEST + 1)[:, None]
    first, rest = np.divmod(2 * DIRECTIONS[:_HALF, None] * crossing, pieces)
    return first, first + (rest > 0), rest.sum(axis=-1) / pieces[..., 0]  # one rest of two is 0


_FIRST, _SECOND, _SHARES = _on_edges()


class Grid(NamedTuple):
    """Costs at the lattice points and halfway between them: (2 rows - 1) (2 columns - 1) samples.

    Each row of samples after the one before it.
    """

    rows: int
    columns: int
    """Of lattice points."""
    step_m: float
    """Between samples."""
    cost: FloatArray
    """Per metre of way."""
    lowest_m: FloatArray
    """The altitude that the terrain asks for, within the limits, AMSL."""
    beside: IndexArray
    """From a lattice point to the samples beside its edges, (24, 9, 2)."""
    jump: IndexArray
    """From a lattice point to its 48 neighbours."""

    @staticmethod
    def empty(rows: int, columns: int, step_m: float) -> "Grid":
        """Of so many lattice points, whose costs are not known yet."""
        across = 2 * columns - 1
        count = (2 * rows - 1) * across
        return Grid(
            rows=rows,
            columns=columns,
            step_m=step_m,
            cost=np.zeros(count),
            lowest_m=np.full(count, -np.inf),
            beside=np.stack([steps @ (across, 1) for steps in (_FIRST, _SECOND)], axis=-1),
            jump=DIRECTIONS[:, 0] * columns + DIRECTIONS[:, 1],
        )


class Costs(NamedTuple):
    """Of every lattice point, (rows * columns,)."""

    seed: FloatArray
    """Cost of the way on from points where it is known; infinite elsewhere."""
    cost: FloatArray
    ahead: FloatArray
    """By the costs of the neighbours: once all is repaired, the same."""
    via: IndexArray
    """The direction that `ahead` comes from, the first of equals; -1: the seed."""

    @staticmethod
    def unknown(seed: FloatArray) -> "Costs":
        """Of points about which nothing is known but the seeds."""
        count = len(seed)
        return Costs(seed, np.full(count, np.inf), np.full(count, np.inf), np.full(count, -1))


def edge_m(grid: Grid, row: int, column: int, k: int) -> float:
    """Cost of the edge in direction k, to a point of the lattice.

    By the trapezoidal rule, one point for each row or column of samples, linear between two.
    """
    if k >= _HALF:  # computed from the same end in both directions
        row += DIRECTIONS[k, 0]
        column += DIRECTIONS[k, 1]
        k -= _HALF
    pieces, at = _PIECES[k], 2 * row * (2 * grid.columns - 1) + 2 * column
    cost, total = grid.cost, 0.0
    for p in range(pieces + 1):
        one, other = cost[at + grid.beside[k, p, 0]], cost[at + grid.beside[k, p, 1]]
        total += one + _SHARES[k, p] * (other - one)
    total -= 0.5 * (cost[at] + cost[at + grid.beside[k, pieces, 0]])
    return float(2.0 * grid.step_m * _LENGTHS[k] / pieces * total)


def repair(
    grid: Grid,
    costs: Costs,
    dirty: BoolArray,
    starts: IndexArray,
    beyond_m: float,
    window: Box,
) -> int:
    """Make costs right again as far as they matter.  How often a point was looked at.

    dirty: (rows, columns), the points one of whose edges has changed; to begin with, when all costs
    are infinite, those that have a seed.
    starts, beyond_m, window: costs matter in a window, and on the ways on from there, up to so much
    more than the least of some points.  Others are left as they are until they do; what is stored
    of those in the window is more than that.
    """
    rows, columns = grid.rows, grid.columns
    cost, ahead, via = costs.cost, costs.ahead, costs.via
    step_m = _ROUNDED * 2.0 * grid.step_m
    least_m = step_m * _LENGTHS
    heap, looked = [(math.inf, -1)], 0
    for row in range(rows):
        for column in range(columns):
            u = row * columns + column
            if dirty[row, column]:
                _again(u, grid, costs, least_m)
            if cost[u] != ahead[u]:  # now, or left before
                heapq.heappush(heap, (_key(u, costs, columns, window, step_m), u))
    while heap[0][1] >= 0:
        if looked % _LOOKS == 0 and heap[0][0] > ahead[starts].min() + beyond_m:
            break
        key, u = heapq.heappop(heap)
        if cost[u] == ahead[u] or key != _key(u, costs, columns, window, step_m):
            continue  # since it was put there, it was put there again
        looked += 1
        row, column = u // columns, u % columns
        is_within = _is_within(row, rows) and _is_within(column, columns)
        if cost[u] > ahead[u]:
            cost[u] = ahead[u]
            for k in range(len(DIRECTIONS)):
                if not (is_within or _leads_on(row, column, rows, columns, k)):
                    continue
                v = u + grid.jump[k]
                if ahead[v] < cost[u] + least_m[k]:
                    continue
                by_u, back = cost[u] + edge_m(grid, row, column, k), (k + _HALF) % len(DIRECTIONS)
                if by_u < ahead[v]:
                    ahead[v], via[v] = by_u, back
                    if by_u != cost[v]:
                        heapq.heappush(heap, (_key(v, costs, columns, window, step_m), v))
                elif by_u == ahead[v] and back < via[v]:
                    via[v] = back
        else:
            cost[u] = math.inf
            _again(u, grid, costs, least_m)
            if cost[u] != ahead[u]:
                heapq.heappush(heap, (_key(u, costs, columns, window, step_m), u))
            for k in range(len(DIRECTIONS)):
                if is_within or _leads_on(row, column, rows, columns, k):
                    v = u + grid.jump[k]
                    if via[v] == (k + _HALF) % len(DIRECTIONS):
                        if cost[v] == ahead[v]:  # it is looked at when its turn comes
                            ahead[v] = math.inf
                        else:
                            _again(v, grid, costs, least_m)
                        if cost[v] != ahead[v]:
                            heapq.heappush(heap, (_key(v, costs, columns, window, step_m), v))
    return looked


def _key(u: int, costs: Costs, columns: int, window: Box, step_m: float) -> float:
    """No way from the window over a point costs less."""
    row, column = u // columns, u % columns
    north = max(max(window[0] - row, row - window[1] + 1), 0)
    east = max(max(window[2] - column, column - window[3] + 1), 0)
    return min(costs.cost[u], costs.ahead[u]) + step_m * math.sqrt(north * north + east * east)


def _is_within(row: int, rows: int) -> bool:
    """Whether no edge from a row leads off the lattice."""
    return _FARTHEST <= row < rows - _FARTHEST


def _leads_on(row: int, column: int, rows: int, columns: int, k: int) -> bool:
    """Whether an edge ends on the lattice."""
    i, j = row + DIRECTIONS[k, 0], column + DIRECTIONS[k, 1]
    return 0 <= i < rows and 0 <= j < columns


def _again(u: int, grid: Grid, costs: Costs, least_m: FloatArray) -> None:
    """Look at a point again, by all of its neighbours."""
    rows, columns = grid.rows, grid.columns
    row, column = u // columns, u % columns
    is_within = _is_within(row, rows) and _is_within(column, columns)
    best, via, most = costs.seed[u], -1, math.inf
    if costs.via[u] >= 0:  # hardly ever is it more than by the direction that was best before
        before = costs.via[u]
        most = costs.cost[u + grid.jump[before]] + edge_m(grid, row, column, before)
    for k in range(len(DIRECTIONS)):
        if is_within or _leads_on(row, column, rows, columns, k):
            there = costs.cost[u + grid.jump[k]]
            if there + least_m[k] <= min(best, most):  # else the edge needs no look
                by_it = there + edge_m(grid, row, column, k)
                if by_it < best:
                    best, via = by_it, k
    costs.ahead[u], costs.via[u] = best, via


def touched(changed: BoolArray) -> BoolArray:
    """The lattice points that may have an edge over a changed sample.

    changed: the points whose own sample, or the next one to the north or east, has changed.
    (rows, columns) both.
    """
    (rows, columns), result = changed.shape, np.zeros_like(changed)
    for row in range(rows):
        until = 0  # the column up to which points beside this row are marked
        for column in range(columns):
            if changed[row, column]:
                begin = max(column - _FARTHEST, until)
                until = min(column + _FARTHEST + 2, columns)
                for i in range(max(row - _FARTHEST, 0), min(row + _FARTHEST + 2, rows)):
                    result[i, begin:until] = True
    return result


def way_from(grid: Grid, costs: Costs, u: int) -> IndexArray:
    """The points of the cheapest way from a point on."""
    way = [u]
    while costs.via[u] >= 0:
        u += grid.jump[costs.via[u]]
        way.append(u)
    return np.array(way)


def needed_m(
    grid: Grid,
    costs: Costs,
    window: Box,
    most_m: float,
    steepness: float,
    target: tuple[float, float, float],
) -> FloatArray:
    """The lowest altitude from which the cheapest way on can be climbed, of the points of a window.

    What the way asks for later, less what can be climbed until then.
    most_m: of points that cost more, what is asked for there.
    target: row and column among the samples and the altitude that the terrain asks for there.
    """
    columns, across = grid.columns, 2 * grid.columns - 1
    needed = np.full(len(costs.cost), -math.inf)
    stack = np.empty(len(costs.cost), dtype=np.int64)
    result = np.empty((window[1] - window[0], window[3] - window[2]))
    for row in range(window[0], window[1]):
        for column in range(window[2], window[3]):
            start = row * columns + column
            u, depth = start, 0
            while u >= 0 and needed[u] == -math.inf:
                stack[depth] = u
                depth += 1
                if costs.cost[u] > most_m:
                    break
                k = costs.via[u]
                u = u + grid.jump[k] if k >= 0 else -1
            while depth:
                depth -= 1
                v = stack[depth]
                i, j = 2 * (v // columns), 2 * (v % columns)
                needed[v] = grid.lowest_m[i * across + j]
                if u < 0:
                    away_m = grid.step_m * math.sqrt((i - target[0]) ** 2 + (j - target[1]) ** 2)
                    needed[v] = max(needed[v], target[2] - steepness * away_m)
                elif u != v:
                    north, east = 2 * (u // columns) - i, 2 * (u % columns) - j
                    climb_m = grid.step_m * steepness * math.sqrt(north * north + east * east)
                    for part in range(1, _PARTS + 1):
                        at_i = i + (part * north + _PARTS // 2) // _PARTS
                        at_j = j + (part * east + _PARTS // 2) // _PARTS
                        asked_m = grid.lowest_m[at_i * across + at_j] - part / _PARTS * climb_m
                        needed[v] = max(needed[v], asked_m)
                    needed[v] = max(needed[v], needed[u] - climb_m)
                u = v
            result[row - window[0], column - window[2]] = needed[start]
    return result


def lines_m(grid: Grid, begin: FloatArray, end: FloatArray) -> FloatArray:
    """Costs of straight lines from a place, (2,), to others, (K, 2) -> (K,).

    Rows and columns among the samples.  Places beside the grid count as the nearest on it.
    """
    result = np.empty(len(end))
    for k in range(len(end)):
        result[k] = _line_m(grid, begin, end[k], math.inf)
    return result


def _line_m(grid: Grid, begin: FloatArray, end: FloatArray, most_m: float) -> float:
    """Cost of a straight line; infinite if it is more than most_m."""
    rows, columns = 2 * grid.rows - 1, 2 * grid.columns - 1
    north, east = end[0] - begin[0], end[1] - begin[1]
    far = math.sqrt(north * north + east * east)
    pieces = min(max(math.ceil(far), 1), _MAX_PIECES)
    piece_m = far * grid.step_m / pieces
    total = before = 0.0
    for p in range(pieces + 1):
        u = min(max(begin[0] + p / pieces * north, 0.0), rows - 1.0)
        v = min(max(begin[1] + p / pieces * east, 0.0), columns - 1.0)
        i, j = min(int(u), rows - 2), min(int(v), columns - 2)
        u, v, at = u - i, v - j, i * columns + j
        rate = _between(grid.cost, at, columns, u, v)
        if p > 0:
            total += 0.5 * (before + rate) * piece_m
        if total + (pieces - p) * piece_m * _ROUNDED > most_m:  # the rest costs 1 per metre or more
            return math.inf
        before = rate
    return total


def straightened(grid: Grid, points: FloatArray, along_m: FloatArray) -> IndexArray:
    """Which points of a way are left if a straight line passes by others at no more cost.

    From each point the line goes as far as it can.  points: rows and columns among the samples,
    (K, 2); along_m: the cost of the way to each.
    """
    count, keep = len(points), [0]
    while keep[-1] < count - 1:
        last, to = keep[-1], count - 1
        while to > last + 1:
            most_m = (along_m[to] - along_m[last]) * _ROUNDED_UP
            if _line_m(grid, points[last], points[to], most_m) <= most_m:
                break
            to -= 1
        keep.append(to)
    return np.array(keep)


_MAX_PIECES = 1_600  # of a straight line: of a sample each on a grid of 800 across, and beyond it


def _between(samples: FloatArray, at: int, columns: int, u: float, v: float) -> float:
    """Bilinear, so far (0 to 1) to the north and east of a sample."""
    south = samples[at] + v * (samples[at + 1] - samples[at])
    at += columns
    north = samples[at] + v * (samples[at + 1] - samples[at])
    return float(south + u * (north - south))


def smooth_edges(value: FloatArray, costly: BoolArray, one_side: float) -> None:
    """Give costly points that border on free ones no more than the cost of these.

    Their mean, or their maximum where they differ by more than one_side: then they lie on two sides
    of something thin, and what costs less beyond a wall must not draw towards it.
    """
    for place, is_costly in np.ndenumerate(costly):
        if is_costly:
            south, west = max(place[0] - 1, 0), max(place[1] - 1, 0)
            about = slice(south, place[0] + 2), slice(west, place[1] + 2)
            beside = value[about].ravel()[~costly[about].ravel()]
            if len(beside) > 0:
                is_thin = beside.max() - beside.min() >= one_side
                most = beside.max() if is_thin else beside.mean()
                value[place] = min(value[place], most)
