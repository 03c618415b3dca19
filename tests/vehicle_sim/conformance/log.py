"""A recorded flight: who said what, at which vehicle time.

A .tlog is a sequence of records: 8 bytes of big-endian microseconds since 1970, then one raw
MAVLink frame; both directions, in time order (tests/recordings/README.md).
"""

import functools
import io
import itertools
import lzma
import math
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.errors import InputError

# --- Frames into messages: pymavlink's dialect `all` ------------------------------------------

_AUTOPILOT = 1


class TimedFrame(NamedTuple):
    """A frame, and when it was on the wire."""

    time_s: float
    number: int
    """Of the message."""
    system: int
    component: int
    frame: bytes


def decoded(heard: TimedFrame) -> Any:
    """Decode a frame; MAVLink_unknown for an unknown message."""
    # A decoder of its own for each frame would cost more than the decoding.
    return _DECODER.decode(bytearray(heard.frame))


_DECODER = mavlink.MAVLink(None)


def message_name(number: int) -> str:
    """What the protocol calls it."""
    known = mavlink.mavlink_map.get(number)
    return known.msgname if known else f"message {number}"


def enum_name(enum: str, value: int) -> str:
    """The short name of a value, or the number where it has none."""
    entry = mavlink.enums.get(enum, {}).get(value)
    return str(value) if entry is None else entry.name.removeprefix(f"{enum}_")


