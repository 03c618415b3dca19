"""Both ends of a signed link: the companion's signing and the simulated ArduPilot's.

Link 0 of an ArduPilot believes everybody (ardupilot.md 5), so the companion speaks on link 1.
"""

from pathlib import Path
from typing import Any, final

import pytest

from companion.mavlink.dialect import codec, wire
from companion.mavlink.frames import Passed, Receiver
from companion.mavlink.signing import TICKS_PER_S, Refusal, Signing, key_of, timestamp_of
from companion.runtime.keys import SigningKey
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

LINK = 1
PHRASE = "correct horse battery staple"
KEY, WRONG_KEY = key_of(PHRASE), bytes(32)
CLOCK_S = 1_790_000_000.0
NOW = timestamp_of(CLOCK_S)
GLOBAL_POSITION = 33


@final
class Companion:
    """The companion's end: packs and signs, receives and judges; time is the vehicle's."""

    def __init__(self, vehicle: Simulation, signing: Signing | None) -> None:
        self.vehicle, self.signing = vehicle, signing
        self.receiver = Receiver(signing)
        self.codec = codec(1)
        if signing is not None:
            signing.attach(self.codec)
        self.heard: list[bytes] = []
        """Frames as they came over the link."""
        self.messages: list[Any] = []

    def send(self, message: Any) -> bytes:
        frame: bytes = message.pack(self.codec)
        self.vehicle.receive(LINK, frame)
        return frame

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
            if self.signing is not None:
                self.signing.on_time(self.vehicle.now_us * 1e-6)
            for link, frame in self.vehicle.take_frames():
                if link == LINK:
                    self.heard.append(frame)
                    self.messages += self.receiver.feed(frame)

    def of(self, name: str) -> list[Any]:
        return [message for message in self.messages if message.get_type() == name]


def ready_vehicle() -> Simulation:
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
    return vehicle


def give_key(vehicle: Simulation, key: bytes = KEY, timestamp: int = NOW) -> None:
    """As a ground station does it, on the link that needs no signature."""
    station = wire.MAVLink(None, srcSystem=255, srcComponent=190)
    setup = wire.MAVLink_setup_signing_message(1, 1, list(key), timestamp)
    vehicle.receive(0, setup.pack(station))
    vehicle.step()
    vehicle.take_frames()


def ours(timestamp: int = NOW, key: bytes = KEY) -> Signing:
    return Signing(key=key, timestamp=timestamp, link_id=2)


@pytest.fixture
def vehicle() -> Simulation:
    """Ready to be armed, with the key."""
    vehicle = ready_vehicle()
    give_key(vehicle)
    return vehicle


