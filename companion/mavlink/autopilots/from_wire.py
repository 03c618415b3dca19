"""What the messages that all autopilots send alike mean for the mission: messages to events."""

import math

from companion.geodesy import LocalFrame, deg, rotate
from companion.mavlink.autopilots.modes import Modes
from companion.mavlink.autopilots.to_wire import is_nowhere
from companion.mavlink.dialect import Message, wire
from companion.mission.events import (
    Battery,
    Echo,
    Event,
    GpsFix,
    Home,
    Landed,
    LandedState,
    Origin,
    Position,
    Vector,
    VehicleStatus,
)

_NO_HEADING = 65535
_FAILSAFE = (wire.MAV_STATE_CRITICAL, wire.MAV_STATE_EMERGENCY)
_LANDED = {
    wire.MAV_LANDED_STATE_UNDEFINED: Landed.UNKNOWN,
    wire.MAV_LANDED_STATE_ON_GROUND: Landed.ON_GROUND,
    wire.MAV_LANDED_STATE_IN_AIR: Landed.IN_AIR,
    wire.MAV_LANDED_STATE_TAKEOFF: Landed.TAKING_OFF,
    wire.MAV_LANDED_STATE_LANDING: Landed.LANDING,
}


def event_of(message: Message, now_s: float, frame: LocalFrame, modes: Modes) -> Event | None:
    """What a message means that all autopilots send alike."""
    match message.get_type():
        case "HEARTBEAT":
            return VehicleStatus(
                time_s=now_s,
                mode=modes.mode_of(message.custom_mode),
                armed=bool(message.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED),
                failsafe=message.system_status in _FAILSAFE,
            )
        case "GLOBAL_POSITION_INT":
            return _position(message, frame)
        case "EXTENDED_SYS_STATE":
            landed = _LANDED.get(message.landed_state, Landed.UNKNOWN)
            return LandedState(time_s=now_s, landed=landed)
        case "GPS_RAW_INT":
            return GpsFix(time_s=now_s, good=message.fix_type >= wire.GPS_FIX_TYPE_3D_FIX)
        case "HOME_POSITION":
            place = _place(message.latitude, message.longitude, message.altitude * 1e-3, frame)
            return None if place is None else Home(time_s=now_s, position_nea_m=place)
        case "GPS_GLOBAL_ORIGIN":
            place = _place(message.latitude, message.longitude, message.altitude * 1e-3, frame)
            return None if place is None else Origin(time_s=now_s, position_nea_m=place)
        case "SYS_STATUS":
            return _battery(message, now_s)
        case "BATTERY_STATUS":
            return _battery(message, now_s) if message.id == 0 else None
        case _:
            return None


def heading_rad(message: Message) -> float | None:
    """Where the nose points by GLOBAL_POSITION_INT, from true north; None: it does not say."""
    return None if message.hdg == _NO_HEADING else math.radians(message.hdg * 0.01)


def echo_at(
    place_deg: tuple[float, float],
    altitude_amsl_m: float,
    now_s: float,
    frame: LocalFrame,
    velocity_nea_m_s: Vector | None = None,
) -> Echo | None:
    """An echo of a setpoint there; None if it is no place."""
    latitude, longitude = place_deg
    if not all(map(math.isfinite, (latitude, longitude, altitude_amsl_m))):
        return None
    if is_nowhere(latitude, longitude):
        return None
    north_m, east_m = frame.to_local_m(latitude, longitude)
    if not (math.isfinite(north_m) and math.isfinite(east_m)):
        return None
    place = north_m, east_m, altitude_amsl_m
    return Echo(time_s=now_s, position_nea_m=place, velocity_nea_m_s=velocity_nea_m_s)


def _battery(message: Message, now_s: float) -> Battery | None:
    """Percent left; -1 means that the autopilot does not know."""
    percent = message.battery_remaining
    return Battery(time_s=now_s, remaining=percent * 0.01) if 0 <= percent <= 100 else None


def _place(
    latitude_e7: int, longitude_e7: int, altitude_m: float, frame: LocalFrame
) -> Vector | None:
    """A place of the wire; None about latitude = longitude = 0: then there is none yet."""
    latitude, longitude = deg(latitude_e7), deg(longitude_e7)
    if is_nowhere(latitude, longitude):
        return None
    north_m, east_m = frame.to_local_m(latitude, longitude)
    if not (math.isfinite(north_m) and math.isfinite(east_m)):
        return None
    return north_m, east_m, altitude_m


def _position(message: Message, frame: LocalFrame) -> Position | None:
    """The vehicle's position, if it has one."""
    place = _place(message.lat, message.lon, message.alt * 1e-3, frame)
    if place is None:
        return None
    turn, heading = -frame.grid_north_rad(place[0], place[1]), heading_rad(message)
    north_m_s, east_m_s = rotate(message.vx * 0.01, message.vy * 0.01, turn)
    return Position(
        time_s=message.time_boot_ms * 1e-3,
        position_nea_m=place,
        velocity_nea_m_s=(north_m_s, east_m_s, -message.vz * 0.01),
        heading_rad=None if heading is None else heading + turn,
    )
