"""Messages to events, and setpoints and commands to messages.

Units, frames and datums are converted here only.  Inside: local frame, altitudes AMSL, SI.  On the
wire: latitude and longitude in 1e-7 degrees, true-north NED.  Values that are not finite or out of
range are never sent.
"""

import cmath
import math
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from companion.geodesy import LocalFrame
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mission import events

HIGHEST_AMSL_M = 50_000.0
_LOWEST_AMSL_M = -500.0
_FASTEST_M_S = 1000.0
"""ArduCopter treats more as an error and stops (ardupilot.md 3)."""
_FURTHEST_M = 2.0e7
"""Half way round: no local frame reaches further."""
NOWHERE_DEG = 0.01
"""Treat (0, 0) +- 0.01 degrees as "no position": autopilots report it before they have one, and an
ArduPlane drifts about there by some metres (recorded)."""
_LATEST_S = 4.29e6
"""time_boot_ms is an unsigned 32-bit number."""

POSITION_VELOCITY_YAW = 2496
"""type_mask: acceleration and yaw rate are ignored."""
POSITION_VELOCITY = 3520
"""type_mask: acceleration, yaw and yaw rate are ignored."""
POSITION = 3576
"""type_mask: everything but the position is ignored."""
_E7 = 1e-7  # degrees in the wire's unit of them
_NO_HEADING = 65535
_NOTHING = (0.0, 0.0, 0.0)
_LANDED: Final = dict(enumerate(events.Landed))
"""By MAV_LANDED_STATE, which has the same order."""

Decoder = Callable[[Message, float, LocalFrame, events.Vector | None], events.Event | None]
"""(message, now_s, frame, origin_nea_m) -> event; arguments as in `Autopilot.event_of`."""

# --- in


def position(
    message: Message, _now_s: float, frame: LocalFrame, *_: object
) -> events.Position | None:
    """GLOBAL_POSITION_INT: the vehicle's position, if it has one."""
    place = place_of(message.lat * _E7, message.lon * _E7, message.alt * 1e-3, frame)
    if place is None:
        return None
    turn, heading = -frame.grid_north_rad(place[0], place[1]), message.hdg
    over_ground = complex(message.vx * 0.01, message.vy * 0.01) * cmath.rect(1.0, turn)
    return events.Position(
        time_s=message.time_boot_ms * 1e-3,
        position_nea_m=place,
        velocity_nea_m_s=(over_ground.real, over_ground.imag, -message.vz * 0.01),
        heading_rad=None if heading == _NO_HEADING else math.radians(heading * 0.01) + turn,
    )


def _landed(message: Message, now_s: float, *_: object) -> events.LandedState:
    landed = _LANDED.get(message.landed_state, events.Landed.UNKNOWN)
    return events.LandedState(time_s=now_s, landed=landed)


def _gps(message: Message, now_s: float, *_: object) -> events.GpsFix:
    return events.GpsFix(time_s=now_s, good=message.fix_type >= wire.GPS_FIX_TYPE_3D_FIX)


def _placed(
    message: Message, now_s: float, frame: LocalFrame, *_: object
) -> events.Home | events.Origin | None:
    """HOME_POSITION or GPS_GLOBAL_ORIGIN, once there is one."""
    latitude, longitude = message.latitude * _E7, message.longitude * _E7
    place = place_of(latitude, longitude, message.altitude * 1e-3, frame)
    is_home = message.get_msgId() == wire.MAVLINK_MSG_ID_HOME_POSITION
    kind = events.Home if is_home else events.Origin
    return None if place is None else kind(time_s=now_s, position_nea_m=place)


def _battery(message: Message, now_s: float, *_: object) -> events.Battery | None:
    """Percent left; -1 means that the autopilot does not know."""
    percent = message.battery_remaining
    return events.Battery(time_s=now_s, remaining=percent * 0.01) if 0 <= percent <= 100 else None


def _one_battery(message: Message, now_s: float, *_: object) -> events.Battery | None:
    """Battery 0 only: others may power something else."""
    return _battery(message, now_s) if message.id == 0 else None


DECODERS: Final[Mapping[int, Decoder]] = {
    wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: position,
    wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _landed,
    wire.MAVLINK_MSG_ID_GPS_RAW_INT: _gps,
    wire.MAVLINK_MSG_ID_HOME_POSITION: _placed,
    wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _placed,
    wire.MAVLINK_MSG_ID_SYS_STATUS: _battery,
    wire.MAVLINK_MSG_ID_BATTERY_STATUS: _one_battery,
}
"""Message id -> decoder, for messages common to all autopilots; HEARTBEAT needs their modes."""


def echo_at(
    place_deg: tuple[float, float],
    altitude_amsl_m: float,
    now_s: float,
    frame: LocalFrame,
    velocity_nea_m_s: events.Vector | None = None,
) -> events.Echo | None:
    """A position target echo; None if the position is invalid."""
    place = place_of(*place_deg, altitude_amsl_m, frame)
    if place is None:
        return None
    return events.Echo(time_s=now_s, position_nea_m=place, velocity_nea_m_s=velocity_nea_m_s)


