"""MAVLink frames as ground stations, routers and companions log them: .tlog.

It has 8 bytes before each frame: microseconds since 1970, big-endian (MAVProxy and pymavlink keep
the number of a link in the last two bits; Mission Planner's are out of order by some microseconds).
Of a computer that does not know the date they count from 1970 all the same.
"""

import re
from collections import Counter
from collections.abc import Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Final

from companion.errors import InputError
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, KINDS, wire
from companion.mavlink.frames import (
    LONGEST,
    find_marker,
    frame_extent,
    intact_end,
    number_of,
    payload_of,
    sender_of,
)
from companion.mavlink.signing import SECRETS, is_signed
from companion.telemetry.logs.log import YEAR_2100_US, Clock, Log, Odd, Record, earliest

_PORTION: Final = 1 << 20
"""Bytes that are read at a time: memory does not grow with a log."""
_STAMP: Final = 8
_AHEAD: Final = 2 * (_STAMP + LONGEST)
"""A record, and the one after it."""
_SAMPLE: Final = 200
"""Frames that tell whether there are stamps, and the first of them."""
_HEARTBEAT: Final = re.compile(
    rb"\xfd[\x06-\x09][\x00\x01]..[^\x00].\x00\x00\x00|\xfe\x09.[^\x00].\x00", re.DOTALL
)
"""Of any component, in either protocol."""
_NO_AUTOPILOTS: Final = (wire.MAV_TYPE_GCS, wire.MAV_TYPE_ONBOARD_CONTROLLER)


def opened(path: Path) -> Log | None:
    """A log of MAVLink frames; None: there is none in it.  InputError: they have no time stamps."""
    framed = (record for record in _framed(path, Counter()) if number_of(record[1]) in KINDS)
    stamps = [stamp for stamp, _ in islice(framed, _SAMPLE)]
    autopilots, elsewhere = _autopilots_of(path)
    times_us = [int.from_bytes(stamp) for stamp in stamps if len(stamp) == _STAMP]
    if not stamps:
        return None
    if 2 * len(times_us) < len(stamps):
        remedy = "Give the .tlog that was written beside it."
        raise InputError("log", str(path), "its messages have no time stamps", remedy)
    start_us = earliest([time_us for time_us in times_us if time_us < YEAR_2100_US])
    return Log(
        kind="tlog",
        path=path,
        autopilots=autopilots,
        read=partial(_records, start_us),
        elsewhere=elsewhere,
    )


def _records(start_us: int, log: Log) -> Iterator[Record]:
    """All frames, but those of other vehicles and those with secrets; start_us: the first stamp."""
    odd = log.odd
    clock = Clock(odd, start_us=start_us, last_us=YEAR_2100_US)
    others = frozenset(log.systems) - {log.system_id}
    for stamp, frame in _framed(log.path, odd):
        number, (system, component) = number_of(frame), sender_of(frame)
        if len(stamp) == _STAMP:
            clock.read(int.from_bytes(stamp))
        else:
            odd[Odd.NO_STAMP] += 1
        odd[Odd.UNKNOWN] += number not in KINDS
        if system in others:
            odd[Odd.OTHER_VEHICLE] += 1
        elif number in SECRETS:
            odd[Odd.SECRET] += 1
        else:
            odd[Odd.SIGNED] += is_signed(frame)
            if component == AUTOPILOT_COMPONENT and log.system_id in (None, system):
                log.heard.add(number)
            yield Record(clock.now_us, frame)


def _autopilots_of(path: Path) -> tuple[dict[int, int], frozenset[tuple[int, int]]]:
    """MAV_AUTOPILOT by system id of all autopilots, and those that are not component 1."""
    autopilots, elsewhere = dict[int, int](), set[tuple[int, int]]()
    data = b""
    with path.open("rb") as file:
        while portion := file.read(_PORTION):
            data = data[-LONGEST:] + portion
            for match in _HEARTBEAT.finditer(data):
                frame = data[match.start() : intact_end(data, match.start())]
                payload = payload_of(frame, 9) if frame else bytes(9)
                is_autopilot = payload[5] != wire.MAV_AUTOPILOT_INVALID
                if not frame or payload[4] in _NO_AUTOPILOTS or not is_autopilot:
                    continue
                system, component = sender_of(frame)
                if component == AUTOPILOT_COMPONENT:
                    autopilots.setdefault(system, payload[5])
                else:
                    elsewhere.add((system, component))
    return autopilots, frozenset(elsewhere)


# --- frames in the bytes of a file


def _framed(path: Path, odd: Counter[Odd]) -> Iterator[tuple[bytes, bytes]]:
    """Stamps and frames of a file in order, in bounded memory; what is passed over is counted.

    OSError if it cannot be read, or nothing is in it any more.
    A stamp is what stands before a frame, since the last one: 8 bytes at most.  Of frames whose
    kind is not known the checksum is not, either.  One wrong byte costs two frames at most.
    """
    data, at, more = b"", 0, True
    if not path.stat().st_size:
        raise OSError("it is empty")
    with path.open("rb") as file:
        while more or at < len(data):
            if more and at + _AHEAD > len(data):
                portion = file.read(_PORTION)
                data, at, more = data[at:] + portion, 0, bool(portion)
                continue
            begin = at + _STAMP
            if end := intact_end(data, begin) or _unknown_end(data, begin):
                yield data[at:begin], data[begin:end]
                at = end
                continue
            until = len(data) - LONGEST if more else len(data)  # beyond, more may be needed
            frame_at, end = _next_intact(data, at, until)
            stamp = data[max(at, frame_at - _STAMP) : frame_at] if end else b""
            after = frame_at - (_STAMP if len(stamp) == _STAMP else 0)
            if more and not end:
                after -= _STAMP  # the stamp of the next one may be among the last bytes
            if _may_begin(data, begin) and frame_extent(data, begin)[0] == after:
                odd[Odd.CHECKSUM] += 1
            else:
                is_cut = not (more or end) and after - at < _STAMP + LONGEST
                odd[Odd.CUT_SHORT if is_cut else Odd.GARBAGE] += after - at
            if end:
                yield stamp, data[frame_at:end]
            at = end or after


def _unknown_end(data: bytes, at: int) -> int:
    """End of what may be a frame of an unknown kind, if another seems to follow it; else 0."""
    if not _may_begin(data, at):
        return 0
    end, number, _ = frame_extent(data, at)
    is_one = number is not None and number not in KINDS and end <= len(data)
    return end if is_one and (end == len(data) or _may_begin(data, end + _STAMP)) else 0


def _next_intact(data: bytes, at: int, until: int) -> tuple[int, int]:
    """Where the next intact frame begins and ends; an end of 0: none begins before `until`."""
    while (marker := find_marker(data, at)) is not None and marker.start() < until:
        at = marker.start()
        if end := intact_end(data, at):
            return at, end
        at += 1
    return until, 0


def _may_begin(data: bytes, at: int) -> bool:
    """Whether there is what a frame can begin with, as far as it can be told."""
    marker = find_marker(data, at, at + 3)
    return marker is not None and marker.start() == at
