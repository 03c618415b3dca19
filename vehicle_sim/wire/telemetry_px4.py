"""A PX4's report as MAVLink messages: what it says differently, and what only it says.

Fields are filled as in the recorded flights (px4.md 2), constants included: what SIH does not
simulate is as empty here as there.
"""

import math
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Report
from vehicle_sim.autopilots.px4.modes import CUSTOM_MODES, Mode, standard_mode
from vehicle_sim.wire import telemetry, telemetry_px4_sensors
from vehicle_sim.wire.frames import bounded, degrees_e7
from vehicle_sim.wire.px4_messages import (
    CurrentEventSequence,
    Events,
    LinkNodeStatus,
    ProtocolVersion,
    TimeEstimateToTarget,
)
from vehicle_sim.wire.telemetry import INT16, INT32, UINT16, Builder, boot_ms
from vehicle_sim.wire.telemetry_px4_sensors import is_plane, on_ground

__all__ = ["MESSAGES", "Events"]

_NAN: Final = math.nan
_PRESENT, _ENABLED, _HEALTH = 33570863, 33636399, 52480063
"""SYS_STATUS as recorded; the bits of the GPS (0x20) and of the position control (0x4000) apart."""
_AIRSPEED_BIT, _GPS_BIT, _POSITION_BIT, _PREARM_BIT = 0x10, 0x20, 0x4000, 0x10000000
_LOGGING_BIT: Final = 0x1000000
_BOOTING_HEALTH: Final = 52545599
_SENSORS_FROM_US: Final = 2_100_000
"""Boot to the first report of sensors that are present: 1.6 s + 0.64 s of the log."""
_RETURN_MARGIN_S, _RETURN_FACTOR = 100.0, 1.1
"""RTL_TIME_MARGIN and RTL_TIME_FACTOR."""
_BY_MODE: Final = {
    number: mode for mode, number in CUSTOM_MODES.items() if mode is not Mode.DESCEND
}


def _sys_status(report: Report) -> Any:
    battery, ready = report.battery, report.time_us >= _SENSORS_FROM_US
    present, enabled, health = _PRESENT, _ENABLED, _HEALTH
    if not report.status.fusing:
        present, enabled = present & ~_GPS_BIT, enabled & ~_GPS_BIT
    if not report.status.position_reported:
        health &= ~_POSITION_BIT
    if is_plane(report):
        present, enabled = present | _AIRSPEED_BIT, enabled | _AIRSPEED_BIT
    if report.status.logs_always:
        present, enabled = present | _LOGGING_BIT, enabled | _LOGGING_BIT
    if not ready:
        present, enabled, health = 0, 0, _BOOTING_HEALTH
    return mavlink.MAVLink_sys_status_message(
        onboard_control_sensors_present=present,
        onboard_control_sensors_enabled=enabled,
        onboard_control_sensors_health=health | (_PREARM_BIT if report.status.prearm_ok else 0),
        load=120 + report.time_us // 200_000 * 37 % 60,
        voltage_battery=bounded(battery.voltage_v * 1e3, UINT16),
        current_battery=-100,
        battery_remaining=math.ceil(_per_cent(battery.remaining)),
        drop_rate_comm=0,
        errors_comm=0,
        errors_count1=0,
        errors_count2=0,
        errors_count3=0,
        errors_count4=0,
        onboard_control_sensors_health_extended=1,
    )


def _per_cent(share: float) -> float:
    """Rounded up in SYS_STATUS and down in BATTERY_STATUS."""
    return min(max(share, 0.0), 1.0) * 100.0


def _ping(report: Report) -> Any:
    return mavlink.MAVLink_ping_message(
        time_usec=report.time_us,
        seq=report.time_us // 1_000_000,
        target_system=0,
        target_component=0,
    )


def _link_node_status(report: Report) -> Any:
    return LinkNodeStatus(report.time_us)


