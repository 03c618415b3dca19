"""Radars (eq. 3) and keep-out zones: what is known in advance and is not terrain."""

import math
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


def detection_probability(
    distance_m: FloatArray, range_m: float, margin_m: float = 0.0
) -> FloatArray:
    """Eq. 3: R^4 / (R^4 + d^4) within the range (and a margin), 0 beyond it.  (...) -> (...)."""
    ratio = (distance_m / range_m) ** 4
    return np.where(distance_m <= range_m + margin_m, 1.0 / (1.0 + ratio), 0.0)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CircleKeepOut:
    """A vertical cylinder that the vehicle must stay out of."""

    name: str
    north_m: float
    east_m: float
    radius_m: float

    def distance_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Horizontal distance to the edge, negative inside, metres.  (...) x2 -> (...)."""
        return np.hypot(north_m - self.north_m, east_m - self.east_m) - self.radius_m


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PolygonKeepOut:
    """A vertical prism over a simple polygon that the vehicle must stay out of."""

    name: str
    vertices_ne_m: tuple[tuple[float, float], ...]

    def distance_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Horizontal distance to the edge, negative inside, metres.  (...) x2 -> (...).

        Distance to the nearest edge segment; inside by the even-odd rule.
        """
        nearest = np.full(np.shape(north_m), math.inf)
        inside = np.zeros(np.shape(north_m), dtype=bool)
        ends = self.vertices_ne_m[1:] + self.vertices_ne_m[:1]
        for (an, ae), (bn, be) in zip(self.vertices_ne_m, ends, strict=True):
            dn, de = bn - an, be - ae
            squared = max(dn * dn + de * de, 1e-12)  # a corner may be given twice
            along = np.clip(((north_m - an) * dn + (east_m - ae) * de) / squared, 0.0, 1.0)
            gap = np.hypot(north_m - an - along * dn, east_m - ae - along * de)
            nearest = np.minimum(nearest, gap)
            if de:
                crosses = (ae > east_m) != (be > east_m)
                inside ^= crosses & (north_m < an + (east_m - ae) * dn / de)
        return np.where(inside, -nearest, nearest)


KeepOut = CircleKeepOut | PolygonKeepOut
