"""What ArduPilot says besides, and what it says differently: from the recorded flights.

Sensors that nothing here models (magnetometer, temperatures) carry the values of a vehicle at
rest.
"""

import math
from typing import Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Report
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.geodesy import ARDUPILOT_M_PER_DEG, around, degrees_east
from vehicle_sim.wire import telemetry
from vehicle_sim.wire.frames import bounded, degrees_e7
from vehicle_sim.wire.telemetry import (
    INT16,
    INT32,
    UINT16,
    Form,
    attitude_rad,
    is_plane,
    place_e7,
    throttle,
)

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
_ESC_US = 5_500_000
_FIELD_MGAUSS: Final = (232, 52, -528)
"""The magnetic field in milligauss."""


# --- health and battery ---------------------------------------------------------------------------


def _masks(report: Report) -> tuple[int, int, int]:
    """What is there, wanted and well."""
    present, enabled, health = _usual_masks(report)
    there, lost = report.range_sensors
    return present | there, enabled | there, (health | there) & ~lost


def _usual_masks(report: Report) -> tuple[int, int, int]:
    """Without proximity sensor and rangefinder."""
    status = report.status
    gps = _GPS if report.fix.fix_type > 0 else 0
    prearm = _PREARM_CHECK if status.prearm_ok else 0
    if is_plane(report):
        present = _PLANE_PRESENT | gps
        if status.logging:
            return present, present, _PLANE_ARMED_HEALTH | gps
        ahrs = _AHRS if report.time_us >= _AHRS_US - 200_000 else 0
        calibrated = _AIRSPEED if report.time_us >= _AIRSPEED_US else 0
        return (
            present,
            _PLANE_ENABLED | gps | ahrs,
            _PLANE_HEALTH | gps | ahrs | calibrated | prearm,
        )
    armed = bool(status.base_mode & 0x80)
    holds = status.mode in _HOLDS_ALTITUDE and (armed or status.mode not in _RETURNS)
    control = _ALTITUDE if holds else 0
    if control and status.base_mode & 0x08:
        control |= _POSITION
    ahrs = _AHRS if report.time_us >= _AHRS_US else 0
    enabled = _COPTER_ENABLED | gps | control | ahrs | (_LOGGING if status.logging else 0)
    return _COPTER_PRESENT | gps, enabled, _COPTER_HEALTH | gps | control | ahrs | prearm


def _percent(report: Report) -> int:
    return math.floor(telemetry.per_cent_left(report) + 1e-9)


def _energy_hj(report: Report) -> int:
    battery = report.battery
    return bounded(battery.consumed_mah * 0.0036 * battery.voltage_v * 10.0, INT32)


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


def _airspeed_variance(report: Report) -> float:
    flies = is_plane(report) and report.status.logging
    return 2.0 * report.estimate.compass_variance if flies else 0.0


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
    """The air as the estimator has it: what it does, as a direction that it comes from."""
    vehicle = report.vehicle
    north, east = vehicle.wind_north_m_s, vehicle.wind_east_m_s
    if is_plane(report) and report.status.logging:
        north += _WIND_ERROR_M_S + report.estimate.velocity_variance
        east -= report.estimate.compass_variance
    direction_deg = math.degrees(math.atan2(-east, -north)) if north or east else -180.0
    return direction_deg, math.hypot(north, east)


def _terrain_wanted(report: Report) -> tuple[int, int]:
    """The grid about home, which it remembers."""
    home = report.autopilot.home or report.vehicle
    return degrees_e7(home.latitude_deg - 0.0115), degrees_e7(around(home.longitude_deg - 0.0104))


# --- sensors and the board ------------------------------------------------------------------------


def _indicated_m_s(report: Report) -> float:
    """A plane says its indicated airspeed."""
    airspeed_m_s = report.status.airspeed_m_s
    return report.vehicle.airspeed_m_s if airspeed_m_s is None else airspeed_m_s


def _dynamic_pressure(report: Report, factor: float) -> float | None:
    """Of planes."""
    airspeed = _indicated_m_s(report)
    return factor * airspeed * airspeed if is_plane(report) else None


def _specific_force(report: Report) -> tuple[float, float, float]:
    """What accelerometers measure at rest at this attitude: forward, right, down in m/s2."""
    vehicle = report.vehicle
    lift = GRAVITY_M_S2 + vehicle.acceleration_up_m_s2
    return 0.0, 0.0, -lift / max(math.cos(vehicle.roll_rad) * math.cos(vehicle.pitch_rad), 0.1)


def _milli_g(report: Report) -> tuple[int, ...]:
    scale = 1000.0 / GRAVITY_M_S2
    return tuple(bounded(each * scale, INT16) for each in _specific_force(report))


def _pressure_hpa(report: Report) -> float:
    """International standard atmosphere at the estimated height."""
    return 1013.25 * (1.0 - 2.25577e-5 * min(report.estimate.altitude_amsl_m, 4e4)) ** 5.25588


def _servos(report: Report) -> list[int]:
    turning = round(1000.0 + 1000.0 * throttle(report))
    if not is_plane(report):
        return [turning] * 4
    return [1500, 1500, turning, 1500] if report.status.base_mode & 0x80 else [0] * 4


