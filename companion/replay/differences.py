"""What a replay did against what was recorded: frames and journal entries, one by one."""

import json
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from companion.errors import InputError
from companion.mavlink.dialect import Message
from companion.mavlink.outbox import Stamped
from companion.mavlink.receiver import Receiver
from companion.mission.entries import Entry
from companion.sources.files import answer
from companion.telemetry.run_folder import journal_line, recorded_frames

_SEQUENCE: Final = {0xFD: 4, 0xFE: 2}
"""Where a frame holds its sequence number, by its first byte: not compared, nor is the checksum."""
_ABSENT: Final = "nothing"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """Where a replay parts from the flight."""

    time_s: float
    """Vehicle time."""
    what: str
    """The message or the kind of journal entry."""
    field: str
    recorded: Any
    replayed: Any
    before: tuple[str, ...] = ()
    """What led there, oldest first."""

    def __str__(self) -> str:
        where = f"{self.what}.{self.field}" if self.field else self.what
        return (
            f"t {self.time_s:.3f} s: {where}: "
            f"recorded {_shown(self.recorded)}, replayed {_shown(self.replayed)}"
        )


def _shown(value: Any) -> str:
    return value if value == _ABSENT else repr(value)


@final
class Recording:
    """The frames and entries of a run folder, next to which a replay's are held as they come."""

    def __init__(self, folder: Path) -> None:
        """InputError if there is nothing to compare with."""
        for name in ("flight.tlog", "journal.jsonl"):
            if not answer((folder / name).is_file):
                remedy = "Give the run folder of a flight, whole."
                raise InputError("RUN_DIR", str(folder), f"it holds no {name}", remedy)
        self.frames = self.entries = 0
        """How many were the same."""
        self.unrecorded = 0
        """How many came after the end of what was recorded: it was killed, or the disk full."""
        self._log = recorded_frames(folder / "flight.tlog")
        self._journal = _entries(folder / "journal.jsonl")
        self._epoch_us: int | None = None

    def close(self) -> None:
        """Let go of the files."""
        self._log.close()
        self._journal.close()

    def begin_again(self) -> None:
        """The companion was started once more: its clock may be another."""
        self._epoch_us = None

    def first_difference(self, record: list[Stamped], journal: list[Entry]) -> Difference | None:
        """Hold what one run gave against what comes next."""
        for time_s, frame in record:
            if (difference := self._frame_differs(time_s, frame)) is not None:
                return difference
        for entry in journal:
            if (difference := self._entry_differs(entry)) is not None:
                return difference
        return None

    def pass_over(self, frames: int) -> None:
        """What the watchdog did by itself: so many frames, and one entry."""
        for _ in range(frames):
            next(self._log, None)
        next(self._journal, None)

    def _frame_differs(self, time_s: float, frame: bytes) -> Difference | None:
        held = next(self._log, None)
        if held is None:
            self.unrecorded += 1
            return None
        time_us, recorded = held
        at_us = round(time_s * 1e6)
        if self._epoch_us is None:
            self._epoch_us = time_us - at_us
        if (difference := frames_differ(time_s, recorded, frame)) is None:
            if time_us == self._epoch_us + at_us:
                self.frames += 1
                return None
            was_s = (time_us - self._epoch_us) * 1e-6
            return _difference(time_s, name_of(frame), "time", was_s, time_s)
        return difference

    def _entry_differs(self, entry: Entry) -> Difference | None:
        recorded = next(self._journal, None)
        if recorded is None:
            self.unrecorded += 1
            return None
        line = journal_line(entry)
        if recorded == line:
            self.entries += 1
            return None
        was, now = json.loads(recorded), json.loads(line)
        time_s, kind = float(entry["t_s"]), str(entry["kind"])
        if was.get("kind") != kind:
            return _difference(time_s, "journal", "kind", was.get("kind"), kind)
        field, old, new = next(_values_differ("", was, now), ("", was, now))
        return _difference(time_s, kind, field, old, new)


def _difference(time_s: float, what: str, field: str, was: Any, now: Any) -> Difference:
    return Difference(time_s=time_s, what=what, field=field, recorded=was, replayed=now)


def _entries(path: Path) -> Generator[bytes]:
    """The lines of a journal but for its headers, to the last whole one."""
    with path.open("rb") as file:
        for line in file:
            if line.endswith(b"\n") and not line.startswith(b'{"schema"'):
                yield line


# --- where two of a kind differ


def _compared(frame: bytes) -> bytes:
    at = _SEQUENCE.get(frame[0], 0)
    return frame[:at] + frame[at + 1 : -2]


def name_of(frame: bytes | None) -> str:
    """What a frame says, by its name."""
    if frame is None:
        return _ABSENT
    message = message_of(frame)
    return "frame" if message is None else str(message.get_type())


def message_of(frame: bytes) -> Message | None:
    """What a frame says; None: nothing that can be read."""
    return next(iter(Receiver().feed(frame)), None)


def frames_differ(time_s: float, recorded: bytes | None, frame: bytes | None) -> Difference | None:
    """The first field in which two frames differ; None: in none but the sequence number.

    Of two frames one may be None: then there is none.
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
            yield from _values_differ(inner, was.get(key, _ABSENT), now.get(key, _ABSENT))
    elif isinstance(was, list) and isinstance(now, list) and len(was) == len(now):
        for index, (old, new) in enumerate(zip(was, now, strict=True)):
            yield from _values_differ(f"{path}[{index}]", old, new)
    elif was != now:
        yield path, was, now


def values_differ(was: Any, now: Any) -> tuple[str, Any, Any] | None:
    """The first place where plain values differ, and both values; None: nowhere."""
    return next(_values_differ("", was, now), None)
