"""An autopilot's report as MAVLink messages: a table of what fills each field.

Here is what every personality says in the same way; telemetry_ardupilot.py and telemetry_px4.py
add their own and replace what they say differently.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Estimate, Place, Report
from vehicle_sim.wire.dialect import Layout, Prepared, layout_named
from vehicle_sim.wire.frames import bounded, degrees_e7

INT16, INT32, UINT16 = 32767, 2_147_483_647, 65535
PLANE: Final = 1
"""MAV_TYPE_FIXED_WING."""
_IGNORE_POSITION, _IGNORE_VELOCITY, _IGNORE_ACCELERATION = 0x007, 0x038, 0x1C0
_IGNORE_YAW_RATE = 0x800
_ZERO = (0.0, 0.0, 0.0)

Builder = Callable[[Report], Prepared | None]
Value = int | float | bytes | Sequence[int | float]
_Take = Callable[[Report], Any]
Form = Mapping[str, Value | _Take]
"""How a message is filled: name of a field -> its value, or where to take it from.

A key may name several fields ("x y z"); then there are as many values.  What is not named is zero.
A field that is None: there is nothing to say now.
"""
Table = Mapping[str, Form]
"""By name of the message; time_boot_ms and time_usec need no mention: they are since boot."""


def builders(firmware: Table) -> dict[int, Builder]:
    """What makes the messages of COMMON and of this firmware, by message number.

    A message that is in both has the fields of both; where they name the same, the firmware's.
    """
    forms = {
        name: {**COMMON.get(name, {}), **firmware.get(name, {})} for name in {**COMMON, **firmware}
    }
    return {layout_named(name).number: _builder(layout_named(name), forms[name]) for name in forms}


def _builder(layout: Layout, form: Form) -> Builder:
    times: Form = {"time_boot_ms": boot_ms, "time_usec": time_us}
    form = {name: times[name] for name in times if name in layout.empty} | dict(form)
    constants, taken, names = dict(layout.empty), list[tuple[_Take, bool]](), list[str]()
    for key, value in form.items():
        fields = key.split()
        if callable(value):
            taken.append((value, len(fields) == 1))
            names += fields
        else:
            values: Any = [value] if len(fields) == 1 else value
            constants |= zip(fields, values, strict=True)
    given = list(constants.values())
    places = {name: place for place, name in enumerate([*constants, *names])}  # the later counts
    in_order = itemgetter(*(places[name] for name in layout.empty))

    def build(report: Report) -> Prepared | None:
        values = given.copy()
        for take, is_single in taken:
            value = take(report)
            if value is None:
                return None
            if is_single:
                values.append(value)
            else:
                values += value
        return Prepared(layout, layout.pack(in_order(values)))

    return build


# --- what fills the fields ------------------------------------------------------------------------


def is_plane(report: Report) -> bool:
    """A fixed wing."""
    return report.profile.vehicle_type == PLANE


def boot_ms(report: Report) -> int:
    """time_boot_ms."""
    return report.time_us // 1000 & 0xFFFFFFFF


def time_us(report: Report) -> int:
    """time_usec: since boot."""
    return report.time_us


def heading_cdeg(report: Report) -> int:
    """Where the nose points, 0 to 35999."""
    return round(math.degrees(report.vehicle.heading_rad) * 100.0) % 36000


def attitude_rad(report: Report) -> tuple[float, float, float]:
    """Roll, pitch, yaw."""
    vehicle = report.vehicle
    return vehicle.roll_rad, vehicle.pitch_rad, math.remainder(vehicle.heading_rad, math.tau)


def rates_rad_s(report: Report) -> tuple[float, float, float]:
    """Of roll, pitch and heading."""
    return report.autopilot.rates_rad_s


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
    return (
        estimate.velocity_north_m_s,
        estimate.velocity_east_m_s,
        -estimate.velocity_up_m_s,
    )


def ground_speed_m_s(report: Report) -> float:
    """The estimate's, horizontal."""
    return math.hypot(report.estimate.velocity_north_m_s, report.estimate.velocity_east_m_s)


def throttle(report: Report) -> float:
    """From 0 to 1."""
    return min(max(report.vehicle.throttle, 0.0), 1.0)


def per_cent_left(report: Report) -> float:
    """Of the battery's charge."""
    return min(max(report.battery.remaining, 0.0), 1.0) * 100.0


def place_e7(place: Any) -> tuple[int, int]:
    """Latitude and longitude of anything that has them."""
    return degrees_e7(place.latitude_deg), degrees_e7(place.longitude_deg)


def place_e7_mm(place: Place | Estimate | None) -> tuple[int, int, int] | None:
    """Latitude, longitude and height above the sea."""
    return (
        None if place is None else (*place_e7(place), bounded(place.altitude_amsl_m * 1e3, INT32))
    )