def test_a_flight_over_a_signed_link(vehicle: Simulation) -> None:
    companion = Companion(vehicle, ours())
    companion.send(wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    assert companion.command(wire.MAV_CMD_SET_MESSAGE_INTERVAL, GLOBAL_POSITION, 50_000) == 0
    companion.run(2.0)
    assert len(companion.of("GLOBAL_POSITION_INT")) >= 39
    assert {message.get_srcComponent() for message in companion.messages} == {1, 100}  # the radar's
    assert companion.command(wire.MAV_CMD_DO_SET_MODE, 1, 4) == 0
    assert companion.command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    assert companion.command(wire.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 20) == 0
    companion.run(20.0)
    setpoint = wire.MAVLink_set_position_target_global_int_message(
        *(0, 1, 1, 5, 2496, 474_010_000, 85_000_000, 510.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    )
    for _ in range(50):
        companion.send(setpoint)
        companion.run(0.1)
    [*_, last] = companion.of("GLOBAL_POSITION_INT")
    assert last.relative_alt > 18_000
    assert last.vx > 100
    assert companion.signing is not None
    assert not companion.signing.refused
    assert companion.receiver.signed == len(companion.heard)


def test_the_vehicle_obeys_only_what_is_signed_and_new(vehicle: Simulation) -> None:
    mode = (wire.MAV_CMD_DO_SET_MODE, 1, 4)
    assert Companion(vehicle, None).command(*mode) is None
    assert Companion(vehicle, ours(key=WRONG_KEY)).command(*mode) is None
    companion = Companion(vehicle, ours())
    companion.run(1.0)
    arm = wire.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    assert companion.command(*mode) == 0
    recorded = companion.send(arm)
    companion.run(1.0)
    assert vehicle.armed
    companion.command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    assert not vehicle.armed
    vehicle.receive(LINK, recorded)
    companion.run(1.0)
    assert not vehicle.armed


def test_the_companion_believes_only_what_is_signed_and_new(vehicle: Simulation) -> None:
    companion = Companion(vehicle, ours())
    companion.run(3.0)
    assert companion.of("HEARTBEAT")
    signing = companion.signing
    assert signing is not None
    for frame in companion.heard:  # all of it once more
        assert companion.receiver.feed(frame) == []
    assert signing.refused == {Refusal.REPLAYED: len(companion.heard)}
    signing.refused.clear()

    give_key(vehicle, WRONG_KEY[:-1] + b"\1")
    companion.messages.clear()
    companion.run(2.0)
    assert not companion.messages
    assert set(signing.refused) == {Refusal.WRONG}
    signing.refused.clear()

    give_key(vehicle, bytes(32), 0)  # switches signing off
    companion.run(2.0)
    assert not companion.messages
    assert set(signing.refused) == {Refusal.UNSIGNED}


def test_a_companion_without_a_key_hears_and_is_not_obeyed(vehicle: Simulation) -> None:
    companion = Companion(vehicle, None)
    companion.run(2.0)
    assert companion.of("HEARTBEAT")
    assert companion.receiver.signed == len(companion.heard)
    assert companion.command(wire.MAV_CMD_DO_SET_MODE, 1, 4) is None


@pytest.mark.parametrize("hours", [-24.0, -0.02, 0.0, 24.0])
def test_a_companion_whose_clock_is_wrong_is_obeyed_once_it_has_heard_the_vehicle(
    vehicle: Simulation, hours: float
) -> None:
    """The vehicle's clock runs a minute ahead of its key's time, and we may be a day off."""
    companion = Companion(vehicle, ours(NOW + round(hours * 3600 * TICKS_PER_S)))
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
    companion = Companion(vehicle, ours())
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


@pytest.mark.parametrize("clock_moved_s", [0.5, 25.0, -86_400.0])
def test_a_new_process_is_not_refused(
    vehicle: Simulation, tmp_path: Path, clock_moved_s: float
) -> None:
    """Its time stamps go on above those of the process that was killed, before it heard anybody."""
    path = tmp_path / "key"
    path.write_text(PHRASE)
    path.chmod(0o600)
    companion = Companion(vehicle, SigningKey(path).signing(clock_s=CLOCK_S))
    companion.run(min(abs(clock_moved_s), 25.0))
    assert companion.command(wire.MAV_CMD_DO_SET_MODE, 1, 4) == 0
    assert companion.signing is not None
    SigningKey(path).save(companion.signing.timestamp, CLOCK_S)
    companion.run(min(abs(clock_moved_s), 25.0))
    assert companion.command(wire.MAV_CMD_DO_SET_MODE, 1, 4) == 0  # and then it is killed
    before = vehicle.now_us
    again = Companion(vehicle, SigningKey(path).signing(clock_s=CLOCK_S + clock_moved_s + 1.0))
    assert vehicle.now_us == before
    assert again.command(wire.MAV_CMD_DO_SET_MODE, 1, 4) == 0


def test_nothing_of_the_key_comes_out_of_the_receiver(vehicle: Simulation) -> None:
    """A SETUP_SIGNING that a ground station sends past us is neither handed out nor logged."""
    companion = Companion(vehicle, ours())
    station = wire.MAVLink(None, srcSystem=255, srcComponent=190)
    ours(NOW + TICKS_PER_S).attach(station)
    frame = wire.MAVLink_setup_signing_message(1, 1, list(KEY), NOW).pack(station)
    assert companion.receiver.feed(frame) == []
    assert companion.receiver.passed == {Passed.SECRET: 1}
