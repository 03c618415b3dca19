"""Bytes, messages and values, both ways: against pymavlink's own parser, packer, signer, reader."""

import itertools
import random
import struct
from typing import Any

import pytest
from harness import COMPANION, VEHICLE, ZERO, Rig, flying, hover, hovering, setpoint
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavftp_op
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Text
from vehicle_sim.flight_controller import texts
from vehicle_sim.wire.frames import StreamParser, framed

ARM = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 7.5)
BEAT = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
TEXT = mavlink.MAVLink_statustext_message(4, b"a text that is long enough for all of its 50 bytes")
KINDS = sorted(mavlink.mavlink_map.values(), key=lambda kind: kind.id)
approx = pytest.approx


def packed(message: Any, *, old: bool = False) -> bytes:
    mav = mavlink.MAVLink(None, srcSystem=7, srcComponent=195)
    return bytes(message.pack(mav, force_mavlink1=old))


def decoded(frame: bytes) -> Any:
    return mavlink.MAVLink(None).decode(bytearray(frame))


def sent(message: Any) -> Any:
    """As we read what we pack."""
    ((_, got),) = StreamParser(datagrams=True).feed(framed(message, 0, 255, 190))
    return got


# --- frames ---------------------------------------------------------------------------------------


def filled(kind: Any, rng: random.Random) -> bytes:
    """An intact frame of any message, with random fields."""
    payload = rng.randbytes(rng.randint(0, kind.unpacker.size)).ljust(kind.unpacker.size, b"\0")
    frame = bytes([253, len(payload), 0, 0, 9, 7, 195, *kind.id.to_bytes(3, "little")]) + payload
    crc: int = mavlink.x25crc(frame[1:] + bytes([kind.crc_extra])).crc
    return frame + struct.pack("<H", crc)


def same(got: Any, wanted: Any) -> bool:
    heads = [bytes(each.get_header().pack()) for each in (got, wanted)]
    return repr(got.to_dict()) == repr(wanted.to_dict()) and heads[0] == heads[1]


def test_every_message_of_the_dialect_is_read_and_packed_as_pymavlink_does_it() -> None:
    rng = random.Random(1)
    mav = mavlink.MAVLink(None, srcSystem=3, srcComponent=4)
    for kind in KINDS:
        frame = filled(kind, rng)
        ((raw, got),) = StreamParser(datagrams=True).feed(frame)
        assert raw == frame
        assert same(got, decoded(frame)), kind
        if kind is not mavlink.MAVLink_test_types_message:  # a lone zero is more than it can pack
            assert framed(got, mav.seq, 3, 4) == decoded(frame).pack(mav), kind
            mav.seq = (mav.seq + 1) % 256


@given(
    old=st.booleans(),
    cuts=st.lists(st.integers(0, 400), max_size=12),
    noise=st.binary(max_size=9).filter(lambda raw: not set(raw) & {0xFD, 0xFE}),
)
def test_a_stream_may_be_cut_anywhere(old: bool, cuts: list[int], noise: bytes) -> None:
    messages = (ARM, BEAT, TEXT) * 2
    stream = noise.join([b"", *(packed(message, old=old) for message in messages)])
    edges = sorted({0, len(stream), *(cut for cut in cuts if cut < len(stream))})
    parser = StreamParser(datagrams=False)
    got = [message for a, b in itertools.pairwise(edges) for _, message in parser.feed(stream[a:b])]
    assert [message.to_dict() for message in got] == [m.to_dict() for m in messages]


@given(rubbish=st.binary(max_size=300), cut=st.integers(0, 44), flip=st.integers(0, 44))
def test_a_broken_datagram_cannot_hide_the_next_one(rubbish: bytes, cut: int, flip: int) -> None:
    good = packed(ARM)
    broken = bytearray(good)
    broken[flip % len(good)] ^= 0x55
    parser = StreamParser(datagrams=True)
    for datagram in (rubbish, good[:cut], bytes(broken)):
        parser.feed(datagram)
        assert parser.feed(good)[0][0] == good
    assert parser.feed(rubbish + good)[-1][0] == good
    inside = b"\xfd\xff\x00\x00\x00\x01\x01\x00\x00\x00" + good + bytes(300)
    assert [frame for frame, _ in parser.feed(inside)] == [good]


