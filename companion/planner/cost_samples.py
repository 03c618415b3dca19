"""The costs of a grid's samples: plain Python that numba compiles as it is (`companion.jit`).

What they are made of, and why, is said in `cost_grid`.
"""

import math
from typing import NamedTuple

import numpy as np

from companion.geodesy import BoolArray, FloatArray
from companion.planner.cheapest_ways import Box, Grid, touched

BLOCKED = 300.0
"""Cost per metre where nothing may fly: a detour of 300 times as much is shorter on any map."""
_GUESSED_BLOCKED = 30.0  # where that is only guessed: if all is blocked, it is looked at first


class Scale(NamedTuple):
    """What costs depend on beside the map."""

    every: int
    """Cells between samples."""
    floor_m: float
    ceiling_m: float
    """Of the band, AMSL."""
    highest_m: float
    """Ground that asks for more blocks the way."""
    per_height: float
    """Cost per metre of way at the ceiling."""
    per_radar: float
    """The same for detection for sure."""
    radars: FloatArray
    """(N, 4): north, east, altitude, range."""
    rises_m: FloatArray
    """By how much over a cell the clearance is kept, by how many cells are between, north and east.

    -inf beyond the clearance."""


class Ground(NamedTuple):
    """What samples know of the map, (2 rows - 1, 2 columns - 1)."""

    seen_m: FloatArray
    """The lowest altitude that keeps the clearance from what was seen or told, AMSL, or -inf."""
    guess_m: FloatArray
    """The same from what is guessed beside it, not below the floor."""
    shut: BoolArray
    """Zones or the edge of the map forbid to be here."""
    costly: BoolArray
    """Blocked, or seen by a radar."""
    beside: FloatArray
    """What a metre costs more, if it was not seen, for what stands near it."""
    extra: FloatArray
    """What of that is in the costs."""


