"""Downloads mission, fence and rally points from the autopilot, and goes on watching them.

Changes are not announced (ardupilot.md 1 and 4), so the item counts are polled every few seconds
and all items are downloaded again periodically; PX4 reports the ids of its lists.  Protocol:
mavlink.md 2.3 and 2.5, px4.md 7.
"""

import math
import struct
from dataclasses import dataclass, field
from typing import Final, NamedTuple, final

from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, Message, wire
from companion.mavlink.frames import payload_as_sent

MISSION: Final = wire.MAV_MISSION_TYPE_MISSION
FENCE: Final = wire.MAV_MISSION_TYPE_FENCE
RALLY: Final = wire.MAV_MISSION_TYPE_RALLY
KINDS: Final = (FENCE, RALLY, MISSION)
"""In the order in which they are read: what is safety first."""
_CURRENT: Final = wire.MAVLINK_MSG_ID_MISSION_CURRENT
_COUNT: Final = wire.MAVLINK_MSG_ID_MISSION_COUNT
_ITEM: Final = wire.MAVLINK_MSG_ID_MISSION_ITEM_INT
_ACK: Final = wire.MAVLINK_MSG_ID_MISSION_ACK
MESSAGES: Final = (_CURRENT, _COUNT, _ITEM, _ACK)
LOOK_S: Final = 4.0
"""Period of the polls of the item count."""
READ_ALL_S: Final = 30.0
_READ_ALL_PER_ITEM_S: Final = 0.5
"""Long lists are read less often: a few hundred items would fill a slow radio."""
_FEW: Final = 24
"""Items of a list without an id that is read whole instead of counted."""
_LIST_S: Final = 1.5
"""Time-out of the first answer; later, four times the measured response time."""
_ITEM_S: Final = 0.25
_MAX_LIST_TRIES: Final = 5
_MAX_ITEM_TRIES: Final = 12
"""A list of sixty must come at 25 % loss too."""
_LATER_S: Final = 1.0
"""Wait after a refusal: another client is transferring."""
_LONGEST: Final = 10_000
_REFUSED: Final = {
    wire.MAV_MISSION_DENIED: "somebody else is transferring it",
    wire.MAV_MISSION_ERROR: "the autopilot says that it failed",
    wire.MAV_MISSION_OPERATION_CANCELLED: "the autopilot has cancelled it",
}
_NAMES: Final = {MISSION: "mission", FENCE: "fence", RALLY: "rally points"}


class PlanItem(NamedTuple):
    """One item of a list as the autopilot has it (MISSION_ITEM_INT).

    What is no number in it is `math.nan` itself, so that equal items are equal.
    """

    frame: int
    command: int
    parameters: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    x: int = 0
    """Latitude in 1e-7 degrees, of items that have a place."""
    y: int = 0
    z_m: float = 0.0
    """Measured from what the frame says."""


def _item_of(message: Message) -> PlanItem:
    numbers = message.param1, message.param2, message.param3, message.param4, message.z
    a, b, c, d, z_m = (math.nan if math.isnan(number) else number for number in numbers)
    return PlanItem(message.frame, message.command, (a, b, c, d), message.x, message.y, z_m)


@final
@dataclass(slots=True)
class Plan:
    """One kind of list: complete, as it was when it was read last; and when to look at it again."""

    kind: int
    """Its MAV_MISSION_TYPE."""
    items: tuple[PlanItem, ...] = ()
    version: int = 0
    """Rises with every change; 0: not read yet."""
    supported: bool = True
    """Whether the autopilot supports this kind of list."""
    changing: int = 0
    """How many items a newer one has, that is being read; 0: it has not changed."""
    trouble: str = "no answer yet"
    """Why the last transfer did not succeed, if it did not."""
    due_s: float = -math.inf
    read_s: float = -math.inf
    """When all of it was read last; -inf: it has to be."""
    opaque_id: int = 0
    candidate: tuple[PlanItem, ...] | None = None
    """A new list that was read with gaps, or found empty after a reboot: it replaces another when
    it has been read twice."""
    rebooted: bool = False
    """Whether it has not been read since the autopilot rebooted."""


@final
@dataclass(slots=True)
class _Transfer:
    """The transfer in progress."""

    plan: Plan
    only_look: bool
    reads: bool = False
    """Whether items are requested; else the count."""
    asked_s: float = -math.inf
    tries: int = 0
    count: int = 0
    items: list[PlanItem] = field(default_factory=list)
    opaque_id: int = 0
    item_s: float = _ITEM_S
    smooth: bool = True
    """Every item came promptly, so a change in between is unlikely."""


