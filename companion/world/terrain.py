"""The true terrain of the paper's worlds (eq. 1).  In flight only the simulator has it."""

from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """One mountain of eq. 1: h exp(-((x - x0) / xs)^2 - ((y - y0) / ys)^2)."""

    north_m: float
    east_m: float
    height_amsl_m: float
    spread_north_m: float
    spread_east_m: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PeakTerrain:
    """The ground, and the highest (or the sum) of all peaks over it."""

    peaks: tuple[Peak, ...]
    ground_amsl_m: float
    sum_of_peaks: bool = False

    def height_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Terrain height, metres AMSL.  (...) x2 -> (...)."""
        return self.highest_in_box_m(north_m, north_m, east_m, east_m)

    def highest_in_box_m(
        self,
        north_min: FloatArray,
        north_max: FloatArray,
        east_min: FloatArray,
        east_max: FloatArray,
    ) -> FloatArray:
        """Highest terrain of axis-aligned boxes, metres AMSL.  (...) x4 -> (...).

        A peak is highest at the box's nearest point to its centre; exact for the maximum of
        peaks, an upper bound for their sum.
        """
        result = np.full(
            np.broadcast_shapes(np.shape(north_min), np.shape(east_min)),
            0.0 if self.sum_of_peaks and self.peaks else -np.inf,
        )
        for peak in self.peaks:
            north = (
                np.clip(peak.north_m, north_min, north_max) - peak.north_m
            ) / peak.spread_north_m
            east = (np.clip(peak.east_m, east_min, east_max) - peak.east_m) / peak.spread_east_m
            height = peak.height_amsl_m * np.exp(-(north**2) - east**2)
            result = result + height if self.sum_of_peaks else np.maximum(result, height)
        return np.maximum(result, self.ground_amsl_m)
