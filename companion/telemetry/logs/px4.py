"""PX4's .ulg: its topics as the MAVLink messages that it would have sent with them.

What each message is made of: docs/reference/log-messages.md. The log is looked through once
beforehand: whose it is, when it was, and what it has.
"""

import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, final

from pyproj import Proj
from pyulog import ULog

from companion.mavlink.autopilots.px4 import EARTH_M
from companion.mavlink.dialect import Message, wire
from companion.mavlink.parameter_client import encoded
from companion.telemetry.logs import ulog
from companion.telemetry.logs.anomalies import AnomalyCounter
from companion.telemetry.logs.timeline import YEAR_2000_US, YEAR_2100_US, earliest
from companion.telemetry.logs.translated import (
    LONGEST_US,
    NumberedMessages,
    RateLimiter,
    Row,
    Source,
    battery,
    boot_ms,
    refuse_older,
    system_time,
    whole,
)

_OLDEST: Final = (1, 13)
_SAMPLE: Final = 200
_SECOND_US: Final = 1_000_000
_FAST_US: Final = 19_000
_HALF_SECOND_US: Final = 490_000
_ARMED: Final = 2
"""vehicle_status.arming_state."""
_TERMINATION, _TAKEOFF, _LAND, _VTOL_TAKEOFF = 13, 17, 18, 22
_MODES: Final = {
    0: (1, 0),
    1: (2, 0),
    2: (3, 0),
    3: (4, 4),
    4: (4, 3),
    5: (4, 5),
    6: (3, 2),
    8: (11, 0),
    10: (5, 0),
    12: (4, 6),
    13: (10, 0),
    14: (6, 0),
    15: (7, 0),
    16: (8, 0),
    17: (4, 2),
    18: (4, 6),
    19: (4, 8),
    20: (4, 9),
    21: (3, 1),
    22: (4, 10),
    **{23 + k: (4, 11 + k) for k in range(8)},
}
"""nav_state -> main and sub mode of custom_mode; the failsafe DESCEND is told as LAND."""
_MODE_FLAGS: Final = wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_NO_DIRECTION: Final = 65535
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")


# --- the first look


