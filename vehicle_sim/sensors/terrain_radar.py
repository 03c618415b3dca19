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
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from vehicle_sim.geodesy import EARTH_RADIUS_M, LocalFrame
from vehicle_sim.terrain import FloatArray, Terrain

BLOCK_CELLS = 4
ROWS, COLUMNS = 7, 8
UNSEEN_M = -32768
_CELLS_NORTH, _CELLS_EAST = ROWS * BLOCK_CELLS, COLUMNS * BLOCK_CELLS
_GRID_CELLS_PER_RANGE = 400
_GRID_MARGIN = 0.25
_TILE_CELLS = 100
_CHUNK = 10
"""Grid cells on a side of a square, and samples of a line, that are looked at together at first."""
_PARTS = 3  # a side
_MAX_DIVISIONS = 2
_LOWEST_M, _HIGHEST_M = -32767.0, 32767.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ScanRequest:
    """A TERRAIN_REQUEST: an area of 28 x 32 cells, and which of its 56 blocks are wanted."""

    latitude_deg: float
    """Of the south-west corner."""
    longitude_deg: float
    spacing_m: int
    mask: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ScanBlock:
    """The 4 x 4 cells of one bit of the mask, from the south-west, east running fastest."""

    gridbit: int
    heights_amsl_m: tuple[int, ...]


