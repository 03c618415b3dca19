"""ArduPilot's own flat earth: the local frame of its estimator, about the estimator's origin."""

import math

from vehicle_sim.autopilots import Place
from vehicle_sim.geodesy import ARDUPILOT_M_PER_DEG, around, degrees_east

Vector = tuple[float, float, float]


def longitude_scale(latitude_deg: float) -> float:
    """How much shorter a degree of longitude is than one of latitude; 0.01 at least."""
    return max(math.cos(math.radians(latitude_deg)), 0.01)


def flat_earth_ned_m(origin: Place, place: Place) -> Vector:
    """Position in the estimator's local frame, as ArduPilot computes it."""
    middle_deg = 0.5 * (origin.latitude_deg + place.latitude_deg)
    east_m = degrees_east(origin.longitude_deg, place.longitude_deg) * ARDUPILOT_M_PER_DEG
    return (
        (place.latitude_deg - origin.latitude_deg) * ARDUPILOT_M_PER_DEG,
        east_m * longitude_scale(middle_deg),
        origin.altitude_amsl_m - place.altitude_amsl_m,
    )


def flat_earth_place(origin: Place, ned_m: Vector) -> Place:
    """The inverse of flat_earth_ned_m."""
    north_deg = ned_m[0] / ARDUPILOT_M_PER_DEG
    scale = longitude_scale(origin.latitude_deg + 0.5 * north_deg)
    return Place(
        origin.latitude_deg + north_deg,
        around(origin.longitude_deg + ned_m[1] / (ARDUPILOT_M_PER_DEG * scale)),
        origin.altitude_amsl_m - ned_m[2],
    )


def distance_m(one: Place, other: Place) -> float:
    """Horizontal distance, as ArduPilot's Location::get_distance."""
    north_m, east_m, _ = flat_earth_ned_m(one, other)
    return math.hypot(north_m, east_m)


def bearing_rad(one: Place, other: Place) -> float:
    """Course from one place to the other, from 0 to 2 pi."""
    north_m, east_m, _ = flat_earth_ned_m(one, other)
    return math.atan2(east_m, north_m) % math.tau


def offset(place: Place, north_m: float, east_m: float, up_m: float = 0.0) -> Place:
    """The place so far away from this one."""
    return flat_earth_place(place, (north_m, east_m, -up_m))
