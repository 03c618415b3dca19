"""A simulated vehicle with a client of the companion on one link."""

from collections.abc import Callable, Iterator
from typing import Any, Literal, Protocol

from recordings import recording
from tlog import recorded_frames

from companion.mavlink.dialect import codec, wire
from companion.mavlink.frames import IGNORED_MESSAGES, Receiver, number_of
from vehicle_sim.plans import PlanItem as Stored
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import World, flat_world

Firmware = Literal["ardupilot", "px4"]
Kind = Literal["copter", "plane"]
FOUR: tuple[tuple[Firmware, Kind], ...] = (
    ("ardupilot", "copter"),
    ("ardupilot", "plane"),
    ("px4", "copter"),
    ("px4", "plane"),
)
HOME_DEG, HOME_M = (47.397742, 8.545594), 488.0
OURS = (1, 195)


def level(
    firmware: Firmware,
    kind: Kind = "copter",
    home: tuple[float, float, float] = (*HOME_DEG, HOME_M),
    scan_range_m: float | None = None,
) -> World:
    """Level ground about a home; degrees and metres AMSL."""
    latitude, longitude, altitude_m = home
    return flat_world(
        kind,
        firmware,
        latitude_deg=latitude,
        longitude_deg=longitude,
        altitude_amsl_m=altitude_m,
        heading_deg=0.0,
        scan_range_m=scan_range_m,
    )


class Client(Protocol):
    def on_message(self, message: Any, now_s: float) -> list[Any]: ...

    def on_time(self, now_s: float) -> list[Any]: ...


class Held:
    """The vehicle, and what was sent to it."""

    def __init__(
        self,
        firmware: Firmware,
        kind: Kind = "copter",
        faults: str = "",
        world: World | None = None,
    ) -> None:
        world = world or level(firmware, kind)
        self.simulation = Simulation(world, seed=1, links=2, faults=faults)
        self.sent: list[tuple[float, Any]] = []
        self.heard: list[Any] = []
        """What the client has heard."""
        self.others: list[bytes] = []
        """What link 1 has."""
        self._ours = codec(OURS[0])
        self._receiver = Receiver(ignored=IGNORED_MESSAGES)
        self._theirs = wire.MAVLink(None, srcSystem=255, srcComponent=190)
        self.run(1.5)

    @property
    def now_s(self) -> float:
        return self.simulation.now_us * 1e-6

    def run(
        self,
        seconds: float,
        client: Client | None = None,
        until: Callable[[], bool] = lambda: False,
    ) -> float:
        """Let time pass, with the client on link 0; how much did until it was so."""
        begun_s = self.now_s
        while self.now_s - begun_s < seconds - 1e-9 and not until():
            self.simulation.step()
            self.exchange(client)
            if client is not None:
                self.say(client.on_time(self.now_s))
                self.exchange(client)
        return self.now_s - begun_s

    def exchange(self, client: Client | None) -> None:
        """Deliver what has come, and what is answered to it, until nothing more comes."""
        while frames := self.simulation.take_frames():
            for link, frame in frames:
                if link == 1:
                    self.others.append(frame)
                else:
                    self.deliver(frame, client)

    def deliver(self, frame: bytes, client: Client | None) -> None:
        """What the vehicle says on link 0."""
        if client is None:
            return
        for message in self._receiver.feed(frame):
            if message is not None:
                self.heard.append(message)
                self.say(client.on_message(message, self.now_s))

    def say(self, messages: list[Any]) -> None:
        for message in messages:
            self.sent.append((self.now_s, message))
            self.simulation.receive(0, message.pack(self._ours))

    def other(self, message: Any, link: int = 1) -> None:
        """A ground station (255/190) says this."""
        self.simulation.receive(link, message.pack(self._theirs))

    def upload(self, kind: int, items: list[Stored], client: Client | None = None) -> None:
        """By the ground station on link 1, over the protocol; it must be taken."""
        self.others.clear()
        self.other(wire.MAVLink_mission_count_message(1, 1, len(items), kind))
        for _ in range(5000):
            self.run(0.01, client)
            if self._answer(kind, items):
                return
        raise AssertionError("the upload did not end")

    def _answer(self, kind: int, items: list[Stored]) -> bool:
        heard, self.others = self.others, []
        for frame in heard:
            if number_of(frame) not in _OF_UPLOADS:
                continue
            message: Any = self._theirs.decode(bytearray(frame))
            if message.mission_type != kind:
                continue
            if message.get_type() == "MISSION_ACK":
                assert message.type == wire.MAV_MISSION_ACCEPTED
                return True
            self.other(item_message(items[message.seq], message.seq, kind))
        return False


_OF_UPLOADS = (
    wire.MAVLINK_MSG_ID_MISSION_REQUEST,
    wire.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
    wire.MAVLINK_MSG_ID_MISSION_ACK,
)


def item_message(item: Stored, seq: int, kind: int) -> Any:
    return wire.MAVLink_mission_item_int_message(
        1, 1, seq, item.frame, item.command, 0, 1, *item.parameters, item.x, item.y, item.z_m, kind
    )


def place_e7(north_m: float, east_m: float) -> tuple[int, int]:
    """About home, nearly."""
    return (
        round((HOME_DEG[0] + north_m / 111_200.0) * 1e7),
        round((HOME_DEG[1] + east_m / 75_300.0) * 1e7),
    )


def circle(radius_m: float, north_m: float = 500.0, east_m: float = 0.0) -> Stored:
    x, y = place_e7(north_m, east_m)
    return Stored(frame=5, command=5004, parameters=(radius_m, 0.0, 0.0, 0.0), x=x, y=y)


def polygon(count: int, size_m: float = 100.0, command: int = 5002) -> list[Stored]:
    places = [place_e7(800.0 + size_m * (k % 2), 10.0 * k) for k in range(count)]
    return [
        Stored(frame=5, command=command, parameters=(float(count), 0.0, 0.0, 0.0), x=x, y=y)
        for x, y in places
    ]


def waypoints(count: int) -> list[Stored]:
    places = [place_e7(100.0 * k, 50.0) for k in range(count)]
    return [Stored(frame=3, command=16, x=x, y=y, z_m=40.0) for x, y in places]


def recorded(name: str, ignored: frozenset[int] = IGNORED_MESSAGES) -> Iterator[tuple[float, Any]]:
    """Seconds since the first record, and message, of a recorded flight: of those that are read."""
    receiver, frames = Receiver(ignored=ignored), recorded_frames(recording(name))
    for stamp_us, frame in frames:
        for message in receiver.feed(frame):
            if message is not None:
                yield (stamp_us - frames[0][0]) * 1e-6, message
