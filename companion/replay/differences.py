"""Compares a replay with the recording: frames and journal entries, one by one."""

import json
from collections.abc import Generator, Iterator
from functools import partial
from itertools import chain, starmap
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
from companion.telemetry.run_folder import LONGEST_RECORD, Records, journal_line

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
        self._log = Records(self._path)
        self._lines = _entry_lines(file_of_run(folder, "journal.jsonl"))
        self._epoch_us: int | None = None
        """The stamp of vehicle time 0, by the first frame that is compared."""
        self._has_ended = False

    def close(self) -> None:
        """Close the files."""
        self._log.close()
        self._lines.close()

    def begin_again(self) -> None:
        """The companion was restarted: its clock may differ."""
        self._epoch_us = None

    def first_difference(self, record: list[Stamped], journal: list[Entry]) -> Difference | None:
        """Compare the output of one run with the next records."""
        found = chain(starmap(self._frame_differs, record), map(self._entry_differs, journal))
        return next((each for each in found if each is not None), None)

    def pass_over(self, frames: int) -> None:
        """Skip what the watchdog sent: this many frames, and one entry."""
        while frames > 0 and self._log.take() is not None:
            frames -= 1
        next(self._lines, None)

    def _frame_differs(self, time_s: float, frame: bytes) -> Difference | None:
        if (held := self._log.take()) is None:
            self.unrecorded += 1
            return self._is_damaged(time_s, frame)
        stamp_us, recorded = held
        if (difference := frames_differ(time_s, recorded, frame)) is not None:
            return difference
        at_us = round(time_s * 1e6)
        self._epoch_us = stamp_us - at_us if self._epoch_us is None else self._epoch_us
        if stamp_us != self._epoch_us + at_us:
            was_s = time_s + (stamp_us - self._epoch_us - at_us) * 1e-6
            return _difference(time_s, name_of(frame), "time", was_s, time_s)
        self.frames += 1
        return None

    def _is_damaged(self, time_s: float, frame: bytes) -> Difference | None:
        """Whether the log ends here because the data after it is damaged; checked once."""
        has_ended, self._has_ended = self._has_ended, True
        left = self._path.stat().st_size - self._log.end
        if has_ended or left <= LONGEST_RECORD or is_hole(self._path, self._log.end):
            return None
        what = f"{left:,} bytes that are no frames"
        return _difference(time_s, "flight.tlog", "", what, name_of(frame))

    def _entry_differs(self, entry: Entry) -> Difference | None:
        line, held = journal_line(entry), next(self._lines, None)
        if held is None:
            self.unrecorded += 1
            return None
        if held != line:
            was, now = _entry_of(held), with_printable_texts(json.loads(line))
            time_s, kind = float(entry["t_s"]), str(entry["kind"])
            if was is None:
                return _difference(time_s, "journal", "line", held[:_SHOWN_BYTES], kind)
            if was.get("kind") != kind:
                return _difference(time_s, "journal", "kind", was.get("kind"), kind)
            if (differs := values_differ(was, now)) is not None:  # else it is spelled otherwise
                return _difference(time_s, kind, *differs)
        self.entries += 1
        return None


def _difference(time_s: float, what: str, field: str, was: Any, now: Any) -> Difference:
    return Difference(t_s=time_s, what=what, field=field, recorded=was, replayed=now)


def _entry_lines(path: Path) -> Generator[bytes, None, None]:
    """The lines of a journal but for its headers, to the last whole one."""
    with path.open("rb") as file:
        for line in iter(partial(file.readline, _LONGEST_LINE), b""):
            if not line.endswith(b"\n") and len(line) < _LONGEST_LINE:
                return
            if not (line.startswith(b'{"schema"') and line.endswith(b"\n")):
                yield line


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
