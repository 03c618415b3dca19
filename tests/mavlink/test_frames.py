"""Where frames lie in bytes: checked against pymavlink's own packing and the Receiver."""

import random

import pytest
from recordings import recording

from companion.mavlink.dialect import wire
from companion.mavlink.frames import (
    LONGEST,
    Receiver,
    find_marker,
    frame_extent,
    intact_end,
    number_of,
    payload_of,
    sender_of,
)


def _packed(message: wire.MAVLink_message, *, first: bool = False) -> bytes:
    codec = wire.MAVLink(None, srcSystem=7, srcComponent=9)
    return bytes(message.pack(codec, force_mavlink1=first))


@pytest.mark.parametrize("first", [False, True])
def test_what_pymavlink_packs_is_intact_and_no_longer_with_any_bit_turned(first: bool) -> None:
    frame = _packed(wire.MAVLink_attitude_message(5000, 0.1, 0.2, 0.3, 0, 0, 0), first=first)
    assert intact_end(b"xy" + frame + b"z", 2) == 2 + len(frame)
    assert (number_of(frame), sender_of(frame)) == (wire.MAVLINK_MSG_ID_ATTITUDE, (7, 9))
    assert payload_of(frame, 28)[:4] == (5000).to_bytes(4, "little")
    for bit in range(len(frame) * 8):
        other = bytearray(frame)
        other[bit // 8] ^= 1 << bit % 8
        assert not intact_end(bytes(other), 0), bit


def test_a_frame_that_is_not_all_there_is_not_intact() -> None:
    frame = _packed(wire.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3))
    for size in range(len(frame)):
        assert intact_end(frame[:size], 0) == 0


def test_the_longest_frame_is_a_signed_one_with_all_of_its_payload() -> None:
    codec = wire.MAVLink(None, srcSystem=7, srcComponent=9)
    codec.signing.sign_outgoing, codec.signing.secret_key = True, bytes(32)
    content = [255] * 251
    frame = bytes(wire.MAVLink_file_transfer_protocol_message(0, 1, 1, content).pack(codec))
    assert len(frame) == LONGEST - 1  # no message of 255 bytes can be packed in this dialect
    assert intact_end(frame, 0) == len(frame)
    assert frame_extent(frame, 0)[0] == len(frame)


def test_the_frames_found_in_noise_are_those_that_the_receiver_finds() -> None:
    """Two searches, one that decodes and one that does not."""
    content = recording("px4-offboard-8mps.tlog").read_bytes()[:60_000]
    chance = random.Random(3)
    noisy = bytearray(content)
    for _ in range(200):
        noisy[chance.randrange(len(noisy))] = chance.randrange(256)
    data = bytes(noisy)
    found, at = [], 0
    while (marker := find_marker(data, at)) is not None:
        end = frame_extent(data, marker.start())[0]
        if 0 < end <= len(data) and intact_end(data, marker.start()):
            found.append(data[marker.start() : end])
            at = end
        else:
            at = marker.start() + 1
    received = [bytes(message.get_msgbuf()) for message in Receiver().feed(data)]
    # The receiver believes the length of a message of an unknown kind: it may pass over some.
    assert len(found) > 700
    assert set(received) <= set(found)
    assert len(set(found) - set(received)) <= 3
