"""What ArduPilot says besides, and what it says differently: from the recorded flights.

Sensors and the board are in telemetry_ardupilot_sensors.py.
"""

import math
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Report
from vehicle_sim.wire import telemetry
from vehicle_sim.wire.frames import bounded, degrees_e7
from vehicle_sim.wire.telemetry import INT16, INT32, Builder, boot_ms, heading_cdeg
from vehicle_sim.wire.telemetry_ardupilot_sensors import SENSOR_MESSAGES, indicated_m_s

_PLANE = 1
_GPS, _ALTITUDE, _POSITION, _AHRS = 0x20, 0x2000, 0x4000, 0x20_0000
_LOGGING, _PREARM_CHECK = 0x100_0000, 0x1000_0000
_COPTER_PRESENT, _COPTER_ENABLED, _COPTER_HEALTH = 0x5371_FC0F, 0x5241_9C0F, 0x4751_9C0F
_PLANE_PRESENT, _PLANE_ENABLED, _PLANE_HEALTH = 325188639, 306282527, 51478543
_PLANE_ARMED_HEALTH = 322042911
_AHRS_US = 22_300_000
_AIRSPEED, _AIRSPEED_US = 0x10, 3_400_000
"""Of a plane: the differential pressure sensor is calibrated."""
_HOLDS_ALTITUDE = frozenset({2, 3, 4, 5, 6, 7, 9, 16, 17, 21})
_RETURNS = (6, 21)
"""ArduCopter's modes, by number; those that return control nothing while disarmed."""
_TARGET_MASK_GLOBAL = 0xFDF8
_WIND_ERROR_M_S = 0.77
"""A plane's estimator sees wind where there is none: the recorded one this much, from the south."""
_NAN = float("nan")
_NO_CELL = 65535


def _masks(report: Report) -> tuple[int, int, int]:
    """What is there, wanted and well."""
    status = report.status
    gps = _GPS if report.fix.fix_type > 0 else 0
    if report.style.vehicle_type == _PLANE:
        return _plane_masks(report, gps)
    armed = bool(status.base_mode & 0x80)
    holds = status.mode in _HOLDS_ALTITUDE and (armed or status.mode not in _RETURNS)
    control = _ALTITUDE if holds else 0
    if control and status.base_mode & 0x08:
        control |= _POSITION
    ahrs = _AHRS if report.time_us >= _AHRS_US else 0
    enabled = _COPTER_ENABLED | gps | control | ahrs | (_LOGGING if status.logging else 0)
    health = _COPTER_HEALTH | gps | control | ahrs | (_PREARM_CHECK if status.prearm_ok else 0)
    return _COPTER_PRESENT | gps, enabled, health


def _plane_masks(report: Report, gps: int) -> tuple[int, int, int]:
    status = report.status
    present = _PLANE_PRESENT | gps
    ahrs = _AHRS if report.time_us >= _AHRS_US - 200_000 else 0
    calibrated = _AIRSPEED if report.time_us >= _AIRSPEED_US else 0
    enabled = _PLANE_ENABLED | gps | ahrs
    health = _PLANE_HEALTH | gps | ahrs | calibrated | (_PREARM_CHECK if status.prearm_ok else 0)
    if status.logging:
        enabled = present
        health = _PLANE_ARMED_HEALTH | gps
    return present, enabled, health


def _sys_status(report: Report) -> Any:
    present, enabled, health = _masks(report)
    battery = report.battery
    return mavlink.MAVLink_sys_status_message(
        onboard_control_sensors_present=present,
        onboard_control_sensors_enabled=enabled,
        onboard_control_sensors_health=health,
        load=0,
        voltage_battery=bounded(battery.voltage_v * 1000.0, INT16),
        current_battery=bounded(battery.current_a * 100.0, INT16),
        battery_remaining=_percent(report),
        drop_rate_comm=0,
        errors_comm=0,
        errors_count1=0,
        errors_count2=0,
        errors_count3=0,
        errors_count4=0,
    )


def _percent(report: Report) -> int:
    return math.floor(min(max(report.battery.remaining, 0.0), 1.0) * 100.0 + 1e-9)


