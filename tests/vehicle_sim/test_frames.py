"""Bytes, messages and parameters, both ways, against pymavlink's own parser and packer.

pymavlink's own client sets parameters in tests/interop.
"""

import itertools
import math
import random
import struct
from typing import Any

import pytest
from harness import VEHICLE, Rig, command_long, heartbeat, hover, hovering
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink
from wires import Speaker

from vehicle_sim.autopilot.values import Text
from vehicle_sim.flight_controller import texts
from vehicle_sim.parameters import Firmware
from vehicle_sim.wire.frames import StreamParser, framed

ARM, BEAT = command_long(400, 1, 0, 0, 0, 0, 0, 7.5), heartbeat()
TEXT = mavlink.MAVLink_statustext_message(4, b"a text that is long enough for all of its 50 bytes")
BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])


def packed(message: Any, *, old: bool = False) -> bytes:
    return Speaker(srcSystem=7, srcComponent=195).frame(message, force_mavlink1=old)


# --- frames ---------------------------------------------------------------------------------------


def filled(kind: Any, rng: random.Random) -> bytes:
    """An intact frame of any message, with random fields."""
    payload = rng.randbytes(rng.randint(0, kind.unpacker.size)).ljust(kind.unpacker.size, b"\0")
    frame = bytes([253, len(payload), 0, 0, 9, 7, 195, *kind.id.to_bytes(3, "little")]) + payload
    crc: int = mavlink.x25crc(frame[1:] + bytes([kind.crc_extra])).crc
    return frame + struct.pack("<H", crc)


def test_every_message_of_the_dialect_is_read_and_packed_as_pymavlink_does_it() -> None:
    rng, mav = random.Random(1), mavlink.MAVLink(None, srcSystem=3, srcComponent=4)
    for kind in mavlink.mavlink_map.values():
        frame = filled(kind, rng)
        ((raw, got),) = StreamParser(datagrams=True).feed(frame)
        wanted = mavlink.MAVLink(None).decode(bytearray(frame))
        assert raw == frame
        assert repr(got.to_dict()) == repr(wanted.to_dict()), kind
        assert got.get_header().pack() == wanted.get_header().pack()
        if kind is not mavlink.MAVLink_test_types_message:  # a lone zero is more than it can pack
            assert framed(got, mav.seq, 3, 4) == wanted.pack(mav), kind
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
    for number in range(100_000, 100_100):
        head = bytes([253, 9, 0, 0, 0, 1, 1, *number.to_bytes(3, "little")])
        assert len(parser.feed(head + b"\xfd\xff\x00" * 3 + b"\0\0" + packed(BEAT))) == 1


# --- messages -------------------------------------------------------------------------------------


@pytest.mark.parametrize("length", [50, 51, 100, 149])
def test_a_text_that_does_not_fit_goes_on_in_chunks_to_a_zero_byte(length: int) -> None:
    said = "å" + "".join(chr(ord("a") + k % 26) for k in range(length - 1))
    frames = b"".join(framed(each, 0, 1, 1) for each in texts(Text(severity=2, text=said), 7))
    chunks = mavlink.MAVLink(None).parse_buffer(frames)
    assert "".join(chunk.text for chunk in chunks) == said.replace("å", "?")
    assert [chunk.chunk_seq for chunk in chunks] == list(range(len(chunks)))
    assert {chunk.id for chunk in chunks} == {7 if length > 50 else 0}
    assert [len(chunk.text) for chunk in chunks[:-1]] == [50] * (len(chunks) - 1)
    assert len(chunks[-1].text) < 50 or length == 50  # a zero byte ends it


def test_every_message_can_be_packed_and_read_again() -> None:
    """Also before there is anything to say."""
    for rig in (Rig().run(5.0), Rig("px4").run(0.01), hovering(), hover()):
        for number in rig.autopilot.firmware.requestable:
            assert rig.command(512, number) == 0
        kinds = {each.message.get_type() for each in rig.heard if each.source == VEHICLE}
        assert len(kinds) > 12


# --- parameters -----------------------------------------------------------------------------------

FLOAT = {"ardupilot": "GUID_TIMEOUT", "px4": "COM_DISARM_LAND"}
LIST = mavlink.MAVLink_param_request_list_message(*VEHICLE)
REAL, INT8, INT32 = 9, 2, 6


