"""The mission protocol of either firmware: what it takes in, what it says, and when."""

from typing import Any, Protocol

from vehicle_sim.autopilots import Autopilot, Sender
from vehicle_sim.wire.answers import Answer
from vehicle_sim.wire.mission_ardupilot import ArduPilotMissions
from vehicle_sim.wire.mission_items import MESSAGES
from vehicle_sim.wire.mission_px4 import Px4Missions

__all__ = ["MESSAGES", "MissionProtocol", "mission_protocol"]


class MissionProtocol(Protocol):
    """Uploads and downloads of missions, fences and rally points on all links of one autopilot."""

    @property
    def busy(self) -> bool:
        """Whether step() has anything to do."""
        ...

    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Answer]:
        """Answer a message of MESSAGES that is for the autopilot."""
        ...

    def step(self, now_us: int) -> list[Answer]:
        """Repeat requests, and give up, when it is time."""
        ...


def mission_protocol(autopilot: Autopilot) -> MissionProtocol:
    """As this autopilot's firmware speaks it; a new one after each boot."""
    if autopilot.style.firmware == "px4":
        return Px4Missions(autopilot)
    return ArduPilotMissions(autopilot)
