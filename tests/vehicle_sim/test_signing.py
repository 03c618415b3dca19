"""MAVLink 2 signing: the table of ardupilot.md 5 row by row, and pymavlink as the other side."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.wire.frames import Packer, prepared
from vehicle_sim.wire.signing import AHEAD, Signing

USB, RADIO, OTHER = 0, 1, 2
KEY, WRONG_KEY = bytes(range(32)), bytes(32 * [9])
SECOND = 100_000
"""Of the time stamps: 10 microseconds each."""
NOW = 3_600 * 24 * 365 * 11 * SECOND
ARM = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
TEXT = mavlink.MAVLink_statustext_message(4, b"hello")


def setup(key: bytes = KEY, timestamp: int = NOW) -> Any:
    return mavlink.MAVLink_setup_signing_message(1, 1, list(key), timestamp)


def signed_vehicle() -> Signing:
    signing = Signing(links=3)
    assert signing.setup(setup(), armed=False) is None
    return signing


def said(signing: Signing, message: Any = ARM, link: int = RADIO) -> bytes:
    return Packer(1, 1, signing.signer(link)).frame(prepared(message))


class Client:
    """pymavlink with its own signing."""

    def __init__(
        self, *, key: bytes | None = KEY, link: int = 5, timestamp: int = NOW, component: int = 190
    ) -> None:
        self.mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=component)
        if key is not None:
            self.mav.signing.secret_key = key
            self.mav.signing.link_id = link
            self.mav.signing.timestamp = timestamp
            self.mav.signing.sign_outgoing = True

    def frame(self, message: Any = ARM) -> bytes:
        return bytes(message.pack(self.mav))


UNSIGNED, LIAR = Client(key=None), Client(key=WRONG_KEY)


@pytest.mark.parametrize("is_off_again", [False, True])
def test_without_a_key_everything_comes_in_and_nothing_is_signed(*, is_off_again: bool) -> None:
    signing = signed_vehicle() if is_off_again else Signing(links=3)
    if is_off_again:
        signing.setup(setup(bytes(32), 0), armed=False)
    assert said(signing)[2] == 0
    assert all(signing.accepts(client.frame(), RADIO) for client in (UNSIGNED, LIAR))


def test_pymavlink_believes_what_the_vehicle_signs_on_every_link() -> None:
    signing, client = signed_vehicle(), Client()
    for link in (USB, RADIO, OTHER):
        for message in (ARM, TEXT):
            frame = said(signing, message, link)
            assert client.mav.decode(bytearray(frame)).get_signed()
            assert frame[-13] == link  # its own number
    assert (client.mav.signing.goodsig_count, client.mav.signing.badsig_count) == (6, 0)
    with pytest.raises(mavlink.MAVError, match="signature"):
        Client(key=WRONG_KEY).mav.decode(bytearray(said(signing)))


@given(flip=st.integers(0, 10**6))
def test_the_vehicle_believes_what_pymavlink_signs_but_for_one_bit(flip: int) -> None:
    signing, client = signed_vehicle(), Client()
    frame = bytearray(client.frame())
    at = flip % (8 * len(frame))
    frame[at // 8] ^= 1 << at % 8
    assert not signing.accepts(bytes(frame), RADIO)
    assert all(signing.accepts(client.frame(), RADIO) for _ in range(5))  # it leaves no trace


# --- the table of ardupilot.md 5 ------------------------------------------------------------------


def test_the_vehicle_stamps_a_minute_ahead_of_what_it_was_given_and_counts_on() -> None:
    signer = signed_vehicle().signer(RADIO)
    stamps = [int.from_bytes(signer.signature(b"")[1:7], "little") for _ in range(3)]
    assert stamps == [NOW + AHEAD, NOW + AHEAD + 1, NOW + AHEAD + 2]
    assert AHEAD == 60 * SECOND


def test_setup_while_armed_is_refused_with_a_text() -> None:
    signing = Signing(links=3)
    text = signing.setup(setup(), armed=True)
    assert text is not None
    assert text.text == "ERROR: Won't setup signing when armed"
    assert said(signing)[2] == 0


def test_channel_0_takes_everything_and_the_others_only_radio_status_unsigned() -> None:
    signing = signed_vehicle()
    old = bytes(ARM.pack(UNSIGNED.mav, force_mavlink1=True))
    for frame in (UNSIGNED.frame(), LIAR.frame(), old, UNSIGNED.frame(setup(WRONG_KEY))):
        assert signing.accepts(frame, USB)
        assert not signing.accepts(frame, RADIO)
    status = mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1)
    assert signing.accepts(UNSIGNED.frame(status), RADIO)


def test_the_same_frame_again_is_dropped() -> None:
    signing, frame = signed_vehicle(), Client().frame()
    assert [signing.accepts(frame, RADIO) for _ in range(3)] == [True, False, False]
    assert not signing.accepts(Client(timestamp=NOW - 1).frame(), RADIO)
    assert signing.accepts(Client(timestamp=NOW + 1).frame(), RADIO)


@pytest.mark.parametrize(
    ("offset", "taken"), [(-30 * SECOND, False), (-1, False), (0, True), (90 * SECOND, True)]
)
def test_how_old_a_new_stream_may_be(offset: int, *, taken: bool) -> None:
    # 30 s old was dropped although the client's clock is right: the vehicle's is 60 s ahead
    assert signed_vehicle().accepts(Client(timestamp=NOW + offset).frame(), RADIO) is taken


def test_the_vehicle_keeps_up_with_what_it_hears_on_each_link_and_over_a_reboot() -> None:
    signing = signed_vehicle()
    assert signing.accepts(Client(timestamp=NOW + 200 * SECOND).frame(), RADIO)
    late = Client(link=6, timestamp=NOW + 20 * SECOND)
    assert not signing.accepts(late.frame(), RADIO)
    assert signing.accepts(late.frame(), OTHER)
    signing.restart()
    assert said(signing)[2] == 1
    assert not signing.accepts(UNSIGNED.frame(), RADIO)
    assert not signing.accepts(Client(link=9, timestamp=NOW + 130 * SECOND).frame(), RADIO)
    assert signing.accepts(Client(timestamp=NOW + 200 * SECOND).frame(), RADIO)


def test_streams_are_told_apart_by_link_id_and_sender_and_bounded() -> None:
    signing = signed_vehicle()
    assert signing.accepts(Client(timestamp=NOW + 5 * SECOND).frame(), RADIO)
    assert signing.accepts(Client(component=191).frame(), RADIO)
    assert not signing.accepts(Client().frame(), RADIO)
    taken = [signing.accepts(Client(link=link).frame(), RADIO) for link in range(10, 40)]
    assert taken == [True] * 14 + [False] * 16
    assert signing.accepts(Client(link=13, timestamp=NOW + 9).frame(), RADIO)
