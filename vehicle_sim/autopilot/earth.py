"""The plane that an autopilot flies in: each firmware has its own, about its estimator's origin."""

import math
from typing import Final, final

from vehicle_sim.autopilot.estimator import Estimator
from vehicle_sim.autopilot.values import Place, Vector
from vehicle_sim.geodesy import ARDUPILOT_M_PER_DEG, around, degrees_east


@final
class FlatEarth:
    """ArduPilot's: degrees of a sphere, of longitude scaled by the latitude between."""

    def __init__(self, origin: Place) -> None:
        self.origin = origin

    def ned_m(self, place: Place | Estimator) -> Vector:
        """Where it is, as Location::get_distance_NED says it."""
        origin = self.origin
        north_deg = place.latitude_deg - origin.latitude_deg
        east_deg = degrees_east(origin.longitude_deg, place.longitude_deg)
        east_m = east_deg * ARDUPILOT_M_PER_DEG * self._scale(north_deg)
        down_m = origin.altitude_amsl_m - place.altitude_amsl_m
        return north_deg * ARDUPILOT_M_PER_DEG, east_m, down_m

    def place(self, north_m: float, east_m: float, down_m: float) -> Place:
        """The inverse."""
        origin, north_deg = self.origin, north_m / ARDUPILOT_M_PER_DEG
        east_deg = east_m / (ARDUPILOT_M_PER_DEG * self._scale(north_deg))
        longitude_deg = around(origin.longitude_deg + east_deg)
        return Place(
            origin.latitude_deg + north_deg, longitude_deg, origin.altitude_amsl_m - down_m
        )

    def _scale(self, north_deg: float) -> float:
        """How much shorter a degree of longitude is there than one of latitude; at least 0.01."""
        between_deg = self.origin.latitude_deg + 0.5 * north_deg
        return max(math.cos(math.radians(between_deg)), 0.01)


def way_m(one: Place, other: Place) -> complex:
    """From one place to another, as ArduPilot measures it."""
    return complex(*FlatEarth(one).ned_m(other)[:2])


_RADIUS_M: Final = 6_371_000.0  # of PX4's sphere (CONSTANTS_RADIUS_OF_EARTH)
_NEAR_RAD: Final = 1e-9


@final
class Projection:
    """PX4's: azimuthal equidistant, on a sphere (MapProjection of its geo library)."""

    def __init__(self, origin: Place) -> None:
        self.origin = origin
        self._latitude_rad = math.radians(origin.latitude_deg)
        self._longitude_rad = math.radians(origin.longitude_deg)
        self._sine, self._cosine = math.sin(self._latitude_rad), math.cos(self._latitude_rad)

    def ned_m(self, place: Place | Estimator) -> Vector:
        """Where it is, as MapProjection::project says it."""
        latitude_rad = place.latitude_deg * 0.017453292519943295
        east_rad = place.longitude_deg * 0.017453292519943295 - self._longitude_rad
        sine, cosine = math.sin(latitude_rad), math.cos(latitude_rad)
        cos_east = math.cos(east_rad)
        north = self._cosine * sine - self._sine * cosine * cos_east
        east = cosine * math.sin(east_rad)
        away = math.hypot(north, east)
        # atan2 where PX4 has acos: the same, but for rounding near the origin
        angle = math.atan2(away, self._sine * sine + self._cosine * cosine * cos_east)
        scale = _RADIUS_M * (angle / away if away > _NEAR_RAD else 1.0)
        return scale * north, scale * east, self.origin.altitude_amsl_m - place.altitude_amsl_m

    def place(self, north_m: float, east_m: float, down_m: float) -> Place:
        """The inverse (MapProjection::reproject)."""
        origin, away_m = self.origin, math.hypot(north_m, east_m)
        angle, altitude_m = away_m / _RADIUS_M, origin.altitude_amsl_m - down_m
        if angle < 1e-12:
            return origin.at(altitude_m)
        sine, cosine = math.sin(angle), math.cos(angle)
        north, east = north_m / away_m, east_m / away_m
        vertical = cosine * self._sine + north * sine * self._cosine
        east_rad = math.atan2(east * sine, self._cosine * cosine - north * self._sine * sine)
        longitude_rad = math.remainder(self._longitude_rad + east_rad, math.tau)
        latitude_rad = math.asin(min(max(vertical, -1.0), 1.0))
        return Place(math.degrees(latitude_rad), math.degrees(longitude_rad), altitude_m)


Frame = FlatEarth | Projection
"""North, east and down of a place, in metres; and the place of those."""