def _gps_raw(report: Report) -> Any:
    fix = report.fix
    if fix.time_us == 0:
        return None
    north, east = fix.velocity_north_m_s, fix.velocity_east_m_s
    altitude_mm = bounded(fix.altitude_amsl_m * 1e3, INT32)
    return mavlink.MAVLink_gps_raw_int_message(
        time_usec=fix.time_us,
        fix_type=fix.fix_type,
        lat=degrees_e7(fix.latitude_deg),
        lon=degrees_e7(fix.longitude_deg),
        alt=altitude_mm,
        eph=min(round(fix.horizontal_dilution * 100.0), UINT16),
        epv=min(round(fix.vertical_dilution * 100.0), UINT16),
        vel=bounded(math.hypot(north, east) * 100.0, UINT16 - 1),
        cog=round(math.degrees(math.atan2(east, north)) * 100.0) % 36000,
        satellites_visible=min(fix.satellites, 255),
        alt_ellipsoid=altitude_mm,
        h_acc=bounded(fix.horizontal_accuracy_m * 1e3, INT32),
        v_acc=bounded(fix.vertical_accuracy_m * 1e3, INT32),
        vel_acc=bounded(fix.speed_accuracy_m_s * 1e3, INT32),
        hdg_acc=0,
        yaw=0,
    )


def _global_position(report: Report) -> Any | None:
    if report.status.origin is None:
        return None
    return telemetry.global_position(report)


def _mission_current(report: Report) -> Any:
    """mission_mode: 1 while the navigator lands, takes off or flies the mission, else 2."""
    status = report.status
    navigated = status.waypoint is not None
    active = navigated and _BY_MODE[status.mode] in (Mode.LAND, Mode.TAKEOFF, Mode.MISSION)
    return mavlink.MAVLink_mission_current_message(
        seq=status.mission_current,
        total=status.mission_total,
        mission_state=status.mission_state,
        mission_mode=1 if active else 2,
    )


def _vfr_hud(report: Report) -> Any:
    message = telemetry.vfr_hud(report)
    if not is_plane(report) and message is not None:
        message.airspeed = _NAN
    return message


def _position_target_global(report: Report) -> Any | None:
    """POSITION_TARGET_GLOBAL_INT: the navigator's place with the controller's vectors."""
    waypoint, target = report.status.waypoint, report.status.target
    if waypoint is None:
        return None
    nothing = (_NAN, _NAN, _NAN)
    vx, vy, vz = (target.velocity_ned_m_s if target else None) or nothing
    ax, ay, az = (target.acceleration_ned_m_s2 if target else None) or nothing
    lands = report.status.mode == CUSTOM_MODES[Mode.LAND]
    return mavlink.MAVLink_position_target_global_int_message(
        time_boot_ms=boot_ms(report),
        coordinate_frame=mavlink.MAV_FRAME_GLOBAL_INT,
        type_mask=0,
        lat_int=degrees_e7(waypoint.place.latitude_deg),
        lon_int=degrees_e7(waypoint.place.longitude_deg),
        alt=0.0 if lands and not is_plane(report) else waypoint.place.altitude_amsl_m,
        vx=vx,
        vy=vy,
        vz=vz,
        afx=ax,
        afy=ay,
        afz=az,
        yaw=target.yaw_rad if target else _NAN,
        yaw_rate=target.yaw_rate_rad_s if target else _NAN,
    )


def _time_sync(report: Report) -> Any:
    return mavlink.MAVLink_timesync_message(tc1=0, ts1=report.time_us * 1000)


def _battery_status(report: Report) -> Any:
    battery = report.battery
    return mavlink.MAVLink_battery_status_message(
        id=0,
        battery_function=1,
        type=1,
        temperature=INT16,
        voltages=[bounded(battery.voltage_v * 1e3, UINT16 - 1), *[UINT16] * 9],
        current_battery=-100,
        current_consumed=bounded(battery.consumed_mah, INT32),
        energy_consumed=-1,
        battery_remaining=math.floor(_per_cent(battery.remaining)),
        time_remaining=0,
        charge_state=1,
    )


