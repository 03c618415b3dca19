"""Parts of the companion are killed and blocked for real, in real time (design 7, last row)."""

import json
import math
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import odd_planners
import pytest
from stub_session import HEARTBEAT, HOLD, PATIENCE_S, SETPOINT, SpeakingLink, StubSession

from companion.mavlink.link import Output
from companion.mission.events import End, Outcome
from companion.runtime import loop, recorder, watchdog
from companion.runtime.compiler import load_libraries
from companion.runtime.planner_process import PlannerHere, PlannerProcess
from companion.runtime.watchdog import Failure
from companion.telemetry.flight_summary import FlightSummary
from companion.telemetry.run_folder import RunFolder

BAR_S = 0.3
BREAKS_AT = 20
"""The datagram at which something happens to the session."""


class Rig:
    """A flight whose vehicle speaks until the test has seen enough."""

    def __init__(self, folder: RunFolder) -> None:
        self.session, self.folder, self.link = StubSession(), folder, SpeakingLink()
        self.options: dict[str, Any] = {"on_progress": lambda _: None, "lockstep": False}
        self.flight = Future[FlightSummary]()
        self.broken_s = math.inf
        self.thread = threading.Thread(target=self._fly, daemon=True)
        self.released = threading.Event()
        """What has stood still goes on."""
        self._over = threading.Event()

    def _fly(self) -> None:
        options: Any = {"planner": PlannerHere(odd_planners.echoes), **self.options}
        session: Any = self.session
        try:
            flown = loop.fly(
                session, self.link, self.folder, stop_asked=self._over.is_set, **options
            )
        except BaseException as error:  # noqa: BLE001 - looked at by the test
            self.flight.set_exception(error)
        else:
            self.flight.set_result(flown)

    def breaks(self, error: Exception | None = None) -> None:
        """From now on; raised, if there is an error."""
        self.broken_s = time.monotonic()
        if error is not None:
            raise error

    def at(self, number: int, does: Callable[[], object]) -> None:
        """What the session does with that datagram."""
        self.session.on_datagram = lambda count: count == number and does()

    def has_planner(self) -> PlannerProcess:
        """In a process of its own."""
        planner = PlannerProcess(odd_planners.echoes, odd_planners.nothing)
        self.options["planner"] = planner
        return planner

    @contextmanager
    def flying(self) -> Iterator[None]:
        load_libraries()  # as `fly` would, while what the vehicle says piles up
        self.thread.start()
        try:
            self.streams_on(5)
            yield
        finally:
            self.released.set()
            self.stops()

    def stops(self) -> None:
        """As a person asks it to."""
        self._over.set()
        self.flight.exception(PATIENCE_S)

    def streams_on(self, count: int = 20) -> None:
        """For so many setpoints more."""
        before = len(self.link.times_of(SETPOINT))
        self.link.wait_until(lambda: len(self.link.times_of(SETPOINT)) > before + count)

    @property
    def end(self) -> End:
        end = self.flight.result(PATIENCE_S).end
        assert end is not None
        return end

    def assert_no_gap(self) -> None:
        """Between one setpoint and the next."""
        sent_s = self.link.times_of(SETPOINT)
        assert max(after - before for before, after in pairwise(sent_s)) < BAR_S


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[RunFolder]:
    with RunFolder(tmp_path / "run", mission_toml="", epoch_us=0) as folder:
        yield folder


