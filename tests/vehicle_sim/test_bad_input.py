"""Whatever comes in: nothing is raised, nothing stalls, nothing grows, and the vehicle lives on."""

import math
import random
from typing import Any

import pytest
from harness import KINDS, flying, local, ready
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink
from receive import MESSAGES, Target, intact

from vehicle_sim.plans import PlanItem, PlanKind

WILD = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1.0, -1.0, 3.4e38, -3.4e38, 1e-45, 4.0, 192.0)
COMMANDS = sorted(number for number in mavlink.enums["MAV_CMD"] if number < 65536)
FRAMES = (0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12, 21, 255)
MASKS = (0, 0xDF8, 0xDC0, 0xC00, 0x9C0, 0xDC7)
EDGES_E7 = (0, 474_000_000, 85_000_000, -(2**31), 2**31 - 1)

_target = Target()


@given(st.binary(max_size=300))
@settings(
    max_examples=100, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
def test_any_bytes_and_any_frames_do_no_harm(data: bytes) -> None:
    _target.play(data)


def command(rng: random.Random, number: int) -> Any:
    """COMMAND_LONG or COMMAND_INT with anything in it."""
    p = [rng.choice(WILD) for _ in range(7)]
    if rng.random() < 0.5:
        return mavlink.MAVLink_command_long_message(1, 1, number, 0, *p)
    frame, x, y = rng.choice(FRAMES), rng.choice(EDGES_E7), rng.choice(EDGES_E7)
    return mavlink.MAVLink_command_int_message(1, 1, frame, number, 0, 0, *p[:4], x, y, p[6])


def setpoints(rng: random.Random) -> list[Any]:
    """Of both kinds."""
    v, frame, mask = [rng.choice(WILD) for _ in range(11)], rng.choice(FRAMES), rng.choice(MASKS)
    x, y = rng.choice(EDGES_E7), rng.choice(EDGES_E7)
    return [
        mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *v),
        mavlink.MAVLink_set_position_target_global_int_message(0, 1, 1, frame, mask, x, y, *v[2:]),
    ]


@pytest.mark.parametrize(("autopilot", "kind"), KINDS)
def test_every_message_command_parameter_and_setpoint_with_every_wild_number(
    autopilot: Any, kind: Any
) -> None:
    rng, client = random.Random(4), ready(autopilot, kind)
    rows = client.simulation.parameters.rows.values()
    own = [row for row in rows if not row.name.startswith("SIM_")]  # those may cut the link
    assert len(own) > 30
    for count, number in enumerate(COMMANDS * 4):
        row = own[count % len(own)]
        client.send(
            command(rng, number),
            mavlink.MAVLink_param_set_message(1, 1, row.name.encode(), rng.choice(WILD), row.kind),
            *setpoints(rng),
        )
        if count % 10 == 0:
            client.run(0.05)
    for number in MESSAGES:
        for pattern in (b"\xff", b"\0\0\x80\x7f", b"\0"):  # not a number, infinite
            size = mavlink.mavlink_map[number].unpacker.size
            client.put(intact(number, (pattern * size)[:size]))
        client.run(0.02)
    assert any(each.kind == "HEARTBEAT" for each in client.run(5.0))  # or it reboots


ACTED_ON = (16, 17, 20, 21, 22, 115, 176, 178, 179, 192, 207, 224, 300, 400, 43000, 43001, 43002)
OF_PLANS = (16, 17, 18, 19, 20, 21, 22, 177, 178, 201, 5001, 5002, 5003, 5004, 5100, 0, 65535)
TELLING = (1, 24, 30, 32, 33, 42, 62, 74, 85, 87, 162, 242, 245)
HAPPENS = ("for 1 s: gps_off", "for 2 s: gps_glitch 30 m up", "pilot", "estimator_reset 300 m west")
HAPPENS += ("origin_move 300 m north", "for 2 s: wind 20 m/s from 90 deg turbulence 5")


