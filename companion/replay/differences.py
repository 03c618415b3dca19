"""Compares a replay with the recording: frames and journal entries, one by one."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, final

from msgspec import Struct

from companion.mavlink.dialect import Message
from companion.mavlink.frames import Receiver
from companion.mavlink.link import Stamped
from companion.mission.entries import Entry
from companion.printable import with_printable_texts
from companion.sources.files import file_of_run
from companion.telemetry.inputs import is_hole
from companion.telemetry.run_folder import (
    LONGEST_RECORD,
    Records,
    journal_line,
    log_records,
    whole_records,
)

_SEQUENCE: Final = {0xFD: 4, 0xFE: 2}
"""Where a frame holds its sequence number, by its first byte: not compared, nor is the checksum."""
NOTHING: Final = "nothing"
"""Shown for a missing frame or entry."""
_LONGEST_LINE: Final = 2**24
_SHOWN_BYTES: Final = 100


@final
class Difference(Struct, frozen=True, kw_only=True):
    """The first difference between a replay and the recording."""

    t_s: float
    """Vehicle time."""
    what: str
    """The message or the kind of journal entry."""
    field: str
    recorded: Any
    replayed: Any

    def __str__(self) -> str:
        where = f"{self.what}.{self.field}" if self.field else self.what
        return (
            f"t {self.t_s:.3f} s: {where}: "
            f"recorded {_shown(self.recorded)}, replayed {_shown(self.replayed)}"
        )


def _shown(value: Any) -> str:
    return value if value == NOTHING else repr(value)


@final
class Recording:
    """The recorded frames and entries of a run folder, compared with a replay's in order."""

    def __init__(self, folder: Path) -> None:
        """InputError if there is nothing to compare with."""
        self.frames = self.entries = 0
        """How many were the same."""
        self.unrecorded = 0
        """How many came after the end of what was recorded: it was killed, or the disk full."""
        self._path = file_of_run(folder, "flight.tlog")
        journal = file_of_run(folder, "journal.jsonl")
        self._log, self._journal = Records(self._path), _Lines(journal)
        self._epoch_us: int | None = None
        self._has_ended = False

    def close(self) -> None:
        """Close the files."""
        self._log.close()
        self._journal.close()

    def begin_again(self) -> None:
        """The companion was restarted: its clock may differ."""
        self._epoch_us = None

    def first_difference(self, record: list[Stamped], journal: list[Entry]) -> Difference | None:
        """Compare the output of one run with the next records."""
        if self._epoch_us is not None and self._log.takes(
            b"".join(log_records(record, self._epoch_us))
        ):
            self.frames += len(record)
            record = []
        for time_s, frame in record:
            if (difference := self._frame_differs(time_s, frame)) is not None:
                return difference
        for entry in journal:
            if (difference := self._entry_differs(entry)) is not None:
                return difference
        return None

    def pass_over(self, frames: int) -> None:
        """Skip what the watchdog sent: this many frames, and one entry."""
        while frames > 0 and self._log.take() is not None:
            frames -= 1
        self._journal.take()

    def _stamp_us(self, time_s: float) -> int:
        """The stamp of a vehicle time; the first that is asked for is that of the next frame."""
        if self._epoch_us is None and (head := self._log.head) is not None:
            self._epoch_us = head[0] - _us(time_s)
        return (self._epoch_us or 0) + _us(time_s)

    def _frame_differs(self, time_s: float, frame: bytes) -> Difference | None:
        at_us = self._stamp_us(time_s)
        held = self._log.take()
        if held is None:
            self.unrecorded += 1
            return self._is_damaged(time_s, frame)
        time_us, recorded = held
        if (difference := frames_differ(time_s, recorded, frame)) is not None:
            return difference
        if time_us != at_us:
            was_s = time_s + (time_us - at_us) * 1e-6
            return _difference(time_s, name_of(frame), "time", was_s, time_s)
        self.frames += 1
        return None

    def _is_damaged(self, time_s: float, frame: bytes) -> Difference | None:
        """Whether the log ends here because the data after it is damaged; checked once."""
        if self._has_ended:
            return None
        self._has_ended, end = True, whole_records(self._path)
        left = self._path.stat().st_size - end
        if left <= LONGEST_RECORD or is_hole(self._path, end):
            return None
        what = f"{left:,} bytes that are no frames"
        return _difference(time_s, "flight.tlog", "", what, name_of(frame))

    def _entry_differs(self, entry: Entry) -> Difference | None:
        held = self._journal.take()
        if held is None:
            self.unrecorded += 1
            return None
        line = journal_line(entry)
        if held == line:
            self.entries += 1
            return None
        was, now = _entry_of(held), with_printable_texts(json.loads(line))
        time_s, kind = float(entry["t_s"]), str(entry["kind"])
        if was is None:
            return _difference(time_s, "journal", "line", held[:_SHOWN_BYTES], kind)
        if was.get("kind") != kind:
            return _difference(time_s, "journal", "kind", was.get("kind"), kind)
        if (differs := values_differ(was, now)) is None:  # written by an older companion
            self.entries += 1
            return None
        return _difference(time_s, kind, *differs)


