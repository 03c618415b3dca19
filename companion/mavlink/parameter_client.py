"""Reads, sets and goes on watching the autopilot's parameters, by name (mavlink.md 2.5).

Firmware releases rename parameters (`SYSID_THISMAV` is `MAV_SYSID`), so each is requested by all
its names at once; after an answer the other names are dropped.  A request for a parameter that does
not exist gets no answer, or PARAM_ERROR from autopilots that send it.
"""

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, final

from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mavlink.frames import payload_as_sent

MESSAGES: Final = (wire.MAVLINK_MSG_ID_PARAM_VALUE, wire.MAVLINK_MSG_ID_PARAM_ERROR)
ANSWER_S: Final = 0.5
"""Time-out of a request before it is repeated."""
_MAX_TRIES: Final = 5
_MAX_TRIES_LOSSY: Final = 10
"""On a link that has already lost an answer."""
_OUTSTANDING: Final = 6
"""Requests within ANSWER_S: less than 1 kB/s, so that a slow radio is not flooded."""
_FORMATS: Final = {
    wire.MAV_PARAM_TYPE_UINT8: "<B",
    wire.MAV_PARAM_TYPE_INT8: "<b",
    wire.MAV_PARAM_TYPE_UINT16: "<H",
    wire.MAV_PARAM_TYPE_INT16: "<h",
    wire.MAV_PARAM_TYPE_UINT32: "<I",
    wire.MAV_PARAM_TYPE_INT32: "<i",
}
"""Of whole numbers; everything else is a float."""


@final
@dataclass(slots=True)
class _Request:
    """A request without an answer yet: of a value, or to set it."""

    set_to: float | None = None
    on_wire: tuple[float, int] = (0.0, 0)
    """What it is set to as PARAM_SET has it, and its type."""
    is_echoed: bool = False
    """Whether it has said that it keeps what it was told: then the value is read back."""
    tries: int = 0
    """Without those during which the whole autopilot was silent."""
    asked_s: float = -math.inf


def decoded(message: Message, *, bytewise: bool) -> float:
    """The value in a PARAM_VALUE or PARAM_SET, by its own param_type."""
    form = _FORMATS.get(message.param_type) if bytewise else None
    if form is None:
        return float(message.param_value)
    raw = payload_as_sent(message, 4) or struct.pack("<f", message.param_value)
    return float(struct.unpack_from(form, raw)[0])


def encoded(value: float, kind: int, *, bytewise: bool) -> float:
    """What goes into param_value for a parameter of this type; struct.error: it does not fit."""
    form = _FORMATS.get(kind)
    if form is None:
        return value
    raw = struct.pack(form, round(value))
    return float(struct.unpack("<f", raw.ljust(4, b"\0"))[0]) if bytewise else float(round(value))


