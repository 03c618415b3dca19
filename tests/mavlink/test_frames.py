"""Frames found in noise, checked and decoded: against pymavlink's packing and decoding."""

import itertools
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from wires import Speaker

from companion.mavlink.dialect import codec, wire
from companion.mavlink.frames import Receiver, decoded, intact_end, sender_of
from companion.mavlink.signing import SECRETS, Signing
from companion.printable import printable

KINDS = [wire.mavlink_map[number] for number in sorted(wire.mavlink_map)]
NO_MARKER = st.binary(max_size=40).map(
    lambda data: data.replace(b"\xfd", b"").replace(b"\xfe", b"")
)
FLUSH = bytes(300)
"""Longer than any frame: whatever looked like one is judged."""
ATTITUDE = wire.mavlink_map[wire.MAVLINK_MSG_ID_ATTITUDE]


def position(time_ms: int = 1) -> Any:
    return wire.MAVLink_global_position_int_message(time_ms, 1, 2, 3, 4, 5, 6, 7, 8)


def frame_of(
    kind: Any, payload: bytes, *, first_protocol: bool = False, sequence: int = 0
) -> bytes:
    """A frame with this payload, cut or filled up to what the kind takes."""
    size = kind.unpacker.size
    payload = payload[:size].ljust(size, b"\0")
    if first_protocol and kind.id < 256:
        return sealed(bytes([0xFE, len(payload), sequence, 1, 1, kind.id]) + payload, kind)
    payload = payload.rstrip(b"\0") or b"\0"
    number = kind.id.to_bytes(3, "little")
    return sealed(bytes([0xFD, len(payload), 0, 0, sequence, 1, 1]) + number + payload, kind)


def sealed(content: bytes, kind: Any) -> bytes:
    checksum = wire._x25crc_slow(content[1:] + bytes([kind.crc_extra])).crc
    return content + checksum.to_bytes(2, "little")


def unknown(payload: bytes) -> bytes:
    head = bytes([0xFD, len(payload), 0, 0, 0, 1, 1, 0xFF, 0xFF, 0xFF])
    return head + payload + b"\0\0"


def fed(receiver: Receiver, data: bytes, cuts: list[int]) -> list[bytes]:
    """The frames that are found, if the bytes come in these portions."""
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    parts = (data[a:b] for a, b in itertools.pairwise(edges))
    return [bytes(m.get_msgbuf()) for part in parts for m in receiver.feed(part)]


frames = st.builds(
    frame_of,
    st.sampled_from(KINDS).filter(lambda kind: kind.id not in SECRETS),
    st.binary(max_size=255),
    first_protocol=st.booleans(),
    sequence=st.integers(0, 255),
)
cuts = st.lists(st.integers(0, 10_000), max_size=12)


@given(st.lists(st.binary(max_size=400), max_size=10))
def test_no_bytes_raise_and_less_than_a_frame_is_kept(parts: list[bytes]) -> None:
    for receiver in (Receiver(), Receiver(Signing(key=bytes(32), timestamp=0))):
        for part in parts:
            receiver.feed(part)
        assert len(receiver._rest) < 300


@given(
    st.lists(st.tuples(NO_MARKER, frames, st.integers(1, 400), st.integers(-3, 1)), max_size=8),
    cuts,
)
def test_frames_are_found_in_any_noise_and_a_broken_one_takes_no_other(
    parts: list[tuple[bytes, bytes, int, int]], where: list[int]
) -> None:
    """One that is cut short, or has a wrong checksum: all that are whole come out in the end."""
    data, whole, noisy = b"", [frame for _, frame, _, broken in parts if broken < 0], 0
    for noise, frame, at, broken in parts:
        bent = frame[:-1] + bytes([frame[-1] ^ 0xA5])
        data += noise + (frame[: 1 + at % (len(frame) - 1)], bent, frame)[max(broken, -1)]
        noisy += len(noise)
    receiver = Receiver()
    found = fed(receiver, data, where)
    if len(whole) == len(parts):
        assert (found, receiver.passed, receiver._rest) == (whole, noisy, b"")
    left = iter([*found, *fed(receiver, FLUSH, [])])
    assert all(frame in left for frame in whole)


