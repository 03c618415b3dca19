"""What the vehicle's scans have shown of the terrain so far.

The map is a lattice of square cells over the mission's area, in the local frame.  Each cell
holds an upper bound of the terrain in it: the highest terrain where a scan saw the cell, the
sight line over what hides it where a scan could not see it, infinity where nothing is known
(design section 4).
"""

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy.ndimage

from companion.geodesy import BoolArray, FloatArray

NOT_SEEN = -math.inf  # the radar answered: sheltered, or out of range
NO_ANSWER = math.nan  # the radar did not answer


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """The answers of the terrain radar to one scan, on a window of the lattice."""

    row: int
    column: int
    """Lattice index of the window's south-west cell."""
    heights_m: FloatArray  # (rows, columns)
    """Highest terrain of each cell AMSL, NOT_SEEN or NO_ANSWER."""
    radar_nea_m: FloatArray  # (rows, columns, 3)
    """Where the radar was when it answered for each cell (it moves during a scan)."""
    range_m: float
    drift_m: float
    """How wrong `radar_nea_m` may be."""
    registration_m: float
    """How far an answered cell may lie from its lattice cell (true north is not grid north)."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class KnownMap:
    """Upper bound of the terrain, cell by cell."""

    cell_m: float
    north_min_m: float
    east_min_m: float
    upper_m: FloatArray  # (rows, columns), rows to the north, columns to the east
    seen: BoolArray  # (rows, columns), cells that a scan has seen: nothing more to learn
    registration_m: float = 0.0
    """How far the terrain of a cell may lie from it."""

    def cell_of(self, north_m: float, east_m: float) -> tuple[int, int]:
        """Row and column of the cell that holds a point (may lie outside the lattice)."""
        return (
            math.floor((north_m - self.north_min_m) / self.cell_m),
            math.floor((east_m - self.east_min_m) / self.cell_m),
        )

    def is_known(self, north_m: float, east_m: float) -> bool:
        """Whether the terrain under a point is bounded."""
        row, column = self.cell_of(north_m, east_m)
        rows, columns = self.upper_m.shape
        inside = 0 <= row < rows and 0 <= column < columns
        return inside and bool(np.isfinite(self.upper_m[row, column]))

    def with_scan(self, scan: Scan) -> "KnownMap":
        """The map after one more scan: nothing that was known is lost."""
        after = replace(
            self,
            upper_m=self.upper_m.copy(),
            seen=self.seen.copy(),
            registration_m=max(self.registration_m, scan.registration_m),
        )
        window = _window(scan)
        now_seen = np.isfinite(scan.heights_m)
        after.upper_m[window] = np.where(now_seen, scan.heights_m, after.upper_m[window])
        after.seen[window] |= now_seen
        upper = after.upper_m[window]
        bound = np.minimum(upper, _hidden_bound_m(after, scan))
        after.upper_m[window] = np.where(after.seen[window], upper, bound)
        return after

    def middles_m(
        self, row: int, column: int, shape: tuple[int, int]
    ) -> tuple[FloatArray, FloatArray]:
        """North (rows, 1) and east (1, columns) of the middles of a window of cells, metres."""
        north = self.north_min_m + np.arange(row + 0.5, row + shape[0]) * self.cell_m
        east = self.east_min_m + np.arange(column + 0.5, column + shape[1]) * self.cell_m
        return north[:, None], east[None, :]


def empty_map(cell_m: float, north_m: tuple[float, float], east_m: tuple[float, float]) -> KnownMap:
    """A map of an area (minimum, maximum north and east) of which nothing is known."""
    rows = math.ceil((north_m[1] - north_m[0]) / cell_m)
    columns = math.ceil((east_m[1] - east_m[0]) / cell_m)
    return KnownMap(
        cell_m=cell_m,
        north_min_m=north_m[0],
        east_min_m=east_m[0],
        upper_m=np.full((rows, columns), np.inf),
        seen=np.zeros((rows, columns), dtype=bool),
    )


def proven_range_m(known: KnownMap, scan: Scan) -> float:
    """How far the radar did see: what it did not see beyond that may be out of its range."""
    seen = np.isfinite(scan.heights_m)
    return float(_distances_m(known, scan)[seen].max(initial=0.0))


def _distances_m(known: KnownMap, scan: Scan) -> FloatArray:
    north, east = known.middles_m(scan.row, scan.column, _shape(scan.heights_m))
    return np.hypot(north - scan.radar_nea_m[..., 0], east - scan.radar_nea_m[..., 1])


def _hidden_bound_m(seen: KnownMap, scan: Scan) -> FloatArray:
    """Upper bound of what the radar could not see although it was within range.

    The steepest sight line from the radar over known terrain before the cell: what hides the
    cell is itself seen, so whatever is hidden lies below.  -> (rows, columns) of the scan's
    window; +inf where the cell was seen, not answered or perhaps out of range, and
    where ground that is neither known nor hidden may be what hides it.
    """
    north, east = seen.middles_m(scan.row, scan.column, _shape(scan.heights_m))
    distance = _distances_m(seen, scan)
    slack = 1.5 * seen.cell_m + scan.drift_m + scan.registration_m
    not_seen = np.isneginf(scan.heights_m)
    reach = min(scan.range_m - slack, proven_range_m(seen, scan))
    hidden = not_seen & (distance < reach)
    result = np.full(hidden.shape, np.inf)
    if hidden.any():
        rows, columns = np.nonzero(hidden)
        middles = np.stack([north[rows, 0], east[0, columns]], axis=-1)
        window = _window(scan)
        obstacles = seen.upper_m.copy()
        hides_nothing = not_seen & np.isinf(obstacles[window])
        obstacles[window] = np.where(hides_nothing, -np.inf, obstacles[window])
        bound = sight_line_m(
            replace(seen, upper_m=obstacles), scan.radar_nea_m[hidden], middles, slack
        )
        result[hidden] = np.where(np.isneginf(bound), np.inf, np.ceil(bound))
    return result


def sight_line_m(
    known: KnownMap,
    radars_nea_m: FloatArray,
    points_ne_m: FloatArray,
    slack_m: float,
    stop_short_m: float = 0.0,
) -> FloatArray:
    """Altitude of the highest sight line from radars to points over the terrain between.

    radars_nea_m (K, 3), points_ne_m (K, 2) -> (K,), metres AMSL; +inf over unknown ground, -inf
    where nothing lies between.  Never too low if the terrain, the radar and the point are known
    to slack_m: the march looks at every cell within the slack of the line.  It ends stop_short_m
    before the point, so that a cell need not hide itself.
    """
    cell = known.cell_m
    size = 2 * math.ceil(slack_m / cell - 0.5) + 1
    highest = scipy.ndimage.maximum_filter(known.upper_m, size=size, mode="nearest")
    offset = points_ne_m - radars_nea_m[:, :2]
    distance = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-9)
    heading = offset / distance[:, None]
    start = (radars_nea_m[:, :2] - (known.north_min_m, known.east_min_m)) / cell
    limits = np.asarray(known.upper_m.shape) - 1
    steepest = np.full(distance.shape, -np.inf)
    for step in range(1, math.ceil(float(distance.max()) / cell)):
        along = step * cell
        before = np.nonzero(along < distance - stop_short_m)[0]
        index = np.clip((start[before] + heading[before] * step).astype(np.intp), 0, limits)
        rise = highest[index[:, 0], index[:, 1]] - radars_nea_m[before, 2]
        gap = np.where(rise > 0, max(along - slack_m, 0.5 * cell), along + slack_m)
        steepest[before] = np.maximum(steepest[before], rise / gap)
    run = np.where(steepest > 0, distance + slack_m, np.maximum(distance - slack_m, 0.0))
    finite = np.isfinite(steepest)
    bound = radars_nea_m[:, 2] + np.where(finite, steepest, 0.0) * run
    return np.where(finite, bound, steepest)


def _window(scan: Scan) -> tuple[slice, slice]:
    rows, columns = scan.heights_m.shape
    return slice(scan.row, scan.row + rows), slice(scan.column, scan.column + columns)


def _shape(array: FloatArray) -> tuple[int, int]:
    return array.shape[0], array.shape[1]
