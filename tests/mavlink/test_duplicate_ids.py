"""Another process with our ids is told from our own frames that a link sends back."""

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.mavlink.dialect import codec, wire
from companion.mavlink.link import DuplicateIdDetector
from companion.mission.events import DuplicateId

SYSTEM = 7


class Speaker:
    """A process that speaks as 7/195: we, or somebody else."""

    def __init__(self, seq: int = 0, system_id: int = SYSTEM) -> None:
        self.link = codec(system_id)
        self.link.seq = seq

    def says(self, message: Any, *, version_1: bool = False) -> bytes:
        frame: bytes = message.pack(self.link, force_mavlink1=version_1)
        self.link.seq = (self.link.seq + 1) % 256
        return frame

    def beats(self) -> bytes:
        return self.says(wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))

    def leads(self, time_ms: int) -> bytes:
        return self.says(
            wire.MAVLink_set_position_target_global_int_message(
                time_ms, SYSTEM, 1, 5, 2496, 473977420, 85455940, 520.0, *[0.0] * 8
            )
        )


def heard(it: DuplicateIdDetector, frame: bytes, now_s: float, system: int | None = SYSTEM) -> Any:
    return it.heard(frame, system, now_s)


def test_whatever_is_reflected_however_often_and_late_is_no_stranger() -> None:
    us, it = Speaker(), DuplicateIdDetector()
    frames = []
    for tick in range(400):
        frame = us.beats() if tick % 10 == 0 else us.leads(tick * 100)
        it.sent.append(frame)
        frames.append(frame)
        for late in (0, 0, 1, 30, 200):
            if late <= tick:
                assert heard(it, frames[tick - late], tick * 0.1) is None


def test_a_reflection_may_have_lost_its_signature_its_version_or_its_zeros() -> None:
    us, it = Speaker(), DuplicateIdDetector()
    us.link.signing.secret_key, us.link.signing.sign_outgoing = b"k" * 32, True
    it.sent.append(us.beats())
    other = Speaker()
    beat = wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    assert heard(it, other.says(beat), 0.1) is None
    assert heard(it, Speaker().says(beat, version_1=True), 0.2) is None


def test_one_who_says_the_same_with_a_sequence_of_its_own_is_a_stranger() -> None:
    us, them, it = Speaker(), Speaker(seq=100), DuplicateIdDetector()
    told = []
    for second in range(6):
        it.sent.append(us.beats())
        told.append(heard(it, them.beats(), float(second)))
    first, second, third = told[:3]
    assert first == DuplicateId(time_s=0.0, certain=False)
    assert second == DuplicateId(time_s=1.0, certain=False)
    assert third == DuplicateId(time_s=2.0, certain=True, news=True)
    assert told[3:] == [DuplicateId(time_s=float(at), certain=True) for at in (3, 4, 5)]


def test_what_a_dead_companion_has_left_in_buffers_is_never_certain() -> None:
    before, it = Speaker(seq=50), DuplicateIdDetector()
    told = [heard(it, before.leads(tick), 10.0 + 0.01 * tick) for tick in range(140)]
    assert [event.certain for event in told if event is not None] == [False] * 3
    assert heard(it, before.beats(), 20.0) == DuplicateId(time_s=20.0, certain=False)


@pytest.mark.parametrize("rate_hz", [1, 20, 200])
def test_a_stranger_that_streams_is_told_of_twice_a_second_at_most(rate_hz: int) -> None:
    them, it = Speaker(), DuplicateIdDetector()
    told = [heard(it, them.leads(tick), tick / rate_hz) for tick in range(10 * rate_hz)]
    told = [event for event in told if event is not None]
    assert 0 < len(told) <= 21
    assert sum(event.news for event in told) == 1
    others = [event for event in told if not event.news]
    assert all(b.time_s - a.time_s >= 0.5 - 1e-9 for a, b in pairwise(others))


def test_the_companion_of_another_vehicle_is_none_of_ours() -> None:
    them, it = Speaker(system_id=8), DuplicateIdDetector()
    assert not any(heard(it, them.beats(), float(at)) for at in range(10))


def test_what_was_heard_before_it_was_clear_whose_companion_we_are_counts_then() -> None:
    them, it = Speaker(), DuplicateIdDetector()
    assert not any(heard(it, them.beats(), float(at), None) for at in range(4))
    assert heard(it, them.beats(), 4.0) == DuplicateId(time_s=4.0, certain=True, news=True)


def test_one_who_comes_back_is_news_again() -> None:
    them, it = Speaker(), DuplicateIdDetector()
    times = [*range(4), 10, *range(30, 34)]
    told = [heard(it, them.beats(), float(at)) for at in times]
    assert [event.time_s for event in told if event.news] == [2.0, 32.0]


@given(st.lists(st.tuples(st.booleans(), st.floats(0.0, 2.0)), max_size=60))
def test_without_a_stranger_nothing_is_ever_told(steps: list[tuple[bool, float]]) -> None:
    """Whatever the link does with our frames: sends them back in any order, again, or late."""
    us, it, now_s = Speaker(), DuplicateIdDetector(), 0.0
    frames = [us.beats()]
    it.sent.append(frames[0])
    for sends, wait_s in steps:
        now_s += wait_s
        if sends:
            frames.append(us.leads(len(frames)))
            it.sent.append(frames[-1])
        else:
            assert heard(it, frames[int(wait_s * 1e6) % len(frames)], now_s) is None
