"""What is not read is recorded, frame by frame, and changes nothing."""

import random
import re
from itertools import pairwise
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as wire
from scripted_vehicle import MISSION, pair

from companion.mavlink.autopilots import Autopilot
from companion.mavlink.autopilots.arducopter import ARDUCOPTER
from companion.mavlink.autopilots.arduplane import ARDUPLANE
from companion.mavlink.autopilots.px4_fixed_wing import PX4_FIXED_WING
from companion.mavlink.autopilots.px4_multicopter import PX4_MULTICOPTER
from companion.mavlink.frames import IGNORED_MESSAGES, Receiver
from companion.mavlink.link import ClockReading, VehicleClock
from companion.session import Session

COMPANION = Path(__file__).parents[2] / "companion"
READ_FROM_LOGS_ONLY = (
    "telemetry/logs",
    "mavlink/frames.py",
    "mavlink/near_sensing.py",
    "mavlink/near_scanner.py",
    "mavlink/rangefinder.py",
    "mavlink/autopilot_client.py",
)


def frame_of(number: int, rng: random.Random, system: int = 1, component: int = 1) -> bytes:
    kind = wire.mavlink_map[number]
    sender = wire.MAVLink(None, srcSystem=system, srcComponent=component)
    sender.seq = rng.randrange(256)
    payload = rng.randbytes(kind.unpacker.size)
    message = wire.MAVLink_message(kind.id, kind.msgname)
    return bytes(message._pack(sender, kind.crc_extra, payload))


def vehicle_says(seconds: float) -> list[bytes]:
    """What a vehicle says from its start into its flight, frame by frame."""
    it = pair(lockstep=False)
    frames: list[bytes] = []
    for _ in range(round(seconds * 10)):
        said = it.vehicle.tick()
        frames += [bytes(message.get_msgbuf()) for message in Receiver().feed(said)]
        it.feed(said)
    return frames


SAID = vehicle_says(14.0)


@pytest.mark.sample(4)
@pytest.mark.parametrize("seed", range(8))
def test_frames_that_nobody_reads_change_no_decision_and_are_recorded_where_they_came(
    seed: int,
) -> None:
    rng = random.Random(seed)
    numbers = sorted(IGNORED_MESSAGES)
    more: list[bytes] = []
    for frame in SAID:
        who = rng.choice([(1, 1), (1, 1), (7, 1), (1, 158)])
        more += [frame_of(rng.choice(numbers), rng, *who) for _ in range(rng.randrange(4))]
        more.append(frame)
    plain, busy = (Session(MISSION, seed=1, lockstep=False) for _ in range(2))
    plain.receive(b"".join(SAID))
    busy.receive(b"".join(more))
    expected, given = plain.run(), busy.run()
    assert (given.frames, given.journal) == (expected.frames, expected.journal)
    sent = set(given.frames)
    assert [frame for _, frame in given.record if frame not in sent] == more


def test_who_says_only_such_things_is_there_all_the_same() -> None:
    session = Session(MISSION, seed=1, lockstep=False)
    session.receive(b"".join(SAID))
    session.run()
    assert session.receive(frame_of(wire.MAVLINK_MSG_ID_HIGHRES_IMU, random.Random(1)))


@pytest.mark.parametrize("autopilot", [ARDUCOPTER, ARDUPLANE, PX4_MULTICOPTER, PX4_FIXED_WING])
def test_nothing_that_is_asked_for_goes_unread(autopilot: Autopilot) -> None:
    wanted = {*autopilot.streams_hz, *autopilot.requested_once, *autopilot.intermittent}
    assert not wanted & IGNORED_MESSAGES
    assert not IGNORED_MESSAGES & set(autopilot.decoders)


def test_nothing_goes_unread_whose_name_stands_in_the_code() -> None:
    names = {wire.mavlink_map[number].msgname for number in IGNORED_MESSAGES}
    for path in sorted(COMPANION.rglob("*.py")):
        place = path.relative_to(COMPANION).as_posix()
        if not place.startswith(READ_FROM_LOGS_ONLY):
            words = set(re.findall(r"[A-Z][A-Z0-9_]+", path.read_text(encoding="utf-8")))
            words |= {word.removeprefix("MAVLINK_MSG_ID_") for word in words}
            made = re.findall(r"MAVLink_(\w+)_message", path.read_text(encoding="utf-8"))
            words |= {name.upper() for name in made}
            assert not words & names, place


@pytest.mark.parametrize("behind_ms", [0, 10])
def test_another_vehicles_time_does_not_hide_ours(behind_ms: int) -> None:
    """Two in lockstep tell the same times; who listens to both still knows how late it is."""
    session = Session(MISSION, seed=1, lockstep=False)
    session.receive(b"".join(SAID))
    session.run()
    began_ms = round(session.now_s * 1000.0)
    for at_ms in range(began_ms + 200, began_ms + 2_000, 200):
        for system, told_ms in ((7, at_ms - behind_ms), (1, at_ms)):
            sender = wire.MAVLink(None, srcSystem=system, srcComponent=1)
            attitude = wire.MAVLink_attitude_message(told_ms, 0, 0, 0, 0, 0, 0)
            session.receive(attitude.pack(sender))
        session.run()
        assert session.now_s == pytest.approx(at_ms * 1e-3)


@pytest.mark.parametrize(("rate_hz", "read"), [(100, 20), (50, 17), (20, 20), (4, 4), (1, 1)])
def test_the_time_is_read_of_at_most_twenty_attitudes_a_second(rate_hz: int, read: int) -> None:
    clock = VehicleClock(0.0)
    times_ms = [round(k * 1000 / rate_hz) + 5000 for k in range(10 * rate_hz)]
    needed = [at_ms for at_ms in times_ms if clock.is_newer(wire.MAVLINK_MSG_ID_ATTITUDE, at_ms)]
    assert len(needed) == pytest.approx(10 * read, abs=4)
    assert min((b - a for a, b in pairwise(needed)), default=1000) >= 50
    assert clock.is_newer(wire.MAVLINK_MSG_ID_ATTITUDE, 10)  # it has begun again


READ = ClockReading
"""Short, for the table below."""


@pytest.mark.parametrize(
    ("stamps_s", "last"),
    [
        ((1060.0,), READ.DOUBTED),
        ((1060.0, 60.1), READ.LATER),  # the clock goes on where it was
        ((1060.0, 60.1, 1060.1), READ.DOUBTED),  # one that leaps now and then is never believed
        ((1060.0, 1060.0), READ.DOUBTED),  # copies of one frame, or messages of one moment
        ((1060.0, 5.0), READ.DOUBTED),
        ((1060.0, 2_000.0), READ.DOUBTED),
        ((1060.0, 1060.1), READ.LATER),  # two agree: so it is
        ((5.0,), READ.DOUBTED),
        ((5.0, 60.1), READ.LATER),
        ((5.0, 5.0), READ.DOUBTED),
        ((5.0, 5.1), READ.REBOOTED),
        ((61.9,), READ.LATER),
    ],
)
def test_a_clock_that_leaps_is_doubted_like_one_that_falls(
    stamps_s: tuple[float, ...], last: ClockReading
) -> None:
    clock = VehicleClock(0.0)
    assert clock.read(60.0) is READ.FIRST
    told = [(clock.believes(stamp_s), clock.read(stamp_s)) for stamp_s in stamps_s]
    assert told[-1][1] is last
    assert all(believed is (reading is not READ.DOUBTED) for believed, reading in told)


def test_a_leap_that_the_silence_or_the_arrival_explains_is_believed_at_once() -> None:
    arrived, silent = VehicleClock(0.0), VehicleClock(0.0)
    for clock in (arrived, silent):
        clock.read(60.0, 7.0)
    assert arrived.read(90.0, 37.0) is READ.LATER  # a gap in a log, or a slow stream
    assert arrived.read(97.0, 38.0) is READ.DOUBTED
    silent.on_silence(30.0, counts=True)
    assert silent.read(90.0) is READ.LATER
    assert silent.read(97.0) is READ.DOUBTED
