"""Messages to events and commands to messages: units, frames and datums change here only."""

import math

from companion.geodesy import LocalFrame, deg, deg_e7, rotate
from companion.mavlink.autopilots import Autopilot
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mission.events import (
    Estimator,
    Event,
    GpsFix,
    Home,
    Landed,
    LandedState,
    Mode,
    Position,
    Setpoint,
    VehicleStatus,
)

POSITION_VELOCITY_YAW = 2496  # type_mask: acceleration and yaw rate are ignored
_HIGHEST_AMSL_M = 50_000.0
_LOWEST_AMSL_M = -500.0
_FASTEST_M_S = 1000.0  # ArduCopter takes more for an error and stops
_ESTIMATOR_NEEDS = wire.ESTIMATOR_POS_HORIZ_ABS  # EKF_STATUS_REPORT uses the same bit
_LANDED = {
    wire.MAV_LANDED_STATE_UNDEFINED: Landed.UNKNOWN,
    wire.MAV_LANDED_STATE_ON_GROUND: Landed.ON_GROUND,
    wire.MAV_LANDED_STATE_IN_AIR: Landed.IN_AIR,
    wire.MAV_LANDED_STATE_TAKEOFF: Landed.TAKING_OFF,
    wire.MAV_LANDED_STATE_LANDING: Landed.LANDING,
}


def event_of(
    message: Message, now_s: float, frame: LocalFrame, autopilot: Autopilot
) -> Event | None:
    """What a message of the autopilot means for the mission; None: nothing."""
    match message.get_type():
        case "HEARTBEAT":
            return VehicleStatus(
                time_s=now_s,
                mode=autopilot.mode_of(message.custom_mode),
                armed=bool(message.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED),
                fits=autopilot.flies(message.autopilot, message.type),
            )
        case "GLOBAL_POSITION_INT":
            return _position(message, frame)
        case "EXTENDED_SYS_STATE":
            landed = _LANDED.get(message.landed_state, Landed.UNKNOWN)
            return LandedState(time_s=now_s, landed=landed)
        case "GPS_RAW_INT":
            return GpsFix(time_s=now_s, good=message.fix_type >= wire.GPS_FIX_TYPE_3D_FIX)
        case "EKF_STATUS_REPORT":
            return Estimator(time_s=now_s, good=bool(message.flags & _ESTIMATOR_NEEDS))
        case "HOME_POSITION":
            return Home(time_s=now_s, altitude_amsl_m=message.altitude * 1e-3)
        case _:
            return None


def _position(message: Message, frame: LocalFrame) -> Position | None:
    """The vehicle's position; None for latitude = longitude = 0, which means that it has none."""
    if message.lat == 0 and message.lon == 0:
        return None
    north_m, east_m = frame.to_local_m(deg(message.lat), deg(message.lon))
    if not (math.isfinite(north_m) and math.isfinite(east_m)):
        return None
    turn = -frame.grid_north_rad(north_m, east_m)
    north_m_s, east_m_s = rotate(message.vx * 0.01, message.vy * 0.01, turn)
    return Position(
        time_s=message.time_boot_ms * 1e-3,
        position_nea_m=(north_m, east_m, message.alt * 1e-3),
        velocity_nea_m_s=(north_m_s, east_m_s, -message.vz * 0.01),
    )


def setpoint_message(setpoint: Setpoint, frame: LocalFrame, system_id: int) -> Message | None:
    """SET_POSITION_TARGET_GLOBAL_INT, or None if any value is not finite or out of range.

    The one function that makes setpoints: a NaN would abort ArduPilot's process, and 0, 0
    would be flown to.  Frame 5 (AMSL), position + velocity + yaw, true-north NED.
    """
    values = (*setpoint.position_nea_m, *setpoint.velocity_nea_m_s, setpoint.yaw_rad)
    if not all(math.isfinite(value) for value in (*values, setpoint.time_s)):
        return None
    north_m, east_m, altitude_m = setpoint.position_nea_m
    earth_m = 2.0e7  # half way round: no local frame reaches further
    if max(abs(north_m), abs(east_m)) > earth_m or not 0.0 <= setpoint.time_s < 4.29e6:
        return None
    in_range = _LOWEST_AMSL_M <= altitude_m <= _HIGHEST_AMSL_M
    if not in_range or math.hypot(*setpoint.velocity_nea_m_s) > _FASTEST_M_S:
        return None
    latitude, longitude = frame.to_geodetic_deg(north_m, east_m)
    turn = frame.grid_north_rad(north_m, east_m)
    north_m_s, east_m_s = rotate(setpoint.velocity_nea_m_s[0], setpoint.velocity_nea_m_s[1], turn)
    yaw = math.remainder(setpoint.yaw_rad + turn, math.tau)
    sent = (latitude, longitude, north_m_s, east_m_s, yaw)
    if not all(math.isfinite(value) for value in sent):
        return None
    if deg_e7(latitude) == deg_e7(longitude) == 0:
        return None
    return wire.MAVLink_set_position_target_global_int_message(
        round(setpoint.time_s * 1e3),
        system_id,
        AUTOPILOT_COMPONENT,
        wire.MAV_FRAME_GLOBAL_INT,
        POSITION_VELOCITY_YAW,
        deg_e7(latitude),
        deg_e7(longitude),
        altitude_m,
        north_m_s,
        east_m_s,
        -setpoint.velocity_nea_m_s[2],
        0.0,
        0.0,
        0.0,
        yaw,
        0.0,
    )


def command_long(system_id: int, command: int, *parameters: float) -> Message:
    """COMMAND_LONG to the autopilot; parameters left out are 0."""
    padded = (*parameters, *([0.0] * (7 - len(parameters))))
    return wire.MAVLink_command_long_message(system_id, AUTOPILOT_COMPONENT, command, 0, *padded)


def mode_message(system_id: int, mode: Mode, autopilot: Autopilot) -> Message:
    """DO_SET_MODE with the autopilot's own number of a mode."""
    return command_long(
        system_id,
        wire.MAV_CMD_DO_SET_MODE,
        wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
        autopilot.mode_numbers[mode],
    )


def heartbeat_message(system_status: int) -> Message:
    """The companion's heartbeat: an onboard controller, not an autopilot."""
    return wire.MAVLink_heartbeat_message(
        wire.MAV_TYPE_ONBOARD_CONTROLLER, wire.MAV_AUTOPILOT_INVALID, 0, 0, system_status, 3
    )
