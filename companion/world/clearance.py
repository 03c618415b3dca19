"""The surface that a path must stay above, and the terrain under it, for one plan.

`safe_surface`: the known map dilated by a ball of the required clearance (design 5.3).  Above it a
point is at least that far from every piece of terrain that the map allows for, in three dimensions.
`terrain_surface`: the known map as it is, for the paper's first-order distance.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
import scipy.ndimage

from companion.geodesy import FloatArray
from companion.world.known_map import KnownMap

_REFINE = 2  # sub-cells a side: halves what rounding to whole cells adds to the clearance


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """Altitudes at the vertices of a lattice, bilinear between them."""

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


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Window:
    north_min_m: float
    east_min_m: float
    upper_m: FloatArray


def _window(
    known: KnownMap, centre_ne_m: tuple[float, float], reach_m: float, unknown_m: float
) -> _Window:
    """The part of the map within reach of a point; unknown or off the map: unknown_m."""
    row, column = known.cell_of(*centre_ne_m)
    half = math.ceil(reach_m / known.cell_m) + 1
    rows, columns = known.upper_m.shape
    window = np.full((2 * half + 1, 2 * half + 1), np.inf)
    south, north = max(row - half, 0), min(row + half + 1, rows)
    west, east = max(column - half, 0), min(column + half + 1, columns)
    if south < north and west < east:
        window[
            south - row + half : north - row + half, west - column + half : east - column + half
        ] = known.upper_m[south:north, west:east]
    return _Window(
        north_min_m=known.north_min_m + (row - half) * known.cell_m,
        east_min_m=known.east_min_m + (column - half) * known.cell_m,
        upper_m=np.where(np.isfinite(window), window, unknown_m),
    )


def safe_surface(
    known: KnownMap,
    *,
    centre_ne_m: tuple[float, float],
    reach_m: float,
    clearance_m: float,
    unknown_m: float,
) -> Surface:
    """The lowest altitude at which the clearance is sure, within reach of a point.

    A point above it is at least clearance_m from the terrain that the map allows for, whatever
    the terrain does inside a cell: cells count with their highest terrain over their whole
    square, grown by the registration error, and distances are those between the nearest points
    of cells.  Unknown ground counts as terrain of altitude unknown_m.
    """
    radius = clearance_m + known.registration_m
    window = _window(known, centre_ne_m, reach_m + radius, unknown_m)
    cell = known.cell_m / _REFINE
    heights = np.repeat(np.repeat(window.upper_m, _REFINE, axis=0), _REFINE, axis=1)
    half = math.ceil(radius / cell) + 1
    steps = np.maximum(np.abs(np.arange(-half, half + 1)) - 1, 0) * cell
    gap = np.maximum(np.hypot(steps[:, None], steps[None, :]) - known.registration_m, 0.0)
    near = gap < clearance_m
    ball = np.where(near, np.sqrt(np.maximum(clearance_m**2 - gap**2, 0.0)), -1e6)
    dilated = scipy.ndimage.grey_dilation(heights, footprint=near, structure=ball, mode="nearest")
    return Surface(
        north_min_m=window.north_min_m,
        east_min_m=window.east_min_m,
        cell_m=cell,
        vertex_m=_at_vertices(dilated),
    )


def terrain_surface(
    known: KnownMap, *, centre_ne_m: tuple[float, float], reach_m: float
) -> Surface:
    """The known terrain within reach of a point; unknown ground lies at 0 m.

    Bilinear between the middles of the cells: smooth, for the paper's objective, not a bound.
    """
    window = _window(known, centre_ne_m, reach_m, 0.0)
    return Surface(
        north_min_m=window.north_min_m + 0.5 * known.cell_m,
        east_min_m=window.east_min_m + 0.5 * known.cell_m,
        cell_m=known.cell_m,
        vertex_m=window.upper_m,
    )


def _at_vertices(cells: FloatArray) -> FloatArray:
    """Highest of the (up to) four cells at each vertex.  (rows, columns) -> (rows+1, columns+1).

    Bilinear interpolation of these is nowhere below the cell that it crosses.
    """
    padded = np.pad(cells, 1, mode="edge")
    by_rows = np.maximum(padded[1:, :], padded[:-1, :])
    return np.maximum(by_rows[:, 1:], by_rows[:, :-1])
