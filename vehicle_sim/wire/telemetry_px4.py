"""A PX4's report as MAVLink messages: what it says differently, and what only it says.

Fields are filled as in the recorded flights (px4.md 2), constants included: what SIH does not
simulate is as empty here as there.
"""

import math
from typing import Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Landed, Report
from vehicle_sim.autopilots.px4.modes import CUSTOM_MODES, Mode, standard_mode
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.wire import telemetry
from vehicle_sim.wire.frames import bounded
from vehicle_sim.wire.telemetry import (
    INT16,
    INT32,
    UINT16,
    boot_ms,
    is_plane,
    per_cent_left,
    place_e7,
    quaternion,
    rates_rad_s,
    throttle,
    time_us,
    velocity_ned_m_s,
)

_NAN: Final = math.nan
_UNKNOWN: Final = (_NAN, _NAN, _NAN)
_PRESENT, _ENABLED, _HEALTH = 33570863, 33636399, 52480063
"""SYS_STATUS as recorded; the bits of the GPS (0x20) and of the position control (0x4000) apart."""
_AIRSPEED_BIT, _GPS_BIT, _POSITION_BIT, _PREARM_BIT = 0x10, 0x20, 0x4000, 0x10000000
_BOOTING_HEALTH: Final = 52545599
_SENSORS_FROM_US: Final = 2_100_000
"""Boot to the first report of sensors that are present: 1.6 s + 0.64 s of the log."""
_RETURN_MARGIN_S, _RETURN_FACTOR = 100.0, 1.1
"""RTL_TIME_MARGIN and RTL_TIME_FACTOR."""
_BY_MODE: Final = {
    number: mode for mode, number in CUSTOM_MODES.items() if mode is not Mode.DESCEND
}
_DRONE_ID_TIME: Final = 2748666496
"""As recorded: PX4 fills it with something that is no time."""
_SPEED_COVARIANCE: Final = [{0: 0.0147, 6: 0.0124, 11: 0.0099}.get(k, _NAN) for k in range(21)]


def _on_ground(report: Report) -> bool:
    """As EXTENDED_SYS_STATE says it."""
    return report.status.landed_state == Landed.ON_GROUND


# --- health ---------------------------------------------------------------------------------------


def _masks(report: Report) -> tuple[int, int, int]:
    """What is there, wanted and well."""
    present, enabled, health = _PRESENT, _ENABLED, _HEALTH
    if not report.status.fusing:
        present, enabled = present & ~_GPS_BIT, enabled & ~_GPS_BIT
    if not report.estimate.position_ok:
        health &= ~_POSITION_BIT
    if is_plane(report):
        present, enabled = present | _AIRSPEED_BIT, enabled | _AIRSPEED_BIT
    if report.time_us < _SENSORS_FROM_US:
        present, enabled, health = 0, 0, _BOOTING_HEALTH
    return present, enabled, health | (_PREARM_BIT if report.status.prearm_ok else 0)


def _estimator_ratios(report: Report) -> tuple[float, ...]:
    """Of velocity, position, height, compass, height above ground and airspeed."""
    estimate = report.estimate
    airspeed = 0.03 if is_plane(report) and not _on_ground(report) else _NAN
    return (
        *(estimate.velocity_variance, estimate.horizontal_variance, estimate.vertical_variance),
        *(estimate.compass_variance, estimate.terrain_variance, airspeed),
    )


# --- where it flies to ----------------------------------------------------------------------------


def _mission_mode(report: Report) -> int:
    """1 while the navigator lands, takes off or flies the mission, else 2."""
    status = report.status
    flies = (Mode.LAND, Mode.TAKEOFF, Mode.MISSION)
    return 1 if status.waypoint is not None and _BY_MODE[status.mode] in flies else 2


def _waypoint(report: Report) -> tuple[float, ...] | None:
    waypoint = report.status.waypoint
    if waypoint is None:
        return None
    lands = report.status.mode == CUSTOM_MODES[Mode.LAND] and not is_plane(report)
    return (*place_e7(waypoint.place), 0.0 if lands else waypoint.place.altitude_amsl_m)


def _aim(report: Report) -> tuple[float, ...]:
    """Velocity, acceleration, yaw and its rate: the controller's."""
    target = report.autopilot.target_echo()
    if target is None:
        return (*_UNKNOWN, *_UNKNOWN, _NAN, _NAN)
    velocity, acceleration = target.velocity_ned_m_s, target.acceleration_ned_m_s2
    vectors = (*(velocity or _UNKNOWN), *(acceleration or _UNKNOWN))
    return (*vectors, target.yaw_rad, target.yaw_rate_rad_s)


