"""SET_POSITION_TARGET as the two firmwares read it (ardupilot.md 3, px4.md 4).

ArduCopter takes groups: one ignored axis drops position, velocity or acceleration as a whole, bits
above 11 are not read, and what it does not like means "stop", without an answer.  PX4 takes each
axis by itself, and what it does not like counts as no setpoint at all.
"""

import math
from typing import Final, NamedTuple, final

from vehicle_sim.autopilot.values import Setpoint, Vector, height_amsl_m

_POSITION, _VELOCITY, _ACCELERATION, _YAW, _YAW_RATE = 0x007, 0x038, 0x1C0, 0x400, 0x800
"""Bits of type_mask that these are ignored by."""
_FORCE: Final = 0x200
LOCAL_NED, _LOCAL_OFFSET_NED, _BODY_NED, _BODY_OFFSET_NED = 1, 7, 8, 9
_GLOBAL_INT: Final = (5, 6, 11)
_NAN: Final = math.nan
NOTHING: Final = (_NAN, _NAN, _NAN)
_MOST, _FASTEST_M_S = 1e6, 1000.0
"""Of ArduCopter: other values beyond the one abort its process, velocities beyond the other stop
it."""


@final
class Target(NamedTuple):
    """What is to be flown: north, east, down; NaN: not given."""

    position: Vector = NOTHING
    """Of a global one latitude, longitude and z as its frame measures it."""
    velocity: Vector = NOTHING
    acceleration: Vector = NOTHING
    yaw_rad: float = _NAN
    yaw_rate_rad_s: float = _NAN
    is_global: bool = False
    frame: int = LOCAL_NED
    """MAV_FRAME; of a local one that is another, the place is measured from the vehicle."""


@final
class Stop(NamedTuple):
    """What ArduCopter makes of a setpoint that it does not like."""

    text: str = ""
    """About one that the real one does not survive."""


def given(vector: Vector) -> bool:
    """Whether it is there; either all of it is, or nothing."""
    return vector[0] == vector[0]


def turned(vector: Vector, heading_rad: float) -> Vector:
    """From the body's heading to north and east; one axis that is not given leaves neither."""
    x, y, z = vector
    sine, cosine = math.sin(heading_rad), math.cos(heading_rad)
    return x * cosine - y * sine, x * sine + y * cosine, z


def read_by_arducopter(setpoint: Setpoint, heading_rad: float) -> Target | Stop:
    """Decode a setpoint as ArduCopter does in GUIDED."""
    is_global, frame, mask = setpoint[:3]
    place = None if mask & _POSITION else setpoint.position
    velocity = None if mask & _VELOCITY else setpoint.velocity_ned_m_s
    push = None if mask & _ACCELERATION else setpoint.acceleration_ned_m_s2
    yaw_rad = 0.0 if mask & _YAW else setpoint.yaw_rad
    yaw_rate_rad_s = 0.0 if mask & _YAW_RATE else setpoint.yaw_rate_rad_s
    if push and (mask & _FORCE or (place and not velocity)):
        return Stop()
    if is_global and place and velocity:
        push = None  # it is not even read
    if velocity and not all(abs(v) <= _FASTEST_M_S for v in velocity):
        return Stop()
    known = is_global or frame in (LOCAL_NED, _LOCAL_OFFSET_NED, _BODY_NED, _BODY_OFFSET_NED)
    if not known or not (place or velocity or push):
        return Stop()
    used = (*(place or ()), *(push or ()), yaw_rad, yaw_rate_rad_s)
    if not all(abs(v) <= _MOST for v in used):  # nor is NaN
        return Stop("SIM: setpoint refused: aborts ArduPilot")
    if is_global and place:
        wild = abs(place[0]) > 90.0 or abs(place[1]) > 180.0
        unknown = height_amsl_m(frame, 0.0, 0.0, None if velocity else 0.0) is None
        if wild or unknown:
            return Stop()
    vectors = [vector or NOTHING for vector in (place, velocity, push)]
    if not is_global and frame in (_BODY_NED, _BODY_OFFSET_NED):
        vectors = [turned(vector, heading_rad) for vector in vectors]
        yaw_rad += heading_rad
    yaws = (_NAN if mask & _YAW else yaw_rad, _NAN if mask & _YAW_RATE else yaw_rate_rad_s)
    return Target(vectors[0], vectors[1], vectors[2], *yaws, is_global, frame)


def read_by_px4(setpoint: Setpoint, heading_rad: float) -> Target | None:
    """Decode a setpoint as PX4 does; None: it is dropped and does not count."""
    mask, frame = setpoint.type_mask, setpoint.frame
    position = _axes(setpoint.position, mask)
    velocity = _axes(setpoint.velocity_ned_m_s, mask >> 3)
    acceleration = _axes(setpoint.acceleration_ned_m_s2, mask >> 6)
    if mask & _FORCE and any(map(math.isfinite, acceleration)):
        return None
    if setpoint.is_global:
        if mask & _POSITION:  # any ignored axis drops the position, whatever the frame
            position = NOTHING
        elif frame not in _GLOBAL_INT:
            return None
        elif not all(map(math.isfinite, position[:2])):
            position = NOTHING
    elif frame == _BODY_NED and not any(map(math.isfinite, position)):
        velocity, acceleration = turned(velocity, heading_rad), turned(acceleration, heading_rad)
    elif frame != LOCAL_NED:
        return None
    if not any(map(math.isfinite, position + velocity + acceleration)):
        return None
    yaw_rad = _NAN if mask & _YAW else _finite(setpoint.yaw_rad)
    rate_rad_s = _NAN if mask & _YAW_RATE else _finite(setpoint.yaw_rate_rad_s)
    return Target(position, velocity, acceleration, yaw_rad, rate_rad_s, setpoint.is_global, frame)


def is_flyable(target: Target) -> bool:
    """Whether PX4's position controller can fly it: all axes have something, north and east alike.

    Otherwise it stays in OFFBOARD and brakes to a standstill ("Failsafe: stop and wait").
    """
    vectors = target[:3]
    return all((v[0] == v[0]) == (v[1] == v[1]) for v in vectors) and all(
        any(v[axis] == v[axis] for v in vectors) for axis in range(3)
    )


def _axes(vector: Vector, ignored: int) -> Vector:
    """NaN for the axes whose bit is set, and for those that are not finite."""
    x, y, z = (_NAN if ignored >> axis & 1 else _finite(v) for axis, v in enumerate(vector))
    return x, y, z


def _finite(value: float) -> float:
    return value if math.isfinite(value) else _NAN
