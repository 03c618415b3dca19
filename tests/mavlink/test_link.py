"""What a link tells besides messages: strangers with our ids, the vehicle's time, frames unread."""

import random
from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import all as wire
from wires import SYSTEM, Speaker

from companion.mavlink.autopilots import ALL
from companion.mavlink.frames import IGNORED_MESSAGES
from companion.mavlink.link import ClockReading, DuplicateIdDetector, VehicleClock
from companion.mission.events import DuplicateId


class Companion(Speaker):
    """A process that speaks as 7/195: we, or somebody else."""

    def __init__(self, seq: int = 0, system_id: int = SYSTEM) -> None:
        super().__init__(seq=seq, srcSystem=system_id, srcComponent=195)

    def beats(self, version: int = 3) -> bytes:
        """A heartbeat; version: what makes it another one."""
        return self.frame(wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, version))


def test_what_comes_back_of_what_we_said_is_no_stranger() -> None:
    """At once, again, 200 frames late, in any order, or without its signature."""
    us, it, rng = Companion(), DuplicateIdDetector(), random.Random(1)
    frames = [us.beats(tick // 2 % 256) for tick in range(400)]
    for tick, frame in enumerate(frames):
        it.sent.append(frame)
        for back in (0, 0, rng.randrange(200), 200):
            assert it.heard(frames[max(tick - back, 0)], SYSTEM, tick * 0.1) is None
    unsigned = Companion(us.mav.seq).beats()
    us.mav.signing.secret_key, us.mav.signing.sign_outgoing = b"k" * 32, True
    it.sent.append(us.beats())
    assert it.heard(unsigned, SYSTEM, 40.1) is None


def test_one_who_says_the_same_with_a_sequence_of_its_own_is_certain_once_it_goes_on() -> None:
    us, them, it = Companion(), Companion(seq=100), DuplicateIdDetector()
    told = []
    for second in range(6):
        it.sent.append(us.beats())
        told.append(it.heard(them.beats(), SYSTEM, float(second)))
    assert told == [DuplicateId(time_s=float(at), certain=at > 1, news=at == 2) for at in range(6)]
    # what a dead companion has left in buffers comes in one burst
    before, it = Companion(seq=50), DuplicateIdDetector()
    burst = [it.heard(before.beats(), SYSTEM, 10.0 + 0.01 * tick) for tick in range(140)]
    assert [event.certain for event in burst if event is not None] == [False] * 3
    doubted = DuplicateId(time_s=20.0, certain=False)
    assert it.heard(before.beats(), SYSTEM, 20.0) == doubted


@pytest.mark.parametrize("rate_hz", [1, 20, 200])
def test_a_stranger_that_streams_is_told_of_twice_a_second_at_most(rate_hz: int) -> None:
    them, it = Companion(), DuplicateIdDetector()
    heard = [it.heard(them.beats(), SYSTEM, k / rate_hz) for k in range(10 * rate_hz)]
    told = [event for event in heard if event is not None]
    assert 0 < len(told) <= 21
    assert sum(event.news for event in told) == 1
    others = [event for event in told if not event.news]
    assert all(b.time_s - a.time_s >= 0.5 - 1e-9 for a, b in pairwise(others))


def test_another_vehicles_companion_is_none_of_ours_once_it_is_clear_whose_we_are() -> None:
    """What was heard before that counts then; one who comes back later is news again."""
    theirs, it = Companion(system_id=8), DuplicateIdDetector()
    assert not any(it.heard(theirs.beats(), SYSTEM, float(at)) for at in range(10))
    them, it = Companion(), DuplicateIdDetector()
    assert not any(it.heard(them.beats(), None, float(at)) for at in range(4))
    told = [it.heard(them.beats(), SYSTEM, float(at)) for at in (4, 10, *range(30, 34))]
    assert [event.time_s for event in told if event and event.news] == [4.0, 32.0]


READ = ClockReading


@pytest.mark.parametrize(
    ("stamps_s", "last"),
    [
        ((1060.0,), READ.DOUBTED),
        ((1060.0, 60.1), READ.LATER),  # the clock goes on where it was
        ((1060.0, 60.1, 1060.1), READ.DOUBTED),  # one that leaps now and then is never believed
        ((1060.0, 1060.0), READ.DOUBTED),  # copies of one frame, or messages of one moment
        ((1060.0, 5.0), READ.DOUBTED),
        ((1060.0, 1060.1), READ.LATER),  # two agree: so it is
        ((5.0, 5.1), READ.REBOOTED),
        ((61.9,), READ.LATER),
    ],
)
def test_a_leap_is_doubted_like_a_fall(stamps_s: tuple[float, ...], last: ClockReading) -> None:
    clock = VehicleClock(0.0)
    assert clock.read(60.0) is READ.FIRST
    told = [(clock.believes(stamp_s), clock.read(stamp_s)) for stamp_s in stamps_s]
    assert told[-1][1] is last
    assert all(believed is (reading is not READ.DOUBTED) for believed, reading in told)


def test_silence_and_arrival_explain_a_leap() -> None:
    arrived, silent = VehicleClock(0.0), VehicleClock(0.0)
    for each in (arrived, silent):
        each.read(60.0, 7.0)
    silent.on_silence(30.0, counts=True)
    # a gap in a log, or a slow stream, and then no more
    assert [arrived.read(*at) for at in ((90.0, 37.0), (97.0, 38.0))] == [READ.LATER, READ.DOUBTED]
    assert [silent.read(at_s) for at_s in (90.0, 97.0)] == [READ.LATER, READ.DOUBTED]


def test_nothing_that_is_asked_for_goes_unread() -> None:
    for each in ALL:
        wanted = {*each.streams_hz, *each.requested_once, *each.intermittent, *each.decoders}
        assert not wanted & IGNORED_MESSAGES
