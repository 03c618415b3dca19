"""A log played to a ground station: over real UDP to pymavlink, and to the microsecond without."""

import math
import socket
import struct
import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from programs import free_port
from pymavlink.dialects.v20 import all as wire

from companion.errors import InputError
from companion.replay.playback import PlaybackSettings, PlaybackStats, Player, play_file
from companion.runtime.link import open_link
from companion.telemetry.logs import Record, open_log

EPOCH_US = 1_790_000_000_000_000
PATIENCE_S = 20.0


def frames(count: int, *, period_s: float = 0.1, version_1: bool = False) -> list[Record]:
    """A vehicle (1/1), its companion (1/195) and a ground station (255/190), in turns."""
    who = ((1, 1, 2, 3), (1, 195, 18, 8), (255, 190, 6, 8))
    codecs = [wire.MAVLink(None, srcSystem=system, srcComponent=part) for system, part, *_ in who]
    found = []
    for number in range(count):
        kind, autopilot = who[number % 3][2:]
        message = wire.MAVLink_heartbeat_message(kind, autopilot, 0, number, 4, 3)
        codec = codecs[number % 3]
        frame = bytes(message.pack(codec, force_mavlink1=version_1))
        codec.seq = (codec.seq + 1) % 256
        found.append(Record(EPOCH_US + round(number * period_s * 1e6), frame))
    return found


def tlog(path: Path, records: list[Record]) -> Path:
    path.write_bytes(b"".join(struct.pack(">Q", each.time_us) + each.frame for each in records))
    return path


# --- without a wall clock: a link that takes as long as it is told


class TimedLink:
    """Passes the time, and notes when each frame was sent."""

    def __init__(self, *, oversleeps_s: float = 0.0, slow_s: float = 0.0) -> None:
        self.now_s = 1000.0
        self.sent: list[tuple[float, bytes]] = []
        self._oversleeps_s, self._slow_s = oversleeps_s, slow_s

    def clock(self) -> float:
        return self.now_s

    def receive(self, timeout_s: float) -> bytes | None:
        assert timeout_s > 0.0
        self.now_s += timeout_s + self._oversleeps_s
        return b"an answer"

    def send(self, batch: list[bytes]) -> None:
        self.sent += [(self.now_s, frame) for frame in batch]
        self.now_s += self._slow_s

    def play(self, records: list[Record], **playing: Any) -> PlaybackStats:
        player = Player(self, self.clock, lambda _: None)  # type: ignore[arg-type]
        return player.play(records, PlaybackSettings(**playing))

    @property
    def times_s(self) -> list[float]:
        return [at_s - 1000.0 for at_s, _ in self.sent]

    @property
    def bytes(self) -> list[bytes]:
        return [frame for _, frame in self.sent]


@given(
    steps_us=st.lists(st.integers(0, 3_000_000), min_size=1, max_size=60),
    speed=st.sampled_from([0.1, 0.7, 1.0, 3.0, 10.0]),
    oversleeps_s=st.sampled_from([0.0, 0.0007]),
)
def test_every_frame_is_sent_when_it_is_due_and_nothing_adds_up(
    steps_us: list[int], speed: float, oversleeps_s: float
) -> None:
    at_us, records = EPOCH_US, []
    for number, step_us in enumerate(steps_us):
        at_us += step_us
        records.append(Record(at_us, bytes([number]) * 20))
    link = TimedLink(oversleeps_s=oversleeps_s)
    played = link.play(records, speed=speed)
    assert link.bytes == [each.frame for each in records]
    assert played.frames == len(records)
    assert played.bytes == 20 * len(records)
    for at_s, record in zip(link.times_s, records, strict=True):
        due_s = (record.time_us - records[0].time_us) * 1e-6 / speed
        assert -0.001001 <= at_s - due_s <= oversleeps_s + 20 * len(records) / 0.5e6 + 1e-6


def test_a_delay_on_the_way_delays_no_later_frame() -> None:
    link = TimedLink(slow_s=0.35)  # longer than three frames
    link.play(frames(100))
    assert len(link.sent) == 100
    assert max(at_s - 0.1 * k for k, at_s in enumerate(link.times_s)) < 0.36


