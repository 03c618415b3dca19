"""Messages to the values of autopilots and back, and telemetry, against pymavlink's definitions."""

import math
import struct
from typing import Any

import pytest
from harness import copied
from pymavlink import mavftp_op
from pymavlink.dialects.v20 import all as mavlink
from pymavlink.quaternion import QuaternionBase as Quaternion
from rigs import ArduCopter, Px4Copter, Rig, hovering

from vehicle_sim.autopilot import px4plane
from vehicle_sim.autopilot.values import Ack, Battery, Report, Sender, Text
from vehicle_sim.flight_controller import HANDLERS, ack, command, mode_command, texts
from vehicle_sim.wire.frames import Packer, StreamParser, make, number_of
from vehicle_sim.wire.telemetry import MESSAGES

ANYBODY = Sender(system=255, component=190, link=2)


def sent(message: Any) -> Any:
    """As it arrives at the other end."""
    ((_, got),) = StreamParser(datagrams=True).feed(Packer(255, 190).frame(message))
    return got


@pytest.mark.parametrize(
    ("frame", "x", "y", "place"),
    [
        (3, 470000000, -80000000, (47.0, -8.0)),
        (1, 12345, -5000, (1.2345, -0.5)),
        (5, 0x7FFFFFFF, 0, (math.nan, 0.0)),
    ],
)
def test_the_place_of_a_command_int_is_in_degrees_or_metres(
    frame: int, x: int, y: int, place: tuple[float, float]
) -> None:
    message = mavlink.MAVLink_command_int_message(1, 1, frame, 192, 0, 0, 9, 1, 2, 3, x, y, 30)
    got = command(sent(message), ANYBODY)
    assert (got.frame, got.number, got.sender) == (frame, 192, ANYBODY)
    assert got.parameters == pytest.approx((9, 1, 2, 3, *place, 30), nan_ok=True)


def test_set_mode_means_do_set_mode_in_either_firmware() -> None:
    for firmware, base, mode, meant in (
        ("ardupilot", 1, 4, (1, 4, 0)),
        ("px4", 209, 4 << 16 | 3 << 24, (209, 4, 3)),
    ):
        message = sent(mavlink.MAVLink_set_mode_message(1, base, mode))
        got = mode_command(message, ANYBODY, firmware)  # type: ignore[arg-type]
        assert (got.number, got.parameters[:3]) == (176, meant)


def test_answers_carry_whom_they_are_for() -> None:
    answer = sent(ack(Ack(to=ANYBODY, command=22, result=5)))
    assert (answer.command, answer.result) == (22, 5)
    assert (answer.target_system, answer.target_component) == (255, 190)
    sync = sent(make("TIMESYNC", 7, 8, 255, 190))
    assert bytes(sync.get_msgbuf())[10:-2] == struct.pack("<qqBB", 7, 8, 255, 190)
    assert Packer(1, 1).frame(make("TIMESYNC", 0, 8))[1] <= 16  # a question has no target


@pytest.mark.parametrize("length", [50, 51, 57, 100, 101, 149, 150])
def test_a_text_that_does_not_fit_goes_on_in_chunks_to_a_zero_byte(length: int) -> None:
    said = "å" + "".join(chr(ord("a") + k % 26) for k in range(length - 1))
    chunks = [sent(each) for each in texts(Text(severity=2, text=said), 7)]
    assert "".join(chunk.text for chunk in chunks) == said.replace("å", "?")
    assert [chunk.chunk_seq for chunk in chunks] == list(range(len(chunks)))
    assert {chunk.id for chunk in chunks} == {7 if length > 50 else 0}
    assert [len(chunk.text) for chunk in chunks[:-1]] == [50] * (len(chunks) - 1)
    assert len(chunks[-1].text) < 50 or length == 50  # a zero byte ends it


