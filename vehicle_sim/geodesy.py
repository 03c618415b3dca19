"""Positions on the WGS84 ellipsoid: the world's local frame, and metres per degree.

The vehicle is kept as latitude, longitude and height and advanced by true-north velocities over
the ellipsoid's radii of curvature: right at any distance from the origin, with no convergence to
rotate by.  The local frame (azimuthal equidistant: geodesic distance and azimuth from the origin)
serves only what is defined in it: terrain, radars, the truth file.  Heights do not stretch
horizontal distances: a metre is a metre on the ellipsoid, as in the local frame.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray
from pyproj import Geod

FloatArray = NDArray[np.float64]

WGS84 = Geod(ellps="WGS84")
ARDUPILOT_M_PER_DEG = 111318.84502145034
"""ArduPilot's flat earth: a sphere's degree along the meridian, and times cos(latitude) across."""
EARTH_RADIUS_M = 6_371_009.0
"""Mean radius (2 a + b) / 3: of the sphere over which sight lines are straight."""
_ONE_DEG_RAD = math.pi / 180.0
_ECCENTRICITY_SQUARED = WGS84.es
_RADIUS_DEG_M = WGS84.a * _ONE_DEG_RAD
_MERIDIAN_SHARE = 1.0 - _ECCENTRICITY_SQUARED
_MIN_COSINE = 1e-6


def around(longitude_deg: float) -> float:
    """The same meridian, from -180 to less than 180 degrees."""
    if -180.0 <= longitude_deg < 180.0:
        return longitude_deg
    return (longitude_deg + 180.0) % 360.0 - 180.0


def degrees_east(from_deg: float, to_deg: float) -> float:
    """From one meridian to another the shorter way, degrees, also over the date line."""
    return math.remainder(to_deg - from_deg, 360.0)


def metres_per_degree(latitude_deg: float) -> tuple[float, float]:
    """Length of one degree of latitude and of longitude: radii of curvature M and N cos(lat)."""
    latitude_rad = latitude_deg * _ONE_DEG_RAD
    sine = math.sin(latitude_rad)
    w2 = 1.0 - _ECCENTRICITY_SQUARED * sine * sine
    prime_vertical = _RADIUS_DEG_M / math.sqrt(w2)
    cosine = math.cos(latitude_rad)
    if cosine < _MIN_COSINE:
        cosine = _MIN_COSINE
    return prime_vertical * _MERIDIAN_SHARE / w2, prime_vertical * cosine


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LocalFrame:
    """North and east about an origin: a point's geodesic distance along its azimuth."""

    latitude_deg: float
    longitude_deg: float

    def to_local(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """North and east of one point, in metres."""
        lon, lat = self.longitude_deg, self.latitude_deg
        azimuth_deg, _, distance_m = WGS84.inv(lon, lat, longitude_deg, latitude_deg)
        azimuth_rad = math.radians(azimuth_deg)
        return distance_m * math.cos(azimuth_rad), distance_m * math.sin(azimuth_rad)

    def to_geographic(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Latitude and longitude of one point, in degrees."""
        lon, lat, distance_m = self.longitude_deg, self.latitude_deg, math.hypot(north_m, east_m)
        azimuth_deg = math.degrees(math.atan2(east_m, north_m))
        longitude_deg, latitude_deg, _ = WGS84.fwd(lon, lat, azimuth_deg, distance_m)
        return latitude_deg, longitude_deg

    def to_local_many(
        self, latitude_deg: FloatArray, longitude_deg: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """North and east of many points.  (K,), (K,) -> (K,), (K,)."""
        lon, lat, _ = np.broadcast_arrays(self.longitude_deg, self.latitude_deg, longitude_deg)
        azimuth_deg, _, distance_m = WGS84.inv(lon, lat, longitude_deg, latitude_deg)
        azimuth_rad = np.radians(azimuth_deg)
        return distance_m * np.cos(azimuth_rad), distance_m * np.sin(azimuth_rad)

    def to_geographic_many(
        self, north_m: FloatArray, east_m: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Latitude and longitude of many points.  (K,), (K,) -> (K,), (K,)."""
        lon, lat, _ = np.broadcast_arrays(self.longitude_deg, self.latitude_deg, north_m)
        azimuth_deg, distance_m = np.degrees(np.arctan2(east_m, north_m)), np.hypot(north_m, east_m)
        longitude_deg, latitude_deg, _ = WGS84.fwd(lon, lat, azimuth_deg, distance_m)
        return latitude_deg, longitude_deg
