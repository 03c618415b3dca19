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
from companion.mission.events import Outcome
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
        self.planner: Any = PlannerHere(odd_planners.echoes)
        self.options: dict[str, Any] = {"on_progress": lambda _: None}
        self.flight = Future[FlightSummary]()
        self.broken_s = math.inf
        self.thread = threading.Thread(target=self._fly, daemon=True)
        self.released = threading.Event()
        """What has stood still goes on."""
        self._over = threading.Event()

    def _fly(self) -> None:
        session: Any = self.session
        options: Any = {"planner": self.planner, "stop_asked": self._over.is_set}
        options |= self.options
        try:
            self.flight.set_result(loop.fly(session, self.link, self.folder, **options))
        except BaseException as error:  # noqa: BLE001 - looked at by the test
            self.flight.set_exception(error)

    def has_planner(self) -> None:
        """In a process of its own."""
        self.planner = PlannerProcess(odd_planners.echoes, odd_planners.nothing)

    def breaks(self, does: Callable[[], object], at: int = BREAKS_AT) -> None:
        """What the session does with that datagram."""

        def breaks() -> object:
            self.broken_s = time.monotonic()
            return does()

        self.session.on_datagram = lambda count: count == at and breaks()

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
    def end(self) -> Any:
        return self.flight.result(PATIENCE_S).end

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


def raises(_rig: Rig) -> None:
    raise OSError("made up")


def raises_and_cannot_even_say_hold(rig: Rig) -> None:
    """It has said it before."""
    rig.session.hold_frames = None  # type: ignore[assignment, method-assign]
    raise KeyError("made up")


@pytest.mark.parametrize(
    ("death", "told", "lockstep"),
    [
        *((raises, "decider: OSError: made up", lockstep) for lockstep in (False, True)),
        (raises_and_cannot_even_say_hold, "decider: KeyError: 'made up'", False),
        (lambda rig: rig.released.wait(), "decider: it has stood still for 0.", False),
        # while nobody asks it anything
        (lambda rig: rig.planner.process.kill(), "planner: its process has ended (SIGKILL)", False),
    ],
)
def test_once_a_part_has_died_nothing_is_streamed_any_more_and_the_vehicle_is_told_to_hold(
    rig: Rig, death: Callable[[Rig], object], told: str, lockstep: bool
) -> None:
    """In time, which in lockstep nothing depends on.  The decider's hold is sent three times."""
    (part, _, error), rig.session.context.lockstep = told.partition(": "), lockstep
    rig.breaks(lambda: death(rig))
    if part == "planner":
        rig.has_planner()
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


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("fails", ["on_progress", "clock"])
def test_a_watchdog_that_fails_or_cannot_show_ends_the_flight_as_if_stopped_and_raises(
    rig: Rig, fails: str
) -> None:
    def failing(*_flown: object) -> float:
        """As clock in the thread of the watchdog alone."""
        now_s = time.monotonic()
        of_watchdog = threading.current_thread() is rig.thread
        if rig.broken_s < now_s and (of_watchdog or fails != "clock"):
            raise MemoryError("made up")
        return now_s

    rig.options[fails] = failing
    rig.has_planner()
    with rig.flying():
        rig.broken_s = time.monotonic()
        assert isinstance(rig.flight.exception(PATIENCE_S), MemoryError)
    assert rig.session.has_left
    assert rig.link.times_of(HOLD) == []
    assert not rig.planner.process.is_alive()


@pytest.mark.parametrize(("lockstep", "at"), [(False, 1), (True, BREAKS_AT)])
def test_a_slow_start_is_no_death_nor_is_a_slow_lockstep_or_a_terminal_that_blocks(
    rig: Rig, lockstep: bool, at: int
) -> None:
    """Before the stream a part may take its time: a computer that starts up is busy."""
    rig.session.context.lockstep = lockstep
    rig.options["on_progress"] = lambda _: rig.released.wait() and None
    rig.breaks(lambda: threading.Event().wait(0.6), at)
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
