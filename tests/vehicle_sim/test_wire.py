"""Frames both ways, against pymavlink's own message definitions."""

import itertools
import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim import telemetry, wire
from vehicle_sim.autopilots import Ack, Command, Sender, Setpoint, Text
from vehicle_sim.sensors import ScanBlock, ScanRequest

Make = Callable[..., Any]


def packed(*messages: Any, system: int = 1, component: int = 195) -> bytes:
    mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    return b"".join(message.pack(mav) for message in messages)


def decoded(frame: bytes) -> Any:
    (message,) = mavlink.MAVLink(None).parse_buffer(bytearray(frame))
    return message


def parsed(*messages: Any, **sender: int) -> list[wire.Received]:
    return wire.Parser(1, 100).parse(packed(*messages, **sender))


GLOBAL = mavlink.MAVLink_set_position_target_global_int_message(
    5, 1, 1, 5, 2496, 471234567, 87654321, 3000.5, 1.5, -2.5, 0.5, 0, 0, 0, 0.25, 0
)
ARM = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
SCAN = mavlink.MAVLink_terrain_request_message(470000001, 80000002, 250, (1 << 55) | 1)


def test_what_arrives_is_in_si_units() -> None:
    command_int = mavlink.MAVLink_command_int_message(
        1, 1, 3, 22, 0, 0, 0, 0, 0, 0, 470000000, 80000000, 30.0
    )
    setpoint, arm, scan, takeoff = parsed(GLOBAL, ARM, SCAN, command_int)
    assert setpoint == Setpoint(
        is_global=True,
        frame=5,
        type_mask=2496,
        position=(47.1234567, 8.7654321, 3000.5),
        velocity_ned_m_s=(1.5, -2.5, 0.5),
        acceleration_ned_m_s2=(0, 0, 0),
        yaw_rad=0.25,
    )
    assert arm == Command(
        sender=Sender(system=1, component=195),
        target_component=1,
        number=400,
        parameters=(1, 0, 0, 0, 0, 0, 0),
    )
    assert scan == ScanRequest(
        latitude_deg=47.0000001, longitude_deg=8.0000002, spacing_m=250, mask=(1 << 55) | 1
    )
    assert isinstance(takeoff, Command)
    assert (takeoff.frame, takeoff.parameters[4:]) == (3, (47.0, 8.0, 30.0))


def retargeted(message: Any, system: int, component: int) -> Any:
    message = mavlink.MAVLink(None).decode(bytearray(packed(message)))
    message.target_system, message.target_component = system, component
    return message


@pytest.mark.parametrize(
    ("sender", "target", "taken"),
    [
        ((1, 191), (1, 1), True),
        ((255, 190), (1, 1), True),
        ((0, 0), (1, 1), True),
        ((1, 1), (1, 1), False),
        ((1, 100), (1, 1), False),
        ((1, 195), (1, 0), True),
        ((1, 195), (0, 0), True),
        ((1, 195), (0, 1), True),
        ((1, 195), (1, 50), True),
        ((1, 195), (2, 1), False),
        ((1, 195), (1, 100), False),
    ],
)
def test_who_may_send_setpoints(
    sender: tuple[int, int], target: tuple[int, int], *, taken: bool
) -> None:
    message = retargeted(GLOBAL, *target)
    assert bool(parsed(message, system=sender[0], component=sender[1])) is taken


def test_commands_to_another_system_are_not_ours() -> None:
    assert parsed(retargeted(ARM, 2, 1)) == []


@given(
    rubbish=st.binary(max_size=300),
    cut=st.integers(0, 60),
    flip=st.integers(0, 40),
)
def test_garbage_neither_kills_nor_hides_the_next_frame(
    rubbish: bytes, cut: int, flip: int
) -> None:
    good = packed(ARM)
    broken = bytearray(good)
    broken[flip % len(broken)] ^= 0x55
    parser = wire.Parser(1, 100)
    parser.parse(rubbish)
    parser.parse(good[:cut])
    parser.parse(bytes(broken))
    assert len(parser.parse(good)) == 1  # whatever came before in other datagrams
    assert len([c for c in parser.parse(b"\xfd\x05\x00" + good) if isinstance(c, Command)]) == 1
    parser.parse(rubbish + good)


def test_mavlink_1_is_not_spoken() -> None:
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=195)
    assert wire.Parser(1, 100).parse(ARM.pack(mav, force_mavlink1=True)) == []


