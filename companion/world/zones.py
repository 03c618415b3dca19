"""Zones (fences): circles and polygons that the vehicle must stay out of, or inside of.

A zone is a vertical cylinder or prism, as high as the sky.  Its distance is horizontal, to its
edge, and negative where it forbids to be; that from several zones is the least of theirs.

It is written down twice, over the same `ZoneTable`, and tests hold the two against each other:
`gaps_m` for arrays of points, in numpy, for the part that decides; and for a point or a segment
plain scalar code that the planner compiles (`planner.kernels`), for search, guidance and proof.
Edges of polygons lie in groups with a box about each: a fence of hundreds of edges costs little
more than one of ten.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, final

import numpy as np

from companion.geodesy import BoolArray, FloatArray
from companion.world.columns import Segment

_GROUP = 16
"""Edges to a box: 16 is faster than 8, with 50 x 100 corners and with 2,000 (measured)."""
_AT_ONCE = 60_000
"""Pairs of a point and a group: arrays of 0.5 MB, twice as fast as of 3 MB (measured)."""
_MOST_CELLS = 512
"""Cells of `near_cells` across: 0.25 MB, made in some 0.1 s."""
_NO_LENGTH_M2 = 1e-12
"""An edge shorter than a micrometre is a point."""
_FAR_M = 1e12
"""Farther than anything on earth, and small enough to calculate with."""
_TOUCHING_M = 1e-9
"""Looked for at least so far from a segment, so that edges that touch it are seen (rounding)."""


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
        """`gaps_m` from this zone alone."""
        return gaps_m(packed((self,)), north_m, east_m)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PolygonZone:
    """A polygon that the vehicle must stay out of, or inside of; inside is by the even-odd rule."""

    name: str
    """For people."""
    vertices_ne_m: tuple[tuple[float, float], ...]
    """Its corners."""
    keep_in: bool = False
    """Whether to stay inside, instead of outside."""

    def distance_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """`gaps_m` from this zone alone."""
        return gaps_m(packed((self,)), north_m, east_m)


Zone = CircleZone | PolygonZone


class ZoneTable(NamedTuple):
    """Zones as plain arrays.  Boxes are edges to the south, north, west and east."""

    circles: FloatArray  # (K, 4): north, east, radius; 1 to stay out, -1 to stay inside
    polygons: FloatArray  # (Z, 7): first group, and the one after the last; 1 or -1; box
    groups: FloatArray  # (G, 5): box of each; how many edges it has
    edges: FloatArray  # (G, 16, 4): north, east of both ends; short groups end with points


@lru_cache(maxsize=256)
def packed(zones: tuple[Zone, ...]) -> ZoneTable:
    """Zones as plain arrays; kept, and not to be changed."""
    circles, polygons = list[tuple[float, ...]](), list[tuple[float, ...]]()
    groups, edges = [np.empty((0, 5))], [np.empty((0, _GROUP, 4))]
    first = 0
    for zone in zones:
        sign = -1.0 if zone.keep_in else 1.0
        if isinstance(zone, CircleZone):
            circles.append((zone.north_m, zone.east_m, zone.radius_m, sign))
            continue
        corners = np.array(zone.vertices_ne_m, dtype=np.float64).reshape(-1, 2)
        count = -(-len(corners) // _GROUP)
        mine = np.tile(corners[0], (count * _GROUP, 2))  # the first corner ends the last edge
        mine[: len(corners)] = np.hstack([corners, np.roll(corners, -1, axis=0)])
        ends = mine.reshape(count, 2 * _GROUP, 2)
        low, high = ends.min(axis=1), ends.max(axis=1)
        own = np.minimum(len(corners) - _GROUP * np.arange(count), _GROUP)
        groups.append(np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1], own], axis=1))
        edges.append(mine.reshape(count, _GROUP, 4))
        low, high = corners.min(axis=0), corners.max(axis=0)
        polygons.append((first, first + count, sign, low[0], high[0], low[1], high[1]))
        first += count
    return ZoneTable(
        circles=np.array(circles, dtype=np.float64).reshape(-1, 4),
        polygons=np.array(polygons, dtype=np.float64).reshape(-1, 7),
        groups=np.concatenate(groups),
        edges=np.concatenate(edges),
    )


# --- many points at once


def gaps_m(
    zones: ZoneTable,
    north_m: FloatArray,
    east_m: FloatArray,
    within_m: float | FloatArray = math.inf,
) -> FloatArray:
    """Distance of points to the nearest zone, negative where one forbids to be, metres.

    (...) x2 or x3 -> (...).  within_m: farther ones count as so far away (inf without zones).
    """
    shape = np.broadcast_shapes(np.shape(north_m), np.shape(east_m))
    north, east, result = (
        np.array(np.broadcast_to(part, shape), dtype=np.float64).reshape(-1)
        for part in (north_m, east_m, within_m)
    )
    for middle_n, middle_e, radius_m, sign in zones.circles.tolist():
        away_m = np.hypot(north - middle_n, east - middle_e)
        np.minimum(result, sign * (away_m - radius_m), out=result)
    if len(result) and len(zones.polygons):
        low, high = (north.min(), east.min()), (north.max(), east.max())
        may_matter = _may_matter(zones.polygons[:, 2:], low, high, result.max())
        for polygon in zones.polygons[may_matter]:
            apart_m2 = _box_gaps_m2(polygon[3:], north, east)
            some = np.flatnonzero((apart_m2 <= np.maximum(result, 0.0) ** 2) | (polygon[2] < 0.0))
            step = max(int(_AT_ONCE / (polygon[1] - polygon[0])), 1)
            for part in (some[k : k + step] for k in range(0, len(some), step)):
                here = north[part], east[part]
                result[part] = _from_polygon_m(zones, polygon, *here, result[part])
    return result.reshape(shape)


def near(
    zones: tuple[Zone, ...],
    low_ne_m: tuple[float, float],
    high_ne_m: tuple[float, float],
    within_m: float,
) -> list[Zone]:
    """Zones that may be nearer than that to some point of an area, or forbid it, by their boxes.

    low_ne_m, high_ne_m: its south-western and north-eastern corner.
    """
    table = packed(zones)
    n, e, radius, sign = table.circles.T
    circles = np.stack([sign, n - radius, n + radius, e - radius, e + radius], axis=1)
    boxes = np.concatenate([circles, table.polygons[:, 2:]])
    in_order = sorted(zones, key=lambda zone: not isinstance(zone, CircleZone))  # as in the table
    found = np.flatnonzero(_may_matter(boxes, low_ne_m, high_ne_m, within_m))
    return [in_order[k] for k in found]


def nearest(zones: tuple[Zone, ...], north_m: float, east_m: float) -> tuple[Zone | None, float]:
    """The zone that is the nearest to a point, or forbids it the most, and its distance, metres."""
    here, at = (north_m, east_m), (np.asarray(north_m), np.asarray(east_m))
    gap_m = float(gaps_m(packed(zones), *at))
    rivals = near(zones, here, here, max(gap_m, 0.0) + 1.0)
    return min(rivals, key=lambda zone: float(zone.distance_m(*at)), default=None), gap_m


def _may_matter(
    boxes: FloatArray, low: tuple[float, float], high: tuple[float, float], within_m: float
) -> BoolArray:
    """Which zones may be nearer than that to some point of an area, or forbid it.

    (Z, 5): 1 or -1 as in the table, and the box -> (Z,).
    """
    sign, south, north, west, east = boxes.T
    gap_n = np.maximum(np.maximum(south - high[0], low[0] - north), 0.0)
    gap_e = np.maximum(np.maximum(west - high[1], low[1] - east), 0.0)
    apart_m = np.hypot(gap_n, gap_e)
    return np.asarray((apart_m < within_m) | (apart_m == 0.0) | (sign < 0.0))


def _from_polygon_m(
    table: ZoneTable, polygon: FloatArray, north: FloatArray, east: FloatArray, enough_m: FloatArray
) -> FloatArray:
    """Distances to a polygon, a row of the table; `enough_m` at most.  (P,) x3 -> (P,)."""
    which = slice(int(polygon[0]), int(polygon[1]))
    edges, boxes = table.edges[which], table.groups[which, :4].T
    n, e = north[:, None], east[:, None]
    _, top, west, east_most = boxes
    point, group = np.nonzero((west <= e) & (e <= east_most) & (n <= top))
    an, ae, bn, be = np.moveaxis(edges[group], -1, 0)  # (X, 16)
    dn, de = bn - an, be - ae
    n_on, e_on = north[point, None], east[point, None]
    divisor = np.where(de == 0.0, 1.0, de)  # an edge that runs north crosses no line
    crosses = ((ae > e_on) != (be > e_on)) & (n_on < an + (e_on - ae) * dn / divisor)
    count = np.bincount(point, np.count_nonzero(crosses, axis=1), minlength=len(north))
    forbidden = (count % 2.0 == 1.0) == (polygon[2] > 0.0)

    apart_m2 = _box_gaps_m2(boxes, n, e)  # (P, groups)
    corner = edges[apart_m2.argmin(axis=1), 0]  # no edge need be looked for beyond it
    nearest_m2 = (north - corner[:, 0]) ** 2 + (east - corner[:, 1]) ** 2
    most_m2 = np.where(forbidden, math.inf, np.maximum(enough_m, 0.0) ** 2)
    nearest_m2 = np.minimum(nearest_m2, most_m2)
    point, group = np.nonzero(apart_m2 <= nearest_m2[:, None])
    an, ae, bn, be = np.moveaxis(edges[group], -1, 0)  # (Y, 16)
    dn, de, n_of, e_of = bn - an, be - ae, north[point, None] - an, east[point, None] - ae
    along = (n_of * dn + e_of * de) / np.maximum(dn * dn + de * de, _NO_LENGTH_M2)
    along = np.clip(along, 0.0, 1.0)
    off_n, off_e = n_of - along * dn, e_of - along * de
    np.minimum.at(nearest_m2, point, (off_n * off_n + off_e * off_e).min(axis=1))
    return np.minimum(np.where(forbidden, -1.0, 1.0) * np.sqrt(nearest_m2), enough_m)


def _box_gaps_m2(boxes: FloatArray, north: FloatArray, east: FloatArray) -> FloatArray:
    """Squared distance of points from boxes, 0 within.  (4, ...), (...) x2 -> (...)."""
    south, top, west, east_most = boxes
    gap_n = np.maximum(np.maximum(south - north, north - top), 0.0)
    gap_e = np.maximum(np.maximum(west - east, east - east_most), 0.0)
    return np.asarray(gap_n * gap_n + gap_e * gap_e)


# --- one point or one segment: compiled with the planner's kernel


def point_to_segment(
    n: float, e: float, n0: float, e0: float, dn: float, de: float
) -> tuple[float, float]:
    """Horizontal distance of a point from a segment, and where along it the nearest point is."""
    squared = dn * dn + de * de
    at = 0.0
    if squared > 0.0:
        at = min(max(((n - n0) * dn + (e - e0) * de) / squared, 0.0), 1.0)
    return math.hypot(n - n0 - at * dn, e - e0 - at * de), at


def edge_distance(
    n0: float, e0: float, n1: float, e1: float, an: float, ae: float, bn: float, be: float
) -> float:
    """Horizontal distance between two segments; 0 where they cross or touch."""
    dn, de, fn, fe = n1 - n0, e1 - e0, bn - an, be - ae
    three, _ = point_to_segment(n0, e0, an, ae, fn, fe)
    if dn == 0.0 and de == 0.0:
        return three
    side_a = dn * (ae - e0) - de * (an - n0)
    side_b = dn * (be - e0) - de * (bn - n0)
    side_0 = fn * (e0 - ae) - fe * (n0 - an)
    side_1 = fn * (e1 - ae) - fe * (n1 - an)
    if min(side_a, side_b) < 0.0 < max(side_a, side_b) and (
        min(side_0, side_1) < 0.0 < max(side_0, side_1)
    ):
        return 0.0
    one, _ = point_to_segment(an, ae, n0, e0, dn, de)
    two, _ = point_to_segment(bn, be, n0, e0, dn, de)
    four, _ = point_to_segment(n1, e1, an, ae, fn, fe)
    return min(min(one, two), min(three, four))


def box_gap(
    box: tuple[float, float, float, float], n0: float, e0: float, n1: float, e1: float
) -> float:
    """A lower bound of the distance of a segment from what lies in a box: that of the boxes."""
    south, north, west, east = box
    gap_n = max(max(south - max(n0, n1), min(n0, n1) - north), 0.0)
    gap_e = max(max(west - max(e0, e1), min(e0, e1) - east), 0.0)
    return math.sqrt(gap_n * gap_n + gap_e * gap_e)


def forbids(zones: ZoneTable, polygon: int, n: float, e: float) -> bool:
    """Whether a polygon forbids a point (even-odd rule, counting the edges to the north of it)."""
    first, last, sign, south, north, west, east = zones.polygons[polygon]
    inside = False
    if south <= n <= north and west <= e <= east:
        for group in range(int(first), int(last)):
            _, north, west, east, count = zones.groups[group]
            if west <= e <= east and n <= north:
                for k in range(int(count)):
                    an, ae, bn, be = zones.edges[group, k]
                    if (ae > e) != (be > e) and n < an + (e - ae) * (bn - an) / (be - ae):
                        inside = not inside
    return inside == (sign > 0.0)


def edges_distance(
    zones: ZoneTable, polygon: int, n0: float, e0: float, n1: float, e1: float, limit: float
) -> float:
    """Least horizontal distance of a segment from a polygon's edges, at most `limit`."""
    first, last, _, south, north, west, east = zones.polygons[polygon]
    nearest = limit
    if box_gap((south, north, west, east), n0, e0, n1, e1) >= limit:
        return nearest
    for group in range(int(first), int(last)):
        south, north, west, east, count = zones.groups[group]
        if box_gap((south, north, west, east), n0, e0, n1, e1) < nearest:
            for k in range(int(count)):
                an, ae, bn, be = zones.edges[group, k]
                nearest = min(nearest, edge_distance(n0, e0, n1, e1, an, ae, bn, be))
    return nearest


