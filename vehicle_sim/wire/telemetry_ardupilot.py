"""What ArduPilot says besides, and what it says differently: from the recorded flights."""

import math
from typing import Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Report
from vehicle_sim.geodesy import ARDUPILOT_M_PER_DEG, degrees_east
from vehicle_sim.wire import telemetry
from vehicle_sim.wire.frames import bounded
from vehicle_sim.wire.telemetry import (
    INT16,
    INT32,
    UINT16,
    is_plane,
    place_e7,
)

_SENSORS = 0x4241_9C0F
"""Gyroscopes, accelerometers, compass, pressure, control: always there and well."""
_GPS, _PREARM_CHECK = 0x20, 0x1000_0000
_TARGET_MASK_GLOBAL = 0xFDF8
_NAN = float("nan")
_NO_CELL = 65535


# --- health and battery ---------------------------------------------------------------------------


def _masks(report: Report) -> tuple[int, int, int]:
    """What is there, wanted and well."""
    there, lost = report.range_sensors
    there |= _SENSORS | (_GPS if report.fix.fix_type > 0 else 0)
    well = there & ~lost | (_PREARM_CHECK if report.status.prearm_ok else 0)
    return there | _PREARM_CHECK, there | _PREARM_CHECK, well


def _percent(report: Report) -> int:
    return math.floor(telemetry.per_cent_left(report) + 1e-9)


# --- position and attitude ------------------------------------------------------------------------


def _gps_solution(report: Report) -> tuple[int, ...]:
    """Nothing is known before the receiver speaks."""
    known = report.fix.fix_type >= 1
    return telemetry.gps_solution(report) if known else (0, 0, 0, 0, UINT16, UINT16, 0, 0)


def _altitude_amsl_m(report: Report) -> float:
    """It stands still with the position; the height above home does not."""
    frozen_m = report.estimate.frozen_altitude_amsl_m
    return report.estimate.altitude_amsl_m if frozen_m is None else frozen_m


def _place(report: Report) -> tuple[int, int, int]:
    return *place_e7(report.estimate), bounded(_altitude_amsl_m(report) * 1e3, INT32)


def _shown_altitude_m(report: Report) -> float:
    known = report.fix.fix_type > 0 or report.time_us > 10_000_000
    return round(_altitude_amsl_m(report), 2) if known else 0.0


def _home_ned_m(report: Report) -> tuple[float, float, float]:
    """In the estimator's frame."""
    home, origin = report.autopilot.home, report.status.origin
    if home is None or origin is None:
        return _NAN, _NAN, _NAN
    north_deg = home.latitude_deg - origin.latitude_deg
    east_deg = degrees_east(origin.longitude_deg, home.longitude_deg)
    return (
        north_deg * ARDUPILOT_M_PER_DEG,
        east_deg * ARDUPILOT_M_PER_DEG * math.cos(math.radians(origin.latitude_deg)),
        origin.altitude_amsl_m - home.altitude_amsl_m,
    )


def _waypoint(report: Report) -> tuple[float, ...] | None:
    waypoint = report.status.waypoint
    return waypoint and (*place_e7(waypoint.place), waypoint.place.altitude_amsl_m)


def _navigation(report: Report) -> tuple[float, ...] | None:
    """Bearing twice, distance, errors of height and airspeed, distance from the track."""
    waypoint = report.status.waypoint
    if waypoint is None:
        return None if is_plane(report) else (0, 0, 0, 0.0, 0.0, 0.0)
    bearing_deg = round(math.degrees(math.remainder(waypoint.bearing_rad, math.tau)))
    return (
        *(bearing_deg, bearing_deg, bounded(waypoint.distance_m, UINT16)),
        *(waypoint.altitude_error_m, waypoint.airspeed_error_m_s * 100.0, waypoint.cross_track_m),
    )