def _battery_status(report: Report) -> Any:
    battery = report.battery
    used_mah = battery.consumed_mah
    return mavlink.MAVLink_battery_status_message(
        id=0,
        battery_function=0,
        type=0,
        temperature=INT16,
        voltages=[bounded(battery.voltage_v * 1000.0, INT16), *[_NO_CELL] * 9],
        current_battery=bounded(battery.current_a * 100.0, INT16),
        current_consumed=bounded(used_mah, INT32),
        energy_consumed=bounded(used_mah * 0.0036 * battery.voltage_v * 10.0, INT32),
        battery_remaining=_percent(report),
        time_remaining=0,
        charge_state=1,
    )


def _gps_raw(report: Report) -> Any:
    fix = report.fix
    known = fix.fix_type >= 1
    course_deg = math.degrees(math.atan2(fix.velocity_east_m_s, fix.velocity_north_m_s))
    speed_cm_s = math.hypot(fix.velocity_north_m_s, fix.velocity_east_m_s) * 100.0
    altitude_mm = bounded(fix.altitude_amsl_m * 1e3, INT32)
    return mavlink.MAVLink_gps_raw_int_message(
        time_usec=fix.time_us,
        fix_type=fix.fix_type,
        lat=degrees_e7(fix.latitude_deg) if known else 0,
        lon=degrees_e7(fix.longitude_deg) if known else 0,
        alt=altitude_mm if known else 0,
        eph=min(round(fix.horizontal_dilution * 100.0), 65535) if known else 65535,
        epv=min(round(fix.vertical_dilution * 100.0), 65535) if known else 65535,
        vel=bounded(speed_cm_s, 65534) if known else 0,
        cog=round(course_deg * 100.0) % 36000 if known else 0,
        satellites_visible=fix.satellites,
        alt_ellipsoid=altitude_mm if known else 0,
        h_acc=bounded(fix.horizontal_accuracy_m * 1e3, INT32),
        v_acc=bounded(fix.vertical_accuracy_m * 1e3, INT32),
        vel_acc=bounded(fix.speed_accuracy_m_s * 1e3, INT32),
        hdg_acc=0,
        yaw=0,
    )


def _vfr_hud(report: Report) -> Any:
    estimate, vehicle = report.estimate, report.vehicle
    ground_m_s = math.hypot(estimate.velocity_north_m_s, estimate.velocity_east_m_s)
    known = report.fix.fix_type > 0 or report.time_us > 10_000_000
    return mavlink.MAVLink_vfr_hud_message(
        airspeed=indicated_m_s(report),
        groundspeed=ground_m_s,
        heading=heading_cdeg(report) // 100,
        throttle=round(min(max(vehicle.throttle, 0.0), 1.0) * 100.0),
        alt=round(_altitude_amsl_m(report), 2) if known else 0.0,
        climb=estimate.velocity_up_m_s,
    )


def _attitude(report: Report) -> Any:
    vehicle, estimate = report.vehicle, report.estimate
    return mavlink.MAVLink_attitude_message(
        time_boot_ms=boot_ms(report),
        roll=vehicle.roll_rad,
        pitch=vehicle.pitch_rad,
        yaw=math.remainder(vehicle.heading_rad, math.tau),
        rollspeed=estimate.roll_rate_rad_s,
        pitchspeed=estimate.pitch_rate_rad_s,
        yawspeed=estimate.yaw_rate_rad_s,
    )


def _attitude_quaternion(report: Report) -> Any:
    q1, q2, q3, q4 = telemetry.quaternion(report)
    estimate = report.estimate
    return mavlink.MAVLink_attitude_quaternion_message(
        time_boot_ms=boot_ms(report),
        q1=q1,
        q2=q2,
        q3=q3,
        q4=q4,
        rollspeed=estimate.roll_rate_rad_s,
        pitchspeed=estimate.pitch_rate_rad_s,
        yawspeed=estimate.yaw_rate_rad_s,
    )


def _altitude_amsl_m(report: Report) -> float:
    """It stands still with the position; the height above home does not."""
    frozen_m = report.estimate.frozen_altitude_amsl_m
    return report.estimate.altitude_amsl_m if frozen_m is None else frozen_m


