"""PX4's .ulg, as pyulog reads it, told as MAVLink; the topics that are wanted are in memory."""

import heapq
import itertools
import math
import re
from collections.abc import Iterator
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from pyulog import ULog, core
from pyulog.exceptions import ULogIncompatibleFlagException

from companion.errors import InputError
from companion.mavlink.dialect import Message, wire
from companion.mavlink.parameter_client import encoded
from companion.telemetry.logs import made
from companion.telemetry.logs.log import YEAR_2000_US, YEAR_2100_US, Log, Odd, Record, earliest
from companion.telemetry.logs.made import Row, Values, direction, whole, wired

TOPICS: Final = (
    *("battery_status", "estimator_status", "estimator_status_flags", "home_position"),
    *("sensor_gps", "vehicle_global_position", "vehicle_land_detected", "vehicle_local_position"),
    "vehicle_status",
)
"""Names of what is translated, beside parameters and texts."""
_OLDEST: Final = (1, 13)
_SAMPLE: Final = 200
"""Rows that tell when the log begins."""
_CHUNK: Final = 4096
"""Messages of a topic that are made rows at a time."""
_SHOWN: Final = ("nav_state", "arming_state", "failsafe")
"""Of vehicle_status, what a HEARTBEAT shows."""
_ARMED: Final = 2
"""vehicle_status.arming_state."""
_TERMINATION, _TAKEOFF, _LAND, _VTOL_TAKEOFF = 13, 17, 18, 22
_AUTO = {3: 4, 4: 3, 5: 5, 12: 6, 17: 2, 18: 6, 19: 8, 20: 9}
_AUTO |= {22 + k: 10 + k for k in range(9)}
"""nav_state -> sub mode, of main mode 4; the failsafe DESCEND (12) is told as LAND."""
_OTHERS: Final = {0: 1, 1: 2, 2: 3, 8: 11, 10: 5, 13: 10, 14: 6, 15: 7, 16: 8}
_MODES: Final = {
    **{state: (4, sub) for state, sub in _AUTO.items()},
    **{state: (main, 0) for state, main in _OTHERS.items()},
    6: (3, 2),
    21: (3, 1),
}
"""nav_state -> main and sub mode of custom_mode."""
_LEAVING: Final = {
    _TAKEOFF: wire.MAV_LANDED_STATE_TAKEOFF,
    _VTOL_TAKEOFF: wire.MAV_LANDED_STATE_TAKEOFF,
    _LAND: wire.MAV_LANDED_STATE_LANDING,
}
"""nav_state -> MAV_LANDED_STATE, off the ground; else in the air."""
_HOME_EVERY_US: Final = 490_000
"""PX4 publishes its home all the time."""
_PLACE: Final = ("latitude_deg", "longitude_deg", "altitude_msl_m")
_MOST: Final = 0xFFFFFFFF
"""Of what GPS_RAW_INT says of accuracies, mm and mm/s."""
_TIME: Final = attrgetter("time_us")
_COLOURS: Final = re.compile(r"\x1b\[[0-9;]*m")


# --- rows


def _read(path: Path) -> ULog | None:
    """A log; None: it cannot be read.  InputError if it is of a later format."""
    with path.open("rb") as file:  # pyulog would not close it when it fails
        try:
            with made.silent(core):
                return ULog(file, TOPICS)
        except ULogIncompatibleFlagException as error:
            rule = "its flags say that it must not be read by who does not know them"
            remedy = "Convert it to the present ULog format."
            raise InputError("log", str(path), rule, remedy) from error
        except Exception:  # noqa: BLE001 - whatever damage brings it to raise
            return None


def _topics(log: ULog) -> dict[str, ULog.Data]:
    """The data of its topics by name, of each the first instance.

    In reverse order: what is known of a moment is the vehicle's status first, then its local
    position, then the global one that is made of it.
    """
    topics = {
        topic.name: topic
        for topic in log.data_list
        if topic.multi_id == 0 and topic.data.get("timestamp", np.zeros(0)).dtype.kind == "u"
    }
    return {name: topics[name] for name in sorted(topics, reverse=True)}


