"""A PX4's report as MAVLink messages: what it says differently, and what only it says.

Fields that somebody reads are filled as in the recorded flights (px4.md 2).
"""

import math
from typing import Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Landed, Report
from vehicle_sim.autopilots.px4.autopilot import ARMABLE_US
from vehicle_sim.autopilots.px4.modes import CUSTOM_MODES, Mode, standard_mode
from vehicle_sim.wire import telemetry
from vehicle_sim.wire.frames import Prepared, make
from vehicle_sim.wire.telemetry import INT16, INT32, NAN, UINT16, boot_ms, bounded, is_plane

_UNKNOWN: Final = (NAN, NAN, NAN)
_SENSORS: Final = 0x0200_000F
"""SYS_STATUS: gyroscopes, accelerometers, compass, pressure, battery: always there and well."""
_GPS_BIT, _POSITION_BIT, _PREARM_BIT = 0x20, 0x4000, 0x10000000
_BY_MODE: Final = {
    number: mode for mode, number in CUSTOM_MODES.items() if mode is not Mode.DESCEND
}


# --- health and battery ---------------------------------------------------------------------------


def _sys_status(report: Report) -> Prepared:
    there = _SENSORS | (_GPS_BIT if report.status.fusing else 0)
    flies = report.estimate.position_ok and report.time_us >= ARMABLE_US
    position = _POSITION_BIT if flies else 0
    prearm = _PREARM_BIT if report.status.prearm_ok else 0
    wanted = there | _POSITION_BIT | _PREARM_BIT
    return make(
        "SYS_STATUS",
        *(wanted, wanted, there | position | prearm, 0),
        *(bounded(report.battery.voltage_v * 1e3, UINT16), -100),
        math.ceil(telemetry.per_cent_left(report)),
        onboard_control_sensors_health_extended=1,
    )


def _battery_status(report: Report) -> Prepared:
    return make(
        "BATTERY_STATUS",
        *(0, 1, 1, INT16),
        [bounded(report.battery.voltage_v * 1e3, UINT16 - 1), *[UINT16] * 9],
        *(-100, bounded(report.battery.consumed_mah, INT32), -1),
        math.floor(telemetry.per_cent_left(report)),
        charge_state=1,
    )


def _autopilot_version(report: Report) -> Prepared:
    profile, custom = report.profile, list(report.profile.custom_version)
    return make(
        "AUTOPILOT_VERSION",
        *(profile.capabilities, profile.software_version, profile.software_version),
        *(101854463, 1, custom, custom),
        uid=report.hardware_id,
    )


def _protocol_version(_: Report) -> Prepared:
    return make("PROTOCOL_VERSION", 200, 100, 200)


def _timesync(report: Report) -> Prepared:
    return make("TIMESYNC", 0, report.time_us * 1000)


def _extended_sys_state(report: Report) -> Prepared:
    return make("EXTENDED_SYS_STATE", 0, report.status.landed_state)


def _current_mode(report: Report) -> Prepared:
    status = report.status
    mode = _BY_MODE.get(status.mode)
    standard = 0 if status.failsafe or mode is None else standard_mode(mode)
    intended = status.mode if status.intended_mode is None else status.intended_mode
    return make("CURRENT_MODE", standard, status.mode, intended)


# --- position -------------------------------------------------------------------------------------


def _gps_raw_int(report: Report) -> Prepared | None:
    return telemetry.gps_raw(report) if report.fix.time_us else None


def _global_position_int(report: Report) -> Prepared | None:
    amsl_m = report.estimate.altitude_amsl_m
    return telemetry.global_position(report, amsl_m) if report.status.origin else None


def _vfr_hud(report: Report) -> Prepared:
    airspeed_m_s = report.vehicle.airspeed_m_s if is_plane(report) else NAN
    return telemetry.vfr_hud(report, airspeed_m_s, report.estimate.altitude_amsl_m)


def _estimator_status(report: Report) -> Prepared:
    estimate = report.estimate
    ratios = (estimate.velocity_variance, estimate.horizontal_variance)
    accuracy_m = estimate.horizontal_accuracy_m
    head = (report.time_us, estimate.flags, *ratios)
    return make("ESTIMATOR_STATUS", *head, pos_horiz_accuracy=accuracy_m)


