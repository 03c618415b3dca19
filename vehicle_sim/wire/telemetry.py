"""An autopilot's report as MAVLink messages: a function each, which has the name of its message.

It returns the fields.  Those that somebody reads are filled as in the recorded flights, the others
are zero.  None: there is nothing to say now.
"""

import math
from collections.abc import Callable
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Landed, Report
from vehicle_sim.geodesy import ARDUPILOT_M_PER_DEG, degrees_east
from vehicle_sim.parameters import Firmware
from vehicle_sim.wire.frames import Layout, Prepared, filled, layout_of

Fields = tuple[Any, ...]
"""Of a message in MAVLink's order; those at the end that are left out are zero."""
Builder = tuple[Layout, Callable[[Report], Fields | None]]

_FIXED_WING: Final = 1
_NAN: Final = math.nan
_NO_VECTOR: Final = (_NAN, _NAN, _NAN)
_HUGE: Final = 1 << 62
"""More than any field of whole numbers carries: the packer makes the nearest of it."""
_NO_DILUTION, _NO_CELL, _NO_TEMPERATURE = 65535, 65535, 32767
_CENTIAMPERES_UNKNOWN: Final = -100
"""As PX4's simulated battery says it."""
_ARDUPILOT_SENSORS, _PX4_SENSORS = 0x4241_9C0F, 0x0200_000F
"""SYS_STATUS: gyroscopes, accelerometers, compass, pressure ...: always there and well."""
_GPS_BIT, _POSITION_BIT, _PREARM_BIT = 0x20, 0x4000, 0x1000_0000
_ONLY_POSITION: Final = 0xFDF8
_LOCAL, _GLOBAL, _GLOBAL_INT, _DOWN = 1, 0, 5, 25
"""Three of MAV_FRAME, and the orientation of a sensor."""
_TAKEOFF, _MISSION, _RETURN, _LAND = 0x0204_0000, 0x0404_0000, 0x0504_0000, 0x0604_0000
_ALTITUDE, _POSITION = 0x0002_0000, 0x0003_0000
_MODES: Final = (_POSITION, _ALTITUDE, _RETURN, _MISSION, _LAND, _TAKEOFF)
_STANDARD_MODES: Final = dict(zip(_MODES, (1, 4, 5, 6, 7, 8), strict=True))
"""MAV_STANDARD_MODE by custom_mode of PX4: 7 and 8 as recorded, the others from the source."""


# --- numbers --------------------------------------------------------------------------------------


def whole(value: float) -> int:
    """The nearest whole number; 0 for NaN."""
    if -_HUGE < value < _HUGE:
        return round(value)
    return 0 if math.isnan(value) else int(math.copysign(_HUGE, value))


def _e7(place: Any) -> tuple[int, int]:
    """Latitude and longitude of anything that has them, in 1e-7 degrees."""
    return whole(place.latitude_deg * 1e7), whole(place.longitude_deg * 1e7)


def _e7_mm(place: Any) -> tuple[int, int, int]:
    """Latitude, longitude and height above the sea."""
    return *_e7(place), whole(place.altitude_amsl_m * 1e3)


def _is_px4(now: Report) -> bool:
    return now.firmware.family == "px4"


def _is_plane(now: Report) -> bool:
    return now.firmware.vehicle_type == _FIXED_WING


def _boot_ms(now: Report) -> int:
    return now.time_us // 1000 & 0xFFFFFFFF


def _heading_cdeg(now: Report) -> int:
    """Where the nose points, 0 to 35999."""
    return round(math.degrees(now.vehicle.heading_rad) * 100.0) % 36000


def _yaw_rad(now: Report) -> float:
    """The same, from -pi to pi."""
    return math.remainder(now.vehicle.heading_rad, math.tau)


