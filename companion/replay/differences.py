"""What a replay and the recording have different: found, as values, and as text."""

import json
import traceback
from pathlib import Path
from typing import Any, Final, final

from msgspec import Struct

from companion.mavlink.dialect import Message
from companion.mavlink.frames import Receiver
from companion.printable import with_printable_texts

_SEQUENCE: Final = {0xFD: 4, 0xFE: 2}
"""Where a frame holds its sequence number, by its first byte: not compared, nor is the checksum."""
NOTHING: Final = "nothing"
"""Shown for a missing frame or entry."""
_SHOWN_BYTES: Final = 100


@final
class Difference(Struct, frozen=True):
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
        was, now = (v if v == NOTHING else repr(v) for v in (self.recorded, self.replayed))
        return f"t {self.t_s:.3f} s: {where}: recorded {was}, replayed {now}"


def frames_differ(time_s: float, recorded: bytes | None, frame: bytes | None) -> Difference | None:
    """The first field in which two frames differ, sequence numbers apart; None: they are equal.

    Either frame may be missing (None).
    """
    if recorded is not None and frame is not None:
        if recorded == frame or _compared(recorded) == _compared(frame):
            return None
        was, now = message_of(recorded), message_of(frame)
        if was is not None and now is not None and was.get_type() == now.get_type():
            # compared as they are shown: a NaN is the same as another
            fields = ((name, getattr(was, name), getattr(now, name)) for name in now.fieldnames)
            differ = (each for each in fields if repr(each[1]) != repr(each[2]))
            first = next(differ, ("header", recorded[:10].hex(), frame[:10].hex()))
            return Difference(time_s, now.get_type(), *first)
    return Difference(time_s, "frame", "message", name_of(recorded), name_of(frame))


def entries_differ(recorded: bytes, replayed: bytes, time_s: float, kind: str) -> Difference | None:
    """The first field in which two lines of a journal differ; None: at most their spelling does."""
    if recorded == replayed:
        return None
    try:
        was = with_printable_texts(json.loads(recorded))
    except (ValueError, RecursionError):
        was = None
    if not isinstance(was, dict):
        return Difference(time_s, "journal", "line", recorded[:_SHOWN_BYTES], kind)
    if was.get("kind") != kind:
        return Difference(time_s, "journal", "kind", was.get("kind"), kind)
    differs = values_differ(was, with_printable_texts(json.loads(replayed)))
    return None if differs is None else Difference(time_s, kind, *differs)


def values_differ(was: Any, now: Any, path: str = "") -> tuple[str, Any, Any] | None:
    """The first place where plain values differ, and both values; None: nowhere."""
    match was, now:
        case dict(), dict():
            parts = [
                (f"{path}.{key}".removeprefix("."), was.get(key, NOTHING), now.get(key, NOTHING))
                for key in {**was, **now}
            ]
        case (list() | tuple(), list() | tuple()) if len(was) == len(now):
            both = enumerate(zip(was, now, strict=True))
            parts = [(f"{path}[{index}]", old, new) for index, (old, new) in both]
        case _:
            return None if was == now else (path, was, now)
    found = (values_differ(old, new, inner) for inner, old, new in parts)
    return next((each for each in found if each is not None), None)


def _compared(frame: bytes) -> bytes:
    at = _SEQUENCE.get(frame[0], 0)
    return frame[:at] + frame[at + 1 : -2]


def message_of(frame: bytes) -> Message | None:
    """The message of a frame; None if it cannot be decoded."""
    return next(iter(Receiver().feed(frame)), None)


def name_of(frame: bytes | None) -> str:
    """The message name of a frame."""
    if frame is None:
        return NOTHING
    message = message_of(frame)
    return "frame" if message is None else str(message.get_type())


def place_of(error: Exception) -> str:
    """Where in the code it was raised."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(last.filename).stem}.{last.name}, line {last.lineno}"


# --- what a replay has found


@final
class Replayed(Struct, kw_only=True):
    """The result of a replay so far."""

    difference: Difference | None = None
    """The first one."""
    plans_differ: list[Difference] = []
    """Of each plan that was computed otherwise: the cost, or the first value that differs."""
    plans_excused: int = 0
    """How many of them another kernel had computed: the last bits of its results may differ."""
    starts: int = 0
    """How often the companion was started."""
    flown_by: str = ""  # the companion's version; empty: a log does not tell
    inputs: int = 0
    frames: int = 0
    """Frames, both ways, that were the same."""
    entries: int = 0
    unrecorded: int = 0
    """Frames and entries after the end of the recording: it was killed, or the disk was full."""
    torn: str = ""
    """Why it ended before the end of the file."""
    plans: int = 0
    plans_computed: int = 0
    ended_by: str = ""
    """The error that ended the flight's control loop; and where, if it ended the replay, too."""
    damaged: str = ""
    """What in the recording is not a valid input; nothing after it was replayed."""
    now_s: float = 0.0
    flown_s: float = 0.0
    """Vehicle time that was replayed, of all starts and boots together."""
    took_s: float = 0.0

    @property
    def differs(self) -> bool:
        """Whether a decision differs, or a plan of the same kernel."""
        return self.difference is not None or len(self.plans_differ) > self.plans_excused

    @property
    def is_identical(self) -> bool:
        """Whether all decisions and plans equal the recorded ones, and there were any."""
        return not self.differs and self.frames + self.entries > 0 and not self.damaged

    def __str__(self) -> str:
        speed = f", {self.flown_s / self.took_s:,.0f}x real time" if self.took_s > 0.0 else ""
        counted = f"{self.frames:,} frames, {self.entries:,} journal entries"
        if self.plans_computed:
            same = self.plans_computed - len(self.plans_differ)
            counted += f", {same} of {self.plans_computed} plans computed again"
        elif self.plans:
            counted += f"; {self.plans} plans taken as recorded"
        verdict = "not identical" if self.differs else "identical"
        if self.damaged and not self.differs:
            verdict = "identical up to there"
        lines = [
            (self.difference is not None, f"first difference at {self.difference}"),
            (True, f"the same: {counted} ({self.flown_s:,.1f} s of flight{speed})"),
            (self.entries and not self.frames, "no frame was compared: flight.tlog holds none"),
            (self.starts > 1, f"the companion was started {self.starts} times"),
            *((True, f"plans differ, the first at {each}") for each in self.plans_differ[:1]),
            (self.unrecorded, f"{self.unrecorded} frames and entries came after its end"),
            (self.ended_by, f"the flight ended with an error of the companion's: {self.ended_by}"),
            (self.torn, f"the recording ends early: {self.torn}"),
            (self.damaged, f"the recording is damaged from there on: {self.damaged}"),
            (True, verdict),
        ]
        return "\n".join(line for is_so, line in lines if is_so)