def _orbit(report: Report) -> tuple[float, ...] | None:
    """While a fixed wing circles."""
    waypoint = report.status.waypoint
    if waypoint is None or waypoint.radius_m == 0.0:
        return None
    return (waypoint.radius_m, *place_e7(waypoint.place), waypoint.place.altitude_amsl_m)


def _home_down_m(report: Report) -> float | None:
    """Seen from the origin."""
    home, origin = report.autopilot.home, report.status.origin
    return home and origin and origin.altitude_amsl_m - home.altitude_amsl_m


def _return_s(report: Report) -> int:
    """RTL_TIME_MARGIN and a rough way home; 0 on the ground."""
    home, local_ned_m = report.autopilot.home, report.autopilot.local_ned_m()
    if _on_ground(report) or home is None or local_ned_m is None:
        return 0
    way_s = math.hypot(local_ned_m[0], local_ned_m[1]) / 5.0
    way_s += max(report.estimate.altitude_amsl_m - home.altitude_amsl_m, 0.0) / 1.5
    return round(_RETURN_MARGIN_S + _RETURN_FACTOR * way_s)


def _modes(report: Report) -> tuple[int, int, int]:
    """Standard mode, the mode and the intended one."""
    status = report.status
    mode = _BY_MODE.get(status.mode)
    standard = 0 if status.failsafe or mode is None else standard_mode(mode)
    intended = status.mode if status.intended_mode is None else status.intended_mode
    return standard, status.mode, intended


# --- attitude and sensors -------------------------------------------------------------------------


def _pressure_hpa(report: Report) -> float:
    """International standard atmosphere."""
    return 1013.25 * max(1.0 - 2.25577e-5 * report.vehicle.altitude_amsl_m, 0.01) ** 5.25588


def _servos(report: Report) -> list[int]:
    turning = 1000 + bounded(throttle(report) * 1000.0, 1000)
    if not report.status.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED:
        return [900] * 4
    return [1500, 1500, 1500, turning] if is_plane(report) else [turning] * 4


def _body(report: Report, north: float, east: float, down: float) -> tuple[float, float, float]:
    """A vector in the vehicle's own axes: forward, right, down."""
    vehicle = report.vehicle
    cy, sy = math.cos(vehicle.heading_rad), math.sin(vehicle.heading_rad)
    cp, sp = math.cos(vehicle.pitch_rad), math.sin(vehicle.pitch_rad)
    cr, sr = math.cos(vehicle.roll_rad), math.sin(vehicle.roll_rad)
    ahead, aside = north * cy + east * sy, east * cy - north * sy
    forward, below = ahead * cp - down * sp, ahead * sp + down * cp
    return forward, aside * cr + below * sr, below * cr - aside * sr


def _specific_force(report: Report) -> tuple[float, float, float]:
    vehicle = report.vehicle
    level = (vehicle.acceleration_north_m_s2, vehicle.acceleration_east_m_s2)
    return _body(report, *level, -vehicle.acceleration_up_m_s2 - GRAVITY_M_S2)


def _range_cm(report: Report) -> int | None:
    above_m = report.status.above_ground_m
    return None if above_m is None else min(max(round(above_m * 100.0), 0), 10000)


def _altitudes_m(report: Report) -> tuple[float, ...]:
    """Above the sea, the origin, home and the ground's own height; and above the ground."""
    status, amsl_m = report.status, report.estimate.altitude_amsl_m
    origin, home, above_m = status.origin, report.autopilot.home, status.above_ground_m
    local_m = _NAN if origin is None else amsl_m - origin.altitude_amsl_m
    return (
        _NAN if origin is None else amsl_m,
        local_m,
        _NAN if home is None else amsl_m - home.altitude_amsl_m,
        _NAN if above_m is None else local_m - above_m,
        _NAN if above_m is None else above_m,
    )


def _vibration(report: Report) -> tuple[float, float, float]:
    vehicle = report.vehicle
    x = 1e-8 * abs(vehicle.acceleration_north_m_s2)
    if _on_ground(report):
        return x, 0.0, 0.0
    y = 0.1 + 0.01 * abs(vehicle.acceleration_east_m_s2)
    return x, y, 1.45 + 0.1 * abs(vehicle.acceleration_up_m_s2)