def _quaternion(now: Report) -> tuple[float, float, float, float]:
    """Attitude, scalar first: as if it yawed, then pitched, then rolled."""
    roll, pitch, yaw = now.vehicle.roll_rad / 2.0, now.vehicle.pitch_rad / 2.0, _yaw_rad(now) / 2.0
    turn = complex(math.cos(yaw), math.sin(yaw))
    level = turn * complex(math.cos(roll) * math.cos(pitch), -math.sin(roll) * math.sin(pitch))
    bent = turn * complex(math.sin(roll) * math.cos(pitch), math.cos(roll) * math.sin(pitch))
    return level.real, bent.real, bent.imag, level.imag


def _velocity_ned_m_s(now: Report) -> tuple[float, float, float]:
    """The estimate's."""
    level = now.estimate.velocity_m_s
    return level.real, level.imag, -now.estimate.velocity_up_m_s


def _altitude_amsl_m(now: Report) -> float:
    """ArduPilot's stands still with the position; the height above home does not."""
    frozen_m = now.estimate.frozen_altitude_amsl_m
    return now.estimate.altitude_amsl_m if frozen_m is None else frozen_m


def _per_cent_left(now: Report) -> float:
    """Of the battery's charge."""
    return min(max(now.autopilot.battery.remaining, 0.0), 1.0) * 100.0


# --- what and how it is ---------------------------------------------------------------------------


def _heartbeat(now: Report) -> Fields:
    firmware, status = now.firmware, now.status
    modes = (status.base_mode, status.mode, status.system_status)
    return firmware.vehicle_type, firmware.autopilot, *modes, 3


def _current_mode(now: Report) -> Fields:
    status = now.status
    standard = 0 if status.failsafe else _STANDARD_MODES.get(status.mode, 0)
    intended = status.mode if status.intended_mode is None else status.intended_mode
    return standard, status.mode, intended


def _extended_sys_state(now: Report) -> Fields:
    vtol = 0 if _is_px4(now) or _is_plane(now) else mavlink.MAV_VTOL_STATE_MC
    return vtol, now.status.landed_state


def _system_time(now: Report) -> Fields:
    return now.unix_us, _boot_ms(now)


def _timesync(now: Report) -> Fields:
    """A question; the last digit tells ArduPilot's from those of others."""
    return 0, now.time_us * 1000 + (0 if _is_px4(now) else 1)


def _autopilot_version(now: Report) -> Fields:
    version, custom = now.firmware.software_version, list(now.firmware.custom_version)
    head = (now.firmware.capabilities, version)
    if _is_px4(now):
        return *head, version, 101854463, 1, custom, custom, [0] * 8, 0, 0, now.hardware_id
    uid = list(now.hardware_id.to_bytes(18, "little"))
    return *head, 0, 0, 0, custom, [0] * 8, [0] * 8, 0, 0, 0, uid


def _sys_status(now: Report) -> Fields:
    prearm, battery = _PREARM_BIT if now.status.prearm_ok else 0, _gauge(now)
    if _is_px4(now):
        there = _PX4_SENSORS | (_GPS_BIT if now.estimate.aiding else 0)
        well = there | prearm | (_POSITION_BIT if now.estimate.position_ok else 0)
        wanted = there | _POSITION_BIT | _PREARM_BIT
        battery = (*battery[:2], math.ceil(_per_cent_left(now)))
        return wanted, wanted, well, 0, *battery, *[0] * 8, 1
    there, lost = now.range_sensors
    there |= _ARDUPILOT_SENSORS | (_GPS_BIT if now.autopilot.fix.fix_type > 0 else 0)
    wanted, well = there | _PREARM_BIT, there & ~lost | prearm
    return wanted, wanted, well, 0, *battery


def _gauge(now: Report) -> tuple[int, int, int]:
    """Millivolts, centiamperes and per cent."""
    battery, left = now.autopilot.battery, math.floor(_per_cent_left(now) + 1e-9)
    amperes = _CENTIAMPERES_UNKNOWN if _is_px4(now) else whole(battery.current_a * 100.0)
    return whole(battery.voltage_v * 1e3), amperes, left


