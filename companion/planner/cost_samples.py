"""The costs of a grid's samples: plain Python that numba compiles as it is (`kernels`).

What they are made of, and why, is said in `cost_grid`.
"""

import math
from typing import NamedTuple

import numpy as np

from companion.geodesy import BoolArray, FloatArray
from companion.planner.cheapest_ways import Grid, IndexArray, touch

BLOCKED = 300.0
"""Cost per metre where nothing may fly: a detour of 300 times as much is shorter on any map."""
_GUESSED_BLOCKED = 30.0  # where that is only guessed: if all is blocked, it is looked at first
_BARRING = 1e4  # cost per metre where an edge is not to be used: far above BLOCKED


class Scale(NamedTuple):
    """What costs depend on beside the map."""

    floor_m: float
    ceiling_m: float
    """Of the band, AMSL."""
    highest_m: float
    """Ground that asks for more blocks the way."""
    per_height: float
    """Cost per metre of way at the ceiling."""
    per_radar: float
    """The same for detection for sure."""
    per_ramp_m: float
    """Cost of the height of a climb from the floor to the ceiling."""
    radars: FloatArray
    """(N, 4): north, east, altitude, range."""
    rises_m: FloatArray
    """By how much over a cell the clearance is kept, by how many cells are between, north and east.

    -inf beyond the clearance."""


