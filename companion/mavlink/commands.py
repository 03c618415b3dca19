"""Command server: COMMAND_LONG and COMMAND_INT to the companion, and their ACKs.

Each command addressed to us, by system and component, is answered once (mavlink.md 2.5).  Of
broadcasts only queries are answered: a broadcast MISSION_START or RETURN_TO_LAUNCH is meant for the
autopilot.  Orders are accepted from the configured senders only, queries from any sender.  No order
takes long, so COMMAND_CANCEL is not supported.  Parameters that an order does not use are ignored;
those it uses must be finite and in range, else it is denied with a text.
"""

import enum
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, final

from msgspec.structs import replace

from companion.geodesy import LocalFrame, deg
from companion.mavlink.addressing import (
    Address,
    Ids,
    Reply,
    address_of,
    ids_text,
    may_command,
    sender_of,
)
from companion.mavlink.dialect import Message, wire
from companion.mavlink.own_messages import AUTOPILOT_VERSION, OwnMessages
from companion.mission.changes import OrderResult
from companion.mission.events import Order, OrderKind
from companion.path.limits import Limits

MESSAGES: Final = (wire.MAVLINK_MSG_ID_COMMAND_LONG, wire.MAVLINK_MSG_ID_COMMAND_INT)
_SAME_S = 5.0  # a command that comes again within this time may be the same one
_MAX_SENDERS = 64
_NOT_GIVEN_E7 = 2**31 - 1
_FRAMES = frozenset(
    {
        wire.MAV_FRAME_GLOBAL,
        wire.MAV_FRAME_GLOBAL_RELATIVE_ALT,
        wire.MAV_FRAME_GLOBAL_INT,
        wire.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
    }
)


class Result(enum.IntEnum):
    """MAV_RESULT, as far as the companion uses it."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    IN_PROGRESS = 5
    UNSUPPORTED_MAV_FRAME = 9
    """Newer than the dialect."""


_OF_ORDERS: Final = {
    OrderResult.ACCEPTED: Result.ACCEPTED,
    OrderResult.INVALID: Result.DENIED,
    OrderResult.NOT_NOW: Result.TEMPORARILY_REJECTED,
}


@final
@dataclass(frozen=True, slots=True)
class _CommandOutcome:
    """Result and effect of one command."""

    result: Result
    text: str = ""
    order: Order | None = None
    """Without its time and sender."""


def _outcome(accepted: bool) -> _CommandOutcome:
    return _CommandOutcome(Result.ACCEPTED if accepted else Result.DENIED)


def _order(kind: OrderKind, target_ne_m: tuple[float, float] | None = None) -> _CommandOutcome:
    order = Order(time_s=0.0, kind=kind, target_ne_m=target_ne_m)
    return _CommandOutcome(Result.ACCEPTED, order=order)


@final
@dataclass(slots=True, kw_only=True)
class _PendingOrder:
    """An order that is waiting for its ACK."""

    message: Message
    order: Order
    result: Result = Result.IN_PROGRESS


@final
class CommandServer:
    """Answers commands; orders are decided by the mission machine.  Pure: time is an argument.

        reply = server.on_message(message, now_s)
        if reply.order is not None:            # give it to the machine, then
            send(server.order_done(reply.order, result))

    ours: our ids; commanders: who may give orders (0: any id); frame, limits: the mission's;
    own_messages: what can be asked for.
    """

    def __init__(
        self,
        *,
        ours: Ids,
        commanders: Iterable[Ids],
        frame: LocalFrame,
        limits: Limits,
        own_messages: OwnMessages,
    ) -> None:
        self._ours, self._commanders = ours, tuple(commanders)
        self._frame, self._limits, self._presence = frame, limits, own_messages
        self._last: dict[Ids, _PendingOrder] = {}
        """The last order of each sender, the newest at the end."""

    def on_message(self, message: Message, now_s: float) -> Reply:
        """Answer a command; an empty reply if it is no command or not for us."""
        if message.get_msgId() not in MESSAGES:
            return Reply()
        match address_of(message, self._ours):
            case Address.US:
                return self._for_us(message, now_s)
            case Address.BROADCAST:
                return self._on_broadcast(message)
            case Address.OTHERS:
                return Reply()

    def order_done(self, order: Order, result: OrderResult) -> tuple[Message, ...]:
        """The ACK of an order that the mission machine has accepted or rejected.

        Empty if the order is not waiting for an ACK.
        """
        for given in self._last.values():
            if given.order is order and given.result is Result.IN_PROGRESS:
                given.result = _OF_ORDERS[result]
                return (_ack(given.message, given.result),)
        return ()

    def _for_us(self, message: Message, now_s: float) -> Reply:
        sender = sender_of(message)
        before = self._last.get(sender)
        if before is not None and _is_repeated(message, before, now_s):
            return Reply(replies=(_ack(message, before.result),))
        meaning = self._interpret(message, sender)
        note = {"kind": "command", "sender": ids_text(sender), "command": message.command}
        if meaning.order is None:
            note |= {"result": meaning.result.name.lower(), "why": meaning.text}
            replies = (_ack(message, meaning.result),)
            return Reply(replies=replies, note=note, text=meaning.text)
        order = replace(meaning.order, time_s=now_s, sender=ids_text(sender))
        self._last.pop(sender, None)
        self._last[sender] = _PendingOrder(message=message, order=order)
        if len(self._last) > _MAX_SENDERS:
            del self._last[next(iter(self._last))]
        return Reply(order=order, note={**note, "order": order.kind.name.lower()})

    def _on_broadcast(self, message: Message) -> Reply:
        """Answer broadcast queries; never carry out a broadcast order."""
        question = _QUERIES.get(message.command)
        meaning = None if question is None else question(self, message)
        if meaning is None or meaning.result is not Result.ACCEPTED:
            return Reply()
        return Reply(replies=(_ack(message, meaning.result),))

    def _interpret(self, message: Message, sender: Ids) -> _CommandOutcome:
        if (question := _QUERIES.get(message.command)) is not None:
            return question(self, message)
        if (order := _ORDERS.get(message.command)) is None:
            return _CommandOutcome(Result.UNSUPPORTED)
        if not may_command(sender, self._commanders):
            who = f"{ids_text(sender)} may not command: see link.commanders"
            return _CommandOutcome(Result.DENIED, who)
        return order(self, message)

    # --- questions

    def _request_message(self, message: Message) -> _CommandOutcome:
        number = _whole(message.param1)
        return _outcome(number is not None and self._presence.ask(number))

    def _capabilities(self, message: Message) -> _CommandOutcome:
        return _outcome(message.param1 == 1.0 and self._presence.ask(AUTOPILOT_VERSION))

    # --- orders

    def _start(self, message: Message) -> _CommandOutcome:
        if not (math.isnan(message.param1) or message.param1 == 0.0):
            return _CommandOutcome(Result.DENIED, "start: only from the first item, param1 = 0")
        return _order(OrderKind.START)

    def _pause_or_continue(self, message: Message) -> _CommandOutcome:
        kind = {0.0: OrderKind.PAUSE, 1.0: OrderKind.CONTINUE}.get(message.param1)
        if kind is None:
            return _CommandOutcome(Result.DENIED, "pause: param1 must be 0 (pause) or 1 (continue)")
        return _order(kind)

    def _return(self, _message: Message) -> _CommandOutcome:
        return _order(OrderKind.RETURN)

    def _land(self, message: Message) -> _CommandOutcome:
        """Land where it is."""
        if any(value not in (0.0, _NOT_GIVEN_E7) and value == value for value in _place(message)):
            text = "land: it lands where it is; first DO_REPOSITION there"
            return _CommandOutcome(Result.DENIED, text)
        return _order(OrderKind.LAND)

    def _reposition(self, message: Message) -> _CommandOutcome:
        """A new target; altitude and speed are the mission's, so those given are ignored."""
        if message.get_type() == "COMMAND_INT" and message.frame not in _FRAMES:
            text = f"reposition: frame {message.frame} is not one of 0, 3, 5, 6"
            return _CommandOutcome(Result.UNSUPPORTED_MAV_FRAME, text)
        place = self._place_ne_m(message)
        if place is None:
            return _CommandOutcome(Result.DENIED, "reposition: give a place on the mission's map")
        return _order(OrderKind.REPOSITION, place)

    def _place_ne_m(self, message: Message) -> tuple[float, float] | None:
        """The place of a command; None if it is invalid or off the map."""
        latitude, longitude = _place(message)
        if message.get_type() == "COMMAND_INT":
            latitude, longitude = deg(message.x), deg(message.y)
        on_earth = (
            abs(latitude) <= 90.0 and abs(longitude) <= 180.0
        )  # not NaN, nor 2**31 - 1: not given
        if not on_earth or latitude == longitude == 0.0:
            return None
        north, east = self._frame.to_local_m(latitude, longitude)
        south_m, north_m = self._limits.north_m
        west_m, east_m = self._limits.east_m
        on_map = south_m <= north <= north_m and west_m <= east <= east_m
        return (north, east) if on_map else None