@pytest.mark.parametrize(
    ("from_s", "until_s"), [(0.0, 5.0), (3.0, 7.05), (2.95, math.inf), (9.9, 9.91)]
)
def test_a_part_begins_and_ends_at_the_very_frame(from_s: float, until_s: float) -> None:
    records, link = frames(100), TimedLink()
    link.play(records, from_s=from_s, until_s=until_s)
    times = [round((each.time_us - EPOCH_US) * 1e-6, 6) for each in records]
    expected = [r for r, at_s in zip(records, times, strict=True) if from_s <= at_s < until_s]
    assert expected
    assert link.bytes == [each.frame for each in expected]
    assert link.times_s[0] == pytest.approx(0.0, abs=1e-9)  # at once, not after from_s
    assert link.times_s[-1] == pytest.approx((len(expected) - 1) * 0.1, abs=1e-6)


def test_the_frames_of_the_vehicle_alone() -> None:
    records, link = frames(90), TimedLink()
    link.play(records, only_vehicle=1)
    assert link.bytes == [each.frame for each in records[::3]]
    assert link.times_s == pytest.approx([0.3 * k for k in range(30)], abs=1e-6)


def test_frames_of_the_first_protocol_are_told_apart_too() -> None:
    records, link = frames(30, version_1=True), TimedLink()
    link.play(records, only_vehicle=1)
    assert link.bytes == [each.frame for each in records[::3]]


def test_long_gaps_are_shortened_and_said() -> None:
    records = frames(40)
    late = [Record(r.time_us + 3_600_000_000 * (k >= 20), r.frame) for k, r in enumerate(records)]
    link = TimedLink()
    played = link.play(late)
    assert link.bytes == [each.frame for each in records]
    assert link.times_s[20] - link.times_s[19] == pytest.approx(10.0, abs=1e-6)
    assert link.times_s[39] - link.times_s[20] == pytest.approx(1.9, abs=1e-6)
    assert played.gaps == [pytest.approx((1.9, 3600.1))]
    assert played.words == ["at 1.9 s: a gap of 3600.1 s was shortened"]


def test_many_gaps_are_said_in_a_few_lines() -> None:
    played = TimedLink().play(frames(30, period_s=60.0))
    assert len(played.gaps) == 29
    assert len(played.words) == 6
    assert played.words[-1] == "24 more gaps were shortened"


def test_as_fast_as_possible_is_no_faster_than_a_ground_station_can_read() -> None:
    records, link = frames(10_000, period_s=0.001), TimedLink()
    played = link.play(records, speed=1000.0)
    assert link.bytes == [each.frame for each in records]
    assert played.bytes / link.times_s[-1] == pytest.approx(0.5e6, rel=0.02)
    batches = len(set(link.times_s))  # small datagrams would fill a receiver's buffer
    assert batches < 10_000 / 15


def test_nothing_to_play() -> None:
    assert TimedLink().play([]).frames == 0
    assert TimedLink().play(frames(10), from_s=100.0).frames == 0


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"speed": 0.01}, "--speed = 0.01: it must be from 0.1 to 1000"),
        ({"speed": 1e6}, "--speed"),
        ({"speed": math.nan}, "--speed"),
    ],
    ids=str,
)
def test_what_is_wrong_is_said_in_one_line(wrong: dict[str, float], words: str) -> None:
    with pytest.raises(InputError) as caught:
        PlaybackSettings(**wrong)
    assert str(caught.value).startswith(words)
    assert "\n" not in str(caught.value)


# --- over real UDP


