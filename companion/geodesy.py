"""Frames and units: the local frame, meridian convergence, and the wire's integers.

The local frame is an azimuthal equidistant projection about an origin (WGS84), so that distances
and directions from the origin are those of the geodesic.  Its north axis agrees with true north
only at the origin (1 degree off 100 km east at 47 N): velocities and yaw are rotated by
the convergence on their way to and from the wire (design section 3).
"""

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TypeVar, final

import numpy as np
import numpy.typing as npt
import pyproj

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Places = TypeVar("Places", float, FloatArray)

_WGS84 = pyproj.Geod(ellps="WGS84")
LEAST_RADIUS_M = 6_330_000.0
"""The ground curves away no faster: WGS 84 has 6,335 km along the meridian at the equator, and
altitudes of up to 5 km count as in height above them."""
_BASELINE_M = 100.0  # long enough that rounding of the projection does not show in the azimuth
_SAME_M = 32.0  # over which the convergence changes by less than 1e-5 rad below 85 degrees
_NEAR = 64  # places whose convergence is kept: where the vehicle is, and is sent


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LocalFrame:
    """North, east in metres about an origin, and back."""

    latitude_deg: float
    longitude_deg: float
    _projection: pyproj.Proj = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        projection = pyproj.Proj(
            proj="aeqd", lat_0=self.latitude_deg, lon_0=self.longitude_deg, datum="WGS84"
        )
        object.__setattr__(self, "_projection", projection)

    def to_local_m(self, latitude_deg: Places, longitude_deg: Places) -> tuple[Places, Places]:
        """Latitude, longitude in degrees -> north, east in metres: numbers, or (...) of them."""
        east_m, north_m = self._projection(longitude_deg, latitude_deg)
        return north_m, east_m

    def to_geodetic_deg(self, north_m: Places, east_m: Places) -> tuple[Places, Places]:
        """North, east in metres -> latitude, longitude in degrees: numbers, or (...) of them."""
        longitude_deg, latitude_deg = self._projection(east_m, north_m, inverse=True)
        return latitude_deg, longitude_deg

    def grid_north_rad(self, north_m: float, east_m: float) -> float:
        """True azimuth of the frame's north axis at a point, radians clockwise.

        A direction of azimuth a in the local frame has the true azimuth a + this.  It is that of
        the middle of a cell of 32 m, which is asked for with nearly every message.
        """
        return _north_of_cell_rad(self, round(north_m / _SAME_M), round(east_m / _SAME_M))


@lru_cache(maxsize=_NEAR)
def _north_of_cell_rad(frame: LocalFrame, row: int, column: int) -> float:
    north_m, east_m = row * _SAME_M, column * _SAME_M
    lat_a, lon_a = frame.to_geodetic_deg(north_m, east_m)
    lat_b, lon_b = frame.to_geodetic_deg(north_m + _BASELINE_M, east_m)
    azimuth_deg, _, _ = _WGS84.inv(lon_a, lat_a, lon_b, lat_b)
    return math.radians(azimuth_deg)


def offset_deg(
    latitude_deg: float, longitude_deg: float, north_m: float, east_m: float
) -> tuple[float, float]:
    """The point that lies north_m, east_m (true north and east, along the geodesic) of another."""
    azimuth_deg = math.degrees(math.atan2(east_m, north_m))
    longitude, latitude, _ = _WGS84.fwd(
        longitude_deg, latitude_deg, azimuth_deg, math.hypot(north_m, east_m)
    )
    return latitude, longitude


def rotate(north: float, east: float, angle_rad: float) -> tuple[float, float]:
    """Turn a horizontal vector clockwise (from north towards east)."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return north * cos - east * sin, north * sin + east * cos


def deg_e7(degrees: float) -> int:
    """Degrees -> the wire's 1e-7 degrees."""
    return round(degrees * 1e7)


def deg(degrees_e7: int) -> float:
    """The wire's 1e-7 degrees -> degrees."""
    return degrees_e7 * 1e-7


def wrap_rad(angle_rad: float) -> float:
    """The same angle between -pi and pi."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi
