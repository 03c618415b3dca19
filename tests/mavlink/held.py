"""A simulated vehicle with a client of the companion on its link."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import harness
from recordings import recording
from tlog import recorded_frames

from companion.mavlink.dialect import codec
from companion.mavlink.frames import IGNORED_MESSAGES, Receiver
from vehicle_sim.plans import PlanItem as Stored
from vehicle_sim.world import VehicleKind

Way = tuple[str, VehicleKind]
FOUR: tuple[Way, ...] = (
    ("ardupilot", "copter"),
    ("ardupilot", "plane"),
    ("px4", "copter"),
    ("px4", "plane"),
)
MISSIONS = ("sitl-arducopter", "sitl-arduplane", "sitl-px4", "sitl-px4-plane")
"""Bundled ones, for each of the four."""
HOME_DEG, HOME_M = harness.PLACE[:2], harness.PLACE[2]


class Held(harness.Rig):
    """The vehicle, the client, and what was sent to the one by the other."""

    client: Any = None
    """Has `on_message` and `on_time`, which return what is to be sent."""

    def __init__(self, *way: Any, place: harness.Vector = harness.PLACE, **told: Any) -> None:
        """What is told is as of a Rig."""
        super().__init__(*way, place=place, seed=1, **told)
        self.sent: list[tuple[float, Any]] = []
        self._receiver = Receiver(ignored=IGNORED_MESSAGES)
        self.run(1.5)

    def step(self) -> None:
        """10 ms of the vehicle, and what the client says then."""
        super().step()
        if self.client is not None:
            self.say(self.client.on_time(self.now_s))
            self._hear()

    def _hear(self) -> None:
        """Deliver what has come, and what is answered to it, until nothing more comes."""
        begun = -1
        while begun < len(self.heard):
            begun = len(self.heard)
            super()._hear()
            for each in self.heard[begun:]:
                self.deliver(each.frame)

    def deliver(self, frame: bytes) -> None:
        """What the vehicle says."""
        for message in self._receiver.feed(frame) if self.client is not None else ():
            if message is not None:
                self.say(self.client.on_message(message, self.now_s))

    def say(self, messages: list[Any]) -> None:
        for message in messages:
            self.sent.append((self.now_s, message))
            self.simulation.receive(0, message.pack(codec(1)))


def stored(command: int, value: float, north_m: float, east_m: float, z_m: float = 0.0) -> Stored:
    """An item of a list, its first parameter, and a place about home."""
    return harness.item(HOME_DEG, command, north_m, east_m, z_m, value)


def placed(items: Iterable[Any]) -> list[tuple[int, float, int, int]]:
    """What tells items of a list apart, of either side."""
    return [(item.command, item.parameters[0], item.x, item.y) for item in items]


def polygon(count: int, size_m: float = 100.0) -> Sequence[Stored]:
    """To be kept out of, far off."""
    return [stored(5002, count, 800.0 + size_m * (k % 2), 10.0 * k) for k in range(count)]


def waypoints(count: int) -> Sequence[Stored]:
    return [stored(16, 0.0, 100.0 * k, 50.0, 40.0) for k in range(count)]


def recorded(name: str, ignored: frozenset[int] = IGNORED_MESSAGES) -> Iterator[tuple[float, Any]]:
    """Seconds since the first record, and message, of a recorded flight: of those that are read."""
    receiver, frames = Receiver(ignored=ignored), recorded_frames(recording(name))
    for stamp_us, frame in frames:
        for message in receiver.feed(frame):
            if message is not None:
                yield (stamp_us - frames[0][0]) * 1e-6, message