def raise_to(
    seen_m: FloatArray, box: Box, tops_m: FloatArray, first: tuple[int, int], scale: Scale
) -> None:
    """Compute what the samples of a box ask for, by the cells about them.

    tops_m: (N, M), of these cells from row and column `first` on: all within the clearance.
    """
    reach, every, least_m = len(scale.rises_m), scale.every, scale.floor_m - scale.rises_m[0, 0]
    seen_m[box[0] : box[1], box[2] : box[3]] = -math.inf
    for r in range(tops_m.shape[0]):
        row = first[0] + r
        south = max(-((reach - 1 - row) // every), box[0])
        north = min((row + reach) // every + 1, box[1])
        for c in range(tops_m.shape[1]):
            if tops_m[r, c] > least_m:  # else it asks for no more than the floor
                column = first[1] + c
                west = max(-((reach - 1 - column) // every), box[2])
                east = min((column + reach) // every + 1, box[3])
                for i in range(south, north):
                    gap = max(i * every - row - 1, row - i * every)
                    for j in range(west, east):
                        aside = max(j * every - column - 1, column - j * every)
                        asked_m = tops_m[r, c] + scale.rises_m[gap, aside]
                        seen_m[i, j] = max(seen_m[i, j], asked_m)


def go_on(
    seen_m: FloatArray, highest_m: float, box: Box, far: float, more: float, beside: FloatArray
) -> Box:
    """Note which samples are less than `far` from one where the way is blocked.

    box: where samples have changed.  -> where that changes something.
    """
    if far == 0.0:
        return box
    (rows, columns), by = seen_m.shape, math.ceil(far)
    south, north = max(box[0] - by, 0), min(box[1] + by, rows)
    west, east = max(box[2] - by, 0), min(box[3] + by, columns)
    by -= 1
    beside[south:north, west:east] = 0.0
    for i in range(max(south - by, 0), min(north + by, rows)):
        for j in range(max(west - by, 0), min(east + by, columns)):
            if seen_m[i, j] > highest_m:
                for row in range(max(i - by, south), min(i + by + 1, north)):
                    half = math.ceil(math.sqrt(far * far - (row - i) ** 2)) - 1
                    beside[row, max(j - half, west) : min(j + half + 1, east)] = more
    return south, north, west, east


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


def _is_surveyed(surveyed: BoolArray, row: int, column: int) -> bool:
    """Whether the terrain of the four cells at a vertex is known."""
    rows, columns = surveyed.shape
    for i in (max(row - 1, 0), min(row, rows - 1)):
        for j in (max(column - 1, 0), min(column, columns - 1)):
            if not surveyed[i, j]:
                return False
    return True


def fill(
    grid: Grid,
    ground: Ground,
    box: Box,
    corner_ne_m: tuple[float, float],
    upper_m: FloatArray,
    surveyed: BoolArray,
    scale: Scale,
) -> BoolArray:
    """Compute the costs of the samples in a box.  -> the lattice points whose edges change.

    corner_ne_m: of the first sample.  Where it is flown at the floor, as before, nothing changes.
    Eq. 3 has half a step of margin: straight lines between samples outside of a radar's range stay
    out.
    """
    across, radars = 2 * grid.columns - 1, scale.radars
    band_m, margin_m = scale.ceiling_m - scale.floor_m, 0.5 * grid.step_m
    near = np.empty(len(radars), dtype=np.int64)
    changed = np.zeros((grid.rows, grid.columns), dtype=np.bool_)
    for i in range(box[0], box[1]):
        count, north_m = 0, corner_ne_m[0] + i * grid.step_m
        for k in range(len(radars)):
            if abs(north_m - radars[k, 0]) <= radars[k, 3] + margin_m:
                near[count] = k
                count += 1
        for j in range(box[2], box[3]):
            at, asked_m = i * across + j, max(ground.seen_m[i, j], ground.guess_m[i, j])
            extra = ground.beside[i, j]
            if extra > 0.0 and _is_surveyed(surveyed, i * scale.every, j * scale.every):
                extra = 0.0
            if asked_m <= scale.floor_m == grid.lowest_m[at] and extra == ground.extra[i, j]:
                continue
            low_m, bound_m, is_sure = ground.seen_m[i, j], scale.ceiling_m, True
            if asked_m > scale.floor_m:
                row, column = i * scale.every, j * scale.every
                is_sure = _is_surveyed(surveyed, row, column)
                if not is_sure:
                    guess_m, bound_m = ground.guess_m[i, j], _bound_m(upper_m, row, column, scale)
                    low_m = max(
                        low_m, guess_m if bound_m == scale.ceiling_m else min(guess_m, bound_m)
                    )
            altitude_m = min(max(low_m, scale.floor_m), scale.ceiling_m)
            flown_m = altitude_m if is_sure or low_m <= scale.floor_m else max(altitude_m, bound_m)
            seen, east_m = 0.0, corner_ne_m[1] + j * grid.step_m
            for k in near[:count]:
                north, east = north_m - radars[k, 0], east_m - radars[k, 1]
                up, reach_m = altitude_m - radars[k, 2], radars[k, 3] + margin_m
                squared = north * north + east * east + up * up
                if squared <= reach_m * reach_m:
                    ratio = squared / (radars[k, 3] * radars[k, 3])
                    seen += 1.0 / (1.0 + ratio * ratio)
            cost = 1.0 + scale.per_height * (flown_m - scale.floor_m) / band_m
            cost += scale.per_radar * seen + extra
            above = max(low_m - scale.highest_m, 0.0) / band_m
            is_blocked = above > 0.0 or ground.shut[i, j]
            if is_blocked:
                blocked = BLOCKED if is_sure or ground.shut[i, j] else _GUESSED_BLOCKED
                cost += blocked * (1.0 + above)
            grid.lowest_m[at], ground.costly[i, j] = altitude_m, is_blocked or seen > 0.0
            ground.extra[i, j] = extra
            if cost != grid.cost[at]:
                grid.cost[at], changed[i // 2, j // 2] = cost, True
    return touched(changed)
