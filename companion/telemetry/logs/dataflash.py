"""ArduPilot's .bin, as pymavlink's DFReader reads it, told as MAVLink.

Nothing in a .bin has a checksum: an entry is believed if another follows it, or the end.  The log
is looked through once beforehand: whose it is, when it was, and what it has.
"""

import math
import re
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Final, final

from pymavlink import DFReader

from companion.mavlink.dialect import Message, wire
from companion.telemetry.logs import made
from companion.telemetry.logs.log import YEAR_2000_US, YEAR_2100_US, Log, Odd, Record, earliest
from companion.telemetry.logs.made import Row, Values, direction, whole, wired

_LOOKED_AT: Final = frozenset(("GPS", "MSG", "PARM", "VER"))
"""Names of the entries that tell of the whole log, beforehand."""
_TRANSLATED: Final = frozenset(
    (
        *("ARM", "ATT", "BAT", "DSF", "ERR", "EV", "GPS", "MODE", "MSG"),
        *("ORGN", "PARM", "POS", "STAT", "XKF1", "XKF4"),
    )
)
_MAGIC: Final = b"\xa3\x95"
_LONGEST: Final = 255
"""Bytes of an entry."""
_OLDEST: Final = (4, 0)
_VERSION: Final = re.compile(r"(?:Ardu|APM)[\w:]* V(\d{1,2})\.(\d{1,2})")
"""Of VER.FWS and the greeting in MSG, in all versions."""
_SAMPLE: Final = 100
"""Entries that tell when the log begins."""
_GPS_EPOCH_US: Final = 315_964_800_000_000
"""6 January 1980, in microseconds since 1970."""
_WEEK_US: Final = 7 * 86_400 * 1_000_000
_LEAP_US: Final = 18_000_000
"""GPS time is so far ahead of UTC, since 2017."""
_VEHICLES: Final = {
    "ArduCopter": wire.MAV_TYPE_QUADROTOR,
    "ArduPlane": wire.MAV_TYPE_FIXED_WING,
    "ArduRover": wire.MAV_TYPE_GROUND_ROVER,
    "ArduSub": wire.MAV_TYPE_SUBMARINE,
    "Blimp": wire.MAV_TYPE_AIRSHIP,
    "AntennaTracker": wire.MAV_TYPE_ANTENNA_TRACKER,
}
"""What VER.FWS, and the greeting in MSG, begin with."""
_MODE_FLAGS: Final = wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | wire.MAV_MODE_FLAG_STABILIZE_ENABLED
_IN_AIR, _ON_GROUND = wire.MAV_LANDED_STATE_IN_AIR, wire.MAV_LANDED_STATE_ON_GROUND
_ARMING: Final = {10: True, 11: False, 15: True}
_LANDING: Final = {18: _ON_GROUND, 28: _IN_AIR}
"""What EV.Id says."""
_FAILSAFES: Final = frozenset({5, 6, 8, 17, 20, 23, 31})
"""ERR.Subsys of what makes ArduPilot say CRITICAL: radio, battery, ground station, estimator, ADSB,
terrain, dead reckoning."""
_FRESH_US: Final = 1_000_000
"""A velocity of longer ago is not that of the position."""
_SAME: Final = 0x3FF
"""Bits of the filter status (XKF4.SS) that EKF_STATUS_REPORT has, too."""
_GLITCHING: Final = 1 << 14
_INITIALISED: Final = 1 << 16
"""In XKF4.SS; a status of 16 bits, as logged before 4.3, does not say it."""


# --- entries


def _nothing(*_: object, **__: object) -> None:
    """Do nothing."""


@final
class _Entries(DFReader.DFReader_binary):  # type: ignore[misc]  # it has no types
    """The entries in their order: no index, no clock, no state, which take longer than reading."""

    init_arrays = init_arrays_fast = init_clock = _add_msg = _nothing


def _rows(path: Path, odd: Counter[Odd], wanted: Collection[str]) -> Iterator[Row]:
    """The entries of the kinds that are wanted."""
    log = _Entries(str(path))
    end, size = 0, log.data_len
    with made.silent(DFReader):
        try:
            while True:
                try:
                    entry = log.recv_msg()
                except RecursionError:  # it calls itself for each that does not fit its FMT
                    continue
                if entry is None:
                    break
                begin = log.offset - entry.fmt.len
                odd[Odd.GARBAGE] += max(begin - end, 0)
                end = log.offset
                if not _MAGIC.startswith(log.data_map[end : end + 2]):
                    odd[Odd.DAMAGED] += 1
                    log.offset = end = begin + len(_MAGIC)
                elif entry.fmt.name in wanted:
                    try:
                        values = entry.to_dict()
                    except (TypeError, ValueError, IndexError):
                        odd[Odd.DAMAGED] += 1
                        continue
                    time_us = values.get("TimeUS")
                    yield Row(entry.fmt.name, time_us if type(time_us) is int else None, values)
            odd[Odd.CUT_SHORT if size - end < _LONGEST else Odd.GARBAGE] += size - end
        finally:
            log.close()


