"""Runs a session: one loop over the link, the planner and people, in a thread of its own.

    link ──► loop (the session) ──► gate ──► link
              │   ▲     └──► writer ──► run folder
              ▼   │
             planner

A slow disk, a long plan or a blocked terminal never delays a setpoint, and a loop that dies shuts
the gate (`watchdog`).  In lockstep the loop itself writes, as the vehicle waits.
"""

import contextlib
import gc
import math
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Final, final

from companion.mavlink.link import Output
from companion.mission.events import End, Outcome
from companion.planner.request import Planned, PlanOutcome
from companion.runtime.compiler import load_libraries
from companion.runtime.link import Link
from companion.runtime.planner_process import PlannerEndedError, PlannerHere, PlannerProcess
from companion.runtime.recorder import WRITER, Recorder, WriterThread
from companion.runtime.terminal import Terminal
from companion.runtime.watchdog import DECIDER, Clock, Failure, Gate, Watchdog
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary
from companion.telemetry.run_folder import RunFolder

_POLL_S: Final = 0.05
_MOST: Final = 64  # datagrams in one turn
_MOST_WAITING: Final = 4096  # more than the buffer of a socket holds
_AT_ONCE_S: Final = 0.005
"""What is received sooner than this had waited."""
_SILENCE_S: Final = 0.2
_DEAF_S: Final = 5.0  # less than makes the session give up; nobody was listened to meanwhile
_LOCKSTEP_SILENCE_S: Final = 30.0  # the simulator is busy, or has ended
_LOCKSTEP_NOBODY_S: Final = 10.0
_STALE_S: Final = 0.5  # a datagram that has waited so long tells of the past
_SETTLE_S: Final = 3.0  # for the vehicle to confirm the mode in which it is left
_TRACK_S: Final = 0.5
_MAX_TRACK: Final = 20_000  # points; of a longer flight every second one, and so on
_MAX_PLANS: Final = 2_000
_RESERVE_S: Final = 10.0
_HELD_S: Final = 2.0  # for a loop to send and to record its last frames
_PROGRESS_S: Final = 0.1
_SHOWN_S: Final = 1.0  # for what is being shown at the end
_COLLECT: Final = (50_000, 20, 50)  # allocations: rarely, for next to nothing here is a cycle
_SWITCH_S: Final = 0.0005  # how long a thread that computes may keep one waiting that must answer