def _global_position(report: Report) -> Any:
    estimate, home = report.estimate, report.status.home
    above_home_m = 0.0 if home is None else estimate.altitude_amsl_m - home.altitude_amsl_m
    return mavlink.MAVLink_global_position_int_message(
        time_boot_ms=boot_ms(report),
        lat=degrees_e7(estimate.latitude_deg),
        lon=degrees_e7(estimate.longitude_deg),
        alt=bounded(_altitude_amsl_m(report) * 1e3, INT32),
        relative_alt=bounded(above_home_m * 1e3, INT32),
        vx=bounded(estimate.velocity_north_m_s * 100.0, INT16),
        vy=bounded(estimate.velocity_east_m_s * 100.0, INT16),
        vz=bounded(-estimate.velocity_up_m_s * 100.0, INT16),
        hdg=heading_cdeg(report),
    )


def _time_sync(report: Report) -> Any:
    """ArduPilot asks every ten seconds; the last digit tells its questions from others."""
    return mavlink.MAVLink_timesync_message(tc1=0, ts1=report.time_us * 1000 + 1)


def _ekf_status(report: Report) -> Any:
    estimate = report.estimate
    plane = report.style.vehicle_type == _PLANE and report.status.logging
    return mavlink.MAVLink_ekf_status_report_message(
        flags=estimate.flags,
        velocity_variance=estimate.velocity_variance,
        pos_horiz_variance=estimate.horizontal_variance,
        pos_vert_variance=estimate.vertical_variance,
        compass_variance=estimate.compass_variance,
        terrain_alt_variance=0.0,
        airspeed_variance=2.0 * estimate.compass_variance if plane else 0.0,
    )


def _home_position(report: Report) -> Any | None:
    """No attitude of the surface is known; x, y, z in the estimator's frame."""
    home, origin = report.status.home, report.status.origin
    if home is None:
        return None
    x, y, z = _NAN, _NAN, _NAN
    if origin is not None:
        north_deg = home.latitude_deg - origin.latitude_deg
        east_deg = home.longitude_deg - origin.longitude_deg
        x = north_deg * 111318.84502145034
        y = east_deg * 111318.84502145034 * math.cos(math.radians(origin.latitude_deg))
        z = origin.altitude_amsl_m - home.altitude_amsl_m
    return mavlink.MAVLink_home_position_message(
        latitude=degrees_e7(home.latitude_deg),
        longitude=degrees_e7(home.longitude_deg),
        altitude=bounded(home.altitude_amsl_m * 1e3, INT32),
        x=x,
        y=y,
        z=z,
        q=[_NAN] * 4,
        approach_x=0.0,
        approach_y=0.0,
        approach_z=0.0,
        time_usec=report.time_us,
    )


def _extended_sys_state(report: Report) -> Any:
    plane = report.style.vehicle_type == _PLANE
    return mavlink.MAVLink_extended_sys_state_message(
        vtol_state=0 if plane else mavlink.MAV_VTOL_STATE_MC,
        landed_state=report.status.landed_state,
    )


def _autopilot_version(report: Report) -> Any:
    style, nothing = report.style, [0] * 8
    unique = report.hardware_id.to_bytes(8, "little", signed=False)
    return mavlink.MAVLink_autopilot_version_message(
        capabilities=style.capabilities,
        flight_sw_version=style.software_version,
        middleware_sw_version=0,
        os_sw_version=0,
        board_version=0,
        flight_custom_version=list(style.custom_version),
        middleware_custom_version=nothing,
        os_custom_version=nothing,
        vendor_id=0,
        product_id=0,
        uid=0,
        uid2=[*unique, *[0] * 10],
    )


# --- where it flies to ----------------------------------------------------------------------------


def _position_target_global(report: Report) -> Any | None:
    waypoint = report.status.waypoint
    if waypoint is None:
        return None
    return mavlink.MAVLink_position_target_global_int_message(
        time_boot_ms=boot_ms(report),
        coordinate_frame=mavlink.MAV_FRAME_GLOBAL,
        type_mask=_TARGET_MASK_GLOBAL,
        lat_int=degrees_e7(waypoint.place.latitude_deg),
        lon_int=degrees_e7(waypoint.place.longitude_deg),
        alt=waypoint.place.altitude_amsl_m,
        vx=0.0,
        vy=0.0,
        vz=0.0,
        afx=0.0,
        afy=0.0,
        afz=0.0,
        yaw=0.0,
        yaw_rate=0.0,
    )


