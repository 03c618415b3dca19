"""The mission protocol: what is the same in either firmware, and which one speaks."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Ack, Autopilot, Command, Reply, Say, Sender
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.wire.mission_items import Upload


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
        return Say(message=make(to.system, to.component, upload.next, int(upload.kind)), to=to)

    def _store(self, kind: PlanKind, items: tuple[PlanItem, ...]) -> list[Reply]:
        """The list is replaced, and the autopilot told."""
        self._plans[kind] = items
        return list(self._autopilot.on_plan(kind))

    def _do(self, command: Command) -> list[Reply]:
        """What a message asks for that means the same as this command: without a COMMAND_ACK."""
        done = self._autopilot.on_command(command)
        return [each for each in done if not isinstance(each, Ack)]