def polygon_at(
    zones: ZoneTable, polygon: int, n: float, e: float, enough: float, most: float
) -> float:
    """Signed horizontal distance of a point from a polygon, negative where it is forbidden.

    At most `enough` where it is allowed, and at least -`most` where not.
    """
    if forbids(zones, polygon, n, e):
        return -edges_distance(zones, polygon, n, e, n, e, most)
    return edges_distance(zones, polygon, n, e, n, e, enough)


def circle_distance(
    zones: ZoneTable, circle: int, n0: float, e0: float, n1: float, e1: float
) -> float:
    """Least signed horizontal distance of a segment from a circle, negative where forbidden."""
    n, e, radius, sign = zones.circles[circle]
    if sign > 0.0:
        away, _ = point_to_segment(n, e, n0, e0, n1 - n0, e1 - e0)
        return float(away - radius)
    return float(radius - max(math.hypot(n0 - n, e0 - e), math.hypot(n1 - n, e1 - e)))


def zone_distance(zones: ZoneTable, segment: Segment, limit: float) -> tuple[float, float]:
    """Least signed horizontal distance of a segment from the zones: lower and upper bound.

    Both at most `limit`, which is at least 0; equal, and exact, where the segment lies wholly where
    all polygons allow.
    """
    n0, e0, _, dn, de, _ = segment
    n1, e1 = n0 + dn, e0 + de
    lower, upper = limit, limit
    for k in range(zones.circles.shape[0]):
        far = circle_distance(zones, k, n0, e0, n1, e1)
        lower, upper = min(lower, far), min(upper, far)
    for polygon in range(zones.polygons.shape[0]):
        nearest = edges_distance(zones, polygon, n0, e0, n1, e1, max(limit, _TOUCHING_M))
        if nearest > 0.0 and not forbids(zones, polygon, n0, e0):
            lower, upper = min(lower, nearest), min(upper, nearest)
        else:
            middle = polygon_at(zones, polygon, n0 + 0.5 * dn, e0 + 0.5 * de, _FAR_M, _FAR_M)
            start = polygon_at(zones, polygon, n0, e0, _FAR_M, _FAR_M)
            lower = min(lower, middle - 0.5 * math.hypot(dn, de))
            upper = min(upper, min(middle, start))
            if nearest <= 0.0:
                upper = min(upper, 0.0)
    return lower, upper


