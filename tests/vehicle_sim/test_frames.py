"""Bytes and messages, against pymavlink's own parser and packer."""

import itertools
import math
import random
import struct
from typing import Any

import pytest
from conformance.flights import records
from hypothesis import example, given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink
from recordings import recording

from vehicle_sim.links import datagrams
from vehicle_sim.wire import frames
from vehicle_sim.wire.frames import Packer, StreamParser
from vehicle_sim.wire.telemetry import whole

ARM = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 7.5)
BEAT = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
TEXT = mavlink.MAVLink_statustext_message(4, b"a text that is long enough for all of its 50 bytes")
LARGEST = 3.4028234663852886e38
KINDS = sorted(mavlink.mavlink_map.values(), key=lambda kind: kind.id)


def packed(message: Any, *, old: bool = False) -> bytes:
    mav = mavlink.MAVLink(None, srcSystem=7, srcComponent=195)
    return bytes(message.pack(mav, force_mavlink1=old))


def decoded(frame: bytes) -> Any:
    return mavlink.MAVLink(None).decode(bytearray(frame))


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
    rng, packer = random.Random(1), Packer(3, 4)
    mav = mavlink.MAVLink(None, srcSystem=3, srcComponent=4)
    for kind in KINDS:
        frame = filled(kind, rng)
        ((raw, got),) = StreamParser(datagrams=True).feed(frame)
        assert raw == frame
        assert same(got, decoded(frame)), kind
        if kind is not mavlink.MAVLink_test_types_message:  # a lone zero is more than it can pack
            assert packer.frame(got) == decoded(frame).pack(mav), kind
            mav.seq = (mav.seq + 1) % 256


def test_a_recorded_flight_is_read_as_pymavlink_reads_it() -> None:
    data = recording("px4-offboard-short.tlog").read_bytes()[:400_000]
    parser, reader, known = StreamParser(datagrams=False), mavlink.MAVLink(None), 0
    for _, frame in records(data):
        wanted, got = reader.decode(bytearray(frame)), parser.feed(frame)
        is_known = not isinstance(wanted, mavlink.MAVLink_unknown)
        assert len(got) == is_known
        assert all(same(message, wanted) for _, message in got)
        known += is_known
    assert known > 1000


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


@given(stream=st.binary(max_size=600), step=st.integers(1, 40))
@example(stream=b"\xfd" * 600, step=7)
@example(stream=b"\xfe\x09" * 300, step=1)
@example(stream=b"\xfd\xff\x00" * 200, step=1)
def test_anything_at_all_may_come_and_good_frames_still_arrive(stream: bytes, step: int) -> None:
    parser = StreamParser(datagrams=False)
    for at in range(0, len(stream), step):
        parser.feed(stream[at : at + step])
        assert len(parser._rest) < 300
    seen = [got for _ in range(40) for _, got in parser.feed(packed(ARM))]
    assert len(seen) >= 30  # what a false beginning can swallow is less than ten of them
    assert seen[-1].command == 400


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


@pytest.mark.parametrize(
    "datagram", [b"abc", flagged(0, 1), flagged(0)[:-1], flagged(2), flagged(3) + bytes(13)]
)
def test_what_is_no_frame_of_mavlink_is_passed_over(datagram: bytes) -> None:
    assert StreamParser(datagrams=True).feed(datagram) == []
    assert len(StreamParser(datagrams=True).feed(flagged(0))) == 1


def test_an_unknown_message_costs_only_itself() -> None:
    parser = StreamParser(datagrams=False)
    for number in range(100_000, 101_000):
        head = bytes([253, 9, 0, 0, 0, 1, 1, *number.to_bytes(3, "little")])
        assert len(parser.feed(head + b"\xfd\xff\x00" * 3 + b"\0\0" + packed(BEAT))) == 1


def test_the_work_is_linear_in_the_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    summed, checksum = list[int](), frames.mcrf4xx

    def counted(data: bytes) -> int:
        summed.append(len(data))
        return int(checksum(data))

    monkeypatch.setattr(frames, "mcrf4xx", counted)
    longest = 280  # of a frame: the most that one marker can have summed up
    command = b"\xfd\xff\0\0\0\x01\x01\x4c\0\0"
    for worst in (b"\xfe\xff\x00\x01\x01\x4c", command, b"x\xfd" * 3, b"\xfd" * 6):
        summed.clear()
        assert StreamParser(datagrams=False).feed(worst * 4_000) == []
        assert sum(summed) <= longest * len(worst) * 4_000, worst
        assert sum(summed) > len(worst) * 4_000 or b"\x4c" not in worst


def test_sequence_numbers_go_round() -> None:
    packer = Packer(1, 100)
    assert [packer.frame(BEAT)[4] for _ in range(257)] == [*range(256), 0]


def test_a_value_that_does_not_fit_is_sent_as_the_nearest_that_does() -> None:
    wild = mavlink.MAVLink_home_position_message(
        2**40, -(2**40), 10**12, 1e300, -1e300, math.nan, [1e300, 1, 2, 3], 0, 0, math.inf
    )
    got = decoded(Packer(1, 1).frame(wild))
    assert (got.latitude, got.longitude, got.altitude) == (2**31 - 1, -(2**31), 2**31 - 1)
    assert (got.x, got.y) == pytest.approx((LARGEST, -LARGEST))
    assert math.isnan(got.z)
    assert got.q == pytest.approx([LARGEST, 1, 2, 3])
    assert got.approach_z == math.inf
    numbers = mavlink.MAVLink_distance_sensor_message(1.5, -3, 70_000, 0, 300, -1, math.nan, 0)
    got = decoded(Packer(1, 1).frame(numbers))
    assert (got.time_boot_ms, got.min_distance, got.max_distance) == (1, 0, 65535)
    assert (got.current_distance, got.type, got.id, got.orientation) == (0, 255, 0, 0)


@given(value=st.floats())
def test_what_goes_into_a_field_of_whole_numbers_is_the_nearest(value: float) -> None:
    told = decoded(Packer(1, 1).frame(frames.make("GPS_GLOBAL_ORIGIN", whole(value)))).latitude
    assert told == (0 if math.isnan(value) else round(min(max(value, -(2**31)), 2**31 - 1)))


@given(sizes=st.lists(st.integers(12, 300), max_size=80))
def test_datagrams_keep_order_and_size(sizes: list[int]) -> None:
    wanted = [bytes([k % 256]) * size for k, size in enumerate(sizes)]
    got = datagrams(wanted)
    assert b"".join(got) == b"".join(wanted)
    assert all(0 < len(datagram) <= 1400 for datagram in got)
    assert all(len(a) + len(b) > 1100 for a, b in itertools.pairwise(got))