def _estimator_status(report: Report) -> Any:
    estimate = report.estimate
    return mavlink.MAVLink_estimator_status_message(
        time_usec=report.time_us,
        flags=estimate.flags,
        vel_ratio=estimate.velocity_variance,
        pos_horiz_ratio=estimate.horizontal_variance,
        pos_vert_ratio=estimate.vertical_variance,
        mag_ratio=estimate.compass_variance,
        hagl_ratio=estimate.terrain_variance,
        tas_ratio=0.03 if is_plane(report) and not on_ground(report) else _NAN,
        pos_horiz_accuracy=estimate.horizontal_accuracy_m,
        pos_vert_accuracy=estimate.vertical_accuracy_m,
    )


def _home_position(report: Report) -> Any | None:
    home, origin = report.status.home, report.status.origin
    if home is None or origin is None:
        return None
    message = telemetry.home_position(report)
    if message is not None:
        message.z = origin.altitude_amsl_m - home.altitude_amsl_m
    return message


def _orbit_status(report: Report) -> Any | None:
    """While a fixed wing circles."""
    waypoint = report.status.waypoint
    if waypoint is None or waypoint.radius_m == 0.0:
        return None
    return mavlink.MAVLink_orbit_execution_status_message(
        time_usec=report.time_us,
        radius=waypoint.radius_m,
        frame=mavlink.MAV_FRAME_GLOBAL,
        x=degrees_e7(waypoint.place.latitude_deg),
        y=degrees_e7(waypoint.place.longitude_deg),
        z=waypoint.place.altitude_amsl_m,
    )


def _time_to_target(report: Report) -> Any:
    """RTL_TIME_MARGIN and a rough way home; 0 on the ground."""
    home, local_ned_m = report.status.home, report.status.local_ned_m
    if on_ground(report) or home is None or local_ned_m is None:
        return TimeEstimateToTarget(0)
    way_s = math.hypot(local_ned_m[0], local_ned_m[1]) / 5.0
    way_s += max(report.estimate.altitude_amsl_m - home.altitude_amsl_m, 0.0) / 1.5
    return TimeEstimateToTarget(round(_RETURN_MARGIN_S + _RETURN_FACTOR * way_s))


def _event_sequence(report: Report) -> Any:
    """Flags 1: the sequence has begun anew."""
    return CurrentEventSequence(report.event_sequence, 1 if report.time_us < 3_000_000 else 0)


def _current_mode(report: Report) -> Any:
    status = report.status
    mode = _BY_MODE.get(status.mode)
    failsafe = status.failsafe or mode is None
    intended = status.mode if status.intended_mode is None else status.intended_mode
    return mavlink.MAVLink_current_mode_message(
        standard_mode=0 if failsafe or mode is None else standard_mode(mode),
        custom_mode=status.mode,
        intended_custom_mode=intended,
    )


def _autopilot_version(report: Report) -> Any:
    style = report.style
    return mavlink.MAVLink_autopilot_version_message(
        capabilities=style.capabilities,
        flight_sw_version=style.software_version,
        middleware_sw_version=style.software_version,
        os_sw_version=101854463,
        board_version=1,
        flight_custom_version=list(style.custom_version),
        middleware_custom_version=list(style.custom_version),
        os_custom_version=[0] * 8,
        vendor_id=0,
        product_id=0,
        uid=report.hardware_id,
    )


def _protocol_version(_: Report) -> Any:
    return ProtocolVersion()


MESSAGES: dict[int, Builder] = {
    **telemetry.MESSAGES,
    **telemetry_px4_sensors.MESSAGES,
    1: _sys_status,
    4: _ping,
    8: _link_node_status,
    24: _gps_raw,
    33: _global_position,
    42: _mission_current,
    74: _vfr_hud,
    87: _position_target_global,
    111: _time_sync,
    147: _battery_status,
    148: _autopilot_version,
    230: _estimator_status,
    242: _home_position,
    300: _protocol_version,
    360: _orbit_status,
    380: _time_to_target,
    411: _event_sequence,
    436: _current_mode,
}
"""What can be said, by message number; None while there is nothing to say."""