def _above_home_mm(report: Report) -> int:
    home = report.autopilot.home
    above_m = 0.0 if home is None else report.estimate.altitude_amsl_m - home.altitude_amsl_m
    return bounded(above_m * 1e3, INT32)


def _velocity_cm_s(report: Report) -> tuple[int, ...]:
    north, east, down = velocity_ned_m_s(report)
    return bounded(north * 100.0, INT16), bounded(east * 100.0, INT16), bounded(down * 100.0, INT16)


GPS_FIELDS: Final = "fix_type lat lon alt eph epv vel cog"


def gps_solution(report: Report) -> tuple[int, ...]:
    """GPS_FIELDS of GPS_RAW_INT."""
    fix = report.fix
    north, east = fix.velocity_north_m_s, fix.velocity_east_m_s
    return (
        fix.fix_type,
        *place_e7(fix),
        bounded(fix.altitude_amsl_m * 1e3, INT32),
        min(round(fix.horizontal_dilution * 100.0), UINT16),
        min(round(fix.vertical_dilution * 100.0), UINT16),
        bounded(math.hypot(north, east) * 100.0, UINT16 - 1),
        round(math.degrees(math.atan2(east, north)) * 100.0) % 36000,
    )


def _gps_accuracies_mm(report: Report) -> tuple[int, ...]:
    fix = report.fix
    all_m = (fix.horizontal_accuracy_m, fix.vertical_accuracy_m, fix.speed_accuracy_m_s)
    return tuple(bounded(each_m * 1e3, INT32) for each_m in all_m)


TARGET_FIELDS: Final = "type_mask x y z vx vy vz afx afy afz yaw yaw_rate"


def _target(report: Report) -> tuple[float, ...] | None:
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
    vectors = (*(position or _ZERO), *(velocity or _ZERO), *(acceleration or _ZERO))
    return (mask, *vectors, target.yaw_rad, target.yaw_rate_rad_s)


# --- the table ------------------------------------------------------------------------------------

COMMON: Final[Table] = {
    "ATTITUDE": {
        "roll pitch yaw": attitude_rad,
        "rollspeed pitchspeed yawspeed": rates_rad_s,
    },
    "ATTITUDE_QUATERNION": {
        "q1 q2 q3 q4": quaternion,
        "rollspeed pitchspeed yawspeed": rates_rad_s,
    },
    "GLOBAL_POSITION_INT": {
        "lat lon alt": lambda r: place_e7_mm(r.estimate),
        "relative_alt": _above_home_mm,
        "vx vy vz": _velocity_cm_s,
        "hdg": heading_cdeg,
    },
    "GPS_RAW_INT": {
        "time_usec": lambda r: r.fix.time_us,
        GPS_FIELDS: gps_solution,
        "satellites_visible": lambda r: min(r.fix.satellites, 255),
        "alt_ellipsoid": lambda r: bounded(r.fix.altitude_amsl_m * 1e3, INT32),
        "h_acc v_acc vel_acc": _gps_accuracies_mm,
    },
    "VFR_HUD": {
        "airspeed": lambda r: r.vehicle.airspeed_m_s,
        "groundspeed": ground_speed_m_s,
        "heading": lambda r: heading_cdeg(r) // 100,
        "throttle": lambda r: round(throttle(r) * 100.0),
        "alt": lambda r: r.estimate.altitude_amsl_m,
        "climb": lambda r: r.estimate.velocity_up_m_s,
    },
    "MISSION_CURRENT": {
        "seq total": lambda r: (r.status.mission_current, r.status.mission_total),
        "mission_state": lambda r: r.status.mission_state,
    },
    "HOME_POSITION": {"latitude longitude altitude": lambda r: place_e7_mm(r.autopilot.home)},
    "HEARTBEAT": {
        "type autopilot": lambda r: (r.profile.vehicle_type, r.profile.autopilot),
        "base_mode custom_mode": lambda r: (r.status.base_mode, r.status.mode),
        "system_status": lambda r: r.status.system_status,
        "mavlink_version": 3,
    },
    "SYSTEM_TIME": {"time_unix_usec": lambda r: r.unix_us},
    "LOCAL_POSITION_NED": {
        "x y z": lambda r: r.autopilot.local_ned_m(),
        "vx vy vz": velocity_ned_m_s,
    },
    "GPS_GLOBAL_ORIGIN": {"latitude longitude altitude": lambda r: place_e7_mm(r.status.origin)},
    "POSITION_TARGET_LOCAL_NED": {
        "coordinate_frame": mavlink.MAV_FRAME_LOCAL_NED,
        TARGET_FIELDS: _target,
    },
    "EXTENDED_SYS_STATE": {"landed_state": lambda r: r.status.landed_state},
}
