"""Commands as PX4's commander and navigator answer them.

Results are those measured (px4.md 2, 3, 7) and, for the rest, those of the source: a mode that
cannot run is TEMPORARILY_REJECTED, an unknown command UNSUPPORTED.
"""

import math
from typing import Final

from vehicle_sim.autopilots import (
    HIGHEST_HOME_M,
    Command,
    Place,
    Reboot,
    Result,
    SendTelemetry,
    height_amsl_m,
)
from vehicle_sim.autopilots.px4.autopilot import Handler, Px4
from vehicle_sim.autopilots.px4.modes import MANUAL_MODES, Mode, mode_of

_FORCE: Final = 21196.0
_HIGHEST_M: Final = 1e5
"""Altitudes beyond count as not given: they do not fit into any answer."""


def _place(px4: Px4, command: Command) -> tuple[float, float, float]:
    """Latitude, longitude and altitude AMSL of p5 to p7; NaN: not given."""
    latitude_deg, longitude_deg, altitude_m = command.parameters[4:]
    nowhere = latitude_deg == longitude_deg == 0.0
    if nowhere or not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):
        latitude_deg = longitude_deg = math.nan
    if not abs(altitude_m) <= _HIGHEST_M:
        altitude_m = math.nan
    frame = 0 if command.frame is None else command.frame
    if math.isfinite(altitude_m) and px4.home is not None:
        height_m = height_amsl_m(frame, altitude_m, px4.home.altitude_amsl_m, px4.ground_amsl_m)
        altitude_m = altitude_m if height_m is None else height_m
    return latitude_deg, longitude_deg, altitude_m


def _set_mode(px4: Px4, command: Command) -> Result:
    """DO_SET_MODE: p1 bit 0 says that p2 and p3 are PX4's own numbers."""
    flags, main, sub = command.parameters[:3]
    if not all(map(math.isfinite, (flags, main, sub))) or not int(flags) & 1:
        return Result.TEMPORARILY_REJECTED
    mode = mode_of(int(main), int(sub))
    if mode is None:
        return Result.TEMPORARILY_REJECTED
    return px4.command_mode(mode)


def _arm(px4: Px4, command: Command) -> Result:
    wanted, force = command.parameters[:2]
    if wanted not in (0.0, 1.0):
        return Result.UNSUPPORTED
    if wanted == 1.0:
        return px4.arm(forced=force == _FORCE)
    if px4.armed and not px4.landed and force != _FORCE and px4.mode not in MANUAL_MODES:
        return Result.TEMPORARILY_REJECTED
    px4.disarm("external command")
    return Result.ACCEPTED


def _take_off(px4: Px4, command: Command) -> Result:
    return px4.command_mode(Mode.TAKEOFF, takeoff=_place(px4, command))


def _land(px4: Px4, command: Command) -> Result:
    latitude_deg, longitude_deg, _ = _place(px4, command)
    given = math.isfinite(latitude_deg) and math.isfinite(longitude_deg)
    return px4.command_mode(Mode.LAND, land=(latitude_deg, longitude_deg) if given else None)


def _return(px4: Px4, _: Command) -> Result:
    return px4.command_mode(Mode.RTL)


def _reposition(px4: Px4, command: Command) -> Result:
    """DO_REPOSITION: p2 bit 0 changes to Hold; a target outside of the fence is refused."""
    latitude_deg, longitude_deg, altitude_m = _place(px4, command)
    if math.isfinite(latitude_deg) and math.isfinite(longitude_deg):
        north_m, east_m = px4.projection.to_local(latitude_deg, longitude_deg)
        if not px4.fence.allows(px4.projection, north_m, east_m):
            return Result.DENIED
    flags, yaw = command.parameters[1], command.parameters[3]
    switches = math.isfinite(flags) and bool(int(flags) & 1)
    if not switches and px4.mode is not Mode.LOITER:
        return Result.UNSUPPORTED
    target = (latitude_deg, longitude_deg, altitude_m, yaw)
    return px4.command_mode(Mode.LOITER, reposition=target)


def _change_speed(px4: Px4, command: Command) -> Result:
    """DO_CHANGE_SPEED: accepted always, of effect in AUTO modes only (px4.md 3)."""
    speed_m_s = command.parameters[1]
    if math.isfinite(speed_m_s):
        px4.speed_m_s = speed_m_s if speed_m_s > 0.0 else None
    return Result.ACCEPTED


def _set_home(px4: Px4, command: Command) -> Result:
    if command.parameters[0] == 1.0:
        if not px4.estimate.position_ok:
            return Result.TEMPORARILY_REJECTED
        px4.home = px4.estimate.place
    else:
        latitude_deg, longitude_deg, altitude_m = _place(px4, command)
        if not all(map(math.isfinite, (latitude_deg, longitude_deg, altitude_m))):
            return Result.DENIED
        if abs(altitude_m) > HIGHEST_HOME_M:
            return Result.DENIED
        px4.home = Place(latitude_deg, longitude_deg, altitude_m)
    px4.emit(SendTelemetry(message=242))
    return Result.ACCEPTED


def _start_mission(px4: Px4, command: Command) -> Result:
    """MISSION_START: AUTO:MISSION, and arm if need be."""
    if not px4.mission.items:
        return Result.DENIED
    first = command.parameters[0]
    if math.isfinite(first) and int(first) > 0:
        px4.mission.jump(int(first))
    result = px4.command_mode(Mode.MISSION)
    return px4.arm(forced=False) if result is Result.ACCEPTED else result


def _set_current(px4: Px4, command: Command) -> Result:
    number = command.parameters[0]
    known = math.isfinite(number) and px4.mission.jump(int(number))
    return Result.ACCEPTED if known else Result.DENIED


def _reboot(px4: Px4, command: Command) -> Result:
    """PREFLIGHT_REBOOT_SHUTDOWN: only while disarmed."""
    first = command.parameters[0]
    if px4.armed:
        return Result.TEMPORARILY_REJECTED
    if first in (1.0, 3.0):
        px4.emit(Reboot())
    return Result.ACCEPTED if first in (0.0, 1.0, 3.0) else Result.DENIED


def _accept(_px4: Px4, _command: Command) -> Result:
    return Result.ACCEPTED


def _answer(message: int) -> Handler:
    """An old command that asks for one message."""

    def send(px4: Px4, command: Command) -> Result:
        px4.emit(SendTelemetry(message=message, to=command.sender))
        return Result.ACCEPTED

    return send


HANDLERS: Final[dict[int, Handler]] = {
    20: _return,
    21: _land,
    22: _take_off,
    176: _set_mode,
    178: _change_speed,
    179: _set_home,
    192: _reposition,
    224: _set_current,
    246: _reboot,
    300: _start_mission,
    400: _arm,
    401: _accept,
    410: _answer(242),
    519: _answer(300),
    520: _answer(148),
}
"""By number: RETURN_TO_LAUNCH, LAND, TAKEOFF, ... REQUEST_AUTOPILOT_CAPABILITIES."""
