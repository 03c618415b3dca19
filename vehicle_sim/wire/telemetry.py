"""An autopilot's report as MAVLink messages: one function a message, all conversions here.

What every personality says in the same way; telemetry_ardupilot.py and telemetry_px4.py add their
own and replace what they say differently.
"""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Report
from vehicle_sim.wire.frames import bounded, degrees_e7

INT16, INT32, UINT16 = 32767, 2_147_483_647, 65535
_IGNORE_POSITION, _IGNORE_VELOCITY, _IGNORE_ACCELERATION = 0x007, 0x038, 0x1C0
_IGNORE_YAW_RATE = 0x800

Builder = Callable[[Report], Any | None]


def boot_ms(report: Report) -> int:
    """time_boot_ms."""
    return report.time_us // 1000 & 0xFFFFFFFF


def heading_cdeg(report: Report) -> int:
    """Where the nose points, 0 to 35999."""
    return round(math.degrees(report.vehicle.heading_rad) * 100.0) % 36000


def heartbeat(report: Report) -> Any:
    """HEARTBEAT of the autopilot."""
    return mavlink.MAVLink_heartbeat_message(
        type=report.style.vehicle_type,
        autopilot=report.style.autopilot,
        base_mode=report.status.base_mode,
        custom_mode=report.status.mode,
        system_status=report.status.system_status,
        mavlink_version=3,
    )


def _system_time(report: Report) -> Any:
    return mavlink.MAVLink_system_time_message(
        time_unix_usec=report.unix_us, time_boot_ms=boot_ms(report)
    )


def attitude(report: Report) -> Any:
    """ATTITUDE, without rates of turning."""
    vehicle = report.vehicle
    return mavlink.MAVLink_attitude_message(
        time_boot_ms=boot_ms(report),
        roll=vehicle.roll_rad,
        pitch=vehicle.pitch_rad,
        yaw=math.remainder(vehicle.heading_rad, math.tau),
        rollspeed=0.0,
        pitchspeed=0.0,
        yawspeed=0.0,
    )


def quaternion(report: Report) -> tuple[float, float, float, float]:
    """Attitude, scalar first."""
    vehicle = report.vehicle
    cr, sr = math.cos(vehicle.roll_rad / 2.0), math.sin(vehicle.roll_rad / 2.0)
    cp, sp = math.cos(vehicle.pitch_rad / 2.0), math.sin(vehicle.pitch_rad / 2.0)
    yaw_rad = math.remainder(vehicle.heading_rad, math.tau)
    cy, sy = math.cos(yaw_rad / 2.0), math.sin(yaw_rad / 2.0)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def attitude_quaternion(report: Report) -> Any:
    """ATTITUDE_QUATERNION, likewise."""
    q1, q2, q3, q4 = quaternion(report)
    return mavlink.MAVLink_attitude_quaternion_message(
        time_boot_ms=boot_ms(report),
        q1=q1,
        q2=q2,
        q3=q3,
        q4=q4,
        rollspeed=0.0,
        pitchspeed=0.0,
        yawspeed=0.0,
    )


def _local_position(report: Report) -> Any | None:
    local_ned_m, estimate = report.status.local_ned_m, report.estimate
    if local_ned_m is None:
        return None
    x, y, z = local_ned_m
    return mavlink.MAVLink_local_position_ned_message(
        time_boot_ms=boot_ms(report),
        x=x,
        y=y,
        z=z,
        vx=estimate.velocity_north_m_s,
        vy=estimate.velocity_east_m_s,
        vz=-estimate.velocity_up_m_s,
    )


def global_position(report: Report) -> Any:
    """GLOBAL_POSITION_INT: the estimate."""
    estimate, home = report.estimate, report.status.home
    above_home_m = 0.0 if home is None else estimate.altitude_amsl_m - home.altitude_amsl_m
    return mavlink.MAVLink_global_position_int_message(
        time_boot_ms=boot_ms(report),
        lat=degrees_e7(estimate.latitude_deg),
        lon=degrees_e7(estimate.longitude_deg),
        alt=bounded(estimate.altitude_amsl_m * 1e3, INT32),
        relative_alt=bounded(above_home_m * 1e3, INT32),
        vx=bounded(estimate.velocity_north_m_s * 100.0, INT16),
        vy=bounded(estimate.velocity_east_m_s * 100.0, INT16),
        vz=bounded(-estimate.velocity_up_m_s * 100.0, INT16),
        hdg=heading_cdeg(report),
    )


def _gps_global_origin(report: Report) -> Any | None:
    origin = report.status.origin
    if origin is None:
        return None
    return mavlink.MAVLink_gps_global_origin_message(
        latitude=degrees_e7(origin.latitude_deg),
        longitude=degrees_e7(origin.longitude_deg),
        altitude=bounded(origin.altitude_amsl_m * 1e3, INT32),
        time_usec=report.time_us,
    )


def vfr_hud(report: Report) -> Any:
    """VFR_HUD."""
    estimate, vehicle = report.estimate, report.vehicle
    return mavlink.MAVLink_vfr_hud_message(
        airspeed=vehicle.airspeed_m_s,
        groundspeed=math.hypot(estimate.velocity_north_m_s, estimate.velocity_east_m_s),
        heading=heading_cdeg(report) // 100,
        throttle=round(min(max(vehicle.throttle, 0.0), 1.0) * 100.0),
        alt=estimate.altitude_amsl_m,
        climb=estimate.velocity_up_m_s,
    )


def _position_target(report: Report) -> Any | None:
    target = report.status.target
    if target is None:
        return None
    x, y, z = target.position_ned_m or (0.0, 0.0, 0.0)
    vx, vy, vz = target.velocity_ned_m_s or (0.0, 0.0, 0.0)
    ax, ay, az = target.acceleration_ned_m_s2 or (0.0, 0.0, 0.0)
    mask = target.type_mask
    if mask is None:
        mask = _IGNORE_YAW_RATE
        mask |= 0 if target.position_ned_m else _IGNORE_POSITION
        mask |= 0 if target.velocity_ned_m_s else _IGNORE_VELOCITY
        mask |= 0 if target.acceleration_ned_m_s2 else _IGNORE_ACCELERATION
    return mavlink.MAVLink_position_target_local_ned_message(
        time_boot_ms=boot_ms(report),
        coordinate_frame=mavlink.MAV_FRAME_LOCAL_NED,
        type_mask=mask,
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
        yaw_rate=target.yaw_rate_rad_s,
    )


def home_position(report: Report) -> Any | None:
    """HOME_POSITION; x, y, z are the origin's view of it."""
    home = report.status.home
    if home is None:
        return None
    return mavlink.MAVLink_home_position_message(
        latitude=degrees_e7(home.latitude_deg),
        longitude=degrees_e7(home.longitude_deg),
        altitude=bounded(home.altitude_amsl_m * 1e3, INT32),
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
        vtol_state=mavlink.MAV_VTOL_STATE_UNDEFINED, landed_state=report.status.landed_state
    )


MESSAGES: dict[int, Builder] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _gps_global_origin,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: _position_target,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
}
"""What both say in the same way, by message number; None while there is nothing to say."""
