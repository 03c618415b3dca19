"""Rays that go out from a radar over a lattice of cells: which cell each crosses at every step."""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
import scipy

from companion.geodesy import BoolArray, FloatArray
from companion.world.lattice import IntArray, Lattice

RAY_CELLS = 0.3
"""Between neighbouring rays at the farthest point, in cells."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Rays:
    """Rays towards points: each point has one that passes within RAY_CELLS / 2 of it."""

    azimuth_rad: FloatArray  # (rays,)
    distance_m: FloatArray  # (points,)
    ray_of: IntArray  # (points,)
    farthest_m: float

    @classmethod
    def towards(
        cls, points_ne_m: FloatArray, radar_ne_m: tuple[float, float], cell_m: float
    ) -> "Rays":
        """The rays from a radar that are needed for these points.  (K, 2)."""
        away = points_ne_m - np.asarray(radar_ne_m)
        distance = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-9)
        farthest = max(float(distance.max()), cell_m)
        apart_rad = RAY_CELLS * cell_m / farthest
        index = np.rint(np.arctan2(away[:, 1], away[:, 0]) / apart_rad).astype(np.intp)
        first = int(index.min())
        used = np.bincount(index - first) > 0
        return cls(
            azimuth_rad=np.asarray((np.flatnonzero(used) + first) * apart_rad, dtype=np.float64),
            distance_m=distance,
            ray_of=(np.cumsum(used) - 1)[index - first],
            farthest_m=farthest,
        )


def all_round(cell_m: float, farthest_m: float) -> FloatArray:
    """Azimuths of rays in all directions, RAY_CELLS apart at the farthest.  -> (rays,), radians."""
    count = math.ceil(2.0 * math.pi * farthest_m / (RAY_CELLS * cell_m))
    return np.arange(float(count)) * (2.0 * math.pi / count)


_WIDER = 1.5
"""Strips of cells are looked at in widths that grow by this: up to half as wide again as need be,
which only takes in more cells, for a handful of filters in all."""


def overlooking_line_m(
    lattice: Lattice,
    top_m: FloatArray,
    radar_nea_m: tuple[float, float, float],
    points_ne_m: FloatArray,
    slack_m: float,
) -> FloatArray:
    """Altitude of the lowest line of sight that passes over points to seen ground beyond them.

    top_m: the highest of each cell that was seen, +inf for all others.  (K, 2) -> (K,).

    The arc between two rays at one step is seen if the cells that it may touch are; a point is
    overlooked if at some step at least two slacks behind it all arcs are seen that lines over its
    cell can reach.  Those lines are steepest to the highest of these cells, a slack nearer.
    """
    cell = lattice.cell_m
    away = points_ne_m - np.asarray(radar_nea_m[:2])
    distance = np.hypot(away[:, 0], away[:, 1])
    farthest = _farthest_m(lattice, np.isfinite(top_m), radar_nea_m)
    azimuth = all_round(cell, farthest)
    apart_rad = float(azimuth[1])
    steps = np.arange(1.0, math.ceil(farthest / cell) + 1.0)
    steepest = _slope_to_arcs(lattice, top_m, radar_nea_m, azimuth, steps, slack_m)
    half_rad = np.arcsin(np.minimum(slack_m / np.maximum(distance, slack_m), 1.0))
    half = half_rad / apart_rad  # rays to each side
    first = np.ceil((distance + 2.0 * slack_m) / cell).astype(np.intp) - 1
    ray = np.rint(np.arctan2(away[:, 1], away[:, 0]) / apart_rad).astype(np.intp) % len(azimuth)
    slope = np.full(len(distance), np.inf)
    able = (first < len(steps)) & (distance > 2.0 * slack_m)
    classes = np.ceil(np.log(np.maximum(half, 1.0)) / math.log(_WIDER)).astype(np.intp)
    for each in np.unique(classes[able]):
        wide = 2 * math.ceil(_WIDER ** int(each)) + 1
        strip = scipy.ndimage.maximum_filter1d(steepest, wide, axis=1, mode="wrap")
        np.minimum.accumulate(strip[::-1], axis=0, out=strip[::-1])
        at = able & (classes == each)
        slope[at] = strip[first[at], ray[at]]
    run = np.where(slope > 0.0, distance + slack_m, np.maximum(distance - slack_m, 0.0))
    return np.asarray(radar_nea_m[2] + slope * np.maximum(run, 1e-9))


def _farthest_m(
    lattice: Lattice, seen: BoolArray, radar_nea_m: tuple[float, float, float]
) -> float:
    """How far the farthest of the seen cells may reach."""
    rows, columns = np.nonzero(seen)
    north = lattice.north_min_m + (rows + 0.5) * lattice.cell_m - radar_nea_m[0]
    east = lattice.east_min_m + (columns + 0.5) * lattice.cell_m - radar_nea_m[1]
    return float(np.hypot(north, east).max()) + lattice.cell_m


def _slope_to_arcs(
    lattice: Lattice,
    top_m: FloatArray,
    radar_nea_m: tuple[float, float, float],
    azimuth_rad: FloatArray,
    steps: FloatArray,
    slack_m: float,
) -> FloatArray:
    """Slope of the steepest line to the cells of each arc; +inf if one was not seen.

    An arc reaches half way to the rays beside it, so it is shorter than a cell and touches no cells
    but those that hold its ends and the two others of the same rows and columns.
    -> (steps, rays).
    """
    edge = np.pad(top_m, 1, constant_values=np.inf)
    half_rad = 0.5 * float(azimuth_rad[1])
    ends = lattice.wider().crossed(radar_nea_m[:2], azimuth_rad - half_rad, steps)
    left, right = (np.divmod(flat, edge.shape[1]) for flat in (ends, np.roll(ends, -1, axis=1)))
    rise = np.maximum(edge[left], edge[right])
    np.maximum(rise, edge[left[0], right[1]], out=rise)
    np.maximum(rise, edge[right[0], left[1]], out=rise)
    rise -= radar_nea_m[2]
    run = (steps * lattice.cell_m)[:, None]
    nearest = np.maximum(run - slack_m, 1e-9)
    return np.where(rise > 0.0, rise / nearest, rise / (run + slack_m))
