"""MAVLink frames as ground stations, routers and companions log them: .tlog, .raw, .rlog.

A .tlog has 8 bytes before each frame: microseconds since 1970, big-endian.  What is known of those
who write it otherwise: MAVProxy and pymavlink keep the number of a link in the last two bits;
old QGroundControls wrote the stamps little-endian, and the time since boot without a clock;
Mission Planner's stamps are in steps of a millisecond, and out of order by some microseconds;
MAVProxy's .raw and Mission Planner's .rlog have no stamps.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple, final

from companion.mavlink.dialect import AUTOPILOT_COMPONENT, KINDS
from companion.mavlink.frames import LONGEST, V1, V2, boot_ms_of, frame_extent, intact_end
from companion.mavlink.signing import SECRETS, is_signed
from companion.telemetry.logs.anomalies import Anomaly, AnomalyCounter
from companion.telemetry.logs.record import Log, Record, chosen
from companion.telemetry.logs.search import STAMP_BYTES, find_intact
from companion.telemetry.logs.survey import Stamps, Survey, survey
from companion.telemetry.logs.timeline import YEAR_2000_US, YEAR_2100_US, Timeline
from companion.telemetry.logs.window import Window

_AHEAD: Final = STAMP_BYTES + LONGEST + STAMP_BYTES + LONGEST
"""A record, and the one after it."""
_ABOUT_STAMPS: Final = {
    Stamps.LITTLE_ENDIAN: (Anomaly.LITTLE_ENDIAN,),
    Stamps.MILLISECONDS: (Anomaly.MILLISECONDS,),
    Stamps.LITTLE_MILLISECONDS: (Anomaly.LITTLE_ENDIAN, Anomaly.MILLISECONDS),
    Stamps.SINCE_BOOT: (Anomaly.NO_DATE,),
    Stamps.SENSELESS: (Anomaly.NO_STAMPS,),
    Stamps.NONE: (Anomaly.NO_STAMPS,),
}


def open_tlog(path: Path, size_bytes: int, system_id: int | None) -> Log | None:
    """A log of MAVLink frames; None: there is none in it.

    InputError if it is not clear which vehicle is meant.
    """
    looked = survey(path)
    if looked is None:
        return None
    systems = tuple(sorted(looked.autopilots))
    vehicle = chosen(path, systems, system_id, looked.elsewhere)
    return Log(
        kind="tlog",
        path=path,
        size_bytes=size_bytes,
        systems=systems,
        system_id=vehicle,
        autopilot=looked.autopilots.get(vehicle or 0),
        begin=partial(_TlogReader, looked, vehicle),
        elsewhere=looked.elsewhere,
    )


class _Found(NamedTuple):
    """A place to go on from, in bytes of the file: the frame there, or if empty only the place."""

    begin: int
    end: int
    stamped: bool = True
    known: bool = True


@final
class _TlogReader:
    """One pass through a log; see `record.Reading`."""

    def __init__(
        self, looked: Survey, vehicle: int | None, findings: AnomalyCounter, heard: set[int]
    ) -> None:
        self._vehicle, self._findings, self._heard = vehicle, findings, heard
        self._others = frozenset(looked.autopilots) - {vehicle}
        self.byte = 0
        self._stamps = looked.stamps
        self._stamp_bytes = 0 if looked.stamps is Stamps.NONE else STAMP_BYTES
        self._by_vehicle = looked.stamps in (Stamps.NONE, Stamps.SENSELESS)
        self._boot_us = looked.boot_us or 0
        dated = not self._by_vehicle and looked.stamps is not Stamps.SINCE_BOOT
        self.timeline = Timeline(
            findings,
            first_us=YEAR_2000_US if dated else 0,
            last_us=YEAR_2100_US,
            start_us=looked.start_us,
            is_sure=not self._by_vehicle,
        )
        for oddity in _ABOUT_STAMPS.get(looked.stamps, ()):
            findings.note(oddity, 0, None)
        if self._by_vehicle and looked.boot_us is None:
            findings.note(Anomaly.NO_DATE, 0, None)

    def records(self, window: Window) -> Iterator[Record]:
        """All frames, but those of other vehicles and those with secrets."""
        at, stamp_bytes = 0, self._stamp_bytes
        while True:
            data = window.data
            if at + _AHEAD > len(data) and window.more(at):
                at = 0
                continue
            begin = at + stamp_bytes
            end = intact_end(data, begin)
            if end:
                record = self._record(data, begin, end, window.base)
            else:
                found = self._recover(window, at)
                if found is None:
                    break
                begin, end = found.begin - window.base, found.end - window.base
                record = None
                if begin < end:
                    record = self._record(
                        window.data,
                        begin,
                        end,
                        window.base,
                        stamped=found.stamped,
                        known=found.known,
                    )
            at = end
            if record is not None:
                self.byte = window.base + end
                yield record
        self.byte = window.base + len(window.data)

    def _record(
        self,
        data: bytes,
        begin: int,
        end: int,
        base: int,
        *,
        stamped: bool = True,
        known: bool = True,
    ) -> Record | None:
        """The frame there with its time; None: it is left out."""
        frame = data[begin:end]
        if frame[0] == V2:
            number = frame[7] | frame[8] << 8 | frame[9] << 16
            system, component = frame[5], frame[6]
        else:
            number, system, component = frame[5], frame[3], frame[4]
        if self._by_vehicle:
            time_us = self._by_clock(frame, number, (system, component), base + begin)
        elif stamped and self._stamp_bytes:
            stamp = data[begin - STAMP_BYTES : begin]
            time_us, _ = self.timeline.read(self._stamps.read(stamp), base + begin)
        else:
            self._findings.note(Anomaly.NO_STAMP, base + begin, self.timeline.now_us)
            time_us = self.timeline.last_us
        if not known:
            self._findings.note(Anomaly.UNKNOWN, base + begin, time_us)
        plain = frame[0] == V2 and not frame[2] and number not in SECRETS
        if (not plain or system in self._others) and self._is_left_out(
            frame, number, system, (base + begin, time_us)
        ):
            return None
        if component == AUTOPILOT_COMPONENT and self._vehicle in (None, system):
            self._heard.add(number)
        return Record(time_us, frame)

    def _is_left_out(self, frame: bytes, number: int, system: int, place: tuple[int, int]) -> bool:
        """Note a frame's anomalies; whether it is left out."""
        if system in self._others:
            self._findings.note(Anomaly.OTHER_VEHICLE, *place)
            return True
        if number in SECRETS:
            self._findings.note(Anomaly.SECRET, *place)
            return True
        if frame[0] == V1:
            self._findings.note(Anomaly.MAVLINK_1, *place)
        elif is_signed(frame):
            self._findings.note(Anomaly.SIGNED, *place)
        return False

    def _by_clock(self, frame: bytes, number: int, sender: tuple[int, int], byte: int) -> int:
        """The vehicle's clock, as it was told last."""
        is_ours = sender[1] == AUTOPILOT_COMPONENT and self._vehicle in (None, sender[0])
        boot_ms = boot_ms_of(frame, number) if is_ours else None
        if boot_ms is None:
            return self.timeline.last_us
        return self.timeline.read(self._boot_us + boot_ms * 1000, byte)[0]

    def _recover(self, window: Window, at: int) -> _Found | None:
        """Where to go on if no intact frame follows; None: the log has ended."""
        data, begin, now_us = window.data, at + self._stamp_bytes, self.timeline.now_us
        if at >= len(data):
            return None
        end, number = frame_extent(data, begin) if _may_begin(data, begin) else (0, None)
        whole = number is not None and end <= len(data)
        byte = window.base + at
        if whole:
            last, following = end == len(data), end + self._stamp_bytes
            place = (window.base + begin, window.base + end)
            if number not in KINDS:
                if last or _may_begin(data, following):
                    return _Found(*place, known=False)
            elif last or intact_end(data, following):
                self._findings.note(Anomaly.CHECKSUM, place[0], now_us)
                return _Found(place[1], place[1])
        cut_short = not whole and (end > len(data) or begin >= len(data))
        found = find_intact(window, byte)
        if found is None:
            rest = window.base + len(window.data) - byte
            oddity = Anomaly.CUT_SHORT if cut_short else Anomaly.GARBAGE
            self._findings.note(oddity, byte, now_us, rest)
            return None
        gap = found[0] - byte
        stamped = gap >= self._stamp_bytes
        if passed := gap - self._stamp_bytes if stamped else gap:
            self._findings.note(Anomaly.GARBAGE, byte, now_us, passed)
        return _Found(*found, stamped=stamped)


def _may_begin(data: bytes, at: int) -> bool:
    """Whether there is what a frame can begin with, as far as it can be told."""
    if at >= len(data):
        return False
    if data[at] == V2:
        return at + 2 >= len(data) or data[at + 2] <= 1
    return data[at] == V1
