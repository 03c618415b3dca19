import hashlib
import itertools
import math
from typing import Any

import pytest
from fastcrc.crc16 import mcrf4xx
from hypothesis import given
from hypothesis import strategies as st

from companion.mavlink.dialect import codec, wire
from companion.mavlink.signing import (
    SECRETS,
    TICKS_PER_S,
    Signing,
    key_of,
    strip_signature,
    timestamp_of,
)

KEY, WRONG_KEY = bytes(range(32)), bytes(32 * [9])
NOW = timestamp_of(1_790_000_000.0)
MINUTE = 60 * TICKS_PER_S


def ours(timestamp: int = NOW) -> Signing:
    return Signing(key=KEY, timestamp=timestamp, link_id=3)


class Speaker:
    """pymavlink as the other side, with its own signing."""

    def __init__(
        self,
        timestamp: int = NOW,
        *,
        key: bytes | None = KEY,
        link: int = 0,
        component: int = 1,
        system: int = 1,
    ) -> None:
        self.mav = wire.MAVLink(None, srcSystem=system, srcComponent=component)
        if key is not None:
            self.mav.signing.secret_key = key
            self.mav.signing.link_id = link
            self.mav.signing.timestamp = timestamp
            self.mav.signing.sign_outgoing = True

    def frame(self, message: Any = None, **how: Any) -> bytes:
        frame: bytes = (message or heartbeat()).pack(self.mav, **how)
        return frame


def heartbeat() -> Any:
    return wire.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3)


# --- keys and clocks ------------------------------------------------------------------------------


def test_a_phrase_becomes_a_key_as_in_ground_stations() -> None:
    assert key_of("correct horse") == hashlib.sha256(b"correct horse").digest()
    assert key_of("Ström") == hashlib.sha256("Ström".encode()).digest()
    assert key_of("00fF" * 16) == bytes.fromhex("00ff" * 16)
    assert key_of("00fg" * 16) == hashlib.sha256(b"00fg" * 16).digest()


def test_a_key_of_another_length_is_refused_without_being_shown() -> None:
    with pytest.raises(ValueError, match="32 bytes") as caught:
        Signing(key=b"hushhush", timestamp=0)
    assert "hush" not in str(caught.value)


def test_a_time_stamp_counts_ten_microseconds_since_2015() -> None:
    assert timestamp_of(1_420_070_400.0) == 0
    assert timestamp_of(1_420_070_401.5) == 150_000
    assert timestamp_of(0.0) == timestamp_of(float("nan")) == 0
    assert timestamp_of(1e300) == 2**48 - 1


# --- what we send ---------------------------------------------------------------------------------


def test_a_receiver_with_the_key_believes_what_we_send() -> None:
    signing = ours()
    other = wire.MAVLink(None)
    other.signing.secret_key, other.signing.timestamp = KEY, NOW
    for _ in range(10):
        message = other.decode(bytearray(signing.sign(heartbeat().pack(codec(1)))))
        assert message.get_signed()
        assert message.get_link_id() == 3
    assert (other.signing.goodsig_count, other.signing.badsig_count) == (10, 0)


@given(st.lists(st.floats(-1e6, 1e6) | st.just(math.nan) | st.just("frame"), max_size=30))
def test_our_time_stamps_rise_whatever_the_clock_does(happenings: list[float | str]) -> None:
    signing = ours()
    stamps = [NOW - 1]
    for each in happenings:
        if isinstance(each, str):
            frame = signing.sign(heartbeat().pack(codec(1)))
            stamps.append(int.from_bytes(frame[-12:-6], "little"))
        else:
            signing.on_time(each)
    assert all(a < b for a, b in itertools.pairwise(stamps))
    assert signing.timestamp > stamps[-1]


def test_our_time_stamps_follow_the_clock() -> None:
    signing = ours()
    signing.on_time(1000.0)
    signing.on_time(1060.0)
    assert signing.timestamp == NOW + MINUTE


# --- what we hear ---------------------------------------------------------------------------------


def test_signed_frames_of_any_component_are_believed() -> None:
    signing = ours()
    vehicle, radar = Speaker(), Speaker(component=197)
    station = Speaker(system=255, component=190, link=7)
    for speaker in (vehicle, radar, station) * 3:
        assert signing.accepts(speaker.frame())
    assert not signing.refused


@pytest.mark.parametrize("how", [{}, {"force_mavlink1": True}])
def test_unsigned_frames_are_refused_except_those_of_radios(how: dict[str, Any]) -> None:
    signing, radio = ours(), Speaker(key=None)
    assert not signing.accepts(radio.frame(**how))
    status = wire.MAVLink_radio_status_message(100, 100, 50, 10, 10, 0, 0)
    assert signing.accepts(radio.frame(status, **how))
    assert signing.refused == 1


def test_wrongly_signed_frames_are_refused() -> None:
    signing = ours()
    assert not signing.accepts(Speaker(key=WRONG_KEY).frame())
    good = Speaker().frame()
    for k in range(2, len(good)):
        bent = bytearray(good)
        bent[k] ^= 0x80
        assert not signing.accepts(bytes(bent))
    assert signing.accepts(good)
    assert signing.refused == 1 + len(good) - 2


