"""Distances from a segment to the known terrain and to zones, for the proof.

Plain scalar code that numba can compile as it is (see `path.proof`).  A column of terrain, a disc
and an edge are convex, so the distance to one is a convex function along the segment.

Edges of polygons lie in groups, each with a box about it: a fence of hundreds of edges costs
little more than one of ten.
"""

import math
from typing import NamedTuple

from companion.geodesy import FloatArray
from companion.path.envelope import Envelope

_FAR = 1e12
_TOUCHING = 1e-9
Segment = tuple[float, float, float, float, float, float]
"""North, east, altitude of its start, and from there to its end."""
Box = tuple[float, float, float, float, float, float]
"""A column: its edges to the south, north, west and east, its top, the registration error."""


class ZoneTable(NamedTuple):
    """Zones as plain arrays."""

    circles: FloatArray  # (K, 4): north, east, radius; 1 to stay out, -1 to stay inside
    edges: FloatArray  # (M, 4): north, east of both ends, polygon after polygon
    groups: FloatArray  # (G, 6): first edge, and the one after the last; south, north, west, east
    polygons: FloatArray  # (Z, 3): first group, and the one after the last; 1 or -1 as for circles


class Surroundings(NamedTuple):
    """What a certificate is about: terrain, zones, radars and bounds, as plain arrays.

    The terrain is a window of the known map.  Every cell is a column as high as `heights_m`;
    where that is inf, and outside of the window, it has no top.
    """

    heights_m: FloatArray  # (rows, columns), C order
    blocks_m: FloatArray  # (block rows, block columns): highest of block x block cells
    block: int
    south_m: float
    west_m: float
    cell_m: float
    registration_m: float
    zones: ZoneTable
    radars: FloatArray  # (N, 4): north, east, altitude, range
    clearance_m: float
    contact_m: float
    motion: Envelope
    """Of the circle that a plane holds on, the terrain is dealt with in `registration_m`."""
    stops: bool
    """Whether the vehicle stops at the end of the curve; if not, it may be at full speed there."""
    curvature_1_m: float
    climb: float
    """Tangent of the largest climb angle; `dive` likewise."""
    dive: float
    floor_m: float
    ceiling_m: float
    map_south_m: float
    map_north_m: float
    map_west_m: float
    map_east_m: float


def column_gap(at: float, segment: Segment, box: Box) -> tuple[float, float]:
    """Distance of the point `at` (0 to 1) along a segment from a column, and its rate by `at`."""
    n0, e0, z0, dn, de, dz = segment
    south, north, west, east, top, registration = box
    n, e, z = n0 + at * dn, e0 + at * de, z0 + at * dz
    gap_n, rate_n = 0.0, 0.0
    if n < south:
        gap_n, rate_n = south - n, -dn
    elif n > north:
        gap_n, rate_n = n - north, dn
    gap_e, rate_e = 0.0, 0.0
    if e < west:
        gap_e, rate_e = west - e, -de
    elif e > east:
        gap_e, rate_e = e - east, de
    flat = math.sqrt(gap_n * gap_n + gap_e * gap_e)
    gap, rate = 0.0, 0.0
    if flat > registration:
        gap, rate = flat - registration, (gap_n * rate_n + gap_e * rate_e) / flat
    if z > top:
        above = z - top
        far = math.sqrt(gap * gap + above * above)
        return far, (gap * rate + above * dz) / far
    return gap, rate


def column_distance(segment: Segment, box: Box, limit: float, tolerance: float) -> float:
    """Least distance of a segment from a column: a lower bound, at most `tolerance` too low.

    The distance is convex along the segment: its tangents are below it, and where those of both
    ends of a bracket meet bounds what lies between.  From `limit` on any bound will do.
    """
    low, high = 0.0, 1.0
    f0, s0 = column_gap(low, segment, box)
    if s0 >= 0.0:
        return f0
    f1, s1 = column_gap(high, segment, box)
    if s1 <= 0.0:
        return f1
    bound = 0.0
    for _ in range(60):
        at = low + (f1 - f0 - s1 * (high - low)) / (s0 - s1)
        bound = max(f0 + s0 * (at - low), 0.0)
        if bound >= limit:
            return bound
        f, s = column_gap(at, segment, box)
        if s == 0.0 or f - bound <= tolerance:
            return bound
        if s < 0.0:
            low, f0, s0 = at, f, s
        else:
            high, f1, s1 = at, f, s
    return bound


