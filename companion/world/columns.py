"""Columns of terrain: each cell of the known map is as high, all over its square, as its highest.

Unknown ground, and what lies off the map, has no top.  Every distance between the vehicle and
known ground is a distance to columns: of many points at once (`distances_to_terrain_m`), and of a
segment for the proof (`terrain_distance`).  A column is convex, so the distance to one is a convex
function along the segment.  Dilated by a ball of the required clearance they are the surface that
the search stays above (`safe_surface`, design 5.3): what it finds is proven against the columns
themselves (`path.certificate`).

What is about a segment or dilates is plain code that numba compiles as it is (`companion.jit`).
"""

import math
from typing import NamedTuple

import numpy as np

from companion import jit
from companion.geodesy import FloatArray
from companion.world.known_map import KnownMap

FAR_M = 1e12  # farther than anything on earth, and small enough to calculate with
_BRACKETINGS = 60
"""Of `column_distance`, which halves its bracket at least every other time: double precision."""
_COARSE_FROM = 4.0  # cells of clearance: from there on half cells are not worth their time
Segment = tuple[float, float, float, float, float, float]
"""North, east, altitude of its start, and from there to its end."""
Box = tuple[float, float, float, float, float, float]
"""A column: its edges to the south, north, west and east, its top, the registration error."""


class Columns(NamedTuple):
    """A window of the known map.  What lies outside of it has no top."""

    heights_m: FloatArray  # (rows, columns), C order; inf where there is no top
    blocks_m: FloatArray  # (block rows, block columns): highest of block x block cells
    block: int
    south_m: float
    west_m: float
    cell_m: float
    registration_m: float
    """How far a column may stand from its cell; of a plane the radius of its circle as well."""


def pack_columns(
    known: KnownMap,
    *,
    centre_ne_m: tuple[float, float],
    reach_m: float,
    block: int,
    registration_m: float,
) -> Columns:
    """The columns within reach of a point; without a top beyond."""
    south_m, west_m, heights_m = known.square_m(centre_ne_m, reach_m)
    first = np.arange(0, len(heights_m), block)
    highest_m = np.maximum.reduceat(np.maximum.reduceat(heights_m, first), first, axis=1)
    return Columns(
        heights_m=heights_m,
        blocks_m=np.ascontiguousarray(highest_m),
        block=block,
        south_m=south_m,
        west_m=west_m,
        cell_m=known.cell_m,
        registration_m=float(registration_m),
    )


# --- many points at once


def distance_to_terrain_m(
    known: KnownMap, point_nea_m: FloatArray, most_m: float, *, seen_only: bool = False
) -> float:
    """`distances_to_terrain_m` of one point."""
    point = np.asarray(point_nea_m, dtype=np.float64)[None]
    return float(distances_to_terrain_m(known, point, most_m, seen_only=seen_only)[0])


def distances_to_terrain_m(
    known: KnownMap, points_nea_m: FloatArray, most_m: float, *, seen_only: bool = False
) -> FloatArray:
    """Distance of points to the columns of the known map, metres; most_m if it is farther.

    (N, 3) -> (N,).  Cells count with their highest terrain over their whole square, grown by the
    registration error; unknown ones, and those off the map, as if they had no top.  seen_only: only
    what a scan has seen, or is known in advance, counts, not what may be there.
    """
    edges_m, upper_m = known.squares_m(
        points_nea_m[:, :2], most_m + known.registration_m, seen_only=seen_only
    )
    here_m = points_nea_m[:, :2, None]
    gaps_m = np.maximum(np.maximum(edges_m - here_m, here_m - edges_m - known.cell_m), 0.0)
    apart_m = np.hypot(gaps_m[:, 0, :, None], gaps_m[:, 1, None, :]) - known.registration_m
    above_m = np.maximum(points_nea_m[:, 2, None, None] - upper_m, 0.0)
    return np.minimum(np.hypot(np.maximum(apart_m, 0.0), above_m).min(axis=(1, 2)), most_m)


# --- a segment: compiled


def column_gap(at: float, segment: Segment, box: Box) -> tuple[float, float]:
    """Distance of the point `at` (0 to 1) along a segment from a column, and its rate by `at`."""
    n0, e0, z0, dn, de, dz = segment
    south, north, west, east, top, registration = box
    n, e, z = n0 + at * dn, e0 + at * de, z0 + at * dz
    gap_n, rate_n = max(max(south - n, n - north), 0.0), -dn if n < south else dn
    gap_e, rate_e = max(max(west - e, e - east), 0.0), -de if e < west else de
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
    for _ in range(_BRACKETINGS):
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
            return FAR_M, -FAR_M
    elif n0 < south - wide or n0 > north + wide:
        return FAR_M, -FAR_M
    one, other = e0 + first * de, e0 + last * de
    return min(one, other) - wide, max(one, other) + wide


