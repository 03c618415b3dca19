"""Signing, with pymavlink as the other side (ardupilot.md 5, px4.md 2), and what bad links lose."""

import itertools
from functools import partial
from typing import Any

import numpy as np
import pytest
from harness import GCS, Rig, command_long
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as mavlink
from wires import Speaker

from vehicle_sim.faults import LinkConditions
from vehicle_sim.wire.frames import framed
from vehicle_sim.wire.impairments import MAX_FRAMES, Impairments
from vehicle_sim.wire.signing import Signing

STEP_US, S = 10_000, 1_000_000
ARM = command_long(400, 1)
STATUS = mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1)

# --- what is signed -------------------------------------------------------------------------------

USB, SIGNED = 0, 1
"""Links: the first takes everything."""
KEY, WRONG_KEY = bytes(range(32)), bytes(32 * [9])
SECOND = 100_000
"""Of the time stamps: 10 microseconds each."""
NOW = 3_600 * 24 * 365 * 11 * SECOND


def setup(secret: bytes = KEY, timestamp: int = NOW) -> Any:
    return mavlink.MAVLink_setup_signing_message(1, 1, list(secret), timestamp)


def signed_vehicle() -> Signing:
    signing = Signing()
    assert signing.setup(setup(), armed=False) == []
    return signing


def speaker(key: bytes | None = KEY, link: int = 5, late: int = 0, component: int = 190) -> Speaker:
    """pymavlink with its own signing."""
    return Speaker(key, NOW + late, link=link, srcSystem=255, srcComponent=component)


UNSIGNED, LIAR = speaker(None), speaker(WRONG_KEY)


def test_without_a_key_everything_comes_in_and_nothing_is_signed() -> None:
    taken_back = signed_vehicle()
    taken_back.setup(setup(bytes(32), 0), armed=False)
    for signing in (Signing(), taken_back):
        assert not signing.secret
        assert all(signing.accepts(each.frame(ARM), SIGNED) for each in (UNSIGNED, LIAR))
    (refused,) = signing.setup(setup(), armed=True)
    assert refused.text == "ERROR: Won't setup signing when armed"
    assert not signing.secret


def test_pymavlink_believes_what_the_vehicle_signs_a_minute_ahead_on_every_link() -> None:
    signing, client = signed_vehicle(), speaker()
    for count, link in enumerate((USB, SIGNED, 2)):
        frame = framed(STATUS, 0, 1, 1, partial(signing.signature, link=link))
        assert client.mav.decode(bytearray(frame)).get_signed()
        assert frame[-13] == link
        assert int.from_bytes(frame[-12:-6], "little") == NOW + 60 * SECOND + count
    with pytest.raises(mavlink.MAVError, match="signature"):
        LIAR.mav.decode(bytearray(frame))


