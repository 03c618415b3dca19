"""Whatever comes in, at any moment of a flight: nothing raised, no nonsense sent, nothing grows."""

from typing import Any

import pytest
from companion_receive import HANDLED, Run, Target, saved
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink
from random_programs import intact

COPTER, PX4, LOCKSTEP = 0, 2, 4
TARGET = Target()
FLOOD = 1_500
INBOX = 2_500_000
"""Bytes that may wait to be handled, beside what is recorded: some ten thousand messages."""
GROWTH = 200_000
"""Bytes that a flood may add to a session: texts, tables and queues that are not empty."""


def in_flight(which: int) -> Run:
    """A session and its vehicle in the middle of their flight."""
    moments = [moment for moment in TARGET.moments(which) if moment.phase == "flying"]
    return moments[len(moments) // 2].again()


@settings(max_examples=100)
@given(st.binary(min_size=1, max_size=300))
def test_nothing_is_raised_and_no_nonsense_is_sent_whatever_happens(program: bytes) -> None:
    TARGET.play(program)


@pytest.mark.sample(4)  # each second message, to a copter
@pytest.mark.parametrize("which", [COPTER, pytest.param(PX4, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("number", HANDLED, ids=lambda number: mavlink.mavlink_map[number].msgname)
def test_a_flood_of_one_message_does_not_pile_up(which: int, number: int) -> None:
    """Each different, from the autopilot and from a ground station, all answered at once."""
    run = in_flight(which)
    session = run.session
    kind: Any = mavlink.mavlink_map[number]
    size, before = kind.unpacker.size, len(saved(session))
    for k in range(FLOOD):
        payload = (k.to_bytes(3, "little") * 90)[:size]
        sender = (1, 1) if k % 2 else (255, 190)
        values = {"time_boot_ms": round(session.now_s * 1e3), "param_index": k % 1000}
        session.receive(intact(number, payload, sender, target=(1, 195), values=values), 1000.0)
        if k % 100 == 0:
            run.tick()
    run.run()
    assert len(saved(session)) < before + GROWTH


@pytest.mark.parametrize("which", [COPTER, pytest.param(LOCKSTEP, marks=pytest.mark.nightly)])
def test_what_comes_faster_than_it_is_handled_is_dropped(which: int) -> None:
    run = in_flight(which)
    session, before = run.session, len(saved(run.session))
    portion = b"".join(run.heard() for _ in range(10))
    for _ in range(1_000):
        session.receive(portion, 1000.0)
    assert len(saved(session)) < before + 1_000 * len(portion) + INBOX
    run.run()