@final
class PlanClient:
    """Downloads and polls the three lists of one autopilot.  Sans-IO.

    After each of its MESSAGES and each tick send the messages returned.  Only messages addressed to
    us count: other clients may transfer on the same link.  An incomplete download changes nothing.
    """

    def __init__(self, system_id: int) -> None:
        self._to, self._own_ids = (system_id, AUTOPILOT_COMPONENT), (system_id, COMPANION_COMPONENT)
        self.plans = {kind: Plan(kind) for kind in KINDS}
        """By MAV_MISSION_TYPE."""
        self._transfer: _Transfer | None = None
        self._list_s = _LIST_S

    @property
    def is_done(self) -> bool:
        """Whether each list has been read once, or is not supported."""
        return all(plan.version or not plan.supported for plan in self.plans.values())

    @property
    def waiting(self) -> tuple[str, ...]:
        """What has not been read once, with the reason if one is known, for people."""
        return tuple(
            f"{_NAMES[plan.kind]} ({plan.trouble})"
            for plan in self.plans.values()
            if plan.supported and not plan.version
        )

    def refresh(self) -> None:
        """Download everything again now: the autopilot has rebooted."""
        self._transfer = None
        for kind, plan in self.plans.items():
            self.plans[kind] = Plan(kind, items=plan.items, version=plan.version, rebooted=True)

    def rebase_time(self, shift_s: float) -> None:
        """Shift all stored times by this much: the clock was replaced."""
        if self._transfer is not None:
            self._transfer.asked_s += shift_s
        for plan in self.plans.values():
            plan.due_s += shift_s
            plan.read_s += shift_s

    # --- in -----------------------------------------------------------------------------------

    def on_message(self, message: Message, now_s: float) -> list[Message]:
        """Handle an answer; returns the next request."""
        if (message.get_srcSystem(), message.get_srcComponent()) != self._to:
            return []
        number, transfer = message.get_msgId(), self._transfer
        if number == _CURRENT:
            self._on_ids(message)
        elif transfer is not None and number in MESSAGES:
            target = (message.target_system, message.target_component)
            if target == self._own_ids and message.mission_type == transfer.plan.kind:
                return self._on_answer(transfer, number, message, now_s)
        return []

    def _on_ids(self, message: Message) -> None:
        """PX4 reports the ids of its lists once a second: download a list whose id is new."""
        opaque_ids = struct.unpack("<3I", payload_as_sent(message, 18)[6:] or bytes(12))
        for kind, opaque_id in zip((MISSION, FENCE, RALLY), opaque_ids, strict=True):
            plan = self.plans[kind]
            if opaque_id and plan.opaque_id and opaque_id != plan.opaque_id:
                plan.due_s = plan.read_s = -math.inf

    def _on_answer(
        self, transfer: _Transfer, number: int, message: Message, now_s: float
    ) -> list[Message]:
        if number == _ACK:
            return self._on_ack(transfer.plan, message.type, now_s)
        if transfer.reads is not (number == _ITEM):
            return []  # one that has come already
        answered = self._on_item if transfer.reads else self._on_count
        return answered(transfer, message, now_s)

    def _on_count(self, transfer: _Transfer, message: Message, now_s: float) -> list[Message]:
        plan, count = transfer.plan, message.count
        opaque_id = int.from_bytes(payload_as_sent(message, 9)[5:9], "little")
        if transfer.tries == 1:  # so this is the answer to that request
            waited_s = now_s - transfer.asked_s
            transfer.item_s = min(max(2.0 * waited_s, _ITEM_S), _LIST_S)
            self._list_s = min(max(4.0 * waited_s, 2.0 * _ITEM_S), _LIST_S)
        if count > _LONGEST:
            return self._end(plan, now_s, _LATER_S, why=f"{count} items are too many")
        known, as_many = plan.version > 0 and plan.supported, count == len(plan.items)
        if known and as_many and opaque_id == plan.opaque_id and transfer.only_look:
            plan.changing = 0  # no change, and no items are requested
            return self._end(plan, now_s, LOOK_S, wire.MAV_MISSION_OPERATION_CANCELLED)
        transfer.count, transfer.opaque_id = count, opaque_id
        if known and count and not (as_many and plan.opaque_id in (0, opaque_id)):
            plan.changing = count
        if count == 0:
            return self._complete(transfer, now_s)
        transfer.reads, transfer.tries = True, 0
        return [self._ask(transfer, now_s)]

    def _on_item(self, transfer: _Transfer, message: Message, now_s: float) -> list[Message]:
        seq, plan, item = len(transfer.items), transfer.plan, _item_of(message)
        if message.seq != seq:
            return []  # one that has come already, after it was asked for twice
        transfer.smooth &= now_s - transfer.asked_s <= _ITEM_S
        transfer.items.append(item)
        if plan.version and not plan.changing and plan.items[seq : seq + 1] != (item,):
            plan.changing = transfer.count
        if len(transfer.items) == transfer.count:
            return self._complete(transfer, now_s)
        transfer.tries = 0
        return [self._ask(transfer, now_s)]

    def _on_ack(self, plan: Plan, result: int, now_s: float) -> list[Message]:
        """Instead of an answer: refused."""
        if result == wire.MAV_MISSION_ACCEPTED:
            return []  # of something that we did not ask for
        if result != wire.MAV_MISSION_UNSUPPORTED:
            why = _REFUSED.get(result, f"refused with MAV_MISSION_RESULT {result}")
            return self._end(plan, now_s, _LATER_S, why=why)
        if plan.supported:
            plan.items, plan.version, plan.supported = (), plan.version + 1, False
        return self._end(plan, now_s, READ_ALL_S)

    # --- how a transfer ends ------------------------------------------------------------------

    def _complete(self, transfer: _Transfer, now_s: float) -> list[Message]:
        plan, items, pause_s = transfer.plan, tuple(transfer.items), LOOK_S
        plan.read_s, plan.opaque_id = now_s, transfer.opaque_id
        # An autopilot may answer before it has loaded its lists: then they look empty.
        early = plan.rebooted and not items and bool(plan.items)
        sure = items == plan.candidate or (transfer.smooth and not early)
        new = items != plan.items or not plan.version or not plan.supported
        if new and (sure or not plan.version):  # the first is better than none
            plan.items, plan.version, plan.supported = items, plan.version + 1, True
        if new and not sure:  # in the gaps it may have become half of one and half of another
            plan.candidate, plan.read_s = items, -math.inf
            pause_s = LOOK_S if early else 0.0
        else:
            plan.candidate, plan.rebooted, plan.changing = None, False, 0
        return self._end(plan, now_s, pause_s, wire.MAV_MISSION_ACCEPTED)

    def _end(
        self, plan: Plan, now_s: float, pause_s: float, ack: int | None = None, why: str = ""
    ) -> list[Message]:
        """Look at this list again after a pause; returns what is due now.

        ack: what ends the transfer for the autopilot, too.  why: it has failed; the known list is
        kept.
        """
        self._transfer, plan.due_s, plan.trouble = None, now_s + pause_s, why
        asked = self.on_time(now_s)
        if ack is None:
            return asked
        return [wire.MAVLink_mission_ack_message(*self._to, ack, plan.kind), *asked]

    # --- out ----------------------------------------------------------------------------------

    def on_time(self, now_s: float) -> list[Message]:
        """The request that is due: a retry, or a poll of the next list."""
        transfer = self._transfer
        if transfer is None:
            transfer = self._transfer = self._next(now_s)
            return [] if transfer is None else [self._ask(transfer, now_s)]
        if now_s - transfer.asked_s < self._wait_s(transfer):
            return []
        transfer.smooth = False
        if transfer.tries < (_MAX_ITEM_TRIES if transfer.reads else _MAX_LIST_TRIES):
            return [self._ask(transfer, now_s)]
        over = wire.MAV_MISSION_OPERATION_CANCELLED
        return self._end(transfer.plan, now_s, _LATER_S, over, "no answer")

    @property
    def due_s(self) -> float:
        """When `on_time` has something to do, at the latest."""
        transfer = self._transfer
        if transfer is None:
            return min(plan.due_s for plan in self.plans.values())
        return transfer.asked_s + self._wait_s(transfer)

    def _wait_s(self, transfer: _Transfer) -> float:
        return transfer.item_s if transfer.reads else self._list_s

    def _next(self, now_s: float) -> _Transfer | None:
        """The next list to poll: one never read first, then the one not polled for longest."""
        due = [plan for plan in self.plans.values() if now_s >= plan.due_s]
        if not due:
            return None
        plan = min(due, key=lambda plan: (plan.version > 0, plan.due_s))
        read_all_s = max(READ_ALL_S, _READ_ALL_PER_ITEM_S * len(plan.items))
        whole = now_s - plan.read_s >= read_all_s
        few = not plan.opaque_id and len(plan.items) <= _FEW
        return _Transfer(plan, only_look=bool(plan.version) and not whole and not few)

    def _ask(self, transfer: _Transfer, now_s: float) -> Message:
        transfer.asked_s, kind = now_s, transfer.plan.kind
        transfer.tries += 1
        if not transfer.reads:
            return wire.MAVLink_mission_request_list_message(*self._to, kind)
        return wire.MAVLink_mission_request_int_message(*self._to, len(transfer.items), kind)
