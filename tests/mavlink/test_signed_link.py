"""The clocks at both ends of a signed link: the companion's and the simulated ArduPilot's.

Link 0 of an ArduPilot believes everybody (ardupilot.md 5), so the companion speaks on link 1.
"""

from typing import Any, final

import pytest

from companion.mavlink.dialect import codec, wire
from companion.mavlink.frames import Receiver
from companion.mavlink.signing import TICKS_PER_S, Signing, key_of, timestamp_of
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

LINK = 1
KEY = key_of("correct horse battery staple")
NOW = timestamp_of(1_790_000_000.0)


@final
class Companion:
    """The companion's end: packs and signs, receives and judges; time is the vehicle's."""

    def __init__(self, vehicle: Simulation, timestamp: int = NOW) -> None:
        self.vehicle = vehicle
        self.signing = Signing(key=KEY, timestamp=timestamp, link_id=2)
        self.receiver = Receiver(self.signing)
        self.codec = codec(1)
        self.signing.attach(self.codec)
        self.messages: list[Any] = []

    def send(self, message: Any) -> None:
        self.vehicle.receive(LINK, message.pack(self.codec))

    def command(self, number: int, *values: float) -> int | None:
        """Send a command; the result, None if there was no answer in a second."""
        padded = (*values, *([0.0] * (7 - len(values))))
        self.messages.clear()
        self.send(wire.MAVLink_command_long_message(1, 1, number, 0, *padded))
        self.run(1.0)
        results = [m.result for m in self.of("COMMAND_ACK") if m.command == number]
        return results[0] if results else None

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.vehicle.step()
            self.signing.on_time(self.vehicle.now_us * 1e-6)
            for link, frame in self.vehicle.take_frames():
                if link == LINK:
                    self.messages += self.receiver.feed(frame)

    def of(self, name: str) -> list[Any]:
        return [message for message in self.messages if message.get_type() == name]


@pytest.fixture
def vehicle() -> Simulation:
    """Ready to be armed; it has its key by a link that needs no signature."""
    world = flat_world(
        "copter",
        "ardupilot",
        latitude_deg=47.4,
        longitude_deg=8.5,
        altitude_amsl_m=488.0,
        heading_deg=0.0,
        scan_range_m=500.0,
    )
    vehicle = Simulation(world, links=2)
    while not vehicle.armable:
        vehicle.step()
        vehicle.take_frames()
    station = wire.MAVLink(None, srcSystem=255, srcComponent=190)
    vehicle.receive(0, wire.MAVLink_setup_signing_message(1, 1, list(KEY), NOW).pack(station))
    vehicle.step()
    vehicle.take_frames()
    return vehicle


@pytest.mark.parametrize("hours", [-24.0, -0.02, 0.0, 24.0])
def test_a_companion_whose_clock_is_wrong_is_obeyed_once_it_has_heard_the_vehicle(
    vehicle: Simulation, hours: float
) -> None:
    """The vehicle's clock runs a minute ahead of its key's time, and we may be a day off."""
    companion = Companion(vehicle, NOW + round(hours * 3600 * TICKS_PER_S))
    companion.run(1.0)
    if hours > 0.0:  # too old for us, until it has heard us
        assert not companion.messages
        companion.send(wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
        companion.run(1.0)
    assert companion.of("HEARTBEAT")
    assert companion.command(wire.MAV_CMD_DO_SET_MODE, 1, 4) == 0


@pytest.mark.parametrize("spoken", [False, True])
def test_a_vehicle_that_reboots_is_believed_again(vehicle: Simulation, spoken: bool) -> None:
    """It starts from the time that it kept; if that is too low, our next frame raises it."""
    companion = Companion(vehicle)
    companion.run(20.0)
    if spoken:
        assert companion.command(wire.MAV_CMD_DO_SET_MODE, 1, 4) == 0
    companion.run(20.0)
    assert companion.command(wire.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == 0
    companion.run(4.0)
    companion.send(wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    companion.messages.clear()
    companion.run(2.0)
    assert companion.of("HEARTBEAT")
    assert companion.command(wire.MAV_CMD_DO_SET_MODE, 1, 4) == 0