def _pose_covariance(report: Report) -> list[float]:
    estimate = report.estimate
    horizontal, vertical = estimate.horizontal_accuracy_m**2 / 2, estimate.vertical_accuracy_m**2
    known = {0: horizontal, 6: horizontal, 11: vertical, 15: 1e-4, 18: 1e-4, 20: 6e-4}
    return [known.get(k, _NAN) for k in range(21)]


def _drone_id_motion(report: Report) -> tuple[int, int, int]:
    """Direction, horizontal and vertical speed."""
    fix = report.fix
    north, east = fix.velocity_north_m_s, fix.velocity_east_m_s
    return (
        round(math.degrees(math.atan2(east, north))) % 360 * 100,
        bounded(math.hypot(north, east) * 100.0, 25425),
        bounded(fix.velocity_up_m_s * 100.0, 6200),
    )


def _drone_id_height_m(report: Report) -> float:
    home = report.autopilot.home
    return 0.0 if home is None else report.fix.altitude_amsl_m - home.altitude_amsl_m


def _drone_id_operator(report: Report) -> tuple[float, float, float]:
    home = report.autopilot.home
    return (0, 0, -1000.0) if home is None else (*place_e7(home), home.altitude_amsl_m)


def _wind(report: Report) -> tuple[float, float] | None:
    """Once in the air."""
    vehicle = report.vehicle
    flies = is_plane(report) and not _on_ground(report)
    return (vehicle.wind_north_m_s, vehicle.wind_east_m_s) if flies else None


# --- the table ------------------------------------------------------------------------------------