def raise_to(
    lowest_m: FloatArray,
    tops_m: FloatArray,
    cells: tuple[IndexArray, IndexArray],
    first: tuple[int, int],
    every: int,
    rises_m: FloatArray,
    least_m: float,
) -> None:
    """Raise the altitudes of samples to what keeps the clearance from cells.

    Samples are at vertices of the cells, `every` of them from row and column `first`.
    tops_m: (N, M), of the cells of these rows and columns; none above least_m asks for more.
    """
    reach, (rows, columns) = len(rises_m), cells
    for r in range(len(rows)):
        row = rows[r] - first[0]
        south = max(-((reach - 1 - row) // every), 0)
        north = min((row + reach) // every, lowest_m.shape[0] - 1)
        for c in range(len(columns)):
            if tops_m[r, c] > least_m:
                column = columns[c] - first[1]
                west = max(-((reach - 1 - column) // every), 0)
                east = min((column + reach) // every, lowest_m.shape[1] - 1)
                for i in range(south, north + 1):
                    gap = max(i * every - row - 1, row - i * every)
                    for j in range(west, east + 1):
                        aside = max(j * every - column - 1, column - j * every)
                        lowest_m[i, j] = max(lowest_m[i, j], tops_m[r, c] + rises_m[gap, aside])


def _bound_m(upper_m: FloatArray, row: int, column: int, scale: Scale) -> float:
    """What keeps the clearance from the bounds of all cells about a vertex, up to the ceiling."""
    reach, result = len(scale.rises_m), -math.inf
    for i in range(max(row - reach, 0), min(row + reach, upper_m.shape[0])):
        gap = max(row - i - 1, i - row)
        for j in range(max(column - reach, 0), min(column + reach, upper_m.shape[1])):
            aside = max(column - j - 1, j - column)
            result = max(result, upper_m[i, j] + scale.rises_m[gap, aside])
            if result >= scale.ceiling_m:
                return scale.ceiling_m
    return result


def _is_firm(firm: BoolArray, row: int, column: int) -> bool:
    """Whether the terrain of the four cells at a vertex is known."""
    rows, columns = firm.shape
    for i in (max(row - 1, 0), min(row, rows - 1)):
        for j in (max(column - 1, 0), min(column, columns - 1)):
            if not firm[i, j]:
                return False
    return True


def fill(
    grid: Grid,
    box: tuple[int, int, int, int],
    lowest_m: FloatArray,
    vertices: tuple[IndexArray, IndexArray],
    upper_m: FloatArray,
    firm: BoolArray,
    places_m: tuple[FloatArray, FloatArray],
    shut: BoolArray,
    costly: BoolArray,
    scale: Scale,
    touched: BoolArray,
) -> None:
    """Compute the costs of samples, and mark the lattice points with an edge over a changed one.

    box: rows and columns from and to; lowest_m: in it.  vertices, places_m: of all samples, in the
    map and north and east.  Eq. 3 has half a step of margin: straight lines between samples outside
    of a radar's range stay out.
    """
    across, radars = 2 * grid.columns - 1, scale.radars
    band_m, margin_m = scale.ceiling_m - scale.floor_m, 0.5 * grid.step_m
    near = np.empty(len(radars), dtype=np.int64)
    for i in range(box[0], box[1]):
        count = 0
        for k in range(len(radars)):
            if abs(places_m[0][i] - radars[k, 0]) <= radars[k, 3] + margin_m:
                near[count] = k
                count += 1
        for j in range(box[2], box[3]):
            low_m = lowest_m[i - box[0], j - box[2]]
            row, column = vertices[0][i], vertices[1][j]
            altitude_m = min(max(low_m, scale.floor_m), scale.ceiling_m)
            flown_m, is_sure = altitude_m, True
            if low_m > scale.floor_m:
                is_sure = _is_firm(firm, row, column)
                if not is_sure:
                    flown_m = max(altitude_m, _bound_m(upper_m, row, column, scale))
            seen = 0.0
            for k in near[:count]:
                north, east = places_m[0][i] - radars[k, 0], places_m[1][j] - radars[k, 1]
                up, reach_m = altitude_m - radars[k, 2], radars[k, 3] + margin_m
                squared = north * north + east * east + up * up
                if squared <= reach_m * reach_m:
                    ratio = squared / (radars[k, 3] * radars[k, 3])
                    seen += 1.0 / (1.0 + ratio * ratio)
            fraction = (altitude_m - scale.floor_m) / band_m
            cost = 1.0 + scale.per_height * (flown_m - scale.floor_m) / band_m
            cost += scale.per_radar * seen
            above = max(low_m - scale.highest_m, 0.0) / band_m
            is_blocked = above > 0.0 or shut[i, j]
            if is_blocked:
                blocked = BLOCKED if is_sure or shut[i, j] else _GUESSED_BLOCKED
                cost += blocked * (1.0 + above)
            at, height, ramp_m = i * across + j, scale.per_height * fraction, fraction * fraction
            ramp_m *= scale.per_ramp_m
            if cost != grid.cost[at] or height != grid.height[at] or ramp_m != grid.ramp_m[at]:
                touch(i, j, touched)
            grid.cost[at], grid.height[at], grid.ramp_m[at] = cost, height, ramp_m
            grid.lowest_m[at], costly[i, j] = altitude_m, is_blocked or seen > 0.0
    for i in range(max(box[0] - 1, 0), min(box[1] + 1, 2 * grid.rows - 1)):
        for j in range(max(box[2] - 1, 0), min(box[3] + 1, across)):
            at = i * across + j
            barring = grid.cost[at] + (_BARRING if _is_steep(grid, i, j) else 0.0)
            if barring != grid.barring[at]:
                touch(i, j, touched)
            grid.barring[at] = barring


def _is_steep(grid: Grid, i: int, j: int) -> bool:
    """Whether beside a sample the height for a ramp costs more than the height of the ground."""
    across = 2 * grid.columns - 1
    at = i * across + j
    for by, is_there in (
        (-across, i > 0),
        (across, i < 2 * grid.rows - 2),
        (-1, j > 0),
        (1, j < across - 1),
    ):
        if is_there:
            level_m = 0.5 * grid.step_m * (grid.height[at] + grid.height[at + by])
            if abs(grid.ramp_m[at] - grid.ramp_m[at + by]) > level_m:
                return True
    return False


ENTRIES = (raise_to, fill)
"""What is called from elsewhere."""
