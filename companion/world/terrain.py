"""The true terrain: the paper's peaks (eq. 1) or a height grid.

In flight only the simulator has it.  Both answer the same two questions (`Terrain`): how high a
point is, and how high a box is at most.  `companion.sources.elevation` reads elevation files.
"""

import abc
import math
from dataclasses import astuple, dataclass
from typing import Any, Protocol, final

import numpy as np
import numpy.typing as npt
import pyproj
import scipy

from companion.geodesy import FloatArray, LocalFrame, wrap_deg
from companion.ranges import Altitude, Horizontal, Spread

_FEW = 400  # points that are projected one by one; more of them on a lattice are interpolated
_NODES = 12  # Chebyshev nodes a side: 0.1 mm on windows of 200 km below 70 degrees of latitude
_FINE_LINES = 2
"""Lines of a grid in a box up to which patches are cut at them: exact, at 16 points a box."""
_DEG_M = 111_194.0  # of the mean sphere
_NODE_ERROR = 1e-4  # of a cell: more than what interpolation between Chebyshev nodes makes
_Places = tuple[FloatArray, FloatArray]  # fractional rows and columns of a grid


class Terrain(Protocol):
    """What the ground is like, in the local frame."""

    def height_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Terrain height, metres AMSL.  (...) x2 -> (...)."""
        ...

    def highest_in_box_m(
        self, south: FloatArray, north: FloatArray, west: FloatArray, east: FloatArray
    ) -> FloatArray:
        """Upper bound of the terrain in axis-aligned boxes, metres AMSL.  (...) x4 -> (...)."""
        ...


@final
@dataclass(frozen=True, slots=True)
class Peak:
    """One mountain of eq. 1: h exp(-((x - x0) / xs)^2 - ((y - y0) / ys)^2)."""

    north_m: Horizontal
    east_m: Horizontal
    height_amsl_m: Altitude
    spread_north_m: Spread
    spread_east_m: Spread


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PeakTerrain:
    """The ground, and the highest (or the sum) of all peaks over it."""

    peaks: tuple[Peak, ...]
    ground_amsl_m: float
    sum_of_peaks: bool = False

    def height_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Terrain height, metres AMSL.  (...) x2 -> (...)."""
        return self.highest_in_box_m(north_m, north_m, east_m, east_m)

    def highest_in_box_m(
        self, south: FloatArray, north: FloatArray, west: FloatArray, east: FloatArray
    ) -> FloatArray:
        """Highest terrain of axis-aligned boxes, metres AMSL.  (...) x4 -> (...).

        A peak is highest at the box's nearest point to its centre; exact for the maximum of
        peaks, an upper bound for their sum.  Time of a maximum depends on the peaks that rise above
        the ground somewhere in the boxes.
        """
        shape = np.broadcast_shapes(np.shape(south), np.shape(west))
        if 0 in shape:
            return np.empty(shape)
        adds = self.sum_of_peaks and bool(self.peaks)
        peaks = np.array([astuple(peak) for peak in self.peaks]).reshape(-1, 5).T
        result = np.full(shape, 0.0 if adds else -np.inf)
        if not adds:
            outline = np.min(south), np.max(north), np.min(west), np.max(east)
            peaks = peaks[:, _highest_of_peak_m(peaks, *outline) > self.ground_amsl_m]
        for peak in peaks.T:
            height = _highest_of_peak_m(peak, south, north, west, east)
            result = result + height if adds else np.maximum(result, height)
        return np.maximum(result, self.ground_amsl_m)


def _highest_of_peak_m(
    peak: FloatArray, south: Any, north: Any, west: Any, east: Any
) -> FloatArray:
    """What a peak (or each, (5, peaks)) has at most in boxes: at their nearest points to it."""
    north_0, east_0, top, spread_north, spread_east = peak
    x = (np.clip(north_0, south, north) - north_0) / spread_north
    y = (np.clip(east_0, west, east) - east_0) / spread_east
    height: FloatArray = top * np.exp(-(x**2) - y**2)
    return height


