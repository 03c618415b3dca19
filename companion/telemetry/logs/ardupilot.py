"""ArduPilot's .bin: its entries as the MAVLink messages that it would have sent with them.

What each message is made of: docs/reference/log-messages.md. The log is looked through once
beforehand: whose it is, when it was, and what it has.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final, final

from companion.mavlink.dialect import Message, wire
from companion.telemetry.logs import dataflash
from companion.telemetry.logs.anomalies import Anomaly, AnomalyCounter
from companion.telemetry.logs.timeline import YEAR_2000_US, YEAR_2100_US, earliest
from companion.telemetry.logs.translated import (
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

_GPS_EPOCH_US: Final = 315_964_800_000_000
"""6 January 1980, in microseconds since 1970."""
_WEEK_US: Final = 7 * 86_400 * 1_000_000
_LEAP_US: Final = 18_000_000
"""GPS time is so far ahead of UTC, since 2017."""
_OLDEST: Final = (4, 0)
_VERSION: Final = re.compile(r"(?:Ardu|APM)[\w:]* V(\d{1,2})\.(\d{1,2})")
"""Of VER.FWS and the greeting in MSG, in all versions."""
_SAMPLE: Final = 100
_STATISTICS: Final = "DSF"
"""Of the logger itself; Dp counts what it could not write."""
_TELLING: Final = frozenset({"GPS", "MSG", "PARM", "VER"})
"""Entries that tell of the whole log."""
_SYSTEM_IDS: Final = ("MAV_SYSID", "SYSID_THISMAV")
_FRAME_TYPES: Final = {
    1: wire.MAV_TYPE_QUADROTOR,
    2: wire.MAV_TYPE_HEXAROTOR,
    3: wire.MAV_TYPE_OCTOROTOR,
    4: wire.MAV_TYPE_OCTOROTOR,
    5: wire.MAV_TYPE_HEXAROTOR,
    6: wire.MAV_TYPE_HELICOPTER,
    7: wire.MAV_TYPE_TRICOPTER,
    8: wire.MAV_TYPE_COAXIAL,
    9: wire.MAV_TYPE_COAXIAL,
    11: wire.MAV_TYPE_HELICOPTER,
    12: wire.MAV_TYPE_DODECAROTOR,
    13: wire.MAV_TYPE_HELICOPTER,
    14: wire.MAV_TYPE_DECAROTOR,
}
"""FRAME_CLASS of a copter."""
_WORDS: Final = {
    "ArduCopter": wire.MAV_TYPE_QUADROTOR,
    "ArduPlane": wire.MAV_TYPE_FIXED_WING,
    "ArduRover": wire.MAV_TYPE_GROUND_ROVER,
    "ArduSub": wire.MAV_TYPE_SUBMARINE,
    "Blimp": wire.MAV_TYPE_AIRSHIP,
    "AntennaTracker": wire.MAV_TYPE_ANTENNA_TRACKER,
}
"""What VER.FWS, and the greeting in MSG, begin with."""
_SECOND_US: Final = 1_000_000
_FAST_US: Final = 19_000
"""Positions and attitudes: 50 a second are enough."""
_ESTIMATOR_US: Final = 95_000
_FRESH_US: Final = 1_000_000
"""A velocity of longer ago is not that of the position."""
_GPS: Final = -1
"""In place of an estimator's core."""
_ARMED, _DISARMED, _AUTO_ARMED = 10, 11, 15
_LANDED, _NOT_LANDED = 18, 28
"""EV.Id."""
_FAILSAFES: Final = frozenset({5, 6, 8, 17, 20, 23, 31})
"""ERR.Subsys of what makes ArduPilot say CRITICAL: radio, battery, ground station, estimator, ADSB,
terrain, dead reckoning."""
_MODE_FLAGS: Final = wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | wire.MAV_MODE_FLAG_STABILIZE_ENABLED
_NO_HEADING: Final = 65535
_EKF2: Final = ("NKF1", "NKF4")
_FLAGS: Final = (
    *((1 << bit, 1 << bit) for bit in range(6)),
    (1 << 6, wire.EKF_POS_VERT_AGL),
    (1 << 7, wire.EKF_CONST_POS_MODE),
    (1 << 8, wire.EKF_PRED_POS_HORIZ_REL),
    (1 << 9, wire.EKF_PRED_POS_HORIZ_ABS),
    (1 << 14, wire.EKF_GPS_GLITCHING),
)
"""Bits of the filter status (XKF4.SS), and what EKF_STATUS_REPORT has for them."""
_INITIALISED: Final = 1 << 16
_OLD_STATUS: Final = 1 << 16
"""A filter status of 16 bits does not say whether it is initialised."""


