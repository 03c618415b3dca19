"""Radars (eq. 3): what is known in advance of those who look for the vehicle."""

from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray


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


def detection_probability(distance_m: FloatArray, range_m: float | FloatArray) -> FloatArray:
    """Eq. 3: R^4 / (R^4 + d^4) within the range, 0 beyond it.  (...) -> (...)."""
    ratio = (distance_m / range_m) ** 4
    return np.where(distance_m <= range_m, 1.0 / (1.0 + ratio), 0.0)
