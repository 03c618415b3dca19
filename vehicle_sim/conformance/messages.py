"""Frames into messages: pymavlink's dialect `all`, and the one that it lacks."""

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, final

from pymavlink.dialects.v20 import all as mavlink

EVENT = 410
_NAMES_LACKING = {
    8: "LINK_NODE_STATUS",
    380: "TIME_ESTIMATE_TO_TARGET",
    EVENT: "EVENT",
    411: "CURRENT_EVENT_SEQUENCE",
}
_EVENT = struct.Struct("<IIHBBB40s")
_V2_HEAD = 10
_AUTOPILOT = 1


class Heard(NamedTuple):
    """A frame, and when it was on the wire."""

    time_s: float
    number: int
    """Of the message."""
    system: int
    component: int
    frame: bytes


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class EventSaid:
    """EVENT (410) of PX4."""

    id: int
    log_levels: int
    arguments: bytes
    """Without the zeros at the end, which MAVLink 2 does not send."""


def decoded(heard: Heard) -> Any:
    """The message in a frame; MAVLink_unknown for one that nobody here knows."""
    if heard.number == EVENT:
        return _event(heard.frame)
    # A decoder of its own for each frame would cost more than the decoding.
    return _DECODER.decode(bytearray(heard.frame))


_DECODER = mavlink.MAVLink(None)


def _event(frame: bytes) -> EventSaid:
    payload = frame[_V2_HEAD : _V2_HEAD + frame[1]].ljust(_EVENT.size, b"\0")
    number, _, _, _, _, levels, arguments = _EVENT.unpack(payload[: _EVENT.size])
    return EventSaid(id=number, log_levels=levels, arguments=arguments.rstrip(b"\0"))


def message_name(number: int) -> str:
    """What the protocol calls it."""
    known = mavlink.mavlink_map.get(number)
    return known.msgname if known else _NAMES_LACKING.get(number, f"message {number}")


def enum_name(enum: str, value: int) -> str:
    """The short name of a value, or the number where it has none."""
    entry = mavlink.enums.get(enum, {}).get(value)
    return str(value) if entry is None else entry.name.removeprefix(f"{enum}_")


@final
class Side:
    """One side of the comparison: everything that one autopilot said, by message.

    Of other components of the vehicle only that they speak at all.
    """

    def __init__(self, said: Iterable[Heard]) -> None:
        self._by_number = dict[int, list[Heard]]()
        self.speakers = set[tuple[int, int]]()
        """System and component of everybody who said something."""
        for h in said:
            self.speakers.add((h.system, h.component))
            if h.component == _AUTOPILOT:
                self._by_number.setdefault(h.number, []).append(h)
        self._decoded = dict[int, list[tuple[float, Any]]]()

    @property
    def numbers(self) -> frozenset[int]:
        """Of all messages that it said."""
        return frozenset(self._by_number)

    def heard(self, number: int) -> Sequence[Heard]:
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
