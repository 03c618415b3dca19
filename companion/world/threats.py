"""Radars (eq. 3) and zones (fences): what is known in advance, or told, and is not terrain.

A zone is a vertical cylinder or prism that the vehicle must stay out of, or, with keep_in, inside
of.  Its distance is positive where the vehicle may be.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import final

import numpy as np

from companion.geodesy import BoolArray, FloatArray

_AT_ONCE = 1_000_000  # pairs of points and edges


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Radar:
    """An enemy radar: a sphere of detection range about a point."""

    name: str
    centre_nea_m: tuple[float, float, float]
    range_m: float

    def distance_m(self, points_nea_m: FloatArray) -> FloatArray:
        """Distance of points from the radar, metres.  (..., 3) -> (...)."""
        offset = points_nea_m - np.asarray(self.centre_nea_m)
        return np.sqrt(np.einsum("...k,...k->...", offset, offset))


def detection_probability(
    distance_m: FloatArray, range_m: float | FloatArray, margin_m: float = 0.0
) -> FloatArray:
    """Eq. 3: R^4 / (R^4 + d^4) within the range (and a margin), 0 beyond it.  (...) -> (...)."""
    ratio = (distance_m / range_m) ** 4
    return np.where(distance_m <= range_m + margin_m, 1.0 / (1.0 + ratio), 0.0)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CircleZone:
    """A circle that the vehicle must stay out of, or inside of."""

    name: str
    """For people."""
    north_m: float
    """Of its centre."""
    east_m: float
    """Of its centre."""
    radius_m: float
    """Of the circle."""
    keep_in: bool = False
    """Whether to stay inside, instead of outside."""

    def distance_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Horizontal distance to the edge, negative where it is forbidden, metres.

        (...) x2 -> (...).
        """
        beyond = np.hypot(north_m - self.north_m, east_m - self.east_m) - self.radius_m
        return -beyond if self.keep_in else beyond


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PolygonZone:
    """A simple polygon that the vehicle must stay out of, or inside of."""

    name: str
    """For people."""
    vertices_ne_m: tuple[tuple[float, float], ...]
    """Its corners."""
    keep_in: bool = False
    """Whether to stay inside, instead of outside."""

    def distance_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Horizontal distance to the edge, negative where it is forbidden, metres.

        (...) x2 -> (...).  Distance to the nearest edge segment; inside by the even-odd rule.
        """
        shape = np.broadcast_shapes(np.shape(north_m), np.shape(east_m))
        result = np.empty(math.prod(shape))
        north, east = (np.broadcast_to(part, shape).reshape(-1, 1) for part in (north_m, east_m))
        edges = edges_of(self.vertices_ne_m)
        at_once = max(_AT_ONCE // len(edges), 1)
        for first in range(0, len(result), at_once):
            part = slice(first, first + at_once)
            result[part] = self._signed_m(north[part], east[part], edges)
        return result.reshape(shape)

    def _signed_m(self, north: FloatArray, east: FloatArray, edges: FloatArray) -> FloatArray:
        """As `distance_m`.  (N, 1) x2, (M, 4) -> (N,)."""
        an, ae, bn, be = edges.T
        dn, de = bn - an, be - ae
        squared = np.maximum(dn * dn + de * de, 1e-12)
        along = np.clip(((north - an) * dn + (east - ae) * de) / squared, 0.0, 1.0)
        nearest = np.hypot(north - an - along * dn, east - ae - along * de).min(axis=1)
        divisor = np.where(de == 0.0, 1.0, de)  # an edge that runs north crosses no line
        crosses = ((ae > east) != (be > east)) & (north < an + (east - ae) * dn / divisor)
        inside = np.count_nonzero(crosses, axis=1) % 2 == 1
        return np.where(inside != self.keep_in, -nearest, nearest)


Zone = CircleZone | PolygonZone


def is_near(zone: Zone, north_m: FloatArray, east_m: FloatArray, distance_m: float) -> BoolArray:
    """Where on a lattice a zone is nearer than a distance, or forbids to be.

    North (rows,), east (columns,), both evenly spaced and rising -> (rows, columns); the same as
    `zone.distance_m(...) < distance_m`.  Each edge of a polygon is looked at only where it is near,
    and what is inside is counted line by line.
    """
    if isinstance(zone, CircleZone) or distance_m < 0.0:
        gap = zone.distance_m(*np.broadcast_arrays(north_m[:, None], east_m[None, :]))
        return np.asarray(gap < distance_m)
    changes = np.zeros((len(north_m) + 1, len(east_m)), dtype=np.int32)
    near = np.zeros((len(north_m), len(east_m)), dtype=bool)
    for an, ae, bn, be in edges_of(zone.vertices_ne_m).tolist():
        rows = _between(north_m, min(an, bn) - distance_m, max(an, bn) + distance_m)
        columns = _between(east_m, min(ae, be) - distance_m, max(ae, be) + distance_m)
        if rows.start < rows.stop and columns.start < columns.stop:
            dn, de = bn - an, be - ae
            n, e = north_m[rows, None] - an, east_m[None, columns] - ae
            share = np.clip((n * dn + e * de) / max(dn * dn + de * de, 1e-12), 0.0, 1.0)
            n, e = n - share * dn, e - share * de
            near[rows, columns] |= n * n + e * e < distance_m * distance_m
        crossed = slice(*np.searchsorted(east_m, (min(ae, be), max(ae, be))))  # lines to the north
        if crossed.start < crossed.stop:
            at = an + (east_m[crossed] - ae) * (bn - an) / (be - ae)
            below = np.searchsorted(north_m, at)  # as many points lie south of the edge
            np.add.at(changes, (below, np.arange(crossed.start, crossed.stop)), 1)
    north_of = np.cumsum(changes[::-1], axis=0)[::-1][1:]  # edges to the north of each point
    inside = north_of % 2 == 1
    return near | (inside != zone.keep_in)


def _between(values: FloatArray, low: float, high: float) -> slice:
    first, last = np.searchsorted(values, (low, high))
    return slice(int(first), int(last))


@lru_cache(maxsize=64)
def edges_of(vertices_ne_m: tuple[tuple[float, float], ...]) -> FloatArray:
    """The edges of a polygon, north and east of both ends.  -> (M, 4)."""
    corners = np.array(vertices_ne_m, dtype=np.float64).reshape(-1, 2)
    edges = np.hstack([corners, np.roll(corners, -1, axis=0)])
    edges.setflags(write=False)
    return edges


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NearCells:
    """Cells of an area that may be near a zone: elsewhere no check is needed."""

    north_min_m: float
    east_min_m: float
    cell_m: float
    near: BoolArray  # (rows, columns)


_MAX_CELLS = 512  # across


@lru_cache(maxsize=4)
def near_cells(
    zones: tuple[Zone, ...],
    north_m: tuple[float, float],
    east_m: tuple[float, float],
    distance_m: float,
) -> NearCells:
    """The cells of an area with points nearer to a zone than a distance, or forbidden by it.

    Kept, and not to be changed.
    """
    most = max(north_m[1] - north_m[0], east_m[1] - east_m[0])
    cell_m = max(0.5 * distance_m, most / _MAX_CELLS)
    north, east = (
        low + cell_m * np.arange(0.5, math.ceil((high - low) / cell_m), dtype=np.float64)
        for low, high in (north_m, east_m)
    )
    near = np.zeros((len(north), len(east)), dtype=bool)
    for zone in zones:
        near |= is_near(zone, north, east, distance_m + math.sqrt(0.5) * cell_m)
    return NearCells(north_min_m=north_m[0], east_min_m=east_m[0], cell_m=cell_m, near=near)
