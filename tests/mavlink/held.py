"""A simulated vehicle with a client of the companion on its link."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Literal

import harness
from recordings import recording
from tlog import recorded_frames

from companion.mavlink.dialect import codec, wire
from companion.mavlink.frames import IGNORED_MESSAGES, Receiver
from vehicle_sim.plans import PlanItem as Stored
from vehicle_sim.plans import PlanKind
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import parse_world

Firmware = Literal["ardupilot", "px4"]
Kind = Literal["copter", "plane"]
FOUR: tuple[tuple[Firmware, Kind], ...] = (
    ("ardupilot", "copter"),
    ("ardupilot", "plane"),
    ("px4", "copter"),
    ("px4", "plane"),
)
MISSIONS = ("sitl-arducopter", "sitl-arduplane", "sitl-px4", "sitl-px4-plane")
"""Bundled ones, for each of the four."""
HOME_DEG, HOME_M = harness.PLACE[:2], harness.PLACE[2]


class Held:
    """The vehicle, and what was sent to it."""

    client: Any = None
    """Has `on_message` and `on_time`, which return what is to be sent."""

    def __init__(
        self,
        firmware: Firmware,
        kind: Kind = "copter",
        faults: str = "",
        home: harness.Vector = harness.PLACE,
        **parameters: Any,
    ) -> None:
        """home: degrees and metres AMSL."""
        world = harness.world(firmware, kind, home, **parameters)
        self.simulation = Simulation(parse_world(world), seed=1, faults=faults)
        self.sent: list[tuple[float, Any]] = []
        self.heard: list[Any] = []
        """What the client has heard."""
        self._receiver = Receiver(ignored=IGNORED_MESSAGES)
        self.run(1.5)

    @property
    def now_s(self) -> float:
        return self.simulation.now_us * 1e-6

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> float:
        """Let time pass; how much did until it was so."""
        begun_s = self.now_s
        while self.now_s - begun_s < seconds - 1e-9 and not until():
            self.simulation.step()
            self._exchange()
            if self.client is not None:
                self.say(self.client.on_time(self.now_s))
                self._exchange()
        return self.now_s - begun_s

    def _exchange(self) -> None:
        """Deliver what has come, and what is answered to it, until nothing more comes."""
        while frames := self.simulation.take_frames():
            for _, frame in frames:
                self.deliver(frame)

    def deliver(self, frame: bytes) -> None:
        """What the vehicle says."""
        for message in self._receiver.feed(frame) if self.client is not None else ():
            if message is not None:
                self.heard.append(message)
                self.say(self.client.on_message(message, self.now_s))

    def say(self, messages: list[Any]) -> None:
        for message in messages:
            self.sent.append((self.now_s, message))
            self.simulation.receive(0, message.pack(codec(1)))

    def other(self, message: Any) -> None:
        """A ground station says this."""
        them = wire.MAVLink(None, srcSystem=255, srcComponent=190)
        self.simulation.receive(0, message.pack(them))

    def draw(self, kind: int, *items: Stored) -> None:
        """A ground station has uploaded this."""
        self.simulation.plans[PlanKind(kind)] = items


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
