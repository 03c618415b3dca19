"""The mission protocol: what is the same in either firmware, and which one speaks."""

import enum
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Ack, Autopilot, Command, Reply, Sender, SendMessage
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.wire.dialect import message_class

# --- Items of missions, fences and rally lists, between the wire and plans; MISSION_* numbers -----

MISSION_CURRENT: Final = 42
DO_SET_MISSION_CURRENT: Final = 224
GLOBAL_FRAMES: Final = frozenset({0, 3, 5, 6, 10, 11})
_INT32 = 2**31
_Count: Any = message_class("MISSION_COUNT")
_Ack: Any = message_class("MISSION_ACK")


class MissionResult(enum.IntEnum):
    """MAV_MISSION_RESULT."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM1 = 6
    INVALID_PARAM2 = 7
    INVALID_PARAM3 = 8
    INVALID_PARAM4 = 9
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    OPERATION_CANCELLED = 15


@final
@dataclass(slots=True, kw_only=True)
class Upload:
    """A list on its way from a client; the stored one stays until this one is complete."""

    sender: Sender
    kind: PlanKind
    last: int
    """Number of the last item that is asked for."""
    heard_us: int
    asked_us: int = 0
    next: int = 0
    items: list[PlanItem] = field(default_factory=list)

    def is_from(self, sender: Sender) -> bool:
        """Whether this is who uploads; on which link does not matter."""
        return (sender.system, sender.component) == (self.sender.system, self.sender.component)

    def put(self, item: PlanItem) -> None:
        """The item that was asked for has come."""
        if self.next < len(self.items):
            self.items[self.next] = item
        else:
            self.items.append(item)
        self.next += 1


def kind_of(message: Any) -> PlanKind | None:
    """Which list a message is about; None if there is no such list."""
    number = message.mission_type
    return PlanKind(number) if number in PlanKind.__members__.values() else None


def read_item(message: Any) -> PlanItem | MissionResult:
    """A MISSION_ITEM_INT, or a MISSION_ITEM with its place in degrees."""
    x, y = message.x, message.y
    if message.get_type() == "MISSION_ITEM":
        scaled = [value * 1e7 if math.isfinite(value) else math.inf for value in (x, y)]
        for value, wrong in zip(
            scaled, (MissionResult.INVALID_PARAM5_X, MissionResult.INVALID_PARAM6_Y), strict=True
        ):
            if abs(value) >= _INT32:
                return wrong
        x, y = (round(value) for value in scaled)
    return PlanItem(
        frame=message.frame,
        command=message.command,
        parameters=(message.param1, message.param2, message.param3, message.param4),
        x=x,
        y=y,
        z_m=message.z,
        autocontinue=bool(message.autocontinue),
    )


def tell_item(
    item: PlanItem, kind: PlanKind, seq: int, to: Sender, *, whole: bool, current: bool = False
) -> SendMessage:
    """The item as a MISSION_ITEM_INT (whole), or as a MISSION_ITEM."""
    make: Any = mavlink.MAVLink_mission_item_int_message
    place: tuple[float, float] = (item.x, item.y)
    if not whole:
        make, place = mavlink.MAVLink_mission_item_message, (item.x * 1e-7, item.y * 1e-7)
    message = make(
        *(to.system, to.component, seq, item.frame, item.command, int(current)),
        *(int(item.autocontinue), *item.parameters, *place, item.z_m, int(kind)),
    )
    return SendMessage(message=message, to=to)


def tell_count(count: int, kind: PlanKind, to: Sender, opaque_id: int = 0) -> SendMessage:
    """MISSION_COUNT: so many items are there to be asked for."""
    return SendMessage(message=_Count(to.system, to.component, count, int(kind), opaque_id), to=to)


def ack(result: MissionResult, kind: int, to: Sender, opaque_id: int = 0) -> SendMessage:
    """MISSION_ACK: how it ended; the kind may be one that there is not."""
    return SendMessage(message=_Ack(to.system, to.component, int(result), kind, opaque_id), to=to)


def make_current(seq: int, sender: Sender) -> Command:
    """MISSION_SET_CURRENT as the command that means the same."""
    return Command(
        sender=sender,
        target_component=0,
        number=DO_SET_MISSION_CURRENT,
        parameters=(float(seq), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    )


class MissionProtocol(ABC):
    """Uploads and downloads of missions, fences and rally points on all links of one autopilot.

    An upload has a slot: ArduPilot has one for each kind of list, PX4 one for each link.
    """

    ask_again_us: ClassVar[int]
    """An item that does not come is asked for again after this time."""
    give_up_us: ClassVar[int]
    """The same of the whole upload, from what was heard last."""

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot = autopilot
        self._plans = autopilot.plans
        self._uploads: dict[int, Upload] = {}

    @property
    @abstractmethod
    def busy(self) -> bool:
        """Whether step() has anything to do."""

    @abstractmethod
    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """Answer a message of the mission protocol that is for the autopilot."""

    @abstractmethod
    def step(self, now_us: int) -> list[Reply]:
        """Repeat requests, and give up, when it is time."""

    @abstractmethod
    def _whole(self, upload: Upload) -> bool:
        """Whether items are asked for as integers."""

    @abstractmethod
    def _gave_up(self, upload: Upload) -> list[Reply]:
        """What is said of an upload that was left."""

    def _repeat(self, now_us: int) -> list[Reply]:
        """Ask again for what did not come, and give up in the end."""
        answers = list[Reply]()
        for slot, upload in list(self._uploads.items()):
            if now_us - upload.heard_us > self.give_up_us:
                del self._uploads[slot]
                answers += self._gave_up(upload)
            elif now_us - upload.asked_us > self.ask_again_us:
                answers.append(self._ask(upload, now_us))
        return answers

    def _begin(self, slot: int, upload: Upload, now_us: int) -> list[Reply]:
        """An upload begins: ask for its first item."""
        self._uploads[slot] = upload
        return [self._ask(upload, now_us)]

    def _ask(self, upload: Upload, now_us: int) -> Reply:
        """Ask for the next item."""
        upload.asked_us = now_us
        make: Any = mavlink.MAVLink_mission_request_message
        if self._whole(upload):
            make = mavlink.MAVLink_mission_request_int_message
        to = upload.sender
        return SendMessage(
            message=make(to.system, to.component, upload.next, int(upload.kind)), to=to
        )

    def store(self, kind: PlanKind, items: tuple[PlanItem, ...]) -> list[Reply]:
        """Replace a list, and tell the autopilot."""
        self._plans[kind] = items
        return list(self._autopilot.on_plan(kind))

    def _do(self, command: Command) -> list[Reply]:
        """What a message asks for that means the same as this command: without a COMMAND_ACK."""
        done = self._autopilot.on_command(command)
        return [each for each in done if not isinstance(each, Ack)]
