"""Messages to the values of autopilots, and answers back, against pymavlink's definitions."""

import math
import struct
from typing import Any

import pytest
from pymavlink import mavftp_op
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Ack, Sender, Text
from vehicle_sim.wire import messages
from vehicle_sim.wire.frames import Packer, StreamParser

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
    got = messages.command(sent(message), ANYBODY)
    assert (got.frame, got.number, got.sender) == (frame, 192, ANYBODY)
    assert got.parameters == pytest.approx((9, 1, 2, 3, *place, 30), nan_ok=True)


def test_set_mode_means_do_set_mode_in_either_firmware() -> None:
    for firmware, base, mode, meant in (
        ("ardupilot", 1, 4, (1, 4, 0)),
        ("px4", 209, 4 << 16 | 3 << 24, (209, 4, 3)),
    ):
        message = sent(mavlink.MAVLink_set_mode_message(1, base, mode))
        got = messages.mode_command(message, ANYBODY, firmware)  # type: ignore[arg-type]
        assert (got.number, got.parameters[:3]) == (176, meant)


def test_answers_carry_whom_they_are_for() -> None:
    answer = sent(messages.ack(Ack(to=ANYBODY, command=22, result=5, progress=40)))
    assert (answer.command, answer.result, answer.progress) == (22, 5, 40)
    assert (answer.target_system, answer.target_component) == (255, 190)
    sync = sent(messages.time_sync(7, 8, ANYBODY))
    assert bytes(sync.get_msgbuf())[10:-2] == struct.pack("<qqBB", 7, 8, 255, 190)
    assert Packer(1, 1).frame(messages.time_sync(0, 8))[1] <= 16  # a question has no target


@pytest.mark.parametrize("length", [50, 51, 57, 100, 101, 149, 150])
def test_a_text_that_does_not_fit_goes_on_in_chunks_to_a_zero_byte(length: int) -> None:
    said = "å" + "".join(chr(ord("a") + k % 26) for k in range(length - 1))
    chunks = [sent(each) for each in messages.texts(Text(severity=2, text=said), 7)]
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
    said = messages.no_files(asked, ANYBODY)
    if answer is None or said is None:
        assert said is answer
        return
    got = sent(said)
    assert (got.target_system, got.target_component) == (255, 190)
    assert struct.unpack_from("<HBBBB6xB", bytes(got.payload)) == answer