# --- the first look


def look(path: Path) -> Source:
    """Look through a log once.  InputError if it is of firmware before 4.0."""
    looked = _Look()
    for row in dataflash.rows(path, AnomalyCounter(), _TELLING, looked.counts):
        looked.at_row(row)
    refuse_older(path, "ArduPilot", looked.version, _OLDEST)
    return Source(
        kind="bin",
        autopilot=int(wire.MAV_AUTOPILOT_ARDUPILOTMEGA),
        system_id=looked.system_id,
        entries=sum(looked.counts[name] for name in ROWS),
        epoch_us=looked.epoch_us,
        start_us=earliest(looked.times_us) if looked.times_us else 0,
        substitutes=tuple(_substitutes(looked)),
        rows=partial(_entries, path),
        translator=lambda: _Rows(looked).on_row,
    )


def _entries(path: Path, findings: AnomalyCounter) -> Iterator[Row]:
    """What is translated; what the logger could not write is noted."""
    dropped = 0
    for row in dataflash.rows(path, findings, ROWS | {_STATISTICS}):
        if row.name != _STATISTICS:
            yield row
            continue
        count = row.values.get("Dp")
        if isinstance(count, int) and count > dropped:
            findings.note(Anomaly.LOST_ENTRIES, row.byte, None, count - dropped)
            dropped = count


def _substitutes(looked: "_Look") -> Iterator[str]:
    counts = looked.counts
    if looked.mav_type is None:
        yield "no entry (VER, MSG) tells which kind of vehicle it is: no HEARTBEAT is made"
    if counts["GPS"] and not looked.times_us:
        yield "no entry tells the time since boot: all of it is told at one time"
    if not counts["ARM"] and not counts["EV"] and not counts["STAT"]:
        yield "no entry (ARM, EV, STAT) tells whether it is armed: taken for disarmed"
    if counts["GPS"] and not looked.has_position:
        yield "positions are those of the GPS: there is no POS"
    if counts["GPS"] and not looked.has_velocity:
        yield "velocities are those of the GPS: there is no XKF1"


@final
class _Look:
    """Results of one pass through the file."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.system_id = 1
        """ArduPilot's default, until a parameter says otherwise."""
        self.epoch_us: int | None = None
        self.mav_type: int | None = None
        self.version: tuple[int, int] | None = None
        self.parameters: set[str] = set()
        self.times_us: list[int] = []
        """Of the first entries."""
        self._frame_class = 0

    @property
    def has_position(self) -> bool:
        """Whether its estimate of where it is was logged; else the GPS's is told."""
        return self.counts["POS"] > 0

    @property
    def has_velocity(self) -> bool:
        """Whether that of its velocity was."""
        return self.counts["XKF1"] + self.counts["NKF1"] > 0

    def at_row(self, row: Row) -> None:
        """One more entry."""
        if row.time_us is not None and len(self.times_us) < _SAMPLE:
            self.times_us.append(row.time_us)
        values = row.values
        try:
            match row.name:
                case "GPS" if self.epoch_us is None:
                    self.epoch_us = _epoch_us(row)
                case "PARM":
                    self._on_parameter(values["Name"], values["Value"])
                case "VER":
                    self._on_text(values.get("FWS", ""))
                case "MSG" if self.mav_type is None:
                    self._on_text(values["Message"])
        except (KeyError, TypeError, ValueError, OverflowError):
            return  # damaged: the second pass says so

    def _on_parameter(self, name: str, value: float) -> None:
        self.parameters.add(name)
        if name in _SYSTEM_IDS and 1 <= value <= 255:
            self.system_id = int(value)
        elif name == "FRAME_CLASS":
            self._frame_class = int(value)
            self._take_type(self.mav_type)

    def _on_text(self, text: str) -> None:
        if self.version is None and (found := _VERSION.match(text)) is not None:
            self.version = int(found[1]), int(found[2])
        for word, mav_type in _WORDS.items():
            if text.startswith(word):
                self._take_type(mav_type)

    def _take_type(self, mav_type: int | None) -> None:
        if mav_type == wire.MAV_TYPE_QUADROTOR:
            mav_type = _FRAME_TYPES.get(self._frame_class, mav_type)
        if mav_type is not None:
            self.mav_type = mav_type


