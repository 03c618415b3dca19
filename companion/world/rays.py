"""Rays that go out from a radar over a lattice of cells: which cell each crosses at every step."""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from companion.geodesy import FloatArray

IntArray = NDArray[np.intp]

RAY_CELLS = 0.3
"""Between neighbouring rays at the farthest point, in cells."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Lattice:
    """Where the cells of an array are, in the local frame."""

    cell_m: float
    north_min_m: float
    east_min_m: float
    shape: tuple[int, int]
    """Rows and columns."""

    def crossed(
        self, radar_ne_m: tuple[float, float], azimuth_rad: FloatArray, steps: FloatArray
    ) -> IntArray:
        """Cells under points steps x cell_m away from a radar, as indices of the ravelled array.

        (rays,), (steps,) -> (steps, rays).  Beyond the edge it is the nearest cell.
        """
        rows, columns = self.shape
        row = np.multiply.outer(steps, np.cos(azimuth_rad))  # in place from here on
        row += (radar_ne_m[0] - self.north_min_m) / self.cell_m
        column = np.multiply.outer(steps, np.sin(azimuth_rad))
        column += (radar_ne_m[1] - self.east_min_m) / self.cell_m
        flat = np.clip(row, 0, rows - 1, out=row).astype(np.intp)
        flat *= columns
        flat += np.clip(column, 0, columns - 1, out=column).astype(np.intp)
        return flat


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
            azimuth_rad=(np.flatnonzero(used) + first) * apart_rad,
            distance_m=distance,
            ray_of=(np.cumsum(used) - 1)[index - first],
            farthest_m=farthest,
        )


def all_round(cell_m: float, farthest_m: float) -> FloatArray:
    """Azimuths of rays in all directions, RAY_CELLS apart at the farthest.  -> (rays,), radians."""
    count = math.ceil(2.0 * math.pi * farthest_m / (RAY_CELLS * cell_m))
    return np.arange(count) * (2.0 * math.pi / count)
