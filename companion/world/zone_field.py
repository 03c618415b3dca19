"""Distances to zones on a lattice: about right, for thousands of places at once.

How exact they are is known (`error_m`); where that matters, `ZoneIndex` is asked.  Each edge is
read once, however many places there are.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
import scipy

from companion.geodesy import BoolArray, FloatArray
from companion.world.threats import CircleZone
from companion.world.zone_index import ZoneIndex

_ACROSS = 128  # nodes of a side
_ASIDE = 0.37  # of a cell: corners at round numbers do not lie where cells meet
_STEP = 0.5  # cells between two samples of an edge
_ERROR = math.sqrt(0.5) * 2.0 + 0.5 * _STEP
"""Cells: a node from the middle of the cell of a sample, that from an edge, a place from a node."""
_SLIVER = 4  # cells: smaller parts between edges count as edges


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ZoneField:
    """Distances to the nearest edge of a zone at the nodes of a lattice, negative in zones."""

    index: ZoneIndex
    south_m: float
    west_m: float
    cell_m: float
    most_m: float
    gap_m: FloatArray  # (rows, columns)

    @property
    def error_m(self) -> float:
        """How far a distance may be wrong where nothing is forbidden."""
        return _ERROR * self.cell_m

    def gaps_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """About the distance to the nearest zone; negative where one forbids to be.

        (...) x2 -> (...).  Bilinear between the nodes.
        """
        at = np.stack([north_m - self.south_m, east_m - self.west_m]) / self.cell_m
        found = scipy.ndimage.map_coordinates(self.gap_m, at, order=1, mode="nearest")
        return np.asarray(found)

    def keeps(self, north_m: FloatArray, east_m: FloatArray, gap_m: float) -> BoolArray:
        """Whether zones are no nearer than that, exactly: the index is asked about close calls.

        (...) x2 -> (...).  gap_m: no more than what the field was made for.
        """
        about_m = self.gaps_m(north_m, east_m)
        kept = np.asarray(about_m - self.error_m >= max(gap_m, 0.0))
        close = ~kept & ((about_m + self.error_m >= gap_m) | (gap_m < -self.most_m))
        told_m = self.index.gaps_m(north_m[close], east_m[close], max(gap_m, 0.0) + 1.0)
        kept[close] = told_m >= gap_m
        return kept


def zone_field(
    index: ZoneIndex, low_ne_m: FloatArray, high_ne_m: FloatArray, most_m: float
) -> ZoneField:
    """The field about an area, for distances of up to most_m from zones.

    low_ne_m, high_ne_m: its south-western and north-eastern corner.
    """
    side_m = float((high_ne_m - low_ne_m).max()) + 2.0 * most_m
    cell_m = side_m / (_ACROSS - 2)
    middle = 0.5 * (low_ne_m + high_ne_m)
    south, west = (float(value) - 0.5 * side_m - _ASIDE * cell_m for value in middle)
    gap_m = _to_polygons(index, south, west, cell_m, most_m + _ERROR * cell_m)
    nodes: FloatArray = np.arange(_ACROSS, dtype=np.float64) * cell_m
    for circle in index.circles:
        _lower(gap_m, south + nodes, west + nodes, circle, most_m + _ERROR * cell_m)
    return ZoneField(
        index=index, south_m=south, west_m=west, cell_m=cell_m, most_m=most_m, gap_m=gap_m
    )


def _to_polygons(
    index: ZoneIndex, south: float, west: float, cell_m: float, most_m: float
) -> FloatArray:
    """Distances of the nodes to polygons: to edges by their cells, which part what is inside."""
    edges = index.edges.reshape(4, -1) - np.array([south, west, south, west])[:, None]
    on_edge = _cells_of(edges / cell_m)
    if not len(index.polygons):
        return np.full(on_edge.shape, most_m)
    parts, count = scipy.ndimage.label(~on_edge)
    some = np.empty(count + 1, dtype=np.intp)
    some[parts.ravel()] = np.arange(parts.size)  # of each part, one of its nodes
    asked = 1 + np.flatnonzero(np.bincount(parts.ravel())[1:] >= _SLIVER)
    row, column = np.divmod(some[asked], _ACROSS)
    forbidden = index.polygons_forbid(south + row * cell_m, west + column * cell_m)
    sign = np.zeros(count + 1)
    sign[asked] = np.where(forbidden, -1.0, 1.0)
    if on_edge.any():
        apart = scipy.ndimage.distance_transform_edt(~on_edge) * cell_m
    else:
        apart = np.full(on_edge.shape, np.inf)
    return np.asarray(np.clip(sign[parts] * apart, -_ACROSS * cell_m, most_m))


def _cells_of(edges: FloatArray) -> BoolArray:
    """The cells about nodes that edges pass through.  (4, M), in cells -> (rows, columns)."""
    inside, first, last = _clipped(edges, -1.0, float(_ACROSS))
    an, ae, bn, be = edges[:, inside]
    dn, de, first, last = bn - an, be - ae, first[inside], last[inside]
    count = np.ceil(np.hypot(dn, de) * (last - first) / _STEP).astype(np.intp) + 1
    edge = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    share = (first + (last - first) / np.maximum(count - 1, 1))[edge]
    share = first[edge] + number * (share - first[edge])
    row, column = (
        np.rint(begin[edge] + share * along[edge]).astype(np.intp)
        for begin, along in ((an, dn), (ae, de))
    )
    on = (row >= 0) & (row < _ACROSS) & (column >= 0) & (column < _ACROSS)
    cells = np.zeros((_ACROSS, _ACROSS), dtype=bool)
    cells[row[on], column[on]] = True
    return cells


def _clipped(
    edges: FloatArray, low: float, high: float
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Which edges come into a square, and from which share of them to which they are in it."""
    an, ae, bn, be = edges
    first, last = np.zeros(len(an)), np.ones(len(an))
    for begin, along in ((an, bn - an), (ae, be - ae)):
        still = along == 0.0
        divisor = np.where(still, 1.0, along)
        one, other = (low - begin) / divisor, (high - begin) / divisor
        beside = still & ((begin < low) | (begin > high))
        first = np.maximum(first, np.where(still, 0.0, np.minimum(one, other)))
        last = np.minimum(
            last, np.where(still, np.where(beside, -1.0, 1.0), np.maximum(one, other))
        )
    return first <= last, first, last


def _lower(
    gap_m: FloatArray, north_m: FloatArray, east_m: FloatArray, circle: CircleZone, most_m: float
) -> None:
    """Lower distances where a circle is nearer.  (rows, columns), (rows,), (columns,)."""
    far_m = np.inf if circle.keep_in else circle.radius_m + most_m
    rows, columns = (
        slice(*np.searchsorted(nodes, (middle - far_m, middle + far_m)))
        for nodes, middle in ((north_m, circle.north_m), (east_m, circle.east_m))
    )
    part = gap_m[rows, columns]
    told_m = circle.distance_m(north_m[rows, None], east_m[None, columns])
    np.minimum(part, told_m, out=part)
