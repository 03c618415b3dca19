"""An autopilot's report as MAVLink messages: a function each, which has the name of its message.

Here is what every personality says in the same way; telemetry_ardupilot.py and telemetry_px4.py
have the rest.  What a function does not fill is zero: nobody reads it.  None: there is nothing to
say now.
"""

import math
from collections.abc import Callable
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Estimate, Place, Report
from vehicle_sim.wire.frames import Prepared, layout_of, make

INT16, INT32, UINT16 = 32767, 2_147_483_647, 65535
PLANE: Final = 1
"""MAV_TYPE_FIXED_WING."""
NAN: Final = math.nan
_IGNORE_POSITION, _IGNORE_VELOCITY, _IGNORE_ACCELERATION = 0x007, 0x038, 0x1C0
_IGNORE_YAW_RATE = 0x800
_ZERO = (0.0, 0.0, 0.0)

Builder = Callable[[Report], Prepared | None]


def by_number(*builders: Builder) -> dict[int, Builder]:
    """Those of all firmwares and these, by message number; a later one of the same name counts."""
    every = {each.__name__.strip("_").upper(): each for each in (*_COMMON, *builders)}
    return {layout_of(name).number: builder for name, builder in every.items()}


# --- numbers --------------------------------------------------------------------------------------


def bounded(value: float, most: int) -> int:
    """The nearest whole number within +-most: what an integer field can carry."""
    if -most <= value <= most:
        return round(value)
    return (most if value > 0.0 else -most) if math.isfinite(value) else 0


def place_e7(place: Any) -> tuple[int, int]:
    """Latitude and longitude of anything that has them, in 1e-7 degrees."""
    return bounded(place.latitude_deg * 1e7, INT32), bounded(place.longitude_deg * 1e7, INT32)


def place_e7_mm(place: Place | Estimate) -> tuple[int, int, int]:
    """Latitude, longitude and height above the sea."""
    return *place_e7(place), bounded(place.altitude_amsl_m * 1e3, INT32)


def is_plane(report: Report) -> bool:
    """A fixed wing."""
    return report.profile.vehicle_type == PLANE


def boot_ms(report: Report) -> int:
    """time_boot_ms."""
    return report.time_us // 1000 & 0xFFFFFFFF


def heading_cdeg(report: Report) -> int:
    """Where the nose points, 0 to 35999."""
    return round(math.degrees(report.vehicle.heading_rad) * 100.0) % 36000


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


def velocity_ned_m_s(report: Report) -> tuple[float, float, float]:
    """The estimate's."""
    estimate = report.estimate
    return (estimate.velocity_north_m_s, estimate.velocity_east_m_s, -estimate.velocity_up_m_s)


def per_cent_left(report: Report) -> float:
    """Of the battery's charge."""
    return min(max(report.battery.remaining, 0.0), 1.0) * 100.0


# --- the same of everybody ------------------------------------------------------------------------


def _heartbeat(report: Report) -> Prepared:
    profile, status = report.profile, report.status
    modes = (status.base_mode, status.mode, status.system_status)
    return make("HEARTBEAT", profile.vehicle_type, profile.autopilot, *modes, 3)


def _system_time(report: Report) -> Prepared:
    return make("SYSTEM_TIME", report.unix_us, boot_ms(report))


def _attitude(report: Report) -> Prepared:
    vehicle = report.vehicle
    yaw_rad = math.remainder(vehicle.heading_rad, math.tau)
    angles_rad = (vehicle.roll_rad, vehicle.pitch_rad, yaw_rad)
    return make("ATTITUDE", boot_ms(report), *angles_rad, *report.autopilot.rates_rad_s)


def _attitude_quaternion(report: Report) -> Prepared:
    rates_rad_s = report.autopilot.rates_rad_s
    return make("ATTITUDE_QUATERNION", boot_ms(report), *quaternion(report), *rates_rad_s)


def _local_position_ned(report: Report) -> Prepared | None:
    here_m = report.autopilot.local_ned_m()
    if here_m is None:
        return None
    return make("LOCAL_POSITION_NED", boot_ms(report), *here_m, *velocity_ned_m_s(report))


