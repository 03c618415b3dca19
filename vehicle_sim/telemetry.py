"""An autopilot's report as MAVLink messages: one function a message, all conversions here."""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Report
from vehicle_sim.wire import bounded, degrees_e7

_INT16, _INT32 = 32767, 2_147_483_647
_IGNORE_POSITION, _IGNORE_YAW_RATE = 0x007, 0x800
_PREARM_CHECK = mavlink.MAV_SYS_STATUS_PREARM_CHECK
_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
)
_CAPABILITIES, _VERSION = 64495, 0x04070000
"""Of the ArduCopter that was measured."""


def _boot_ms(report: Report) -> int:
    return report.time_us // 1000 & 0xFFFFFFFF


def _heading_cdeg(report: Report) -> int:
    return round(math.degrees(report.heading_rad) * 100.0) % 36000


def heartbeat(report: Report) -> Any:
    """HEARTBEAT of the autopilot."""
    return mavlink.MAVLink_heartbeat_message(
        type=mavlink.MAV_TYPE_QUADROTOR,
        autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        base_mode=report.base_mode,
        custom_mode=report.mode,
        system_status=report.system_status,
        mavlink_version=3,
    )


def _sys_status(report: Report) -> Any:
    sensors = _SENSORS | mavlink.MAV_SYS_STATUS_SENSOR_GPS | _PREARM_CHECK
    health = _SENSORS
    health |= mavlink.MAV_SYS_STATUS_SENSOR_GPS if report.gps_fix else 0
    health |= _PREARM_CHECK if report.health_ok else 0
    return mavlink.MAVLink_sys_status_message(
        onboard_control_sensors_present=sensors,
        onboard_control_sensors_enabled=sensors,
        onboard_control_sensors_health=health,
        load=0,
        voltage_battery=0xFFFF,  # there is no battery: not known, here and in the next two
        current_battery=-1,
        battery_remaining=-1,
        drop_rate_comm=0,
        errors_comm=0,
        errors_count1=0,
        errors_count2=0,
        errors_count3=0,
        errors_count4=0,
    )


def _system_time(report: Report) -> Any:
    return mavlink.MAVLink_system_time_message(time_unix_usec=0, time_boot_ms=_boot_ms(report))


def _gps_raw(report: Report) -> Any:
    north, east, _ = report.velocity_ned_m_s
    fix, place = report.gps_fix, report.place
    return mavlink.MAVLink_gps_raw_int_message(
        time_usec=report.time_us,
        fix_type=mavlink.GPS_FIX_TYPE_RTK_FIXED if fix else mavlink.GPS_FIX_TYPE_NO_FIX,
        lat=degrees_e7(place.latitude_deg) if fix else 0,
        lon=degrees_e7(place.longitude_deg) if fix else 0,
        alt=bounded(place.altitude_amsl_m * 1e3, _INT32) if fix else 0,
        eph=121 if fix else 0xFFFF,
        epv=200 if fix else 0xFFFF,
        vel=bounded(math.hypot(north, east) * 100.0, 0xFFFE) if fix else 0xFFFF,
        cog=round(math.degrees(math.atan2(east, north)) * 100.0) % 36000 if fix else 0xFFFF,
        satellites_visible=10 if fix else 0,
    )


def _attitude(report: Report) -> Any:
    return mavlink.MAVLink_attitude_message(
        time_boot_ms=_boot_ms(report),
        roll=report.roll_rad,
        pitch=report.pitch_rad,
        yaw=math.remainder(report.heading_rad, math.tau),
        rollspeed=0.0,
        pitchspeed=0.0,
        yawspeed=0.0,
    )


def _local_position(report: Report) -> Any | None:
    if report.local_ned_m is None:
        return None
    x, y, z = report.local_ned_m
    vx, vy, vz = report.velocity_ned_m_s
    return mavlink.MAVLink_local_position_ned_message(
        time_boot_ms=_boot_ms(report), x=x, y=y, z=z, vx=vx, vy=vy, vz=vz
    )