def _fence(report: Report) -> tuple[int, int, int, int] | None:
    status = report.status
    if not status.fence_present:
        return None
    return (
        *(int(status.fence_breached), status.fence_breaches),
        *(status.fence_breach_type, status.fence_breach_ms),
    )


def _wind(report: Report) -> tuple[float, float]:
    """The air as it is, as a direction that it comes from."""
    vehicle = report.vehicle
    north, east = vehicle.wind_north_m_s, vehicle.wind_east_m_s
    direction_deg = math.degrees(math.atan2(-east, -north)) if north or east else -180.0
    return direction_deg, math.hypot(north, east)


def _indicated_m_s(report: Report) -> float:
    """A plane says its indicated airspeed."""
    airspeed_m_s = report.status.airspeed_m_s
    return report.vehicle.airspeed_m_s if airspeed_m_s is None else airspeed_m_s


MESSAGES: Final = telemetry.builders(
    {
        "SYS_STATUS": {
            "onboard_control_sensors_present onboard_control_sensors_enabled "
            "onboard_control_sensors_health": _masks,
            "voltage_battery": lambda r: bounded(r.battery.voltage_v * 1000.0, INT16),
            "current_battery": lambda r: bounded(r.battery.current_a * 100.0, INT16),
            "battery_remaining": _percent,
        },
        # its question, every ten seconds: the last digit tells it from those of others
        "TIMESYNC": {"ts1": lambda r: r.time_us * 1000 + 1},
        "GLOBAL_POSITION_INT": {"lat lon alt": _place},
        "BATTERY_STATUS": {
            "temperature": INT16,
            "voltages": lambda r: [bounded(r.battery.voltage_v * 1000.0, INT16), *[_NO_CELL] * 9],
            "current_battery": lambda r: bounded(r.battery.current_a * 100.0, INT16),
            "current_consumed": lambda r: bounded(r.battery.consumed_mah, INT32),
            "battery_remaining": _percent,
            "charge_state": 1,
        },
        "GPS_RAW_INT": {telemetry.GPS_FIELDS: _gps_solution},
        "VFR_HUD": {"airspeed": _indicated_m_s, "alt": _shown_altitude_m},
        "EKF_STATUS_REPORT": {
            "flags": lambda r: r.estimate.flags,
            "velocity_variance": lambda r: r.estimate.velocity_variance,
            "pos_horiz_variance": lambda r: r.estimate.horizontal_variance,
        },
        # no attitude of the surface is known
        "HOME_POSITION": {"x y z": _home_ned_m, "q": [_NAN] * 4},
        "EXTENDED_SYS_STATE": {
            "vtol_state": lambda r: 0 if is_plane(r) else mavlink.MAV_VTOL_STATE_MC
        },
        "AUTOPILOT_VERSION": {
            "capabilities": lambda r: r.profile.capabilities,
            "flight_sw_version": lambda r: r.profile.software_version,
            "flight_custom_version": lambda r: list(r.profile.custom_version),
            "uid2": lambda r: [*r.hardware_id.to_bytes(8, "little"), *[0] * 10],
        },
        "POSITION_TARGET_GLOBAL_INT": {
            "coordinate_frame": mavlink.MAV_FRAME_GLOBAL,
            "type_mask": _TARGET_MASK_GLOBAL,
            "lat_int lon_int alt": _waypoint,
        },
        "NAV_CONTROLLER_OUTPUT": {
            "nav_roll": lambda r: math.degrees(r.vehicle.roll_rad),
            "nav_pitch": lambda r: math.degrees(r.vehicle.pitch_rad),
            "nav_bearing target_bearing wp_dist alt_error aspd_error xtrack_error": _navigation,
        },
        "FENCE_STATUS": {"breach_status breach_count breach_type breach_time": _fence},
        "WIND": {"direction speed": _wind},
        # the truth: SITL says it too
        "SIMSTATE": {"lat lng": lambda r: place_e7(r.vehicle)},
    }
)
"""What can be said, by message number; None while there is nothing to say."""
