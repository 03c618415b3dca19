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

MESSAGES: Final = (
    wire.MAVLINK_MSG_ID_PARAM_VALUE,
    wire.MAVLINK_MSG_ID_PARAM_ERROR,
    wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
)
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
_LARGEST_FLOAT: Final = 3.4028234663852886e38
_ERRORS: Final = {
    wire.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE: "it says that the value is out of range",
    wire.MAV_PARAM_ERROR_PERMISSION_DENIED: "it does not allow that",
    wire.MAV_PARAM_ERROR_READ_ONLY: "it can only be read",
}


@final
@dataclass(slots=True)
class _Request:
    """A request without an answer yet."""

    tries: int = 0
    """Without those during which the whole autopilot was silent."""
    asked_s: float = -math.inf

    def again(self, now_s: float, heard_s: float) -> None:
        """Asked (again) now; heard_s: when anything at all was heard last."""
        self.tries = max(self.tries + int(heard_s > self.asked_s), 1)
        self.asked_s = now_s


@final
@dataclass(slots=True)
class _ParameterSet:
    """A value to be set: first sent, then read back."""

    value: float
    ask: _Request
    acknowledged: bool = False
    """Whether the autopilot has echoed this value, so that only the read-back is missing."""


def decoded(message: Message, *, bytewise: bool) -> float:
    """The value in a PARAM_VALUE or PARAM_SET, by its own param_type."""
    form = _FORMATS.get(message.param_type) if bytewise else None
    if form is None:
        return float(message.param_value)
    raw = payload_as_sent(message, 4) or struct.pack("<f", message.param_value)
    (whole,) = struct.unpack_from(form, raw)
    return float(whole)


def encoded(value: float, kind: int, *, bytewise: bool) -> float:
    """What goes into param_value for a parameter of this type.

    OverflowError or ValueError if the type cannot hold it.
    """
    form = _FORMATS.get(kind)
    if form is None:
        return value
    whole = round(value)
    try:
        raw = struct.pack(form, whole)
    except struct.error as error:
        raise OverflowError(str(error)) from error
    if not bytewise:
        return float(whole)
    (as_float,) = struct.unpack("<f", raw.ljust(4, b"\0"))
    return float(as_float)