def _home_position(report: Report) -> Prepared | None:
    """Seen from the origin."""
    home, origin = report.autopilot.home, report.status.origin
    if home is None or origin is None:
        return None
    down_m = origin.altitude_amsl_m - home.altitude_amsl_m
    return telemetry.home_position(report, (0.0, 0.0, down_m), [1.0, 0.0, 0.0, 0.0])


def _distance_sensor(report: Report) -> Prepared | None:
    above_m = report.status.above_ground_m
    if above_m is None:
        return None
    range_cm = min(max(round(above_m * 100.0), 0), 10000)
    return make("DISTANCE_SENSOR", boot_ms(report), 0, 10000, range_cm, orientation=25)


def _altitude(report: Report) -> Prepared:
    """Above the sea, the origin, home and the ground's own height; and above the ground."""
    status, amsl_m = report.status, report.estimate.altitude_amsl_m
    origin, home, above_m = status.origin, report.autopilot.home, status.above_ground_m
    local_m = NAN if origin is None else amsl_m - origin.altitude_amsl_m
    return make(
        "ALTITUDE",
        report.time_us,
        report.vehicle.altitude_amsl_m,
        NAN if origin is None else amsl_m,
        local_m,
        NAN if home is None else amsl_m - home.altitude_amsl_m,
        NAN if above_m is None else local_m - above_m,
        NAN if above_m is None else above_m,
    )


def _odometry(report: Report) -> Prepared | None:
    here_m = report.autopilot.local_ned_m()
    return here_m and make(
        "ODOMETRY",
        *(report.time_us, mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_NED, *here_m),
        list(telemetry.quaternion(report)),
        *(*telemetry.velocity_ned_m_s(report), *report.autopilot.rates_rad_s),
        *([NAN] * 21, [NAN] * 21),
        estimator_type=mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
    )


def _wind_cov(report: Report) -> Prepared | None:
    """Of a plane, once in the air."""
    vehicle, amsl_m = report.vehicle, report.estimate.altitude_amsl_m
    if not is_plane(report) or report.status.landed_state == Landed.ON_GROUND:
        return None
    wind = (vehicle.wind_north_m_s, vehicle.wind_east_m_s)
    return make("WIND_COV", report.time_us, *wind, wind_alt=amsl_m)


# --- where it flies to ----------------------------------------------------------------------------


def _mission_current(report: Report) -> Prepared:
    """Mode 1 while the navigator lands, takes off or flies the mission, else 2."""
    status = report.status
    flies = (Mode.LAND, Mode.TAKEOFF, Mode.MISSION)
    active = status.waypoint is not None and _BY_MODE[status.mode] in flies
    return telemetry.mission_current(report, 1 if active else 2)


def _position_target_global_int(report: Report) -> Prepared | None:
    """The navigator's place with the controller's velocity, acceleration, yaw and its rate."""
    waypoint, target = report.status.waypoint, report.autopilot.target_echo()
    if waypoint is None:
        return None
    lands = report.status.mode == CUSTOM_MODES[Mode.LAND] and not is_plane(report)
    aim: tuple[float, ...] = (*_UNKNOWN, *_UNKNOWN, NAN, NAN)
    if target is not None:
        velocity, acceleration = target.velocity_ned_m_s, target.acceleration_ned_m_s2
        yaw = (target.yaw_rad, target.yaw_rate_rad_s)
        aim = (*(velocity or _UNKNOWN), *(acceleration or _UNKNOWN), *yaw)
    return make(
        "POSITION_TARGET_GLOBAL_INT",
        *(boot_ms(report), mavlink.MAV_FRAME_GLOBAL_INT, 0, *telemetry.place_e7(waypoint.place)),
        *(0.0 if lands else waypoint.place.altitude_amsl_m, *aim),
    )


MESSAGES: Final = telemetry.by_number(
    *(_sys_status, _battery_status, _autopilot_version, _protocol_version, _timesync),
    *(_extended_sys_state, _current_mode, _gps_raw_int, _global_position_int, _vfr_hud),
    *(_estimator_status, _home_position, _distance_sensor, _altitude, _odometry, _wind_cov),
    *(_mission_current, _position_target_global_int),
)
"""What can be said, by message number; None while there is nothing to say."""
