"""The true terrain: the paper's peaks (eq. 1) or a height grid.

In flight only the simulator has it.  Both answer the same two questions (`Terrain`): how high a
point is, and how high a box is at most.  `companion.sources.elevation` reads elevation files.
"""

import math
from dataclasses import dataclass, field
from typing import Any, Protocol, final

import numpy as np
import numpy.typing as npt

from companion.geodesy import FloatArray, LocalFrame, wrap_deg
from companion.world.lattice import IntArray

_NEGLIGIBLE_M = 1e-9
"""What all peaks that are left out of a sum may add up to; it is added."""
_FEW = 400
"""Points that are projected one by one; more of them on a lattice are interpolated."""
_NODES = 12
"""Chebyshev nodes a side: 0.1 mm on windows of 200 km below 70 degrees of latitude."""
_FINE_LINES = 2
"""Lines of a grid in a box up to which patches are cut at them: exact, at 16 points a box."""
_EARTH_M = 6.3e6
"""Less than any radius of the earth: what bends is taken to bend more."""


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
@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """One mountain of eq. 1: h exp(-((x - x0) / xs)^2 - ((y - y0) / ys)^2)."""

    north_m: float
    east_m: float
    height_amsl_m: float
    spread_north_m: float
    spread_east_m: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PeakTerrain:
    """The ground, and the highest (or the sum) of all peaks over it."""

    peaks: tuple[Peak, ...]
    ground_amsl_m: float
    sum_of_peaks: bool = False
    _columns: FloatArray = field(init=False, repr=False, compare=False)
    """(5, peaks), as the fields of `Peak`."""

    def __post_init__(self) -> None:
        rows = [
            (p.north_m, p.east_m, p.height_amsl_m, p.spread_north_m, p.spread_east_m)
            for p in self.peaks
        ]
        columns = np.array(rows, dtype=np.float64).reshape(-1, 5).T.copy()
        object.__setattr__(self, "_columns", columns)

    def height_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Terrain height, metres AMSL.  (...) x2 -> (...)."""
        return self.highest_in_box_m(north_m, north_m, east_m, east_m)

    def highest_in_box_m(
        self, south: FloatArray, north: FloatArray, west: FloatArray, east: FloatArray
    ) -> FloatArray:
        """Highest terrain of axis-aligned boxes, metres AMSL.  (...) x4 -> (...).

        A peak is highest at the box's nearest point to its centre; exact for the maximum of
        peaks, an upper bound for their sum.  Time depends on the peaks that matter somewhere in
        the boxes: the others are left out together (of a sum, up to a nanometre that is added).
        """
        shape = np.broadcast_shapes(np.shape(south), np.shape(west))
        if 0 in shape:
            return np.empty(shape)
        outline = np.min(south), np.max(north), np.min(west), np.max(east)
        near, rest = self._near(_highest_of_peak_m(self._columns, *outline))
        result = np.full(shape, rest if self.sum_of_peaks and self.peaks else -np.inf)
        for peak in self._columns[:, near].T:
            height = _highest_of_peak_m(peak, south, north, west, east)
            result = result + height if self.sum_of_peaks else np.maximum(result, height)
        return np.maximum(result, self.ground_amsl_m)

    def _near(self, most_m: FloatArray) -> tuple[IntArray, float]:
        """The peaks that count, given what each has at most, and a bound of the sum of the rest."""
        if not self.sum_of_peaks:
            return np.flatnonzero(most_m > self.ground_amsl_m), 0.0
        rising = np.argsort(np.abs(most_m), kind="stable")
        total = np.cumsum(np.abs(most_m[rising]))
        left_out = int(np.searchsorted(total, _NEGLIGIBLE_M, side="right"))
        rest = float(total[left_out - 1]) if left_out else 0.0
        return np.sort(rising[left_out:]), rest


def _highest_of_peak_m(
    peak: FloatArray, south: Any, north: Any, west: Any, east: Any
) -> FloatArray:
    """What a peak (or each, (5, peaks)) has at most in boxes: at their nearest points to it."""
    north_0, east_0, top, spread_north, spread_east = peak
    x = (np.clip(north_0, south, north) - north_0) / spread_north
    y = (np.clip(east_0, west, east) - east_0) / spread_east
    height: FloatArray = top * np.exp(-(x**2) - y**2)
    return height


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GridTerrain:
    """Heights at the nodes of a grid in latitude and longitude, bilinear in these between them.

    The grid stays in the coordinates that its file has it in, so that no resampling comes between
    the file and the terrain.  Beyond its edge the terrain goes on as at the edge.
    """

    frame: LocalFrame
    heights_m: npt.NDArray[Any]
    """(rows, columns) AMSL, of the file's own type; rows to the north, columns to the east."""
    south_deg: float
    west_deg: float
    """Latitude and longitude of node (0, 0)."""
    step_north_deg: float
    step_east_deg: float

    def height_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Terrain height, metres AMSL.  (...) x2 -> (...)."""
        return _bilinear_m(self.heights_m, *self._nodes(np.asarray(north_m), np.asarray(east_m)))

    def highest_in_box_m(
        self, south: FloatArray, north: FloatArray, west: FloatArray, east: FloatArray
    ) -> FloatArray:
        """Upper bound of the terrain in axis-aligned boxes, metres AMSL.  (...) x4 -> (...).

        A bilinear patch is highest at a corner of the rectangle that one looks at.  Boxes smaller
        than about two cells of the grid: the corners of all patches in the box's outline in
        latitude and longitude (a box at 1 degree of convergence grows by 2 %); larger ones: the
        nodes in and next to it.
        """
        low, high = self._outlines(south, north, west, east)
        return _highest_between_m(self.heights_m, low, high)

    def _nodes(self, north_m: FloatArray, east_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fractional row and column of points.  (...) x2 -> (...) x2."""
        outer = north_m.ndim == east_m.ndim == 2 and north_m.shape[1] == east_m.shape[0] == 1
        if not outer or north_m.size * east_m.size <= _FEW:
            return self._projected(*np.broadcast_arrays(north_m, east_m))
        north_at, from_north = _chebyshev(north_m[:, 0])
        east_at, from_east = _chebyshev(east_m[0])
        row, column = self._projected(*np.meshgrid(north_at, east_at, indexing="ij"))
        return from_north @ row @ from_east.T, from_north @ column @ from_east.T

    def _projected(self, north_m: FloatArray, east_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fractional row and column of points, each projected.  (...) x2 -> (...) x2."""
        latitude, longitude = self.frame.to_geodetic_deg(north_m, east_m)
        half = 0.5 * self.step_east_deg * (self.heights_m.shape[1] - 1)
        off_middle = wrap_deg(self.frame.longitude_deg - self.west_deg - half)
        east = wrap_deg(longitude - self.frame.longitude_deg) + off_middle + half
        return (latitude - self.south_deg) / self.step_north_deg, east / self.step_east_deg

    def _outlines(
        self, south: FloatArray, north: FloatArray, west: FloatArray, east: FloatArray
    ) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        """Lowest and highest fractional row and column of boxes.  (...) x4 -> 2 x (...) x2.

        Those of the corners, and a little more: the sides bend by side^2 / 8 over the curvature
        radius of a straight line's image, R / 2 (1 + tan(latitude)), and a millimetre.
        """
        corners = [
            self._nodes(np.asarray(n), np.asarray(e)) for n in (south, north) for e in (west, east)
        ]
        sides = np.subtract(north, south), np.subtract(east, west)
        side = float(max(np.max(each, initial=0.0) for each in sides))
        edge_deg = abs(self.south_deg) + self.step_north_deg * self.heights_m.shape[0]
        steep = 1.0 + math.tan(math.radians(min(edge_deg, 89.0)))
        slack_deg = math.degrees((side**2 / 4.0 * steep / _EARTH_M + 1e-3) / _EARTH_M)
        slack_row = slack_deg / self.step_north_deg
        slack_column = slack_deg / math.cos(math.radians(min(edge_deg, 89.0))) / self.step_east_deg
        if side == 0.0:
            slack_row = slack_column = 0.0
        rows, columns = (np.stack([corner[axis] for corner in corners]) for axis in (0, 1))
        return (
            (rows.min(axis=0) - slack_row, columns.min(axis=0) - slack_column),
            (rows.max(axis=0) + slack_row, columns.max(axis=0) + slack_column),
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArrayTerrain:
    """Heights at the nodes of a square lattice in the local frame, bilinear between them.

    Beyond its edge the terrain goes on as at the edge.
    """

    heights_m: npt.NDArray[Any]
    """(rows, columns) AMSL; rows to the north, columns to the east."""
    spacing_m: float
    south_m: float = 0.0
    """North of the nodes of row 0."""
    west_m: float = 0.0
    """East of the nodes of column 0."""

    def height_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Terrain height, metres AMSL.  (...) x2 -> (...)."""
        return _bilinear_m(self.heights_m, *self._nodes(north_m, east_m))

    def highest_in_box_m(
        self, south: FloatArray, north: FloatArray, west: FloatArray, east: FloatArray
    ) -> FloatArray:
        """Upper bound of the terrain in axis-aligned boxes, metres AMSL.  (...) x4 -> (...).

        Exact in boxes of up to three cells; of larger ones the nodes in and next to them.
        """
        low, high = self._nodes(south, west), self._nodes(north, east)
        return _highest_between_m(self.heights_m, low, high)

    def _nodes(self, north_m: FloatArray, east_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fractional row and column of points.  (...) x2 -> (...) x2."""
        north, east = np.broadcast_arrays(north_m, east_m)
        return (north - self.south_m) / self.spacing_m, (east - self.west_m) / self.spacing_m


_Nodes = tuple[FloatArray, FloatArray]
"""Fractional rows and columns of a grid."""


def _bilinear_m(heights_m: npt.NDArray[Any], row: FloatArray, column: FloatArray) -> FloatArray:
    """Height at fractional nodes.  (rows, columns), (...) x2 -> (...)."""
    rows, columns = heights_m.shape
    row, column = np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)
    i = np.minimum(row.astype(np.intp), max(rows - 2, 0))
    j = np.minimum(column.astype(np.intp), max(columns - 2, 0))
    u, v = row - i, column - j
    i_next, j_next = np.minimum(i + 1, rows - 1), np.minimum(j + 1, columns - 1)
    sw, se = heights_m[i, j].astype(float), heights_m[i, j_next].astype(float)
    nw, ne = heights_m[i_next, j], heights_m[i_next, j_next]
    south = sw + v * (se - sw)
    north = nw * (1.0 - v) + v * ne
    return np.asarray(south + u * (north - south))


def _highest_between_m(heights_m: npt.NDArray[Any], low: _Nodes, high: _Nodes) -> FloatArray:
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


def _highest_node_m(heights_m: npt.NDArray[Any], low: _Nodes, high: _Nodes) -> FloatArray:
    """Highest node in and next to boxes of fractional nodes.  2 x (...) x2 -> (...).

    Maxima over squares as wide as the narrowest box, once for all, then a few squares a box.
    """
    first, last, count = [], [], []
    for a, b, size in zip(low, high, heights_m.shape, strict=True):
        first.append(np.clip(np.floor(a).astype(np.intp), 0, size - 1))
        last.append(np.clip(np.ceil(b).astype(np.intp), 0, size - 1))
        count.append(last[-1] - first[-1] + 1)
    start = [int(index.min()) for index in first]
    window = heights_m[start[0] : last[0].max() + 1, start[1] : last[1].max() + 1]
    width = [int(c.min()) for c in count]
    for wanted in width:  # of the maxima from each node on, down the rows, then the columns
        done = 1
        while done < wanted:
            more = min(done, wanted - done)
            window, done = np.maximum(window[:-more], window[more:]), done + more
        window = window.T
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
