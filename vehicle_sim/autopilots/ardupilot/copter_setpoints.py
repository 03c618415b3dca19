"""How ArduCopter reads SET_POSITION_TARGET: masks, frames, and what it calls "stop".

Measured on ArduCopter 4.7 (ardupilot.md 3): any single ignored axis drops its whole group, bits
above 11 are not read, and whatever makes no sense stops the vehicle without an answer.  Where the
real one aborts its process (a number that is not finite, a position in the millions), this one
stops and says so, with a text that begins with "SIM:".
"""

import math
from dataclasses import dataclass
from typing import final

from vehicle_sim.autopilots import Place, Setpoint
from vehicle_sim.autopilots.ardupilot.flat_earth import Vector, flat_earth_place, offset

IGNORE_POSITION, IGNORE_VELOCITY, IGNORE_ACCELERATION = 0x007, 0x038, 0x1C0
_FORCE, IGNORE_YAW, IGNORE_YAW_RATE = 0x200, 0x400, 0x800
_FRAMES_AMSL, _FRAMES_ABOVE_HOME, _FRAMES_TERRAIN = (0, 5), (3, 6), (10, 11)
_LOCAL_NED, _LOCAL_OFFSET_NED, _BODY_NED, _BODY_OFFSET_NED = 1, 7, 8, 9
_LOCAL_FRAMES = (_LOCAL_NED, _LOCAL_OFFSET_NED, _BODY_NED, _BODY_OFFSET_NED)
_FARTHEST_M = 1e6
_FASTEST_M_S = 1000.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A setpoint that was understood; what it leaves out is None.  Vectors north, east, up."""

    place: Place | None
    velocity_neu_m_s: Vector | None
    acceleration_neu_m_s2: Vector
    yaw_rad: float | None = None
    yaw_rate_rad_s: float | None = None


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


def read_setpoint(setpoint: Setpoint, bearings: Bearings) -> Target | Stop:
    """What ArduCopter makes of a setpoint in GUIDED."""
    mask = setpoint.type_mask
    use_position = not mask & IGNORE_POSITION
    use_velocity = not mask & IGNORE_VELOCITY
    use_acceleration = not mask & IGNORE_ACCELERATION
    if use_acceleration and mask & _FORCE:
        return Stop()
    if use_velocity and not all(abs(v) <= _FASTEST_M_S for v in setpoint.velocity_ned_m_s):
        return Stop()  # NaN too
    dropped = setpoint.is_global and use_position and use_velocity
    honoured = use_acceleration and not dropped  # GLOBAL_INT takes position and velocity only
    if not setpoint.is_global and setpoint.frame not in _LOCAL_FRAMES:
        return Stop()
    if use_acceleration and use_position and not use_velocity:
        return Stop()
    if not (use_position or use_velocity or honoured):
        return Stop()
    text = _fatal(setpoint, use_position=use_position, use_acceleration=honoured)
    if text is not None:
        return Stop(text=text)
    place = _place(setpoint, bearings, use_velocity=use_velocity) if use_position else None
    if isinstance(place, Stop):
        return place
    velocity, acceleration = setpoint.velocity_ned_m_s, setpoint.acceleration_ned_m_s2
    relative = not setpoint.is_global and setpoint.frame in (_BODY_NED, _BODY_OFFSET_NED)
    yaw_rad = None if mask & IGNORE_YAW else setpoint.yaw_rad
    if yaw_rad is not None and relative:
        yaw_rad += bearings.heading_rad
    return Target(
        place=place,
        velocity_neu_m_s=_north_east_up(setpoint, velocity, bearings) if use_velocity else None,
        acceleration_neu_m_s2=_north_east_up(setpoint, acceleration, bearings)
        if honoured
        else (0.0, 0.0, 0.0),
        yaw_rad=yaw_rad,
        yaw_rate_rad_s=None if mask & IGNORE_YAW_RATE else setpoint.yaw_rate_rad_s,
    )


def _fatal(setpoint: Setpoint, *, use_position: bool, use_acceleration: bool) -> str | None:
    """What would end the real one's process: a floating point trap."""
    mask = setpoint.type_mask
    used = [
        *(setpoint.position if use_position else ()),
        *(setpoint.acceleration_ned_m_s2 if use_acceleration else ()),
        *(() if mask & IGNORE_YAW else (setpoint.yaw_rad,)),
        *(() if mask & IGNORE_YAW_RATE else (setpoint.yaw_rate_rad_s,)),
    ]
    if not all(map(math.isfinite, used)):
        return "SIM: setpoint not finite refused: aborts ArduPilot"
    if use_position and max(map(abs, setpoint.position)) > _FARTHEST_M:
        return "SIM: setpoint too far refused: aborts ArduPilot"
    return None


def _place(setpoint: Setpoint, bearings: Bearings, *, use_velocity: bool) -> Place | Stop:
    """Where the setpoint is."""
    if not setpoint.is_global:
        return _local_place(setpoint, bearings)
    latitude_deg, longitude_deg, altitude_m = setpoint.position
    if abs(latitude_deg) > 90.0 or abs(longitude_deg) > 180.0:
        return Stop()
    if setpoint.frame in _FRAMES_ABOVE_HOME:
        altitude_m += bearings.home.altitude_amsl_m
    elif setpoint.frame in _FRAMES_TERRAIN:
        if use_velocity:
            return Stop()
        # without terrain data the ground is taken to be at sea level: it flies into it
    elif setpoint.frame not in _FRAMES_AMSL:
        return Stop(text=f"Unknown mavlink coordinate frame {setpoint.frame}")
    return Place(latitude_deg, longitude_deg, altitude_m)


def _local_place(setpoint: Setpoint, bearings: Bearings) -> Place:
    if setpoint.frame == _LOCAL_NED:
        return flat_earth_place(bearings.origin, setpoint.position)
    return offset(bearings.vehicle, *_north_east_up(setpoint, setpoint.position, bearings))


def _north_east_up(setpoint: Setpoint, vector: Vector, bearings: Bearings) -> Vector:
    """Turn a vector out of the setpoint's frame."""
    x, y, down = vector
    if setpoint.is_global or setpoint.frame not in (_BODY_NED, _BODY_OFFSET_NED):
        return x, y, -down
    sine, cosine = math.sin(bearings.heading_rad), math.cos(bearings.heading_rad)
    return x * cosine - y * sine, x * sine + y * cosine, -down
