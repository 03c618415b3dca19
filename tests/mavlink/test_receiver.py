import itertools
import tracemalloc
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.mavlink import frames as receiver_module
from companion.mavlink.dialect import codec, wire
from companion.mavlink.frames import Receiver, Skipped
from companion.mavlink.signing import Signing

KINDS = [wire.mavlink_map[number] for number in sorted(wire.mavlink_map)]
NO_MARKER = st.binary(max_size=40).map(
    lambda data: data.replace(b"\xfd", b"").replace(b"\xfe", b"")
)
FLUSH = bytes(300)
"""Longer than any frame: whatever looked like one is judged."""


def position(time_ms: int = 1) -> Any:
    return wire.MAVLink_global_position_int_message(time_ms, 1, 2, 3, 4, 5, 6, 7, 8)


def frame_of(
    kind: Any, payload: bytes, *, first_protocol: bool = False, sequence: int = 0
) -> bytes:
    """A frame with this payload, cut or filled up to what the kind takes."""
    size = kind.unpacker.size
    payload = payload[:size].ljust(size, b"\0")
    if first_protocol and kind.id < 256:
        head = bytes([0xFE, len(payload), sequence, 1, 1, kind.id])
    else:
        payload = payload.rstrip(b"\0") or b"\0"
        number = kind.id.to_bytes(3, "little")
        head = bytes([0xFD, len(payload), 0, 0, sequence, 1, 1]) + number
    return sealed(head + payload, kind.crc_extra)


def sealed(content: bytes, extra: int) -> bytes:
    checksum = wire._x25crc_slow(content[1:] + bytes([extra])).crc
    return content + checksum.to_bytes(2, "little")


def unknown(payload: bytes = b"\1\2\3") -> bytes:
    head = bytes([0xFD, len(payload), 0, 0, 0, 1, 1, 0xFF, 0xFF, 0xFF])
    return head + payload + b"\0\0"


def portions(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(edges)]


def feed_all(receiver: Receiver, parts: list[bytes]) -> list[bytes]:
    return [bytes(m.get_msgbuf()) for part in parts for m in receiver.feed(part)]


frames = st.builds(
    frame_of,
    st.sampled_from(KINDS).filter(lambda kind: kind.id not in receiver_module.SECRETS),
    st.binary(max_size=255),
    first_protocol=st.booleans(),
    sequence=st.integers(0, 255),
)
cuts = st.lists(st.integers(0, 10_000), max_size=12)


# --- whatever comes -------------------------------------------------------------------------------


@given(st.lists(st.binary(max_size=400), max_size=10))
def test_nothing_is_raised_whatever_the_bytes(parts: list[bytes]) -> None:
    for receiver in (Receiver(), Receiver(Signing(key=bytes(32), timestamp=0))):
        for part in parts:
            receiver.feed(part)
        assert len(receiver._rest) < 300


@given(st.lists(st.tuples(NO_MARKER, frames), max_size=8), cuts)
def test_every_frame_between_noise_comes_out_in_any_portions(
    parts: list[tuple[bytes, bytes]], where: list[int]
) -> None:
    receiver = Receiver()
    data = b"".join(noise + frame for noise, frame in parts)
    assert feed_all(receiver, portions(data, where)) == [frame for _, frame in parts]
    assert receiver.passed[Skipped.GARBAGE] == sum(len(noise) for noise, _ in parts)
    assert receiver._rest == b""


@given(st.lists(st.tuples(frames, st.integers(1, 400), st.integers(0, 2)), max_size=8), cuts)
def test_a_broken_frame_takes_no_other_with_it(
    parts: list[tuple[bytes, int, int]], where: list[int]
) -> None:
    """Cut short, or with one byte changed: all that are whole come out in the end."""
    data, whole = b"", []
    for frame, at, what in parts:
        if what == 0:
            data += frame[: 1 + at % (len(frame) - 1)]
        elif what == 1:
            k = len(frame) - 1 - at % 2
            data += frame[:k] + bytes([frame[k] ^ 0xA5]) + frame[k + 1 :]
        else:
            data += frame
            whole.append(frame)
    got = feed_all(Receiver(), [*portions(data, where), FLUSH])
    left = iter(got)
    assert all(frame in left for frame in whole)


def test_a_torn_datagram_holds_nothing_up() -> None:
    receiver, speaker = Receiver(), codec(1)
    good = [position(k).pack(speaker) for k in range(3)]
    torn = wire.MAVLink_param_value_message(b"NAME", 1.0, 9, 1, 0).pack(speaker)[:-9]
    assert receiver.feed(torn) == []
    for frame in good:
        assert [bytes(m.get_msgbuf()) for m in receiver.feed(frame)] == [frame]


