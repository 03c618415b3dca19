"""Logs for tests: ArduPilot .bin files made of recorded flights, and ways to damage any file.

The .bin has the formats of ArduPilot 4.5 (AP_Logger's LogStructure.h), packed here by themselves.
"""

import math
import random
import struct
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

from companion.mavlink.dialect import Message, wire
from companion.mavlink.frames import Receiver
from companion.telemetry.logs import Log, Odd, Record, open_log
from companion.telemetry.logs.ulog import TOPICS

_GPS_EPOCH_S = 315_964_800
_LETTERS = {"n": "4s", "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I"}
_LETTERS |= {"L": "i", "M": "B"}
FORMATS = {
    "PARM": (64, "QNff", "TimeUS,Name,Value,Default"),
    "MSG": (65, "QZ", "TimeUS,Message"),
    "MODE": (66, "QMBB", "TimeUS,Mode,ModeNum,Rsn"),
    "ARM": (67, "QBIBB", "TimeUS,ArmState,ArmChecks,Forced,Method"),
    "EV": (68, "QB", "TimeUS,Id"),
    "ERR": (69, "QBB", "TimeUS,Subsys,ECode"),
    "POS": (70, "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt"),
    "GPS": (
        71,
        "QBBIHBcLLeffffB",
        "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U",
    ),
    "ATT": (73, "QccccCCCCB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF"),
    "XKF1": (74, "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH"),
    "XKF4": (75, "QBcccccfffHBIHb", "TimeUS,C,SV,SP,SH,SM,SVT,errRP,OFN,OFE,FS,TS,SS,GPS,PI"),
    "BAT": (76, "QBfffffcfBBB", "TimeUS,Inst,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res,RemPct,H,SH"),
    "ORGN": (77, "QBLLe", "TimeUS,Type,Lat,Lng,Alt"),
    "STAT": (78, "QBfBBBBBB", "TimeUS,isFlying,isFlyProb,Armed,Safety,Crash,Still,Stage,Hit"),
    "RCIN": (79, "QHHHH", "TimeUS,C1,C2,C3,C4"),
    "DSF": (81, "QIHIIII", "TimeUS,Dp,Blk,Bytes,FMn,FMx,FAv"),
}


def entry(name: str, *values: float | bytes) -> bytes:
    """One entry, as ArduPilot packs it: scaled columns in their own units."""
    number, letters, _ = FORMATS[name]
    form = "<" + "".join(_LETTERS.get(letter, letter) for letter in letters)
    scaled = [
        round(value * 100) if letter in "cCeE" and not isinstance(value, bytes) else value
        for letter, value in zip(letters, values, strict=True)
    ]
    return struct.pack("<BBB", 0xA3, 0x95, number) + struct.pack(form, *scaled)


def fmt_entries() -> bytes:
    """The FMT entries of all, and of FMT itself."""
    rows = {"FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"), **FORMATS}
    out = b""
    for name, (number, letters, columns) in rows.items():
        form = "<" + "".join(_LETTERS.get(letter, letter) for letter in letters)
        length = 3 + struct.calcsize(form)
        content = (number, length, name.encode(), letters.encode(), columns.encode())
        out += struct.pack("<BBB", 0xA3, 0x95, 128) + struct.pack("<BB4s16s64s", *content)
    return out


def messages_of(records: Iterable[Record]) -> list[tuple[int, Message]]:
    """What the records say, each with its time; frames that do not decode are left out."""
    receiver = Receiver()
    return [(each.time_us, m) for each in records for m in receiver.feed(each.frame)]


def opened(folder: Path, content: bytes, *, system_id: int | None = None) -> Log:
    """A log of these bytes."""
    path = folder / "log"
    path.write_bytes(content)
    return open_log(path, system_id=system_id)


def told(log: Log) -> list[Message]:
    """All that it says."""
    return [message for _, message in messages_of(log.records())]


def of(messages: list[Message], kind: str) -> list[Message]:
    """Those of a kind."""
    return [message for message in messages if message.get_type() == kind]


def counts(log: Log) -> dict[Odd, int]:
    """How often each oddity was met, as far as the log has been read."""
    return {odd: count for odd, count in log.odd.items() if count}


def bin_of(path: Path, *, most: int | None = None) -> bytes:
    """The .bin that the vehicle of a recorded .tlog might have written; of its first messages."""
    writer = _BinWriter()
    for _, message in messages_of(islice(open_log(path).records(), most)):
        if message.get_srcComponent() == wire.MAV_COMP_ID_AUTOPILOT1:
            writer.on_message(message)
    return fmt_entries() + b"".join(writer.rows)