def test_a_frame_is_believed_once() -> None:
    signing, vehicle = ours(), Speaker()
    first, second, third = (vehicle.frame() for _ in range(3))
    assert signing.accepts(first)
    assert signing.accepts(third)
    for old in (first, second, third, Speaker(NOW - 5).frame()):  # the last: it begins again lower
        assert not signing.accepts(old)
    assert signing.refused == 4


def test_a_forged_frame_changes_nothing() -> None:
    # pymavlink 2.4.50 moves the stream's time before it looks at the signature
    signing, vehicle = ours(), Speaker()
    assert signing.accepts(vehicle.frame())
    forged = Speaker(timestamp=NOW + 1000 * MINUTE, key=WRONG_KEY).frame()
    assert not signing.accepts(forged)
    assert signing.accepts(vehicle.frame())
    assert signing.timestamp < NOW + MINUTE


@pytest.mark.parametrize(("behind", "believed"), [(MINUTE, True), (MINUTE + 1, False)])
def test_a_new_stream_may_be_a_minute_behind(behind: int, believed: bool) -> None:
    signing = ours()
    assert signing.accepts(Speaker(NOW - behind).frame()) == believed
    assert signing.refused == (not believed)


def test_a_clock_ahead_of_ours_is_believed_and_followed() -> None:
    # ardupilot.md 5: the vehicle stamps +47 to +60 s; a new stream must be within its minute
    signing = ours(NOW - 3600 * TICKS_PER_S)  # a computer without a clock
    vehicle = Speaker(NOW + MINUTE)
    assert signing.accepts(vehicle.frame())
    sent = signing.sign(heartbeat().pack(codec(1)))
    assert vehicle.mav.check_signature(bytearray(sent), 1, 195)


def test_streams_are_kept_apart_by_link_system_and_component() -> None:
    signing = ours()
    assert signing.accepts(Speaker(NOW + 1000).frame())
    for other in ({"link": 1}, {"system": 2}, {"component": 2}):
        assert signing.accepts(Speaker(NOW, **other).frame())  # type: ignore[arg-type]


def test_memory_is_bounded_however_many_streams_there_are() -> None:
    signing = ours()
    believed = sum(
        signing.accepts(Speaker(NOW, link=k % 256, system=1 + k // 256).frame()) for k in range(300)
    )
    assert believed == 256
    assert signing.refused == 44


# --- what is said about it ------------------------------------------------------------------------


def test_refusals_are_told_once_a_minute_and_only_if_there_are_new_ones() -> None:
    signing, stranger = ours(), Speaker(key=None)
    steps = ((0, 0.0), (1, 1.0), (5, 60.0), (0, 61.0), (0, 600.0), (1, 5.0))  # it has rebooted
    told = []
    for frames, at_s in steps:
        for _ in range(frames):
            signing.accepts(stranger.frame())
        told.append(signing.complaint(at_s))
    said = [None if each is None else each.split()[1] for each in told]
    assert said == [None, "1", None, "5", None, "1"]
    signing.refused += 9_999_999
    assert len(signing.complaint(900.0) or "") <= 50


# --- logs -----------------------------------------------------------------------------------------


@given(
    text=st.binary(max_size=50),
    sequence=st.integers(0, 255),
    number=st.integers(0, 2**24 - 1),
    extra=st.integers(0, 255),
)
def test_a_stripped_frame_is_the_frame_that_was_never_signed(
    text: bytes, sequence: int, number: int, extra: int
) -> None:
    def framed(flags: int) -> bytes:
        head = bytes([len(text), flags, 0, sequence, 1, 1]) + number.to_bytes(3, "little")
        checksum = mcrf4xx(head + text + bytes([extra]))
        return b"\xfd" + head + text + checksum.to_bytes(2, "little")

    assert strip_signature(framed(1) + bytes(range(13))) == framed(0)
    assert strip_signature(framed(0)) == framed(0)


def test_a_frame_that_was_kept_is_signed_as_pymavlink_would_sign_it_now() -> None:
    keeper = ours()
    for message in (heartbeat(), wire.MAVLink_statustext_message(4, b"hello")):
        plain = message.pack(codec(1))
        for _ in range(3):
            signed = keeper.sign(plain)
            there = Speaker(int.from_bytes(signed[-12:-6], "little"), link=3, component=195)
            assert signed == there.frame(message)
            assert keeper.sign(signed) == signed
            assert strip_signature(signed) == plain  # as a log keeps it
    first_protocol = heartbeat().pack(codec(1), force_mavlink1=True)
    assert keeper.sign(first_protocol) == first_protocol  # it has no signatures


def test_messages_with_keys_and_passwords_are_secret() -> None:
    names = {wire.mavlink_map[number].msgname for number in SECRETS}
    assert "SETUP_SIGNING" in names
    words = ("secret", "password", "passkey", "key")
    assert names == {
        kind.msgname
        for kind in wire.mavlink_map.values()
        if any(field.startswith(words) for field in kind.fieldnames)
    }


def test_the_key_is_not_shown() -> None:
    shown = repr(ours()), str(vars(codec(1)))
    assert not any(form in each for each in shown for form in (KEY.hex(), repr(KEY)))