@given(sizes=st.lists(st.integers(12, 300), max_size=80))
def test_datagrams_keep_order_and_size(sizes: list[int]) -> None:
    frames = [bytes([k % 256]) * size for k, size in enumerate(sizes)]
    got = wire.datagrams(frames)
    assert b"".join(got) == b"".join(frames)
    assert all(0 < len(datagram) <= 1400 for datagram in got)
    assert all(len(a) + len(b) > 1100 for a, b in itertools.pairwise(got))


def test_sequence_numbers_count_for_each_component() -> None:
    packer = wire.Packer(1, 100)
    frames = [packer.frame(wire.radar_heartbeat()) for _ in range(257)]
    assert [decoded(f).get_seq() for f in frames] == [*range(256), 0]
    packer.restart()
    assert decoded(packer.frame(wire.radar_heartbeat())).get_seq() == 0


def test_answers_carry_whom_they_are_for() -> None:
    packer = wire.Packer(1, 1)
    answer = decoded(
        packer.frame(wire.ack(Ack(to=Sender(system=255, component=190), command=22, result=4)))
    )
    assert (answer.command, answer.result) == (22, 4)
    assert (answer.target_system, answer.target_component) == (255, 190)
    text = decoded(packer.frame(wire.text(Text(severity=4, text="å" + "x" * 80))))
    assert text.text == "?" + "x" * 49


def test_a_terrain_block_keeps_corner_bit_and_order() -> None:
    request = ScanRequest(latitude_deg=-33.1234567, longitude_deg=-70.5, spacing_m=250, mask=1 << 9)
    block = ScanBlock(gridbit=9, heights_amsl_m=tuple(range(-8, 8)))
    got = decoded(wire.Packer(1, 100).frame(wire.terrain_data(request, block)))
    assert (got.lat, got.lon) == (-331234567, -705000000)
    assert (got.grid_spacing, got.gridbit, got.data) == (250, 9, list(range(-8, 8)))


def say(it: Any, number: int) -> Any:
    message = telemetry.MESSAGES[number](it.autopilot.report())
    return None if message is None else decoded(wire.Packer(1, 1).frame(message))


def test_telemetry_is_in_mavlinks_units(pilot: Make) -> None:
    it = pilot(ground_amsl_m=70.0).airborne(100.0)
    it.setpoint((47.0, 8.0, 170.0), (3.0, -4.0, 0.0), mask=0x9C7, yaw_rad=-0.5)
    it.run(2.9)
    copter = it.copter
    position = say(it, 33)
    assert position.time_boot_ms == it.now_us // 1000
    assert position.lat == pytest.approx(copter.latitude_deg * 1e7, abs=0.51)
    assert position.lon == pytest.approx(copter.longitude_deg * 1e7, abs=0.51)
    assert position.alt == pytest.approx(copter.altitude_amsl_m * 1e3, abs=0.51)
    assert position.relative_alt == pytest.approx((copter.altitude_amsl_m - 70.0) * 1e3, abs=0.51)
    assert position.vx == pytest.approx(copter.velocity_north_m_s * 100, abs=0.51)
    assert position.vy == pytest.approx(copter.velocity_east_m_s * 100, abs=0.51)
    assert position.hdg == pytest.approx(math.degrees(-0.5 % math.tau) * 100, abs=1)
    beat = say(it, 0)
    assert (beat.type, beat.autopilot, beat.custom_mode) == (2, 3, 4)
    assert (beat.base_mode, beat.system_status) == (217, 4)
    assert say(it, 245).landed_state == 2
    assert say(it, 24).fix_type == 6
    assert say(it, 193).flags == 0x33F
    assert say(it, 1).onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert say(it, 242).altitude == 70_000
    assert say(it, 49).latitude == 470_000_000
    assert say(it, 30).yaw == pytest.approx(-0.5, abs=1e-6)
    assert say(it, 74).groundspeed == pytest.approx(
        math.hypot(copter.velocity_north_m_s, copter.velocity_east_m_s)
    )
    local = say(it, 32)
    scale = 0.011131884502145034
    assert local.x == pytest.approx((copter.latitude_deg - 47.0) * 1e7 * scale, abs=1e-3)
    assert local.z == pytest.approx(-(copter.altitude_amsl_m - 70.0), abs=1e-3)
    echo = say(it, 85)
    assert (echo.vx, echo.vy, echo.coordinate_frame) == (3.0, -4.0, 1)
    assert echo.type_mask & 0x007


def test_there_is_nothing_to_say_before_there_is_a_position(pilot: Make) -> None:
    it = pilot()
    it.run(5.0)
    assert (say(it, 33).lat, say(it, 33).lon) == (0, 0)
    assert [say(it, number) for number in (32, 49, 85, 242)] == [None] * 4
