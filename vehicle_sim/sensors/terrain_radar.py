"""The terrain radar: which cells it sees from where the vehicle is, and how high they are.

A cell's height is that of its highest true terrain, rounded up to the metre.  A cell is seen if any
point of it may have a free line of sight to the radar, and its middle is not farther than the
radar's range.  So a cell within range that is not seen is completely hidden, and a reader of the
scan may rely on that.

Lines of sight are marched through a grid of lower bounds of the terrain: what blocks a line there
blocks it in truth.  A cell is seen if its highest point, its middle or a corner
has a free line.  Of the others, each part
is taken to be as high as its highest all over, and lines go out across it so close to each other
that every line to a point of it lies within a grid cell of one of them; only what is higher on all
of that strip blocks it.  So a cell is never called hidden that is not.  What passes within two grid
cells of a ridge may count as seen though it is not, which only reports one true height more.
Lines are straight over a sphere: of a line between altitudes that differ by z, over a distance d,
a share s of the way is s (1 - s) (d^2 + 2 z^2) / 2 R_e lower than over a plane.  The air bends
nothing.
"""

import math
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from vehicle_sim.compiled import compiled
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.geodesy import EARTH_RADIUS_M, FloatArray, LocalFrame
from vehicle_sim.terrain import Terrain

BLOCK_CELLS: Final = 4
ROWS, COLUMNS = 7, 8
UNSEEN_M: Final = -32768
_GRID_CELLS_PER_RANGE: Final = 400
_GRID_MARGIN: Final = 0.25
_TILE_CELLS: Final = 100
_PARTS: Final = 3  # a side
_MAX_DIVISIONS: Final = 2
_LOWEST_M, _HIGHEST_M = -32767.0, 32767.0
Eye = tuple[float, float, float]
"""North, east, AMSL."""