def nearest_column(
    tops: FloatArray,
    part: tuple[int, int, int, int],
    lattice: tuple[float, float, float, float],
    segment: Segment,
    limit: float,
    tolerance: float,
    listed: FloatArray,
) -> tuple[float, int]:
    """Least distance of a segment from columns (rows from, to, columns from, to), at most `limit`.

    lattice: its southern and western edge, the side of a column and the registration error, metres.
    listed: if it has room, the columns within `limit` are listed there (row, column, distance) and
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
                if len(listed) > 0:
                    listed[count, 0], listed[count, 1], listed[count, 2] = row, column, far
                    count += 1
                else:
                    best = far
    return best, count


def terrain_distance(
    terrain: Columns, segment: Segment, limit: float, tolerance: float, scratch: FloatArray
) -> float:
    """Least distance of a segment from the terrain, at most `limit` and `tolerance` too low.

    scratch: (blocks, 3), overwritten.
    """
    n0, e0, _, dn, de, _ = segment
    rows, columns = terrain.heights_m.shape
    south, west, cell = terrain.south_m, terrain.west_m, terrain.cell_m
    north, east = south + rows * cell, west + columns * cell
    inside_n = min(min(n0, n0 + dn) - south, north - max(n0, n0 + dn))
    inside_e = min(min(e0, e0 + de) - west, east - max(e0, e0 + de))
    best = min(limit, max(min(inside_n, inside_e) - terrain.registration_m, 0.0))
    if best <= 0.0:
        return min(best, limit)
    wide, side = best + terrain.registration_m, cell * terrain.block
    first = max(math.floor((min(n0, n0 + dn) - wide - south) / side), 0)
    last = math.floor((max(n0, n0 + dn) + wide - south) / side) + 1
    part = (first, min(last, terrain.blocks_m.shape[0]), 0, terrain.blocks_m.shape[1])
    lattice = (south, west, side, terrain.registration_m)
    _, count = nearest_column(terrain.blocks_m, part, lattice, segment, best, tolerance, scratch)
    lattice = (south, west, cell, terrain.registration_m)
    nearest = 0
    for k in range(1, count):
        if scratch[k, 2] < scratch[nearest, 2]:
            nearest = k
    for k in range(count):
        other = nearest if k == 0 else (0 if k == nearest else k)
        if float(scratch[other, 2]) >= best:
            continue
        row, column = int(scratch[other, 0]) * terrain.block, int(scratch[other, 1]) * terrain.block
        part = (row, min(row + terrain.block, rows), column, min(column + terrain.block, columns))
        none = scratch[:0]
        best, _ = nearest_column(terrain.heights_m, part, lattice, segment, best, tolerance, none)
    return best


# --- surfaces for one plan: above the columns, and of the terrain itself


class Surface(NamedTuple):
    """Altitudes, or other values, at the points of a lattice, bilinear between them.

    As numba takes it: its array in C order.
    """

    north_min_m: float
    east_min_m: float
    cell_m: float
    vertex_m: FloatArray  # (rows + 1, columns + 1)

    def altitude_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Altitude of the surface, metres AMSL.  (...) x2 -> (...).  Clamped at its edges."""
        return self.altitude_and_slope(north_m, east_m)[0]

    def altitude_and_slope(
        self, north_m: FloatArray, east_m: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Altitude, metres AMSL, and squared gradient.  (...) x2 -> (...) x2."""
        rows, columns = self.vertex_m.shape
        u = np.clip((north_m - self.north_min_m) / self.cell_m, 0.0, rows - 1.000001)
        v = np.clip((east_m - self.east_min_m) / self.cell_m, 0.0, columns - 1.000001)
        row, column = u.astype(np.intp), v.astype(np.intp)
        u, v = u - row, v - column
        flat = self.vertex_m.ravel()
        corner = row * columns + column
        sw, se = flat[corner], flat[corner + 1]
        nw, ne = flat[corner + columns], flat[corner + columns + 1]
        south, north = sw + v * (se - sw), nw + v * (ne - nw)
        rise_north = (north - south) / self.cell_m
        rise_east = ((se - sw) * (1.0 - u) + (ne - nw) * u) / self.cell_m
        return south + u * (north - south), rise_north**2 + rise_east**2


def safe_surface(
    known: KnownMap,
    *,
    centre_ne_m: tuple[float, float],
    reach_m: float,
    clearance_m: float,
    unknown_m: float,
    floor_m: float = -math.inf,
) -> Surface:
    """The lowest altitude at which the clearance is sure, within reach of a point.

    A point above it is at least clearance_m from the terrain that the map allows for, whatever
    the terrain does inside a cell: cells count with their highest terrain over their whole
    square, grown by the registration error.  Unknown ground counts as terrain of altitude
    unknown_m.  Up to a cell wider than need be: `path.certificate` is exact.

    floor_m: at lower altitudes it need not be right.
    """
    radius = clearance_m + known.registration_m
    south, west, upper_m = known.square_m(centre_ne_m, reach_m + radius)
    upper_m[~np.isfinite(upper_m)] = unknown_m
    refine = 2 if radius < _COARSE_FROM * known.cell_m else 1
    half = math.ceil(radius / known.cell_m)
    offset, start = np.arange(half, -half - 1, -1)[:, None], np.arange(refine) / refine
    gap = np.maximum(offset - start - 1.0 / refine, start - offset - 1.0)  # of parts from cells
    gap = np.maximum(gap, 0.0).ravel()  # from the southernmost part on
    away_m = np.hypot(gap[:, None], gap[None, :]) * known.cell_m - known.registration_m
    rises_m = np.sqrt(np.maximum(clearance_m**2 - np.maximum(away_m, 0.0) ** 2, 0.0))
    rises_m[away_m >= clearance_m] = -np.inf
    wide = jit.compiled(dilated_m)(upper_m, rises_m, refine, floor_m - clearance_m)
    wide = np.pad(wide, 1, mode="edge")
    across = np.maximum(wide[1:], wide[:-1])
    return Surface(
        north_min_m=south,
        east_min_m=west,
        cell_m=float(known.cell_m / refine),
        vertex_m=np.maximum(across[:, 1:], across[:, :-1]),  # bilinear, it is below no square
    )


def dilated_m(upper_m: FloatArray, rises_m: FloatArray, refine: int, least_m: float) -> FloatArray:
    """Cells dilated: for each part of a cell the most that a cell about it asks for.

    Compiled.  (N, M) -> (N refine, M refine).
    rises_m: (K, K), by how much over a cell, for the parts of the cells about it from the
    southernmost and westernmost on; -inf where it asks for nothing.
    least_m: what cells that are no higher ask for of others does not matter.

    A cell among eight that are no lower asks for nothing that these do not: the line from anywhere
    to it goes over one of them.
    """
    (rows, columns), across = upper_m.shape, len(rises_m)
    margin = (across - refine) // 2  # parts on each side of a cell
    wide = np.full((rows * refine + 2 * margin, columns * refine + 2 * margin), -math.inf)
    for r in range(rows):
        for c in range(columns):
            top_m, is_edge = upper_m[r, c], False
            if top_m > least_m:
                for i in range(max(r - 1, 0), min(r + 2, rows)):
                    for j in range(max(c - 1, 0), min(c + 2, columns)):
                        is_edge |= upper_m[i, j] < top_m
            low, high = (0, across) if is_edge else (margin, margin + refine)
            for y in range(low, high):
                for x in range(low, high):
                    asked_m = top_m + rises_m[y, x]
                    if asked_m > wide[r * refine + y, c * refine + x]:
                        wide[r * refine + y, c * refine + x] = asked_m
    return wide[margin : margin + rows * refine, margin : margin + columns * refine].copy()


def terrain_surface(
    known: KnownMap, *, centre_ne_m: tuple[float, float], reach_m: float
) -> Surface:
    """The known terrain within reach of a point; unknown ground lies at 0 m.

    Bilinear between the middles of the cells: smooth, for the paper's objective, not a bound.
    """
    south, west, upper_m = known.square_m(centre_ne_m, reach_m)
    return Surface(
        north_min_m=south + 0.5 * known.cell_m,
        east_min_m=west + 0.5 * known.cell_m,
        cell_m=known.cell_m,
        vertex_m=np.where(np.isfinite(upper_m), upper_m, 0.0),
    )


def sees_anything(known: KnownMap, centre_ne_m: tuple[float, float], reach_m: float) -> bool:
    """Whether any ground within reach of a point is known."""
    return bool(np.isfinite(known.square_m(centre_ne_m, reach_m)[2]).any())