class _BinWriter:
    """Messages to entries: the other way round than the reader, from ArduPilot's own sources."""

    def __init__(self) -> None:
        self.rows: list[bytes] = []
        self._boot_us = 0
        self._unix_us = 0
        self._last: dict[str, float] = {}
        self._add("RCIN", 1500, 1500, 1000, 1500)

    def _add(self, name: str, *values: float | bytes) -> None:
        self.rows.append(entry(name, self._boot_us, *values))

    def _changed(self, what: str, value: float) -> bool:
        before, self._last[what] = self._last.get(what), value
        return before != value

    def on_message(self, m: Message) -> None:
        if hasattr(m, "time_boot_ms"):
            self._boot_us = max(self._boot_us, m.time_boot_ms * 1000)
        match m.get_type():
            case "SYSTEM_TIME":
                self._unix_us = m.time_unix_usec - self._boot_us if m.time_unix_usec else 0
            case "HEARTBEAT":
                self._on_heartbeat(m)
            case "GLOBAL_POSITION_INT" if m.lat or m.lon:
                v = (m.vx * 0.01, m.vy * 0.01, m.vz * 0.01)
                self._add("XKF1", 0, 0, 0, m.hdg * 0.01, *v, *([0] * 8))
                self._add("XKF1", 1, 0, 0, 0, 99, 99, 99, *([0] * 8))  # another core, beside it
                self._add("POS", m.lat, m.lon, m.alt * 1e-3, m.relative_alt * 1e-3, 0)
            case "ATTITUDE":
                angles = [math.degrees(each) for each in (m.roll, m.pitch, m.yaw % math.tau)]
                self._add("ATT", 0, angles[0], 0, angles[1], 0, angles[2] % 360, 0, 0, 3)
            case "GPS_RAW_INT":
                self._on_gps(m)
            case "EKF_STATUS_REPORT":
                ready = 0 if m.flags & wire.EKF_UNINITIALIZED else 1 << 16
                status = (m.flags & 0x3FF) | (1 << 14 if m.flags & 0x8000 else 0) | ready
                variances = (m.velocity_variance, m.pos_horiz_variance, m.pos_vert_variance)
                told = (*variances, m.compass_variance, m.airspeed_variance)
                self._add("XKF4", 0, *told, 0, 0, 0, 0, 0, status, 0, 0)
                self._add("XKF4", 1, 9, 9, 9, 9, 9, 0, 0, 0, 0, 0, 0, 0, 0)
            case "SYS_STATUS":
                volt = m.voltage_battery * 1e-3
                told = (m.current_battery * 0.01, 0, 0, 20, 0, m.battery_remaining, 1, 100)
                self._add("BAT", 0, volt, volt, *told)
            case "HOME_POSITION":
                self._add("ORGN", 1, m.latitude, m.longitude, m.altitude * 1e-3)
            case "GPS_GLOBAL_ORIGIN":
                self._add("ORGN", 0, m.latitude, m.longitude, m.altitude * 1e-3)
            case "PARAM_VALUE":
                self._add("PARM", m.param_id.encode(), m.param_value, m.param_value)
            case "STATUSTEXT":
                self._add("MSG", m.text.encode("ascii", "replace"))
            case "EXTENDED_SYS_STATE" if self._changed("landed", m.landed_state):
                self._add("EV", 18 if m.landed_state == wire.MAV_LANDED_STATE_ON_GROUND else 28)

    def _on_heartbeat(self, m: Message) -> None:
        if "mode" not in self._last:
            word = b"ArduPlane" if m.type == wire.MAV_TYPE_FIXED_WING else b"ArduCopter"
            self._add("MSG", word + b" V4.5.7 (2598e9d4)")
        if self._changed("mode", m.custom_mode):
            self._add("MODE", m.custom_mode, m.custom_mode, 1)
        armed = bool(m.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED)
        if self._changed("armed", armed):
            self._add("ARM", int(armed), 0, 0, 0)
            self._add("EV", 10 if armed else 11)
        if self._changed("critical", m.system_status == wire.MAV_STATE_CRITICAL):
            self._add("ERR", 17, int(m.system_status == wire.MAV_STATE_CRITICAL))

    def _on_gps(self, m: Message) -> None:
        week, rest_s = 0, 0.0
        if self._unix_us and m.fix_type >= wire.GPS_FIX_TYPE_3D_FIX:
            gps_s = (self._unix_us + self._boot_us) * 1e-6 - _GPS_EPOCH_S + 18
            week, rest_s = int(gps_s // 604_800), gps_s % 604_800
        place = (m.lat, m.lon, m.alt * 1e-3)
        speed = (m.vel * 0.01, m.cog * 0.01, 0, 0)
        told = (m.fix_type, round(rest_s * 1e3), week, m.satellites_visible)
        self._add("GPS", 0, *told, min(m.eph * 0.01, 99), *place, *speed, 1)
        self._add("GPS", 1, 0, 0, 0, 0, 99, 0, 0, 0, *([0] * 4), 0)  # a second receiver


def ulg_messages(content: bytes) -> Iterator[bytes]:
    """The messages of a .ulg after its head of 16 bytes, each with its own: size, kind, content."""
    at = 16
    while at + 3 <= len(content):
        size = 3 + int.from_bytes(content[at : at + 2], "little")
        yield content[at : at + size]
        at += size


def ulg_of(path: Path, most: int) -> bytes:
    """Of a recorded .ulg the topics that are read, so many bytes of each, and 30 parameters."""
    content, parameters, left = path.read_bytes(), 0, dict[bytes, int]()
    out = content[:16]
    for message in ulg_messages(content):
        match message[2:3]:
            case b"F":
                wanted = message[3:].partition(b":")[0].decode() in TOPICS
            case b"A":
                wanted = message[6:].decode() in TOPICS
                left[message[4:6]] = most * wanted
            case b"D":
                wanted = left[message[3:5]] > 0
                left[message[3:5]] -= len(message)
            case b"P":
                parameters += 1
                wanted = parameters <= 30
            case kind:
                wanted = kind in (b"L", b"O")
        out += message * wanted
    return out


def damaged(content: bytes, chance: random.Random) -> bytes:
    """The same with some of what happens to files, once to six times over.

    Bytes that change, are missing or too many, cut off, pages of zeros or ones, something twice,
    numbers at their limits; or the beginning is missing.
    """
    out = bytearray(content)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 6))):
        at, size = chance.randrange(len(out) + 1), chance.choice((1, 1, 2, 8, 64, 300, 5000))
        new = chance.choice([
            b"", chance.randbytes(size), bytes(size), b"\xff" * size,
            out[max(0, at - size) : at], b"\x7f\xff\xff\xff", b"\x80",
        ])  # fmt: skip
        out[at : at + chance.choice((0, size, len(new), len(new), len(out)))] = new
        if chance.random() < 0.1:
            del out[: at // 4]
    return bytes(out)