class Station:
    """A ground station: pymavlink's parser behind a socket, with the time of each message."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(PATIENCE_S)
        self.port = self.socket.getsockname()[1]
        self.heard: list[tuple[float, Any]] = []
        self._wanted = 0
        self._there = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)

    def expect(self, count: int) -> None:
        self._wanted = count
        self._thread.start()

    def _listen(self) -> None:
        parser = wire.MAVLink(None)
        while len(self.heard) < self._wanted:
            try:
                data = self.socket.recv(65536)
            except TimeoutError:
                return  # wait() says what is missing
            now_s = time.monotonic()
            self.heard += [(now_s, each) for each in parser.parse_buffer(data) or ()]
        self._there.set()

    def wait(self) -> list[tuple[float, Any]]:
        assert self._there.wait(PATIENCE_S), f"{len(self.heard)} of {self._wanted} messages"
        return self.heard


@pytest.fixture
def station() -> Iterator[Station]:
    it = Station()
    yield it
    it.socket.close()


def test_a_ground_station_hears_every_frame_in_order_and_at_its_time(
    station: Station, tmp_path: Path
) -> None:
    """300 frames, 30 s of the log at x10: as recorded, byte for byte."""
    records = frames(300)
    file = tlog(tmp_path / "flight.tlog", records)
    station.expect(300)
    played = play_file(file, f"udpout:127.0.0.1:{station.port}", PlaybackSettings(speed=10.0))
    heard = station.wait()
    assert [bytes(m.get_msgbuf()) for _, m in heard] == [each.frame for each in records]
    assert played.frames == 300
    began_s = heard[0][0]
    late = sorted(at_s - began_s - 0.01 * k for k, (at_s, _) in enumerate(heard))
    assert late[0] > -0.05  # the first one was as late as this
    assert late[150] < 0.05
    assert late[-1] < 1.0  # however busy this computer is
    assert 2.9 < played.wall_s < 4.5


def test_as_fast_as_possible_and_both_ways_or_one(station: Station, tmp_path: Path) -> None:
    file = tlog(tmp_path / "flight.tlog", frames(3000))
    station.expect(1000)
    connect = f"udpout:127.0.0.1:{station.port}"
    play_file(file, connect, PlaybackSettings(speed=1000.0), only_vehicle=True)
    senders = {(m.get_srcSystem(), m.get_srcComponent()) for _, m in station.wait()}
    assert senders == {(1, 1)}
    assert [m.custom_mode for _, m in station.heard] == list(range(0, 3000, 3))


def test_a_part_of_a_log(station: Station, tmp_path: Path) -> None:
    file = tlog(tmp_path / "flight.tlog", frames(600))
    station.expect(50)
    playing = PlaybackSettings(speed=100.0, from_s=20.0, until_s=25.0)
    played = play_file(file, f"udpout:127.0.0.1:{station.port}", playing)
    assert [m.custom_mode for _, m in station.wait()] == list(range(200, 250))
    assert played.at_s == pytest.approx(24.9)


def test_a_ground_station_that_calls_is_waited_for(tmp_path: Path) -> None:
    """udpin: nobody is there until it says something; what it says later is read and dropped."""
    log = open_log(tlog(tmp_path / "flight.tlog", frames(60)))
    port = free_port()
    with open_link(f"udpin:127.0.0.1:{port}") as link:
        player = Player(link, time.monotonic, lambda _: None)
        station = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        station.settimeout(PATIENCE_S)
        waiting = threading.Thread(target=player.wait_for_somebody)
        waiting.start()
        station.sendto(b"\xfd hello", ("127.0.0.1", port))
        waiting.join(PATIENCE_S)
        assert not waiting.is_alive()
        for _ in range(20):
            station.sendto(bytes(1000), ("127.0.0.1", port))
        player.play(log.records(), PlaybackSettings(speed=100.0))
        heard: list[Any] = []
        parser = wire.MAVLink(None)
        while len(heard) < 60:
            heard += parser.parse_buffer(station.recv(65536)) or ()
        station.close()
    assert all(a.custom_mode + 1 == b.custom_mode for a, b in pairwise(heard))


def test_a_log_with_nothing_in_that_part_is_refused(
    station: Station, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tlog(tmp_path / "flight.tlog", frames(10))
    with pytest.raises(InputError, match=r"--from = 100\.0: no frame of the log lies there"):
        play_file(file, f"udpout:127.0.0.1:{station.port}", PlaybackSettings(from_s=100.0))
    assert capsys.readouterr().err == ""  # no line of a bar before the error


def test_a_log_without_a_vehicle_has_none_to_play_alone(station: Station, tmp_path: Path) -> None:
    file = tlog(tmp_path / "flight.tlog", frames(9)[2::3] * 3)
    with pytest.raises(InputError, match="--only-vehicle = True: the log has no autopilot in it"):
        play_file(file, f"udpout:127.0.0.1:{station.port}", PlaybackSettings(), only_vehicle=True)