def _nav_controller(report: Report) -> Any | None:
    waypoint, vehicle = report.status.waypoint, report.vehicle
    bearing_deg, distance_m, up_m, cross_m = 0.0, 0.0, 0.0, 0.0
    slow_m_s = 0.0
    if waypoint is not None:
        slow_m_s = waypoint.airspeed_error_m_s
        bearing_deg = math.degrees(math.remainder(waypoint.bearing_rad, math.tau))
        distance_m, up_m = waypoint.distance_m, waypoint.altitude_error_m
        cross_m = waypoint.cross_track_m
    elif report.style.vehicle_type == _PLANE:
        return None
    return mavlink.MAVLink_nav_controller_output_message(
        nav_roll=math.degrees(vehicle.roll_rad),
        nav_pitch=math.degrees(vehicle.pitch_rad),
        nav_bearing=round(bearing_deg),
        target_bearing=round(bearing_deg),
        wp_dist=bounded(distance_m, 65535),
        alt_error=up_m,
        aspd_error=slow_m_s * 100.0,
        xtrack_error=cross_m,
    )


def _mission_current(report: Report) -> Any:
    status = report.status
    return mavlink.MAVLink_mission_current_message(
        seq=status.mission_current,
        total=status.mission_total,
        mission_state=status.mission_state,
        mission_mode=0,
    )


def _fence_status(report: Report) -> Any | None:
    status = report.status
    if not status.fence_present:
        return None
    return mavlink.MAVLink_fence_status_message(
        breach_status=int(status.fence_breached),
        breach_count=status.fence_breaches,
        breach_type=status.fence_breach_type,
        breach_time=status.fence_breach_ms,
        breach_mitigation=0,
    )


def _wind(report: Report) -> Any:
    """The air as the estimator has it: what it does, as a direction that it comes from."""
    vehicle = report.vehicle
    north, east = vehicle.wind_north_m_s, vehicle.wind_east_m_s
    if report.style.vehicle_type == _PLANE and report.status.logging:
        north += _WIND_ERROR_M_S + report.estimate.velocity_variance
        east -= report.estimate.compass_variance
    return mavlink.MAVLink_wind_message(
        direction=math.degrees(math.atan2(-east, -north)) if north or east else -180.0,
        speed=math.hypot(north, east),
        speed_z=-vehicle.wind_up_m_s,
    )


def _terrain_report(report: Report) -> Any:
    """It has no terrain data and waits for some."""
    estimate, known = report.estimate, report.status.origin is not None
    return mavlink.MAVLink_terrain_report_message(
        lat=degrees_e7(estimate.latitude_deg) if known else 0,
        lon=degrees_e7(estimate.longitude_deg) if known else 0,
        spacing=0 if known else 100,
        terrain_height=0.0,
        current_height=0.0,
        pending=56,
        loaded=0,
    )


def _terrain_request(report: Report) -> Any:
    """It asks for the grid about home, which it remembers, until somebody answers."""
    home = report.status.home or report.vehicle
    return mavlink.MAVLink_terrain_request_message(
        lat=degrees_e7(home.latitude_deg - 0.0115),
        lon=degrees_e7(home.longitude_deg - 0.0104),
        grid_spacing=100,
        mask=(1 << 56) - 1,
    )


MESSAGES: dict[int, Builder] = {
    **telemetry.MESSAGES,
    **SENSOR_MESSAGES,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_TIMESYNC: _time_sync,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: _battery_status,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: _gps_raw,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: _vfr_hud,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: _ekf_status,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: _home_position,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _autopilot_version,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: _position_target_global,
    mavlink.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: _nav_controller,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: _mission_current,
    mavlink.MAVLINK_MSG_ID_FENCE_STATUS: _fence_status,
    mavlink.MAVLINK_MSG_ID_WIND: _wind,
    mavlink.MAVLINK_MSG_ID_TERRAIN_REPORT: _terrain_report,
    mavlink.MAVLINK_MSG_ID_TERRAIN_REQUEST: _terrain_request,
}
"""What can be said, by message number; None while there is nothing to say."""
