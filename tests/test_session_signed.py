"""The whole companion over a signed link, with the simulated ArduCopter as the other end.

Link 0 of an ArduPilot believes everybody (ardupilot.md 5), so the companion speaks on link 1.
"""

from copy import deepcopy
from typing import final

import pytest
from companion_receive import mission
from held import Faced, level
from pymavlink.dialects.v20 import all as mavlink

from companion.mavlink.frames import Receiver
from companion.mavlink.signing import Signing, key_of, timestamp_of
from companion.runtime.link import Link
from companion.runtime.watchdog import Gate
from vehicle_sim.simulation import Simulation

KEY = key_of("correct horse battery staple")
NOW = timestamp_of(1_790_000_000.0)


def signing() -> Signing:
    return Signing(key=KEY, timestamp=NOW)


@pytest.fixture(scope="module")
def on_its_way() -> Faced:
    """On its first leg; the vehicle has its key by SETUP_SIGNING on the link that is trusted."""
    world = level("ardupilot", "copter", (47.4, 8.5, 488.0), scan_range_m=1_000.0)
    vehicle = Simulation(world, links=2)
    flight = Faced(mission("ardupilot", "copter"), vehicle, link=1, signing=signing())
    flight.station(mavlink.MAVLink_setup_signing_message(1, 1, list(KEY), NOW), link=0)
    flight.run(250.0, until=lambda: flight.session.state.leg is not None)
    return flight


def copy(flight: Faced) -> Faced:
    """Another one that has come as far; only the hash of the key, which stays, is the same."""
    assert flight.session.signing is not None
    key = flight.session.signing._hash
    return deepcopy(flight, {id(key): key})


def test_all_that_is_said_over_a_signed_link_is_signed_and_its_log_holds_no_signature(
    on_its_way: Faced,
) -> None:
    flight = on_its_way
    assert flight.session.signing is not None
    assert not flight.session.signing.refused
    assert all(frame[2] & 1 for frame in flight.sent + flight.heard)
    assert len(flight.recorded) == len(flight.sent) + len(flight.heard)
    log = Receiver()
    assert len(log.feed(b"".join(flight.recorded))) == len(flight.recorded)
    assert (log.signed, log.passed) == (0, 0)


def test_a_hold_that_was_kept_in_reserve_is_obeyed_whenever_and_however_often_it_is_sent(
    on_its_way: Faced,
) -> None:
    """The stream went on meanwhile, and each copy would be a replay of the one before."""
    flight = copy(on_its_way)
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
        again = copy(flight)
        assert again.vehicle.mode_name == "GUIDED"
        again.vehicle.receive(again.link, sent[number])
        again.vehicle.step()
        assert again.vehicle.mode_name == "BRAKE"
