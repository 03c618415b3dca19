"""The surface that a path must stay above, and the terrain under it, for one plan.

`safe_surface`: the known map dilated by a ball of the required clearance (design 5.3).  Above it a
point is at least that far from every piece of terrain that the map allows for, in three dimensions.
The search reads it; what it finds is proven against the map itself (`path.certificate`).
`terrain_surface`: the known map as it is, for the paper's first-order distance.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy

from companion import jit
from companion.geodesy import FloatArray
from companion.world.known_map import KnownMap

_COARSE_FROM = 4.0  # cells of clearance: from there on half cells are not worth their time


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
    vertices_m = scipy.ndimage.maximum_filter(np.pad(wide, 1, mode="edge"), size=2)[1:, 1:]
    return Surface(
        north_min_m=south,
        east_min_m=west,
        cell_m=float(known.cell_m / refine),
        vertex_m=np.ascontiguousarray(vertices_m),  # bilinear, it is below no square
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