def flagged(flags: int, crc_is_off_by: int = 0) -> bytes:
    """A command with these flags of things that a reader has to understand."""
    body = packed(ARM)[:2] + bytes([flags]) + packed(ARM)[3:-2]
    crc = mavlink.x25crc(body[1:] + bytes([ARM.crc_extra])).crc ^ crc_is_off_by
    return body + struct.pack("<H", crc)


def test_what_is_no_frame_of_mavlink_is_passed_over_and_an_unknown_one_costs_only_itself() -> None:
    assert len(StreamParser(datagrams=True).feed(flagged(0))) == 1
    for datagram in (flagged(0, 1), flagged(0)[:-1], flagged(2), flagged(3) + bytes(13)):
        assert StreamParser(datagrams=True).feed(datagram) == []
    parser = StreamParser(datagrams=False)
    for number in range(100_000, 101_000):
        head = bytes([253, 9, 0, 0, 0, 1, 1, *number.to_bytes(3, "little")])
        assert len(parser.feed(head + b"\xfd\xff\x00" * 3 + b"\0\0" + packed(BEAT))) == 1


# --- messages and values --------------------------------------------------------------------------


@pytest.mark.parametrize(("firmware", "base", "mode"), [("ardupilot", 1, 9), ("px4", 209, 6 << 16)])
def test_set_mode_means_do_set_mode(firmware: Any, base: int, mode: int) -> None:
    vehicle = flying(firmware, "copter")
    vehicle.streamed = setpoint(None, ZERO)
    vehicle.run(1.0).send(mavlink.MAVLink_set_mode_message(1, base, mode))
    assert vehicle.run(0.1).mode == ("Offboard" if firmware == "px4" else "LAND")


@pytest.mark.parametrize("length", [50, 51, 100, 149])
def test_a_text_that_does_not_fit_goes_on_in_chunks_to_a_zero_byte(length: int) -> None:
    said = "å" + "".join(chr(ord("a") + k % 26) for k in range(length - 1))
    chunks = [sent(each) for each in texts(Text(severity=2, text=said), 7)]
    assert "".join(chunk.text for chunk in chunks) == said.replace("å", "?")
    assert [chunk.chunk_seq for chunk in chunks] == list(range(len(chunks)))
    assert {chunk.id for chunk in chunks} == {7 if length > 50 else 0}
    assert [len(chunk.text) for chunk in chunks[:-1]] == [50] * (len(chunks) - 1)
    assert len(chunks[-1].text) < 50 or length == 50  # a zero byte ends it


# --- telemetry ------------------------------------------------------------------------------------


def test_every_message_can_be_packed_and_read_again() -> None:
    """Also before there is anything to say."""
    for rig in (Rig().run(5.0), Rig("px4").run(0.01), hovering(), hover()):
        for number in rig.autopilot.firmware.requestable:
            assert rig.command(512, number) == 0
        kinds = {each.message.get_type() for each in rig.heard if each.source == VEHICLE}
        assert len(kinds) > 12


@pytest.mark.parametrize(
    ("opcode", "data", "answer"),
    [
        (4, b"@PARAM/param.pck?withdefaults=1", (8, 3, 129, 1, 4, 10)),  # not found
        (2, b"", (8, 3, 128, 0, 2, 0)),  # sessions can be ended
        (129, b"", None),  # that is an answer
    ],
)
def test_there_are_no_files(opcode: int, data: bytes, answer: tuple[int, ...] | None) -> None:
    """Asked for in the layout of pymavlink's own client."""
    operation = mavftp_op.FTP_OP(7, 3, opcode, len(data), 0, 0, 11, bytearray(data))
    payload = list(bytes(operation.pack()).ljust(251, b"\0"))
    got = Rig().ask(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, payload))
    assert all((each.target_system, each.target_component) == COMPANION for each in got)
    found = [struct.unpack_from("<HBBBB6xB", bytes(each.payload)) for each in got]
    assert found == ([answer] if answer else [])
