"""Signatures of what is sent and heard, with pymavlink as the other side."""

import hashlib
import itertools
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from wires import Speaker

from companion.mavlink.dialect import codec, wire
from companion.mavlink.link import FrameEncoder
from companion.mavlink.signing import SECRETS, Signing, key_of, strip_signature, timestamp_of

KEY, WRONG_KEY = bytes(range(32)), bytes(32 * [9])
NOW = timestamp_of(1_790_000_000.0)
MINUTE = 60 * 100_000
"""In ticks of 10 microseconds."""
BEAT = wire.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3)


def ours(timestamp: int = NOW) -> Signing:
    return Signing(key=KEY, timestamp=timestamp)


def stamp_of(frame: bytes) -> int:
    return int.from_bytes(frame[-12:-6], "little")


def test_a_key_is_a_phrase_as_in_ground_stations_or_32_bytes_and_is_never_shown() -> None:
    for phrase in ("correct horse", "Ström", "00fg" * 16):
        assert key_of(phrase) == hashlib.sha256(phrase.encode()).digest()
    assert key_of("00fF" * 16) == bytes.fromhex("00ff" * 16)
    with pytest.raises(ValueError, match="32 bytes") as caught:
        Signing(key=b"hushhush", timestamp=0)
    assert "hush" not in str(caught.value)
    shown = repr(ours()), str(vars(codec(1)))
    assert not any(form in each for each in shown for form in (KEY.hex(), repr(KEY)))
    words = ("secret", "password", "passkey", "key")
    kinds = wire.mavlink_map.items()
    secret = {n for n, kind in kinds if any(field.startswith(words) for field in kind.fieldnames)}
    assert secret == set(SECRETS)


@given(st.lists(st.floats(-1e6, 1e6) | st.just(math.nan) | st.just("frame"), max_size=30))
def test_our_time_stamps_rise_whatever_the_clock_does(happenings: list[float | str]) -> None:
    signing = ours()
    for at_s in (1000.0, 1060.0):
        signing.on_time(at_s)
    assert signing.timestamp == NOW + MINUTE
    stamps = [signing.timestamp - 1]
    for each in happenings:
        if isinstance(each, str):
            stamps.append(stamp_of(signing.sign(BEAT.pack(codec(1)))))
        else:
            signing.on_time(each)
    assert all(a < b for a, b in itertools.pairwise([*stamps, signing.timestamp]))
    clocks = {1_420_070_400.0: 0, 1_420_070_401.5: 150_000, 0.0: 0, 1e300: 2**48 - 1}
    assert {unix_s: timestamp_of(unix_s) for unix_s in clocks} == clocks
    assert timestamp_of(math.nan) == 0


def test_a_frame_that_was_kept_is_signed_as_pymavlink_would_sign_it_now() -> None:
    keeper = ours()
    for message in (BEAT, wire.MAVLink_statustext_message(4, b"hello")):
        plain = message.pack(codec(1))
        for _ in range(3):
            signed = keeper.sign(plain)
            assert signed == Speaker(KEY, stamp_of(signed), srcComponent=195).frame(message)
            assert keeper.sign(signed) == signed
            assert strip_signature(signed) == strip_signature(plain) == plain  # as a log keeps it
    first_protocol = BEAT.pack(codec(1), force_mavlink1=True)
    assert keeper.sign(first_protocol) == first_protocol  # it has no signatures


def test_what_is_kept_in_reserve_is_believed_whenever_and_however_often_it_is_sent() -> None:
    """The stream goes on meanwhile, and each copy would be a replay of the one before."""
    encoder, vehicle = FrameEncoder(1, ours()), ours()
    reserve = encoder.encode_unsent([BEAT])
    encoder.send([BEAT] * 3, 5.0)
    sent = [*encoder.out.frames, *encoder.signed(reserve), *encoder.signed(reserve)]
    assert all(map(vehicle.accepts, sent))
    assert encoder.out.record == [(5.0, strip_signature(frame)) for frame in encoder.out.frames]
    assert FrameEncoder(1, None).signed(reserve) == reserve


RADIO = wire.MAVLink_radio_status_message(100, 100, 50, 10, 10, 0, 0)
OFFSETS = (-MINUTE - 1, -MINUTE, -MINUTE + 1, -5, 0, 1, 5, MINUTE, 60 * MINUTE)
heard = st.tuples(
    st.sampled_from(OFFSETS),
    st.sampled_from([{}, {"srcComponent": 197}, {"srcSystem": 2}, {"link": 7}]),
    st.sampled_from(["signed", "signed", "wrong key", "bent", "unsigned", "version 1"]),
    st.booleans(),
    st.integers(2, 10_000),
)


@given(st.lists(heard, max_size=40))
def test_a_frame_is_believed_if_it_is_signed_and_newer_than_all_of_its_stream(frames: Any) -> None:
    """A new stream may be a minute behind; what is refused changes nothing; radios cannot sign.

    A clock ahead of ours is followed (ardupilot.md 5); pymavlink 2.4.50 moves a stream's time
    before it looks at the signature.
    """
    signing, newest, latest, refused = ours(), dict[str, int](), NOW, 0
    for offset, ids, how, is_radio, place in frames:
        stamp, key = NOW + offset, {"signed": KEY, "bent": KEY, "wrong key": WRONG_KEY}.get(how)
        frame = Speaker(key, stamp, **ids).frame(
            RADIO if is_radio else BEAT, force_mavlink1=how == "version 1"
        )
        if how == "bent":
            at = 2 + place % (len(frame) - 2)
            frame = frame[:at] + bytes([frame[at] ^ 0x80]) + frame[at + 1 :]
        is_news = stamp > newest[str(ids)] if str(ids) in newest else stamp >= latest - MINUTE
        if is_believed := is_news if how == "signed" else is_radio and key is None:
            newest |= {str(ids): stamp} if how == "signed" else {}
            latest = max(latest, stamp) if how == "signed" else latest
        refused += not is_believed
        assert signing.accepts(frame) is is_believed
        assert (signing.timestamp, signing.refused) == (latest, refused)


def test_memory_is_bounded_to_256_streams() -> None:
    signing = ours()
    for k in range(300):
        signing.accepts(Speaker(KEY, NOW, link=k % 256, srcSystem=3 + k // 256).frame(BEAT))
    assert signing.refused == 300 - 256


def test_refusals_are_told_once_a_minute_and_only_if_there_are_new_ones() -> None:
    signing = ours()
    steps = ((0, 0.0), (1, 1.0), (5, 60.0), (0, 61.0), (0, 600.0), (1, 5.0))  # it has rebooted
    told = []
    for frames, at_s in steps:
        signing.refused += frames
        told.append(signing.complaint(at_s))
    said = [None if each is None else each.split()[1] for each in told]
    assert said == [None, "1", None, "5", None, "1"]
    signing.refused += 9_999_999
    assert len(signing.complaint(900.0) or "") <= 50
