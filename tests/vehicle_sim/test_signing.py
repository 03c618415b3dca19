"""MAVLink 2 signing: the table of ardupilot.md 5 row by row, and pymavlink as the other side."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.wire.frames import Packer
from vehicle_sim.wire.signing import AHEAD, Signing

USB, RADIO = 0, 1
KEY, WRONG_KEY = bytes(range(32)), bytes(32 * [9])
SECOND = 100_000
"""Of the time stamps: 10 microseconds each."""
NOW = 3_600 * 24 * 365 * 11 * SECOND
ARM = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
STATUS = mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1)


def setup(key: bytes = KEY, timestamp: int = NOW) -> Any:
    return mavlink.MAVLink_setup_signing_message(1, 1, list(key), timestamp)


def signed_vehicle() -> Signing:
    signing = Signing()
    assert signing.setup(setup(), armed=False) is None
    return signing


class Client:
    """pymavlink with its own signing."""

    def __init__(
        self, *, key: bytes = KEY, link: int = 5, timestamp: int = NOW, component: int = 190
    ) -> None:
        self.mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=component)
        self.mav.signing.secret_key, self.mav.signing.link_id = key, link
        self.mav.signing.timestamp, self.mav.signing.sign_outgoing = timestamp, bool(key)

    def frame(self, message: Any = ARM, *, old: bool = False) -> bytes:
        return bytes(message.pack(self.mav, force_mavlink1=old))


UNSIGNED, LIAR = Client(key=b""), Client(key=WRONG_KEY)


def test_without_a_key_everything_comes_in_and_nothing_is_signed() -> None:
    taken_back = signed_vehicle()
    taken_back.setup(setup(bytes(32), 0), armed=False)
    for signing in (Signing(), taken_back):
        assert Packer(1, 1, signing).frame(ARM)[2] == 0
        assert all(signing.accepts(client.frame(), RADIO) for client in (UNSIGNED, LIAR))
    refused = signing.setup(setup(), armed=True)
    assert refused is not None
    assert refused.text == "ERROR: Won't setup signing when armed"
    assert not signing.secret


def test_pymavlink_believes_what_the_vehicle_signs_a_minute_ahead_on_every_link() -> None:
    signing, client = signed_vehicle(), Client()
    for count, link in enumerate((USB, RADIO, 2)):
        frame = Packer(1, 1, signing, link).frame(STATUS)
        assert client.mav.decode(bytearray(frame)).get_signed()
        assert frame[-13] == link
        assert int.from_bytes(frame[-12:-6], "little") == NOW + 60 * SECOND + count
    assert client.mav.signing.badsig_count == 0
    with pytest.raises(mavlink.MAVError, match="signature"):
        Client(key=WRONG_KEY).mav.decode(bytearray(frame))


@given(flip=st.integers(0, 10**6))
def test_the_vehicle_believes_what_pymavlink_signs_but_for_one_bit(flip: int) -> None:
    signing, client = signed_vehicle(), Client()
    frame = bytearray(client.frame())
    at = flip % (8 * len(frame))
    frame[at // 8] ^= 1 << at % 8
    assert not signing.accepts(bytes(frame), RADIO)
    assert all(signing.accepts(client.frame(), RADIO) for _ in range(5))  # it leaves no trace


def test_link_0_takes_everything_and_the_others_only_radio_status_unsigned() -> None:
    signing = signed_vehicle()
    for frame in (
        UNSIGNED.frame(),
        LIAR.frame(),
        UNSIGNED.frame(old=True),
        UNSIGNED.frame(setup()),
    ):
        assert signing.accepts(frame, USB)
        assert not signing.accepts(frame, RADIO)
    assert signing.accepts(UNSIGNED.frame(STATUS), RADIO)
    assert signing.accepts(UNSIGNED.frame(STATUS, old=True), RADIO)


@pytest.mark.parametrize(
    ("offset", "taken"), [(-30 * SECOND, False), (-1, False), (0, True), (90 * SECOND, True)]
)
def test_how_old_a_new_stream_may_be(offset: int, *, taken: bool) -> None:
    # 30 s old was dropped although the client's clock is right: the vehicle's is 60 s ahead
    assert AHEAD == 60 * SECOND
    assert signed_vehicle().accepts(Client(timestamp=NOW + offset).frame(), RADIO) is taken


def test_of_each_stream_only_what_is_newer_comes_in_and_streams_are_bounded() -> None:
    signing, frame = signed_vehicle(), Client(timestamp=NOW + 5).frame()
    assert [signing.accepts(frame, RADIO) for _ in range(3)] == [True, False, False]
    assert not signing.accepts(Client(timestamp=NOW + 4).frame(), RADIO)
    assert signing.accepts(Client(component=191).frame(), RADIO)  # another stream
    taken = [signing.accepts(Client(link=link).frame(), RADIO) for link in range(10, 40)]
    assert taken == [True] * 14 + [False] * 16
    assert signing.accepts(Client(link=13, timestamp=NOW + 9).frame(), RADIO)


def test_the_vehicle_keeps_up_with_what_it_hears_and_keeps_its_key_over_a_reboot() -> None:
    signing = signed_vehicle()
    assert signing.accepts(Client(timestamp=NOW + 200 * SECOND).frame(), RADIO)
    assert not signing.accepts(Client(link=6, timestamp=NOW + 20 * SECOND).frame(), RADIO)
    signing.restart()
    assert Packer(1, 1, signing).frame(ARM)[2] == 1
    assert not signing.accepts(UNSIGNED.frame(), RADIO)
    assert not signing.accepts(Client(link=9, timestamp=NOW + 130 * SECOND).frame(), RADIO)
    assert signing.accepts(Client(timestamp=NOW + 200 * SECOND).frame(), RADIO)