@final
class Side:
    """One side of the comparison: everything that one autopilot said, by message.

    Of other components of the vehicle only that they speak at all.
    """

    def __init__(self, said: Iterable[TimedFrame]) -> None:
        self._by_number = dict[int, list[TimedFrame]]()
        self.speakers = set[tuple[int, int]]()
        """System and component ids of all senders."""
        for h in said:
            self.speakers.add((h.system, h.component))
            if h.component == _AUTOPILOT:
                self._by_number.setdefault(h.number, []).append(h)
        self._decoded = dict[int, list[tuple[float, Any]]]()

    @property
    def numbers(self) -> frozenset[int]:
        """Of all messages that it said."""
        return frozenset(self._by_number)

    def heard(self, number: int) -> Sequence[TimedFrame]:
        """Every frame of this message."""
        return self._by_number.get(number, ())

    def of(self, number: int) -> Sequence[tuple[float, Any]]:
        """Every message of this number, decoded, with its time in seconds."""
        if number not in self._decoded:
            self._decoded[number] = [(h.time_s, decoded(h)) for h in self.heard(number)]
        return self._decoded[number]

    def some(self, number: int, most: int) -> Sequence[tuple[float, Any]]:
        """At most so many of them, evenly spread."""
        all_of = self.heard(number)
        every = max(1, -(-len(all_of) // most))
        if number in self._decoded:
            return self._decoded[number][::every]
        return [(h.time_s, decoded(h)) for h in all_of[::every]]


# --- Log time and vehicle time: one piecewise line between them, from the vehicle's own stamps

_BIN_S = 1.0


@final
class Clock:
    """Seconds since the first record of a log <-> seconds since the autopilot's boot.

    A stamp is never older than its record, but it may have waited on the way.  So in each second
    of the log the stamp that waited least counts.  Before the first and after the last stamp the
    vehicle's clock is taken to run at the log's rate.
    """

    def __init__(self, stamps: Iterable[tuple[float, float]]) -> None:
        """Pairs of log time and the vehicle time that the record carries, in seconds."""
        best = dict[int, tuple[float, float]]()
        for log_s, vehicle_s in stamps:
            number = int(log_s // _BIN_S)
            known = best.get(number)
            if known is None or vehicle_s - log_s > known[1] - known[0]:
                best[number] = (log_s, vehicle_s)
        knots = sorted(best.values()) or [(0.0, 0.0)]
        self._log_s = np.array([k[0] for k in knots])
        self._vehicle_s = np.maximum.accumulate(np.array([k[1] for k in knots]))

    def vehicle_s(self, log_s: float) -> float:
        """Vehicle time at this log time."""
        return _along(log_s, self._log_s, self._vehicle_s)

    def log_s(self, vehicle_s: float) -> float:
        """Log time at this vehicle time."""
        return _along(vehicle_s, self._vehicle_s, self._log_s)


def _along(x: float, knots: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    if x <= knots[0]:
        return float(values[0] + (x - knots[0]))
    if x >= knots[-1]:
        return float(values[-1] + (x - knots[-1]))
    return float(np.interp(x, knots, values))


_V1, _V2 = 0xFE, 0xFD
_SIGNED = 0x01
_HEARTBEAT, _GPS_RAW, _ATTITUDE, _ORIGIN, _HOME = 0, 24, 30, 49, 242
_STAMPED = {30, 32, 33}
"""ATTITUDE, LOCAL_POSITION_NED and GLOBAL_POSITION_INT begin with time_boot_ms."""
_ARDUPILOT, _PX4 = 3, 12
_FIXED_WING = 1
_ARMED = 0x80
_FIX_3D = 3


class Record(NamedTuple):
    """One record as it is in the file."""

    time_us: int
    """Since 1970."""
    frame: bytes


def records(stream: io.BufferedIOBase, name: str) -> Iterator[Record]:
    """All records of a .tlog, one after the other.  InputError if it is not one."""
    for number in itertools.count():
        head = stream.read(8)
        if not head:
            return
        start = stream.read(3)
        if len(head) < 8 or len(start) < 3:
            return  # the recorder was cut off: what is complete counts
        if start[0] not in (_V1, _V2):
            rule = f"record {number} does not begin with a MAVLink frame"
            raise InputError("LOG", name, rule, "Name a .tlog of MAVLink 1 or 2.")
        rest = start[1] + (5 if start[0] == _V1 else 9)
        if start[0] == _V2 and start[2] & _SIGNED:
            rest += 13
        tail = stream.read(rest)
        if len(tail) < rest:
            return
        yield Record(struct.unpack(">Q", head)[0], start + tail)


def heard(time_s: float, frame: bytes) -> TimedFrame:
    """A frame with its identity read from its head."""
    if frame[0] == _V1:
        return TimedFrame(time_s, frame[5], frame[3], frame[4], frame)
    number = frame[7] | frame[8] << 8 | frame[9] << 16
    return TimedFrame(time_s, number, frame[5], frame[6], frame)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where the vehicle stood before the flight."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    heading_deg: float


@final
@dataclass(frozen=True, kw_only=True)
class Recording:
    """One flight.  All times are seconds since the autopilot's boot."""

    name: str
    """Of the file, without folder and .xz."""
    firmware: Literal["ardupilot", "px4"]
    kind: Literal["copter", "plane"]
    system: int
    home: Place
    sent: tuple[TimedFrame, ...]
    """By the clients: everything that does not come from the autopilot."""
    said: tuple[TimedFrame, ...]
    """By the autopilot."""
    begin_s: float
    end_s: float
    clock: Clock = field(repr=False)

    @functools.cached_property
    def side(self) -> Side:
        """What the autopilot said, each message decoded once."""
        return Side(self.said)


def read_recording(path: Path) -> Recording:
    """The flight in this file, a .tlog or .tlog.xz.  InputError if there is none."""
    packed = path.suffix == ".xz"
    try:
        with lzma.open(path) if packed else path.open("rb") as stream:
            return recording(path.name.removesuffix(".xz"), records(stream, str(path)))
    except (OSError, EOFError, lzma.LZMAError) as error:
        rule = f"cannot be read ({getattr(error, 'strerror', error)})"
        raise InputError("LOG", str(path), rule, "Name a .tlog or .tlog.xz.") from None


def recording(name: str, of: Iterable[Record]) -> Recording:
    """The flight that these records tell of."""
    raw, epoch_us = list[TimedFrame](), None
    for time_us, frame in of:
        epoch_us = time_us if epoch_us is None else epoch_us
        raw.append(heard((time_us - epoch_us) * 1e-6, frame))
    heartbeat = _first_of_autopilot(raw)
    if heartbeat is None:
        rule = "no autopilot of ArduPilot or PX4 speaks in it"
        raise InputError("LOG", name, rule, "Name the recording of a flight.")
    identity = (heartbeat.system, heartbeat.component)
    clock = Clock(_stamps(raw, identity))
    timed = [h._replace(time_s=clock.vehicle_s(h.time_s)) for h in raw]
    said = tuple(h for h in timed if (h.system, h.component) == identity)
    message = decoded(heartbeat)
    return Recording(
        name=name,
        firmware="ardupilot" if message.autopilot == _ARDUPILOT else "px4",
        kind="plane" if message.type == _FIXED_WING else "copter",
        system=heartbeat.system,
        home=_home(said),
        sent=tuple(h for h in timed if (h.system, h.component) != identity),
        said=said,
        begin_s=timed[0].time_s,
        end_s=timed[-1].time_s,
        clock=clock,
    )


def _first_of_autopilot(raw: Iterable[TimedFrame]) -> TimedFrame | None:
    beats = (h for h in raw if h.number == _HEARTBEAT)
    return next((h for h in beats if decoded(h).autopilot in (_ARDUPILOT, _PX4)), None)


def _stamps(raw: Iterable[TimedFrame], identity: tuple[int, int]) -> Iterator[tuple[float, float]]:
    for h in raw:
        if h.number in _STAMPED and (h.system, h.component) == identity:
            at = 6 if h.frame[0] == _V1 else 10
            end = at + min(4, h.frame[1])  # MAVLink 2 leaves out zeros at the end
            yield h.time_s, int.from_bytes(h.frame[at:end], "little") * 1e-3


def _home(said: Iterable[TimedFrame]) -> Place:
    """From HOME_POSITION, or else the estimator's origin, or else the first fix."""
    found = dict[int, tuple[float, float, float]]()
    yaw_rad = 0.0
    for h in said:
        if h.number == _HEARTBEAT and decoded(h).base_mode & _ARMED:
            break  # it has stood still until now
        if h.number == _ATTITUDE:
            yaw_rad = decoded(h).yaw
        elif h.number in (_HOME, _ORIGIN) and h.number not in found:
            m = decoded(h)
            found[h.number] = (m.latitude / 1e7, m.longitude / 1e7, m.altitude / 1e3)
        elif h.number == _GPS_RAW and h.number not in found and decoded(h).fix_type >= _FIX_3D:
            m = decoded(h)
            found[h.number] = (m.lat / 1e7, m.lon / 1e7, m.alt / 1e3)
    place = found.get(_HOME) or found.get(_ORIGIN) or found.get(_GPS_RAW) or (0.0, 0.0, 0.0)
    return Place(
        latitude_deg=place[0],
        longitude_deg=place[1],
        altitude_amsl_m=place[2],
        heading_deg=math.degrees(yaw_rad) % 360.0,
    )