def _difference(time_s: float, what: str, field: str, was: Any, now: Any) -> Difference:
    return Difference(t_s=time_s, what=what, field=field, recorded=was, replayed=now)


def _us(time_s: float) -> int:
    return round(time_s * 1e6)


@final
class _Lines:
    """The lines of a journal but for its headers, one by one, to the last whole one."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")

    def take(self) -> bytes | None:
        """The next one; None at the end."""
        line = self._file.readline(_LONGEST_LINE)
        while line.startswith(b'{"schema"') and line.endswith(b"\n"):
            line = self._file.readline(_LONGEST_LINE)
        return line if line.endswith(b"\n") or len(line) == _LONGEST_LINE else None

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _entry_of(line: bytes) -> dict[str, Any] | None:
    """Decode a journal entry; None if it is invalid."""
    try:
        entry = with_printable_texts(json.loads(line))
    except (ValueError, RecursionError):
        return None
    return entry if isinstance(entry, dict) else None


# --- where two of a kind differ


def _compared(frame: bytes) -> bytes:
    at = _SEQUENCE.get(frame[0], 0)
    return frame[:at] + frame[at + 1 : -2]


def name_of(frame: bytes | None) -> str:
    """The message name of a frame."""
    if frame is None:
        return NOTHING
    message = message_of(frame)
    return "frame" if message is None else str(message.get_type())


def message_of(frame: bytes) -> Message | None:
    """The message of a frame; None if it cannot be decoded."""
    return next(iter(Receiver().feed(frame)), None)


def frames_differ(time_s: float, recorded: bytes | None, frame: bytes | None) -> Difference | None:
    """The first field in which two frames differ, sequence numbers apart; None: they are equal.

    Either frame may be missing (None).
    """
    if recorded is None or frame is None:
        return _difference(time_s, "frame", "message", name_of(recorded), name_of(frame))
    if recorded == frame or _compared(recorded) == _compared(frame):
        return None
    was, now = message_of(recorded), message_of(frame)
    if was is None or now is None or was.get_type() != now.get_type():
        return _difference(time_s, "frame", "message", name_of(recorded), name_of(frame))
    pairs = ((name, getattr(was, name), getattr(now, name)) for name in now.fieldnames)
    # compared as they are shown: a NaN is the same as another
    differ = ((name, a, b) for name, a, b in pairs if repr(a) != repr(b))
    name, a, b = next(differ, ("header", recorded[:10].hex(), frame[:10].hex()))
    return _difference(time_s, now.get_type(), name, a, b)


def _values_differ(path: str, was: Any, now: Any) -> Iterator[tuple[str, Any, Any]]:
    """Where plain values differ: path, and both values."""
    if isinstance(was, dict) and isinstance(now, dict):
        for key in [*was, *(key for key in now if key not in was)]:
            inner = f"{path}.{key}" if path else str(key)
            yield from _values_differ(inner, was.get(key, NOTHING), now.get(key, NOTHING))
    elif isinstance(was, list | tuple) and isinstance(now, list | tuple) and len(was) == len(now):
        for index, (old, new) in enumerate(zip(was, now, strict=True)):
            yield from _values_differ(f"{path}[{index}]", old, new)
    elif was != now:
        yield path, was, now


def values_differ(was: Any, now: Any) -> tuple[str, Any, Any] | None:
    """The first place where plain values differ, and both values; None: nowhere."""
    return next(_values_differ("", was, now), None)