def _battery_status(now: Report) -> Fields:
    volts, amperes, left = _gauge(now)
    kind, energy = ((0, 1, 1), -1) if _is_px4(now) else ((0, 0, 0), 0)
    cells, consumed = [volts, *[_NO_CELL] * 9], whole(now.autopilot.battery.consumed_mah)
    return *kind, _NO_TEMPERATURE, cells, amperes, consumed, energy, left, 0, 1


# --- where it is ----------------------------------------------------------------------------------


def _attitude(now: Report) -> Fields:
    angles_rad = (now.vehicle.roll_rad, now.vehicle.pitch_rad, _yaw_rad(now))
    return _boot_ms(now), *angles_rad, *now.autopilot.rates_rad_s


def _attitude_quaternion(now: Report) -> Fields:
    return _boot_ms(now), *_quaternion(now), *now.autopilot.rates_rad_s


def _local_position_ned(now: Report) -> Fields | None:
    here_m = now.autopilot.local_ned_m()
    return here_m and (_boot_ms(now), *here_m, *_velocity_ned_m_s(now))


def _odometry(now: Report) -> Fields | None:
    here_m, frames = now.autopilot.local_ned_m(), (_LOCAL, _LOCAL)
    moving = (list(_quaternion(now)), *_velocity_ned_m_s(now), *now.autopilot.rates_rad_s)
    rest = ([_NAN] * 21, [_NAN] * 21, 0, mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT)
    return here_m and (now.time_us, *frames, *here_m, *moving, *rest)


def _global_position_int(now: Report) -> Fields | None:
    """Of PX4 once it has an origin."""
    home = now.autopilot.home
    if _is_px4(now) and now.estimate.origin is None:
        return None
    above_home_m = 0.0 if home is None else now.estimate.altitude_amsl_m - home.altitude_amsl_m
    mm = whole(_altitude_amsl_m(now) * 1e3), whole(above_home_m * 1e3)
    cm_s = [whole(each * 100.0) for each in _velocity_ned_m_s(now)]
    return _boot_ms(now), *_e7(now.estimate), *mm, *cm_s, _heading_cdeg(now)


def _gps_raw_int(now: Report) -> Fields | None:
    """Before the receiver speaks ArduPilot knows nothing, and PX4 says nothing."""
    fix = now.autopilot.fix
    if _is_px4(now) and not fix.time_us:
        return None
    solution: Fields = (0, 0, 0, 0, _NO_DILUTION, _NO_DILUTION, 0, 0)
    if _is_px4(now) or fix.fix_type:
        north, east = fix.velocity_north_m_s, fix.velocity_east_m_s
        dilutions = (*fix.quality[:2], math.hypot(north, east))
        course_cdeg = round(math.degrees(math.atan2(east, north)) * 100.0) % 36000
        hundredths = (whole(each * 100.0) for each in dilutions)
        solution = (fix.fix_type, *_e7_mm(fix), *hundredths, course_cdeg)
    mm = (whole(each * 1e3) for each in (fix.altitude_amsl_m, *fix.quality[2:]))
    return fix.time_us, *solution, fix.satellites, *mm


def _vfr_hud(now: Report) -> Fields:
    """A plane says its indicated airspeed, a copter of PX4 none."""
    airspeed_m_s, altitude_m = now.vehicle.airspeed_m_s, now.estimate.altitude_amsl_m
    if _is_px4(now):
        airspeed_m_s = airspeed_m_s if _is_plane(now) else _NAN
    else:
        indicated_m_s, known = (
            now.status.airspeed_m_s,
            now.autopilot.fix.fix_type or now.time_us > 10_000_000,
        )
        airspeed_m_s = airspeed_m_s if indicated_m_s is None else indicated_m_s
        altitude_m = round(_altitude_amsl_m(now), 2) if known else 0.0
    north, east, down = _velocity_ned_m_s(now)
    throttle = round(min(max(now.vehicle.throttle, 0.0), 1.0) * 100.0)
    speeds_m_s = (airspeed_m_s, math.hypot(north, east))
    return *speeds_m_s, _heading_cdeg(now) // 100, throttle, altitude_m, -down


