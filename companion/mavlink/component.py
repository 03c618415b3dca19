"""The companion as a MAVLink component: its heartbeat, its version, and who may command it.

It identifies as an onboard controller, never as autopilot or ground station, and its heartbeat
stops when it is faulted (mavlink.md 2.1, C11).  Each command addressed to us, by system and
component, is answered once (mavlink.md 2.5).  Of broadcasts only questions are answered: a
broadcast MISSION_START or RETURN_TO_LAUNCH is meant for the autopilot.

No order takes long, so COMMAND_CANCEL is not supported.  Parameters that an order does not use are
ignored; those that it uses must be finite and in range, else it is denied with a text.  Sans-IO.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, final

from companion.geodesy import deg
from companion.mavlink.dialect import (
    AMSL_FRAMES,
    COMPANION_COMPONENT,
    HOME_FRAMES,
    Message,
    wire,
)
from companion.mission.changes import OrderResult
from companion.mission.events import Order, OrderKind
from companion.mission.mission import Mission
from companion.mission.state import Phase, State

COMMANDS: Final = (wire.MAVLINK_MSG_ID_COMMAND_LONG, wire.MAVLINK_MSG_ID_COMMAND_INT)
_HEARTBEAT: Final = wire.MAVLINK_MSG_ID_HEARTBEAT
_VERSION: Final = wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION
_BEAT_S: Final = 1.0
_SAME_S: Final = 5.0  # a command that comes again within this time may be the same one
_MAX_SENDERS: Final = 64
_NOT_GIVEN_E7 = 2**31 - 1
_AMSL_OR_HOME: Final = (*AMSL_FRAMES, *HOME_FRAMES)
"""Frames of a place whose height the companion may ignore."""
_CAPABILITIES: Final = (
    wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | wire.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
)
"""No parameters, mission, fence or rally points: those are the autopilot's; no files."""
_VERSION_FORM: Final = re.compile(r"(\d+)(?:\.(\d+))?(?:\.(\d+))?")
_Ids = tuple[int, int]
"""System and component id; 0 stands for any."""
Point = tuple[float, float]
"""North and east, metres."""
_ORDERS: Final = {
    wire.MAV_CMD_MISSION_START: OrderKind.START,
    wire.MAV_CMD_DO_PAUSE_CONTINUE: OrderKind.PAUSE,
    wire.MAV_CMD_DO_REPOSITION: OrderKind.REPOSITION,
    wire.MAV_CMD_NAV_RETURN_TO_LAUNCH: OrderKind.RETURN,
    wire.MAV_CMD_NAV_LAND: OrderKind.LAND,
}
"""Accepted from commanders only; questions are answered to anybody."""
_UNSUPPORTED_FRAME: Final = 9
"""MAV_RESULT_COMMAND_UNSUPPORTED_MAV_FRAME, newer than the dialect."""
_RESULT_WORDS: Final = {
    wire.MAV_RESULT_DENIED: "denied",
    wire.MAV_RESULT_UNSUPPORTED: "unsupported",
    _UNSUPPORTED_FRAME: "unsupported_mav_frame",
}
"""Of what is refused, as the journal has it."""
_RESULTS: Final = {
    OrderResult.ACCEPTED: wire.MAV_RESULT_ACCEPTED,
    OrderResult.INVALID: wire.MAV_RESULT_DENIED,
    OrderResult.NOT_NOW: wire.MAV_RESULT_TEMPORARILY_REJECTED,
}


class _RefusedError(Exception):
    """A command that is not carried out."""

    def __init__(self, text: str, result: int = wire.MAV_RESULT_DENIED) -> None:
        """text: why not, for the operator."""
        super().__init__(text)
        self.text, self.result = text, result


class Reply(NamedTuple):
    """The companion's reaction to a command."""

    replies: Sequence[Message] = ()
    """To be sent now."""
    order: Order | None = None
    """The order to carry out; `order_done` returns its ACK."""
    note: dict[str, Any] | None = None
    """For the journal."""
    text: str = ""
    """Reason for a refusal, as text for the operator; empty if there is none."""


@final
@dataclass(slots=True)
class _Given:
    """The last order of a sender."""

    message: Message
    order: Order
    result: int = wire.MAV_RESULT_IN_PROGRESS

    def is_repeated_by(self, message: Message, now_s: float) -> bool:
        """Whether a command repeats this order because its ACK was lost.

        COMMAND_LONG has a confirmation field.  COMMAND_INT has none: it counts as a repetition if
        the same order was accepted just before; a refused one may be retried.
        """
        same = _values(message) == _values(self.message)
        if not same or not 0.0 <= now_s - self.order.time_s <= _SAME_S:
            return False
        if not _is_int(message):
            return bool(message.confirmation > 0)
        return self.result in (wire.MAV_RESULT_ACCEPTED, wire.MAV_RESULT_IN_PROGRESS)


