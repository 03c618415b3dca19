"""How ArduCopter reads SET_POSITION_TARGET: masks, frames, and what it calls "stop".

Measured on ArduCopter 4.7: any single ignored axis drops its whole group, bits above 11 are not
read, and whatever makes no sense stops the vehicle without an answer.  Where the real one aborts
its process (a number that is not finite, a position in the millions), this one stops and says so.
"""

import math
from dataclasses import dataclass
from typing import final

from vehicle_sim.autopilots import Place, Setpoint
from vehicle_sim.geodesy import metres_per_degree

Vector = tuple[float, float, float]

_IGNORE_POSITION, _IGNORE_VELOCITY, _IGNORE_ACCELERATION = 0x007, 0x038, 0x1C0
_FORCE, _IGNORE_YAW = 0x200, 0x400
_FRAMES_AMSL, _FRAMES_ABOVE_HOME, _FRAMES_TERRAIN = (0, 5), (3, 6), (10, 11)
_LOCAL_NED, _LOCAL_OFFSET_NED, _BODY_NED, _BODY_OFFSET_NED = 1, 7, 8, 9
_FARTHEST_M = 1e6
_FASTEST_M_S = 1000.0
_FLAT_EARTH_M_PER_DEG = 111318.84502145034
"""ArduPilot's scale: a sphere's, along the meridian, and times cos(latitude) across it."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A setpoint that was understood; what it leaves out is None.  Velocities north, east, up."""

    place: Place | None
    velocity_neu_m_s: Vector | None
    acceleration_neu_m_s2: Vector
    yaw_rad: float | None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """A setpoint that means "stop", and what is said about it, if anything."""

    text: str | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Bearings:
    """What setpoints are measured from."""

    vehicle: Place
    heading_rad: float
    home: Place
    origin: Place


def flat_earth_ned_m(origin: Place, place: Place) -> Vector:
    """Position in the estimator's local frame, as ArduPilot computes it."""
    middle_deg = 0.5 * (origin.latitude_deg + place.latitude_deg)
    east_m = (place.longitude_deg - origin.longitude_deg) * _FLAT_EARTH_M_PER_DEG
    return (
        (place.latitude_deg - origin.latitude_deg) * _FLAT_EARTH_M_PER_DEG,
        east_m * max(math.cos(math.radians(middle_deg)), 0.01),
        origin.altitude_amsl_m - place.altitude_amsl_m,
    )


def flat_earth_place(origin: Place, ned_m: Vector) -> Place:
    """The inverse of flat_earth_ned_m."""
    north_deg = ned_m[0] / _FLAT_EARTH_M_PER_DEG
    scale = max(math.cos(math.radians(origin.latitude_deg + 0.5 * north_deg)), 0.01)
    return Place(
        latitude_deg=origin.latitude_deg + north_deg,
        longitude_deg=origin.longitude_deg + ned_m[1] / (_FLAT_EARTH_M_PER_DEG * scale),
        altitude_amsl_m=origin.altitude_amsl_m - ned_m[2],
    )


def read_setpoint(setpoint: Setpoint, bearings: Bearings) -> Target | Stop:
    """What ArduCopter makes of a setpoint in GUIDED."""
    mask = setpoint.type_mask
    use_position = not mask & _IGNORE_POSITION
    use_velocity = not mask & _IGNORE_VELOCITY
    use_acceleration = not mask & _IGNORE_ACCELERATION
    yaw_rad = None if mask & _IGNORE_YAW else setpoint.yaw_rad
    used = [
        *(setpoint.position if use_position else ()),
        *(setpoint.velocity_ned_m_s if use_velocity else ()),
        *(setpoint.acceleration_ned_m_s2 if use_acceleration else ()),
        *(() if yaw_rad is None else (yaw_rad,)),
    ]
    if not all(map(math.isfinite, used)):
        return Stop(text="Setpoint not finite: refused, stopping")
    if use_acceleration and (mask & _FORCE or not use_velocity):
        return Stop()  # a force, or an acceleration that nothing limits: not flown here
    if not use_position and not use_velocity:
        return Stop()
    if use_velocity and max(map(abs, setpoint.velocity_ned_m_s)) > _FASTEST_M_S:
        return Stop()
    place = _place(setpoint, bearings, use_position=use_position, use_velocity=use_velocity)
    if isinstance(place, Stop):
        return place
    honoured = use_acceleration and not setpoint.is_global  # dropped in GLOBAL_INT, as measured
    return Target(
        place=place,
        velocity_neu_m_s=_north_east_up(setpoint, setpoint.velocity_ned_m_s, bearings)
        if use_velocity
        else None,
        acceleration_neu_m_s2=_north_east_up(setpoint, setpoint.acceleration_ned_m_s2, bearings)
        if honoured
        else (0.0, 0.0, 0.0),
        yaw_rad=yaw_rad,
    )


def _place(
    setpoint: Setpoint, bearings: Bearings, *, use_position: bool, use_velocity: bool
) -> Place | Stop | None:
    """Where the setpoint is, None if it names no position."""
    if not setpoint.is_global and setpoint.frame not in (
        _LOCAL_NED,
        _LOCAL_OFFSET_NED,
        _BODY_NED,
        _BODY_OFFSET_NED,
    ):
        return Stop()
    if not use_position:
        return None
    if max(map(abs, setpoint.position)) > _FARTHEST_M:
        return Stop(text="Setpoint out of range: refused, stopping")
    if not setpoint.is_global:
        return _local_place(setpoint, bearings)
    return _global_place(setpoint, bearings, use_velocity=use_velocity)


def _global_place(setpoint: Setpoint, bearings: Bearings, *, use_velocity: bool) -> Place | Stop:
    latitude_deg, longitude_deg, altitude_m = setpoint.position
    if abs(latitude_deg) > 90.0 or abs(longitude_deg) > 180.0:
        return Stop()
    if setpoint.frame in _FRAMES_ABOVE_HOME:
        altitude_m += bearings.home.altitude_amsl_m
    elif setpoint.frame not in _FRAMES_AMSL:
        silent = use_velocity or setpoint.frame in _FRAMES_TERRAIN
        return Stop(text=None if silent else f"Unknown mavlink coordinate frame {setpoint.frame}")
    return Place(latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_amsl_m=altitude_m)


def _local_place(setpoint: Setpoint, bearings: Bearings) -> Place:
    if setpoint.frame == _LOCAL_NED:
        return flat_earth_place(bearings.origin, setpoint.position)
    vehicle = bearings.vehicle
    north_m, east_m, up_m = _north_east_up(setpoint, setpoint.position, bearings)
    metres_north, metres_east = metres_per_degree(vehicle.latitude_deg)
    return Place(
        latitude_deg=vehicle.latitude_deg + north_m / metres_north,
        longitude_deg=vehicle.longitude_deg + east_m / metres_east,
        altitude_amsl_m=vehicle.altitude_amsl_m + up_m,
    )


def _north_east_up(setpoint: Setpoint, vector: Vector, bearings: Bearings) -> Vector:
    """Turn a vector out of the setpoint's frame."""
    x, y, down = vector
    if setpoint.is_global or setpoint.frame not in (_BODY_NED, _BODY_OFFSET_NED):
        return x, y, -down
    sine, cosine = math.sin(bearings.heading_rad), math.cos(bearings.heading_rad)
    return x * cosine - y * sine, x * sine + y * cosine, -down