def _altitude(now: Report) -> Fields:
    """Above the sea, the origin, home and the ground's own height; and above the ground."""
    amsl_m, origin, home = now.estimate.altitude_amsl_m, now.estimate.origin, now.autopilot.home
    above_m = _NAN if now.status.above_ground_m is None else now.status.above_ground_m
    known_m, local_m = (_NAN, _NAN) if origin is None else (amsl_m, amsl_m - origin.altitude_amsl_m)
    above_home_m = _NAN if home is None else amsl_m - home.altitude_amsl_m
    heights_m = (now.vehicle.altitude_amsl_m, known_m, local_m, above_home_m)
    return now.time_us, *heights_m, local_m - above_m, above_m


def _distance_sensor(now: Report) -> Fields | None:
    """PX4's; of ArduPilot's proximity.py says more."""
    above_m = now.status.above_ground_m
    range_cm = None if above_m is None else min(max(round(above_m * 100.0), 0), 10000)
    return None if range_cm is None else (_boot_ms(now), 0, 10000, range_cm, 0, 0, _DOWN)


def _ekf_status_report(now: Report) -> Fields:
    estimate = now.estimate
    return estimate.flags, estimate.velocity_variance, estimate.horizontal_variance


def _estimator_status(now: Report) -> Fields:
    accuracy_m = now.estimate.horizontal_accuracy_m
    return now.time_us, *_ekf_status_report(now), *[0.0] * 4, accuracy_m


def _gps_global_origin(now: Report) -> Fields | None:
    origin = now.estimate.origin
    return origin and (*_e7_mm(origin), now.time_us)


def _home_position(now: Report) -> Fields | None:
    """Seen from the origin; ArduPilot knows no attitude of the surface."""
    home, origin, ned_m = now.autopilot.home, now.estimate.origin, _NO_VECTOR
    if home is None or (_is_px4(now) and origin is None):
        return None
    if origin is not None:
        per_deg, shrink = ARDUPILOT_M_PER_DEG, math.cos(math.radians(origin.latitude_deg))
        north_m = (home.latitude_deg - origin.latitude_deg) * per_deg
        east_m = degrees_east(origin.longitude_deg, home.longitude_deg) * per_deg * shrink
        north_m, east_m = (0.0, 0.0) if _is_px4(now) else (north_m, east_m)
        ned_m = (north_m, east_m, origin.altitude_amsl_m - home.altitude_amsl_m)
    q = [1.0, 0.0, 0.0, 0.0] if _is_px4(now) else [_NAN] * 4
    return *_e7_mm(home), *ned_m, q, 0.0, 0.0, 0.0, now.time_us


def _simstate(now: Report) -> Fields:
    """The truth: SITL says it too."""
    return *[0.0] * 9, *_e7(now.vehicle)


def _wind(now: Report) -> Fields:
    """The air as it is, as a direction that it comes from."""
    north, east = now.vehicle.wind_m_s.real, now.vehicle.wind_m_s.imag
    direction_deg = math.degrees(math.atan2(-east, -north)) if north or east else -180.0
    return direction_deg, math.hypot(north, east)


def _wind_cov(now: Report) -> Fields | None:
    """Of a plane, once in the air."""
    if not _is_plane(now) or now.status.landed_state == Landed.ON_GROUND:
        return None
    wind = (now.vehicle.wind_m_s.real, now.vehicle.wind_m_s.imag)
    return now.time_us, *wind, 0.0, 0.0, 0.0, now.estimate.altitude_amsl_m


# --- where it flies to ----------------------------------------------------------------------------


def _position_target_local_ned(now: Report) -> Fields | None:
    target = now.autopilot.target_echo()
    if target is None:
        return None
    vectors = [value for vector in target[:3] for value in vector or (0.0, 0.0, 0.0)]
    yaw = (target.yaw_rad, target.yaw_rate_rad_s)
    return _boot_ms(now), _LOCAL, target.type_mask, *vectors, *yaw