def _motors(report: Report) -> tuple[bytes, list[int], list[int], list[int], list[int], list[int]]:
    """Temperatures, voltages, currents, charges, speeds and counters.

    One motor of a plane, on the third output; four of a copter.
    """
    turning = round(7000.0 * throttle(report))
    used = (0, 0, 1, 0) if is_plane(report) else (1, 1, 1, 1)
    count = max(report.time_us - _ESC_US, 0) // 20_000 & 0xFFFF
    _, *others = ([n * u for u in used] for n in (0, 1679, 80, 1, turning, count))
    voltage, current, total, rpm, counts = others
    return bytes(32 * u for u in used), voltage, current, total, rpm, counts


_IMU: Final[Form] = {
    "xacc yacc zacc": _milli_g,
    "xmag ymag zmag": _FIELD_MGAUSS,
    "temperature": 2512,
}

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
            "energy_consumed": _energy_hj,
            "battery_remaining": _percent,
            "charge_state": 1,
        },
        "GPS_RAW_INT": {telemetry.GPS_FIELDS: _gps_solution},
        "VFR_HUD": {"airspeed": _indicated_m_s, "alt": _shown_altitude_m},
        "EKF_STATUS_REPORT": {
            "flags": lambda r: r.estimate.flags,
            "velocity_variance": lambda r: r.estimate.velocity_variance,
            "pos_horiz_variance": lambda r: r.estimate.horizontal_variance,
            "pos_vert_variance": lambda r: r.estimate.vertical_variance,
            "compass_variance": lambda r: r.estimate.compass_variance,
            "airspeed_variance": _airspeed_variance,
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
        "WIND": {"direction speed": _wind, "speed_z": lambda r: -r.vehicle.wind_up_m_s},
        # it has no terrain data, and requests it until it is answered
        "TERRAIN_REPORT": {
            "lat lon": lambda r: place_e7(r.estimate) if r.status.origin else (0, 0),
            "spacing": lambda r: 0 if r.status.origin else 100,
            "pending": 56,
        },
        "TERRAIN_REQUEST": {
            "lat lon": _terrain_wanted,
            "grid_spacing": 100,
            "mask": (1 << 56) - 1,
        },
        "RAW_IMU": _IMU,
        "SCALED_IMU": _IMU,
        "SCALED_IMU2": _IMU,
        "SCALED_IMU3": {"xmag ymag zmag": _FIELD_MGAUSS},
        "SCALED_PRESSURE": {
            "press_abs": _pressure_hpa,
            "press_diff": lambda r: _dynamic_pressure(r, 0.005) or 0.0,
            "temperature": 2540,
        },
        "SCALED_PRESSURE2": {
            "press_abs": lambda r: _pressure_hpa(r) - 0.012,
            "temperature": 2540,
        },
        # SITL's: sticks centred, throttle down
        "RC_CHANNELS": {
            "chancount": 8,
            "chan1_raw chan2_raw chan3_raw chan4_raw": (1500, 1500, 1000, 1500),
            "chan5_raw chan6_raw chan7_raw chan8_raw": (1800, 1000, 1000, 1800),
            "rssi": 255,
        },
        "SERVO_OUTPUT_RAW": {
            "time_usec": lambda r: r.time_us & 0xFFFFFFFF,
            "servo1_raw servo2_raw servo3_raw servo4_raw": _servos,
        },
        "POWER_STATUS": {"Vcc": 5000},
        "MEMINFO": {"freemem": 65535, "freemem32": 524288},
        "HWSTATUS": {"Vcc": 5000},
        "MCU_STATUS": {
            "MCU_temperature": 2500,
            "MCU_voltage MCU_voltage_min MCU_voltage_max": (3300, 3300, 3300),
        },
        "AHRS": {},
        "AHRS2": {
            "roll pitch yaw": attitude_rad,
            "altitude": lambda r: r.estimate.altitude_amsl_m,
            "lat lng": lambda r: place_e7(r.estimate),
        },
        # the truth: SITL says it too
        "SIMSTATE": {
            "roll pitch yaw": attitude_rad,
            "xacc yacc zacc": _specific_force,
            "lat lng": lambda r: place_e7(r.vehicle),
        },
        "VIBRATION": {"vibration_x vibration_y vibration_z": (0.02, 0.02, 0.02)},
        "AIRSPEED": {
            "airspeed": _indicated_m_s,
            "temperature": INT16,
            "raw_press": lambda r: _dynamic_pressure(r, 0.5),
            "flags": 2,
        },
        "AOA_SSA": {"time_usec": lambda r: r.time_us if is_plane(r) else None},
        "ESC_TELEMETRY_1_TO_4": {
            "temperature voltage current totalcurrent rpm count": lambda r: (
                None if r.time_us < _ESC_US else _motors(r)
            ),
        },
        "AVAILABLE_MODES": {
            "number_modes mode_index": (1, 1),
            "custom_mode": lambda r: r.status.mode,
        },
    }
)
"""What can be said, by message number; None while there is nothing to say."""