@pytest.mark.parametrize(
    ("opcode", "data", "answer"),
    [
        (4, b"@PARAM/param.pck?withdefaults=1", (8, 3, 129, 1, 4, 10)),  # not found
        (15, b"", (8, 3, 129, 1, 15, 10)),
        (2, b"", (8, 3, 128, 0, 2, 0)),  # sessions can be ended
        (129, b"", None),  # that is an answer
    ],
)
def test_there_are_no_files(opcode: int, data: bytes, answer: tuple[int, ...] | None) -> None:
    """Asked for in the layout of pymavlink's own client."""
    operation = mavftp_op.FTP_OP(7, 3, opcode, len(data), 0, 0, 11, bytearray(data))
    payload = list(bytes(operation.pack()).ljust(251, b"\0"))
    asked = sent(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, payload))
    said: Any = list(HANDLERS["FILE_TRANSFER_PROTOCOL"](Any, asked, ANYBODY))  # type: ignore[arg-type]
    assert len(said) == (answer is not None)
    if answer is None:
        return
    got = sent(said[0].message)
    assert (got.target_system, got.target_component) == (255, 190)
    assert struct.unpack_from("<HBBBB6xB", bytes(got.payload)) == answer


ARDUPILOT, PX4 = MESSAGES["ardupilot"], MESSAGES["px4"]


def read(said: Any) -> Any:
    """As pymavlink reads it out of its frame."""
    return mavlink.MAVLink(None).decode(bytearray(Packer(1, 1).frame(said)))


def report_of(rig: Rig) -> Report:
    """Of a vehicle in the tests of its autopilot."""
    told = {"autopilot": rig.autopilot, "time_us": rig.now_us, "fix": rig.fix, "hardware_id": 7}
    return Report(**told, battery=Battery())


@copied
def copter() -> ArduCopter:
    it = hovering()
    for k in range(500):
        if k % 10 == 0:
            it.aim((0.0, 0.0, -30.0), (k * 0.01, 0.0, 0.0), (0.0, 0.0, 0.0))
        it.step()
    return it


@copied
def multicopter() -> Px4Copter:
    return Px4Copter().take_off(12.0).stream(3.0, None, (5.0, 3.0, 0.0))


def test_every_message_can_be_packed_and_read_again() -> None:
    """Also before there is anything to say."""
    booting, fresh = ArduCopter().run(5.0), Px4Copter()
    fresh.step()
    for builders, rigs in ((ARDUPILOT, (booting, copter())), (PX4, (fresh, multicopter()))):
        for number, build in builders.items():
            saids = [build(report_of(rig)) for rig in rigs]
            for frame in map(Packer(1, 1).frame, filter(None, saids)):
                assert number_of(frame) == number
                assert mavlink.MAVLink(None).decode(bytearray(frame)).get_msgId() == number
    assert {*px4plane.FIRMWARE.profile.rates_hz, 49, 148} <= set(PX4)


def test_where_it_is_is_told_alike_by_all_messages() -> None:
    """Truth and estimate differ by what the receiver's delay makes of the speed."""
    for builders, rig in ((ARDUPILOT, copter()), (PX4, multicopter())):
        report, vehicle = report_of(rig), report_of(rig).vehicle
        told = {number: read(build(report)) for number, build in builders.items() if build(report)}
        place, attitude, local_m = told[33], told[30], told[32]
        assert place.lat * 1e-7 == pytest.approx(vehicle.latitude_deg, abs=3e-5)
        assert place.lon * 1e-7 == pytest.approx(vehicle.longitude_deg, abs=3e-5)
        assert place.alt * 1e-3 == pytest.approx(vehicle.altitude_amsl_m, abs=1.0)
        assert place.relative_alt * 1e-3 == pytest.approx(-local_m.z, abs=0.2)
        assert (place.vx, place.vy) == pytest.approx((local_m.vx * 100, local_m.vy * 100), abs=1.0)
        assert (told[74].groundspeed, told[74].climb) == pytest.approx(
            (math.hypot(local_m.vx, local_m.vy), -local_m.vz)
        )
        assert attitude.roll == pytest.approx(vehicle.roll_rad, abs=1e-6)
        assert place.hdg == pytest.approx(math.degrees(attitude.yaw) % 360.0 * 100.0, abs=1.0)
        wanted = Quaternion([attitude.roll, attitude.pitch, attitude.yaw]).q
        by_itself = told[31]
        assert [by_itself.q1, by_itself.q2, by_itself.q3, by_itself.q4] == pytest.approx(wanted)
        if 331 in told:
            assert told[331].q == pytest.approx(wanted)
            assert (told[331].x, told[331].vx, told[331].yawspeed, told[331].estimator_type) == (
                *(local_m.x, local_m.vx, attitude.yawspeed, 8),
            )