def _gps_global_origin(report: Report) -> Prepared | None:
    origin = report.status.origin
    return origin and make("GPS_GLOBAL_ORIGIN", *place_e7_mm(origin), report.time_us)


def _position_target_local_ned(report: Report) -> Prepared | None:
    target = report.autopilot.target_echo()
    if target is None:
        return None
    position, velocity, acceleration = target[:3]
    mask = target.type_mask
    if mask is None:
        mask = _IGNORE_YAW_RATE
        mask |= 0 if position else _IGNORE_POSITION
        mask |= 0 if velocity else _IGNORE_VELOCITY
        mask |= 0 if acceleration else _IGNORE_ACCELERATION
    return make(
        "POSITION_TARGET_LOCAL_NED",
        *(boot_ms(report), mavlink.MAV_FRAME_LOCAL_NED, mask),
        *(*(position or _ZERO), *(velocity or _ZERO), *(acceleration or _ZERO)),
        *(target.yaw_rad, target.yaw_rate_rad_s),
    )


_COMMON: Final[tuple[Builder, ...]] = (
    *(_heartbeat, _system_time, _attitude, _attitude_quaternion, _local_position_ned),
    *(_gps_global_origin, _position_target_local_ned),
)


# --- alike but for what is given ------------------------------------------------------------------


def global_position(report: Report, altitude_amsl_m: float) -> Prepared:
    """GLOBAL_POSITION_INT."""
    home, amsl_m = report.autopilot.home, report.estimate.altitude_amsl_m
    above_home_m = 0.0 if home is None else amsl_m - home.altitude_amsl_m
    return make(
        "GLOBAL_POSITION_INT",
        *(boot_ms(report), *place_e7(report.estimate)),
        *(bounded(altitude_amsl_m * 1e3, INT32), bounded(above_home_m * 1e3, INT32)),
        *(bounded(speed_m_s * 100.0, INT16) for speed_m_s in velocity_ned_m_s(report)),
        heading_cdeg(report),
    )


def gps_raw(report: Report, *, known: bool = True) -> Prepared:
    """GPS_RAW_INT; without a solution to tell, of one that is not known."""
    fix = report.fix
    north, east = fix.velocity_north_m_s, fix.velocity_east_m_s
    solution = (
        *(fix.fix_type, *place_e7(fix), bounded(fix.altitude_amsl_m * 1e3, INT32)),
        min(round(fix.horizontal_dilution * 100.0), UINT16),
        min(round(fix.vertical_dilution * 100.0), UINT16),
        bounded(math.hypot(north, east) * 100.0, UINT16 - 1),
        round(math.degrees(math.atan2(east, north)) * 100.0) % 36000,
    )
    all_m = (fix.altitude_amsl_m, fix.horizontal_accuracy_m, fix.vertical_accuracy_m)
    return make(
        "GPS_RAW_INT",
        fix.time_us,
        *(solution if known else (0, 0, 0, 0, UINT16, UINT16, 0, 0)),
        min(fix.satellites, 255),
        *(bounded(each * 1e3, INT32) for each in (*all_m, fix.speed_accuracy_m_s)),
    )


def vfr_hud(report: Report, airspeed_m_s: float, altitude_m: float) -> Prepared:
    """VFR_HUD."""
    estimate = report.estimate
    return make(
        "VFR_HUD",
        airspeed_m_s,
        math.hypot(estimate.velocity_north_m_s, estimate.velocity_east_m_s),
        heading_cdeg(report) // 100,
        round(min(max(report.vehicle.throttle, 0.0), 1.0) * 100.0),
        altitude_m,
        estimate.velocity_up_m_s,
    )


def mission_current(report: Report, mode: int = 0) -> Prepared:
    """MISSION_CURRENT."""
    status = report.status
    numbers = (status.mission_current, status.mission_total, status.mission_state)
    return make("MISSION_CURRENT", *numbers, mode)


def home_position(report: Report, ned_m: tuple[float, ...], q: list[float]) -> Prepared | None:
    """HOME_POSITION; of a surface whose attitude is this quaternion."""
    home = report.autopilot.home
    time_us = report.time_us
    return home and make("HOME_POSITION", *place_e7_mm(home), *ned_m, q, time_usec=time_us)