_Handler = Callable[[CommandServer, Message], _CommandOutcome]

_QUERIES: Final[dict[int, _Handler]] = {
    wire.MAV_CMD_REQUEST_MESSAGE: CommandServer._request_message,
    wire.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: CommandServer._capabilities,
}
"""Queries: from any sender, broadcasts included."""

_ORDERS: Final[dict[int, _Handler]] = {
    wire.MAV_CMD_MISSION_START: CommandServer._start,
    wire.MAV_CMD_DO_PAUSE_CONTINUE: CommandServer._pause_or_continue,
    wire.MAV_CMD_DO_REPOSITION: CommandServer._reposition,
    wire.MAV_CMD_NAV_RETURN_TO_LAUNCH: CommandServer._return,
    wire.MAV_CMD_NAV_LAND: CommandServer._land,
}
"""Orders: from commanders only."""


def _place(message: Message) -> tuple[float, float]:
    """Latitude and longitude of a command, in its own units: degrees, or 1e-7 of them."""
    if message.get_type() == "COMMAND_INT":
        return message.x, message.y
    return message.param5, message.param6


def _is_repeated(message: Message, before: _PendingOrder, now_s: float) -> bool:
    """Whether a command repeats the sender's last order because its ACK was lost.

    COMMAND_LONG has a confirmation field.  COMMAND_INT has none: it counts as a repetition if the
    same order was accepted just before; a refused one may be retried.
    """
    age_s = now_s - before.order.time_s
    if _values(message) != _values(before.message) or not 0.0 <= age_s <= _SAME_S:
        return False
    if message.get_type() == "COMMAND_LONG":
        return bool(message.confirmation > 0)
    return before.result in (Result.ACCEPTED, Result.IN_PROGRESS)


def _values(message: Message) -> str:
    """All parameters but the confirmation, as text, since NaN does not equal itself."""
    return repr({**message.to_dict(), "confirmation": None})


def _ack(message: Message, result: Result) -> Message:
    """The ACK of a command, for who gave it."""
    return wire.MAVLink_command_ack_message(message.command, int(result), 0, 0, *sender_of(message))


def _whole(value: float) -> int | None:
    """The number of a message; None if it is none."""
    return int(value) if math.isfinite(value) and value == int(value) else None