def values(vehicle: Rig, message: Any) -> list[Any]:
    """The PARAM_VALUE that answer this on link 0."""
    return [each for each in vehicle.ask(message) if each.get_type() == "PARAM_VALUE"]


def read(vehicle: Rig, name: str = "", index: int = -1) -> list[Any]:
    asked = mavlink.MAVLink_param_request_read_message(*VEHICLE, name.encode(), index)
    return values(vehicle, asked)


def put(vehicle: Rig, name: str, value: float, kind: int = REAL) -> list[Any]:
    return values(vehicle, mavlink.MAVLink_param_set_message(*VEHICLE, name.encode(), value, kind))


def as_float(whole: int) -> Any:
    return struct.unpack("<f", struct.pack("<i", whole))[0]


@BOTH
def test_values_are_listed_in_order_read_set_and_told_to_every_link(firmware: Firmware) -> None:
    vehicle, name = Rig(firmware, links=2), FLOAT[firmware]
    table = vehicle.simulation.parameters
    listed = [(m.param_id, m.param_index, m.param_count) for m in values(vehicle, LIST)]
    assert listed == [(each, k, len(table)) for k, each in enumerate(table)]
    assert vehicle.all("PARAM_VALUE", link=1) == []  # it has not asked
    place = list(table).index(name)
    for (message,) in (read(vehicle, index=place), read(vehicle, name)):
        told = (message.param_id, message.param_index, message.param_value)
        assert told == (name, place, table[name])
    assert read(vehicle, "NO_SUCH_NAME") == read(vehicle, index=len(table)) == []
    assert put(vehicle, "NO_SUCH_NAME", 1.0) == []
    begun_s = vehicle.now_s
    for asked in (1.5, math.nan):  # neither firmware keeps that
        (kept,) = put(vehicle, name, asked)
        assert kept.param_value == table[name] == 1.5
    there = [h.message.param_value for h in vehicle.all("PARAM_VALUE", link=1, since_s=begun_s)]
    assert set(there) == {1.5}


def test_ardupilot_converts_to_the_type_whatever_type_is_named() -> None:
    vehicle = Rig("ardupilot", links=2)
    for name, asked, kept in (
        *(("ANGLE_MAX", 4500.6, 4501), ("ANGLE_MAX", 1e9, 32767), ("DISARM_DELAY", -1e9, -128)),
        *(("RTL_LOIT_TIME", 1e30, 2**31 - 1), ("GUID_TIMEOUT", 1e30, 1e30)),
    ):
        for kind in (REAL, INT8, INT32):
            (told,) = put(vehicle, name, asked, kind)
            assert told.param_value == pytest.approx(kept, rel=1e-6), name


@given(value=st.integers(-(2**31), 2**31 - 1).filter(lambda v: v & 0x7FC00000 != 0x7F800000))
@settings(max_examples=20)
def test_px4s_integers_travel_as_their_bits_and_no_other_type_is_taken(value: int) -> None:
    vehicle, name = Rig("px4", links=2), "COM_OBL_RC_ACT"
    (told,) = put(vehicle, name, as_float(value), INT32)
    assert struct.unpack("<i", bytes(told.get_msgbuf())[10:14]) == (value,)
    assert vehicle.simulation.parameters[name] == value
    assert told.param_type == INT32
    assert put(vehicle, name, 3.0, REAL) == put(vehicle, FLOAT["px4"], as_float(3), INT32) == []


@BOTH
def test_the_parameters_of_ids_count_from_the_next_boot_on(firmware: Firmware) -> None:
    ids = {"MAV_SYSID": 9} if firmware == "ardupilot" else {"MAV_SYS_ID": 9, "MAV_COMP_ID": 50}
    vehicle, after = Rig(firmware, links=2), (9, ids.get("MAV_COMP_ID", 1))
    for name, value in ids.items():
        vehicle.simulation.set_parameter(name, value)
    assert {each.source for each in vehicle.run(3.0).heard} == {VEHICLE}
    vehicle.fault("reboot")
    vehicle.run(1.2).heard.clear()
    assert {each.source for each in vehicle.run(3.0).heard} == {after}
    for target, obeys in ((after, True), (VEHICLE, False)):
        answers = vehicle.ask(command_long(400, 1, target=target))
        assert any(each.get_type() == "COMMAND_ACK" for each in answers) is obeys