@pytest.fixture
def rig(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> Rig:
    monkeypatch.setattr(watchdog, "_HOLD_AGAIN_S", (0.0, 0.05, 0.05))
    return Rig(folder)


# --- deaths: how each comes about in a flight, and what is said of it


def session_raises(rig: Rig) -> str:
    rig.at(BREAKS_AT, lambda: rig.breaks(OSError("made up")))
    return "decider: OSError: made up"


def session_raises_and_cannot_even_say_hold(rig: Rig) -> str:
    """It has said it before."""

    def does() -> None:
        rig.session.hold_frames = None  # type: ignore[assignment, method-assign]
        rig.breaks(KeyError("made up"))

    rig.at(BREAKS_AT, does)
    return "decider: KeyError: 'made up'"


def session_stands_still(rig: Rig) -> str:
    rig.at(BREAKS_AT, lambda: (rig.breaks(), rig.released.wait()))
    return "decider: it has stood still for 0."


def planner_is_killed(rig: Rig) -> str:
    """Its process, while nobody asks it anything."""
    planner = rig.has_planner()

    def kill() -> None:
        rig.breaks()
        assert planner.process is not None
        planner.process.kill()

    rig.at(10, kill)
    return "planner: its process has ended (SIGKILL)"


@pytest.mark.parametrize(
    ("death", "lockstep"),
    [
        *((session_raises, False), (session_raises, True), (session_stands_still, False)),
        *((session_raises_and_cannot_even_say_hold, False), (planner_is_killed, False)),
    ],
)
def test_once_a_part_has_died_nothing_is_streamed_any_more_and_the_vehicle_is_told_to_hold(
    rig: Rig, death: Callable[[Rig], str], lockstep: bool
) -> None:
    """In time, which in lockstep nothing depends on.  The decider's hold is sent three times."""
    (part, _, error), rig.options["lockstep"] = death(rig).partition(": "), lockstep
    with rig.flying():
        assert rig.end.outcome is Outcome.FAILED
        assert part in rig.end.reason
        sent = len(rig.link.sent)
        rig.released.set()  # what it says now leaves no more
    assert len(rig.link.sent) == sent
    holds_s = rig.link.times_of(HOLD)
    assert len(holds_s) == (3 if part == "decider" else 1)
    assert holds_s[0] - rig.broken_s < BAR_S
    for frame in (SETPOINT, HEARTBEAT):
        assert rig.link.times_of(frame)[-1] - rig.broken_s < BAR_S
    rig.assert_no_gap()
    lines = (rig.folder.path / "journal.jsonl").read_text("utf-8").splitlines()
    noted = [each for each in map(json.loads, lines) if each["kind"] == "part died"]
    assert [each["part"] for each in noted] == [part]
    assert noted[0]["error"].startswith(error)
    assert HOLD in (rig.folder.path / "flight.tlog").read_bytes()


def terminal_fails(rig: Rig) -> type[Exception]:
    def show(_flown: object) -> None:
        if rig.broken_s < time.monotonic():
            raise BrokenPipeError

    rig.options["on_progress"] = show
    return BrokenPipeError


def clock_fails(rig: Rig) -> type[Exception]:
    """In the thread of the watchdog."""

    def clock() -> float:
        now_s, thread = time.monotonic(), threading.current_thread()
        if thread is rig.thread and rig.broken_s < now_s:
            raise MemoryError("made up")
        return now_s

    rig.options["clock"] = clock
    return MemoryError


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("fails", [terminal_fails, clock_fails])
def test_a_watchdog_that_fails_or_cannot_show_ends_the_flight_as_if_stopped_and_raises(
    rig: Rig, fails: Callable[[Rig], type[Exception]]
) -> None:
    planner, error = rig.has_planner(), fails(rig)
    with rig.flying():
        rig.breaks()
        assert isinstance(rig.flight.exception(PATIENCE_S), error)
    assert rig.session.has_left
    assert rig.link.times_of(HOLD) == []
    assert planner.process is not None
    assert not planner.process.is_alive()


def test_a_hold_that_does_not_get_out_is_tried_again(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    fails, send = [OSError("made up")], rig.link.send

    def sends(frames: list[bytes]) -> None:
        if HOLD in frames and fails:
            raise fails.pop()
        send(frames)

    monkeypatch.setattr(rig.link, "send", sends)
    rig.at(BREAKS_AT, lambda: rig.breaks(KeyError("made up")))
    with rig.flying():
        assert rig.end.outcome is Outcome.FAILED
    assert len(rig.link.times_of(HOLD)) == 2


# --- what is no death


@pytest.mark.parametrize(("lockstep", "at"), [(False, 1), (True, BREAKS_AT)])
def test_a_slow_start_is_no_death_nor_is_a_slow_lockstep_or_a_terminal_that_blocks(
    rig: Rig, lockstep: bool, at: int
) -> None:
    """Before the stream a part may take its time: a computer that starts up is busy."""
    rig.options |= {"lockstep": lockstep, "on_progress": lambda _: rig.released.wait() and None}
    rig.at(at, lambda: threading.Event().wait(0.6))
    with rig.flying():
        rig.link.wait_until(lambda: len(rig.session.received) > BREAKS_AT + 5)
    assert rig.link.times_of(HOLD) == []
    assert rig.end.outcome is Outcome.STOPPED


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


def test_what_must_outlive_the_process_is_kept_every_half_minute_and_at_the_end(
    folder: RunFolder,
) -> None:
    now_s, kept_s = [0.0], list[float]()
    writes = recorder.Recorder(
        folder, lambda: now_s[0], lambda _: None, lambda: kept_s.append(now_s[0])
    )
    for _ in range(700):
        now_s[0] += 0.1
        writes.put(Output())
    writes.close()
    assert kept_s == pytest.approx([30.0, 60.0, 70.0], abs=0.11)


def test_a_disk_that_blocks_delays_no_stream(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "_DISK_S", 0.3)
    monkeypatch.setattr(recorder, "_LEAVE_S", 0.1)
    monkeypatch.setattr(rig.folder, "frames", lambda _stamped: rig.released.wait())
    with rig.flying():
        rig.link.wait_until(lambda: bool(rig.session.complaints))
        rig.streams_on()
        writer = next(each for each in threading.enumerate() if each.name == "writer")
        rig.stops()
        assert rig.folder.failure == "the disk does not answer"
    writer.join(PATIENCE_S)  # once its call returns
    assert not writer.is_alive()
    [said] = rig.session.complaints
    assert "stood still" in said
    assert rig.link.times_of(HOLD) == []
    rig.assert_no_gap()


@pytest.mark.parametrize("fails", ["", "No space left on device"])
def test_of_a_slow_disk_so_much_waits_and_all_of_that_is_recorded_unless_it_fails(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    monkeypatch.setattr(recorder, "_MOST_WAITING", 100_000)
    released, write = threading.Event(), folder.frames

    def frames(stamped: list[tuple[float, bytes]]) -> None:
        released.wait()
        write(stamped)
        folder.failure = (stamped and fails) or folder.failure

    monkeypatch.setattr(folder, "frames", frames)
    told = list[Failure]()
    writer = recorder.WriterThread(recorder.Recorder(folder, time.monotonic, told.append))
    for number in range(1000):
        writer.put(Output(record=[(float(number), bytes(1000))]))
    assert 100_000 < writer._put_bytes <= 101_000
    released.set()
    writer.put(Output(record=[(1000.0, bytes(1000))], checkpoint={"number": 1000}))
    writer.close()
    assert not writer._thread.is_alive()
    assert (folder.path / "flight.tlog").stat().st_size == (1 if fails else 101) * 1008
    assert folder.failure == (fails or "the disk is too slow")
    assert [failure.error for failure in told] == [folder.failure]