@final
class Loop:
    """Feeds the session with what is heard and carries out its outputs, through a watched gate."""

    def __init__(
        self,
        session: Session,
        link: Link,
        planner: PlannerProcess | PlannerHere | None = None,
        *,
        clock: Clock,
        stop_asked: Callable[[], bool] = lambda: False,
        person: Terminal | None = None,
        in_flight: bool = False,
    ) -> None:
        """planner: None: nothing is planned."""
        self.session, self.link, self.clock = session, link, clock
        self.record: Callable[[Output], None] = lambda _: None
        """Records what was done, now or soon."""
        self.flown = FlightSummary(session=session, asks_here=person is not None)
        self.leaving, self.ended = threading.Event(), threading.Event()
        """Set to have it end soon, and once it has."""
        self.gate = Gate(link, clock, session.signed)
        self.watchdog = Watchdog(
            self.gate,
            session,
            clock=clock,
            on_failure=self._on_failure,
            watches_time=not session.context.lockstep,
        )
        self._planner: PlannerProcess | PlannerHere | None = planner
        self._lockstep, self._in_flight = session.context.lockstep, in_flight
        self._stop_asked, self._person = stop_asked, person
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        """What other threads have to tell the session in the next turn."""
        self._stopping = False
        self.heard_s = math.nan
        """When the vehicle was heard, or could not be."""
        self._began_s = math.nan
        self._read_s = math.nan
        """When all that had arrived was read."""
        self._since_s = math.nan
        """What is answered now arrived no earlier."""
        self._track_at_s, self._track_every_s = -math.inf, _TRACK_S
        self._reserve_at_s = -math.inf
        self._ended_s = math.nan

    def lost(self, failure: Failure) -> None:
        """The recording is lost, or a part of it: the flight goes on; from any thread."""
        what = "not recorded any more" if failure.part == WRITER else f"{failure.part} is lost"
        self._calls.put(partial(self.session.complain, f"{what}: {failure.error}"))

    def run(self) -> None:
        """Run until the mission ends, or until stopped."""
        for _ in self.turns():
            pass

    def turns(self) -> Iterator[None]:
        """The same, turn by turn."""
        self._began_s = self.heard_s = self._read_s = self.clock()
        try:
            if not self._lockstep:
                self.session.silence(0.0)  # the first heartbeat waits for nobody
                self._carry_out(self.session.run())
            self._await_planner()
            while self._goes_on:
                self._turn()
                yield
            self._carry_out(self.session.farewell())
        except GeneratorExit:  # the caller has seen enough
            raise
        except BaseException as error:
            reason = f"{type(error).__name__}: {error}"
            self.watchdog.died(reason)
            with contextlib.suppress(Exception):  # the error itself is what counts
                self._record_the_end(error, reason)
            raise
        finally:
            self.ended.set()

    @property
    def _goes_on(self) -> bool:
        """Whether the mission has not ended and nobody has said to leave."""
        return self.flown.end is None and not self.leaving.is_set()

    def _await_planner(self) -> None:
        """While the planner is loaded send heartbeats and obey Ctrl-C, but drop what is heard.

        None takes off that nobody can plan for, and what came meanwhile tells of the past.  In
        lockstep the vehicle waits; one that is in flight does not.
        """
        listens = not self._lockstep
        while not (self._in_flight or self._planner is None or self._planner.is_ready):
            if not self._goes_on:
                break
            self.flown.loads = True
            self.watchdog.beat()
            if listens:
                self.link.receive(_POLL_S)
            self._hear(0.0 if listens else _POLL_S)
            self._carry_out(self.session.run())
            if self.clock() - self.heard_s >= _DEAF_S:
                self.heard_s = self.clock()
                if listens:
                    self.session.silence(0.0)
        self.flown.loads, self.heard_s = False, self.clock()  # from now on it is waited for
        for _ in range(_MOST_WAITING if listens else 0):
            if self.link.receive(0.0) is None:
                break

    def _record_the_end(self, error: BaseException, reason: str) -> None:
        """Record the inputs before an error, to reproduce it."""
        out = self.session.take_output()
        _leave_out(out, [*range(len(out.frames))])
        frames = (frame for frame, _ in traceback.walk_tb(error.__traceback__))
        calls = (f.f_code.co_name for f in frames if f.f_locals.get("self") is self.session)
        out.inputs.append(("raised", next(calls, ""), reason))
        self.record(out)

    def _turn(self) -> None:
        self.watchdog.beat()
        self._read()
        self._hear()
        out = self.session.run()
        while out.awaits_plan and self._goes_on:  # a planner may hang, or may have died
            self._carry_out(out)
            self._hear(_POLL_S)
            self.heard_s = self.clock()  # the vehicle was not silent: it was made to wait
            out = self.session.run()
        self._carry_out(out)
        if self.flown.heard:
            self.flown.elapsed_s = self.clock() - self._began_s

    # --- in

    def _read(self) -> None:
        """Feed what has arrived to the session; wait a little for the first.

        After the loop was held up, what had waited meanwhile tells of the past: it is dropped.
        """
        asked_s, self._since_s = self.clock(), self._read_s
        most = 1 if self._lockstep or self.link.is_stream else _MOST
        arrived: list[tuple[bytes, object, float]] = []
        while len(arrived) < most:
            data = self.link.receive(0.0 if arrived else _POLL_S)
            if data is None:
                break
            arrived.append((data, self.link.sender, self.clock()))
        if len(arrived) < _MOST:  # else there may be more, which is as old
            self._read_s = self.clock()
        waited = arrived and arrived[0][2] - asked_s < _AT_ONCE_S
        if waited and not self._lockstep and asked_s - self._since_s >= _STALE_S:
            return
        for data, sender, at_s in arrived:
            if self.session.receive(data, at_s):
                self.link.answer_to(sender)
                self.heard_s = at_s
                if not self.flown.heard:
                    self.flown.heard, self._began_s = True, at_s

    def _hear(self, wait_s: float = 0.0) -> None:
        """Hear what other threads, the planner, people and the silence say.

        wait_s: for the planner.
        """
        while not self._calls.empty():
            self._calls.get()()
        if self._planner is not None:
            try:
                answer = self._planner.answer(wait_s)
            except PlannerEndedError as error:
                self._planner = None
                self.session.part_died("planner", str(error))
            else:
                if answer is not None:
                    self._on_plan(*answer)
        silent_s, quiet_s = self.clock() - self.heard_s, _SILENCE_S
        if self._lockstep:
            quiet_s = _LOCKSTEP_SILENCE_S if self.flown.heard else _LOCKSTEP_NOBODY_S
        if silent_s >= quiet_s:
            self.session.silence(silent_s)
        if not self._stopping and self._stop_asked():
            self._stopping = True
            self.session.stop()
        if self._person is not None and self._person.says_go():
            self._person.hears(self.session.say_go() or "go: it takes off")

    def _on_plan(self, outcome: PlanOutcome, took_s: float) -> None:
        self.flown.plans_s.append(took_s)
        if getattr(outcome, "stopped_after", None) is not None:
            self.flown.out_of_time += 1
        if isinstance(outcome, Planned):
            self.flown.plans.append(outcome)
        for grown in (self.flown.plans, self.flown.plans_s, self.flown.scans_nea_m):
            del grown[:-_MAX_PLANS]  # memory is bounded in long flights; the journal has it all
        self.session.deliver(outcome)

    def _on_failure(self, failure: Failure, hold: list[bytes]) -> None:
        """The watchdog holds the vehicle by these frames: told in its thread."""
        now_s = self.session.now_s
        noted = {"t_s": round(now_s, 6), "kind": "part died", "part": failure.part}
        noted |= {"error": failure.error, "hold_frames": len(hold)}
        record = [(now_s, frame) for frame in hold]
        self.record(Output(record=record, journal=[noted], inputs=[("held", len(hold))]))
        self._calls.put(partial(self.session.part_died, failure.part, failure.error))

    # --- out

    def _carry_out(self, out: Output) -> None:
        try:
            if out.frames:
                since_s = None if self._lockstep else self._since_s
                _leave_out(out, self.gate.send(out.frames, since_s))
        finally:
            self.record(out)
        if not self._lockstep and (out.journal or self.clock() - self._reserve_at_s >= _RESERVE_S):
            self._reserve_at_s = self.clock()
            self.watchdog.reserve = self.session.hold_frames()
        if out.plan is not None and self._planner is not None:
            self.flown.scans_nea_m.append(out.plan.scan_nea_m)
            self._planner.ask(out.plan)
        if out.end is not None:  # it is over once the vehicle has confirmed its final mode
            if math.isnan(self._ended_s):
                self._ended_s = self.clock()
            patience_s = 0.0 if self.gate.is_shut else _SETTLE_S
            if out.settled or self.clock() - self._ended_s > patience_s:
                self.flown.end = out.end
        self._note_track()

    def _note_track(self) -> None:
        if not self.session.mission.task.limits.hovers:
            self.flown.note_passing()
        position, now_s = self.session.state.vehicle.position_nea_m, self.session.now_s
        waits = 0.0 <= now_s - self._track_at_s < self._track_every_s  # or its clock begins again
        if position is not None and not waits:
            self._track_at_s = now_s
            self.flown.track_nea_m.append(position)
            if len(self.flown.track_nea_m) > _MAX_TRACK:
                self._track_every_s *= 2.0
                del self.flown.track_nea_m[1::2]