def strip(
    n0: float, e0: float, dn: float, de: float, south: float, north: float, wide: float
) -> tuple[float, float]:
    """From where to where, east, columns of a row may be within `wide` of a segment.

    Nowhere (the first beyond the last) where the segment passes the row by.
    """
    first, last = 0.0, 1.0
    if dn != 0.0:
        one, other = (south - wide - n0) / dn, (north + wide - n0) / dn
        first, last = max(first, min(one, other)), min(last, max(one, other))
        if first > last:
            return _FAR, -_FAR
    elif n0 < south - wide or n0 > north + wide:
        return _FAR, -_FAR
    one, other = e0 + first * de, e0 + last * de
    return min(one, other) - wide, max(one, other) + wide


def nearest_column(
    tops: FloatArray,
    part: tuple[int, int, int, int],
    lattice: tuple[float, float, float, float],
    segment: Segment,
    limit: float,
    tolerance: float,
    found: FloatArray,
) -> tuple[float, int]:
    """Least distance of a segment from columns (rows from, to, columns from, to), at most `limit`.

    lattice: its southern and western edge, the side of a column and the registration error, metres.
    found: if it has room, the columns within `limit` are listed there (row, column, distance) and
    the limit is not lowered.  -> the distance and how many were listed.
    """
    n0, e0, z0, dn, de, dz = segment
    south_m, west_m, side, registration = lattice
    lowest = min(z0, z0 + dz)
    flat = math.sqrt(dn * dn + de * de)
    along_n, along_e = (dn / flat, de / flat) if flat > 0.0 else (0.0, 0.0)
    half = 0.5 * side * (abs(along_n) + abs(along_e))
    best, count = limit, 0
    for row in range(part[0], part[1]):
        south = south_m + row * side
        wide = best + registration
        west_most, east_most = strip(n0, e0, dn, de, south, south + side, wide)
        first = max(part[2], math.floor((west_most - west_m) / side))
        last = min(part[3], math.floor((east_most - west_m) / side) + 1)
        for column in range(first, last):
            top = float(tops[row, column])
            if lowest - top >= best:
                continue
            west = west_m + column * side
            aside = (south + 0.5 * side - n0) * along_e - (west + 0.5 * side - e0) * along_n
            if abs(aside) - half >= best + registration:
                continue
            box = (south, south + side, west, west + side, top, registration)
            far = column_distance(segment, box, best, tolerance)
            if far < best:
                if len(found) > 0:
                    found[count, 0], found[count, 1], found[count, 2] = row, column, far
                    count += 1
                else:
                    best = far
    return best, count


def terrain_distance(
    around: Surroundings, segment: Segment, limit: float, tolerance: float, found: FloatArray
) -> float:
    """Least distance of a segment from the terrain, at most `limit` and `tolerance` too low.

    found (blocks, 3): scratch.
    """
    n0, e0, _, dn, de, _ = segment
    rows, columns = around.heights_m.shape
    south, west, cell = around.south_m, around.west_m, around.cell_m
    north, east = south + rows * cell, west + columns * cell
    inside_n = min(min(n0, n0 + dn) - south, north - max(n0, n0 + dn))
    inside_e = min(min(e0, e0 + de) - west, east - max(e0, e0 + de))
    best = min(limit, max(min(inside_n, inside_e) - around.registration_m, 0.0))
    if best <= 0.0:
        return min(best, limit)
    wide, side = best + around.registration_m, cell * around.block
    first = max(math.floor((min(n0, n0 + dn) - wide - south) / side), 0)
    last = math.floor((max(n0, n0 + dn) + wide - south) / side) + 1
    part = (first, min(last, around.blocks_m.shape[0]), 0, around.blocks_m.shape[1])
    lattice = (south, west, side, around.registration_m)
    _, count = nearest_column(around.blocks_m, part, lattice, segment, best, tolerance, found)
    lattice = (south, west, cell, around.registration_m)
    nearest = 0
    for k in range(1, count):
        if found[k, 2] < found[nearest, 2]:
            nearest = k
    for k in range(count):
        other = nearest if k == 0 else (0 if k == nearest else k)
        if float(found[other, 2]) >= best:
            continue
        row, column = int(found[other, 0]) * around.block, int(found[other, 1]) * around.block
        part = (row, min(row + around.block, rows), column, min(column + around.block, columns))
        none = found[:0]
        best, _ = nearest_column(around.heights_m, part, lattice, segment, best, tolerance, none)
    return best


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
    three, _ = point_to_segment(n0, e0, an, ae, fn, fe)
    four, _ = point_to_segment(n1, e1, an, ae, fn, fe)
    return min(min(one, two), min(three, four))