@final
class ParameterClient:
    """Requests some parameters of one autopilot and stores the values.  Sans-IO.

    After each message and each tick send what is returned.
    """

    def __init__(
        self, system_id: int, names: Iterable[Sequence[str]], *, bytewise: bool = False
    ) -> None:
        """names: of each parameter all the names that it may have, the usual one first."""
        self._system_id = system_id
        self._groups = tuple(tuple(group) for group in names)
        self._group_of = {name: group for group in self._groups for name in group}
        self._bytewise = bytewise
        self.values: dict[str, float] = {}
        """By the name that this autopilot has it under, in the autopilot's own unit."""
        self.missing: set[str] = set()
        """Usual names of what it does not have under any."""
        self.failed_sets: dict[str, str] = {}
        """What could not be set, and why, in words."""
        self.version = 0
        """Rises whenever a value changes: then judge again."""
        self._types: dict[str, int] = {}
        self._reads: dict[str, _Request] = {}
        self._sets: dict[str, _ParameterSet] = {}
        self._lossy = False
        self.heard_s = -math.inf
        """When the autopilot was heard last: while it is silent nothing is taken for missing."""
        self.restart()

    @property
    def is_done(self) -> bool:
        """Whether everything was read or is missing, and everything set is read back or failed."""
        return not self._reads and not self._sets

    @property
    def waiting(self) -> tuple[str, ...]:
        """What has not been answered yet."""
        return (*self._reads, *(name for name in self._sets if name not in self._reads))

    def restart(self) -> None:
        """Request everything again: the autopilot has rebooted."""
        self.values.clear()
        self.missing.clear()
        self.failed_sets.clear()
        self._types.clear()
        self._sets.clear()
        self._reads = {name: _Request() for group in self._groups for name in group}
        self.version += 1

    def rebase_time(self, shift_s: float) -> None:
        """Shift all stored times by this much: the clock was replaced."""
        self.heard_s += shift_s
        for ask in [*self._reads.values(), *(each.ask for each in self._sets.values())]:
            ask.asked_s += shift_s

    def set(self, name: str, value: float) -> None:
        """Set a parameter; the value is read back and compared.

        Failures are listed in `failed_sets` when `is_done`.
        """
        self.failed_sets.pop(name, None)
        if not (math.isfinite(value) and abs(value) <= _LARGEST_FLOAT):
            self.failed_sets[name] = f"{value} is no number that a parameter can have"
            return
        self._sets[name] = _ParameterSet(value=value, ask=_Request())
        if name not in self.values and name not in self._reads:
            self._reads[name] = _Request()  # its type has to be known

    # --- in -----------------------------------------------------------------------------------

    def on_message(self, message: Message, now_s: float) -> list[Message]:
        """Handle a message of the autopilot, requested or not."""
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source != (self._system_id, AUTOPILOT_COMPONENT):
            return []
        self.heard_s = now_s
        match message.get_type():
            case "PARAM_VALUE":
                self._on_value(message)
            case "PARAM_ERROR":
                self._on_error(message)
            case "AUTOPILOT_VERSION":
                self._on_version(message)
            case _:
                return []
        return self.on_time(now_s)

    def _on_value(self, message: Message) -> None:
        name = message.param_id
        if name not in self._group_of and name not in self._reads and name not in self._sets:
            return
        value = decoded(message, bytewise=self._bytewise)
        if not self._types:  # parameters are answered at all: tries count from here
            for ask in self._reads.values():
                ask.tries = min(ask.tries, 1)
        self._types[name] = message.param_type
        if name not in self.values or not _same(self.values[name], value):
            self.version += 1
        self.values[name] = value
        self._answered(name)
        setting = self._sets.get(name)
        if setting is None or setting.ask.tries == 0 or not self._kept(setting.value, name):
            return
        if setting.acknowledged:
            del self._sets[name]
        else:
            setting.acknowledged, setting.ask = True, _Request()

    def _answered(self, name: str) -> None:
        """Drop the requests for the other names of the same parameter."""
        group = self._group_of.get(name, (name,))
        self.missing.discard(group[0])
        for each in group:
            ask = self._reads.pop(each, None)
            if ask is not None and each == name and ask.tries > 1:
                self._lossy = True

    def _kept(self, asked: float, name: str) -> bool:
        if self._types[name] in _FORMATS:
            asked = float(round(asked))
        return _same(asked, self.values[name])

    def _on_error(self, message: Message) -> None:
        name, error = message.param_id, message.error
        if error == wire.MAV_PARAM_ERROR_DOES_NOT_EXIST:
            self._give_up_reading(name)
        elif name in self._sets and error in _ERRORS:
            self._fail(name, _ERRORS[error])

    def _on_version(self, message: Message) -> None:
        """If integers are encoded differently than assumed, request everything again."""
        as_bytes = message.capabilities & wire.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        cast = message.capabilities & wire.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
        bytewise = bool(as_bytes) or (self._bytewise and not cast)
        if bytewise != self._bytewise:
            self._bytewise = bytewise
            wanted = {name: setting.value for name, setting in self._sets.items()}
            self.restart()
            for name, value in wanted.items():
                self.set(name, value)

    # --- out ----------------------------------------------------------------------------------

    def on_time(self, now_s: float) -> list[Message]:
        """The requests that are due: new ones, and those whose answer has not come."""
        if self.is_done:
            return []
        self._look_at_tries(now_s)
        asks = self._asks()
        free = _OUTSTANDING - sum(1 for _, ask in asks if now_s - ask.asked_s < ANSWER_S)
        due = sorted(
            ((name, ask) for name, ask in asks if now_s - ask.asked_s >= ANSWER_S),
            key=lambda each: each[1].tries,
        )
        messages = []
        for name, ask in due[: max(free, 0)]:
            ask.again(now_s, self.heard_s)
            messages.append(self._request(name))
        return [message for message in messages if message is not None]

    def _asks(self) -> list[tuple[str, _Request]]:
        """All open requests; a set waits until the parameter's type is known."""
        ready = [(name, each.ask) for name, each in self._sets.items() if name in self._types]
        return [*self._reads.items(), *ready]

    def _request(self, name: str) -> Message | None:
        setting = self._sets.get(name)
        key = name.encode("ascii", "replace")
        if setting is None or setting.acknowledged or name in self._reads:
            return wire.MAVLink_param_request_read_message(
                self._system_id, AUTOPILOT_COMPONENT, key, -1
            )
        kind = self._types[name]
        try:
            value = encoded(setting.value, kind, bytewise=self._bytewise)
        except (OverflowError, ValueError):
            self._fail(name, f"{setting.value:g} does not fit into its type")
            return None
        return wire.MAVLink_param_set_message(
            self._system_id, AUTOPILOT_COMPONENT, key, value, kind
        )

    def _look_at_tries(self, now_s: float) -> None:
        """Give up requests after the last retry.

        While no parameter at all has been answered the link is down, and none is given up.
        """
        most = _MAX_TRIES_LOSSY if self._lossy else _MAX_TRIES
        for name, ask in list(self._reads.items()):
            if self._types and self._is_over(ask, most, now_s):
                self._give_up_reading(name)
        for name, setting in list(self._sets.items()):
            if self._is_over(setting.ask, most, now_s):
                self._fail(name, f"it was told {setting.value:g} and says {self.values[name]:g}")

    def _is_over(self, ask: _Request, most: int, now_s: float) -> bool:
        """Whether the last retry has timed out, and the autopilot has been heard since."""
        waited = now_s - ask.asked_s >= ANSWER_S
        return ask.tries >= most and waited and self.heard_s > ask.asked_s

    def _give_up_reading(self, name: str) -> None:
        if self._reads.pop(name, None) is None:
            return
        group = self._group_of.get(name, (name,))
        if not any(each in self._reads or each in self.values for each in group):
            self.missing.add(group[0])
        if name in self._sets:
            self._fail(name, "the autopilot does not have it")

    def _fail(self, name: str, why: str) -> None:
        self._sets.pop(name, None)
        self.failed_sets[name] = why


def _same(one: float, other: float) -> bool:
    """Whether two values are the same float on the wire; what is not a number equals itself."""
    if math.isnan(one) or math.isnan(other):
        return math.isnan(one) and math.isnan(other)
    return math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-30)