@final
class Component:
    """Commands and heartbeat of one companion.  Time is an argument."""

    def __init__(self, mission: Mission, system_id: int, version: str) -> None:
        self._own_ids = system_id, COMPANION_COMPONENT
        self._mission, self._version = mission, version
        self._beat_at_s = -math.inf
        self._asked: set[int] = set()
        """Messages of ours that somebody wants to have now."""
        self._given: dict[_Ids, _Given] = {}
        """By sender, the newest at the end."""

    def on_message(self, message: Message, now_s: float) -> Reply:
        """Handle a command of any sender; it may be addressed to another component."""
        sender = message.get_srcSystem(), message.get_srcComponent()
        target = message.target_system, message.target_component
        if sender == self._own_ids or not _matches(target, self._own_ids):
            return Reply()  # of a router that sends things back, or for others
        is_for_us, before = target == self._own_ids, self._given.get(sender)
        if is_for_us and before is not None and before.is_repeated_by(message, now_s):
            return Reply(replies=(_ack(message, before.result),))
        name = f"{sender[0]}/{sender[1]}"
        note = {"kind": "command", "sender": name, "command": message.command}
        try:
            order = self._read(message, name, now_s)
        except _RefusedError as refused:
            note |= {"result": _RESULT_WORDS[refused.result], "why": refused.text}
            answer = Reply((_ack(message, refused.result),), note=note, text=refused.text)
            return answer if is_for_us else Reply()
        if order is None:
            note |= {"result": "accepted", "why": ""}
            answered = (_ack(message, wire.MAV_RESULT_ACCEPTED),)
            return Reply(answered, note=note if is_for_us else None)
        if not is_for_us:  # of broadcasts no order is carried out
            return Reply()
        self._given.pop(sender, None)
        self._given[sender] = _Given(message, order)
        if len(self._given) > _MAX_SENDERS:
            del self._given[next(iter(self._given))]
        return Reply(order=order, note={**note, "order": order.kind.name.lower()})

    def order_done(self, order: Order, verdict: OrderResult) -> Sequence[Message]:
        """The ACK of an order that the mission machine has decided; empty if none is waited for."""
        for given in self._given.values():
            if given.order is order and given.result == wire.MAV_RESULT_IN_PROGRESS:
                given.result = _RESULTS[verdict]
                return (_ack(given.message, given.result),)
        return ()

    def _read(self, message: Message, sender: str, now_s: float) -> Order | None:
        """The order of a command; None of a question, whose answer is then due."""
        command, first = message.command, message.param1
        if command in (wire.MAV_CMD_REQUEST_MESSAGE, wire.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES):
            is_named = command == wire.MAV_CMD_REQUEST_MESSAGE
            if first not in ((_HEARTBEAT, _VERSION) if is_named else (1.0,)):
                raise _RefusedError("")
            self._asked.add(int(first) if is_named else _VERSION)
            return None
        if (kind := _ORDERS.get(command)) is None:
            raise _RefusedError("", wire.MAV_RESULT_UNSUPPORTED)
        ids = message.get_srcSystem(), message.get_srcComponent()
        if not any(_matches(commander, ids) for commander in self._mission.commanders):
            raise _RefusedError(f"{sender} may not command: see link.commanders")
        place_ne_m = None
        match kind:
            case OrderKind.START if not (math.isnan(first) or first == 0.0):
                raise _RefusedError("start: only from the first item, param1 = 0")
            case OrderKind.PAUSE if first not in (0.0, 1.0):
                raise _RefusedError("pause: param1 must be 0 (pause) or 1 (continue)")
            case OrderKind.PAUSE if first:
                kind = OrderKind.CONTINUE
            case OrderKind.LAND if any(
                at not in (0.0, _NOT_GIVEN_E7) and at == at for at in _xy(message)
            ):
                raise _RefusedError("land: it lands where it is; first DO_REPOSITION there")
            case OrderKind.REPOSITION:
                place_ne_m = self._place_ne_m(message)
            case _:
                pass
        return Order(time_s=now_s, kind=kind, target_ne_m=place_ne_m, sender=sender)

    def _place_ne_m(self, message: Message) -> Point:
        """Where a reposition goes; a height or speed that is given is ignored."""
        latitude, longitude = _xy(message)
        if _is_int(message):
            if message.frame not in _AMSL_OR_HOME:
                text = f"reposition: frame {message.frame} is not one of 0, 3, 5, 6"
                raise _RefusedError(text, _UNSUPPORTED_FRAME)
            latitude, longitude = deg(message.x), deg(message.y)
        on_earth = abs(latitude) <= 90.0 and abs(longitude) <= 180.0  # NaN is not
        if on_earth and not latitude == longitude == 0.0:
            north_m, east_m = self._mission.frame.to_local_m(latitude, longitude)
            limits = self._mission.task.limits
            (south, north), (west, east) = limits.north_m, limits.east_m
            if south <= north_m <= north and west <= east_m <= east:
                return north_m, east_m
        raise _RefusedError("reposition: give a place on the mission's map")

    # --- its own messages

    @property
    def due_s(self) -> float:
        """When `on_time` must be called next, at the latest."""
        return -math.inf if self._asked else self._beat_at_s + _BEAT_S

    def on_time(self, now_s: float, state: State, *, faulted: bool) -> list[Message]:
        """The messages that are due; no heartbeat while faulted or done."""
        messages, asked = list[Message](), self._asked
        is_due = not 0.0 <= now_s - self._beat_at_s < _BEAT_S  # also when a clock begins again
        if not faulted and (is_due or _HEARTBEAT in asked):
            self._beat_at_s = now_s
            messages.append(heartbeat(system_status(state)))
        if _VERSION in asked:
            number, none = version_number(self._version), [0] * 8  # no firmware, no board
            values = (_CAPABILITIES, number, 0, 0, 0, none, none, none, 0, 0, 0)
            messages.append(wire.MAVLink_autopilot_version_message(*values))
        self._asked = asked & {_HEARTBEAT} if faulted else set()
        return messages