def box_gap(zones: ZoneTable, group: int, n0: float, e0: float, n1: float, e1: float) -> float:
    """A lower bound of the distance of a segment from the edges of a group: that of the boxes."""
    box = zones.groups[group]
    gap_n = max(box[2] - max(n0, n1), min(n0, n1) - box[3])
    gap_e = max(box[4] - max(e0, e1), min(e0, e1) - box[5])
    return math.sqrt(max(gap_n, 0.0) ** 2 + max(gap_e, 0.0) ** 2)


def forbids(zones: ZoneTable, polygon: int, n: float, e: float) -> bool:
    """Whether a polygon forbids a point (even-odd rule, counting the edges to the north of it)."""
    inside = False
    for group in range(int(zones.polygons[polygon, 0]), int(zones.polygons[polygon, 1])):
        box = zones.groups[group]
        if box[4] <= e <= box[5] and n <= box[3]:
            for k in range(int(box[0]), int(box[1])):
                an, ae, bn, be = zones.edges[k]
                if (ae > e) != (be > e) and n < an + (e - ae) * (bn - an) / (be - ae):
                    inside = not inside
    return inside == (zones.polygons[polygon, 2] > 0.0)


def edges_distance(zones: ZoneTable, polygon: int, segment: Segment, limit: float) -> float:
    """Least horizontal distance of a segment from a polygon's edges, at most `limit`."""
    n0, e0, _, dn, de, _ = segment
    n1, e1, nearest = n0 + dn, e0 + de, limit
    for group in range(int(zones.polygons[polygon, 0]), int(zones.polygons[polygon, 1])):
        if box_gap(zones, group, n0, e0, n1, e1) < nearest:
            for k in range(int(zones.groups[group, 0]), int(zones.groups[group, 1])):
                an, ae, bn, be = zones.edges[k]
                nearest = min(nearest, edge_distance(n0, e0, n1, e1, an, ae, bn, be))
    return nearest


def polygon_at(
    zones: ZoneTable, polygon: int, n: float, e: float, enough: float, most: float
) -> float:
    """Signed horizontal distance of a point from a polygon, negative where it is forbidden.

    At most `enough` where it is allowed.  most: it is known to be nearer to some edge.
    """
    forbidden = forbids(zones, polygon, n, e)
    nearest = most if forbidden else enough
    for group in range(int(zones.polygons[polygon, 0]), int(zones.polygons[polygon, 1])):
        if box_gap(zones, group, n, e, n, e) < nearest:
            for k in range(int(zones.groups[group, 0]), int(zones.groups[group, 1])):
                an, ae, bn, be = zones.edges[k]
                gap, _ = point_to_segment(n, e, an, ae, bn - an, be - ae)
                nearest = min(nearest, gap)
    return -nearest if forbidden else nearest


def circle_distance(zones: ZoneTable, circle: int, segment: Segment) -> float:
    """Least signed horizontal distance of a segment from a circle, negative where forbidden."""
    n0, e0, _, dn, de, _ = segment
    n, e, radius, sign = zones.circles[circle]
    if sign > 0.0:
        near, _ = point_to_segment(n, e, n0, e0, dn, de)
        return near - radius
    far = max(math.hypot(n0 - n, e0 - e), math.hypot(n0 + dn - n, e0 + de - e))
    return float(radius - far)


def zone_distance(zones: ZoneTable, segment: Segment, limit: float) -> tuple[float, float]:
    """Least signed horizontal distance of a segment from the zones: lower and upper bound.

    Both at most `limit`, which is at least 0; equal, and exact, where the segment lies wholly where
    all polygons allow.
    """
    n0, e0, _, dn, de, _ = segment
    lower, upper = limit, limit
    for k in range(zones.circles.shape[0]):
        far = circle_distance(zones, k, segment)
        lower, upper = min(lower, far), min(upper, far)
    for polygon in range(zones.polygons.shape[0]):
        nearest = edges_distance(zones, polygon, segment, max(limit, _TOUCHING))
        if nearest > 0.0 and not forbids(zones, polygon, n0, e0):
            lower, upper = min(lower, nearest), min(upper, nearest)
        else:
            middle = polygon_at(zones, polygon, n0 + 0.5 * dn, e0 + 0.5 * de, _FAR, _FAR)
            start = polygon_at(zones, polygon, n0, e0, _FAR, _FAR)
            lower = min(lower, middle - 0.5 * math.hypot(dn, de))
            upper = min(upper, min(middle, start))
            if nearest <= 0.0:
                upper = min(upper, 0.0)
    return lower, upper
