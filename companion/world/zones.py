"""Zones (fences): circles and polygons that the vehicle must stay out of, or inside of.

A zone is a vertical cylinder or prism, as high as the sky.  Its distance is horizontal, to its
edge, and negative where it forbids to be; that from several zones is the least of theirs.

It is written down twice, and tests hold the two against each other: `gaps_m` for arrays of points,
by shapely, for the part that decides; and for a point or a segment plain scalar code that is
compiled (`companion.jit`), for search, guidance and proof.  There edges of polygons lie in groups
with a box about each: a fence of hundreds of edges costs little more than one of ten.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, final

import numpy as np
import shapely

from companion import jit
from companion.geodesy import BoolArray, FloatArray
from companion.world.columns import FAR_M, Segment

_GROUP = 16  # edges to a box: 16 is faster than 8, with 50 x 100 corners and with 2,000 (measured)
_MOST_CELLS = 512  # cells of `near_cells` across: 0.25 MB, made in some 0.1 s
_TOUCHING_M = 1e-9
"""Looked for at least so far from a segment, so that edges that touch it are seen (rounding)."""
Row = tuple[float, ...]
Box = tuple[Any, Any, Any, Any]  # edges to the south, north, west and east


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
        return gaps_m((self,), north_m, east_m)


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
        return gaps_m((self,), north_m, east_m)


Zone = CircleZone | PolygonZone


class ZoneTable(NamedTuple):
    """Zones as plain arrays."""

    circles: FloatArray  # (K, 4): north, east, radius; 1 to stay out, -1 to stay inside
    polygons: FloatArray  # (Z, 7): first group, and the one after the last; 1 or -1; box
    groups: FloatArray  # (G, 5): box of each; how many edges it has
    edges: FloatArray  # (G, 16, 4): north, east of both ends; short groups end with points


@lru_cache(maxsize=256)
def packed(zones: tuple[Zone, ...]) -> ZoneTable:
    """Zones as plain arrays; kept, and not to be changed."""
    circles, polygons, groups = list[Row](), list[Row](), list[Row]()
    edges = list[FloatArray]()
    for zone in zones:
        sign = -1.0 if zone.keep_in else 1.0
        if isinstance(zone, CircleZone):
            circles.append((zone.north_m, zone.east_m, zone.radius_m, sign))
            continue
        corners = np.array(zone.vertices_ne_m, dtype=np.float64).reshape(-1, 2)
        sides, first = np.hstack([corners, np.roll(corners, -1, axis=0)]), len(groups)
        for k in range(0, len(sides), _GROUP):
            own = sides[k : k + _GROUP]
            edges.append(np.tile(corners[0], (_GROUP, 2)))
            edges[-1][: len(own)] = own
            groups.append((*_box_of(own.reshape(-1, 2)), len(own)))
        polygons.append((first, len(groups), sign, *_box_of(corners)))
    return ZoneTable(
        circles=np.array(circles, dtype=np.float64).reshape(-1, 4),
        polygons=np.array(polygons, dtype=np.float64).reshape(-1, 7),
        groups=np.array(groups, dtype=np.float64).reshape(-1, 5),
        edges=np.array(edges, dtype=np.float64).reshape(-1, _GROUP, 4),
    )


def _box_of(points_ne_m: FloatArray) -> Box:
    (south, west), (north, east) = points_ne_m.min(axis=0), points_ne_m.max(axis=0)
    return south, north, west, east


# --- many points at once


def gaps_m(
    zones: tuple[Zone, ...], north_m: FloatArray, east_m: FloatArray, within_m: float = math.inf
) -> FloatArray:
    """Distance of points to the nearest zone, negative where one forbids to be, metres.

    (...) x2 -> (...).  within_m: farther ones count as so far away (inf without zones).
    """
    north, east = np.broadcast_arrays(np.asarray(north_m), np.asarray(east_m))
    result = np.asarray(within_m + 0.0 * (north + east))  # of no place it is no distance: NaN
    for zone in zones:
        if isinstance(zone, CircleZone):
            outside_m = np.hypot(north - zone.north_m, east - zone.east_m) - zone.radius_m
        else:
            outside_m = _outside_m(zone, north, east, np.inf if zone.keep_in else result)
        result = np.minimum(result, -outside_m if zone.keep_in else outside_m)
    return np.asarray(result)


def _outside_m(
    zone: PolygonZone, north: FloatArray, east: FloatArray, most_m: FloatArray | float
) -> FloatArray:
    """Distance of points to the edge, negative inside; any that is no less than most_m will do."""
    area = _area(zone)
    south_m, west_m, north_m, east_m = area.bounds
    beyond_m = [south_m - north, north - north_m, west_m - east, east - east_m]
    result = np.asarray(np.maximum.reduce(beyond_m))  # its box is no farther
    near = result < most_m
    north, east = north[near], east[near]
    edge_m = shapely.distance(area.exterior, shapely.points(north, east))
    result[near] = np.where(shapely.contains_xy(area, north, east), -edge_m, edge_m)
    return result


@lru_cache(maxsize=256)
def _area(zone: PolygonZone) -> shapely.Polygon:
    area = shapely.Polygon(zone.vertices_ne_m)
    shapely.prepare(area)
    return area


def nearest(zones: tuple[Zone, ...], north_m: float, east_m: float) -> tuple[Zone | None, float]:
    """The zone that is the nearest to a point, or forbids it the most, and its distance, metres."""
    closest: tuple[Zone | None, float] = None, math.inf
    at = np.asarray(north_m), np.asarray(east_m)
    for zone in zones:
        gap_m = float(gaps_m((zone,), *at, closest[1]))
        closest = (zone, gap_m) if gap_m < closest[1] else closest
    return closest


# --- one point or one segment: compiled


def point_gap(n: float, e: float, n0: float, e0: float, dn: float, de: float) -> float:
    """Horizontal distance of a point from a segment."""
    squared = dn * dn + de * de
    at = 0.0
    if squared > 0.0:
        at = min(max(((n - n0) * dn + (e - e0) * de) / squared, 0.0), 1.0)
    return math.hypot(n - n0 - at * dn, e - e0 - at * de)


def edge_distance(
    n0: float, e0: float, n1: float, e1: float, an: float, ae: float, bn: float, be: float
) -> float:
    """Horizontal distance between two segments; 0 where they cross or touch."""
    dn, de, fn, fe = n1 - n0, e1 - e0, bn - an, be - ae
    three = point_gap(n0, e0, an, ae, fn, fe)
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
    one = point_gap(an, ae, n0, e0, dn, de)
    two = point_gap(bn, be, n0, e0, dn, de)
    four = point_gap(n1, e1, an, ae, fn, fe)
    return min(min(one, two), min(three, four))


def box_gap(box: Box, n0: float, e0: float, n1: float, e1: float) -> float:
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
        return float(point_gap(n, e, n0, e0, n1 - n0, e1 - e0) - radius)
    return float(radius - max(math.hypot(n0 - n, e0 - e), math.hypot(n1 - n, e1 - e)))


def zone_distance(zones: ZoneTable, segment: Segment, limit: float) -> tuple[float, float]:
    """Least signed horizontal distance of a segment from the zones: lower and upper bound.

    Both at most `limit`, which is at least 0; equal, and exact, where the segment lies wholly where
    all polygons allow.
    """
    n0, e0, _, dn, de, _ = segment
    n1, e1 = n0 + dn, e0 + de
    lower, upper = limit, limit
    for circle in range(len(zones.circles)):
        far = circle_distance(zones, circle, n0, e0, n1, e1)
        lower, upper = min(lower, far), min(upper, far)
    for polygon in range(len(zones.polygons)):
        nearest = edges_distance(zones, polygon, n0, e0, n1, e1, max(limit, _TOUCHING_M))
        if nearest > 0.0 and not forbids(zones, polygon, n0, e0):
            lower, upper = min(lower, nearest), min(upper, nearest)
        else:
            middle = polygon_at(zones, polygon, n0 + 0.5 * dn, e0 + 0.5 * de, FAR_M, FAR_M)
            start = polygon_at(zones, polygon, n0, e0, FAR_M, FAR_M)
            lower = min(lower, middle - 0.5 * math.hypot(dn, de))
            upper = min(upper, min(middle, start))
            if nearest <= 0.0:
                upper = min(upper, 0.0)
    return lower, upper


# --- lattices, kept


def near_on_lattice(
    zones: ZoneTable,
    corner_ne_m: tuple[float, float],
    step_m: float,
    shape: tuple[int, int],
    distance_m: float,
) -> BoolArray:
    """Where on a lattice a zone is nearer than a distance, or with one below 0 forbids so deep.

    corner_ne_m: of the first point.  -> (rows, columns).  Compiled.
    """
    result = np.empty(shape, dtype=np.bool_)
    most = abs(distance_m) + 1.0
    for i in range(shape[0]):
        for j in range(shape[1]):
            n, e, gap = corner_ne_m[0] + step_m * i, corner_ne_m[1] + step_m * j, most
            for circle in range(len(zones.circles)):
                gap = min(gap, circle_distance(zones, circle, n, e, n, e))
            for polygon in range(len(zones.polygons)):
                gap = min(gap, polygon_at(zones, polygon, n, e, max(gap, 0.0), most))
            result[i, j] = gap < distance_m
    return result


@lru_cache(maxsize=8)
def too_near(
    zones: tuple[Zone, ...],
    corner_ne_m: tuple[float, float],
    step_m: float,
    shape: tuple[int, int],
    distance_m: float,
) -> BoolArray:
    """The same, kept, and not to be changed: zones and lattice are often those of before."""
    near: BoolArray = jit.compiled(near_on_lattice)(
        packed(zones), corner_ne_m, step_m, shape, distance_m
    )
    near.setflags(write=False)
    return near


class NearCells(NamedTuple):
    """Cells of an area that may be near a zone; beyond it all may be.  As numba takes them."""

    north_min_m: float
    east_min_m: float
    cell_m: float
    near: BoolArray  # (rows, columns), read-only


def near_cells(
    zones: tuple[Zone, ...],
    north_m: tuple[float, float],
    east_m: tuple[float, float],
    distance_m: float,
) -> NearCells:
    """The cells of an area with points nearer to a zone than a distance, or forbidden by it."""
    sides_m = north_m[1] - north_m[0], east_m[1] - east_m[0]
    cell_m = max(0.5 * distance_m, max(sides_m) / _MOST_CELLS)
    rows, columns = (math.ceil(side_m / cell_m) for side_m in sides_m)
    middle_ne_m = float(north_m[0] + 0.5 * cell_m), float(east_m[0] + 0.5 * cell_m)
    near_m = float(distance_m + math.sqrt(0.5) * cell_m)
    near = too_near(zones, middle_ne_m, float(cell_m), (rows, columns), near_m)
    return NearCells(float(north_m[0]), float(east_m[0]), float(cell_m), near)