def _epoch_us(row: Row) -> int | None:
    """When the vehicle booted, by a GPS entry with a fix."""
    values: Mapping[str, Any] = row.values
    week, of_week_ms = values["GWk"], values["GMS"]
    if values["Status"] < wire.GPS_FIX_TYPE_3D_FIX or row.time_us is None or not week:
        return None
    gps_us = week * _WEEK_US + of_week_ms * 1000
    epoch_us = int(_GPS_EPOCH_US + gps_us - _LEAP_US - row.time_us)
    return epoch_us if YEAR_2000_US <= epoch_us < YEAR_2100_US else None


# --- what it says


@final
class _Rows:
    """Translates the entries of one pass; see `translated.OnRow`."""

    def __init__(self, looked: "_Look") -> None:
        self._mav_type, self._epoch_us = looked.mav_type, looked.epoch_us
        self._has_position, self._has_velocity = looked.has_position, looked.has_velocity
        self._has_ekf3 = looked.counts["XKF1"] > 0  # then what EKF2 says is not what is flown by
        self._pace = RateLimiter()
        self._mode: int | None = None
        self._armed, self._landed = False, wire.MAV_LANDED_STATE_UNDEFINED
        self._failsafes: set[int] = set()
        self._velocities: dict[int, tuple[int, float, float, float]] = {}
        """By estimator core: when, and north, east, down, m/s."""
        self._core = 0
        self._yaw_deg: float | None = None
        self._gyro = (math.nan, math.nan, math.nan)
        self._home_alt_m: float | None = None
        self._accuracy: Mapping[str, Any] = {}
        self._capacity_mah = 0.0
        self._load = 0
        self._told = NumberedMessages(len(looked.parameters))

    def on_row(self, row: Row, boot_us: int) -> Iterator[Message]:
        """Messages of one entry."""
        if self._has_ekf3 and row.name in _EKF2:
            return
        yield from _HANDLERS[row.name](self, row.values, boot_us)
        if self._pace.is_due("heartbeat", boot_us, _SECOND_US):
            yield from self._heartbeat()
            yield from self._ground()
            yield system_time(self._epoch_us, boot_us)

    # --- its state

    def _heartbeat(self) -> Iterator[Message]:
        if self._mode is None or self._mav_type is None:
            return
        flags = _MODE_FLAGS | (wire.MAV_MODE_FLAG_SAFETY_ARMED if self._armed else 0)
        status = wire.MAV_STATE_ACTIVE
        if not self._armed or self._landed == wire.MAV_LANDED_STATE_ON_GROUND:
            status = wire.MAV_STATE_STANDBY
        if self._failsafes:
            status = wire.MAV_STATE_CRITICAL
        yield wire.MAVLink_heartbeat_message(
            self._mav_type,
            wire.MAV_AUTOPILOT_ARDUPILOTMEGA,
            flags,
            self._mode,
            status,
            3,
        )

    def _ground(self) -> Iterator[Message]:
        if self._landed == wire.MAV_LANDED_STATE_UNDEFINED:
            return
        yield wire.MAVLink_extended_sys_state_message(wire.MAV_VTOL_STATE_UNDEFINED, self._landed)

    def _on_mode(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        self._mode = int(values["ModeNum"])
        return self._heartbeat()

    def _on_arm(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        return self._set_armed(bool(values["ArmState"]))

    def _set_armed(self, armed: bool) -> Iterable[Message]:
        if armed == self._armed:
            return ()
        self._armed = armed
        return self._heartbeat()

    def _on_event(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        match values["Id"]:
            case event if event in (_ARMED, _AUTO_ARMED):
                return self._set_armed(True)
            case event if event == _DISARMED:
                return self._set_armed(False)
            case event if event == _LANDED:
                return self._set_landed(wire.MAV_LANDED_STATE_ON_GROUND)
            case event if event == _NOT_LANDED:
                return self._set_landed(wire.MAV_LANDED_STATE_IN_AIR)
        return ()

    def _set_landed(self, landed: int) -> Iterable[Message]:
        if landed == self._landed:
            return ()
        self._landed = landed
        return self._ground()

    def _on_plane(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        """STAT, of a plane."""
        flies = bool(values["isFlying"])
        landed = wire.MAV_LANDED_STATE_IN_AIR if flies else wire.MAV_LANDED_STATE_ON_GROUND
        return [*self._set_armed(bool(values["Armed"])), *self._set_landed(landed)]

    def _on_error(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        subsystem = values["Subsys"]
        if subsystem not in _FAILSAFES:
            return ()
        before = bool(self._failsafes)
        (self._failsafes.add if values["ECode"] else self._failsafes.discard)(subsystem)
        return self._heartbeat() if bool(self._failsafes) != before else []

    # --- where it is

    def _on_estimate(self, values: Mapping[str, Any], boot_us: int) -> Iterable[Message]:
        velocity = (values["VN"], values["VE"], values["VD"])
        self._velocities[values.get("C", 0)] = (boot_us, *velocity)
        return ()

    def _on_attitude(self, values: Mapping[str, Any], boot_us: int) -> Iterator[Message]:
        self._yaw_deg = values["Yaw"]
        if not self._pace.is_due("ATTITUDE", boot_us, _FAST_US):
            return
        roll, pitch, yaw = (math.radians(values[each]) for each in ("Roll", "Pitch", "Yaw"))
        turned = math.remainder(yaw, math.tau)
        yield wire.MAVLink_attitude_message(boot_ms(boot_us), roll, pitch, turned, *self._gyro)

    def _on_gyro(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        if values.get("I", 0) == 0:
            self._gyro = (values["GyrX"], values["GyrY"], values["GyrZ"])
        return ()

    def _on_position(self, values: Mapping[str, Any], boot_us: int) -> Iterable[Message]:
        velocity = self._velocities.get(self._core if self._has_velocity else _GPS)
        if velocity is None or boot_us - velocity[0] > _FRESH_US:
            return ()
        above_m = values.get("RelHomeAlt", 0.0)
        return self._position(values, above_m, velocity[1:], boot_us)

    def _position(
        self,
        values: Mapping[str, Any],
        above_home_m: float,
        velocity: tuple[float, ...],
        boot_us: int,
    ) -> Iterator[Message]:
        if not self._pace.is_due("position", boot_us, _FAST_US):
            return
        heading = _NO_HEADING if self._yaw_deg is None else round(self._yaw_deg * 100) % 36000
        yield wire.MAVLink_global_position_int_message(
            boot_ms(boot_us),
            *_degrees_e7(values),
            round(values["Alt"] * 1e3),
            round(above_home_m * 1e3),
            *(round(each * 100) for each in velocity),
            heading,
        )

    def _on_origin(self, values: Mapping[str, Any], boot_us: int) -> Iterator[Message]:
        place = (*_degrees_e7(values), round(values["Alt"] * 1e3))
        if values["Type"] == 0:
            yield wire.MAVLink_gps_global_origin_message(*place, boot_us)
        if values["Type"] != 1:
            return
        self._home_alt_m = values["Alt"]
        q = [1.0, 0.0, 0.0, 0.0]
        yield wire.MAVLink_home_position_message(*place, 0, 0, 0, q, 0, 0, 0, boot_us)

    # --- how well it knows

    def _on_gps(self, values: Mapping[str, Any], boot_us: int) -> Iterator[Message]:
        if values.get("I", 0) != 0:
            return
        speed, course = values["Spd"], values["GCrs"]
        accuracy = self._accuracy
        ellipsoid_m = accuracy.get("AEl", accuracy.get("AE"))
        yield wire.MAVLink_gps_raw_int_message(
            boot_us,
            values["Status"],
            *_degrees_e7(values),
            round(values["Alt"] * 1e3),
            whole(values["HDop"] * 100, 0, 65535),
            whole(accuracy["VDop"] * 100, 0, 65535) if "VDop" in accuracy else 65535,
            whole(speed * 100, 0, 65535),
            round(course * 100) % 36000,
            values["NSats"],
            alt_ellipsoid=0 if ellipsoid_m is None else round(ellipsoid_m * 1e3),
            h_acc=whole(accuracy.get("HAcc", 0.0) * 1e3, 0, 0xFFFFFFFF),
            v_acc=whole(accuracy.get("VAcc", 0.0) * 1e3, 0, 0xFFFFFFFF),
            vel_acc=whole(accuracy.get("SAcc", 0.0) * 1e3, 0, 0xFFFFFFFF),
        )
        if values["Status"] < wire.GPS_FIX_TYPE_3D_FIX:
            return
        angle = math.radians(course)
        velocity = (speed * math.cos(angle), speed * math.sin(angle), values.get("VZ", 0.0))
        self._velocities[_GPS] = (boot_us, *velocity)
        if not self._has_position:
            above_m = 0.0 if self._home_alt_m is None else values["Alt"] - self._home_alt_m
            yield from self._position(values, above_m, velocity, boot_us)

    def _on_accuracy(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        if values.get("I", 0) == 0:
            self._accuracy = values
        return ()

    def _on_filter(self, values: Mapping[str, Any], boot_us: int) -> Iterator[Message]:
        """XKF4: of the primary core."""
        core, primary = values.get("C", 0), values.get("PI", 0)
        self._core = max(primary, 0)
        if core != self._core or not self._pace.is_due("filter", boot_us, _ESTIMATOR_US):
            return
        status = values["SS"]
        flags = sum(flag for bit, flag in _FLAGS if status & bit)
        ready = status & _INITIALISED if status >= _OLD_STATUS else status & wire.EKF_ATTITUDE
        if not ready:
            flags |= wire.EKF_UNINITIALIZED
        variances = (values["SV"], values["SP"], values["SH"], values["SM"])
        yield wire.MAVLink_ekf_status_report_message(
            flags, *variances, 0.0, airspeed_variance=values["SVT"]
        )

    # --- the rest

    def _on_battery(self, values: Mapping[str, Any], boot_us: int) -> Iterable[Message]:
        if values.get("Inst", values.get("Instance", values.get("I", 0))) != 0:
            return ()
        if not self._pace.is_due("battery", boot_us, _SECOND_US // 2):
            return ()
        used_mah = values.get("CurrTot", 0.0)
        percent = values.get("RemPct")
        if percent is None:
            full = self._capacity_mah
            percent = whole(100 * (full - used_mah) / full, 0, 100) if full > 0 else -1
        elif not 0 <= percent <= 100:
            percent = -1
        centi_a = whole(values.get("Curr", 0.0) * 100, -1, 32767)
        used = whole(used_mah, -1, 1 << 30)
        return battery(values["Volt"], centi_a, used, percent, load=self._load)

    def _on_load(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        self._load = whole(values.get("Load", 0), 0, 1000)
        return ()

    def _on_parameter(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        name, value = values["Name"], values["Value"]
        if name == "BATT_CAPACITY" and math.isfinite(value):
            self._capacity_mah = value
        return self._told.parameter(name, value)

    def _on_text(self, values: Mapping[str, Any], _: int) -> Iterable[Message]:
        return self._told.text(values["Message"], wire.MAV_SEVERITY_INFO)


def _degrees_e7(values: Mapping[str, Any]) -> tuple[int, int]:
    """Latitude and longitude."""
    return round(values["Lat"] * 1e7), round(values["Lng"] * 1e7)


_HANDLERS: Final[Mapping[str, Callable[[_Rows, Mapping[str, Any], int], Iterable[Message]]]] = {
    "ARM": _Rows._on_arm,
    "ATT": _Rows._on_attitude,
    "BAT": _Rows._on_battery,
    "ERR": _Rows._on_error,
    "EV": _Rows._on_event,
    "GPA": _Rows._on_accuracy,
    "GPS": _Rows._on_gps,
    "IMU": _Rows._on_gyro,
    "MODE": _Rows._on_mode,
    "MSG": _Rows._on_text,
    "NKF1": _Rows._on_estimate,
    "NKF4": _Rows._on_filter,
    "ORGN": _Rows._on_origin,
    "PARM": _Rows._on_parameter,
    "PM": _Rows._on_load,
    "POS": _Rows._on_position,
    "STAT": _Rows._on_plane,
    "VER": lambda *_: [],  # it tells beforehand
    "XKF1": _Rows._on_estimate,
    "XKF4": _Rows._on_filter,
}
ROWS: Final = frozenset(_HANDLERS)
