"""Parts of the companion are killed and blocked for real, in real time (design 7, last row)."""

import ctypes
import io
import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from stub_session import (
    HEARTBEAT,
    HOLD,
    PATIENCE_S,
    SETPOINT,
    QueueLink,
    StubSession,
    as_any,
    request_of,
)

from companion.mavlink.link import Output
from companion.mission.events import End, Outcome
from companion.planner.request import PlanRequest
from companion.runtime import loop, planner_process, recorder, watchdog
from companion.runtime.compiler import load_libraries
from companion.runtime.planner_process import PlannerProcess
from companion.telemetry.flight_summary import FlightSummary
from companion.telemetry.run_folder import RunFolder

BAR_S = 0.3
PERIOD_S = 0.02


class Rig:
    """A flight whose vehicle speaks at 50 Hz until the test has seen enough."""

    def __init__(self, folder: RunFolder, session: StubSession, **keywords: Any) -> None:
        self.session, self.folder = session, folder
        self.link = QueueLink(time.monotonic)
        self.flown: FlightSummary | None = None
        self.broken_s = float("inf")
        self._over = threading.Event()
        self._keywords = {"planner": lambda _request, _stop: "planned", **keywords}
        self._flight = threading.Thread(target=self._fly)
        self._vehicle = threading.Thread(target=self._speak)

    def _fly(self) -> None:
        self.flown = loop.fly(
            as_any(self.session),
            self.link,
            self.folder,
            **{
                "lockstep": False,
                "on_progress": lambda _: None,
                "stop_asked": self._over.is_set,
                **self._keywords,
            },
        )

    def _speak(self) -> None:
        while not self._over.wait(PERIOD_S):
            self.link.incoming.put(b"position")

    def breaks_now(self) -> None:
        self.broken_s = time.monotonic()

    @contextmanager
    def flying(self) -> Iterator[None]:
        load_libraries()  # as `fly` would, while what the vehicle says piles up
        self._flight.start()
        self._vehicle.start()
        try:
            self.streams_on(5)
            yield
        finally:
            self._over.set()
            self._flight.join(PATIENCE_S)
            self._vehicle.join()
        assert not self._flight.is_alive()

    def streams_on(self, count: int = 20) -> None:
        """For so many setpoints more."""
        before = len(self.link.times_of(SETPOINT))
        self.link.wait_until(lambda: len(self.link.times_of(SETPOINT)) > before + count)

    def wait_for_the_end(self) -> End:
        self._flight.join(PATIENCE_S)
        assert self.flown is not None
        assert self.flown.end is not None
        return self.flown.end

    def journal(self) -> list[Any]:
        lines = (self.folder.path / "journal.jsonl").read_text("utf-8").splitlines()
        return [json.loads(line) for line in lines]


@pytest.fixture(autouse=True)
def _hold_is_repeated_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watchdog, "_HOLD_AGAIN_S", (0.0, 0.05, 0.05))


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[RunFolder]:
    with RunFolder(tmp_path / "run", mission_toml="", epoch_us=0) as folder:
        yield folder


def assert_held(rig: Rig, part: str, error: str) -> None:
    """The stream and the heartbeats stopped in time, and the autopilot was told to hold."""
    end = rig.wait_for_the_end()
    assert end.outcome is Outcome.FAILED
    assert part in end.reason
    for frame in (SETPOINT, HEARTBEAT):
        assert rig.link.times_of(frame)[-1] - rig.broken_s < BAR_S
    holds_s = rig.link.times_of(HOLD)
    assert len(holds_s) == 3
    assert holds_s[0] - rig.broken_s < BAR_S
    assert rig.link.sent[-1][1] == HOLD
    [noted] = [entry for entry in rig.journal() if entry["kind"] == "part died"]
    assert noted["part"] == part
    assert error in noted["error"]
    assert HOLD in (rig.folder.path / "flight.tlog").read_bytes()


def asks_at(session: StubSession, number: int, wanted: int) -> None:
    if number == wanted:
        session.ask(request_of(1))


def test_a_planner_that_raises(folder: RunFolder) -> None:
    session = StubSession(lambda session, number: asks_at(session, number, 10))

    def broken(*_: object) -> Any:
        rig.breaks_now()
        raise ZeroDivisionError("made up")

    rig = Rig(folder, session, planner=broken)
    with rig.flying():
        assert_held(rig, "planner", "ZeroDivisionError: made up")
    assert [part for part, _ in session.died] == ["planner"]


def test_a_planner_whose_process_is_killed_while_nobody_asks_it_anything(folder: RunFolder) -> None:
    planner = PlannerProcess()
    rig = Rig(folder, StubSession(), planner=planner)
    with rig.flying():
        rig.link.wait_until(lambda: planner.is_ready)
        rig.breaks_now()
        assert planner.pid is not None
        os.kill(planner.pid, signal.SIGKILL)
        assert_held(rig, "planner", "its process has ended (SIGKILL)")