@final
class _Grid:
    """Lower bounds of the terrain around a point, found by tiles where lines pass."""

    def __init__(self, terrain: Terrain, near_ne_m: tuple[float, float], range_m: float) -> None:
        """It reaches 1.5 times the range from near the point: so far one may fly on with it."""
        self._terrain = terrain
        self.cell_m = range_m / _GRID_CELLS_PER_RANGE
        tile_m = _TILE_CELLS * self.cell_m
        tiles = 2 * math.ceil(range_m * (1.0 + 2.0 * _GRID_MARGIN) / tile_m)
        # Whole multiples of the tile: the same ground has the same bounds wherever one looks from.
        south_m, west_m = ((round(x / tile_m) - tiles // 2) * tile_m for x in near_ne_m)
        self.place = (south_m, west_m, self.cell_m)
        self.middle_ne_m = np.array([south_m, west_m]) + 0.5 * tiles * tile_m
        self.lowest_amsl_m = np.full((tiles * _TILE_CELLS,) * 2, -np.inf)
        self._bounded = np.zeros((tiles, tiles), dtype=bool)

    def find(self, points_ne_m: FloatArray) -> None:
        """Have the bounds of all cells between these points.  (K, 2)."""
        (*corner, cell_m), edges = self.place, np.arange(_TILE_CELLS + 1.0)
        ends = np.stack([points_ne_m.min(axis=0), points_ne_m.max(axis=0)]) - corner
        ends += [[-cell_m], [cell_m]]  # one cell more: lines look around themselves
        low, high = np.clip(ends // (_TILE_CELLS * cell_m), 0, len(self._bounded) - 1).astype(int)
        part = self._bounded[low[0] : high[0] + 1, low[1] : high[1] + 1]
        for first in (np.argwhere(~part) + low) * _TILE_CELLS:
            edges_m = np.array(corner)[:, None] + (first[:, None] + edges) * cell_m
            rows, columns = (slice(at, at + _TILE_CELLS) for at in first)
            self.lowest_amsl_m[rows, columns] = self._terrain.lowest_in_grid_amsl_m(*edges_m)
        part[:] = True


@final
class TerrainRadar:
    """Answers scan requests.  Keeps the grid of the neighbourhood that it last looked at."""

    def __init__(self, terrain: Terrain, frame: LocalFrame, *, range_m: float) -> None:
        self._terrain = terrain
        self._frame = frame
        self._range_m = range_m
        self._grid: _Grid | None = None

    def answer(
        self, corner: LocalFrame, spacing_m: int, mask: int, vehicle: Vehicle
    ) -> dict[int, list[int]]:
        """The blocks of a TERRAIN_REQUEST as seen from the vehicle, by rising bit of the mask.

        The area of 28 x 32 cells lies to the north-east of the corner.  Heights are of a block's
        4 x 4 cells from the south-west, east running fastest; UNSEEN_M: not seen.
        """
        bits = [bit for bit in range(ROWS * COLUMNS) if mask >> bit & 1]
        if not bits or spacing_m <= 0 or abs(corner.latitude_deg) >= 90.0:
            return {}
        north, east = _cells_of(np.array(bits))
        heights = np.full(len(north), UNSEEN_M, dtype=np.int64)
        own_ne_m = corner.to_local(vehicle.latitude_deg, vehicle.longitude_deg)
        off_north_m, off_east_m = (
            (cells + 0.5) * spacing_m - own_m
            for cells, own_m in zip((north, east), own_ne_m, strict=True)
        )
        near = np.flatnonzero(np.hypot(off_north_m, off_east_m) <= self._range_m)
        if len(near):
            corners_ne_m = self._corners_ne_m(corner, spacing_m, north[near], east[near])
            highest, place_ne_m = self._terrain.highest_in_quads_amsl_m(corners_ne_m)
            own_ne_m = self._frame.to_local(vehicle.latitude_deg, vehicle.longitude_deg)
            eye = (*own_ne_m, vehicle.altitude_amsl_m)
            seen = self._seen(eye, corners_ne_m, highest, place_ne_m)
            rounded = np.clip(np.ceil(highest[seen]), _LOWEST_M, _HIGHEST_M)
            heights[near[seen]] = rounded.astype(np.int64)
        blocks = heights.reshape(len(bits), BLOCK_CELLS * BLOCK_CELLS).tolist()
        return dict(zip(bits, blocks, strict=True))

    def height_amsl_m(self, latitude_deg: float, longitude_deg: float) -> float:
        """The true height of the terrain at a point."""
        return self._terrain.height_at_amsl_m(*self._frame.to_local(latitude_deg, longitude_deg))

    def _corners_ne_m(
        self, origin: LocalFrame, spacing_m: int, north: NDArray[np.intp], east: NDArray[np.intp]
    ) -> FloatArray:
        """Corners of cells in the local frame, anticlockwise from the south-west.

        (C,), (C,) -> (C, 4, 2).
        """
        rows = np.stack([north, north, north + 1, north + 1], axis=-1)
        columns = np.stack([east, east + 1, east + 1, east], axis=-1)
        width = COLUMNS * BLOCK_CELLS + 1
        corners, which = np.unique(rows * width + columns, return_inverse=True)  # cells share them
        corner_m = np.stack(np.divmod(corners, width)) * float(spacing_m)
        local = self._frame.to_local_many(*origin.to_geographic_many(*corner_m))
        return np.stack(local, axis=-1)[which].reshape(-1, 4, 2)

    def _seen(
        self,
        eye: Eye,
        corners_ne_m: FloatArray,
        highest_amsl_m: FloatArray,
        highest_ne_m: FloatArray,
    ) -> NDArray[np.bool_]:
        """Whether some point of each cell may be in sight.  (C, 4, 2), (C,), (C, 2) -> (C,)."""
        grid = self._grid_about(eye, corners_ne_m.reshape(-1, 2))
        lowest = (grid.lowest_amsl_m, grid.place)

        def in_sight(points_ne_m: FloatArray) -> NDArray[np.bool_]:
            """Whether these points of the surface have free lines to the eye.  (K, 2) -> (K,)."""
            top_m = self._terrain.height_amsl_m(points_ne_m[:, 0], points_ne_m[:, 1])
            return _in_sight(eye, np.column_stack([points_ne_m, top_m]), *lowest)

        seen = in_sight(highest_ne_m)  # the likeliest point first: few need more
        left = np.flatnonzero(~seen)
        left = left[_may_be_seen(eye, corners_ne_m[left], highest_amsl_m[left], *lowest)]
        corners = corners_ne_m[left]
        others = np.concatenate([corners, corners.mean(axis=1, keepdims=True)], axis=1)
        seen[left] = in_sight(others.reshape(-1, 2)).reshape(-1, 5).any(axis=1)
        # the rest is divided until its parts are about two cells of the grid wide
        of = left[~seen[left]]
        quads = corners_ne_m[of]
        side_m = float(np.hypot(*(quads[:, 1] - quads[:, 0]).T).max(initial=0.0))
        divisions = math.ceil(math.log(max(0.5 * side_m / grid.cell_m, 1.0), _PARTS) - 1e-9)
        for _ in range(min(divisions, _MAX_DIVISIONS)):
            quads, of = _divided(quads), np.repeat(of, _PARTS * _PARTS)
            highest, _ = self._terrain.highest_in_quads_amsl_m(quads)
            may_be = _may_be_seen(eye, quads, highest, *lowest)
            quads, of = quads[may_be], of[may_be]
            if not len(quads):
                break
        seen[of] = True
        return seen

    def _grid_about(self, eye: Eye, points_ne_m: FloatArray) -> _Grid:
        """A grid beyond the range on all sides of the eye, with what is between it and points."""
        grid, spare_m = self._grid, _GRID_MARGIN * self._range_m
        if grid is None or np.abs(grid.middle_ne_m - eye[:2]).max() > 1.5 * spare_m:
            grid = self._grid = _Grid(self._terrain, eye[:2], self._range_m)
        grid.find(np.concatenate([points_ne_m, [eye[:2]]]))
        return grid


# --- compiled: lines of sight ---------------------------------------------------------------------


def _blocked_m(
    eye: Eye,
    to: Eye,
    lowest_amsl_m: FloatArray,
    south_west_cell_m: Eye,
    around: bool,
    hint_m: float,
) -> float:
    """How far away the ground rises above the line from the eye to a place; -1: nowhere.

    Around: above every line within a cell of it.  It looks at the hint first: lines beside each
    other are hidden by the same ridge.
    """
    south_m, west_m, cell_m = south_west_cell_m
    row, column = (eye[0] - south_m) / cell_m, (eye[1] - west_m) / cell_m
    rows, columns = (to[0] - eye[0]) / cell_m, (to[1] - eye[1]) / cell_m
    size, away = len(lowest_amsl_m) - 1, math.hypot(rows, columns)
    count = max(math.ceil(away), 1)
    rise_m = to[2] - eye[2]
    sag_m = ((away * cell_m) ** 2 + 2.0 * rise_m * rise_m) / (2.0 * EARTH_RADIUS_M)
    for k in range(-1, count):
        share = (k + 0.5) / count
        if k == -1:
            if not 0.0 < hint_m < away * cell_m:
                continue
            share = hint_m / (away * cell_m)
        i, j = int(row + share * rows), int(column + share * columns)
        if not (0 < i < size and 0 < j < size):
            continue  # nothing is known there
        line_m = eye[2] + share * (rise_m - (1.0 - share) * sag_m)
        if lowest_amsl_m[i, j] <= line_m:
            continue
        if not around or lowest_amsl_m[i - 1 : i + 2, j - 1 : j + 2].min() > line_m:
            return share * away * cell_m
    return -1.0


@compiled(_blocked_m)
def _in_sight(
    eye: Eye, points_nea_m: FloatArray, lowest_amsl_m: FloatArray, south_west_cell_m: Eye
) -> NDArray[np.bool_]:
    """Whether lines to points are free.  (K, 3), the grid -> (K,)."""
    free = np.zeros(len(points_nea_m), dtype=np.bool_)
    hint_m = 0.0
    for k in range(len(points_nea_m)):
        to = (points_nea_m[k, 0], points_nea_m[k, 1], points_nea_m[k, 2])
        blocked_m = _blocked_m(eye, to, lowest_amsl_m, south_west_cell_m, False, hint_m)
        free[k] = blocked_m < 0.0
        hint_m = hint_m if free[k] else blocked_m
    return free


@compiled(_blocked_m)
def _may_be_seen(
    eye: Eye,
    corners_ne_m: FloatArray,
    highest_amsl_m: FloatArray,
    lowest_amsl_m: FloatArray,
    south_west_cell_m: Eye,
) -> NDArray[np.bool_]:
    """Whether a line to some point of a quadrilateral may be free.  (K, 4, 2), (K,) -> (K,).

    Taken to be as high as its highest all over the circle around it.
    """
    seen = np.zeros(len(corners_ne_m), dtype=np.bool_)
    cell_m, hint_m = south_west_cell_m[2], 0.0
    for k in range(len(corners_ne_m)):
        north_m = corners_ne_m[k, :, 0].mean() - eye[0]
        east_m = corners_ne_m[k, :, 1].mean() - eye[1]
        half_m, away_m = 0.0, math.hypot(north_m, east_m)
        for corner in corners_ne_m[k]:
            off_n, off_e = corner[0] - eye[0] - north_m, corner[1] - eye[1] - east_m
            half_m = max(half_m, math.hypot(off_n, off_e))
        nearest_m = max(away_m - half_m, cell_m)
        seen[k] = away_m <= 2.0 * half_m + 2.0 * cell_m  # next to the eye
        rise_m = highest_amsl_m[k] - eye[2]
        slope = rise_m / (nearest_m if rise_m > 0.0 else away_m + half_m)
        across_rad = math.asin(min(half_m / max(away_m, 1e-9), 1.0))
        lines = max(math.ceil(half_m / cell_m), 1)
        line = 0
        while line < lines and not seen[k]:
            share = (2.0 * line + 1.0) / lines - 1.0  # of the way from the middle to the side
            at_rad = math.atan2(east_m, north_m) + across_rad * share
            north, east = nearest_m * math.cos(at_rad), nearest_m * math.sin(at_rad)
            to = (eye[0] + north, eye[1] + east, eye[2] + slope * nearest_m)
            blocked_m = _blocked_m(eye, to, lowest_amsl_m, south_west_cell_m, True, hint_m)
            seen[k] = blocked_m < 0.0
            hint_m = hint_m if seen[k] else blocked_m
            line += 1
    return seen


def _divided(corners_ne_m: FloatArray) -> FloatArray:
    """Quadrilaterals divided into parts.  (K, 4, 2) -> (K _PARTS^2, 4, 2)."""
    share = np.linspace(0.0, 1.0, _PARTS + 1)[:, None]
    u, v = share[:, None], share[None]
    sw, se, ne, nw = (corners_ne_m[:, k, None, None] for k in range(4))
    at = (1 - u) * ((1 - v) * sw + v * se) + u * ((1 - v) * nw + v * ne)  # (K, n + 1, n + 1, 2)
    parts = np.stack([at[:, :-1, :-1], at[:, :-1, 1:], at[:, 1:, 1:], at[:, 1:, :-1]], axis=3)
    return parts.reshape(-1, 4, 2)


def _cells_of(bits: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column of the cells of these blocks, in wire order.  (B,) -> (16 B,), (16 B,)."""
    x, y = np.divmod(np.arange(BLOCK_CELLS * BLOCK_CELLS), BLOCK_CELLS)
    north = (bits // COLUMNS * BLOCK_CELLS)[:, None] + x
    east = (bits % COLUMNS * BLOCK_CELLS)[:, None] + y
    return north.ravel(), east.ravel()
