"""First pass over a log of MAVLink frames: its vehicles, and the meaning of its time stamps."""

import enum
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, final

from companion.mavlink.dialect import AUTOPILOT_COMPONENT, wire
from companion.mavlink.frames import LONGEST, intact_end, payload_of, sender_of
from companion.telemetry.logs.search import STAMP_BYTES, find_intact
from companion.telemetry.logs.timeline import YEAR_2000_US, YEAR_2100_US, earliest
from companion.telemetry.logs.window import Window

_SAMPLE: Final = 200
"""Frames that tell what the stamps are."""
_HEARTBEAT = re.compile(
    rb"\xfd[\x06-\x09][\x00\x01]..[^\x00].\x00\x00\x00|\xfe\x09.[^\x00].\x00", re.DOTALL
)
"""Of any component, in either protocol."""
_SYSTEM_TIME = re.compile(
    rb"\xfd[\x07-\x0c][\x00\x01]..[^\x00]\x01\x02\x00\x00|\xfe\x0c.[^\x00]\x01\x02", re.DOTALL
)
_NO_AUTOPILOTS = (wire.MAV_TYPE_GCS, wire.MAV_TYPE_ONBOARD_CONTROLLER)


class Stamps(enum.Enum):
    """The format of the time stamp before each frame."""

    MICROSECONDS = "microseconds since 1970, big-endian"
    LITTLE_ENDIAN = "microseconds since 1970, little-endian"
    MILLISECONDS = "milliseconds since 1970, big-endian"
    LITTLE_MILLISECONDS = "milliseconds since 1970, little-endian"
    SINCE_BOOT = "microseconds since something else, big-endian"
    SENSELESS = "eight bytes that are no time"
    NONE = "nothing: frame follows frame"

    def read(self, stamp: bytes) -> int:
        """Microseconds."""
        order: Literal["little", "big"] = "little" if self in _LITTLE else "big"
        return int.from_bytes(stamp, order) * (1000 if self in _MILLISECONDS else 1)


_LITTLE = (Stamps.LITTLE_ENDIAN, Stamps.LITTLE_MILLISECONDS)
_MILLISECONDS = (Stamps.MILLISECONDS, Stamps.LITTLE_MILLISECONDS)
_DATED = (
    Stamps.MICROSECONDS,
    Stamps.LITTLE_ENDIAN,
    Stamps.MILLISECONDS,
    Stamps.LITTLE_MILLISECONDS,
)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """Result of the first pass."""

    autopilots: dict[int, int]
    """System id -> MAV_AUTOPILOT, of all that send an autopilot's heartbeat, as component 1."""
    elsewhere: frozenset[tuple[int, int]]
    """System and component of what sends one as another component."""
    stamps: Stamps
    start_us: int
    """The earliest time of the log, microseconds since 1970, or since boot."""
    boot_us: int | None
    """When the vehicle booted, microseconds since 1970; only where there are no stamps."""


def survey(path: Path) -> Survey | None:
    """Look at a file; None: there is no intact MAVLink frame in it."""
    stamps, start_us = _stamps_of(path)
    if stamps is None:
        return None
    boot_us = None
    if stamps in (Stamps.NONE, Stamps.SENSELESS):
        boot_us = _boot_us(path)
        start_us = boot_us or 0
    autopilots, elsewhere = _autopilots_of(path)
    return Survey(
        autopilots=autopilots,
        elsewhere=elsewhere,
        stamps=stamps,
        start_us=start_us,
        boot_us=boot_us,
    )


def _stamps_of(path: Path) -> tuple[Stamps | None, int]:
    """What the stamps of the first frames mean, and the earliest; None: there is no frame."""
    before, gaps, values = 0, list[int](), list[bytes]()
    with Window(path) as window:
        while len(gaps) < _SAMPLE and (found := find_intact(window, before)) is not None:
            begin, end = found
            gaps.append(begin - before)
            if begin - before >= STAMP_BYTES:
                at = begin - window.base
                values.append(window.data[at - STAMP_BYTES : at])
            before = end
    if not gaps:
        return None, 0
    if gaps.count(0) > gaps.count(STAMP_BYTES):
        return Stamps.NONE, 0
    times = {kind: [kind.read(value) for value in values] for kind in _DATED}
    dated = {kind: [t for t in each if _is_date(t)] for kind, each in times.items()}
    best = max(_DATED, key=lambda kind: len(dated[kind]))
    if dated[best] and 2 * len(dated[best]) >= sum(1 for t in times[best] if t):
        return best, earliest(dated[best])
    small = [t for t in times[Stamps.MICROSECONDS] if 0 < t < YEAR_2000_US]
    if small and 2 * len(small) >= len(values):
        return Stamps.SINCE_BOOT, earliest(small)
    return Stamps.SENSELESS, 0


def _is_date(time_us: int) -> bool:
    return YEAR_2000_US <= time_us < YEAR_2100_US


def _autopilots_of(path: Path) -> tuple[dict[int, int], frozenset[tuple[int, int]]]:
    """As `Survey.autopilots` and `elsewhere`, anywhere in the file."""
    found, elsewhere = dict[int, int](), set[tuple[int, int]]()
    for frame in _frames(path, _HEARTBEAT):
        payload = payload_of(frame, 9)
        if payload[4] not in _NO_AUTOPILOTS and payload[5] != wire.MAV_AUTOPILOT_INVALID:
            system, component = sender_of(frame)
            if component == AUTOPILOT_COMPONENT:
                found.setdefault(system, payload[5])
            else:
                elsewhere.add((system, component))
    return found, frozenset(elsewhere)


def _boot_us(path: Path) -> int | None:
    """When the vehicle booted by the first SYSTEM_TIME that knows the date."""
    for frame in _frames(path, _SYSTEM_TIME):
        payload = payload_of(frame, 12)
        unix_us = int.from_bytes(payload[:8], "little")
        if _is_date(unix_us):
            return unix_us - int.from_bytes(payload[8:12], "little") * 1000
    return None


def _frames(path: Path, head: "re.Pattern[bytes]") -> Iterator[bytes]:
    """The intact frames that begin like this, anywhere in the file."""
    with Window(path) as window:
        while True:
            data = window.data
            for match in head.finditer(data):
                if frame := data[match.start() : intact_end(data, match.start())]:
                    yield frame
            if not window.more(max(len(data) - LONGEST, 0)):
                return