def test_a_planner_that_stands_still_is_dead_some_time_after_its_time(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An endless loop that computes: it must not take the others' share of the interpreter."""
    slack_s = 0.3
    monkeypatch.setattr(planner_process, "_SLACK_S", slack_s)
    over = threading.Event()

    def endless(request: PlanRequest, _stop: object) -> Any:
        rig.broken_s = time.monotonic() + request.task.settings.planning_time_s + slack_s
        while not over.is_set():
            pass

    rig = Rig(folder, StubSession(lambda s, n: asks_at(s, n, 10)), planner=endless)
    with rig.flying():
        assert_held(rig, "planner", "stood still")
    over.set()
    assert max(gaps_s(rig.link)) < BAR_S
    assert rig.link.times_of(SETPOINT)[-1] > rig.broken_s - 0.2  # until then it streamed


def test_of_two_plans_that_are_asked_for_only_the_newer_counts(folder: RunFolder) -> None:
    def named(request: PlanRequest, stop: Callable[[], bool]) -> Any:
        if request.plan_id == 1:
            rig.link.wait_until(stop)  # it is told to stop as soon as nobody waits for it
        return request.plan_id

    def asks(session: StubSession, number: int) -> None:
        if number in (10, 12):
            session.ask(request_of(1 if number == 10 else 2, planning_time_s=1000.0))

    session = StubSession(asks)
    rig = Rig(folder, session, planner=named)
    with rig.flying():
        rig.link.wait_until(lambda: bool(session.delivered))
    assert session.delivered == [2]


@pytest.mark.parametrize(
    ("what", "raises", "lockstep"),
    [
        *(("session", True, lockstep) for lockstep in (False, True)),
        *(("link", raises, False) for raises in (True, False)),
        ("session", False, False),
    ],
)
def test_a_link_or_a_session_that_raises_or_never_comes_back(
    folder: RunFolder, what: str, raises: bool, lockstep: bool
) -> None:
    error, released = OSError("made up"), threading.Event()

    def breaks(_session: StubSession, number: int) -> None:
        if what == "session" and number == 20:
            rig.breaks_now()
            if raises:
                raise error
            released.wait()

    rig = Rig(folder, session := StubSession(breaks), lockstep=lockstep)
    with rig.flying():
        if what == "link":
            rig.breaks_now()
            rig.link.incoming.put(error if raises else released)
        assert_held(rig, "decider", "OSError: made up" if raises else "stood still")
        sent = len(rig.link.sent)
        released.set()  # what it says now leaves no more
    assert len(rig.link.sent) == sent
    assert not (what == "session" and raises and session.died)


def test_a_setpoint_that_took_too_long_is_not_sent(folder: RunFolder) -> None:
    """The decider holds the interpreter for 0.7 s: nobody can stop it meanwhile, or tell."""

    def hangs(session: StubSession, number: int) -> None:
        if number == 20:
            took_s.append(session.arrived_s[-1])
            ctypes.PyDLL(None).usleep(700_000)

    took_s: list[float] = []
    rig = Rig(folder, StubSession(hangs))
    with rig.flying():
        rig.link.wait_until(lambda: len(rig.session.received) > 40)
    assert rig.link.times_of(HOLD) == []
    sent_s = next(at_s for at_s in rig.link.times_of(SETPOINT) if at_s > took_s[0])
    assert any(took_s[0] < at_s <= sent_s for at_s in rig.session.arrived_s)  # it answers that one


def test_a_session_that_cannot_even_say_hold_has_said_it_before(folder: RunFolder) -> None:
    class Broken(StubSession):
        is_broken = False

        def hold_frames(self) -> list[bytes]:
            if self.is_broken:
                raise RuntimeError("made up")
            return super().hold_frames()

    def breaks(session: StubSession, number: int) -> None:
        if number == 20:
            rig.breaks_now()
            as_any(session).is_broken = True
            raise KeyError("made up")

    rig = Rig(folder, Broken(breaks))
    with rig.flying():
        assert_held(rig, "decider", "KeyError")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_watchdog_that_has_died_itself(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_watchdog: object, _elapsed_s: float) -> None:
        if rig.broken_s < time.monotonic():
            raise MemoryError("made up")

    monkeypatch.setattr(watchdog.Watchdog, "_look", broken)
    rig = Rig(folder, StubSession())
    with rig.flying():
        rig.breaks_now()
        assert_held(rig, "watchdog", "its thread has ended")


def test_a_hold_that_does_not_get_out_is_tried_again(folder: RunFolder) -> None:
    class Failing(QueueLink):
        tries = 0

        def send(self, frames: list[bytes]) -> None:
            if HOLD in frames:
                self.tries += 1
                if self.tries == 1:
                    raise OSError("made up")
            super().send(frames)

    rig = Rig(folder, StubSession())
    rig.link = Failing(time.monotonic)
    with rig.flying():
        rig.link.incoming.put(KeyError("made up"))
        assert rig.wait_for_the_end().outcome is Outcome.FAILED
    assert len(rig.link.times_of(HOLD)) == 2


def test_nothing_is_streamed_while_nobody_is_heard_and_a_slow_start_is_no_death(
    folder: RunFolder,
) -> None:
    """Before the stream a part may take its time: a computer that starts up is busy."""

    def slow_start(_session: StubSession, number: int) -> None:
        if number == 1:
            threading.Event().wait(0.6)

    rig = Rig(folder, StubSession(slow_start))
    with rig.flying():
        pass
    assert rig.wait_for_the_end().outcome is Outcome.STOPPED


# --- the disk: a flight goes on without it


def test_a_disk_that_blocks_does_not_delay_the_stream_and_is_told_of_once(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The log is a pipe that nobody reads: full after 64 KiB."""
    monkeypatch.setattr(recorder, "_DISK_S", 0.3)
    monkeypatch.setattr(recorder, "_LEAVE_S", 0.3)
    session = StubSession(fills_the_pipe)
    rig = Rig(folder, session)
    reading, writing = os.pipe()
    with open(writing, "wb", buffering=0) as blocked:  # noqa: PTH123 - a descriptor
        folder.close()
        monkeypatch.setitem(folder._files, "flight.tlog", blocked)
        with rig.flying():
            rig.link.wait_until(lambda: bool(session.stopped))
            rig.streams_on()
        assert folder.failure == "the disk does not answer"
        os.close(reading)  # the writer's call returns
        for writer in [each for each in threading.enumerate() if each.name == "writer"]:
            writer.join(PATIENCE_S)
            assert not writer.is_alive()
    assert len(session.stopped) == 1
    assert "stood still" in session.stopped[0]
    assert rig.link.times_of(HOLD) == []
    assert max(gaps_s(rig.link)) < BAR_S


def gaps_s(link: QueueLink) -> list[float]:
    """Between one setpoint and the next."""
    return [after - before for before, after in pairwise(link.times_of(SETPOINT))]


def fills_the_pipe(session: StubSession, _number: int) -> None:
    session.out.record += [(session.now_s, bytes(280))] * 50


@pytest.mark.parametrize("what", ["full", "odd"])
def test_a_disk_that_is_full_or_an_entry_that_cannot_be_written_ends_the_recording_alone(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    def breaks(session: StubSession, number: int) -> None:
        if number == 10 and what == "full":
            full = as_any(FullFile(folder._files["flight.tlog"]))
            monkeypatch.setitem(folder._files, "flight.tlog", full)
        elif number == 10:
            session.out.journal.append({"t_s": 1.0, "kind": "odd", "value": object()})

    session = StubSession(breaks)
    rig = Rig(folder, session)
    with rig.flying():
        rig.link.wait_until(lambda: bool(session.stopped))
        rig.streams_on()
    [told] = session.stopped
    assert told.startswith("No space left on device" if what == "full" else "TypeError")
    assert rig.link.times_of(HOLD) == []
    assert rig.wait_for_the_end().outcome is Outcome.STOPPED


def test_a_folder_that_is_moved_away_is_told_of_once_and_what_grows_is_recorded_there(
    folder: RunFolder, tmp_path: Path
) -> None:
    def moves(session: StubSession, number: int) -> None:
        if number == 10:
            folder.path.rename(tmp_path / "moved")
        session.out.checkpoint = {"number": number}
        session.out.journal.append({"t_s": session.now_s, "kind": "x"})

    session = StubSession(moves)
    rig = Rig(folder, session)
    with rig.flying():
        rig.link.wait_until(lambda: bool(session.complaints))
        size = (tmp_path / "moved" / "journal.jsonl").stat().st_size
        rig.streams_on()
    assert session.complaints == ["state for --resume is lost: No such file or directory"]
    assert session.stopped == rig.link.times_of(HOLD) == []
    assert (tmp_path / "moved" / "journal.jsonl").stat().st_size > size


class FullFile:
    """A file on a full disk."""

    def __init__(self, file: io.FileIO) -> None:
        self.close = file.close

    def write(self, _data: bytes) -> int:
        raise OSError(28, "No space left on device")

    def seek(self, *_: object) -> int:
        return 0

    tell = truncate = seek


def test_what_waits_for_a_slow_disk_has_an_end(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "_MOST_WAITING", 100_000)
    monkeypatch.setattr(recorder, "_LEAVE_S", 0.1)
    released = threading.Event()
    writes = recorder.Recorder(folder, time.monotonic, lambda _failure: None)
    monkeypatch.setattr(folder, "frames", lambda _stamped: released.wait())
    writer = recorder.WriterThread(writes)
    thread = threading.Thread(target=writer.run)
    thread.start()
    for _ in range(1000):
        writer.put(Output(record=[(0.0, bytes(1000))]))
    assert folder.failure == "the disk is too slow"
    assert writer._put_bytes <= 101_000
    released.set()
    writer.close()
    thread.join(PATIENCE_S)


# --- in lockstep: nothing depends on the clock, but a death is a death


def test_in_lockstep_nobody_is_dead_for_being_slow(folder: RunFolder) -> None:
    def slow(_session: StubSession, number: int) -> None:
        if number == 20:
            threading.Event().wait(0.6)

    session = StubSession(slow)
    rig = Rig(folder, session, lockstep=True)
    with rig.flying():
        rig.link.wait_until(lambda: len(session.received) > 25)
    assert rig.link.times_of(HOLD) == []
    assert rig.wait_for_the_end().outcome is Outcome.STOPPED