# --- the first look


def opened(path: Path) -> Log | None:
    """A .bin; None: nothing of use is in it.  InputError: it is of firmware before 4.0."""
    look = _Look(path)
    made.refuse_older(path, "ArduPilot", look.version, _OLDEST)
    if not look.times_us:
        return None
    autopilots = {look.system_id: int(wire.MAV_AUTOPILOT_ARDUPILOTMEGA)}
    return Log(kind="bin", path=path, autopilots=autopilots, read=partial(_records, look))


@final
class _Look:
    """What one pass through the file tells of the whole log."""

    def __init__(self, path: Path) -> None:
        self.system_id = 1
        """ArduPilot's default, until a parameter says otherwise."""
        self.epoch_us: int | None = None
        self.version = _OLDEST
        """Unless a greeting says otherwise."""
        self.mav_type: int | None = None
        """None: nothing tells."""
        self.times_us: list[int] = []
        """Of the first entries."""
        for row in _rows(path, Counter(), _LOOKED_AT):
            if row.time_us is not None and len(self.times_us) < _SAMPLE:
                self.times_us.append(row.time_us)
            with suppress(KeyError, TypeError, ValueError, OverflowError):
                self._at_row(row)  # the second pass counts what is damaged

    def _at_row(self, row: Row) -> None:
        values = row.values
        match row.name:
            case "GPS" if self.epoch_us is None:
                self.epoch_us = _epoch_us(row)
            case "PARM" if values["Name"] in ("MAV_SYSID", "SYSID_THISMAV"):
                if 1 <= values["Value"] <= 255:
                    self.system_id = int(values["Value"])
            case "VER" | "MSG" if self.mav_type is None:
                text = values["FWS" if row.name == "VER" else "Message"]
                if (match := _VERSION.match(text)) is not None:
                    self.version = int(match[1]), int(match[2])
                kinds = (mav for word, mav in _VEHICLES.items() if text.startswith(word))
                self.mav_type = next(kinds, None)


def _epoch_us(row: Row) -> int | None:
    """When the vehicle booted, by a GPS entry with a fix."""
    week, of_week_ms = row.values["GWk"], row.values["GMS"]
    if row.values["Status"] < wire.GPS_FIX_TYPE_3D_FIX or row.time_us is None or not week:
        return None
    gps_us = week * _WEEK_US + of_week_ms * 1000
    epoch_us = int(_GPS_EPOCH_US + gps_us - _LEAP_US - row.time_us)
    return epoch_us if YEAR_2000_US <= epoch_us < YEAR_2100_US else None


# --- what it says


def _records(look: _Look, log: Log) -> Iterator[Record]:
    log.odd[Odd.NO_KIND] = int(look.mav_type is None)
    rows = _rows(log.path, log.odd, _TRANSLATED)
    return made.made(log, rows, _Vehicle(look, log.odd), earliest(look.times_us))


