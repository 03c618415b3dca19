"""Messages to the values of autopilots, and answers back, against pymavlink's definitions."""

import math
import struct
from typing import Any

import pytest
from hypothesis import strategies as st
from pymavlink import mavftp_op
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Ack, Sender, Text
from vehicle_sim.wire import messages
from vehicle_sim.wire.frames import Packer, StreamParser

ANYBODY = Sender(system=255, component=190, link=2)
FLOATS = st.floats(width=32)


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
    assert got.frame == frame
    assert got.parameters == pytest.approx((9, 1, 2, 3, *place, 30), nan_ok=True)


def test_set_mode_means_do_set_mode_in_either_firmware() -> None:
    ardupilot = mavlink.MAVLink_set_mode_message(1, 1, 4)
    got = messages.mode_command(sent(ardupilot), ANYBODY, "ardupilot")
    assert (got.number, got.parameters[:3]) == (176, (1, 4, 0))
    px4 = mavlink.MAVLink_set_mode_message(1, 209, 4 << 16 | 3 << 24)
    assert messages.mode_command(sent(px4), ANYBODY, "px4").parameters[:3] == (209, 4, 3)


def test_answers_carry_whom_they_are_for() -> None:
    answer = sent(messages.ack(Ack(to=ANYBODY, command=22, result=5, progress=40)))
    assert (answer.command, answer.result, answer.progress) == (22, 5, 40)
    assert (answer.target_system, answer.target_component) == (255, 190)
    sync = sent(messages.time_sync(7, 8, ANYBODY))
    assert (sync.tc1, sync.ts1) == (7, 8)
    assert bytes(sync.get_msgbuf())[10:-2] == struct.pack("<qqBB", 7, 8, 255, 190)
    question = Packer(1, 1).frame(messages.time_sync(0, 8))
    assert question[1] <= 16  # no target


def test_a_text_that_is_too_long_or_foreign_still_goes_out() -> None:
    (short,) = messages.texts(Text(severity=4, text="å" + "x" * 49), 7)
    assert (sent(short).text, sent(short).id) == ("?" + "x" * 49, 0)


@pytest.mark.parametrize("length", [51, 57, 100, 101, 149, 150])
def test_a_text_that_does_not_fit_goes_on_in_chunks_to_a_zero_byte(length: int) -> None:
    said = "".join(chr(ord("a") + k % 26) for k in range(length))
    chunks = [sent(each) for each in messages.texts(Text(severity=2, text=said), 7)]
    assert "".join(chunk.text for chunk in chunks) == said
    assert [chunk.chunk_seq for chunk in chunks] == list(range(len(chunks)))
    assert {chunk.id for chunk in chunks} == {7}
    assert [len(chunk.text) for chunk in chunks[:-1]] == [50] * (len(chunks) - 1)
    assert len(chunks[-1].text) < 50  # a zero byte ends it


# --- files ----------------------------------------------------------------------------------------


def asked_for_a_file(opcode: int, data: bytes = b"") -> Any:
    """In the layout of pymavlink's own client."""
    operation = mavftp_op.FTP_OP(7, 3, opcode, len(data), 0, 0, 11, bytearray(data))
    payload = list(bytes(operation.pack()).ljust(251, b"\0"))
    return sent(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, payload))


@pytest.mark.parametrize(
    ("opcode", "data", "answer"),
    [
        (4, b"@PARAM/param.pck?withdefaults=1", (8, 3, 129, 1, 4, 10)),  # not found
        (15, b"", (8, 3, 129, 1, 15, 10)),
        (2, b"", (8, 3, 128, 0, 2, 0)),  # sessions can be ended
    ],
)
def test_there_are_no_files(opcode: int, data: bytes, answer: tuple[int, ...]) -> None:
    said = messages.no_files(asked_for_a_file(opcode, data), ANYBODY)
    assert said is not None
    got = sent(said)
    assert (got.target_system, got.target_component) == (255, 190)
    assert struct.unpack_from("<HBBBB6xB", bytes(got.payload)) == answer
    assert messages.no_files(asked_for_a_file(129), ANYBODY) is None  # that is an answer