def test_what_is_passed_over_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A message of a newer dialect is not, if it is longer than we know; a new one is, whole."""
    monkeypatch.setattr(wire, "MAVLINK_IGNORE_CRC", "1")  # checksums count all the same
    receiver, good = Receiver(), position().pack(codec(1))
    broken = good[:-1] + bytes([good[-1] ^ 1])
    flagged = good[:2] + b"\2" + good[3:]  # incompatible
    setup = wire.MAVLink_setup_signing_message(1, 1, list(range(32)), 1).pack(codec(1))
    payload = bytes(range(1, ATTITUDE.unpacker.size + 1)) + b"new field"
    longer = sealed(bytes([0xFD, len(payload), 0, 0, 0, 1, 1, 30, 0, 0]) + payload, ATTITUDE)
    noise, tunnelled = b"no frame at all", unknown(good)
    data = noise + tunnelled + longer + setup + unknown(b"") + flagged + broken + FLUSH
    [attitude] = receiver.feed(data)
    assert (attitude.get_type(), attitude.time_boot_ms) == ("ATTITUDE", 0x04030201)
    frames = 2 + 1 + 1  # of unknown kinds, with a secret, with a wrong checksum
    assert receiver.passed == frames + len(noise + flagged + broken + FLUSH)


def test_what_a_protocol_does_not_allow_is_no_frame_though_its_checksum_is_right() -> None:
    """Fields beyond those of the kind in the first one, and flags that we do not understand."""
    size = ATTITUDE.unpacker.size
    longer = bytes([0xFE, size + 1, 0, 1, 1, 30]) + bytes(size + 1)
    flagged = bytes([0xFD, size, 2, 0, 0, 1, 1, 30, 0, 0]) + bytes(size)
    for content in (longer, flagged):
        frame = sealed(content, ATTITUDE)
        assert intact_end(frame, 0) == 0
        assert Receiver().feed(frame + FLUSH) == []


@given(frames)
def test_a_packed_frame_is_intact_and_no_longer_when_cut_or_bent(frame: bytes) -> None:
    assert intact_end(b"xy" + frame + b"z", 2) == 2 + len(frame)
    assert sender_of(frame) == (1, 1)
    for at in range(len(frame)):
        assert intact_end(frame[:at], 0) == 0
        assert not intact_end(frame[:at] + bytes([frame[at] ^ 0x21]) + frame[at + 1 :], 0)


def told(message: Any) -> dict[str, Any]:
    """All that there is to know of a message, numbers that are none included; texts made fit."""
    values = {
        name: repr(printable(value) if isinstance(value, str) else value)
        for name, value in vars(message).items()
        if name != "_header"
    }
    return {**values, "header": vars(message.get_header())}


@pytest.mark.parametrize("first_protocol", [False, True])
def test_every_kind_is_decoded_as_by_pymavlink(first_protocol: bool) -> None:
    rng, theirs = random.Random(1), wire.MAVLink(None)
    for kind in KINDS:
        for _ in range(0 if first_protocol and kind.id > 255 else 20):
            payload = rng.randbytes(rng.randint(0, kind.unpacker.size))
            how = {"first_protocol": first_protocol, "sequence": rng.randrange(256)}
            frame = frame_of(kind, payload, **how)
            message = decoded(frame, kind)
            assert told(message) == told(theirs.decode(bytearray(frame)))
            texts = (getattr(message, name) for name in message.get_fieldnames())
            assert all(text.isprintable() for text in texts if isinstance(text, str))


def test_signed_messages_come_without_their_signature_and_with_a_key_only_they() -> None:
    speaker, stranger = Speaker(bytes(32), 100), Speaker().frame(position(3))
    first, second = speaker.frame(position(1)), speaker.frame(position(2))
    trusting, receiver = Receiver(), Receiver(Signing(key=bytes(32), timestamp=0))
    for each, stamps in ((trusting, [1, 3, 1, 2]), (receiver, [1, 2])):
        got = each.feed(first + stranger + first + second)
        assert [m.time_boot_ms for m in got] == stamps
        assert bytes(got[0].get_msgbuf()) == Speaker().frame(position())
        assert [m.get_signed() for m in got[:1]] == [each is receiver]
        assert each.signed == 3
    setup = speaker.frame(wire.MAVLink_setup_signing_message(1, 1, list(range(32)), 1))
    # pymavlink 2.4.50 hands out what it does not know without a look at the signature
    assert receiver.feed(setup + unknown(b"\1\2\3")) == []