def lattice_gaps(
    zones: ZoneTable, north_m: FloatArray, east_m: FloatArray, within_m: float
) -> FloatArray:
    """`gaps_m` on a lattice; deeper in a zone than within_m counts as so deep.

    North (rows,), east (columns,) -> (rows, columns).
    """
    result = np.empty((len(north_m), len(east_m)))
    for i in range(len(north_m)):
        for j in range(len(east_m)):
            n, e, gap = float(north_m[i]), float(east_m[j]), within_m
            for circle in range(zones.circles.shape[0]):
                gap = min(gap, circle_distance(zones, circle, n, e, n, e))
            for polygon in range(zones.polygons.shape[0]):
                gap = min(gap, polygon_at(zones, polygon, n, e, max(gap, 0.0), within_m))
            result[i, j] = max(gap, -within_m)
    return result


# --- lattices, kept

LatticeGaps = Callable[[ZoneTable, FloatArray, FloatArray, float], FloatArray]
"""`lattice_gaps`, or the same compiled."""


@lru_cache(maxsize=8)
def too_near(
    zones: tuple[Zone, ...],
    north_m: tuple[float, ...],
    east_m: tuple[float, ...],
    distance_m: float,
    gaps: LatticeGaps = lattice_gaps,
) -> BoolArray:
    """Where on a lattice a zone is nearer than a distance, or with one below 0 forbids so deep.

    (rows,), (columns,) -> (rows, columns).  Kept, and not to be changed: zones and lattice are
    often those of the plan before.
    """
    told_m = gaps(packed(zones), np.array(north_m), np.array(east_m), abs(distance_m) + 1.0)
    found = np.asarray(told_m < distance_m)
    found.setflags(write=False)
    return found