MESSAGES: Final = telemetry.builders(
    {
        "SYS_STATUS": {
            "onboard_control_sensors_present onboard_control_sensors_enabled "
            "onboard_control_sensors_health": _masks,
            "load": lambda r: 120 + r.time_us // 200_000 * 37 % 60,
            "voltage_battery": lambda r: bounded(r.battery.voltage_v * 1e3, UINT16),
            "current_battery": -100,
            "battery_remaining": lambda r: math.ceil(per_cent_left(r)),
            "onboard_control_sensors_health_extended": 1,
        },
        "PING": {"seq": lambda r: r.time_us // 1_000_000},
        "GPS_RAW_INT": {"time_usec": lambda r: r.fix.time_us or None},
        "GLOBAL_POSITION_INT": {"time_boot_ms": lambda r: boot_ms(r) if r.status.origin else None},
        "MISSION_CURRENT": {"mission_mode": _mission_mode},
        "VFR_HUD": {"airspeed": lambda r: r.vehicle.airspeed_m_s if is_plane(r) else _NAN},
        # the navigator's place with the controller's vectors
        "POSITION_TARGET_GLOBAL_INT": {
            "coordinate_frame": mavlink.MAV_FRAME_GLOBAL_INT,
            "lat_int lon_int alt": _waypoint,
            "vx vy vz afx afy afz yaw yaw_rate": _aim,
        },
        "TIMESYNC": {"ts1": lambda r: r.time_us * 1000},
        "BATTERY_STATUS": {
            "battery_function type": (1, 1),
            "temperature": INT16,
            "voltages": lambda r: [bounded(r.battery.voltage_v * 1e3, UINT16 - 1), *[UINT16] * 9],
            "current_battery": -100,
            "current_consumed": lambda r: bounded(r.battery.consumed_mah, INT32),
            "energy_consumed": -1,
            "battery_remaining": lambda r: math.floor(per_cent_left(r)),
            "charge_state": 1,
        },
        "AUTOPILOT_VERSION": {
            "capabilities": lambda r: r.profile.capabilities,
            "flight_sw_version": lambda r: r.profile.software_version,
            "middleware_sw_version": lambda r: r.profile.software_version,
            "os_sw_version": 101854463,
            "board_version": 1,
            "flight_custom_version": lambda r: list(r.profile.custom_version),
            "middleware_custom_version": lambda r: list(r.profile.custom_version),
            "uid": lambda r: r.hardware_id,
        },
        "ESTIMATOR_STATUS": {
            "flags": lambda r: r.estimate.flags,
            "vel_ratio pos_horiz_ratio pos_vert_ratio mag_ratio hagl_ratio tas_ratio": (
                _estimator_ratios
            ),
            "pos_horiz_accuracy": lambda r: r.estimate.horizontal_accuracy_m,
            "pos_vert_accuracy": lambda r: r.estimate.vertical_accuracy_m,
        },
        "HOME_POSITION": {"z": _home_down_m, "q": (1.0, 0.0, 0.0, 0.0)},
        "ORBIT_EXECUTION_STATUS": {"radius x y z": _orbit},
        "CURRENT_MODE": {"standard_mode custom_mode intended_custom_mode": _modes},
        "SCALED_PRESSURE": {
            "press_abs": _pressure_hpa,
            "temperature": lambda r: bounded(1500.0 - 0.65 * r.vehicle.altitude_amsl_m, INT16),
        },
        "SERVO_OUTPUT_RAW": {
            "time_usec": lambda r: r.time_us & 0xFFFFFFFF,
            "servo1_raw servo2_raw servo3_raw servo4_raw": _servos,
            **{f"servo{k}_raw": 900 for k in range(5, 17)},
        },
        "ATTITUDE_TARGET": {
            "q": quaternion,
            "body_roll_rate body_pitch_rate body_yaw_rate": rates_rad_s,
            "thrust": lambda r: r.vehicle.throttle,
        },
        "HIGHRES_IMU": {
            "xacc yacc zacc": _specific_force,
            "xgyro ygyro zgyro": rates_rad_s,
            "xmag ymag zmag": lambda r: _body(r, 0.21, 0.0125, 0.43),
            "abs_pressure": _pressure_hpa,
            "pressure_alt": lambda r: r.vehicle.altitude_amsl_m,
            "temperature": 15.0,
            "fields_updated": 7167,
        },
        "DISTANCE_SENSOR": {
            "max_distance": 10000,
            "current_distance": _range_cm,
            "orientation": 25,
        },
        "ALTITUDE": {
            "altitude_monotonic": lambda r: r.vehicle.altitude_amsl_m,
            "altitude_amsl altitude_local altitude_relative altitude_terrain bottom_clearance": (
                _altitudes_m
            ),
        },
        "VIBRATION": {"vibration_x vibration_y vibration_z": _vibration},
        "ODOMETRY": {
            "frame_id child_frame_id": (mavlink.MAV_FRAME_LOCAL_NED,) * 2,
            "x y z": lambda r: r.autopilot.local_ned_m(),
            "q": quaternion,
            "vx vy vz": velocity_ned_m_s,
            "rollspeed pitchspeed yawspeed": rates_rad_s,
            "pose_covariance": _pose_covariance,
            "velocity_covariance": _SPEED_COVARIANCE,
            "reset_counter": 9,
            "estimator_type": mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        },
        "GNSS_INTEGRITY": {
            "id": 4,
            "raim_hfom raim_vfom": (UINT16, UINT16),
            "corrections_quality system_status_summary": (255, 255),
            "gnss_signal_quality post_processing_quality": (255, 255),
        },
        "OPEN_DRONE_ID_LOCATION": {
            "status": lambda r: 1 if _on_ground(r) else 2,
            "direction speed_horizontal speed_vertical": _drone_id_motion,
            "latitude longitude": lambda r: place_e7(r.fix),
            "altitude_barometric": lambda r: r.vehicle.altitude_amsl_m,
            "altitude_geodetic": lambda r: round(r.fix.altitude_amsl_m),
            "height": _drone_id_height_m,
            "horizontal_accuracy vertical_accuracy speed_accuracy": (12, 5, 3),
            "timestamp": 65535.0,
        },
        "OPEN_DRONE_ID_SYSTEM": {
            "operator_latitude operator_longitude operator_altitude_geo": _drone_id_operator,
            "area_count": 1,
            "area_ceiling area_floor": (-1000.0, -1000.0),
            "timestamp": _DRONE_ID_TIME,
        },
        "WIND_COV": {
            "wind_x wind_y": _wind,
            "var_horiz": 0.8,
            "wind_alt": lambda r: r.estimate.altitude_amsl_m,
        },
        "LINK_NODE_STATUS": {"timestamp": time_us},
        "PROTOCOL_VERSION": {"version min_version max_version": (200, 100, 200)},
        "TIME_ESTIMATE_TO_TARGET": {
            "safe_return": _return_s,
            "land mission_next_item mission_end commanded_action": (-1,) * 4,
        },
    }
)
"""What can be said, by message number; None while there is nothing to say."""
