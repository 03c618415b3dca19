"""What a PX4's report says of attitude and sensors, as MAVLink messages: see telemetry_px4.py."""

import math
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Landed, Report
from vehicle_sim.wire import telemetry
from vehicle_sim.wire.frames import bounded, degrees_e7
from vehicle_sim.wire.telemetry import INT16, UINT16, Builder, boot_ms, quaternion

_NAN: Final = math.nan
_FIXED_WING: Final = 1
_DRONE_ID_TIME: Final = 2748666496
"""As recorded: PX4 fills it with something that is no time."""
_G: Final = 9.80665


def is_plane(report: Report) -> bool:
    """A fixed wing."""
    return report.style.vehicle_type == _FIXED_WING


def on_ground(report: Report) -> bool:
    """As EXTENDED_SYS_STATE says it."""
    return report.status.landed_state == Landed.ON_GROUND


def _pressure_hpa(altitude_amsl_m: float) -> float:
    """International standard atmosphere."""
    return 1013.25 * max(1.0 - 2.25577e-5 * altitude_amsl_m, 0.01) ** 5.25588


def _scaled_pressure(report: Report) -> Any:
    altitude_m = report.vehicle.altitude_amsl_m
    return mavlink.MAVLink_scaled_pressure_message(
        time_boot_ms=boot_ms(report),
        press_abs=_pressure_hpa(altitude_m),
        press_diff=0.0,
        temperature=bounded(1500.0 - 0.65 * altitude_m, INT16),
    )