class _Nodes(abc.ABC):
    """Heights at the nodes of a grid, bilinear between them, and beyond its edge as at the edge."""

    heights_m: npt.NDArray[Any]
    """(rows, columns) AMSL, of any type; rows to the north, columns to the east."""

    @abc.abstractmethod
    def _nodes(self, north_m: FloatArray, east_m: FloatArray) -> _Places:
        """Fractional row and column of points.  (...) x2 -> (...) x2."""

    def height_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Terrain height, metres AMSL.  (...) x2 -> (...)."""
        return _bilinear_m(self.heights_m, *self._nodes(np.asarray(north_m), np.asarray(east_m)))

    def highest_in_box_m(
        self, south: FloatArray, north: FloatArray, west: FloatArray, east: FloatArray
    ) -> FloatArray:
        """Upper bound of the terrain in axis-aligned boxes, metres AMSL.  (...) x4 -> (...).

        A bilinear patch is highest at a corner of the rectangle that one looks at: exact in the
        outline of a box of up to three cells; of larger ones the nodes in and next to it.
        """
        return _highest_between_m(self.heights_m, *self._outlines(south, north, west, east))

    def _outlines(
        self, south: FloatArray, north: FloatArray, west: FloatArray, east: FloatArray
    ) -> tuple[_Places, _Places]:
        """Lowest and highest fractional row and column of boxes.  (...) x4 -> 2 x (...) x2."""
        return self._nodes(south, west), self._nodes(north, east)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GridTerrain(_Nodes):
    """Heights at the nodes of a grid in the coordinates that its file has, bilinear in these.

    It stays in them, so that no resampling comes between the file and the terrain.
    """

    frame: LocalFrame
    heights_m: npt.NDArray[Any]
    south: float
    west: float
    """Coordinates of node (0, 0): degrees, or what `projection` makes of them."""
    step_north: float
    step_east: float
    projection: pyproj.Transformer | None = None
    """From longitude and latitude, degrees, to east and north; None: the grid is in degrees."""

    @property
    def cell_m(self) -> float:
        """The longer side of a cell, at the equator if the grid is in degrees."""
        step = max(self.step_north, self.step_east)
        if self.projection is None:
            return step * _DEG_M
        assert self.projection.target_crs is not None  # it is made of two
        return float(step * self.projection.target_crs.axis_info[0].unit_conversion_factor)

    def nodes(self, north_m: FloatArray, east_m: FloatArray) -> _Places:
        """Fractional row and column of points, each projected.  (...) x2 -> (...) x2.

        Not finite where a projection does not reach.
        """
        latitude, longitude = self.frame.to_geodetic_deg(north_m, east_m)
        if self.projection is not None:
            x, y = self.projection.transform(longitude, latitude)
            return (y - self.south) / self.step_north, (x - self.west) / self.step_east
        half = 0.5 * self.step_east * (self.heights_m.shape[1] - 1)
        off_middle = wrap_deg(self.frame.longitude_deg - self.west - half)
        east = wrap_deg(longitude - self.frame.longitude_deg) + off_middle + half
        return (latitude - self.south) / self.step_north, east / self.step_east

    def _nodes(self, north_m: FloatArray, east_m: FloatArray) -> _Places:
        outer = north_m.ndim == east_m.ndim == 2 and north_m.shape[1] == east_m.shape[0] == 1
        if not outer or north_m.size * east_m.size <= _FEW:
            return self.nodes(*np.broadcast_arrays(north_m, east_m))
        north_at, from_north = _chebyshev(north_m[:, 0])
        east_at, from_east = _chebyshev(east_m[0])
        row, column = self.nodes(*np.meshgrid(north_at, east_at, indexing="ij"))
        return from_north @ row @ from_east.T, from_north @ column @ from_east.T

    def _outlines(
        self, south: FloatArray, north: FloatArray, west: FloatArray, east: FloatArray
    ) -> tuple[_Places, _Places]:
        """Those of the corners, and a little more: the sides bend, most in their middles."""
        south, north, west, east = (np.asarray(side) for side in (south, north, west, east))
        corners = np.array([[self._nodes(n, e) for e in (west, east)] for n in (south, north)])
        bends = np.abs([  # of two sides; those across from them bend alike
            self._nodes(0.5 * (south + north), west) - corners[:, 0].mean(axis=0),
            self._nodes(south, 0.5 * (west + east)) - corners[0].mean(axis=0),
        ])  # fmt: skip
        slack = 2.0 * bends.max(axis=0) + _NODE_ERROR  # (2, ...)
        low, high = corners.min(axis=(0, 1)) - slack, corners.max(axis=(0, 1)) + slack
        return (low[0], low[1]), (high[0], high[1])


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArrayTerrain(_Nodes):
    """Heights at the nodes of a square lattice in the local frame."""

    heights_m: npt.NDArray[Any]
    spacing_m: float
    south_m: float = 0.0
    """North of the nodes of row 0."""
    west_m: float = 0.0
    """East of the nodes of column 0."""

    def _nodes(self, north_m: FloatArray, east_m: FloatArray) -> _Places:
        north, east = np.broadcast_arrays(north_m, east_m)
        return (north - self.south_m) / self.spacing_m, (east - self.west_m) / self.spacing_m


def _bilinear_m(heights_m: npt.NDArray[Any], row: FloatArray, column: FloatArray) -> FloatArray:
    """Height at fractional nodes.  (rows, columns), (...) x2 -> (...)."""
    rows, columns = heights_m.shape
    row, column = np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)
    i, j = row.astype(np.intp), column.astype(np.intp)
    u, v = row - i, column - j
    i_next, j_next = np.minimum(i + 1, rows - 1), np.minimum(j + 1, columns - 1)
    sw, se, nw, ne = (
        heights_m[corner].astype(float)
        for corner in ((i, j), (i, j_next), (i_next, j), (i_next, j_next))
    )
    south, north = sw + v * (se - sw), nw + v * (ne - nw)  # of flat ground exactly its height
    return np.asarray(south + u * (north - south))


def _highest_between_m(heights_m: npt.NDArray[Any], low: _Places, high: _Places) -> FloatArray:
    """Highest of a bilinear surface in boxes of fractional nodes.  2 x (...) x2 -> (...)."""
    lines = [
        int(np.max(np.ceil(b) - np.floor(a) - 1, initial=0)) for a, b in zip(low, high, strict=True)
    ]
    if max(lines) > _FINE_LINES:
        return _highest_node_m(heights_m, low, high)
    u, v = (
        [a, *(np.clip(np.floor(a) + k, a, b) for k in range(1, count + 1)), b]
        for a, b, count in zip(low, high, lines, strict=True)
    )
    result = np.full(np.shape(low[0]), -np.inf)
    for row in u:
        for column in v:
            np.maximum(result, _bilinear_m(heights_m, row, column), out=result)
    return result


def _highest_node_m(heights_m: npt.NDArray[Any], low: _Places, high: _Places) -> FloatArray:
    """Highest node in and next to boxes of fractional nodes.  2 x (...) x2 -> (...).

    Maxima over squares as wide as the narrowest box, once for all, then a few squares a box.
    """
    most = np.reshape(heights_m.shape, (2, *(1 for _ in low[0].shape))) - 1
    first = np.clip(np.floor(low), 0, most).astype(np.intp)  # (2, ...)
    last = np.clip(np.ceil(high), 0, most).astype(np.intp)
    count = last - first + 1
    start, width = ([int(indices.min()) for indices in parts] for parts in (first, count))
    window = heights_m[start[0] : last[0].max() + 1, start[1] : last[1].max() + 1]
    # of squares as wide as the narrowest box, from each node on to the north and east
    window = scipy.ndimage.maximum_filter(window, size=width, origin=[-(w // 2) for w in width])
    result = np.full(first[0].shape, -np.inf)
    for i in range(0, int(count[0].max()), width[0]):
        row = np.minimum(first[0] + i, last[0] + 1 - width[0]) - start[0]
        for j in range(0, int(count[1].max()), width[1]):
            column = np.minimum(first[1] + j, last[1] + 1 - width[1]) - start[1]
            np.maximum(result, window[row, column], out=result)
    return result


def _chebyshev(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Nodes in the span of points, and the weights that lead from values there to the points.

    (K,) -> (_NODES,), (K, _NODES).
    """
    middle, half = 0.5 * (points.min() + points.max()), max(0.5 * np.ptp(points), 1.0)
    nodes = np.cos((np.arange(_NODES) + 0.5) * math.pi / _NODES)
    basis = np.polynomial.chebyshev.chebvander(nodes, _NODES - 1)
    weights = np.polynomial.chebyshev.chebvander((points - middle) / half, _NODES - 1)
    return middle + half * nodes, weights @ np.linalg.inv(basis)