@final
class ParameterClient:
    """Requests some parameters of one autopilot and stores the values.  Sans-IO.

    After each message and each tick send what is returned.
    """

    def __init__(
        self, system_id: int, names: Iterable[Sequence[str]], *, bytewise: bool = False
    ) -> None:
        """names: of each parameter all the names that it may have, the usual one first."""
        self._to = system_id, AUTOPILOT_COMPONENT
        self._group_of = {name: tuple(group) for group in names for name in group}
        self._bytewise = bytewise
        self.values: dict[str, float] = {}
        """By the name that this autopilot has it under, in the autopilot's own unit."""
        self.failed_sets: dict[str, str] = {}
        """What could not be set, and why, in words."""
        self.version = 0
        """Rises whenever a value changes, or cannot be set: then judge again."""
        self.heard_s = -math.inf
        """When the autopilot was heard last: while it is silent nothing is taken for missing."""
        self._types: dict[str, int] = {}
        self._open: dict[str, _Request] = {}
        self._lossy = False
        self.restart()

    @property
    def is_done(self) -> bool:
        """Whether everything was read or is missing, and everything set is read back or failed."""
        return not self._open

    @property
    def waiting(self) -> tuple[str, ...]:
        """What has not been answered yet."""
        return tuple(self._open)

    def restart(self) -> None:
        """Request everything again: the autopilot has rebooted."""
        for known in (self.values, self.failed_sets, self._types):
            known.clear()
        self._open = {name: _Request() for name in self._group_of}
        self.version += 1

    def rebase_time(self, shift_s: float) -> None:
        """Shift all stored times by this much: the clock was replaced."""
        self.heard_s += shift_s
        for request in self._open.values():
            request.asked_s += shift_s

    def set(self, name: str, value: float) -> None:
        """Set a parameter that was read; the value is read back and compared.

        Failures are listed in `failed_sets` when `is_done`.
        """
        self.failed_sets.pop(name, None)
        kind = self._types[name]
        try:
            on_wire = encoded(value, kind, bytewise=self._bytewise), kind
            self._open[name] = _Request(value, on_wire)
        except struct.error:
            self._fail(name, f"{value:g} does not fit into its type")

    def _fail(self, name: str, why: str) -> None:
        self.failed_sets[name] = why
        self.version += 1

    # --- in -----------------------------------------------------------------------------------

    def on_message(self, message: Message, now_s: float) -> list[Message]:
        """Handle a message of the autopilot, requested or not."""
        if (message.get_srcSystem(), message.get_srcComponent()) != self._to:
            return []
        self.heard_s = now_s
        if (number := message.get_msgId()) not in MESSAGES:
            return []
        if number == wire.MAVLINK_MSG_ID_PARAM_ERROR:
            request = self._open.get(message.param_id)
            there_is_none = message.error == wire.MAV_PARAM_ERROR_DOES_NOT_EXIST
            if there_is_none and request is not None and request.set_to is None:
                del self._open[message.param_id]
        elif message.param_id in self._group_of:
            self._on_value(message)
        return self.on_time(now_s)

    def _on_value(self, message: Message) -> None:
        name, value = message.param_id, decoded(message, bytewise=self._bytewise)
        if not self._types:  # parameters are answered at all: tries count from here
            for waiting in self._open.values():
                waiting.tries = min(waiting.tries, 1)
        self._types[name] = message.param_type
        self.version += not _same(self.values.get(name), value)
        self.values[name] = value
        for other in self._group_of[name]:
            if other != name and other in self._open and self._open[other].set_to is None:
                del self._open[other]
        request = self._open.pop(name, None)
        if request is None:
            return
        if request.set_to is None:
            self._lossy = self._lossy or request.tries > 1
        elif not (request.tries and _same(self._as_kept(name, request.set_to), value)):
            self._open[name] = request
        elif not request.is_echoed:  # it says so, but does it keep it?
            self._open[name] = _Request(request.set_to, is_echoed=True)

    def _as_kept(self, name: str, value: float) -> float:
        return float(round(value)) if self._types[name] in _FORMATS else value

    # --- out ----------------------------------------------------------------------------------

    def on_time(self, now_s: float) -> list[Message]:
        """The requests that are due: new ones, and those whose answer has not come.

        What was asked for often enough is given up; but not while no parameter at all has been
        answered: then the link is down.
        """
        most = _MAX_TRIES_LOSSY if self._lossy else _MAX_TRIES
        due = []
        for name, request in list(self._open.items()):
            if now_s - request.asked_s < ANSWER_S:
                continue
            if self._types and request.tries >= most and self.heard_s > request.asked_s:
                del self._open[name]
                if request.set_to is not None:
                    was, value = f"{request.set_to:g}", f"{self.values[name]:g}"
                    self._fail(name, f"it was told {was} and says {value}")
            else:
                due.append((name, request))
        free = _OUTSTANDING - (len(self._open) - len(due))
        due.sort(key=lambda named: named[1].tries)
        asked = due[: max(free, 0)]
        for _, request in asked:
            request.tries = max(request.tries + int(self.heard_s > request.asked_s), 1)
            request.asked_s = now_s
        return [self._message(name, request) for name, request in asked]

    def _message(self, name: str, request: _Request) -> Message:
        key = name.encode("ascii", "replace")
        if request.set_to is None or request.is_echoed:
            return wire.MAVLink_param_request_read_message(*self._to, key, -1)
        return wire.MAVLink_param_set_message(*self._to, key, *request.on_wire)


def _same(one: float | None, other: float) -> bool:
    """Whether two values are the same float on the wire; what is not a number equals itself."""
    if one is None or math.isnan(one) or math.isnan(other):
        return one is not None and math.isnan(one) and math.isnan(other)
    return math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-30)
