"""A PX4's report as MAVLink messages: what it says differently, and what only it says.

Fields that somebody reads are filled as in the recorded flights (px4.md 2).
"""

import math
from typing import Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.px4 import ARMABLE_S, MODE_NAMES, STANDARD_MODES
from vehicle_sim.autopilots import Landed, Report
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
    velocity_ned_m_s,
)

_NAN: Final = math.nan
_UNKNOWN: Final = (_NAN, _NAN, _NAN)
_SENSORS: Final = 0x0200_000F
"""SYS_STATUS: gyroscopes, accelerometers, compass, pressure, battery: always there and well."""
_GPS_BIT, _POSITION_BIT, _PREARM_BIT = 0x20, 0x4000, 0x10000000


def _on_ground(report: Report) -> bool:
    """As EXTENDED_SYS_STATE says it."""
    return report.status.landed_state == Landed.ON_GROUND


# --- health ---------------------------------------------------------------------------------------


def _masks(report: Report) -> tuple[int, int, int]:
    """What is there, wanted and well."""
    there = _SENSORS | (_GPS_BIT if report.status.fusing else 0)
    flies = report.estimate.position_ok and report.time_us >= ARMABLE_S * 1e6
    position = _POSITION_BIT if flies else 0
    prearm = _PREARM_BIT if report.status.prearm_ok else 0
    wanted = there | _POSITION_BIT | _PREARM_BIT
    return wanted, wanted, there | position | prearm


# --- where it flies to ----------------------------------------------------------------------------


def _mission_mode(report: Report) -> int:
    """1 while the navigator lands, takes off or flies the mission, else 2."""
    status = report.status
    flies = MODE_NAMES[status.mode] in ("Land", "Takeoff", "Mission")
    return 1 if status.waypoint is not None and flies else 2


def _waypoint(report: Report) -> tuple[float, ...] | None:
    waypoint = report.status.waypoint
    if waypoint is None:
        return None
    lands = MODE_NAMES[report.status.mode] == "Land" and not is_plane(report)
    return (*place_e7(waypoint.place), 0.0 if lands else waypoint.place.altitude_amsl_m)


def _aim(report: Report) -> tuple[float, ...]:
    """Velocity, acceleration, yaw and its rate: the controller's."""
    target = report.autopilot.target_echo()
    if target is None:
        return (*_UNKNOWN, *_UNKNOWN, _NAN, _NAN)
    velocity, acceleration = target.velocity_ned_m_s, target.acceleration_ned_m_s2
    vectors = (*(velocity or _UNKNOWN), *(acceleration or _UNKNOWN))
    return (*vectors, target.yaw_rad, target.yaw_rate_rad_s)


def _home_down_m(report: Report) -> float | None:
    """Seen from the origin."""
    home, origin = report.autopilot.home, report.status.origin
    return home and origin and origin.altitude_amsl_m - home.altitude_amsl_m


def _modes(report: Report) -> tuple[int, int, int]:
    """Standard mode, the mode and the intended one."""
    status = report.status
    standard = 0 if status.failsafe else STANDARD_MODES.get(MODE_NAMES[status.mode], 0)
    intended = status.mode if status.intended_mode is None else status.intended_mode
    return standard, status.mode, intended


# --- sensors ------------------------------------------------------------------------------------


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
            "voltage_battery": lambda r: bounded(r.battery.voltage_v * 1e3, UINT16),
            "current_battery": -100,
            "battery_remaining": lambda r: math.ceil(per_cent_left(r)),
            "onboard_control_sensors_health_extended": 1,
        },
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
            "vel_ratio": lambda r: r.estimate.velocity_variance,
            "pos_horiz_ratio": lambda r: r.estimate.horizontal_variance,
            "pos_horiz_accuracy": lambda r: r.estimate.horizontal_accuracy_m,
        },
        "HOME_POSITION": {"z": _home_down_m, "q": (1.0, 0.0, 0.0, 0.0)},
        "CURRENT_MODE": {"standard_mode custom_mode intended_custom_mode": _modes},
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
        "ODOMETRY": {
            "frame_id child_frame_id": (mavlink.MAV_FRAME_LOCAL_NED,) * 2,
            "x y z": lambda r: r.autopilot.local_ned_m(),
            "q": quaternion,
            "vx vy vz": velocity_ned_m_s,
            "rollspeed pitchspeed yawspeed": rates_rad_s,
            "pose_covariance": [_NAN] * 21,
            "velocity_covariance": [_NAN] * 21,
            "estimator_type": mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        },
        "WIND_COV": {
            "wind_x wind_y": _wind,
            "wind_alt": lambda r: r.estimate.altitude_amsl_m,
        },
        "PROTOCOL_VERSION": {"version min_version max_version": (200, 100, 200)},
    }
)
"""What can be said, by message number; None while there is nothing to say."""