@final
class _Vehicle:
    """The vehicle in one pass, from first to last."""

    def __init__(self, look: _Look, odd: Counter[Odd]) -> None:
        self.epoch_us, self._mav_type, self._odd = look.epoch_us, look.mav_type, odd
        self._mode: int | None = None
        self._armed, self._landed = False, wire.MAV_LANDED_STATE_UNDEFINED
        self._failsafes: set[int] = set()
        self._velocities: dict[int, tuple[int, float, float, float]] = {}
        """By estimator core: when, and north, east, down, m/s."""
        self._core = 0
        self._yaw_deg = math.nan
        self._texts = 0

    def messages(self, row: Row, boot_us: int) -> Iterator[Message]:
        """What it would have sent of an entry."""
        values = row.values
        match row.name:
            case "MODE":
                self._mode = int(values["ModeNum"])
            case "ARM":
                self._armed = bool(values["ArmState"])
            case "EV":
                self._armed = _ARMING.get(values["Id"], self._armed)
                self._landed = _LANDING.get(values["Id"], self._landed)
            case "STAT":
                self._landed = _IN_AIR if values["isFlying"] else _ON_GROUND
                self._armed = bool(values["Armed"])
            case "ERR" if values["Subsys"] in _FAILSAFES:
                change = self._failsafes.add if values["ECode"] else self._failsafes.discard
                change(values["Subsys"])
            case "XKF1":
                velocity = (values["VN"], values["VE"], values["VD"])
                self._velocities[values.get("C", 0)] = (boot_us, *velocity)
            case "XKF4":
                self._core = max(values.get("PI", 0), 0)
                if values.get("C", 0) == self._core:
                    yield _estimator(values)
            case "ATT":
                self._yaw_deg = values["Yaw"]
            case "POS" if self._core in self._velocities:
                if boot_us - self._velocities[self._core][0] <= _FRESH_US:
                    yield self._position(values, boot_us)
            case "ORGN" if values["Type"] == 0:
                yield wire.MAVLink_gps_global_origin_message(*_wired(values), boot_us)
            case "ORGN" if values["Type"] == 1:
                level = [1.0, 0.0, 0.0, 0.0]
                fields = (*_wired(values), 0, 0, 0, level, 0, 0, 0, boot_us)
                yield wire.MAVLink_home_position_message(*fields)
            case "GPS" if values.get("I", 0) == 0:
                yield _gps(values, boot_us)
            case "BAT" if values.get("Inst", values.get("Instance", values.get("I", 0))) == 0:
                percent = values.get("RemPct", -1)
                percent = percent if 0 <= percent <= 100 else -1
                yield made.battery(values["Volt"], values.get("Curr", 0.0), percent)
            case "PARM":
                yield made.parameter(values["Name"], values["Value"])
            case "MSG":
                self._texts = self._texts % 0xFFFF + 1
                yield from made.texts(values["Message"], wire.MAV_SEVERITY_INFO, self._texts)
            case "DSF":  # what the logger could not write, in all
                self._odd[Odd.LOST_ENTRIES] = max(self._odd[Odd.LOST_ENTRIES], values["Dp"])
            case _:
                return  # of another receiver, battery or subsystem

    def shown(self) -> tuple[int | None, bool, bool, int]:
        """What is told at once when it changes."""
        return self._mode, self._armed, bool(self._failsafes), self._landed

    def state(self) -> Iterator[Message]:
        """HEARTBEAT and EXTENDED_SYS_STATE."""
        status = wire.MAV_STATE_ACTIVE
        if self._failsafes:
            status = wire.MAV_STATE_CRITICAL
        elif not self._armed or self._landed == _ON_GROUND:
            status = wire.MAV_STATE_STANDBY
        if self._mode is not None and self._mav_type is not None:
            flags = _MODE_FLAGS | (wire.MAV_MODE_FLAG_SAFETY_ARMED if self._armed else 0)
            whose = self._mav_type, wire.MAV_AUTOPILOT_ARDUPILOTMEGA
            yield wire.MAVLink_heartbeat_message(*whose, flags, self._mode, status, 3)
        if self._landed != wire.MAV_LANDED_STATE_UNDEFINED:
            yield made.ground(self._landed)

    def _position(self, values: Values, boot_us: int) -> Message:
        """GLOBAL_POSITION_INT, with the newest velocity."""
        return wire.MAVLink_global_position_int_message(
            made.boot_ms(boot_us),
            *(*_wired(values), round(values.get("RelHomeAlt", 0.0) * 1e3)),
            *(round(speed * 100) for speed in self._velocities[self._core][1:]),
            direction(self._yaw_deg),
        )


def _estimator(values: Values) -> Message:
    """EKF_STATUS_REPORT."""
    status = values["SS"]
    flags = status & _SAME | (wire.EKF_GPS_GLITCHING if status & _GLITCHING else 0)
    if not status & (_INITIALISED if status >= _INITIALISED else wire.EKF_ATTITUDE):
        flags |= wire.EKF_UNINITIALIZED
    variances = (values["SV"], values["SP"], values["SH"], values["SM"], 0.0, values["SVT"])
    return wire.MAVLink_ekf_status_report_message(flags, *variances)


def _gps(values: Values, boot_us: int) -> Message:
    """GPS_RAW_INT."""
    return wire.MAVLink_gps_raw_int_message(
        *(boot_us, values["Status"], *_wired(values)),
        *(whole(values["HDop"] * 100, 0, 65535), 65535, whole(values["Spd"] * 100, 0, 65535)),
        *(direction(values["GCrs"]), values["NSats"]),
    )


def _wired(values: Values) -> tuple[int, int, int]:
    """The place of an entry, as on the wire."""
    return wired((values["Lat"], values["Lng"], values["Alt"]))