@given(flip=st.integers(0, 10**6))
def test_the_vehicle_believes_what_pymavlink_signs_but_for_one_bit(flip: int) -> None:
    signing, client = signed_vehicle(), speaker()
    frame = bytearray(client.frame(ARM))
    at = flip % (8 * len(frame))
    frame[at // 8] ^= 1 << at % 8
    assert not signing.accepts(bytes(frame), SIGNED)
    assert all(signing.accepts(client.frame(ARM), SIGNED) for _ in range(5))  # it leaves no trace


def test_link_0_takes_everything_and_the_others_what_is_signed_and_newer_in_its_stream() -> None:
    """30 s old was dropped although the client's clock is right: the vehicle's is 60 s ahead."""
    signing, old = signed_vehicle(), UNSIGNED.frame(ARM, force_mavlink1=True)
    for frame in (UNSIGNED.frame(ARM), old, UNSIGNED.frame(setup()), LIAR.frame(ARM)):
        assert [signing.accepts(frame, link) for link in (USB, SIGNED)] == [True, False]
    for late, taken in ((-30 * SECOND, False), (-1, False), (0, True), (90 * SECOND, True)):
        assert signed_vehicle().accepts(speaker(late=late).frame(ARM), SIGNED) is taken
    signing, frame = signed_vehicle(), speaker(late=5).frame(ARM)
    assert [signing.accepts(frame, SIGNED) for _ in range(2)] == [True, False]
    assert not signing.accepts(speaker(late=4).frame(ARM), SIGNED)
    assert signing.accepts(speaker(component=191).frame(ARM), SIGNED)  # another stream
    assert signing.accepts(speaker(link=13, late=200 * SECOND).frame(ARM), SIGNED)
    assert not signing.accepts(speaker(link=6).frame(ARM), SIGNED)  # it keeps up with what it hears


def test_px4_takes_what_is_signed_and_what_is_not_and_never_signs() -> None:
    vehicle = Rig("px4").armable()
    vehicle.put(speaker().frame(ARM))
    assert vehicle.simulation.armed
    vehicle.send(setup(), source=GCS)
    assert vehicle.run(0.1).command(400, 0) == 0
    assert not any(heard.frame[2] & 1 for heard in vehicle.heard)


# --- what gets lost: frames are numbers here -----------------------------------------------------


def links(*, to_vehicle: bool = True, **conditions: Any) -> Impairments[int]:
    made = Impairments[int](np.random.default_rng(1), to_vehicle=to_vehicle)
    made.impair(LinkConditions(**conditions))
    return made


def carried(made: Impairments[int], count: int, link: int = 0) -> NDArray[np.int64]:
    """When each that came out did so, and which it was; one goes in each step.  -> (K, 2)."""
    out = []
    for step in range(count + 5 * S // STEP_US):
        if step < count:
            made.push(step * STEP_US, link, step)
        out += [(step * STEP_US, number) for _, number in made.pop(step * STEP_US)]
    return np.array(out, dtype=np.int64).reshape(-1, 2)


def test_frames_are_lost_for_good_and_doubled_right_behind_in_their_shares() -> None:
    for conditions, share, most in (({"lost": 0.2}, 0.8, 1), ({"duplicated": 0.3}, 1.3, 2)):
        _, numbers = carried(links(**conditions), 5000).T
        assert (np.diff(numbers) >= 0).all()
        assert len(numbers) / 5000 == pytest.approx(share, abs=0.025)
        assert np.bincount(numbers).max() == most


@given(delay_us=st.integers(0, 3 * S))
def test_a_delay_keeps_order_and_jitter_lets_frames_overtake_within_bounds(delay_us: int) -> None:
    for jitter_us in (0, 80_000):
        at_us, numbers = carried(links(delay_us=delay_us, jitter_us=jitter_us), 200).T
        assert sorted(numbers) == list(range(200))
        assert (np.diff(numbers) > 0).all() == (jitter_us == 0)
        late_us = at_us - numbers * STEP_US
        assert delay_us <= late_us.min() <= late_us.max() < delay_us + jitter_us + STEP_US


def test_only_the_links_and_directions_that_are_meant_are_concerned() -> None:
    both, directions = (True, False), ("both", "from_vehicle", "to_vehicle")
    for link, to_vehicle, only, way in itertools.product((0, 5), both, (None, 5), directions):
        meant: dict[str, Any] = {} if way == "both" else {"way": way}
        made = links(off=True, to_vehicle=to_vehicle, **meant, **({"only": 5} if only else {}))
        ways = ("both", "to_vehicle" if to_vehicle else "from_vehicle")
        concerned = only in (None, link) and way in ways
        assert (len(carried(made, 1, link)) == 0) is concerned
        made.impair(LinkConditions())
        assert len(carried(made, 3, link)) == 3


def test_what_is_on_its_way_comes_before_what_follows_and_a_full_queue_loses_the_rest() -> None:
    made = links(delay_us=S)
    made.push(0, 3, 0)
    made.impair(LinkConditions())
    made.push(10_000, 3, 1)
    assert [made.pop(at) for at in (10_000, S)] == [[], [(3, 0), (3, 1)]]
    made = links(delay_us=60 * S)
    for k in range(MAX_FRAMES + 500):
        made.push(k, 0, k)
    assert len(made.pop(200 * S)) == MAX_FRAMES
