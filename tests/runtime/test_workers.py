"""Parts of the companion are killed and blocked for real, in real time (design 7, last row)."""

import ctypes
import json
import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import odd_planners
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
from companion.runtime import loop, planner_process, recorder, watchdog
from companion.runtime.compiler import load_libraries
from companion.runtime.planner_process import PlannerHere, PlannerProcess
from companion.runtime.watchdog import Failure
from companion.telemetry.flight_summary import FlightSummary
from companion.telemetry.run_folder import RunFolder

BAR_S = 0.3
PERIOD_S = 0.02
SLACK_S = 0.3
"""Of a planner that stands still."""
BREAKS_AT = 20
"""The datagram at which something happens to the session."""


class Rig:
    """A flight whose vehicle speaks at 50 Hz until the test has seen enough."""

    def __init__(self, folder: RunFolder) -> None:
        self.session, self.folder = StubSession(), folder
        self.request = request_of(1)
        self.link = QueueLink(time.monotonic)
        self.flown: FlightSummary | None = None
        self.broken_s = math.inf
        self.raised: BaseException | None = None
        self.options: dict[str, Any] = {
            "on_progress": lambda _: None,
            "lockstep": False,
            "planner": PlannerHere(odd_planners.echoes),
        }
        self.released = threading.Event()
        """What has stood still goes on."""
        self._over = threading.Event()
        self.flies, speaks = (threading.Thread(target=each) for each in (self._fly, self._speak))
        self._threads = [self.flies, speaks]

    def _fly(self) -> None:
        stop = self._over.is_set
        try:
            self.flown = loop.fly(
                as_any(self.session), self.link, self.folder, stop_asked=stop, **self.options
            )
        except BaseException as error:  # noqa: BLE001 - looked at by the test
            self.raised = error

    def _speak(self) -> None:
        while not self._over.wait(PERIOD_S):
            self.link.incoming.put(b"position")

    def breaks_now(self) -> None:
        self.broken_s = time.monotonic()

    def at(self, number: int, does: Callable[[], None]) -> None:
        """What the session does with that datagram."""
        self.session.on_datagram = lambda _session, k: does() if k == number else None

    def asks(self, fails_s: float) -> None:
        """For a plan, of a planner that fails after so long."""
        self.broken_s = time.monotonic() + fails_s
        self.session.ask(self.request)

    @contextmanager
    def flying(self) -> Iterator[None]:
        load_libraries()  # as `fly` would, while what the vehicle says piles up
        for thread in self._threads:
            thread.start()
        try:
            self.streams_on(5)
            yield
        finally:
            self._over.set()
            self.released.set()
            for thread in self._threads:
                thread.join(PATIENCE_S)
        assert not self._threads[0].is_alive()

    def streams_on(self, count: int = 20) -> None:
        """For so many setpoints more."""
        before = len(self.link.times_of(SETPOINT))
        self.link.wait_until(lambda: len(self.link.times_of(SETPOINT)) > before + count)

    @property
    def end(self) -> End:
        self._threads[0].join(PATIENCE_S)
        assert self.flown is not None
        assert self.flown.end is not None
        return self.flown.end

    @property
    def longest_gap_s(self) -> float:
        """Between one setpoint and the next."""
        return max(after - before for before, after in pairwise(self.link.times_of(SETPOINT)))


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[RunFolder]:
    with RunFolder(tmp_path / "run", mission_toml="", epoch_us=0) as folder:
        yield folder


