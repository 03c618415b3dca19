"""Runs a session: the wall clock, the link, the threads, the run folder.

    readers ─► event queue ──► control loop (the session) ──► gate ──► link
    planning ───────┘               │    └──► writer ──► run folder
                                    └──► planning

A slow disk, a long plan or a blocked terminal never delays a setpoint, and a part that dies shuts
the gate (`watchdog`).  In lockstep the control loop itself reads and writes, as the vehicle waits.
"""

import gc
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import final

from companion.mavlink.signing import strip_signature
from companion.mission.events import End, Outcome
from companion.planning import plan
from companion.runtime.compiler import load_libraries
from companion.runtime.control_loop import ControlLoop, Nobody, Person
from companion.runtime.link import Link
from companion.runtime.planner_process import PlannerProcess
from companion.runtime.recorder import Batch, InlineWriter, Recorder, Writer, WriterThread
from companion.runtime.watchdog import Clock, Failure, Gate, Watchdog
from companion.runtime.workers import (
    EventQueue,
    LinkReader,
    PlanFunction,
    PlannerWorker,
    WorkerDelayed,
    WorkerLost,
)
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary
from companion.telemetry.run_folder import RunFolder

_HELD_S = 2.0  # for the watchdog to have told it to hold
_PROGRESS_S = 0.1
_COLLECT = (50_000, 20, 50)  # allocations: rarely, for next to nothing here is a cycle
_SWITCH_S = 0.0005  # how long a thread that computes may keep one that has to answer waiting


def fly(
    session: Session,
    link: Link,
    folder: RunFolder,
    *,
    lockstep: bool,
    on_progress: Callable[[FlightSummary], None],
    stop_asked: Callable[[], bool],
    planner: PlanFunction | None = None,
    persist: Callable[[], None] | None = None,
    person: Person | None = None,
    clock: Clock = time.monotonic,
) -> FlightSummary:
    """Run a session until its mission ends; every end is a value, `FlightSummary.end`.

    planner: by default `plan`, in a process of its own unless in lockstep.
    persist: saves what must outlive the process; called every SAVE_EVERY_S (`keys`) and at the end.
    person: who may say go at the terminal; None: there is none.
    on_progress is called in the caller's thread, stop_asked in another one.
    """
    load_libraries()
    if planner is None:
        planner = plan if lockstep else PlannerProcess()
    who = person or Nobody()
    flight = _Flight(session, link, folder, lockstep, planner, persist, stop_asked, who, clock)
    flight.flown.asks_here = person is not None
    with prompt_threads():
        flight.run(on_progress)
    return flight.flown


@contextmanager
def prompt_threads() -> Iterator[None]:
    """Short thread switch interval, and rare garbage collection without permanent objects."""
    before_s, before, frozen = sys.getswitchinterval(), gc.get_threshold(), gc.get_freeze_count()
    sys.setswitchinterval(_SWITCH_S)
    gc.set_threshold(*_COLLECT)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        if not frozen:  # by the caller
            gc.unfreeze()
        gc.set_threshold(*before)
        sys.setswitchinterval(before_s)


@final
class _Flight:
    """Starts and stops the threads of one flight."""

    def __init__(
        self,
        session: Session,
        link: Link,
        folder: RunFolder,
        lockstep: bool,
        planner: PlanFunction,
        persist: Callable[[], None] | None,
        stop_asked: Callable[[], bool],
        person: Person,
        clock: Clock,
    ) -> None:
        self.flown = FlightSummary(session=session)
        self._session, self._folder, self._lockstep = session, folder, lockstep
        self._event_queue = EventQueue()
        gate = Gate(link, clock, session.signed)
        self._watchdog = Watchdog(
            gate,
            clock=clock,
            hold_frames=session.hold_frames,
            final_text=session.final_text,
            on_failure=self._on_failure,
            on_loss=self._on_loss,
            on_delay=self._on_delay,
            watches_time=not lockstep,
        )
        recorder = Recorder(folder, clock, persist)
        kind = InlineWriter if lockstep else WriterThread
        self._writer: Writer = kind(recorder, self._on_loss)
        self._reader = LinkReader(link, self._event_queue, gate, clock)
        self._planning = PlannerWorker(planner, self._event_queue, lockstep=lockstep)
        self._control_loop = ControlLoop(
            session=session,
            flown=self.flown,
            link=link,
            gate=gate,
            event_queue=self._event_queue,
            reader=self._reader,
            planning=self._planning,
            writer=self._writer,
            watchdog=self._watchdog,
            lockstep=lockstep,
            stop_asked=stop_asked,
            person=person,
            clock=clock,
        )

    def run(self, on_progress: Callable[[FlightSummary], None]) -> None:
        self._watchdog.start()
        self._watchdog.watch(self._planning.part, self._planning.run)
        if isinstance(self._writer, WriterThread):
            self._watchdog.watch(self._writer.part, self._writer.run)
        if not self._lockstep:
            self._watchdog.watch(self._reader.part, self._reader.run)
        self._watchdog.watch(self._control_loop.part, self._control_loop.run)
        try:
            while not self._control_loop.ended.wait(_PROGRESS_S) and self._watchdog.failure is None:
                self._watchdog.check()
                on_progress(self.flown)
        finally:
            self._end()

    def _end(self) -> None:
        """Always send the final frames, and record them."""
        failure = self._watchdog.failure
        if failure is not None and failure.part != self._control_loop.part.name:
            self._control_loop.ended.wait(_HELD_S)  # it tells the session, and notes what that does
        self._control_loop.leave()
        self._control_loop.ended.wait(0.0 if failure is not None else _HELD_S)
        self._watchdog.end(_HELD_S)
        failure = self._watchdog.failure
        if failure is not None:
            self.flown.end, self.flown.died = _end_of(failure, self.flown.end), True
        self._reader.leave()
        self._planning.leave()
        self._writer.close()

    def _on_loss(self, failure: Failure) -> None:
        self._event_queue.put(WorkerLost(failure, vital=False))

    def _on_delay(self, part: str, waited_s: float) -> None:
        self._event_queue.put(WorkerDelayed(part, waited_s))

    def _on_failure(self, failure: Failure, hold: list[bytes]) -> None:
        now_s = self._session.now_s
        noted = {
            "t_s": round(now_s, 6),
            "kind": "part died",
            "part": failure.part,
            "error": failure.error,
            "hold_frames": len(hold),
        }
        record = [(now_s, strip_signature(frame)) for frame in hold]
        self._writer.put(Batch(record=record, journal=[noted], inputs=[("held", len(hold))]))
        self._event_queue.put(WorkerLost(failure, vital=True))


def _end_of(failure: Failure, end: End | None) -> End:
    if end is not None and end.outcome is Outcome.FAILED:
        return end
    reason = f"the {failure.part} has died ({failure.error})"
    remedy = "The vehicle was told to hold; take over, and look into journal.jsonl."
    return End(outcome=Outcome.FAILED, reason=reason, remedy=remedy)