def look(path: Path) -> Source | None:
    """Read a log; None: it cannot be read.  InputError: of a later format, or before 1.13."""
    log = ulog.read(path, TOPICS)
    if log is None:
        return None
    release = log.msg_info_dict.get("ver_sw_release")
    if isinstance(release, int) and release >= 1 << 24:  # else built from no release
        refuse_older(path, "PX4", (release >> 24, release >> 16 & 0xFF), _OLDEST)
    counts = Counter(row.name for row in ulog.rows(log, AnomalyCounter()))
    stamps = (row.time_us for row in ulog.rows(log, AnomalyCounter()) if row.time_us is not None)
    times_us = list(itertools.islice(stamps, _SAMPLE))
    begun_us = log.start_timestamp
    sane = bool(times_us) and 0 <= times_us[len(times_us) // 2] - begun_us < LONGEST_US
    fallback_us = earliest(times_us) if times_us else 0
    start_us = begun_us if sane else fallback_us
    # what the vehicle's clock says at the time that is taken for its boot
    zero_us = start_us if start_us >= YEAR_2000_US else 0
    epoch_us = _epoch_us(log) or zero_us or None

    def rows(findings: AnomalyCounter) -> Iterator[Row]:
        """What was published before the log began is told at its beginning."""
        for row in ulog.rows(log, findings):
            if row.time_us is None or not (zero_us or row.time_us < start_us):
                yield row
            else:
                early = row.time_us < start_us
                yield row._replace(time_us=None if early else row.time_us - zero_us)

    return Source(
        kind="ulg",
        autopilot=int(wire.MAV_AUTOPILOT_PX4),
        system_id=_system_id(log),
        entries=counts.total(),
        epoch_us=epoch_us,
        start_us=start_us - zero_us,
        substitutes=tuple(_substitutes(counts, has_date=bool(zero_us))),
        rows=rows,
        translator=lambda: _Rows(counts, len(ulog.parameters(log)), epoch_us).on_row,
    )


def _epoch_us(log: ULog) -> int | None:
    """When the vehicle booted, microseconds since 1970: by its GPS, or else by its own clock."""
    dates = [
        int(date_us) - int(time_us)
        for each in ulog.first_instances(log)
        if each.name == "sensor_gps" and "time_utc_usec" in each.data
        for date_us, time_us in zip(each.data["time_utc_usec"], each.data["timestamp"], strict=True)
    ]
    dates.append(log.msg_info_dict.get("boot_time_utc_us", 0))
    return next((date for date in dates if YEAR_2000_US <= date < YEAR_2100_US), None)


def _system_id(log: ULog) -> int:
    """PX4's default, unless the log says otherwise."""
    said = ulog.parameters(log).get("MAV_SYS_ID", 1)
    return int(said) if 1 <= said <= 255 else 1


def _substitutes(counts: Counter[str], *, has_date: bool) -> Iterator[str]:
    if has_date:
        yield "the vehicle's clock is a date: its boot is taken to be the log's beginning"
    if counts["vehicle_local_position"]:
        if not counts["vehicle_global_position"]:
            yield "positions are those of vehicle_local_position, about its origin"
        if not counts["estimator_status"]:
            yield (
                "ESTIMATOR_STATUS is made of vehicle_local_position and "
                "estimator_status_flags: there is no estimator_status"
            )


# --- what it says


@final
class _Rows:
    """Translates the entries of one pass; see `translated.OnRow`."""

    def __init__(self, counts: Counter[str], parameters: int, epoch_us: int | None) -> None:
        """counts: of the rows, by name; parameters: how many there are."""
        self._counts, self._epoch_us = counts, epoch_us
        self._pace = RateLimiter()
        self._status: Mapping[str, Any] = {}
        self._landed: bool | None = None
        self._local: Mapping[str, Any] = {}
        self._home_alt_m: float | None = None
        self._origin: tuple[float, float, float] | None = None
        self._projection: Proj | None = None
        self._flags: Mapping[str, Any] = {}
        self._rates = (math.nan, math.nan, math.nan)
        self._told = NumberedMessages(parameters)

    def on_row(self, row: Row, boot_us: int) -> Iterator[Message]:
        """Messages of one entry."""
        yield from _HANDLERS[row.name](self, row.values, boot_us)
        if self._status and self._pace.is_due("heartbeat", boot_us, _SECOND_US):
            yield from self._heartbeat()
            yield from self._ground()
            yield system_time(self._epoch_us, boot_us)

    # --- its state

    def _on_status(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        seen = ("nav_state", "arming_state", "failsafe")
        changed = any(values.get(each) != self._status.get(each) for each in seen)
        self._status = values
        if values["nav_state"] not in _MODES:
            raise ValueError("no such nav_state")
        return [*self._heartbeat(), *self._ground()] if changed else []

    def _heartbeat(self) -> Iterator[Message]:
        values = self._status
        if values["nav_state"] not in _MODES:
            return
        armed = values["arming_state"] == _ARMED
        main, sub = _MODES[values["nav_state"]]
        state = wire.MAV_STATE_STANDBY
        if values["nav_state"] == _TERMINATION:
            state = wire.MAV_STATE_FLIGHT_TERMINATION
        elif armed:
            state = wire.MAV_STATE_CRITICAL if values.get("failsafe") else wire.MAV_STATE_ACTIVE
        yield wire.MAVLink_heartbeat_message(
            _mav_type(values),
            wire.MAV_AUTOPILOT_PX4,
            _MODE_FLAGS | (wire.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0),
            main << 16 | sub << 24,
            state,
            3,
        )

    def _on_landed(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        before, self._landed = self._landed, bool(values["landed"])
        return self._ground() if before != self._landed else []

    def _ground(self) -> Iterator[Message]:
        if self._landed is None:
            return
        landed = wire.MAV_LANDED_STATE_IN_AIR
        mode = self._status.get("nav_state")
        if self._landed:
            landed = wire.MAV_LANDED_STATE_ON_GROUND
        elif mode in (_TAKEOFF, _VTOL_TAKEOFF):
            landed = wire.MAV_LANDED_STATE_TAKEOFF
        elif mode == _LAND:
            landed = wire.MAV_LANDED_STATE_LANDING
        vtol = wire.MAV_VTOL_STATE_UNDEFINED
        yield wire.MAVLink_extended_sys_state_message(vtol, landed)

    # --- where it is

    def _on_local(self, values: Mapping[str, Any], boot_us: int) -> Iterator[Message]:
        self._local = values
        yield from self._origin_of(values, boot_us)
        if self._pace.is_due("LOCAL_POSITION_NED", boot_us, _FAST_US):
            place = [values[each] for each in ("x", "y", "z", "vx", "vy", "vz")]
            yield wire.MAVLink_local_position_ned_message(boot_ms(boot_us), *place)
        if not self._counts["vehicle_global_position"] and self._projection is not None:
            yield from self._unprojected(values, boot_us)
        if not self._counts["estimator_status"]:
            yield from self._made_estimator(values, boot_us)

    def _origin_of(self, values: Mapping[str, Any], boot_us: int) -> Iterator[Message]:
        """GPS_GLOBAL_ORIGIN, whenever there is another."""
        if not (values["xy_global"] and values["z_global"]):
            return
        origin = (values["ref_lat"], values["ref_lon"], values["ref_alt"])
        if origin == self._origin or not all(map(math.isfinite, origin)):
            return
        latitude, longitude, altitude_m = origin
        place = (round(latitude * 1e7), round(longitude * 1e7), round(altitude_m * 1e3))
        if abs(latitude) > 90.0 or abs(longitude) > 180.0:
            raise ValueError("no such place")
        self._projection = Proj(proj="aeqd", lat_0=latitude, lon_0=longitude, R=EARTH_M)
        self._origin = origin
        yield wire.MAVLink_gps_global_origin_message(*place, boot_us)

    def _unprojected(self, values: Mapping[str, Any], boot_us: int) -> Iterable[Message]:
        assert self._projection is not None
        if not values["xy_global"] or not self._pace.is_due("position", boot_us, _FAST_US):
            return ()
        longitude, latitude = self._projection(values["y"], values["x"], inverse=True)
        return self._position((latitude, longitude), values["ref_alt"] - values["z"], boot_us)

    def _on_global(self, values: Mapping[str, Any], boot_us: int) -> Iterable[Message]:
        local = self._local
        if not local or not self._pace.is_due("position", boot_us, _FAST_US):
            return ()
        altitude_m = values["alt"]
        if local["z_valid"] and local["z_global"]:
            altitude_m = local["ref_alt"] - local["z"]
        return self._position((values["lat"], values["lon"]), altitude_m, boot_us)

    def _position(
        self, place_deg: tuple[float, float], altitude_m: float, boot_us: int
    ) -> Iterator[Message]:
        local = self._local
        above_m = 0.0 if self._home_alt_m is None else altitude_m - self._home_alt_m
        heading_rad = local["heading"]
        yield wire.MAVLink_global_position_int_message(
            boot_ms(boot_us),
            round(place_deg[0] * 1e7),
            round(place_deg[1] * 1e7),
            round(altitude_m * 1e3),
            round(above_m * 1e3),
            *(round(local[each] * 100) for each in ("vx", "vy", "vz")),
            _direction(heading_rad),
        )

    def _on_home(self, values: Mapping[str, Any], boot_us: int) -> Iterator[Message]:
        if not values.get("valid_hpos", True):
            return
        self._home_alt_m = values["alt"] if values.get("valid_alt", True) else None
        if not self._pace.is_due("HOME_POSITION", boot_us, _HALF_SECOND_US):
            return
        half = 0.5 * values.get("yaw", 0.0)
        q = [math.cos(half), 0.0, 0.0, math.sin(half)]
        yield wire.MAVLink_home_position_message(
            round(values["lat"] * 1e7),
            round(values["lon"] * 1e7),
            round(values["alt"] * 1e3),
            *(values[each] for each in ("x", "y", "z")),
            q,
            *(0.0, 0.0, 0.0),
            boot_us,
        )

    def _on_attitude(self, values: Mapping[str, Any], boot_us: int) -> Iterator[Message]:
        if not self._pace.is_due("ATTITUDE", boot_us, _FAST_US):
            return
        w, x, y, z = values["q"]
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        yield wire.MAVLink_attitude_message(boot_ms(boot_us), roll, pitch, yaw, *self._rates)

    def _on_rates(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        self._rates = values["xyz"]
        return ()

    def _on_setpoint(self, values: Mapping[str, Any], boot_us: int) -> Iterator[Message]:
        if not self._pace.is_due("POSITION_TARGET_LOCAL_NED", boot_us, _FAST_US):
            return
        numbers = [values[each] for each in ("x", "y", "z", "vx", "vy", "vz")]
        numbers += values["acceleration"]
        ignored = sum(1 << bit for bit, each in enumerate(numbers) if not math.isfinite(each))
        yield wire.MAVLink_position_target_local_ned_message(
            boot_ms(boot_us),
            wire.MAV_FRAME_LOCAL_NED,
            ignored,
            *numbers,
            values["yaw"],
            values["yawspeed"],
        )

    # --- how well it knows

    def _on_gps(self, values: Mapping[str, Any], boot_us: int) -> Iterator[Message]:
        if "latitude_deg" in values:
            place = (values["latitude_deg"] * 1e7, values["longitude_deg"] * 1e7)
            altitude = (values["altitude_msl_m"] * 1e3, values["altitude_ellipsoid_m"] * 1e3)
        else:  # before 1.14
            place = (values["lat"], values["lon"])
            altitude = (values["alt"], values["alt_ellipsoid"])
        yield wire.MAVLink_gps_raw_int_message(
            boot_us,
            values["fix_type"],
            *(round(each) for each in place),
            round(altitude[0]),
            whole(values["hdop"] * 100, 0, 65535),
            whole(values["vdop"] * 100, 0, 65535),
            whole(values["vel_m_s"] * 100, 0, 65535),
            _direction(values["cog_rad"]),
            values["satellites_used"],
            alt_ellipsoid=round(altitude[1]),
            h_acc=whole(values["eph"] * 1e3, 0, 0xFFFFFFFF),
            v_acc=whole(values["epv"] * 1e3, 0, 0xFFFFFFFF),
            vel_acc=whole(values["s_variance_m_s"] * 1e3, 0, 0xFFFFFFFF),
        )

    def _on_estimator(self, values: Mapping[str, Any], boot_us: int) -> Iterator[Message]:
        if not self._pace.is_due("ESTIMATOR_STATUS", boot_us, _HALF_SECOND_US // 5):
            return
        ratios = ("vel", "pos", "hgt", "mag", "hagl", "tas")
        yield wire.MAVLink_estimator_status_message(
            boot_us,
            values["solution_status_flags"],
            *(values.get(f"{each}_test_ratio", math.nan) for each in ratios),
            values["pos_horiz_accuracy"],
            values["pos_vert_accuracy"],
        )

    def _on_flags(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        self._flags = values
        return ()

    def _made_estimator(self, values: Mapping[str, Any], boot_us: int) -> Iterator[Message]:
        """ESTIMATOR_STATUS of what vehicle_local_position calls valid, and rejections."""
        flags = self._flags
        if not flags or not self._pace.is_due("ESTIMATOR_STATUS", boot_us, _HALF_SECOND_US // 5):
            return
        horizontal, placed = bool(values["v_xy_valid"]), bool(values["xy_valid"])
        absolute = placed and bool(values["xy_global"])
        said = (
            (wire.ESTIMATOR_ATTITUDE, flags["cs_tilt_align"]),
            (wire.ESTIMATOR_VELOCITY_HORIZ, horizontal),
            (wire.ESTIMATOR_VELOCITY_VERT, values["v_z_valid"]),
            (wire.ESTIMATOR_POS_HORIZ_REL, placed),
            (wire.ESTIMATOR_POS_HORIZ_ABS, absolute),
            (wire.ESTIMATOR_POS_VERT_ABS, values["z_valid"]),
            (wire.ESTIMATOR_POS_VERT_AGL, values["dist_bottom_valid"]),
            (wire.ESTIMATOR_CONST_POS_MODE, not horizontal),
            (wire.ESTIMATOR_PRED_POS_HORIZ_REL, placed),
            (wire.ESTIMATOR_PRED_POS_HORIZ_ABS, absolute),
            (wire.ESTIMATOR_ACCEL_ERROR, flags["fs_bad_acc_vertical"]),
        )
        rejected = [
            1.0 if flags.get(f"reject_{each}") else math.nan
            for each in ("hor_vel", "hor_pos", "ver_pos")
        ]
        yield wire.MAVLink_estimator_status_message(
            boot_us,
            sum(flag for flag, holds in said if holds),
            *rejected,
            *(math.nan, math.nan, math.nan),
            values["eph"],
            values["epv"],
        )

    # --- the rest

    def _on_battery(self, values: Mapping[str, Any], boot_us: int) -> Iterable[Message]:
        if not self._pace.is_due("battery", boot_us, _HALF_SECOND_US):
            return ()
        percent = -1
        if values.get("connected", True) and 0.0 <= values["remaining"] <= 1.0:
            percent = math.ceil(values["remaining"] * 100)
        current, used = values["current_a"], values["discharged_mah"]
        centi_a = whole(current * 100, -1, 32767) if current >= 0.0 else -1
        used_mah = whole(used, 0, 1 << 30) if used >= 0.0 else -1
        return battery(values["voltage_v"], centi_a, used_mah, percent)

    def _on_acknowledged(self, values: Mapping[str, Any], _: int) -> Iterator[Message]:
        yield wire.MAVLink_command_ack_message(
            values["command"], values["result"], target_system=values["target_system"]
        )

    def _on_parameter(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        name, value = values["key"], values["value"]
        kind = wire.MAV_PARAM_TYPE_REAL32
        if isinstance(value, int):
            kind = wire.MAV_PARAM_TYPE_INT32
            value = encoded(value, kind, bytewise=True)
        return self._told.parameter(name, value, kind)

    def _on_text(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        severity = min(max(values["level"] - ord("0"), 0), wire.MAV_SEVERITY_DEBUG)
        return self._told.text(_COLOURS.sub("", values["text"]), severity)


def _direction(angle_rad: float) -> int:
    """In hundredths of a degree; receivers that stand still may have none."""
    finite = math.isfinite(angle_rad)
    return round(math.degrees(angle_rad) * 100) % 36000 if finite else _NO_DIRECTION


def _mav_type(status: Mapping[str, Any]) -> int:
    """MAV_TYPE of a vehicle_status."""
    if status.get("system_type"):
        return int(status["system_type"])
    if status.get("is_vtol"):
        return int(wire.MAV_TYPE_VTOL_RESERVED5)
    if status.get("vehicle_type") == 1:
        return int(wire.MAV_TYPE_QUADROTOR)
    return int(wire.MAV_TYPE_FIXED_WING)


_HANDLERS: Final[Mapping[str, Callable[[_Rows, Mapping[str, Any], int], Iterable[Message]]]] = {
    ulog.PARAMETER: _Rows._on_parameter,
    ulog.TEXT: _Rows._on_text,
    "battery_status": _Rows._on_battery,
    "estimator_status": _Rows._on_estimator,
    "estimator_status_flags": _Rows._on_flags,
    "home_position": _Rows._on_home,
    "sensor_gps": _Rows._on_gps,
    "vehicle_angular_velocity": _Rows._on_rates,
    "vehicle_attitude": _Rows._on_attitude,
    "vehicle_command_ack": _Rows._on_acknowledged,
    "vehicle_global_position": _Rows._on_global,
    "vehicle_land_detected": _Rows._on_landed,
    "vehicle_local_position": _Rows._on_local,
    "vehicle_local_position_setpoint": _Rows._on_setpoint,
    "vehicle_status": _Rows._on_status,
}
TOPICS: Final = frozenset(_HANDLERS)
