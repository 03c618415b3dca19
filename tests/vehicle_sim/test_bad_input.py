"""Whatever comes in: nothing is raised, nothing stalls, nothing grows, and the vehicle lives on."""

import random
from typing import Any

import pytest
from harness import KINDS, Rig, flying, setpoint
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink
from random_programs import VALUES, Reader, intact
from random_programs import command as wild_command
from receive import MESSAGES, Target, check

COMMANDS = sorted(number for number in mavlink.enums["MAV_CMD"] if number < 65536)
ALL_FOUR = pytest.mark.parametrize(("autopilot", "kind"), KINDS)
_target = Target()


@given(st.binary(max_size=300))
@settings(
    max_examples=100, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
def test_any_bytes_and_any_frames_do_no_harm(data: bytes) -> None:
    _target.play(data)


@ALL_FOUR
def test_wild_numbers_in_any_message_or_parameter_do_no_harm(autopilot: Any, kind: Any) -> None:
    rng, codec = random.Random(4), mavlink.MAVLink(None, *(255, 190))
    client = Rig(autopilot, kind).armable()
    client.command(511, 24, 100_000)
    rows = [*client.simulation.parameters.rows.values()]
    assert len(rows) > 40
    for count, number in enumerate(COMMANDS * 4):
        row, value = rows[count % len(rows)], rng.choice(VALUES)
        client.put(wild_command(Reader(rng.randbytes(12)), (number,), codec, (1, 1)))
        client.send(mavlink.MAVLink_param_set_message(1, 1, row.name.encode(), value, row.kind))
        if count % 10 == 0:
            client.run(0.05)
            check(client.simulation)
    for number in MESSAGES:
        for pattern in (b"\xff", b"\0\0\x80\x7f", b"\0"):  # not a number, infinite
            size = mavlink.mavlink_map[number].unpacker.size
            client.put(intact(number, (pattern * size)[:size]))
        client.run(0.02)
    alive_s = client.run(5.0).all("HEARTBEAT")[-1].at_s  # or it reboots
    assert alive_s > client.now_s - 5.0


@pytest.mark.sample(3)
@pytest.mark.parametrize("seed", range(3))
@ALL_FOUR
def test_in_flight_whatever_comes_leaves_all_finite(autopilot: Any, kind: Any, seed: int) -> None:
    """Orders, setpoints, parameters, plans and faults in any order, sense or none in each."""
    rng, client = random.Random(seed), flying(autopilot, kind)
    for number in (1, 24, 30, 32, 33, 42, 62, 74, 85, 87, 162, 242, 245):
        client.command(511, number, 100_000)
    for _ in range(30):
        _target.play(rng.randbytes(500), client.copy().simulation)


def test_of_ten_thousand_messages_a_second_the_newest_counts_and_nothing_piles_up() -> None:
    client = flying("ardupilot", "copter")
    begun = len(client.heard)
    for k in range(100):  # a second of vehicle time
        client.send(*(setpoint((k, j, -20.0)) for j in range(100)))
        client.step()
    assert len(client.heard) - begun < 100
    client.command(511, 85, 100_000)
    client.run(0.5)
    echo = client.last("POSITION_TARGET_LOCAL_NED")
    assert (echo.x, echo.y) == pytest.approx((99.0, 99.0), abs=0.1)