def place_of(
    latitude_deg: float, longitude_deg: float, altitude_m: float, frame: LocalFrame
) -> events.Vector | None:
    """A position from the wire; None if there is none yet, or it is nowhere on Earth."""
    if max(abs(latitude_deg), abs(longitude_deg)) < NOWHERE_DEG or not abs(longitude_deg) <= 180.0:
        return None
    place = (*frame.to_local_m(latitude_deg, longitude_deg), altitude_m)
    return place if all(map(math.isfinite, place)) else None  # beyond a pole it is not


# --- out


class To(NamedTuple):
    """Whom a message is for, and the frame in which its places are given."""

    system_id: int
    frame: LocalFrame


def _wire_place(position_nea_m: events.Vector, frame: LocalFrame) -> tuple[int, int] | None:
    """Latitude and longitude, 1e-7 degrees; None for an invalid destination."""
    north_m, east_m, altitude_m = position_nea_m
    in_band = _LOWEST_AMSL_M <= altitude_m <= HIGHEST_AMSL_M  # NaN is not
    if not in_band or not math.hypot(north_m, east_m) <= _FURTHEST_M:
        return None
    latitude, longitude = frame.to_geodetic_deg(north_m, east_m)
    is_nowhere = max(abs(latitude), abs(longitude)) < NOWHERE_DEG
    if is_nowhere or not math.isfinite(latitude + longitude):
        return None
    return round(latitude * 1e7), round(longitude * 1e7)


def position_target(
    setpoint: events.Setpoint,
    to: To,
    _loiter_radius_m: float = 0.0,
    type_mask: int = POSITION_VELOCITY_YAW,
) -> list[Message] | None:
    """SET_POSITION_TARGET_GLOBAL_INT in frame 5: AMSL, which all autopilots get right.

    By default position, velocity and yaw, for multicopters: to hold is a velocity of zero.  Yaw is
    clockwise from true north, within half a turn.  None as for `Autopilot.setpoint`.
    """
    position, velocity = setpoint.position_nea_m, setpoint.velocity_nea_m_s
    numbers = math.isfinite(setpoint.yaw_rad) and 0.0 <= setpoint.time_s < _LATEST_S
    if not (numbers and math.hypot(*velocity) <= _FASTEST_M_S):  # NaN is not
        return None
    place_e7 = _wire_place(position, to.frame)
    if place_e7 is None:
        return None
    turn_rad = to.frame.grid_north_rad(position[0], position[1])
    if not math.isfinite(turn_rad):
        return None
    over_ground = complex(velocity[0], velocity[1]) * cmath.rect(1.0, turn_rad)  # north + east j
    yaw_rad = math.remainder(setpoint.yaw_rad + turn_rad, math.tau)
    holds = setpoint.stay and type_mask == POSITION_VELOCITY_YAW
    velocity_ned_m_s = _NOTHING if holds else (over_ground.real, over_ground.imag, -velocity[2])
    head = to.system_id, AUTOPILOT_COMPONENT, wire.MAV_FRAME_GLOBAL_INT, type_mask
    return [
        wire.MAVLink_set_position_target_global_int_message(
            *(round(setpoint.time_s * 1e3), *head, *place_e7, position[2]),
            *(*velocity_ned_m_s, *_NOTHING, yaw_rad, 0.0),
        )
    ]


def command_long(system_id: int, command: int, *parameters: float) -> Message:
    """COMMAND_LONG to the autopilot; parameters left out are 0."""
    padded = (*parameters, *([0.0] * (7 - len(parameters))))
    return wire.MAVLink_command_long_message(system_id, AUTOPILOT_COMPONENT, command, 0, *padded)


def command_int(system_id: int, command: int, *values: float) -> Message:
    """COMMAND_INT to the autopilot, in frame 5 (AMSL): four parameters, and a place on the wire."""
    head = system_id, AUTOPILOT_COMPONENT, wire.MAV_FRAME_GLOBAL_INT, command, 0, 0
    return wire.MAVLink_command_int_message(*head, *values)


def command_at(
    to: To,
    command: int,
    parameters: tuple[float, float, float, float],
    place_nea_m: events.Vector,
) -> list[Message]:
    """COMMAND_INT with a place; empty if that is not finite or out of range."""
    place_e7 = _wire_place(place_nea_m, to.frame)
    if place_e7 is None:
        return []
    return [command_int(to.system_id, command, *parameters, *place_e7, place_nea_m[2])]


def set_mode(system_id: int, *numbers: int) -> Message:
    """DO_SET_MODE with the autopilot's own numbers."""
    flag = wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    return command_long(system_id, wire.MAV_CMD_DO_SET_MODE, flag, *numbers)


def reposition(
    to: To, place_nea_m: events.Vector, *, switch: bool, radius_m: float, yaw_rad: float
) -> list[Message]:
    """DO_REPOSITION at the current speed; empty if it is not finite or out of range.

    switch: whether it is to go into the mode for this; yaw_rad: to a plane of ArduPilot's the sense
    of its circles, 0 clockwise.
    """
    parameters = (-1.0, float(switch), radius_m, yaw_rad)  # -1: the speed that it has
    return command_at(to, wire.MAV_CMD_DO_REPOSITION, parameters, place_nea_m)
