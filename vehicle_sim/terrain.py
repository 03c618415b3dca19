"""The true terrain, and what bounds it: peaks after eq. 1 of the paper, or an elevation file.

A peak is h exp(-((n - n0) / s_n)^2 - ((e - e0) / s_e)^2).  In coordinates scaled by 1 / s about its
centre it falls with the distance alone, so its maximum over a convex area lies at the point nearest
to the centre, and its minimum over a box at the farthest corner: both exact.

An elevation file is bilinear between its points.  Positions come in the local frame: geodesics are
exact and slow, so the way from there to the grid is tabulated once, at places so close that it is
straight between them.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, Literal, final

import numpy as np
import scipy
from numpy.typing import NDArray

from vehicle_sim.compiled import compiled
from vehicle_sim.geodesy import FloatArray, LocalFrame

Combine = Literal["maximum", "sum"]
PeakRow = tuple[float, float, float, float, float]
"""North and east of the centre, height AMSL, spread north and east; all in metres."""


@final
class PeakTerrain:
    """Peaks over ground: max(ground, highest peak) or max(ground, sum of the peaks)."""

    def __init__(self, peaks: Sequence[PeakRow], *, combine: Combine, ground_amsl_m: float) -> None:
        self.combine, self.ground_amsl_m = combine, float(ground_amsl_m)
        self._peaks = np.array(peaks, dtype=np.float64).reshape(-1, 5)
        self._rows = self._peaks.tolist()  # for single points, ten times a second
        self.level = not len(peaks)
        """There is nothing but the ground."""

    def height_amsl_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Height of the terrain.  (...), (...) -> (...)."""
        north, east = np.broadcast_arrays(north_m, east_m)
        n, e, height, s_n, s_e = self._peaks.T.reshape(5, -1, *[1] * north.ndim)
        return self._joined(height * np.exp(-(((north - n) / s_n) ** 2) - ((east - e) / s_e) ** 2))

    def _joined(self, peaks_m: FloatArray) -> FloatArray:
        """What peaks and the ground make together.  (P, ...) -> (...)."""
        if self.combine == "maximum" or self.level:
            return peaks_m.max(axis=0, initial=self.ground_amsl_m)
        return np.maximum(peaks_m.sum(axis=0), self.ground_amsl_m)

    def height_at_amsl_m(self, north_m: float, east_m: float) -> float:
        """Height of the terrain at one point."""
        if self.level:
            return self.ground_amsl_m
        each_m = [
            height * math.exp(-(((north_m - n) / s_n) ** 2) - ((east_m - e) / s_e) ** 2)
            for n, e, height, s_n, s_e in self._rows
        ]
        return max(self.ground_amsl_m, max(each_m) if self.combine == "maximum" else sum(each_m))

    def highest_in_quads_amsl_m(self, corners_ne_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Highest terrain over convex quadrilaterals, and where.  (C, 4, 2) -> (C,), (C, 2).

        Exact for "maximum".  For "sum" the height is an upper bound, and the place is where the
        peak that matters most is highest.
        """
        adds = self.combine == "sum"
        return _highest_in_quads(corners_ne_m, self._peaks, self.ground_amsl_m, adds)

    def lowest_in_grid_amsl_m(
        self, north_edges_m: FloatArray, east_edges_m: FloatArray
    ) -> FloatArray:
        """Lower bound of the terrain in every cell of a grid.  (N + 1,), (E + 1,) -> (N, E).

        Each peak's minimum over a box factors into a north and an east part.
        """
        n, e, height, s_n, s_e = self._peaks.T[..., None]  # (P, 1) each
        x, y = np.abs(north_edges_m - n) / s_n, np.abs(east_edges_m - e) / s_e
        part_north = height * np.exp(-(np.maximum(x[:, :-1], x[:, 1:]) ** 2))  # (P, N)
        part_east = np.exp(-(np.maximum(y[:, :-1], y[:, 1:]) ** 2))  # (P, E)
        return self._joined(part_north[:, :, None] * part_east[:, None])


def _nearest_in_quad(quad: FloatArray, peak: FloatArray) -> tuple[float, float]:
    """Where a peak is highest in a convex quadrilateral: nearest to its centre, scaled.  (4, 2)."""
    best2, best_n, best_e, lefts = math.inf, 0.0, 0.0, 0
    for k in range(4):
        n1, e1 = (quad[k, 0] - peak[0]) / peak[3], (quad[k, 1] - peak[1]) / peak[4]
        n2, e2 = (quad[k - 3, 0] - peak[0]) / peak[3], (quad[k - 3, 1] - peak[1]) / peak[4]
        edge_n, edge_e = n2 - n1, e2 - e1
        side = n1 * edge_e - e1 * edge_n
        lefts += 1 if side > 0.0 else -1 if side < 0.0 else 0
        share = -(n1 * edge_n + e1 * edge_e) / max(edge_n * edge_n + edge_e * edge_e, 1e-300)
        share = min(max(share, 0.0), 1.0)
        n, e = n1 + share * edge_n, e1 + share * edge_e
        if n * n + e * e < best2:
            best2, best_n, best_e = n * n + e * e, n, e
    if abs(lefts) == 4:  # the centre is inside
        return peak[0], peak[1]
    return peak[0] + best_n * peak[3], peak[1] + best_e * peak[4]


@compiled(_nearest_in_quad)
def _highest_in_quads(
    quads: FloatArray, peaks: FloatArray, ground_amsl_m: float, adds: bool
) -> tuple[FloatArray, FloatArray]:
    """Height and place of the highest point.  (C, 4, 2), (P, 5) -> (C,), (C, 2)."""
    highest, place = np.full(len(quads), ground_amsl_m), np.empty((len(quads), 2))
    for k in range(len(quads)):
        place[k, 0], place[k, 1] = quads[k, :, 0].mean(), quads[k, :, 1].mean()
        best, total = 0.0, 0.0
        for peak in peaks:
            if not adds and peak[2] <= highest[k]:
                continue
            north, east = _nearest_in_quad(quads[k], peak)
            x, y = (north - peak[0]) / peak[3], (east - peak[1]) / peak[4]
            height = peak[2] * math.exp(-x * x - y * y)
            total += height
            if height > best and (adds or height > highest[k]):
                best, place[k, 0], place[k, 1] = height, north, east
            highest[k] = max(highest[k], total if adds else height)
    return highest, place


# --- elevation files ------------------------------------------------------------------------------

Area = tuple[float, float, float, float]
"""North least and most, east least and most, in metres."""
Pair = tuple[FloatArray, FloatArray]
Placed = Callable[[FloatArray, FloatArray], Pair]
"""In which row and column of a grid places lie: latitude, longitude -> fractions.  (K,) each."""
_TABLE_M: Final = 250.0
_TABLE_PLACES: Final = 400
"""A side at most: 1 km apart for an area of 400 km, where it bends by 2 cm between them."""
_BENT: Final = 1.01
"""Between the places of the table a grid has steps that are shorter, by less than this."""
_SAMPLES: Final = (9, 25)
_SAMPLE_M: Final = 5.0


@final
class GridTerrain:
    """Heights of points in rows from north to south; as at its edge beyond it."""

    def __init__(
        self,
        heights_m: NDArray[Any],
        *,
        placed: Placed,
        corner: tuple[int, int],
        frame: LocalFrame,
        area_m: Area,
    ) -> None:
        """The terrain of an area.

        heights_m: (rows, columns) AMSL, of the file's own type: the part of its grid from `corner`
        on.  placed: where in that grid latitudes and longitudes lie.
        """
        self.heights_m = heights_m
        sizes = [max(high - low, 1.0) for low, high in (area_m[:2], area_m[2:])]
        counts = [min(math.ceil(size / _TABLE_M), _TABLE_PLACES) + 1 for size in sizes]
        self._low_ne_m = area_m[0], area_m[2]
        self._spacing_ne_m = [size / (count - 1) for size, count in zip(sizes, counts, strict=True)]
        north, east = np.meshgrid(
            area_m[0] + np.linspace(0.0, sizes[0], counts[0]),
            area_m[2] + np.linspace(0.0, sizes[1], counts[1]),
            indexing="ij",
        )
        places = placed(*frame.to_geographic_many(north.ravel(), east.ravel()))
        self._row_at, self._column_at = (
            at.reshape(north.shape) - first for at, first in zip(places, corner, strict=True)
        )
        """(N, E): which row of the grid each place of the table lies in; and which column."""
        tables = self._row_at, self._column_at
        rows, columns = (np.array(np.gradient(at, *self._spacing_ne_m)) for at in tables)
        most = np.hypot(*rows).max(), np.hypot(*columns).max()
        self._steps_m = 1.0 / float(most[0]), 1.0 / float(most[1])
        """From row to row, and from column to column: the least of both in the area."""
        cosine = float(np.abs((rows * columns).sum(axis=0)).max()) / (most[0] * most[1])
        self._stretch = _BENT * math.sqrt(1.0 + cosine)
        """Slopes are so much more than those of steps at right angles, at most."""

    def _rows_columns(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Where points of the local frame lie in the grid.  (...) x2 -> (2, ...)."""
        north = (north_m - self._low_ne_m[0]) / self._spacing_ne_m[0]
        places = np.stack([north, (east_m - self._low_ne_m[1]) / self._spacing_ne_m[1]])
        return np.stack([_between(self._row_at, places), _between(self._column_at, places)])

    def height_amsl_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Height of the terrain.  (...), (...) -> (...)."""
        north, east = np.broadcast_arrays(north_m, east_m)
        return _between(self.heights_m, self._rows_columns(north, east))

    def height_at_amsl_m(self, north_m: float, east_m: float) -> float:
        """Height of the terrain at one point."""
        return float(self.height_amsl_m(np.array([north_m]), np.array([east_m]))[0])

    def _steepest(self, grid: FloatArray) -> FloatArray:
        """Bound of the gradient between points that lie together: C times K rows and columns.

        (2, C, K) -> (C,).  If some of them lie more than two rows apart, that of them all.
        """
        last = np.array(self.heights_m.shape) - 1
        low = np.clip(np.floor(grid.min(axis=(1, 2))).astype(np.intp) - 3, 0, last)
        high = np.clip(np.ceil(grid.max(axis=(1, 2))).astype(np.intp) + 3, 0, last)
        part = self.heights_m[low[0] : high[0] + 1, low[1] : high[1] + 1].astype(np.float64)
        part = np.pad(part, ((0, 1), (0, 1)), mode="edge")
        most = scipy.ndimage.maximum_filter  # within two rows and columns
        along_north = most(np.abs(np.diff(part, axis=0))[:, :-1], 5) / self._steps_m[0]
        along_east = most(np.abs(np.diff(part, axis=1))[:-1], 5) / self._steps_m[1]
        slope: FloatArray = self._stretch * np.hypot(along_north, along_east)
        if np.any(np.ptp(grid, axis=2) > 2.0):
            return np.full(grid.shape[1], slope.max())
        middle = np.rint(grid.mean(axis=2)).astype(np.intp) - low[:, None]
        return slope[tuple(np.clip(middle, 0, np.array(slope.shape)[:, None] - 1))]

    def highest_in_quads_amsl_m(self, corners_ne_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Highest terrain over convex quadrilaterals, and where.  (C, 4, 2) -> (C,), (C, 2).

        The height is an upper bound: that of the highest of a lattice of samples, and what the
        steepest slope nearby may add between them (about a metre for cells of 20 m).
        """
        sides = np.roll(corners_ne_m, -1, axis=1) - corners_ne_m
        longest_m = float(np.max(np.hypot(sides[..., 0], sides[..., 1]), initial=0.0))
        count = int(np.clip(math.ceil(longest_m / _SAMPLE_M) + 1, *_SAMPLES))
        u, v = (x.ravel() for x in np.meshgrid(*2 * [np.linspace(0.0, 1.0, count)]))
        shares = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v])  # (4, count^2)
        corners = self._rows_columns(corners_ne_m[..., 0], corners_ne_m[..., 1])  # (2, C, 4)
        grid = corners @ shares  # (2, C, count^2): cells of 1 km bend by 1 cm
        heights = _between(self.heights_m, grid)
        between_m = longest_m / (count - 1) / math.sqrt(2.0)
        highest_m = heights.max(axis=1) + self._steepest(grid) * between_m
        best = shares[:, heights.argmax(axis=1)]  # (4, C)
        return highest_m, np.einsum("kc,ckx->cx", best, corners_ne_m)

    def lowest_in_grid_amsl_m(
        self, north_edges_m: FloatArray, east_edges_m: FloatArray
    ) -> FloatArray:
        """Lower bound of the terrain in every cell of a grid.  (N + 1,), (E + 1,) -> (N, E).

        The lowest corner, less what the steepest slope of all may take away half a cell from it.
        """
        grid = self._rows_columns(*np.meshgrid(north_edges_m, east_edges_m, indexing="ij"))
        corner = _between(self.heights_m, grid)
        pairs = np.minimum(corner[1:], corner[:-1])
        half_m = 0.5 * math.hypot(np.diff(north_edges_m).max(), np.diff(east_edges_m).max())
        falls_m = self._steepest(grid.reshape(2, 1, -1)) * half_m
        return np.minimum(pairs[:, 1:], pairs[:, :-1]) - falls_m


def _between(values: NDArray[Any], at: FloatArray) -> FloatArray:
    """Bilinear interpolation, as at the edge beyond it.  (R, C), (2, ...) -> (...)."""
    between = scipy.ndimage.map_coordinates
    heights: FloatArray = between(values, at, output=np.float64, order=1, mode="nearest")
    return heights


Terrain = PeakTerrain | GridTerrain
"""Positions are in the local frame, in metres."""