@pytest.fixture
def rig(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> Rig:
    monkeypatch.setattr(watchdog, "_HOLD_AGAIN_S", (0.0, 0.05, 0.05))
    monkeypatch.setattr(planner_process, "_SLACK_S", SLACK_S)
    return Rig(folder)


# --- deaths: how each comes about in a flight, and what is said of it


def breaks(rig: Rig, error: Exception) -> None:
    rig.breaks_now()
    raise error


def session_raises(rig: Rig) -> str:
    rig.at(BREAKS_AT, lambda: breaks(rig, OSError("made up")))
    return "OSError: made up"


def session_raises_and_cannot_even_say_hold(rig: Rig) -> str:
    """It has said it before."""

    def does() -> None:
        rig.session.hold_frames = None  # type: ignore[assignment, method-assign]
        breaks(rig, KeyError("made up"))

    rig.at(BREAKS_AT, does)
    return "KeyError"


def session_stands_still(rig: Rig) -> str:
    def stops() -> None:
        rig.breaks_now()
        rig.released.wait()

    rig.at(BREAKS_AT, stops)
    return "stood still"


@pytest.mark.parametrize(
    ("death", "lockstep"),
    [
        *((session_raises, lockstep) for lockstep in (False, True)),
        *((session_raises_and_cannot_even_say_hold, False), (session_stands_still, False)),
    ],
)
def test_once_it_has_died_nothing_more_is_streamed_and_the_vehicle_is_told_to_hold(
    rig: Rig, death: Callable[[Rig], str], lockstep: bool
) -> None:
    """The stream and the heartbeats stop in time; in lockstep nothing depends on the clock."""
    error, rig.options["lockstep"] = death(rig), lockstep
    with rig.flying():
        assert rig.end.outcome is Outcome.FAILED
        assert "decider" in rig.end.reason
        sent = len(rig.link.sent)
        rig.released.set()  # what it says now leaves no more
    assert len(rig.link.sent) == sent
    assert error == "stood still" or rig.session.died == []  # it cannot be told
    for frame in (SETPOINT, HEARTBEAT):
        assert rig.link.times_of(frame)[-1] - rig.broken_s < BAR_S
    holds_s = rig.link.times_of(HOLD)
    assert len(holds_s) == 3
    assert holds_s[0] - rig.broken_s < BAR_S
    assert rig.link.sent[-1][1] == HOLD
    lines = (rig.folder.path / "journal.jsonl").read_text("utf-8").splitlines()
    [noted] = [each for each in map(json.loads, lines) if each["kind"] == "part died"]
    assert noted["part"] == "decider"
    assert error in noted["error"]
    assert HOLD in (rig.folder.path / "flight.tlog").read_bytes()


def planner_raises(rig: Rig) -> str:
    rig.options["planner"] = PlannerProcess(odd_planners.raises, odd_planners.nothing)
    rig.at(10, lambda: rig.asks(0.0))
    return "ZeroDivisionError: made up"


def planner_stands_still(rig: Rig) -> str:
    rig.options["planner"] = PlannerProcess(odd_planners.never_ends, odd_planners.nothing)
    rig.at(10, lambda: rig.asks(0.5 + SLACK_S))
    return "it has stood still"


def planner_is_killed(rig: Rig) -> str:
    """Its process, while nobody asks it anything."""
    planner = rig.options["planner"] = PlannerProcess(odd_planners.echoes, odd_planners.nothing)

    def kill() -> None:
        rig.breaks_now()
        assert planner.process is not None
        planner.process.kill()

    rig.at(10, kill)
    return "its process has ended (SIGKILL)"


@pytest.mark.parametrize("death", [planner_raises, planner_stands_still, planner_is_killed])
def test_once_its_planner_has_failed_it_says_so_and_ends(
    rig: Rig, death: Callable[[Rig], str]
) -> None:
    error = death(rig)
    with rig.flying():
        assert rig.end.outcome is Outcome.FAILED
    assert rig.session.died == [("planner", error)]
    [hold_s] = rig.link.times_of(HOLD)
    assert hold_s - rig.broken_s < BAR_S
    assert rig.link.times_of(SETPOINT)[-1] <= hold_s
    assert rig.longest_gap_s < BAR_S


def its_clock_fails(rig: Rig) -> type[BaseException]:
    def clock() -> float:
        now_s = time.monotonic()
        if threading.current_thread() is rig.flies and rig.broken_s < now_s:
            raise MemoryError("made up")
        return now_s

    rig.options["clock"] = clock
    return MemoryError


def its_terminal_fails(rig: Rig) -> type[BaseException]:
    def show(_flown: object) -> None:
        if rig.broken_s < time.monotonic():
            raise BrokenPipeError

    rig.options["on_progress"] = show
    return BrokenPipeError


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("fails", [its_clock_fails, its_terminal_fails])
def test_a_watchdog_that_fails_or_cannot_show_ends_the_flight_as_if_stopped_and_raises(
    rig: Rig, fails: Callable[[Rig], type[BaseException]]
) -> None:
    planner = rig.options["planner"] = PlannerProcess(odd_planners.echoes, odd_planners.nothing)
    error = fails(rig)
    with rig.flying():
        rig.breaks_now()
        rig.flies.join(PATIENCE_S)
    assert isinstance(rig.raised, error)
    assert rig.session.has_left
    assert rig.session.died == []
    assert planner.process is not None
    assert not planner.process.is_alive()


def test_a_terminal_that_blocks_does_not_delay_the_stream(rig: Rig) -> None:
    rig.options["on_progress"] = lambda _: rig.released.wait() and None
    with rig.flying():
        rig.streams_on()
    assert rig.longest_gap_s < BAR_S
    assert rig.end.outcome is Outcome.STOPPED


def test_a_hold_that_does_not_get_out_is_tried_again(rig: Rig) -> None:
    fails = [OSError("made up")]

    class Failing(QueueLink):
        def send(self, frames: list[bytes]) -> None:
            if HOLD in frames and fails:
                raise fails.pop()
            super().send(frames)

    rig.link = Failing(time.monotonic)
    with rig.flying():
        rig.link.incoming.put(KeyError("made up"))
        assert rig.end.outcome is Outcome.FAILED
    assert len(rig.link.times_of(HOLD)) == 2


# --- what is no death


@pytest.mark.parametrize(("lockstep", "at"), [(False, 1), (True, BREAKS_AT)])
def test_a_slow_start_is_no_death_nor_a_slow_lockstep(rig: Rig, lockstep: bool, at: int) -> None:
    """Before the stream a part may take its time: a computer that starts up is busy."""
    rig.options["lockstep"] = lockstep
    rig.at(at, lambda: threading.Event().wait(0.6) and None)
    with rig.flying():
        rig.link.wait_until(lambda: len(rig.session.received) > BREAKS_AT + 5)
    assert rig.link.times_of(HOLD) == []
    assert rig.end.outcome is Outcome.STOPPED


def test_a_setpoint_that_took_too_long_is_not_sent(rig: Rig) -> None:
    """The decider holds the interpreter for 0.7 s: nobody can stop it meanwhile, or tell."""

    def hangs() -> None:
        took_s.append(rig.session.arrived_s[-1])
        ctypes.PyDLL(None).usleep(700_000)

    took_s: list[float] = []
    rig.at(BREAKS_AT, hangs)
    with rig.flying():
        rig.link.wait_until(lambda: len(rig.session.received) > 2 * BREAKS_AT)
    assert rig.link.times_of(HOLD) == []
    sent_s = next(at_s for at_s in rig.link.times_of(SETPOINT) if at_s > took_s[0])
    assert any(took_s[0] < at_s <= sent_s for at_s in rig.session.arrived_s)  # it answers that one


# --- the disk: a flight goes on without it


def test_what_is_not_recorded_is_told_once(folder: RunFolder, tmp_path: Path) -> None:
    """That the flight goes on without: below, and on a full disk `closed_loop/test_flight`."""
    told = list[Failure]()
    writes = recorder.Recorder(folder, time.monotonic, told.append)
    moved = folder.path.rename(tmp_path / "moved")
    for number in range(3):
        entry = {"t_s": 1.0, "kind": "x"}
        writes.put(Output(checkpoint={"number": number}, journal=[entry]))
    assert told == [Failure("state for --resume", "No such file or directory")]
    assert len((moved / "journal.jsonl").read_text("utf-8").splitlines()) == 3
    for _ in range(2):
        writes.put(Output(journal=[{"t_s": 1.0, "kind": "odd", "value": object()}]))
    assert [failure.part for failure in told[1:]] == [recorder.WRITER]
    assert told[1].error.startswith("TypeError")


def test_a_disk_that_blocks_delays_no_stream(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """The log is a pipe that nobody reads: full after 64 KiB."""
    monkeypatch.setattr(recorder, "_DISK_S", 0.3)
    monkeypatch.setattr(recorder, "_LEAVE_S", 0.3)

    def fills_the_pipe(session: StubSession, _number: int) -> None:
        session.out.record += [(session.now_s, bytes(280))] * 50

    rig.session.on_datagram = fills_the_pipe
    reading, writing = os.pipe()
    with open(writing, "wb", buffering=0) as blocked:  # noqa: PTH123 - a descriptor
        rig.folder.close()
        monkeypatch.setitem(rig.folder._files, "flight.tlog", blocked)
        with rig.flying():
            rig.link.wait_until(lambda: bool(rig.session.complaints))
            rig.streams_on()
        assert rig.folder.failure == "the disk does not answer"
        os.close(reading)  # the writer's call returns
        for writer in [each for each in threading.enumerate() if each.name == "writer"]:
            writer.join(PATIENCE_S)
            assert not writer.is_alive()
    [said] = rig.session.complaints
    assert "stood still" in said
    assert rig.link.times_of(HOLD) == []
    assert rig.longest_gap_s < BAR_S


def test_a_slow_disk_keeps_so_much_waiting(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "_MOST_WAITING", 100_000)
    monkeypatch.setattr(recorder, "_LEAVE_S", 0.1)
    released = threading.Event()
    monkeypatch.setattr(folder, "frames", lambda _stamped: released.wait())
    writes = recorder.Recorder(folder, time.monotonic, lambda _failure: None)
    writer = recorder.WriterThread(writes)
    for _ in range(1000):
        writer.put(Output(record=[(0.0, bytes(1000))]))
    assert folder.failure == "the disk is too slow"
    assert writer._put_bytes <= 101_000
    released.set()
    writer.close()
    assert not writer._thread.is_alive()
