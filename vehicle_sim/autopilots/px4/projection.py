"""PX4's local frame: azimuthal equidistant about the estimator's origin, on a sphere.

MapProjection of PX4's geo library, radius 6371 km: what LOCAL_POSITION_NED and the setpoints of
SET_POSITION_TARGET_LOCAL_NED are in, and what GLOBAL_INT setpoints are converted by.
"""

import math
from typing import final

from vehicle_sim.autopilots import Place

_RADIUS_M = 6_371_000.0
_NEAR_RAD = 1e-9


@final
class Projection:
    """North and east metres about an origin."""

    def __init__(self, latitude_deg: float, longitude_deg: float) -> None:
        self._latitude_rad = math.radians(latitude_deg)
        self._longitude_rad = math.radians(longitude_deg)
        self._sine = math.sin(self._latitude_rad)
        self._cosine = math.cos(self._latitude_rad)

    def to_local(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """North and east of a place, in metres."""
        latitude_rad = latitude_deg * 0.017453292519943295
        east_rad = longitude_deg * 0.017453292519943295 - self._longitude_rad
        sine, cosine = math.sin(latitude_rad), math.cos(latitude_rad)
        cos_east = math.cos(east_rad)
        north = self._cosine * sine - self._sine * cosine * cos_east
        east = cosine * math.sin(east_rad)
        away = math.hypot(north, east)
        # atan2 where PX4 has acos: the same, but for rounding near the origin.
        angle = math.atan2(away, self._sine * sine + self._cosine * cosine * cos_east)
        scale = _RADIUS_M * (angle / away if away > _NEAR_RAD else 1.0)
        return scale * north, scale * east

    def to_geographic(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Latitude and longitude of a point, in degrees."""
        away_m = math.hypot(north_m, east_m)
        angle = away_m / _RADIUS_M
        if angle < 1e-12:
            return math.degrees(self._latitude_rad), math.degrees(self._longitude_rad)
        sine, cosine = math.sin(angle), math.cos(angle)
        north, east = north_m / away_m, east_m / away_m
        latitude_rad = math.asin(
            min(max(cosine * self._sine + north * sine * self._cosine, -1.0), 1.0)
        )
        longitude_rad = self._longitude_rad + math.atan2(
            east * sine, self._cosine * cosine - north * self._sine * sine
        )
        longitude_deg = math.degrees(math.remainder(longitude_rad, math.tau))
        return math.degrees(latitude_rad), longitude_deg

    def place(self, north_m: float, east_m: float, altitude_amsl_m: float) -> Place:
        """A point, at this height."""
        return Place(*self.to_geographic(north_m, east_m), altitude_amsl_m)
