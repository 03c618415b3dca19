"""The first difference between what was recorded and what a replay makes, named by its field."""

import json
from typing import Any, Final, final

from msgspec import Struct

from companion.mavlink.dialect import Message
from companion.mavlink.frames import Receiver

NOTHING: Final = "nothing"
"""Shown for a missing frame, entry or field."""
_SEQUENCE: Final = {0xFD: 4, 0xFE: 2}
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


def frames_differ(time_s: float, recorded: bytes | None, frame: bytes | None) -> Difference | None:
    """The first field in which two frames differ, sequence numbers apart; None: they are equal.

    Either frame may be missing (None).
    """
    if recorded == frame or (recorded and frame and _compared(recorded) == _compared(frame)):
        return None
    return _differ(time_s, ("frame", "message"), _of_frame(recorded), _of_frame(frame))


def entries_differ(time_s: float, recorded: bytes, replayed: bytes) -> Difference | None:
    """The first field in which two lines of a journal differ; None: at most their spelling does."""
    if recorded == replayed:
        return None
    return _differ(time_s, ("journal", "kind"), _of_line(recorded), _of_line(replayed))


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


def name_of(frame: bytes | None) -> str:
    """The message name of a frame."""
    return str(_of_frame(frame)[0])


_Described = tuple[Any, dict[str, Any]]
"""The kind of a frame or an entry, and its values."""


def _differ(
    time_s: float, kinds: tuple[str, str], was: _Described, now: _Described
) -> Difference | None:
    """kinds: how it is said that they are not even of the same kind."""
    if was[0] != now[0]:
        return Difference(time_s, *kinds, was[0], now[0])
    place = values_differ(was[1], now[1])
    return None if place is None else Difference(time_s, now[0], *place)


def _of_frame(frame: bytes | None) -> _Described:
    """The fields of a message, then its header: who sent it, and how long it is on the wire."""
    if frame is None:
        return NOTHING, {}
    message, header = message_of(frame), {"header": _compared(frame)[:_HEADER_BYTES].hex()}
    if message is None:
        return "frame", header
    return message.get_type(), {n: getattr(message, n) for n in message.fieldnames} | header


def _of_line(line: bytes) -> _Described:
    """The values of an entry; of a line that is none, its bytes as its kind."""
    try:
        entry = json.loads(line)
        return entry["kind"], entry
    except (ValueError, RecursionError, LookupError, TypeError):
        return line[:_SHOWN_BYTES], {}


def _compared(frame: bytes) -> bytes:
    at = _SEQUENCE.get(frame[0], 0)
    return frame[:at] + frame[at + 1 : -2]
