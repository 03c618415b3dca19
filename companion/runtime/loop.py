"""Runs a session: the wall clock, the link, the threads, the run folder.

    link ──► control loop (the session) ──► gate ──► link
                │   ▲       └──► writer ──► run folder
                ▼   │
              planning

A slow disk, a long plan or a blocked terminal never delays a setpoint, and a part that dies shuts
the gate (`watchdog`).  In lockstep the control loop itself writes, as the vehicle waits.
"""

import gc
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from companion.mission.events import End, Outcome
from companion.planning import plan
from companion.runtime.compiler import load_libraries
from companion.runtime.control_loop import ControlLoop
from companion.runtime.link import Link
from companion.runtime.planner_process import PlanFunction, PlannerProcess, PlannerWorker
from companion.runtime.recorder import Recorder, WriterThread
from companion.runtime.terminal import Terminal
from companion.runtime.watchdog import Clock, Failure
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary
from companion.telemetry.run_folder import RunFolder

_HELD_S: Final = 2.0  # for the watchdog to have told it to hold
_PROGRESS_S: Final = 0.1
_COLLECT: Final = (50_000, 20, 50)  # allocations: rarely, for next to nothing here is a cycle
_SWITCH_S: Final = 0.0005  # how long a thread that computes may keep one waiting that must answer


def fly(
    session: Session,
    link: Link,
    folder: RunFolder,
    *,
    lockstep: bool,
    on_progress: Callable[[FlightSummary], None],
    stop_asked: Callable[[], bool],
    planner: PlanFunction | None = None,
    in_flight: bool = False,
    persist: Callable[[], None] = lambda: None,
    person: Terminal | None = None,
    clock: Clock = time.monotonic,
) -> FlightSummary:
    """Run a session until its mission ends; every end is a value, `FlightSummary.end`.

    planner: by default `plan`, in a process of its own unless in lockstep.
    in_flight: the vehicle may be: it is listened to while the planner is still being loaded.
    persist: saves what must outlive the process; called every SAVE_EVERY_S (`keys`) and at the end.
    person: who may say go at the terminal; None: there is none.
    on_progress is called in the caller's thread, stop_asked in another one.
    """
    if in_flight:
        load_libraries()  # now, or it would delay setpoints
    if planner is None:
        planner = plan if lockstep else PlannerProcess()
    loop = ControlLoop(
        session,
        link,
        lockstep=lockstep,
        clock=clock,
        stop_asked=stop_asked,
        person=person,
    )
    loop.flown.asks_here = person is not None
    planning = PlannerWorker(planner, loop.answered, lockstep=lockstep)
    recorder = Recorder(folder, clock, loop.lost, persist)
    writer = recorder if lockstep else WriterThread(recorder)
    loop.plan, loop.record = planning.ask, writer.put
    if not in_flight:
        loop.planner_is_ready = planning.ready.is_set
    with prompt_threads():
        loop.watchdog.start()
        loop.watchdog.watch(planning.part, planning.run)
        if isinstance(writer, WriterThread):
            loop.watchdog.watch(writer.part, writer.run)
        loop.watchdog.watch(loop.part, loop.run)
        try:
            while not loop.ended.wait(_PROGRESS_S) and loop.watchdog.failure is None:
                loop.watchdog.check()
                on_progress(loop.flown)
        finally:
            _end(loop)
            planning.leave()
            writer.close()
    return loop.flown


def _end(loop: ControlLoop) -> None:
    """Always send the final frames, and record them."""
    failure = loop.watchdog.failure
    if failure is not None and failure.part != loop.part.name:
        loop.ended.wait(_HELD_S)  # it tells the session, and notes what that does
    loop.leave()
    loop.ended.wait(0.0 if failure is not None else _HELD_S)
    loop.watchdog.end(_HELD_S)
    if (failure := loop.watchdog.failure) is not None:
        loop.flown.end, loop.flown.died = _end_of(failure, loop.flown.end), True


def _end_of(failure: Failure, end: End | None) -> End:
    if end is not None and end.outcome is Outcome.FAILED:
        return end
    reason = f"the {failure.part} has died ({failure.error})"
    remedy = "The vehicle was told to hold; take over, and look into journal.jsonl."
    return End(outcome=Outcome.FAILED, reason=reason, remedy=remedy)


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
