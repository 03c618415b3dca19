"""MAVLink FTP says no, in the layout that pymavlink's own client reads."""

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavftp_op
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Sender
from vehicle_sim.wire import ftp
from vehicle_sim.wire.frames import Packer, StreamParser

CLIENT = Sender(system=255, component=230, link=1)


def question(opcode: int, data: bytes = b"", *, sequence: int = 7, session: int = 3) -> Any:
    operation = mavftp_op.FTP_OP(sequence, session, opcode, len(data), 0, 0, 11, bytearray(data))
    payload = list(bytes(operation.pack()).ljust(251, b"\0"))
    message = mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, payload)
    ((_, got),) = StreamParser(datagrams=True).feed(Packer(255, 230).frame(message))
    return got


def answered(opcode: int, data: bytes = b"", **head: int) -> tuple[int, ...]:
    """Sequence, session, opcode, size, opcode that is answered, burst, offset, first byte."""
    reply = ftp.answer(question(opcode, data, **head), CLIENT)
    assert reply is not None
    assert reply.to == CLIENT
    assert (reply.message.target_system, reply.message.target_component) == (255, 230)
    fields: tuple[int, ...] = struct.unpack_from("<HBBBBBxIB", bytes(reply.message.payload))
    return fields


def test_a_file_that_is_looked_for_is_not_found() -> None:
    asked = answered(4, b"@PARAM/param.pck?withdefaults=1")
    assert asked == (8, 3, 129, 1, 4, 0, 11, 10)


@pytest.mark.parametrize("opcode", [0, 1, 2])
def test_sessions_can_be_ended(opcode: int) -> None:
    assert answered(opcode) == (8, 3, 128, 0, opcode, 0, 11, 0)


@pytest.mark.parametrize(
    ("opcode", "why"), [(3, 10), (5, 4), (15, 4), (14, 10), (6, 1), (11, 1), (99, 7)]
)
def test_everything_else_is_refused_with_its_reason(opcode: int, why: int) -> None:
    assert answered(opcode)[2:5] == (129, 1, opcode)
    assert answered(opcode)[-1] == why


def test_the_sequence_number_goes_round() -> None:
    assert answered(4, sequence=65535)[0] == 0


@pytest.mark.parametrize("opcode", [128, 129])
def test_an_answer_is_not_answered(opcode: int) -> None:
    assert ftp.answer(question(opcode), CLIENT) is None


@given(payload=st.binary(min_size=251, max_size=251))
def test_whatever_is_asked_there_is_one_answer_or_none(payload: bytes) -> None:
    message = mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, list(payload))
    reply = ftp.answer(message, CLIENT)
    assert (reply is None) == (payload[3] in (128, 129))
    if reply is not None:
        assert len(Packer(1, 1).frame(reply.message)) <= 263
