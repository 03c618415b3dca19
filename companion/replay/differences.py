"""The first difference between what was recorded and what a replay makes, named by its field."""

import json
from typing import Any, Final, final

from msgspec import Struct

from companion.mavlink.dialect import Message
from companion.mavlink.frames import V1, V2, Receiver

NOTHING: Final = "nothing"
"""Shown for a missing field or error."""
_SEQUENCE: Final = {V2: 4, V1: 2}
"""Where a frame holds its sequence number, by its first byte: not compared, nor is the checksum."""
_HEADER_BYTES: Final = 9
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


def first_difference(time_s: float, recorded: bytes, replayed: bytes) -> Difference | None:
    """The first field in which two frames, or two lines of a journal, differ; None: they do not.

    Sequence numbers of frames may differ, and so may the spelling of a line.
    """
    if recorded == replayed or _compared(recorded) == _compared(replayed):
        return None
    is_frame = replayed[0] in _SEQUENCE
    (was_kind, was), (kind, now) = map(_of_frame if is_frame else _of_line, (recorded, replayed))
    if was_kind != kind:
        names = ("frame", "message") if is_frame else ("journal", "kind")
        return Difference(time_s, *names, was_kind, kind)
    place = values_differ(was, now)
    return None if place is None else Difference(time_s, kind, *place)


def values_differ(was: Any, now: Any, path: str = "") -> tuple[str, Any, Any] | None:
    """The first place where plain values differ, and both values; None: nowhere."""
    match was, now:
        case dict(), dict():
            keys = {**was, **now}
            parts = [(f".{key}", was.get(key, NOTHING), now.get(key, NOTHING)) for key in keys]
        case (list() | tuple(), list() | tuple()) if len(was) == len(now):
            parts = [(f"[{k}]", *both) for k, both in enumerate(zip(was, now, strict=True))]
        case _:  # a NaN is the same as another
            return None if was == now or repr(was) == repr(now) else (path, was, now)
    differences = (values_differ(old, new, (path + at).removeprefix(".")) for at, old, new in parts)
    return next((difference for difference in differences if difference is not None), None)


def message_of(frame: bytes) -> Message | None:
    """The message of a frame; None if it cannot be decoded."""
    return next(iter(Receiver().feed(frame)), None)


def name_of(frame: bytes) -> str:
    """The message name of a frame."""
    return str(_of_frame(frame)[0])


def _of_frame(frame: bytes) -> tuple[str, dict[str, Any]]:
    """The kind of a message, and its fields and header: who sent it, and how long it is."""
    message, header = message_of(frame), {"header": _compared(frame)[:_HEADER_BYTES].hex()}
    if message is None:
        return "frame", header
    return message.get_type(), {n: getattr(message, n) for n in message.fieldnames} | header


def _of_line(line: bytes) -> tuple[Any, dict[str, Any]]:
    """The kind of an entry, and its values; of a line that is none, its bytes as its kind."""
    try:
        entry = json.loads(line)
        return entry["kind"], entry
    except (ValueError, RecursionError, LookupError, TypeError):
        return line[:_SHOWN_BYTES], {}


def _compared(record: bytes) -> bytes:
    """What counts of a frame; a line as it is."""
    at = _SEQUENCE.get(record[0])
    return record if at is None else record[:at] + record[at + 1 : -2]
