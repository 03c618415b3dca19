"""What ArduPilot says besides, and what it says differently: from the recorded flights."""

import math
from typing import Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Report
from vehicle_sim.geodesy import ARDUPILOT_M_PER_DEG, degrees_east
from vehicle_sim.wire import telemetry
from vehicle_sim.wire.frames import Prepared, make
from vehicle_sim.wire.telemetry import INT16, INT32, NAN, UINT16, boot_ms, bounded, is_plane

_SENSORS = 0x4241_9C0F
"""Gyroscopes, accelerometers, compass, pressure, control: always there and well."""
_GPS, _PREARM_CHECK = 0x20, 0x1000_0000
_TARGET_MASK_GLOBAL = 0xFDF8
_NO_CELL = 65535


# --- health and battery ---------------------------------------------------------------------------


def _percent(report: Report) -> int:
    return math.floor(telemetry.per_cent_left(report) + 1e-9)


def _volts_and_amperes(report: Report) -> tuple[int, int]:
    """In MAVLink's thousandths and hundredths."""
    battery = report.battery
    return bounded(battery.voltage_v * 1000.0, INT16), bounded(battery.current_a * 100.0, INT16)


def _sys_status(report: Report) -> Prepared:
    there, lost = report.range_sensors
    there |= _SENSORS | (_GPS if report.fix.fix_type > 0 else 0)
    well = there & ~lost | (_PREARM_CHECK if report.status.prearm_ok else 0)
    wanted, battery = there | _PREARM_CHECK, (*_volts_and_amperes(report), _percent(report))
    return make("SYS_STATUS", wanted, wanted, well, 0, *battery)


def _battery_status(report: Report) -> Prepared:
    volts, amperes = _volts_and_amperes(report)
    return make(
        "BATTERY_STATUS",
        temperature=INT16,
        voltages=[volts, *[_NO_CELL] * 9],
        current_battery=amperes,
        current_consumed=bounded(report.battery.consumed_mah, INT32),
        battery_remaining=_percent(report),
        charge_state=1,
    )


def _autopilot_version(report: Report) -> Prepared:
    profile, uid = report.profile, report.hardware_id.to_bytes(18, "little")
    return make(
        "AUTOPILOT_VERSION",
        *(profile.capabilities, profile.software_version),
        flight_custom_version=list(profile.custom_version),
        uid2=list(uid),
    )


def _timesync(report: Report) -> Prepared:
    """Its question, every ten seconds: the last digit tells it from those of others."""
    return make("TIMESYNC", 0, report.time_us * 1000 + 1)


# --- position -------------------------------------------------------------------------------------


def _altitude_amsl_m(report: Report) -> float:
    """It stands still with the position; the height above home does not."""
    frozen_m = report.estimate.frozen_altitude_amsl_m
    return report.estimate.altitude_amsl_m if frozen_m is None else frozen_m


def _global_position_int(report: Report) -> Prepared:
    return telemetry.global_position(report, _altitude_amsl_m(report))


def _gps_raw_int(report: Report) -> Prepared:
    """Nothing is known before the receiver speaks."""
    return telemetry.gps_raw(report, known=report.fix.fix_type >= 1)


def _vfr_hud(report: Report) -> Prepared:
    """A plane says its indicated airspeed."""
    known = report.fix.fix_type > 0 or report.time_us > 10_000_000
    airspeed_m_s = report.status.airspeed_m_s
    return telemetry.vfr_hud(
        report,
        report.vehicle.airspeed_m_s if airspeed_m_s is None else airspeed_m_s,
        round(_altitude_amsl_m(report), 2) if known else 0.0,
    )


def _ekf_status_report(report: Report) -> Prepared:
    estimate = report.estimate
    variances = (estimate.velocity_variance, estimate.horizontal_variance)
    return make("EKF_STATUS_REPORT", estimate.flags, *variances)


def _home_position(report: Report) -> Prepared | None:
    """In the estimator's frame; no attitude of the surface is known."""
    home, origin, ned_m = report.autopilot.home, report.status.origin, (NAN, NAN, NAN)
    if home is not None and origin is not None:
        north_deg = home.latitude_deg - origin.latitude_deg
        east_deg = degrees_east(origin.longitude_deg, home.longitude_deg)
        shrink = math.cos(math.radians(origin.latitude_deg))
        ned_m = (
            north_deg * ARDUPILOT_M_PER_DEG,
            east_deg * ARDUPILOT_M_PER_DEG * shrink,
            origin.altitude_amsl_m - home.altitude_amsl_m,
        )
    return telemetry.home_position(report, ned_m, [NAN] * 4)


def _simstate(report: Report) -> Prepared:
    """The truth: SITL says it too."""
    latitude, longitude = telemetry.place_e7(report.vehicle)
    return make("SIMSTATE", lat=latitude, lng=longitude)


# --- where it flies to, and what is about it ------------------------------------------------------


def _position_target_global_int(report: Report) -> Prepared | None:
    waypoint = report.status.waypoint
    if waypoint is None:
        return None
    place = (*telemetry.place_e7(waypoint.place), waypoint.place.altitude_amsl_m)
    head = (boot_ms(report), mavlink.MAV_FRAME_GLOBAL, _TARGET_MASK_GLOBAL)
    return make("POSITION_TARGET_GLOBAL_INT", *head, *place)


def _nav_controller_output(report: Report) -> Prepared | None:
    """A copter has a target everywhere."""
    vehicle, waypoint = report.vehicle, report.status.waypoint
    attitude_deg = (math.degrees(vehicle.roll_rad), math.degrees(vehicle.pitch_rad))
    if waypoint is None:
        return None if is_plane(report) else make("NAV_CONTROLLER_OUTPUT", *attitude_deg)
    bearing_deg = round(math.degrees(math.remainder(waypoint.bearing_rad, math.tau)))
    return make(
        "NAV_CONTROLLER_OUTPUT",
        *(*attitude_deg, bearing_deg, bearing_deg, bounded(waypoint.distance_m, UINT16)),
        *(waypoint.altitude_error_m, waypoint.airspeed_error_m_s * 100.0, waypoint.cross_track_m),
    )


def _mission_current(report: Report) -> Prepared:
    return telemetry.mission_current(report)


def _extended_sys_state(report: Report) -> Prepared:
    vtol = 0 if is_plane(report) else mavlink.MAV_VTOL_STATE_MC
    return make("EXTENDED_SYS_STATE", vtol, report.status.landed_state)


def _fence_status(report: Report) -> Prepared | None:
    status = report.status
    if not status.fence_present:
        return None
    numbers = (int(status.fence_breached), status.fence_breaches, status.fence_breach_type)
    return make("FENCE_STATUS", *numbers, status.fence_breach_ms)


def _wind(report: Report) -> Prepared:
    """The air as it is, as a direction that it comes from."""
    north, east = report.vehicle.wind_north_m_s, report.vehicle.wind_east_m_s
    direction_deg = math.degrees(math.atan2(-east, -north)) if north or east else -180.0
    return make("WIND", direction_deg, math.hypot(north, east))


MESSAGES: Final = telemetry.by_number(
    *(_sys_status, _battery_status, _autopilot_version, _timesync),
    *(_global_position_int, _gps_raw_int, _vfr_hud, _ekf_status_report, _home_position, _simstate),
    *(_position_target_global_int, _nav_controller_output, _mission_current),
    *(_extended_sys_state, _fence_status, _wind),
)
"""What can be said, by message number; None while there is nothing to say."""
