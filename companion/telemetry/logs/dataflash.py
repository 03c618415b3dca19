"""ArduPilot's .bin, as pymavlink's DFReader reads it, told as MAVLink.

Nothing in a .bin has a checksum: an entry is believed if another follows it, or the end.  The log
is looked through once beforehand: whose it is, when it was, and what it has.
"""

import math
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Final, final

from pymavlink import DFReader

from companion.mavlink.dialect import Message, wire
from companion.telemetry.logs.log import (
    YEAR_2000_US,
    YEAR_2100_US,
    Log,
    Odd,
    Record,
    chosen,
    earliest,
)
from companion.telemetry.logs.made import (
    Pace,
    Row,
    Values,
    battery,
    boot_ms,
    made,
    parameter,
    refuse_older,
    system_time,
    texts,
    whole,
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
_ROTORS: Final = (
    *(wire.MAV_TYPE_QUADROTOR, wire.MAV_TYPE_QUADROTOR, wire.MAV_TYPE_HEXAROTOR),
    *(wire.MAV_TYPE_OCTOROTOR, wire.MAV_TYPE_OCTOROTOR, wire.MAV_TYPE_HEXAROTOR),
    *(wire.MAV_TYPE_HELICOPTER, wire.MAV_TYPE_TRICOPTER, wire.MAV_TYPE_COAXIAL),
    *(wire.MAV_TYPE_COAXIAL, wire.MAV_TYPE_QUADROTOR, wire.MAV_TYPE_HELICOPTER),
    *(wire.MAV_TYPE_DODECAROTOR, wire.MAV_TYPE_HELICOPTER, wire.MAV_TYPE_DECAROTOR),
)
"""MAV_TYPE of a copter by its FRAME_CLASS."""
_MODE_FLAGS: Final = wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | wire.MAV_MODE_FLAG_STABILIZE_ENABLED
_ARMED, _DISARMED, _AUTO_ARMED, _LANDED, _NOT_LANDED = 10, 11, 15, 18, 28
"""EV.Id."""
_IN_AIR, _ON_GROUND = wire.MAV_LANDED_STATE_IN_AIR, wire.MAV_LANDED_STATE_ON_GROUND
_FAILSAFES: Final = frozenset({5, 6, 8, 17, 20, 23, 31})
"""ERR.Subsys of what makes ArduPilot say CRITICAL: radio, battery, ground station, estimator, ADSB,
terrain, dead reckoning."""
_FRESH_US: Final = 1_000_000
"""A velocity of longer ago is not that of the position."""
_GPS: Final = -1
"""In place of an estimator's core."""
_NO_HEADING: Final = 65535
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
"""In XKF4.SS; a status of 16 bits, as logged before 4.3, does not say it."""


# --- entries


@final
class _Entries(DFReader.DFReader_binary):  # type: ignore[misc]  # it has no types
    """The entries in their order: no index, no clock, no state, which take longer than reading."""

    def init_arrays(self, progress_callback: None = None) -> None:
        """Called by the base class."""

    def init_arrays_fast(self, progress_callback: None = None) -> None:
        """Called by the base class."""

    def init_clock(self) -> None:
        """Called by the base class."""

    def _add_msg(self, entry: DFReader.DFMessage) -> None:
        """Called by the base class."""


def _rows(
    path: Path, odd: Counter[Odd], wanted: Collection[str], counts: Counter[str] | None = None
) -> Iterator[Row]:
    """The entries of the kinds that are wanted; all are counted, by kind, if asked for."""
    log = _Entries(str(path))
    vars(DFReader)["print"] = _nothing  # it prints each byte that it passes over
    try:
        end, size = 0, log.data_len
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
                continue
            if counts is not None:
                counts[entry.fmt.name] += 1
            if entry.fmt.name in wanted:
                try:
                    values = entry.to_dict()
                except (TypeError, ValueError, IndexError):
                    odd[Odd.DAMAGED] += 1
                    continue
                time_us = values.get("TimeUS")
                yield Row(entry.fmt.name, time_us if type(time_us) is int else None, values, end)
        odd[Odd.CUT_SHORT if size - end < _LONGEST else Odd.GARBAGE] += size - end
    finally:
        vars(DFReader).pop("print", None)
        log.close()


def _nothing(*_: object, **__: object) -> None:
    """Print nothing."""


# --- the first look


def opened(path: Path, system_id: int | None) -> Log | None:
    """A .bin; None: nothing of use is in it.  InputError: of firmware before 4.0, or not whose."""
    look = _Look()
    for row in _rows(path, Counter(), {"GPS", "MSG", "PARM", "VER"}, look.counts):
        look.at_row(row)
    refuse_older(path, "ArduPilot", look.version, _OLDEST)
    if not any(look.counts[name] for name in ROWS):
        return None
    return Log(
        kind="bin",
        path=path,
        systems=(look.system_id,),
        system_id=chosen(path, (look.system_id,), system_id),
        autopilot=int(wire.MAV_AUTOPILOT_ARDUPILOTMEGA),
        read=partial(_records, look),
        substitutes=tuple(look.substitutes()),
    )


@final
class _Look:
    """What one pass through the file tells of the whole log."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.system_id = 1
        """ArduPilot's default, until a parameter says otherwise."""
        self.epoch_us: int | None = None
        self.version: tuple[int, int] | None = None
        self.times_us: list[int] = []
        """Of the first entries."""
        self._vehicle: int | None = None
        self._frame_class = 0

    @property
    def mav_type(self) -> int | None:
        """MAV_TYPE; None: nothing tells."""
        if self._vehicle == wire.MAV_TYPE_QUADROTOR:
            return int(_ROTORS[self._frame_class])
        return self._vehicle

    def at_row(self, row: Row) -> None:
        """One more entry."""
        if row.time_us is not None and len(self.times_us) < _SAMPLE:
            self.times_us.append(row.time_us)
        values = row.values
        try:
            match row.name:
                case "GPS" if self.epoch_us is None:
                    self.epoch_us = _epoch_us(row)
                case "PARM" if values["Name"] in ("MAV_SYSID", "SYSID_THISMAV"):
                    if 1 <= values["Value"] <= 255:
                        self.system_id = int(values["Value"])
                case "PARM" if values["Name"] == "FRAME_CLASS":
                    known = 0 <= values["Value"] < len(_ROTORS)
                    self._frame_class = int(values["Value"]) if known else 0
                case "VER":
                    self._on_text(values.get("FWS", ""))
                case "MSG" if self._vehicle is None:
                    self._on_text(values["Message"])
        except (KeyError, TypeError, ValueError, OverflowError):
            return  # damaged: the second pass says so

    def _on_text(self, text: str) -> None:
        if self.version is None and (found := _VERSION.match(text)) is not None:
            self.version = int(found[1]), int(found[2])
        for word, vehicle in _VEHICLES.items():
            if text.startswith(word):
                self._vehicle = vehicle

    def substitutes(self) -> Iterator[str]:
        """What of the usual it has not, and what is told instead."""
        counts = self.counts
        if self.mav_type is None:
            yield "no entry (VER, MSG) tells which kind of vehicle it is: no HEARTBEAT is made"
        if counts["GPS"] and not self.times_us:
            yield "no entry tells the time since boot: all of it is told at one time"
        if not counts["ARM"] and not counts["EV"] and not counts["STAT"]:
            yield "no entry (ARM, EV, STAT) tells whether it is armed: taken for disarmed"
        if counts["GPS"] and not counts["POS"]:
            yield "positions are those of the GPS: there is no POS"
        if counts["GPS"] and not counts["XKF1"]:
            yield "velocities are those of the GPS: there is no XKF1"


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
    return made(
        log,
        _told(log),
        _Messages(look).of,
        epoch_us=look.epoch_us,
        start_us=earliest(look.times_us) if look.times_us else 0,
    )


def _told(log: Log) -> Iterator[Row]:
    """What is translated; what the logger could not write (DSF.Dp) is counted."""
    for row in _rows(log.path, log.odd, {*ROWS, "DSF"}):
        lost = row.values.get("Dp")
        if row.name != "DSF":
            yield row
        elif isinstance(lost, int) and lost > log.odd[Odd.LOST_ENTRIES]:
            log.odd[Odd.LOST_ENTRIES] = lost


@final
class _Messages:
    """The messages of the entries of one pass, from first to last; `_on_gps` is told of GPS."""

    def __init__(self, look: _Look) -> None:
        self._mav_type, self._epoch_us = look.mav_type, look.epoch_us
        self._has_position = look.counts["POS"] > 0
        self._has_velocity = look.counts["XKF1"] > 0
        self._pace = Pace()
        self._mode: int | None = None
        self._armed, self._landed = False, wire.MAV_LANDED_STATE_UNDEFINED
        self._failsafes: set[int] = set()
        self._velocities: dict[int, tuple[int, float, float, float]] = {}
        """By estimator core: when, and north, east, down, m/s."""
        self._core = 0
        self._yaw_deg: float | None = None
        self._home_alt_m: float | None = None
        self._accuracy: Values = {}
        self._capacity_mah = 0.0
        self._texts = 0

    def of(self, name: str, values: Values, boot_us: int) -> Iterator[Message]:
        """Messages of one entry."""
        before = self._mode, self._armed, bool(self._failsafes), self._landed
        yield from getattr(self, f"_on_{name.lower()}")(values, boot_us)
        changed = before != (self._mode, self._armed, bool(self._failsafes), self._landed)
        if self._pace.is_due("heartbeat", boot_us) or changed:
            yield from self._state()
        if self._pace.is_due("clock", boot_us):
            yield system_time(self._epoch_us, boot_us)

    # --- its state

    def _state(self) -> Iterator[Message]:
        """HEARTBEAT and EXTENDED_SYS_STATE."""
        status = wire.MAV_STATE_ACTIVE
        if self._failsafes:
            status = wire.MAV_STATE_CRITICAL
        elif not self._armed or self._landed == _ON_GROUND:
            status = wire.MAV_STATE_STANDBY
        if self._mode is not None and self._mav_type is not None:
            flags = _MODE_FLAGS | (wire.MAV_MODE_FLAG_SAFETY_ARMED if self._armed else 0)
            autopilot = wire.MAV_AUTOPILOT_ARDUPILOTMEGA
            yield wire.MAVLink_heartbeat_message(
                self._mav_type, autopilot, flags, self._mode, status, 3
            )
        if self._landed != wire.MAV_LANDED_STATE_UNDEFINED:
            vtol = wire.MAV_VTOL_STATE_UNDEFINED
            yield wire.MAVLink_extended_sys_state_message(vtol, self._landed)

    def _on_mode(self, values: Values, _: int) -> Iterable[Message]:
        self._mode = int(values["ModeNum"])
        return ()

    def _on_arm(self, values: Values, _: int) -> Iterable[Message]:
        self._armed = bool(values["ArmState"])
        return ()

    def _on_ev(self, values: Values, _: int) -> Iterable[Message]:
        event = values["Id"]
        if event in (_ARMED, _AUTO_ARMED, _DISARMED):
            self._armed = event != _DISARMED
        elif event in (_LANDED, _NOT_LANDED):
            self._landed = _ON_GROUND if event == _LANDED else _IN_AIR
        return ()

    def _on_stat(self, values: Values, _: int) -> Iterable[Message]:
        self._landed = _IN_AIR if values["isFlying"] else _ON_GROUND
        self._armed = bool(values["Armed"])
        return ()

    def _on_err(self, values: Values, _: int) -> Iterable[Message]:
        subsystem = values["Subsys"]
        if subsystem in _FAILSAFES:
            (self._failsafes.add if values["ECode"] else self._failsafes.discard)(subsystem)
        return ()

    # --- where it is

    def _on_xkf1(self, values: Values, boot_us: int) -> Iterable[Message]:
        velocity = (values["VN"], values["VE"], values["VD"])
        self._velocities[values.get("C", 0)] = (boot_us, *velocity)
        return ()

    def _on_att(self, values: Values, _: int) -> Iterable[Message]:
        self._yaw_deg = values["Yaw"]
        return ()

    def _on_pos(self, values: Values, boot_us: int) -> Iterator[Message]:
        """GLOBAL_POSITION_INT of POS, or of GPS; none without a velocity of the same moment."""
        velocity = self._velocities.get(self._core if self._has_velocity else _GPS)
        if velocity is None or boot_us - velocity[0] > _FRESH_US:
            return
        above_m = values.get("RelHomeAlt", 0.0)
        if not self._has_position and self._home_alt_m is not None:
            above_m = values["Alt"] - self._home_alt_m
        if self._pace.is_due("position", boot_us):
            heading = _NO_HEADING if self._yaw_deg is None else round(self._yaw_deg * 100) % 36000
            yield wire.MAVLink_global_position_int_message(
                boot_ms(boot_us),
                *_degrees_e7(values),
                round(values["Alt"] * 1e3),
                round(above_m * 1e3),
                *(round(each * 100) for each in velocity[1:]),
                heading,
            )

    def _on_orgn(self, values: Values, boot_us: int) -> Iterator[Message]:
        place = (*_degrees_e7(values), round(values["Alt"] * 1e3))
        if values["Type"] == 0:
            yield wire.MAVLink_gps_global_origin_message(*place, boot_us)
        elif values["Type"] == 1:
            self._home_alt_m = values["Alt"]
            q = [1.0, 0.0, 0.0, 0.0]
            yield wire.MAVLink_home_position_message(*place, 0, 0, 0, q, 0, 0, 0, boot_us)

    # --- how well it knows

    def _on_gps(self, values: Values, boot_us: int) -> Iterator[Message]:
        if values.get("I", 0) != 0:
            return
        speed, course = values["Spd"], values["GCrs"]
        accuracy = self._accuracy
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
            alt_ellipsoid=round(accuracy.get("AEl", accuracy.get("AE", 0.0)) * 1e3),
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
            yield from self._on_pos(values, boot_us)

    def _on_gpa(self, values: Values, _: int) -> Iterable[Message]:
        if values.get("I", 0) == 0:
            self._accuracy = values
        return ()

    def _on_xkf4(self, values: Values, boot_us: int) -> Iterator[Message]:
        """EKF_STATUS_REPORT of the primary core's XKF4."""
        self._core = max(values.get("PI", 0), 0)
        if values.get("C", 0) != self._core or not self._pace.is_due("estimator", boot_us):
            return
        status = values["SS"]
        flags = sum(flag for bit, flag in _FLAGS if status & bit)
        ready = status & _INITIALISED if status >= _INITIALISED else status & wire.EKF_ATTITUDE
        if not ready:
            flags |= wire.EKF_UNINITIALIZED
        variances = (values["SV"], values["SP"], values["SH"], values["SM"])
        yield wire.MAVLink_ekf_status_report_message(
            flags, *variances, 0.0, airspeed_variance=values["SVT"]
        )

    # --- the rest

    def _on_bat(self, values: Values, boot_us: int) -> Iterator[Message]:
        """SYS_STATUS; without RemPct, of what was used and BATT_CAPACITY, as ArduPilot reckons."""
        instance = values.get("Inst", values.get("Instance", values.get("I", 0)))
        if instance != 0 or not self._pace.is_due("battery", boot_us):
            return
        percent, full_mah = values.get("RemPct"), self._capacity_mah
        if percent is None:
            left_mah = full_mah - values.get("CurrTot", 0.0)
            percent = whole(100 * left_mah / full_mah, 0, 100) if full_mah > 0 else -1
        elif not 0 <= percent <= 100:
            percent = -1
        yield battery(values["Volt"], values.get("Curr", 0.0), percent)

    def _on_parm(self, values: Values, _: int) -> Iterator[Message]:
        name, value = values["Name"], values["Value"]
        if name == "BATT_CAPACITY" and math.isfinite(value):
            self._capacity_mah = value
        yield parameter(name, value)

    def _on_msg(self, values: Values, _: int) -> Iterable[Message]:
        self._texts = self._texts % 0xFFFF + 1
        return texts(values["Message"], wire.MAV_SEVERITY_INFO, self._texts)


def _degrees_e7(values: Values) -> tuple[int, int]:
    """Latitude and longitude."""
    return round(values["Lat"] * 1e7), round(values["Lng"] * 1e7)


ROWS: Final = frozenset(name[4:].upper() for name in vars(_Messages) if name.startswith("_on_"))
"""Names of the entries that are translated."""
