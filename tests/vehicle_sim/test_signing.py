"""MAVLink 2 signing: the table of ardupilot.md 5 row by row, and pymavlink as the other side."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.wire.frames import Packer, StreamParser
from vehicle_sim.wire.signing import AHEAD, Signing

USB, RADIO, OTHER = 0, 1, 2
KEY, WRONG_KEY = bytes(range(32)), bytes(32 * [9])
SECOND = 100_000
"""Of the time stamps: 10 microseconds each."""
NOW = 3_600 * 24 * 365 * 11 * SECOND
ARM = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)


def setup(key: bytes = KEY, timestamp: int = NOW) -> Any:
    return mavlink.MAVLink_setup_signing_message(1, 1, list(key), timestamp)


def signed_vehicle() -> Signing:
    signing = Signing(links=3)
    assert signing.setup(setup(), armed=False) is None
    return signing


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


def test_without_a_key_everything_comes_in_and_nothing_is_signed() -> None:
    signing = Signing(links=3)
    assert signing.key.is_off
    assert not signing.signer(RADIO).active
    for client in (Client(key=None), Client(key=WRONG_KEY)):
        assert signing.accepts(client.frame(), RADIO, 0)


def test_after_setup_every_link_signs_with_its_own_number() -> None:
    signing = signed_vehicle()
    for link in (USB, RADIO, OTHER):
        packer = Packer(1, 1)
        packer.signer = signing.signer(link)
        frame = packer.frame(ARM)
        assert frame[2] == 1
        assert frame[-13] == link
        plain = Packer(1, 1).frame(ARM)
        assert len(frame) == len(plain) + 13


@pytest.mark.parametrize("message", [ARM, mavlink.MAVLink_statustext_message(4, b"hello")])
def test_pymavlink_believes_what_the_vehicle_signs(message: Any) -> None:
    signing, client = signed_vehicle(), Client()
    packer = Packer(1, 1)
    packer.signer = signing.signer(RADIO)
    for _ in range(20):
        got = client.mav.decode(bytearray(packer.frame(message)))
        assert got.get_signed()
    assert client.mav.signing.goodsig_count == 20
    assert client.mav.signing.badsig_count == 0
    liar = Client(key=WRONG_KEY)
    with pytest.raises(mavlink.MAVError, match="signature"):
        liar.mav.decode(bytearray(packer.frame(message)))


def test_the_vehicle_believes_what_pymavlink_signs() -> None:
    signing, client = signed_vehicle(), Client()
    for _ in range(20):
        frame = client.frame()
        assert signing.accepts(frame, RADIO, 0)
        ((raw, message),) = StreamParser(datagrams=True).feed(frame)
        assert (raw, message.command) == (frame, 400)


@given(flip=st.integers(0, 10**6))
def test_one_bit_more_or_less_is_refused(flip: int) -> None:
    signing, frame = signed_vehicle(), bytearray(Client().frame())
    at = flip % (8 * len(frame))
    frame[at // 8] ^= 1 << at % 8
    assert not signing.accepts(bytes(frame), RADIO, 0)
    assert signing.accepts(Client().frame(), RADIO, 0)  # a refused frame leaves no trace


# --- the table of ardupilot.md 5 ------------------------------------------------------------------


def test_the_vehicle_stamps_a_minute_ahead_of_what_it_was_given_and_falls_behind() -> None:
    signer = signed_vehicle().signer(RADIO)
    stamps = [int.from_bytes(signer.signature(b"")[1:7], "little") for _ in range(3)]
    assert stamps == [NOW + AHEAD, NOW + AHEAD + 1, NOW + AHEAD + 2]
    assert AHEAD == 60 * SECOND


def test_setup_while_armed_is_refused_with_a_text() -> None:
    signing = Signing(links=3)
    text = signing.setup(setup(), armed=True)
    assert text is not None
    assert text.text == "ERROR: Won't setup signing when armed"
    assert signing.key.is_off


def test_channel_0_takes_what_is_unsigned_or_wrongly_signed() -> None:
    signing = signed_vehicle()
    for client in (Client(key=None), Client(key=WRONG_KEY)):
        assert signing.accepts(client.frame(), USB, 0)


def test_other_links_drop_what_is_unsigned_but_radio_status() -> None:
    signing, client = signed_vehicle(), Client(key=None)
    assert not signing.accepts(client.frame(), RADIO, 0)
    assert not signing.accepts(bytes(ARM.pack(client.mav, force_mavlink1=True)), RADIO, 0)
    status = mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1)
    assert signing.accepts(client.frame(status), RADIO, 0)


def test_the_right_key_is_accepted_and_a_wrong_one_dropped() -> None:
    signing = signed_vehicle()
    assert signing.accepts(Client().frame(), RADIO, 0)
    assert not signing.accepts(Client(key=WRONG_KEY, timestamp=NOW + SECOND).frame(), RADIO, 0)


def test_the_same_frame_again_is_dropped() -> None:
    signing, frame = signed_vehicle(), Client().frame()
    assert [signing.accepts(frame, RADIO, 0) for _ in range(3)] == [True, False, False]
    assert not signing.accepts(Client(timestamp=NOW - 1).frame(), RADIO, 0)
    assert signing.accepts(Client(timestamp=NOW + 1).frame(), RADIO, 0)


@pytest.mark.parametrize(
    ("offset", "taken"), [(-30 * SECOND, False), (-1, False), (0, True), (90 * SECOND, True)]
)
def test_how_old_a_new_stream_may_be(offset: int, *, taken: bool) -> None:
    # 30 s old was dropped although the client's clock is right: the vehicle's is 60 s ahead
    assert signed_vehicle().accepts(Client(timestamp=NOW + offset).frame(), RADIO, 0) is taken


def test_the_vehicle_keeps_up_with_what_it_hears() -> None:
    signing = signed_vehicle()
    assert signing.accepts(Client(timestamp=NOW + 90 * SECOND).frame(), RADIO, 0)
    late = Client(link=6, timestamp=NOW + 20 * SECOND)
    assert not signing.accepts(late.frame(), RADIO, 0)
    assert signing.accepts(late.frame(), OTHER, 0)  # each link has its own time


def test_streams_are_told_apart_by_link_id_and_sender() -> None:
    signing = signed_vehicle()
    later = Client(timestamp=NOW + 5 * SECOND)
    assert signing.accepts(later.frame(), RADIO, 0)
    assert signing.accepts(Client(link=6).frame(), RADIO, 0)
    assert signing.accepts(Client(component=191).frame(), RADIO, 0)
    assert not signing.accepts(Client().frame(), RADIO, 0)


def test_the_number_of_streams_is_bounded() -> None:
    signing = signed_vehicle()
    taken = [signing.accepts(Client(link=link).frame(), RADIO, 0) for link in range(40)]
    assert taken == [True] * 16 + [False] * 24
    assert signing.accepts(Client(link=3, timestamp=NOW + 9).frame(), RADIO, 0)


def test_setup_unsigned_on_a_signed_link_is_ignored() -> None:
    signing = signed_vehicle()
    assert not signing.accepts(Client(key=None).frame(setup(WRONG_KEY)), RADIO, 0)


def test_an_all_zero_key_and_time_turn_signing_off() -> None:
    signing = signed_vehicle()
    signing.setup(setup(bytes(32), 0), armed=False)
    assert signing.key.is_off
    assert not signing.signer(RADIO).active
    assert signing.accepts(Client(key=None).frame(), RADIO, 0)
    packer = Packer(1, 1)
    packer.signer = signing.signer(RADIO)
    assert packer.frame(ARM) == Packer(1, 1).frame(ARM)


def test_a_reboot_keeps_the_key() -> None:
    signing = signed_vehicle()
    frame = Client().frame()
    assert signing.accepts(frame, RADIO, 0)
    signing.restart()
    assert signing.signer(RADIO).active
    assert not signing.accepts(Client(key=None).frame(), RADIO, 0)
    assert signing.accepts(frame, RADIO, 0)  # who spoke before is forgotten
    again = Signing(links=3, key=signing.key)  # as a new process would read it from a file
    assert again.accepts(Client(timestamp=NOW + 2).frame(), RADIO, 0)


def test_the_time_that_was_reached_is_kept_every_30_s() -> None:
    signing = signed_vehicle()
    client = Client(timestamp=NOW + 200 * SECOND)
    signing.accepts(client.frame(), RADIO, 1_000_000)
    assert signing.key.timestamp == NOW
    signing.accepts(client.frame(), RADIO, 31_000_000)
    assert signing.key.timestamp == pytest.approx(NOW + 200 * SECOND, abs=2)
    signing.restart()
    replayed = Client(link=9, timestamp=NOW + 150 * SECOND)
    assert not signing.accepts(replayed.frame(), RADIO, 0)