def _is_int(message: Message) -> bool:
    return bool(message.get_msgId() == wire.MAVLINK_MSG_ID_COMMAND_INT)


def _xy(message: Message) -> tuple[float, float]:
    """Latitude and longitude of a command, in its own units: degrees, or 1e-7 of them."""
    return (message.x, message.y) if _is_int(message) else (message.param5, message.param6)


def _matches(pattern: _Ids, ids: _Ids) -> bool:
    """Whether ids fit a pattern, in which 0 stands for any."""
    return all(asked in (own, 0) for asked, own in zip(pattern, ids, strict=True))


def _values(message: Message) -> str:
    """All parameters but the confirmation, as text, since NaN does not equal itself."""
    return repr({**message.to_dict(), "confirmation": None})


def _ack(message: Message, result: int) -> Message:
    """The ACK of a command, for who gave it."""
    to = message.get_srcSystem(), message.get_srcComponent()
    return wire.MAVLink_command_ack_message(message.command, result, 0, 0, *to)


def heartbeat(status: int) -> Message:
    """HEARTBEAT with this MAV_STATE: an onboard controller without modes (minimal.xml)."""
    return wire.MAVLink_heartbeat_message(
        wire.MAV_TYPE_ONBOARD_CONTROLLER, wire.MAV_AUTOPILOT_INVALID, 0, 0, status, 3
    )


def system_status(state: State) -> int:
    """MAV_STATE: critical while it holds because of a fault."""
    if state.phase is Phase.WAITING:
        return int(wire.MAV_STATE_BOOT)
    if state.phase is Phase.HOLDING:
        warns = state.reason is None or state.reason.warns
        return int(wire.MAV_STATE_CRITICAL if warns else wire.MAV_STATE_ACTIVE)
    on_ground = state.phase in (Phase.PREPARING, Phase.READY, Phase.ARMING, Phase.SHADOW)
    return int(wire.MAV_STATE_STANDBY if on_ground else wire.MAV_STATE_ACTIVE)


def version_number(version: str) -> int:
    """Major << 24 | minor << 16 | patch << 8 | kind of release: official, or in development.

    version: as Python's packages write it, "1.2.3rc1".
    """
    match = _VERSION_FORM.match(version)
    numbers = () if match is None else match.groups("0")
    major, minor, patch = (min(int(number), 255) for number in (*numbers, "0", "0", "0")[:3])
    is_official = _VERSION_FORM.fullmatch(version) is not None
    kind = wire.FIRMWARE_VERSION_TYPE_OFFICIAL if is_official else wire.FIRMWARE_VERSION_TYPE_DEV
    return int(major << 24 | minor << 16 | patch << 8 | kind)
