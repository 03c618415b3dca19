"""The whole companion over a signed link, with the simulated ArduCopter as the other end.

Link 0 of an ArduPilot believes everybody (ardupilot.md 5), so the companion speaks on link 1.
"""

from collections.abc import Callable
from copy import deepcopy
from typing import Any, final

import pytest
from companion_receive import mission
from held import Faced
from pymavlink.dialects.v20 import all as mavlink

from companion.mavlink.frames import Receiver
from companion.mavlink.signing import Signing, key_of, timestamp_of
from companion.mission.events import Outcome
from companion.mission.state import Phase
from companion.runtime.link import Link
from companion.runtime.watchdog import Gate
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

KEY, WRONG_KEY = key_of("correct horse battery staple"), bytes(32)
NOW = timestamp_of(1_790_000_000.0)


def vehicle_with_key() -> Simulation:
    """Given its key as a ground station gives it: SETUP_SIGNING, by the link that is trusted."""
    world = flat_world(
        "copter",
        "ardupilot",
        latitude_deg=47.4,
        longitude_deg=8.5,
        altitude_amsl_m=488.0,
        heading_deg=0.0,
        scan_range_m=1_000.0,
    )
    vehicle = Simulation(world, links=2)
    station = mavlink.MAVLink(None, srcSystem=255, srcComponent=191)
    vehicle.receive(0, mavlink.MAVLink_setup_signing_message(1, 1, list(KEY), NOW).pack(station))
    return vehicle


def signing(timestamp: int = NOW, key: bytes = KEY) -> Signing:
    return Signing(key=key, timestamp=timestamp, link_id=2)


class Flight(Faced):
    """A session and its vehicle."""

    def __init__(self, vehicle: Simulation, signing: Signing | None, resume: Any = None) -> None:
        of = mission("ardupilot", "copter")
        super().__init__(of, vehicle, link=1, signing=signing, resume=resume)

    def run_until(self, condition: Callable[["Flight"], bool], within_s: float = 250.0) -> "Flight":
        self.run(within_s, lambda: condition(self))
        assert condition(self), f"not within {within_s} s: {self.session.state.phase}"
        return self

    def copy(self) -> "Flight":
        """Another one that has come as far; only the hash of the key, which stays, is the same."""
        assert self.session.signing is not None
        key = self.session.signing._hash
        return deepcopy(self, {id(key): key})


def flying(flight: Flight) -> bool:
    return flight.session.state.flight.leg is not None


@pytest.fixture(scope="module")
def on_its_way() -> Flight:
    """Over a signed link, on its first leg; flown once, flown on as a copy."""
    return Flight(vehicle_with_key(), signing()).run_until(flying)


def test_a_mission_over_a_signed_link_arrives_and_its_log_holds_no_signature(
    on_its_way: Flight,
) -> None:
    flight = on_its_way.copy()
    flight.run_until(lambda it: it.out.end is not None)
    end, ours = flight.out.end, flight.session.signing
    assert end is not None
    assert end.outcome is Outcome.ARRIVED
    assert ours is not None
    assert not ours.refused
    assert all(frame[2] & 1 for frame in flight.sent + flight.heard)
    assert len(flight.recorded) == len(flight.sent) + len(flight.heard)
    log = Receiver()
    assert len(log.feed(b"".join(flight.recorded))) == len(flight.recorded)
    assert (log.signed, log.passed.total()) == (0, 0)


@pytest.mark.parametrize("ours", [None, signing(key=WRONG_KEY)], ids=["none", "wrong"])
def test_without_the_right_key_it_never_arms(ours: Signing | None) -> None:
    vehicle = vehicle_with_key()
    flight = Flight(vehicle, ours)
    with pytest.raises(AssertionError, match="not within"):
        flight.run_until(lambda _: vehicle.armed, within_s=90.0)
    if ours is None:
        assert flight.session.receiver.signed > 0  # so preflight can say what is missing
    else:
        assert ours.refused > 0
        assert flight.session.state.phase is Phase.WAITING


def test_in_flight_only_signed_and_new_orders_are_obeyed(on_its_way: Flight) -> None:
    flight = on_its_way.copy()
    pause = mavlink.MAVLink_command_long_message(1, 195, 193, 0, 0, 0, 0, 0, 0, 0, 0)
    station = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)

    def obeyed(frame: bytes) -> bool:
        before = len(flight.sent)
        flight.hear(frame)
        messages = Receiver().feed(b"".join(flight.sent[before:]))
        return any(m.get_type() == "COMMAND_ACK" and m.command == 193 for m in messages)

    assert not obeyed(pause.pack(station))
    assert not obeyed(signing(key=WRONG_KEY).sign(pause.pack(station)))
    order = signing(NOW + 10_000_000).sign(pause.pack(station))
    assert obeyed(order)
    assert not obeyed(order)  # replayed
    ours = flight.session.signing
    assert ours is not None
    assert ours.refused == 3


def test_a_hold_that_was_kept_in_reserve_is_obeyed_whenever_and_however_often_it_is_sent(
    on_its_way: Flight,
) -> None:
    """The stream went on meanwhile, and each copy would be a replay of the one before."""
    flight = on_its_way.copy()
    reserve = flight.session.hold_frames()
    flight.run(5.0)

    sent: list[bytes] = []

    @final
    class ToVehicle(Link):
        def send(self, frames: list[bytes]) -> None:
            sent.extend(frames)

    gate = Gate(ToVehicle(), clock=lambda: 0.0, signed=flight.session.signed)
    gate.shut()
    for _ in range(3):
        gate.send_last(reserve)
    vehicle = signing()
    assert all(map(vehicle.accepts, flight.sent + sent))
    for number in range(3):  # any one of them does it
        again = flight.copy()
        assert again.vehicle.mode_name == "GUIDED"
        again.vehicle.receive(again.link, sent[number])
        again.vehicle.step()
        assert again.vehicle.mode_name == "BRAKE"


def test_a_recording_of_the_vehicle_played_back_moves_nothing(on_its_way: Flight) -> None:
    flight = on_its_way.copy()
    state = flight.session.state
    assert not flight.session.receive(b"".join(flight.heard), 1e6)
    flight.session.run()
    assert flight.session.state is state


def test_a_companion_that_is_started_again_in_flight_is_believed_at_once(
    on_its_way: Flight,
) -> None:
    flight = on_its_way.copy()
    flight.run(5.0)
    ours = flight.session.signing
    assert ours is not None
    assert flight.kept[0] is not None
    again = Flight(flight.vehicle, signing(ours.timestamp + 1), resume=flight.kept)
    again.run_until(lambda it: it.out.end is not None)
    end = again.out.end
    assert end is not None
    assert end.outcome is Outcome.ARRIVED
    assert all(frame[2] & 1 for frame in again.sent)