def _leave_out(out: Output, unsent: list[int]) -> None:
    """Remove frames that were not sent from the record."""
    if unsent:
        out.leave_out(unsent)
        out.inputs.append(("unsent", unsent))


# --- with its threads


def fly(
    session: Session,
    link: Link,
    folder: RunFolder,
    *,
    on_progress: Callable[[FlightSummary], None],
    stop_asked: Callable[[], bool],
    planner: PlannerProcess | PlannerHere | None = None,
    in_flight: bool = False,
    persist: Callable[[], None] = lambda: None,
    person: Terminal | None = None,
    clock: Clock = time.monotonic,
) -> FlightSummary:
    """Run a session until its mission ends; every end is a value, `FlightSummary.end`.

    planner: by default a process.
    in_flight: the vehicle may be: it is listened to while the planner is still being loaded.
    persist: saves what must outlive the process; called every SAVE_EVERY_S (`keys`) and at the end.
    person: who may say go at the terminal; None: there is none.
    The caller's thread watches; on_progress and stop_asked are called in threads of their own.
    """
    load_libraries()  # now, or it would delay setpoints
    lockstep = session.context.lockstep
    planner = planner or PlannerProcess(hurries=not lockstep)
    loop = Loop(
        session, link, planner,
        clock=clock, stop_asked=stop_asked, person=person, in_flight=in_flight,
    )  # fmt: skip
    recorder = Recorder(folder, clock, loop.lost, persist)
    writer = recorder if lockstep else WriterThread(recorder)
    loop.record = writer.put
    watchdog, raised = loop.watchdog, list[BaseException]()

    def show() -> None:
        try:
            while not loop.ended.wait(_PROGRESS_S):
                on_progress(loop.flown)
        except BaseException as error:  # noqa: BLE001 - it is raised below
            raised.append(error)

    def run() -> None:
        with contextlib.suppress(BaseException):  # which the watchdog is told of
            loop.run()

    shows = threading.Thread(target=show, name="progress", daemon=True)
    with prompt_threads(), contextlib.ExitStack() as at_end:
        at_end.callback(writer.close)
        at_end.callback(planner.close)
        at_end.callback(loop.ended.wait, _HELD_S)  # always send the final frames, and record them
        at_end.callback(loop.leaving.set)
        threading.Thread(target=run, name=DECIDER, daemon=True).start()
        shows.start()
        watchdog.watch(loop.ended, lambda: bool(raised or watchdog.failure))
        if watchdog.failure is None:
            loop.leaving.set()
        watchdog.watch(loop.ended, longest_s=_HELD_S)  # it tells the session of a failure
    shows.join(_SHOWN_S)
    if raised:
        raise raised[0]
    if watchdog.failure is not None:
        loop.flown.end, loop.flown.died = _end_of(watchdog.failure, loop.flown.end), True
    return loop.flown


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