def _position_target_global_int(now: Report) -> Fields | None:
    """The navigator's place; PX4 with the controller's velocity, acceleration, yaw and its rate."""
    waypoint, target = now.status.waypoint, now.autopilot.target_echo()
    if waypoint is None:
        return None
    place, height_m = _e7(waypoint.place), waypoint.place.altitude_amsl_m
    if not _is_px4(now):
        return _boot_ms(now), _GLOBAL, _ONLY_POSITION, *place, height_m
    height_m = 0.0 if now.status.mode == _LAND and not _is_plane(now) else height_m
    aim: Fields = (_NAN,) * 8
    if target is not None:
        velocity, acceleration = target.velocity_ned_m_s, target.acceleration_ned_m_s2
        yaw = (target.yaw_rad, target.yaw_rate_rad_s)
        aim = (*(velocity or _NO_VECTOR), *(acceleration or _NO_VECTOR), *yaw)
    return _boot_ms(now), _GLOBAL_INT, 0, *place, height_m, *aim


def _nav_controller_output(now: Report) -> Fields | None:
    """A copter has a target everywhere."""
    vehicle, waypoint = now.vehicle, now.status.waypoint
    attitude_deg = (math.degrees(vehicle.roll_rad), math.degrees(vehicle.pitch_rad))
    if waypoint is None:
        return None if _is_plane(now) else attitude_deg
    bearing_deg = round(math.degrees(math.remainder(waypoint.bearing_rad, math.tau)))
    ways = (bearing_deg, bearing_deg, whole(waypoint.distance_m))
    errors = (waypoint.altitude_error_m, waypoint.airspeed_error_m_s * 100.0)
    return *attitude_deg, *ways, *errors, waypoint.cross_track_m


def _mission_current(now: Report) -> Fields:
    """Mode of PX4: 1 while the navigator lands, takes off or flies the mission, else 2."""
    status = now.status
    flies = status.waypoint is not None and status.mode in (_LAND, _TAKEOFF, _MISSION)
    mode = (1 if flies else 2) if _is_px4(now) else 0
    return status.mission_current, status.mission_total, status.mission_state, mode


def _fence_status(now: Report) -> Fields | None:
    return now.status.fence


# --- who says what --------------------------------------------------------------------------------


def _messages(*functions: Callable[[Report], Fields | None]) -> dict[int, Builder]:
    """By number what makes the messages that these functions are called after."""
    numbers = {kind.msgname: number for number, kind in mavlink.mavlink_map.items()}
    names = [each.__name__.strip("_").upper() for each in functions]
    pairs = zip(names, functions, strict=True)
    return {numbers[name]: (layout_of(name), fields) for name, fields in pairs}


_BOTH: Final = _messages(
    *(_heartbeat, _extended_sys_state, _system_time, _timesync, _autopilot_version, _sys_status),
    *(_battery_status, _attitude, _attitude_quaternion, _local_position_ned, _global_position_int),
    *(_gps_raw_int, _vfr_hud, _gps_global_origin, _home_position, _position_target_local_ned),
    *(_position_target_global_int, _mission_current),
)
MESSAGES: Final[dict[Firmware, dict[int, Builder]]] = {
    "ardupilot": _BOTH
    | _messages(_ekf_status_report, _simstate, _wind, _nav_controller_output, _fence_status),
    "px4": _BOTH
    | _messages(
        _current_mode, _odometry, _altitude, _distance_sensor, _estimator_status, _wind_cov
    ),
}
"""What can be said, by message number."""


def message_of(now: Report, number: int) -> Prepared | None:
    """The message of this number; None: there is nothing to say now, or no such message."""
    layout, fields = MESSAGES[now.firmware.family].get(number, (None, None))
    values = fields(now) if fields else None
    return None if layout is None or values is None else filled(layout, values)