def test_a_frame_with_incompatible_flags_is_passed_over() -> None:
    frame = bytearray(position().pack(codec(1)))
    frame[2] = 2
    receiver = Receiver()
    assert receiver.feed(bytes(frame) + FLUSH) == []
    good = position().pack(codec(1))
    assert len(receiver.feed(good)) == 1


def test_what_is_passed_over_is_counted_by_kind() -> None:
    receiver, speaker = Receiver(), codec(1)
    good = position().pack(speaker)
    broken = good[:-1] + bytes([good[-1] ^ 1])
    setup = wire.MAVLink_setup_signing_message(1, 1, list(range(32)), 1).pack(speaker)
    noise = b"no frame at all"
    got = receiver.feed(noise + unknown() + good + setup + unknown(b"") + broken + FLUSH)
    assert [m.get_type() for m in got] == ["GLOBAL_POSITION_INT"]
    assert receiver.passed[Skipped.UNKNOWN] == 2
    assert receiver.passed[Skipped.SECRET] == 1
    assert receiver.passed[Skipped.CHECKSUM] == 1
    assert receiver.passed[Skipped.GARBAGE] == len(noise) + len(broken) + len(FLUSH)


def test_what_an_unknown_message_carries_is_not_taken_for_a_frame() -> None:
    tunnelled = wire.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3).pack(codec(1))
    good = position().pack(codec(1))
    receiver = Receiver()
    got = receiver.feed(unknown(tunnelled) + good)
    assert [m.get_type() for m in got] == ["GLOBAL_POSITION_INT"]


def test_a_payload_that_is_longer_than_we_know_is_read_as_far_as_we_know() -> None:
    kind = wire.mavlink_map[wire.MAVLINK_MSG_ID_ATTITUDE]
    payload = bytes(range(1, kind.unpacker.size + 1)) + b"new field"
    head = bytes([0xFD, len(payload), 0, 0, 0, 1, 1, 30, 0, 0])
    [message] = Receiver().feed(sealed(head + payload, kind.crc_extra))
    assert message.time_boot_ms == 0x04030201


def test_checksums_count_even_where_pymavlink_is_told_to_ignore_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(wire, "MAVLINK_IGNORE_CRC", "1")
    frame = position().pack(codec(1))
    assert Receiver().feed(frame[:-1] + bytes([frame[-1] ^ 1]) + FLUSH) == []


def test_numbers_that_are_none_arrive_as_they_are() -> None:
    nan = wire.MAVLink_attitude_message(1, float("nan"), float("inf"), float("-inf"), 0, 0, 0)
    [message] = Receiver().feed(nan.pack(codec(1)))
    assert message.roll != message.roll
    assert (message.pitch, message.yaw) == (float("inf"), float("-inf"))


# --- memory ---------------------------------------------------------------------------------------


def test_nothing_piles_up_while_every_portion_ends_within_a_frame() -> None:
    # pymavlink's own parser keeps all that it ever read
    frame = position().pack(codec(1))
    stream = frame * 5_000
    receiver = Receiver()
    count = len(receiver.feed(stream[:10]))
    tracemalloc.start()
    for at in range(10, len(stream), len(frame)):
        count += len(receiver.feed(stream[at : at + len(frame)]))
        assert len(receiver._rest) < 300
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert count == 5_000
    assert peak < 50_000


# --- signatures -----------------------------------------------------------------------------------


def signer(timestamp: int = 100) -> wire.MAVLink:
    speaker = codec(1)
    speaker.signing.secret_key, speaker.signing.timestamp = bytes(32), timestamp
    speaker.signing.sign_outgoing = True
    return speaker


def test_signed_messages_come_without_their_signature() -> None:
    plain = position().pack(codec(1))
    for receiver in (Receiver(), Receiver(Signing(key=bytes(32), timestamp=0))):
        [message] = receiver.feed(position().pack(signer()))
        assert bytes(message.get_msgbuf()) == plain
        assert message.time_boot_ms == 1
        assert receiver.signed == 1


def test_with_a_key_only_what_is_signed_comes_out() -> None:
    receiver = Receiver(Signing(key=bytes(32), timestamp=0))
    speaker = signer()
    first, second = position(1).pack(speaker), position(2).pack(speaker)
    stranger = position(3).pack(codec(1))
    got = receiver.feed(first + stranger + first + second)
    assert [m.time_boot_ms for m in got] == [1, 2]
    assert all(m.get_signed() for m in got)


def test_with_a_key_no_secret_and_nothing_unknown_comes_out_either() -> None:
    # pymavlink 2.4.50 hands out what it does not know without a look at the signature
    receiver = Receiver(Signing(key=bytes(32), timestamp=0))
    setup = wire.MAVLink_setup_signing_message(1, 1, list(range(32)), 1).pack(signer())
    assert receiver.feed(setup + unknown()) == []