def _rows(log: ULog) -> Iterator[Row]:
    """Parameters, texts and data, by time."""
    texts = (*log.logged_messages, *itertools.chain(*log.logged_messages_tagged.values()))
    rows = [
        Row("text", text.timestamp, {"level": text.log_level, "text": text.message})
        for text in texts
    ]
    for time_us, key, value in log.changed_parameters:
        rows.append(Row("parameter", time_us, {"key": key, "value": value}))
    rows.sort(key=_TIME)
    for key, value in log.initial_parameters.items():
        yield Row("parameter", None, {"key": key, "value": value})
    yield from heapq.merge(rows, *map(_data, _topics(log).values()), key=_TIME)


def _data(topic: ULog.Data) -> Iterator[Row]:
    """The messages of a topic by time."""
    order = np.argsort(topic.data["timestamp"], kind="stable")
    for some in np.split(order, range(_CHUNK, len(order), _CHUNK)):
        columns = [column[some].tolist() for column in topic.data.values()]
        for row in zip(*columns, strict=True):
            values = dict(zip(topic.data, row, strict=True))
            yield Row(topic.name, values["timestamp"], values)


# --- the log as a whole


def opened(path: Path) -> Log | None:
    """A .ulg; None: nothing in it can be read.

    InputError: it is of a later format, or of firmware before 1.13.
    """
    log = _read(path)
    if log is None:
        return None
    release = log.msg_info_dict.get("ver_sw_release")
    if isinstance(release, int) and release >= 1 << 24:  # else built from no release
        made.refuse_older(path, "PX4", (release >> 24, release >> 16 & 0xFF), _OLDEST)
    stamps = (row.time_us for row in _rows(log) if row.time_us is not None)
    known_us = list(itertools.islice(stamps, _SAMPLE))
    if not known_us and not log.initial_parameters:
        return None
    start_us, begun_us = earliest(known_us), log.start_timestamp
    if known_us and 0 <= known_us[len(known_us) // 2] - begun_us < made.LONGEST_US:
        start_us = begun_us
    changed = {name: value for _, name, value in log.changed_parameters}
    system = (log.initial_parameters | changed).get("MAV_SYS_ID", 1)
    is_one = isinstance(system, int) and 1 <= system <= 255
    autopilots = {system if is_one else 1: int(wire.MAV_AUTOPILOT_PX4)}
    return Log(kind="ulg", path=path, autopilots=autopilots, read=partial(_records, log, start_us))


def _records(ulog: ULog, start_us: int, log: Log) -> Iterator[Record]:
    """What it says.

    start_us: when the log begins, by the vehicle's clock; if that is a date, it is taken for the
    vehicle's boot.  What was published before the log began is told at its beginning.
    """
    zero_us = start_us if start_us >= YEAR_2000_US else 0
    topics = _topics(ulog)
    has_estimator = "estimator_status" in topics
    log.odd[Odd.CORRUPT] = int(ulog.file_corruption)
    log.odd[Odd.LOST_TIME] = sum(lost.duration for lost in ulog.dropouts)
    log.odd[Odd.CLOCK_IS_DATE] = int(zero_us > 0)
    log.odd[Odd.MADE_ESTIMATOR] = int("vehicle_local_position" in topics and not has_estimator)
    epoch_us = _epoch_us(ulog, topics.get("sensor_gps")) or zero_us or None

    def since_boot_us(time_us: int | None) -> int | None:
        return None if time_us is None or time_us < start_us else time_us - zero_us

    rows = (row._replace(time_us=since_boot_us(row.time_us)) for row in _rows(ulog))
    vehicle = _Vehicle(epoch_us, has_estimator=has_estimator)
    return made.made(log, rows, vehicle, start_us - zero_us)


def _epoch_us(log: ULog, fixes: ULog.Data | None) -> int | None:
    """When the vehicle booted, microseconds since 1970: by its GPS, or else by its own clock."""
    dates = [log.msg_info_dict.get("boot_time_utc_us", 0)]
    if fixes is not None and "time_utc_usec" in fixes.data:
        utc_us, time_us = (fixes.data[field].tolist() for field in ("time_utc_usec", "timestamp"))
        dates[:0] = [date - at for date, at in zip(utc_us, time_us, strict=True)]
    return next((date for date in dates if YEAR_2000_US <= date < YEAR_2100_US), None)


@final
class _Vehicle:
    """The vehicle in one pass, from first to last."""

    def __init__(self, epoch_us: int | None, *, has_estimator: bool) -> None:
        self.epoch_us, self._has_estimator = epoch_us, has_estimator
        self._status: Values = {}
        self._landed: bool | None = None
        self._local: Values = {}
        self._home_alt_m: float | None = None
        self._home_us = -_HOME_EVERY_US
        self._origin: tuple[float, float, float] | None = None
        self._flags: Values = {}
        self._texts = 0

    def messages(self, row: Row, boot_us: int) -> Iterator[Message]:
        """What it would have sent of a row."""
        values = row.values
        match row.name:
            case "vehicle_status":
                self._status = values
                if values["nav_state"] not in _MODES:
                    raise ValueError("no such nav_state")
            case "vehicle_land_detected":
                self._landed = bool(values["landed"])
            case "vehicle_local_position":
                self._local = values
                yield from self._place(values, boot_us)
                if not self._has_estimator and self._flags:
                    yield _made_estimator(values, self._flags, boot_us)
            case "vehicle_global_position" if self._local:
                yield self._position(values, boot_us)
            case "home_position" if values.get("valid_hpos", True):
                self._home_alt_m = values["alt"] if values.get("valid_alt", True) else None
                if boot_us - self._home_us >= _HOME_EVERY_US:
                    self._home_us = boot_us
                    yield _home(values, boot_us)
            case "sensor_gps":
                yield _gps(values, boot_us)
            case "estimator_status":
                yield _estimator(values, boot_us)
            case "estimator_status_flags":
                self._flags = values
            case "battery_status":
                left, amperes = values["remaining"], values["current_a"]
                is_known = values.get("connected", True) and 0.0 <= left <= 1.0
                percent = math.ceil(left * 100) if is_known else -1
                amperes = amperes if amperes >= 0.0 else -0.01
                yield made.battery(values["voltage_v"], amperes, percent)
            case "parameter":
                value, kind = values["value"], wire.MAV_PARAM_TYPE_REAL32
                if isinstance(value, int):
                    kind = wire.MAV_PARAM_TYPE_INT32
                    value = encoded(value, kind, bytewise=True)
                yield made.parameter(values["key"], value, kind)
            case "text":
                self._texts = self._texts % 0xFFFF + 1
                severity = min(max(values["level"] - ord("0"), 0), wire.MAV_SEVERITY_DEBUG)
                yield from made.texts(_COLOURS.sub("", values["text"]), severity, self._texts)
            case _:
                return  # what is not valid, or of nothing that is known

    def shown(self) -> tuple[Any, ...]:
        """What is told at once when it changes; empty while nothing is known."""
        return (*map(self._status.get, _SHOWN), self._landed) if self._status else ()

    def state(self) -> Iterator[Message]:
        """HEARTBEAT and EXTENDED_SYS_STATE."""
        values, mode = self._status, self._status["nav_state"]
        if mode in _MODES:
            armed = values["arming_state"] == _ARMED
            state = wire.MAV_STATE_STANDBY
            if mode == _TERMINATION:
                state = wire.MAV_STATE_FLIGHT_TERMINATION
            elif armed:
                state = wire.MAV_STATE_CRITICAL if values.get("failsafe") else wire.MAV_STATE_ACTIVE
            flags = wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            flags |= wire.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
            whose, (main, sub) = (values["system_type"], wire.MAV_AUTOPILOT_PX4), _MODES[mode]
            yield wire.MAVLink_heartbeat_message(*whose, flags, main << 16 | sub << 24, state, 3)
        if self._landed:
            yield made.ground(wire.MAV_LANDED_STATE_ON_GROUND)
        elif self._landed is not None:
            yield made.ground(_LEAVING.get(mode, wire.MAV_LANDED_STATE_IN_AIR))

    def _place(self, values: Values, boot_us: int) -> Iterator[Message]:
        """GPS_GLOBAL_ORIGIN, whenever it is another."""
        origin = (values["ref_lat"], values["ref_lon"], values["ref_alt"])
        is_known = values["xy_global"] and values["z_global"] and all(map(math.isfinite, origin))
        if is_known and origin != self._origin:
            if abs(origin[0]) > 90.0 or abs(origin[1]) > 180.0:
                raise ValueError("no such place")
            self._origin = origin
            yield wire.MAVLink_gps_global_origin_message(*wired(origin), boot_us)

    def _position(self, values: Values, boot_us: int) -> Message:
        """GLOBAL_POSITION_INT, with height, velocity and heading of the local position."""
        local, altitude_m = self._local, values["alt"]
        if local["z_valid"] and local["z_global"]:
            altitude_m = local["ref_alt"] - local["z"]
        above_m = 0.0 if self._home_alt_m is None else altitude_m - self._home_alt_m
        return wire.MAVLink_global_position_int_message(
            made.boot_ms(boot_us),
            *(*wired((values["lat"], values["lon"], altitude_m)), round(above_m * 1e3)),
            *(round(local[field] * 100) for field in ("vx", "vy", "vz")),
            direction(math.degrees(local["heading"])),
        )


def _home(values: Values, boot_us: int) -> Message:
    half = 0.5 * values.get("yaw", 0.0)
    return wire.MAVLink_home_position_message(
        *wired((values["lat"], values["lon"], values["alt"])),
        *(values[field] for field in ("x", "y", "z")),
        [math.cos(half), 0.0, 0.0, math.sin(half)],
        *(0.0, 0.0, 0.0, boot_us),
    )


def _gps(values: Values, boot_us: int) -> Message:
    if "latitude_deg" in values:
        place = wired(tuple(values[field] for field in _PLACE))
        ellipsoid_mm = values["altitude_ellipsoid_m"] * 1e3
    else:  # before 1.14
        place = (values["lat"], values["lon"], values["alt"])
        ellipsoid_mm = values["alt_ellipsoid"]
    return wire.MAVLink_gps_raw_int_message(
        *(boot_us, values["fix_type"], *place),
        *(whole(values[field] * 100, 0, 65535) for field in ("hdop", "vdop", "vel_m_s")),
        *(direction(math.degrees(values["cog_rad"])), values["satellites_used"]),
        alt_ellipsoid=round(ellipsoid_mm),
        h_acc=whole(values["eph"] * 1e3, 0, _MOST),
        v_acc=whole(values["epv"] * 1e3, 0, _MOST),
        vel_acc=whole(values["s_variance_m_s"] * 1e3, 0, _MOST),
    )


def _estimator(values: Values, boot_us: int) -> Message:
    ratios = (f"{name}_test_ratio" for name in ("vel", "pos", "hgt", "mag", "hagl", "tas"))
    return wire.MAVLink_estimator_status_message(
        *(boot_us, values["solution_status_flags"]),
        *(values.get(name, math.nan) for name in ratios),
        *(values["pos_horiz_accuracy"], values["pos_vert_accuracy"]),
    )


def _made_estimator(values: Values, flags: Values, boot_us: int) -> Message:
    """ESTIMATOR_STATUS of what vehicle_local_position calls valid, and rejections."""
    horizontal, placed = bool(values["v_xy_valid"]), bool(values["xy_valid"])
    absolute = placed and bool(values["xy_global"])
    flag_values = {
        wire.ESTIMATOR_ATTITUDE: flags["cs_tilt_align"],
        wire.ESTIMATOR_VELOCITY_HORIZ: horizontal,
        wire.ESTIMATOR_VELOCITY_VERT: values["v_z_valid"],
        wire.ESTIMATOR_POS_HORIZ_REL: placed,
        wire.ESTIMATOR_POS_HORIZ_ABS: absolute,
        wire.ESTIMATOR_POS_VERT_ABS: values["z_valid"],
        wire.ESTIMATOR_POS_VERT_AGL: values["dist_bottom_valid"],
        wire.ESTIMATOR_CONST_POS_MODE: not horizontal,
        wire.ESTIMATOR_PRED_POS_HORIZ_REL: placed,
        wire.ESTIMATOR_PRED_POS_HORIZ_ABS: absolute,
        wire.ESTIMATOR_ACCEL_ERROR: flags["fs_bad_acc_vertical"],
    }
    rejected = (flags.get(f"reject_{name}") for name in ("hor_vel", "hor_pos", "ver_pos"))
    return wire.MAVLink_estimator_status_message(
        *(boot_us, sum(flag for flag, holds in flag_values.items() if holds)),
        *(1.0 if is_rejected else math.nan for is_rejected in rejected),
        *(math.nan, math.nan, math.nan, values["eph"], values["epv"]),
    )