@final
@dataclass(frozen=True, slots=True)
class Viewpoint:
    """Where the radar looks from."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float


@final
class _Grid:
    """Lower bounds of the terrain around a point, found where a line passes; nothing outside."""

    def __init__(
        self, terrain: Terrain, *, south_m: float, west_m: float, cell_m: float, tiles: int
    ) -> None:
        self.south_m, self.west_m, self.cell_m = south_m, west_m, cell_m
        self.size = tiles * _TILE_CELLS
        self.lowest_amsl_m = np.empty((self.size, self.size))
        self.lowest_around_amsl_m = np.empty((self.size, self.size))
        """Of each cell and the eight around it."""
        squares = self.size // _CHUNK
        self.highest_near_amsl_m = np.full((squares, squares), -np.inf)
        """The highest of `lowest_amsl_m` in each square of cells and the eight around it."""
        self._highest_amsl_m = np.full((squares + 2, squares + 2), -np.inf)  # with a margin
        self._terrain = terrain
        self._found = np.zeros((tiles, tiles), dtype=bool)

    def centre_ne_m(self) -> tuple[float, float]:
        half_m = 0.5 * self.size * self.cell_m
        return self.south_m + half_m, self.west_m + half_m

    def find(self, rows: tuple[int, int], columns: tuple[int, int]) -> None:
        """Have the bounds of these rows and columns, first and last, in `lowest_amsl_m`."""
        (top, bottom), (left, right) = (
            (first // _TILE_CELLS, last // _TILE_CELLS + 1) for first, last in (rows, columns)
        )
        new = np.argwhere(~self._found[top:bottom, left:right])
        for row, column in new:
            self._find(top + int(row), left + int(column))
        if len(new):
            self.highest_near_amsl_m = _of_nine(np.maximum, self._highest_amsl_m)

    def _find(self, row: int, column: int) -> None:
        edges = np.arange(-1.0, _TILE_CELLS + 2.0)
        north = self.south_m + (row * _TILE_CELLS + edges) * self.cell_m
        east = self.west_m + (column * _TILE_CELLS + edges) * self.cell_m
        start = row * _TILE_CELLS, column * _TILE_CELLS
        tile = tuple(slice(first, first + _TILE_CELLS) for first in start)
        lowest = self._terrain.lowest_in_grid_amsl_m(north, east)
        self.lowest_amsl_m[tile] = lowest[1:-1, 1:-1]
        side = _TILE_CELLS // _CHUNK
        at = tuple(slice(1 + first * side, 1 + (first + 1) * side) for first in (row, column))
        squares = lowest[1:-1, 1:-1].reshape(side, _CHUNK, side, _CHUNK)
        self._highest_amsl_m[at] = squares.max(axis=1).max(axis=2)
        self.lowest_around_amsl_m[tile] = _of_nine(np.minimum, lowest)
        self._found[row, column] = True
        for edge in (0, -1):  # lines beyond the edge are looked up there
            for lowest in (self.lowest_amsl_m, self.lowest_around_amsl_m):
                lowest[edge, tile[1]] = lowest[tile[0], edge] = -np.inf


@final
class TerrainRadar:
    """Answers scan requests.  Keeps the grid of the neighbourhood that it last looked at."""

    def __init__(self, terrain: Terrain, frame: LocalFrame, *, range_m: float) -> None:
        self._terrain = terrain
        self._frame = frame
        self._range_m = range_m
        self._grid: _Grid | None = None

    def answer(self, request: ScanRequest, view: Viewpoint) -> tuple[ScanBlock, ...]:
        """The wanted blocks, by rising bit."""
        bits = [bit for bit in range(ROWS * COLUMNS) if request.mask >> bit & 1]
        if not bits or request.spacing_m <= 0 or abs(request.latitude_deg) >= 90.0:
            return ()
        north, east = _cells_of(np.array(bits))
        heights = np.full(len(north), UNSEEN_M, dtype=np.int64)
        near = np.flatnonzero(self._within_range(request, view, north, east))
        if len(near):
            corners_ne_m = self._corners_ne_m(request, north[near], east[near])
            highest, place_ne_m = self._terrain.highest_in_quads_amsl_m(corners_ne_m)
            seen = self._seen(corners_ne_m, highest, place_ne_m, view)
            rounded = np.clip(np.ceil(highest[seen]), _LOWEST_M, _HIGHEST_M)
            heights[near[seen]] = rounded.astype(np.int64)
        blocks = heights.reshape(len(bits), BLOCK_CELLS * BLOCK_CELLS).tolist()
        return tuple(
            ScanBlock(gridbit=bit, heights_amsl_m=tuple(block))
            for bit, block in zip(bits, blocks, strict=True)
        )

    def height_amsl_m(self, latitude_deg: float, longitude_deg: float) -> float:
        """The true height of the terrain at a point."""
        return self._terrain.height_at_amsl_m(*self._frame.to_local(latitude_deg, longitude_deg))

    def sees(self, latitude_deg: float, longitude_deg: float, view: Viewpoint) -> bool:
        """Whether a point of the ground is in range and in sight."""
        if not abs(latitude_deg) < 90.0:
            return False
        frame = LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
        if math.hypot(*frame.to_local(view.latitude_deg, view.longitude_deg)) > self._range_m:
            return False
        point_ne_m = np.array([self._frame.to_local(latitude_deg, longitude_deg)])
        north_m, east_m = self._frame.to_local(view.latitude_deg, view.longitude_deg)
        return bool(self._in_sight((north_m, east_m, view.altitude_amsl_m), point_ne_m)[0])

    def _corners_ne_m(
        self, request: ScanRequest, north: NDArray[np.intp], east: NDArray[np.intp]
    ) -> FloatArray:
        """Corners of cells in the local frame, anticlockwise from the south-west.

        (C,), (C,) -> (C, 4, 2).
        """
        rows = np.stack([north, north, north + 1, north + 1], axis=-1)
        columns = np.stack([east, east + 1, east + 1, east], axis=-1)
        corners_ne_m = np.empty((_CELLS_NORTH + 1, _CELLS_EAST + 1, 2))
        wanted = np.zeros(corners_ne_m.shape[:2], dtype=bool)
        wanted[rows, columns] = True  # each once: cells share them
        north_m, east_m = (each * np.float64(request.spacing_m) for each in np.nonzero(wanted))
        corner = LocalFrame(latitude_deg=request.latitude_deg, longitude_deg=request.longitude_deg)
        local = self._frame.to_local_many(*corner.to_geographic_many(north_m, east_m))
        corners_ne_m[wanted] = np.stack(local, axis=-1)
        return corners_ne_m[rows, columns]

    def _within_range(
        self,
        request: ScanRequest,
        view: Viewpoint,
        north: NDArray[np.intp],
        east: NDArray[np.intp],
    ) -> NDArray[np.bool_]:
        """Whether the middle of each cell is in range.  (C,), (C,) -> (C,)."""
        corner = LocalFrame(latitude_deg=request.latitude_deg, longitude_deg=request.longitude_deg)
        view_north_m, view_east_m = corner.to_local(view.latitude_deg, view.longitude_deg)
        away_m = np.hypot(
            (north + 0.5) * request.spacing_m - view_north_m,
            (east + 0.5) * request.spacing_m - view_east_m,
        )
        return away_m <= self._range_m

    def _seen(
        self,
        corners_ne_m: FloatArray,
        highest_amsl_m: FloatArray,
        highest_ne_m: FloatArray,
        view: Viewpoint,
    ) -> NDArray[np.bool_]:
        """Whether some point of each cell may be in sight.  (C, 4, 2), (C,), (C, 2) -> (C,)."""
        north_m, east_m = self._frame.to_local(view.latitude_deg, view.longitude_deg)
        eye = (north_m, east_m, view.altitude_amsl_m)
        seen = self._in_sight(eye, highest_ne_m)  # the likeliest point first: few need more
        left = np.flatnonzero(~seen)
        left = left[self._may_be_seen(eye, corners_ne_m[left], highest_amsl_m[left])]
        if len(left):
            corners = corners_ne_m[left]
            others = np.concatenate([corners, corners.mean(axis=1, keepdims=True)], axis=1)
            free = self._in_sight(eye, others.reshape(-1, 2)).reshape(-1, 5)
            seen[left] = free.any(axis=1)
            left = left[~seen[left]]
        quads, of = corners_ne_m[left], left
        for _ in range(self._divisions(eye, quads)):
            if not len(quads):
                break
            quads, of = _divided(quads), np.repeat(of, _PARTS * _PARTS)
            highest, _ = self._terrain.highest_in_quads_amsl_m(quads)
            may_be = self._may_be_seen(eye, quads, highest)
            quads, of = quads[may_be], of[may_be]
        seen[of] = True
        return seen

    def _divisions(self, eye: tuple[float, float, float], quads_ne_m: FloatArray) -> int:
        """How often to divide quadrilaterals until they are about two cells of the grid wide."""
        if not len(quads_ne_m):
            return 0
        side_m = float(np.hypot(*(quads_ne_m[:, 1] - quads_ne_m[:, 0]).T).max())
        times = math.log(max(0.5 * side_m / self._grid_about(*eye[:2]).cell_m, 1.0), _PARTS)
        return min(math.ceil(times - 1e-9), _MAX_DIVISIONS)

    def _may_be_seen(
        self, eye: tuple[float, float, float], corners_ne_m: FloatArray, highest_amsl_m: FloatArray
    ) -> NDArray[np.bool_]:
        """Whether a line to some point of each quadrilateral may be free.  (K, 4, 2), (K,) -> (K,).

        Taken to be as high as its highest all over the circle around it.
        """
        grid = self._grid_about(eye[0], eye[1])
        away = corners_ne_m - np.array(eye[:2])
        middle = away.mean(axis=1)
        half_m = np.hypot(*np.moveaxis(away - middle[:, None], -1, 0)).max(axis=1, initial=0.0)
        middle_m = np.hypot(middle[:, 0], middle[:, 1])
        nearest_m = np.maximum(middle_m - half_m, grid.cell_m)
        seen = middle_m <= 2.0 * half_m + 2.0 * grid.cell_m  # next to the eye
        rise_m = highest_amsl_m - eye[2]
        slope = rise_m / np.where(rise_m > 0.0, nearest_m, middle_m + half_m)
        count = np.maximum(np.ceil(half_m / grid.cell_m), 1.0)
        across_rad = np.arcsin(np.minimum(half_m / np.maximum(middle_m, 1e-9), 1.0))
        bearing_rad = np.arctan2(middle[:, 1], middle[:, 0])
        for k in range(int(np.max(count[~seen], initial=0.0))):
            left = np.flatnonzero(~seen & (k < count))
            share = (2.0 * k + 1.0) / count[left] - 1.0  # of the way from the middle to the side
            at = bearing_rad[left] + across_rad[left] * share
            run = nearest_m[left, None] * np.stack([np.cos(at), np.sin(at)], axis=-1)
            top_m = eye[2] + slope[left] * nearest_m[left]
            seen[left] = self._free(eye, run, top_m, around=True)
        return seen

    def _in_sight(
        self, eye: tuple[float, float, float], points_ne_m: FloatArray
    ) -> NDArray[np.bool_]:
        """Whether each point of the surface has a free line to the eye.  (K, 2) -> (K,)."""
        top_m = self._terrain.height_amsl_m(points_ne_m[:, 0], points_ne_m[:, 1])
        return self._free(eye, points_ne_m - np.array(eye[:2]), top_m, around=False)

    def _free(
        self,
        eye: tuple[float, float, float],
        offset_ne_m: FloatArray,
        top_amsl_m: FloatArray,
        *,
        around: bool,
    ) -> NDArray[np.bool_]:
        """Whether nothing blocks each line from the eye, or some line around it.

        Around: within a cell of the grid.  (K, 2), (K,) -> (K,).
        """
        grid = self._grid_about(eye[0], eye[1])
        farthest_m = float(np.max(np.hypot(offset_ne_m[:, 0], offset_ne_m[:, 1]), initial=0.0))
        count = max(math.ceil(farthest_m / grid.cell_m), 1)
        share = (np.arange(count) + 0.5) / count  # of the way to the point
        lines = _Lines(eye=eye, offset_ne_m=offset_ne_m, top_amsl_m=top_amsl_m)
        return ~lines.blocked(grid, share, around=around)

    def _grid_about(self, north_m: float, east_m: float) -> _Grid:
        """The grid that reaches beyond the range on all sides of this point."""
        grid = self._grid
        spare_m = _GRID_MARGIN * self._range_m
        if grid is not None:
            centre_north_m, centre_east_m = grid.centre_ne_m()
            if max(abs(north_m - centre_north_m), abs(east_m - centre_east_m)) <= 1.5 * spare_m:
                return grid
        cell_m = self._range_m / _GRID_CELLS_PER_RANGE
        tile_m = _TILE_CELLS * cell_m
        tiles = 2 * math.ceil((self._range_m + 2.0 * spare_m) / tile_m)
        # Whole multiples of the tile: the same ground has the same bounds wherever one looks from.
        self._grid = _Grid(
            self._terrain,
            south_m=(round(north_m / tile_m) - tiles // 2) * tile_m,
            west_m=(round(east_m / tile_m) - tiles // 2) * tile_m,
            cell_m=cell_m,
            tiles=tiles,
        )
        return self._grid


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Lines:
    """Straight lines from the radar to points of the ground."""

    eye: tuple[float, float, float]
    offset_ne_m: FloatArray
    """From the eye.  (K, 2)."""
    top_amsl_m: FloatArray
    """Of the ground at the points.  (K,)."""

    def blocked(self, grid: _Grid, share: FloatArray, *, around: bool) -> NDArray[np.bool_]:
        """Whether the ground rises above each line at rising shares of the way.  (S,) -> (K,).

        Samples must be no farther from each other than a cell of the grid.  Most lie far above
        the ground: only where the highest of the neighbourhood is above a line, each is looked up.
        """
        every = np.arange(len(self.top_amsl_m))
        if not len(every):
            return np.zeros(0, dtype=bool)
        rows, columns = self._cells(grid, share[[0, -1], None], every)
        grid.find((int(rows.min()), int(rows.max())), (int(columns.min()), int(columns.max())))
        first = np.arange(0, len(share), _CHUNK)
        middle, last = (
            np.minimum(first + more, len(share) - 1) for more in (_CHUNK // 2, _CHUNK - 1)
        )
        lowest_amsl_m = grid.lowest_around_amsl_m if around else grid.lowest_amsl_m
        rows, columns = self._cells(grid, share[middle, None], every)
        # most of what is hidden is so for more than one sample
        line_m = self._heights_m(share[middle, None], every)
        blocked = np.logical_or.reduce(lowest_amsl_m[rows, columns] > line_m)
        ends_m = [self._heights_m(share[end, None], every) for end in (first, last)]
        dip_m = 0.25 * (share[last] - share[first])[:, None] ** 2 * self._sags_m(every)
        near_amsl_m = grid.highest_near_amsl_m[rows // _CHUNK, columns // _CHUNK]
        chunk, line = np.nonzero((near_amsl_m > np.minimum(*ends_m) - dip_m) & ~blocked)
        sample = np.minimum(first[chunk] + np.arange(_CHUNK)[:, None], len(share) - 1)
        rows, columns = self._cells(grid, share[sample], line)
        is_under = lowest_amsl_m[rows, columns] > self._heights_m(share[sample], line)
        blocked[line[is_under.any(axis=0)]] = True
        return blocked

    def _cells(
        self, grid: _Grid, share: FloatArray, line: NDArray[np.intp]
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Row and column of the grid at these shares of these lines.  (S, L), (L,) -> (S, L)."""
        low_m, offset_m = (grid.south_m, grid.west_m), self.offset_ne_m[line].T / grid.cell_m
        row, column = (
            np.clip(
                ((self.eye[k] - low_m[k]) / grid.cell_m + share * offset_m[k]).astype(np.int32),
                0,
                grid.size - 1,
            )
            for k in (0, 1)
        )
        return row, column

    def _heights_m(self, share: FloatArray, line: NDArray[np.intp]) -> FloatArray:
        """Height of these lines at these shares of the way.  (S, L), (L,) -> (S, L)."""
        rise_m = self.top_amsl_m[line] - self.eye[2]
        return self.eye[2] + share * (rise_m - (1.0 - share) * self._sags_m(line))

    def _sags_m(self, line: NDArray[np.intp]) -> FloatArray:
        """Four times what the middles of these lines are lower than over a plane.  (L,) -> (L,)."""
        rise_m = self.top_amsl_m[line] - self.eye[2]
        square_m2 = (self.offset_ne_m[line] ** 2).sum(axis=1) + 2.0 * rise_m**2
        return square_m2 / (2.0 * EARTH_RADIUS_M)


def _of_nine(best: np.ufunc, cells: FloatArray) -> FloatArray:
    """The best of each cell and the eight around it.  (N + 2, M + 2) -> (N, M)."""
    cells = best(best(cells[:-2], cells[1:-1]), cells[2:])
    nine: FloatArray = best(best(cells[:, :-2], cells[:, 1:-1]), cells[:, 2:])
    return nine


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