def _servo_output(report: Report) -> Any:
    armed = bool(report.status.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    throttle = 1000 + bounded(min(max(report.vehicle.throttle, 0.0), 1.0) * 1000.0, 1000)
    outputs = [900] * 16
    if armed:
        outputs[:4] = [1500, 1500, 1500, throttle] if is_plane(report) else [throttle] * 4
    return mavlink.MAVLink_servo_output_raw_message(
        report.time_us & 0xFFFFFFFF, 0, *outputs[:8], *outputs[8:]
    )


def _attitude_target(report: Report) -> Any:
    throttle, rates = report.vehicle.throttle, report.status.rates_rad_s
    return mavlink.MAVLink_attitude_target_message(
        time_boot_ms=boot_ms(report),
        type_mask=0,
        q=list(quaternion(report)),
        body_roll_rate=rates[0],
        body_pitch_rate=rates[1],
        body_yaw_rate=rates[2],
        thrust=throttle,
    )


def _body(report: Report, north: float, east: float, down: float) -> tuple[float, float, float]:
    """A vector in the vehicle's own axes: forward, right, down."""
    vehicle = report.vehicle
    cy, sy = math.cos(vehicle.heading_rad), math.sin(vehicle.heading_rad)
    cp, sp = math.cos(vehicle.pitch_rad), math.sin(vehicle.pitch_rad)
    cr, sr = math.cos(vehicle.roll_rad), math.sin(vehicle.roll_rad)
    ahead, aside = north * cy + east * sy, east * cy - north * sy
    forward, below = ahead * cp - down * sp, ahead * sp + down * cp
    return forward, aside * cr + below * sr, below * cr - aside * sr


def _highres_imu(report: Report) -> Any:
    vehicle = report.vehicle
    xacc, yacc, zacc = _body(
        report,
        vehicle.acceleration_north_m_s2,
        vehicle.acceleration_east_m_s2,
        -vehicle.acceleration_up_m_s2 - _G,
    )
    xgyro, ygyro, zgyro = report.status.rates_rad_s
    xmag, ymag, zmag = _body(report, 0.21, 0.0125, 0.43)
    return mavlink.MAVLink_highres_imu_message(
        time_usec=report.time_us,
        xacc=xacc,
        yacc=yacc,
        zacc=zacc,
        xgyro=xgyro,
        ygyro=ygyro,
        zgyro=zgyro,
        xmag=xmag,
        ymag=ymag,
        zmag=zmag,
        abs_pressure=_pressure_hpa(vehicle.altitude_amsl_m),
        diff_pressure=0.0,
        pressure_alt=vehicle.altitude_amsl_m,
        temperature=15.0,
        fields_updated=7167,
        id=0,
    )


def _distance_sensor(report: Report) -> Any | None:
    above_m = report.status.above_ground_m
    if above_m is None:
        return None
    return mavlink.MAVLink_distance_sensor_message(
        time_boot_ms=boot_ms(report),
        min_distance=0,
        max_distance=10000,
        current_distance=min(max(round(above_m * 100.0), 0), 10000),
        type=0,
        id=0,
        orientation=25,
        covariance=0,
    )


def _attitude(report: Report) -> Any:
    return _turning(report, telemetry.attitude(report))


def _attitude_quaternion(report: Report) -> Any:
    return _turning(report, telemetry.attitude_quaternion(report))


def _turning(report: Report, message: Any) -> Any:
    message.rollspeed, message.pitchspeed, message.yawspeed = report.status.rates_rad_s
    return message


def _altitude(report: Report) -> Any:
    estimate, status = report.estimate, report.status
    origin, home, above_m = status.origin, status.home, status.above_ground_m
    amsl_m = estimate.altitude_amsl_m
    local_m = _NAN if origin is None else amsl_m - origin.altitude_amsl_m
    return mavlink.MAVLink_altitude_message(
        time_usec=report.time_us,
        altitude_monotonic=report.vehicle.altitude_amsl_m,
        altitude_amsl=_NAN if origin is None else amsl_m,
        altitude_local=local_m,
        altitude_relative=_NAN if home is None else amsl_m - home.altitude_amsl_m,
        altitude_terrain=_NAN if above_m is None else local_m - above_m,
        bottom_clearance=_NAN if above_m is None else above_m,
    )


def _vibration(report: Report) -> Any:
    vehicle = report.vehicle
    flying = not on_ground(report)
    return mavlink.MAVLink_vibration_message(
        time_usec=report.time_us,
        vibration_x=1e-8 * abs(vehicle.acceleration_north_m_s2),
        vibration_y=0.1 + 0.01 * abs(vehicle.acceleration_east_m_s2) if flying else 0.0,
        vibration_z=1.45 + 0.1 * abs(vehicle.acceleration_up_m_s2) if flying else 0.0,
        clipping_0=0,
        clipping_1=0,
        clipping_2=0,
    )


def _odometry(report: Report) -> Any | None:
    local_ned_m, rates = report.status.local_ned_m, report.status.rates_rad_s
    estimate, nothing = report.estimate, [_NAN] * 21
    if local_ned_m is None:
        return None
    x, y, z = local_ned_m
    horizontal, vertical = estimate.horizontal_accuracy_m**2 / 2, estimate.vertical_accuracy_m**2
    pose, speed = list(nothing), list(nothing)
    pose[0], pose[6], pose[11] = horizontal, horizontal, vertical
    pose[15], pose[18], pose[20] = 1e-4, 1e-4, 6e-4
    speed[0], speed[6], speed[11] = 0.0147, 0.0124, 0.0099
    return mavlink.MAVLink_odometry_message(
        time_usec=report.time_us,
        frame_id=mavlink.MAV_FRAME_LOCAL_NED,
        child_frame_id=mavlink.MAV_FRAME_LOCAL_NED,
        x=x,
        y=y,
        z=z,
        q=list(quaternion(report)),
        vx=estimate.velocity_north_m_s,
        vy=estimate.velocity_east_m_s,
        vz=-estimate.velocity_up_m_s,
        rollspeed=rates[0],
        pitchspeed=rates[1],
        yawspeed=rates[2],
        pose_covariance=pose,
        velocity_covariance=speed,
        reset_counter=9,
        estimator_type=mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        quality=0,
    )


def _gnss_integrity(_: Report) -> Any:
    return mavlink.MAVLink_gnss_integrity_message(
        id=4,
        system_errors=0,
        authentication_state=0,
        jamming_state=0,
        spoofing_state=0,
        raim_state=0,
        raim_hfom=UINT16,
        raim_vfom=UINT16,
        corrections_quality=255,
        system_status_summary=255,
        gnss_signal_quality=255,
        post_processing_quality=255,
    )


def _drone_id_location(report: Report) -> Any:
    fix = report.fix
    north, east, up = fix.velocity_north_m_s, fix.velocity_east_m_s, fix.velocity_up_m_s
    home = report.status.home
    altitude_m = fix.altitude_amsl_m
    return mavlink.MAVLink_open_drone_id_location_message(
        target_system=0,
        target_component=0,
        id_or_mac=[0] * 20,
        status=1 if on_ground(report) else 2,
        direction=round(math.degrees(math.atan2(east, north))) % 360 * 100,
        speed_horizontal=bounded(math.hypot(north, east) * 100.0, 25425),
        speed_vertical=bounded(up * 100.0, 6200),
        latitude=degrees_e7(fix.latitude_deg),
        longitude=degrees_e7(fix.longitude_deg),
        altitude_barometric=report.vehicle.altitude_amsl_m,
        altitude_geodetic=round(altitude_m),
        height_reference=0,
        height=0.0 if home is None else altitude_m - home.altitude_amsl_m,
        horizontal_accuracy=12,
        vertical_accuracy=5,
        barometer_accuracy=0,
        speed_accuracy=3,
        timestamp=65535.0,
        timestamp_accuracy=0,
    )


def _drone_id_system(report: Report) -> Any:
    home = report.status.home
    return mavlink.MAVLink_open_drone_id_system_message(
        target_system=0,
        target_component=0,
        id_or_mac=[0] * 20,
        operator_location_type=0,
        classification_type=0,
        operator_latitude=0 if home is None else degrees_e7(home.latitude_deg),
        operator_longitude=0 if home is None else degrees_e7(home.longitude_deg),
        area_count=1,
        area_radius=0,
        area_ceiling=-1000.0,
        area_floor=-1000.0,
        category_eu=0,
        class_eu=0,
        operator_altitude_geo=-1000.0 if home is None else home.altitude_amsl_m,
        timestamp=_DRONE_ID_TIME,
    )


def _wind_cov(report: Report) -> Any | None:
    """Once in the air."""
    if not is_plane(report) or on_ground(report):
        return None
    vehicle = report.vehicle
    return mavlink.MAVLink_wind_cov_message(
        time_usec=report.time_us,
        wind_x=vehicle.wind_north_m_s,
        wind_y=vehicle.wind_east_m_s,
        wind_z=0.0,
        var_horiz=0.8,
        var_vert=0.0,
        wind_alt=report.estimate.altitude_amsl_m,
        horiz_accuracy=0.0,
        vert_accuracy=0.0,
    )


MESSAGES: dict[int, Builder] = {
    29: _scaled_pressure,
    30: _attitude,
    31: _attitude_quaternion,
    36: _servo_output,
    83: _attitude_target,
    105: _highres_imu,
    132: _distance_sensor,
    141: _altitude,
    231: _wind_cov,
    241: _vibration,
    331: _odometry,
    441: _gnss_integrity,
    12901: _drone_id_location,
    12904: _drone_id_system,
}
"""By message number."""
