"""Whatever comes in: nothing is raised, nothing stalls, nothing grows."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink
from receive import MESSAGES, PERSONALITIES, Target, intact

from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

NAN = float("nan")


def vehicle(autopilot: str = "ardupilot", kind: str = "copter", links: int = 1) -> Simulation:
    world = flat_world(
        kind,  # type: ignore[arg-type]
        autopilot,  # type: ignore[arg-type]
        latitude_deg=47.4,
        longitude_deg=8.5,
        altitude_amsl_m=488.0,
        heading_deg=0.0,
    )
    return Simulation(world, links=links)


class Client:
    """Sends pymavlink's messages into a simulation and reads what comes back."""

    def __init__(self, simulation: Simulation, system: int = 1, component: int = 191) -> None:
        self.simulation = simulation
        self.mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self.parser = mavlink.MAVLink(None)

    def send(self, *messages: Any) -> None:
        self.simulation.receive(0, b"".join(m.pack(self.mav) for m in messages))

    def command(self, number: int, *parameters: float) -> None:
        padded = [*parameters, *[0.0] * (7 - len(parameters))]
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded))

    def run(self, seconds: float) -> list[Any]:
        got: list[Any] = []
        for _ in range(round(seconds * 100)):
            self.simulation.step()
            for _, frame in self.simulation.take_frames():
                got += self.parser.parse_buffer(frame) or []
        return got

    def airborne(self) -> "Client":
        """An ArduCopter in GUIDED, 20 m up."""
        self.run(45.0)
        self.command(176, 1, 4)
        self.command(400, 1)
        self.command(22, 0, 0, 0, 0, 0, 0, 20)
        self.run(20.0)
        assert self.simulation.vehicle.altitude_amsl_m == pytest.approx(508.0, abs=1.0)
        return self


_target = Target()


@given(st.binary(max_size=300))
@settings(
    max_examples=300,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
def test_any_bytes_and_any_frames_do_no_harm(data: bytes) -> None:
    _target.play(data)


@pytest.mark.parametrize("pattern", [b"\xff", b"\0\0\x80\x7f", b"\0"], ids=["nan", "inf", "zero"])
@pytest.mark.parametrize(("autopilot", "kind"), PERSONALITIES)
def test_every_message_of_the_dialect_full_of_the_worst_does_no_harm(
    autopilot: str, kind: str, pattern: bytes
) -> None:
    simulation = vehicle(autopilot, kind)
    client = Client(simulation)
    client.run(1.0)
    for number in MESSAGES:
        size = mavlink.mavlink_map[number].unpacker.size
        simulation.receive(0, intact(number, (pattern * size)[:size]))
        client.run(0.02)
    assert simulation.landed


def test_of_ten_thousand_messages_a_second_the_newest_counts_and_nothing_piles_up() -> None:
    client = Client(vehicle()).airborne()
    simulation = client.simulation
    for k in range(100):  # a second of vehicle time
        setpoints = [
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, 1, 0xDF8, k, j, -20, *[0.0] * 8
            )
            for j in range(100)
        ]
        client.send(*setpoints)
        simulation.step()
    assert len(simulation.take_frames()) < 100
    client.command(511, 85, 100_000)
    (echo, *_) = [m for m in client.run(0.5) if m.get_type() == "POSITION_TARGET_LOCAL_NED"]
    assert (echo.x, echo.y) == pytest.approx((99.0, 99.0), abs=0.1)


def test_a_flood_of_questions_is_answered_and_does_not_pile_up() -> None:
    client = Client(vehicle("px4"))
    client.run(5.0)
    for _ in range(50):
        client.send(mavlink.MAVLink_param_request_list_message(1, 1))
        client.send(*[mavlink.MAVLink_mission_request_list_message(1, 1, k) for k in range(3)])
    values = [m for m in client.run(5.0) if m.get_type() == "PARAM_VALUE"]
    count = values[0].param_count
    assert count <= len(values) <= 2 * count  # one listing a link, begun again by each request


@pytest.mark.parametrize("target", [(2, 1), (1, 77), (200, 0)])
def test_what_is_for_others_is_not_done(target: tuple[int, int]) -> None:
    client = Client(vehicle("px4"))
    client.run(10.0)
    arm = mavlink.MAVLink_command_long_message(*target, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    client.send(arm)
    assert "COMMAND_ACK" not in [m.get_type() for m in client.run(1.0)]
    assert not client.simulation.armed


Damage = Callable[[bytes], bytes]


DAMAGES: dict[str, Damage] = {
    "cut": lambda frame: frame[:-1],
    "wrong checksum": lambda frame: frame[:-2] + b"\0\0",
    "half a header before": lambda frame: b"\xfd\xff" + frame,
    "markers after": lambda frame: frame + b"\xfd" * 300,
    "another version": lambda frame: b"\xfe\xff\xff" + frame[3:],
    "every byte": lambda frame: bytes(b ^ 0x55 for b in frame),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_broken_frame_does_not_take_the_next_one_with_it(damage: Damage) -> None:
    client = Client(vehicle())
    client.run(1.0)
    heartbeat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(client.mav)
    client.simulation.receive(0, damage(heartbeat))
    client.command(512, 148)
    assert "AUTOPILOT_VERSION" in [m.get_type() for m in client.run(0.1)]
