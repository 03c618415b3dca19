"""Every command, parameter and setpoint with numbers that are none: the whole vehicle lives on."""

import math
import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.parameters import Firmware
from vehicle_sim.simulation import Simulation
from vehicle_sim.wire.frames import Packer, StreamParser
from vehicle_sim.world import VehicleKind, flat_world

FIRMWARES = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
KINDS = pytest.mark.parametrize("kind", ["copter", "plane"])
WILD = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1.0, -1.0, 3.4e38, -3.4e38, 1e-45, 4.0, 192.0)
COMMANDS = sorted(number for number in mavlink.enums["MAV_CMD"] if number < 65536)
FRAMES = (0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12, 21, 255)
MASKS = (0, 0xDF8, 0xDC0, 0xC00, 0x9C0, 0xDC7)
EDGES_E7 = (0, 474_000_000, 85_000_000, -(2**31), 2**31 - 1)


class Vehicle:
    """One that is ready to be armed, and a client on its first link."""

    def __init__(self, firmware: Firmware, kind: VehicleKind) -> None:
        world = flat_world(
            kind,
            firmware,
            latitude_deg=47.4,
            longitude_deg=8.5,
            altitude_amsl_m=488.0,
            heading_deg=0.0,
        )
        self.sim = Simulation(world, seed=1)
        self.packer = Packer(255, 190)
        self.run(45.0)

    def run(self, seconds: float) -> list[Any]:
        parser, got = StreamParser(datagrams=True), []
        for _ in range(round(seconds * 100)):
            self.sim.step()
            for _, frame in self.sim.take_frames():
                got += [message for _, message in parser.feed(frame)]
        return got

    def say(self, message: Any) -> None:
        self.sim.receive(0, self.packer.frame(message))

    def lives(self) -> bool:
        """Whether heartbeats come; a reboot that was asked for may be under way."""
        return any(each.get_type() == "HEARTBEAT" for each in self.run(5.0))


@FIRMWARES
@KINDS
def test_every_command_with_every_wild_number(firmware: Firmware, kind: VehicleKind) -> None:
    rng, vehicle = random.Random(4), Vehicle(firmware, kind)
    for count, number in enumerate(COMMANDS * 6):
        p = [rng.choice(WILD) for _ in range(7)]
        if count % 2:
            vehicle.say(mavlink.MAVLink_command_long_message(1, 1, number, 0, *p))
        else:
            frame, x, y = rng.choice(FRAMES), rng.choice(EDGES_E7), rng.choice(EDGES_E7)
            vehicle.say(
                mavlink.MAVLink_command_int_message(1, 1, frame, number, 0, 0, *p[:4], x, y, p[6])
            )
        if count % 10 == 0:
            vehicle.run(0.05)
    assert vehicle.lives()


@FIRMWARES
@KINDS
def test_every_parameter_and_setpoint_with_every_wild_number(
    firmware: Firmware, kind: VehicleKind
) -> None:
    rng, vehicle = random.Random(5), Vehicle(firmware, kind)
    vehicle.say(mavlink.MAVLink_param_request_list_message(1, 1))
    values = [each for each in vehicle.run(2.0) if each.get_type() == "PARAM_VALUE"]
    assert len(values) > 100
    for value in values:
        if value.param_id.startswith("SIM_"):
            continue  # those may cut the link
        name, v = value.param_id.encode(), [rng.choice(WILD) for _ in range(11)]
        frame, mask = rng.choice(FRAMES), rng.choice(MASKS)
        x, y = rng.choice(EDGES_E7), rng.choice(EDGES_E7)
        for message in (
            mavlink.MAVLink_param_set_message(1, 1, name, rng.choice(WILD), value.param_type),
            mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *v),
            mavlink.MAVLink_set_position_target_global_int_message(
                0, 1, 1, frame, mask, x, y, *v[2:]
            ),
        ):
            vehicle.say(message)
        vehicle.run(0.02)
    assert vehicle.lives()
