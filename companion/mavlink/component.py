"""The companion as a MAVLink component: its heartbeat, its version, and who may command it.

It identifies as an onboard controller, never as autopilot or ground station, and its heartbeat
stops when it is faulted (mavlink.md 2.1, C11).  Each command addressed to us, by system and
component, is answered once (mavlink.md 2.5).  Of broadcasts only questions are answered: a
broadcast MISSION_START or RETURN_TO_LAUNCH is meant for the autopilot.  Sans-IO.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, final

from companion.mavlink.commands import HEARTBEAT, ORDERS, VERSION, Meaning, Result, meaning_of
from companion.mavlink.dialect import COMPANION_COMPONENT, Message, wire
from companion.mission.changes import OrderResult
from companion.mission.events import Order
from companion.mission.mission import Mission
from companion.mission.state import Phase, State

_BEAT_S: Final = 1.0
_SAME_S: Final = 5.0  # a command that comes again within this time may be the same one
_MAX_SENDERS: Final = 64
_CAPABILITIES: Final = (
    wire.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | wire.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
)
"""No parameters, mission, fence or rally points: those are the autopilot's; no files."""
_RELEASES: Final = {
    "a": wire.FIRMWARE_VERSION_TYPE_ALPHA,
    "b": wire.FIRMWARE_VERSION_TYPE_BETA,
    "rc": wire.FIRMWARE_VERSION_TYPE_RC,
    "": wire.FIRMWARE_VERSION_TYPE_OFFICIAL,
}
_RESULTS: Final = {
    OrderResult.ACCEPTED: Result.ACCEPTED,
    OrderResult.INVALID: Result.DENIED,
    OrderResult.NOT_NOW: Result.TEMPORARILY_REJECTED,
}
_Ids = tuple[int, int]
"""System and component id; 0 stands for any."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
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
    result: Result = Result.IN_PROGRESS


@final
class Component:
    """Commands and heartbeat of one companion.  Time is an argument."""

    def __init__(self, mission: Mission, system_id: int, version: str) -> None:
        self._ours = system_id, COMPANION_COMPONENT
        self._mission, self._version = mission, version
        self._beat_at_s = -math.inf
        self._asked: set[int] = set()
        """Messages of ours that somebody wants to have now."""
        self._given: dict[_Ids, _Given] = {}
        """By sender, the newest at the end."""

    # --- commands

    def on_message(self, message: Message, now_s: float) -> Reply:
        """Handle a command of any sender; it may be addressed to another component."""
        sender = message.get_srcSystem(), message.get_srcComponent()
        target = message.target_system, message.target_component
        if sender == self._ours or not _matches(target, self._ours):
            return Reply()  # of a router that sends things back, or for others
        if target != self._ours:
            return self._on_broadcast(message)
        before = self._given.get(sender)
        if before is not None and _is_repeated(message, before, now_s):
            return Reply(replies=(_ack(message, before.result),))
        meaning, name = self._meaning(message, sender), f"{sender[0]}/{sender[1]}"
        note = {"kind": "command", "sender": name, "command": message.command}
        if meaning.order is None:
            note |= {"result": meaning.result.name.lower(), "why": meaning.text}
            return Reply(replies=(_ack(message, meaning.result),), note=note, text=meaning.text)
        order = Order(
            time_s=now_s, kind=meaning.order, target_ne_m=meaning.target_ne_m, sender=name
        )
        self._given.pop(sender, None)
        self._given[sender] = _Given(message, order)
        if len(self._given) > _MAX_SENDERS:
            del self._given[next(iter(self._given))]
        return Reply(order=order, note={**note, "order": order.kind.name.lower()})

    def order_done(self, order: Order, verdict: OrderResult) -> Sequence[Message]:
        """The ACK of an order that the mission machine has decided; empty if none is waited for."""
        for given in self._given.values():
            if given.order is order and given.result is Result.IN_PROGRESS:
                given.result = _RESULTS[verdict]
                return (_ack(given.message, given.result),)
        return ()

    def _meaning(self, message: Message, sender: _Ids) -> Meaning:
        may = any(_matches(allowed, sender) for allowed in self._mission.commanders)
        if message.command in ORDERS and not may:
            who = f"{sender[0]}/{sender[1]} may not command: see link.commanders"
            return Meaning(Result.DENIED, who)
        meaning = meaning_of(message, self._mission.frame, self._mission.task.limits)
        if meaning.asks_for is not None:
            self._asked.add(meaning.asks_for)
        return meaning

    def _on_broadcast(self, message: Message) -> Reply:
        """Answer a question for us; never carry out an order."""
        if message.command in ORDERS or self._meaning(message, self._ours).asks_for is None:
            return Reply()
        return Reply(replies=(_ack(message, Result.ACCEPTED),))

    # --- its own messages

    @property
    def due_s(self) -> float:
        """When `on_time` must be called next, at the latest."""
        return -math.inf if self._asked else self._beat_at_s + _BEAT_S

    def on_time(self, now_s: float, state: State, *, faulted: bool) -> list[Message]:
        """The messages that are due; no heartbeat while faulted or done."""
        messages, asked = list[Message](), self._asked
        is_due = not 0.0 <= now_s - self._beat_at_s < _BEAT_S  # also when a clock begins again
        if not faulted and (is_due or HEARTBEAT in asked):
            self._beat_at_s = now_s
            messages.append(heartbeat(system_status(state)))
        if VERSION in asked:
            messages.append(_version_message(self._version))
        self._asked = asked & {HEARTBEAT} if faulted else set()
        return messages


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


def _version_message(version: str) -> Message:
    """AUTOPILOT_VERSION: capabilities and version; what belongs to firmware and board is zero."""
    nothing = [0] * 8
    return wire.MAVLink_autopilot_version_message(
        _CAPABILITIES, version_number(version), 0, 0, 0, nothing, nothing, nothing, 0, 0, 0
    )


def version_number(version: str) -> int:
    """Major << 24 | minor << 16 | patch << 8 | kind of release (FIRMWARE_VERSION_TYPE).

    version: as Python's packages write it, "1.2.3rc1".
    """
    found = re.match(r"(\d+)(?:\.(\d+))?(?:\.(\d+))?\.?(.*)", version)
    if found is None:
        return int(wire.FIRMWARE_VERSION_TYPE_DEV)
    *numbers, rest = found.groups()
    release = _RELEASES.get(re.sub(r"\d*$", "", rest), wire.FIRMWARE_VERSION_TYPE_DEV)
    major, minor, patch = (min(int(number or 0), 255) for number in numbers)
    return int(major << 24 | minor << 16 | patch << 8 | release)


def _matches(pattern: _Ids, ids: _Ids) -> bool:
    """Whether ids fit a pattern, in which 0 stands for any."""
    return all(asked in (own, 0) for asked, own in zip(pattern, ids, strict=True))


def _is_repeated(message: Message, before: _Given, now_s: float) -> bool:
    """Whether a command repeats the sender's last order because its ACK was lost.

    COMMAND_LONG has a confirmation field.  COMMAND_INT has none: it counts as a repetition if the
    same order was accepted just before; a refused one may be retried.
    """
    age_s = now_s - before.order.time_s
    if _values(message) != _values(before.message) or not 0.0 <= age_s <= _SAME_S:
        return False
    if message.get_msgId() == wire.MAVLINK_MSG_ID_COMMAND_LONG:
        return bool(message.confirmation > 0)
    return before.result in (Result.ACCEPTED, Result.IN_PROGRESS)


def _values(message: Message) -> str:
    """All parameters but the confirmation, as text, since NaN does not equal itself."""
    return repr({**message.to_dict(), "confirmation": None})


def _ack(message: Message, result: Result) -> Message:
    """The ACK of a command, for who gave it."""
    to = message.get_srcSystem(), message.get_srcComponent()
    return wire.MAVLink_command_ack_message(message.command, int(result), 0, 0, *to)