class NearCells(NamedTuple):
    """Cells of an area that may be near a zone; beyond it all may be.  As numba takes them."""

    north_min_m: float
    east_min_m: float
    cell_m: float
    near: BoolArray  # (rows, columns)


NO_CELLS = NearCells(0.0, 0.0, 1.0, np.frombuffer(b"", dtype=bool).reshape(0, 0))
"""Of no area: zones are looked at everywhere.  Read-only as all are, for numba."""


def near_cells(
    zones: tuple[Zone, ...],
    north_m: tuple[float, float],
    east_m: tuple[float, float],
    distance_m: float,
    gaps: LatticeGaps = lattice_gaps,
) -> NearCells:
    """The cells of an area with points nearer to a zone than a distance, or forbidden by it."""
    most_m = max(north_m[1] - north_m[0], east_m[1] - east_m[0])
    cell_m = max(0.5 * distance_m, most_m / _MOST_CELLS)
    north, east = (
        tuple((low + cell_m * np.arange(0.5, math.ceil((high - low) / cell_m))).tolist())
        for low, high in (north_m, east_m)
    )
    near_m = distance_m + math.sqrt(0.5) * cell_m
    near = too_near(zones, north, east, near_m, gaps)
    return NearCells(float(north_m[0]), float(east_m[0]), float(cell_m), near)