def plan(rng: random.Random) -> tuple[PlanItem, ...]:
    """Up to six items, of any sense."""
    return tuple(
        PlanItem(
            frame=rng.choice(FRAMES),
            command=rng.choice(OF_PLANS),
            parameters=tuple(rng.choice(WILD) for _ in range(4)),  # type: ignore[arg-type]
            x=rng.choice(EDGES_E7),
            y=rng.choice(EDGES_E7),
            z_m=rng.choice((*WILD, 30.0)),
        )
        for _ in range(rng.randrange(7))
    )


@pytest.mark.sample(3)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("autopilot", "kind"), KINDS)
def test_a_flight_survives_whatever_comes_and_tells_finite_things(
    autopilot: Any, kind: Any, seed: int
) -> None:
    """Orders, setpoints, parameters, plans and faults in any order, sense or none in each."""
    rng, client = random.Random(seed), flying(autopilot, kind)
    simulation, names = client.simulation, list(client.simulation.parameters)
    own = [name.encode() for name in names if not name.startswith("SIM_")]
    for number in TELLING:
        client.command(511, number, 100_000)
    modes = (1.0, 3.0, 4.0, 5.0, 6.0, 9.0, 10.0, 11.0, 15.0)
    for _ in range(40):
        match rng.randrange(6):
            case 0:
                client.send(command(rng, rng.choice(ACTED_ON)))
            case 1:
                client.command(176, 1, rng.choice(modes), float(rng.randrange(9)))
            case 2:
                for _ in range(3):
                    client.send(*setpoints(rng))
                    client.run(0.2)
            case 3:
                name = rng.choice(own)
                client.send(mavlink.MAVLink_param_set_message(1, 1, name, rng.choice(WILD), 9))
            case 4:
                kept = rng.choice(list(PlanKind))
                simulation.plans[kept] = plan(rng)
                simulation._controller.answer(simulation._controller.autopilot.on_plan(kept))
            case _:
                simulation.add_fault(rng.choice(HAPPENS))
        begun = len(client.heard)
        client.run(rng.choice((0.05, 0.3, 1.5)))
        vehicle = simulation.vehicle
        angles = vehicle.roll_rad + vehicle.pitch_rad + vehicle.heading_rad
        assert math.isfinite(angles + vehicle.airspeed_m_s + sum(vehicle.velocity_neu_m_s))
        assert abs(vehicle.latitude_deg) <= 90.0
        assert abs(vehicle.longitude_deg) <= 180.0
        assert simulation.contact.ground_amsl_m - 41.0 <= vehicle.altitude_amsl_m < 2e6
        assert 0.0 <= vehicle.throttle <= 1.0
        for each in client.heard[begun:]:
            if each.kind in ("LOCAL_POSITION_NED", "ATTITUDE"):
                fields = each.message.to_dict().values()
                assert all(math.isfinite(field) for field in fields if isinstance(field, float))


def test_of_ten_thousand_messages_a_second_the_newest_counts_and_nothing_piles_up() -> None:
    client = flying("ardupilot", "copter")
    begun = len(client.heard)
    for k in range(100):  # a second of vehicle time
        client.send(*(local((k, j, -20.0)) for j in range(100)))
        client.step()
    assert len(client.heard) - begun < 100
    client.command(511, 85, 100_000)
    client.run(0.5)
    echo = client.last("POSITION_TARGET_LOCAL_NED")
    assert (echo.x, echo.y) == pytest.approx((99.0, 99.0), abs=0.1)


def test_a_flood_of_questions_is_answered_and_does_not_pile_up() -> None:
    client = ready("px4", "copter")
    for _ in range(50):
        client.send(mavlink.MAVLink_param_request_list_message(1, 1))
        client.send(*[mavlink.MAVLink_mission_request_list_message(1, 1, k) for k in range(3)])
    values = [each.message for each in client.run(5.0) if each.kind == "PARAM_VALUE"]
    count = values[0].param_count
    assert count <= len(values) <= 2 * count  # one listing a link, begun again by each request
