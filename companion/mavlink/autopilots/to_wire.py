"""Setpoints and commands as they go on the wire: refused if not finite or out of range.

Units, frames and datums change here only: inside is the local frame, altitudes AMSL, SI; on the
wire are latitude and longitude in 1e-7 degrees and true-north NED.
"""

import math
from dataclasses import dataclass, replace
from typing import final

from companion.geodesy import LocalFrame, deg_e7, rotate
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mission.events import Setpoint, Vector

HIGHEST_AMSL_M = 50_000.0
_LOWEST_AMSL_M = -500.0
_FASTEST_M_S = 1000.0
"""ArduCopter takes more for an error and stops (ardupilot.md 3)."""
_FURTHEST_M = 2.0e7
"""Half way round: no local frame reaches further."""
_NOWHERE_DEG = 0.01
"""So near to latitude = longitude = 0 nobody is, and nobody is to be sent: what has no position
yet says that it is there, and an ArduPlane drifts about there by some metres (recorded)."""
_LATEST_S = 4.29e6
"""time_boot_ms is an unsigned 32-bit number."""

POSITION_VELOCITY_YAW = 2496
"""type_mask: acceleration and yaw rate are ignored."""
POSITION_VELOCITY = 3520
"""type_mask: acceleration, yaw and yaw rate are ignored."""
POSITION = 3576
"""type_mask: everything but the position is ignored."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class WirePoint:
    """A setpoint in the wire's frames and units; all of it finite and in range."""

    time_ms: int
    latitude_e7: int
    longitude_e7: int
    altitude_amsl_m: float
    velocity_ned_m_s: Vector
    """True north, east, down."""
    yaw_rad: float
    """Clockwise from true north, within half a turn."""


def wire_point(setpoint: Setpoint, frame: LocalFrame) -> WirePoint | None:
    """A setpoint as it may go on the wire; None if any value is not finite or out of range."""
    position, velocity = setpoint.position_nea_m, setpoint.velocity_nea_m_s
    values = (*position, *velocity, setpoint.yaw_rad, setpoint.time_s)
    if not all(map(math.isfinite, values)) or not 0.0 <= setpoint.time_s < _LATEST_S:
        return None
    if math.hypot(*velocity) > _FASTEST_M_S:
        return None
    place = wire_place(position, frame)
    if place is None:
        return None
    turn = frame.grid_north_rad(position[0], position[1])
    north_m_s, east_m_s = rotate(velocity[0], velocity[1], turn)
    yaw_rad = math.remainder(setpoint.yaw_rad + turn, math.tau)
    if not all(map(math.isfinite, (north_m_s, east_m_s, yaw_rad))):
        return None
    return WirePoint(
        time_ms=round(setpoint.time_s * 1e3),
        latitude_e7=place[0],
        longitude_e7=place[1],
        altitude_amsl_m=position[2],
        velocity_ned_m_s=(north_m_s, east_m_s, -velocity[2]),
        yaw_rad=yaw_rad,
    )


def wire_place(position_nea_m: Vector, frame: LocalFrame) -> tuple[int, int] | None:
    """Latitude and longitude, 1e-7 degrees; None for a place that nobody should be sent to."""
    north_m, east_m, altitude_m = position_nea_m
    if not all(map(math.isfinite, position_nea_m)):
        return None
    if max(abs(north_m), abs(east_m)) > _FURTHEST_M:
        return None
    if not _LOWEST_AMSL_M <= altitude_m <= HIGHEST_AMSL_M:
        return None
    latitude, longitude = frame.to_geodetic_deg(north_m, east_m)
    if not (math.isfinite(latitude) and math.isfinite(longitude)):
        return None
    if is_nowhere(latitude, longitude):
        return None
    return deg_e7(latitude), deg_e7(longitude)


def is_nowhere(latitude_deg: float, longitude_deg: float) -> bool:
    """Whether this stands for having no position."""
    return max(abs(latitude_deg), abs(longitude_deg)) < _NOWHERE_DEG


def hovering_setpoint(
    setpoint: Setpoint, frame: LocalFrame, system_id: int, *, loiter_radius_m: float = 0.0
) -> list[Message] | None:
    """Position, velocity and yaw for what can stand still; to stay is a velocity of zero."""
    del loiter_radius_m
    point = wire_point(setpoint, frame)
    if point is None:
        return None
    if setpoint.stay:
        point = replace(point, velocity_ned_m_s=(0.0, 0.0, 0.0))
    return [position_target(point, POSITION_VELOCITY_YAW, system_id)]


def position_target(point: WirePoint, type_mask: int, system_id: int) -> Message:
    """SET_POSITION_TARGET_GLOBAL_INT in frame 5: AMSL, which all autopilots get right."""
    return wire.MAVLink_set_position_target_global_int_message(
        point.time_ms,
        system_id,
        AUTOPILOT_COMPONENT,
        wire.MAV_FRAME_GLOBAL_INT,
        type_mask,
        point.latitude_e7,
        point.longitude_e7,
        point.altitude_amsl_m,
        *point.velocity_ned_m_s,
        0.0,
        0.0,
        0.0,
        point.yaw_rad,
        0.0,
    )


def command_long(system_id: int, command: int, *parameters: float) -> Message:
    """COMMAND_LONG to the autopilot; parameters left out are 0."""
    padded = (*parameters, *([0.0] * (7 - len(parameters))))
    return wire.MAVLink_command_long_message(system_id, AUTOPILOT_COMPONENT, command, 0, *padded)


def command_int(
    system_id: int,
    command: int,
    parameters: tuple[float, float, float, float],
    place_e7: tuple[int, int] = (0, 0),
    altitude_amsl_m: float = 0.0,
) -> Message:
    """COMMAND_INT to the autopilot, in frame 5 (AMSL); place: latitude, longitude."""
    return wire.MAVLink_command_int_message(
        system_id,
        AUTOPILOT_COMPONENT,
        wire.MAV_FRAME_GLOBAL_INT,
        command,
        0,
        0,
        *parameters,
        *place_e7,
        altitude_amsl_m,
    )


def set_mode(system_id: int, *numbers: int) -> Message:
    """DO_SET_MODE with the autopilot's own numbers."""
    flag = wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    return command_long(system_id, wire.MAV_CMD_DO_SET_MODE, flag, *numbers)


def reposition(
    system_id: int,
    place_e7: tuple[int, int],
    altitude_amsl_m: float,
    *,
    switch: bool,
    radius_m: float,
    yaw_rad: float,
) -> Message:
    """DO_REPOSITION, at the speed that it has.

    switch: whether it is to go into the mode for this; yaw_rad: to a plane of ArduPilot's the sense
    of its circles, 0 clockwise.
    """
    as_it_is = -1.0
    parameters = (as_it_is, float(switch), radius_m, yaw_rad)
    number = wire.MAV_CMD_DO_REPOSITION
    return command_int(system_id, number, parameters, place_e7, altitude_amsl_m)