def _global_position(report: Report) -> Any:
    north, east, down = report.velocity_ned_m_s
    place, home, fix = report.place, report.home, report.gps_fix
    above_home_m = 0.0 if home is None else place.altitude_amsl_m - home.altitude_amsl_m
    return mavlink.MAVLink_global_position_int_message(
        time_boot_ms=_boot_ms(report),
        lat=degrees_e7(place.latitude_deg) if fix else 0,
        lon=degrees_e7(place.longitude_deg) if fix else 0,
        alt=bounded(place.altitude_amsl_m * 1e3, _INT32) if fix else 0,
        relative_alt=bounded(above_home_m * 1e3, _INT32),
        vx=bounded(north * 100.0, _INT16),
        vy=bounded(east * 100.0, _INT16),
        vz=bounded(down * 100.0, _INT16),
        hdg=_heading_cdeg(report),
    )


def _gps_global_origin(report: Report) -> Any | None:
    origin = report.origin
    if origin is None:
        return None
    return mavlink.MAVLink_gps_global_origin_message(
        latitude=degrees_e7(origin.latitude_deg),
        longitude=degrees_e7(origin.longitude_deg),
        altitude=bounded(origin.altitude_amsl_m * 1e3, _INT32),
        time_usec=report.time_us,
    )


def _vfr_hud(report: Report) -> Any:
    north, east, down = report.velocity_ned_m_s
    speed = math.hypot(north, east)
    return mavlink.MAVLink_vfr_hud_message(
        airspeed=speed,
        groundspeed=speed,
        heading=_heading_cdeg(report) // 100,
        throttle=0,
        alt=report.place.altitude_amsl_m,
        climb=-down,
    )


def _position_target(report: Report) -> Any | None:
    target = report.target
    if target is None:
        return None
    x, y, z = target.position_ned_m or (0.0, 0.0, 0.0)
    vx, vy, vz = target.velocity_ned_m_s
    ax, ay, az = target.acceleration_ned_m_s2
    return mavlink.MAVLink_position_target_local_ned_message(
        time_boot_ms=_boot_ms(report),
        coordinate_frame=mavlink.MAV_FRAME_LOCAL_NED,
        type_mask=_IGNORE_YAW_RATE | (0 if target.position_ned_m else _IGNORE_POSITION),
        x=x,
        y=y,
        z=z,
        vx=vx,
        vy=vy,
        vz=vz,
        afx=ax,
        afy=ay,
        afz=az,
        yaw=target.yaw_rad,
        yaw_rate=0.0,
    )


def _ekf_status(report: Report) -> Any:
    return mavlink.MAVLink_ekf_status_report_message(
        flags=report.ekf_flags,
        velocity_variance=0.0,
        pos_horiz_variance=0.0,
        pos_vert_variance=0.0,
        compass_variance=0.0,
        terrain_alt_variance=0.0,
    )


def _home_position(report: Report) -> Any | None:
    home = report.home
    if home is None:
        return None
    return mavlink.MAVLink_home_position_message(
        latitude=degrees_e7(home.latitude_deg),
        longitude=degrees_e7(home.longitude_deg),
        altitude=bounded(home.altitude_amsl_m * 1e3, _INT32),
        x=0.0,
        y=0.0,
        z=0.0,
        q=[1.0, 0.0, 0.0, 0.0],
        approach_x=0.0,
        approach_y=0.0,
        approach_z=0.0,
        time_usec=report.time_us,
    )


def _extended_sys_state(report: Report) -> Any:
    return mavlink.MAVLink_extended_sys_state_message(
        vtol_state=mavlink.MAV_VTOL_STATE_UNDEFINED, landed_state=report.landed_state
    )


def _autopilot_version(report: Report) -> Any:
    nothing = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        capabilities=_CAPABILITIES,
        flight_sw_version=_VERSION,
        middleware_sw_version=0,
        os_sw_version=0,
        board_version=0,
        flight_custom_version=nothing,
        middleware_custom_version=nothing,
        os_custom_version=nothing,
        vendor_id=0,
        product_id=0,
        uid=report.hardware_id,
    )


MESSAGES: dict[int, Callable[[Report], Any | None]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: _gps_raw,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _gps_global_origin,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: _vfr_hud,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: _position_target,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _autopilot_version,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: _ekf_status,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: _home_position,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
}
"""What can be said, by message number; None while there is nothing to say."""
