"""The control loop: what the vehicle, the planner and people say -> the session -> the link.

One thread reads the link and writes to it; other threads leave it calls to make (`post`).
"""

import contextlib
import math
import queue
import threading
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from typing import Final, final

from companion.mavlink.link import Output
from companion.planner.request import Planned, PlanOutcome, PlanRequest
from companion.runtime.link import Link, is_setpoint
from companion.runtime.recorder import WRITER
from companion.runtime.terminal import Terminal
from companion.runtime.watchdog import Clock, Failure, Gate, Watchdog, Worker
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary

_POLL_S: Final = 0.05
_MOST: Final = 64  # datagrams in one turn
_MOST_WAITING: Final = 4096  # more than the buffer of a socket holds
_AT_ONCE_S: Final = 0.005
"""What is received sooner than this had waited."""
_SILENCE_S: Final = 0.2
_LOCKSTEP_SILENCE_S: Final = 30.0  # the simulator is busy, or has ended
_LOCKSTEP_NOBODY_S: Final = 10.0
_STALE_S: Final = 0.5  # a datagram that has waited so long tells of the past
_SETTLE_S: Final = 3.0  # for the vehicle to confirm the mode in which it is left
_TRACK_S: Final = 0.5
_MAX_TRACK: Final = 20_000  # points; of a longer flight every second one, and so on
_MAX_PLANS: Final = 2_000
_RESERVE_S: Final = 10.0


@final
class ControlLoop:
    """Feeds the session with events and carries out its outputs, through a watched gate."""

    plan: Callable[[int, PlanRequest], None]
    """Has a plan computed, now or soon, whose answer is `answered`; set before the first turn."""
    planner_is_ready: Callable[[], bool] = staticmethod(lambda: True)
    """What the vehicle says before counts for nothing: none takes off that nobody can plan for."""

    def __init__(
        self,
        session: Session,
        link: Link,
        *,
        lockstep: bool,
        clock: Clock,
        stop_asked: Callable[[], bool],
        person: Terminal | None = None,
    ) -> None:
        self.session, self.link, self.clock = session, link, clock
        self.record: Callable[[Output], None] = lambda _: None
        """Records what was done, now or soon."""
        self.flown = FlightSummary(session=session)
        self.part, self.ended = Worker("decider"), threading.Event()
        self.gate = Gate(link, clock, session.signed)
        self.watchdog = Watchdog(
            self.gate,
            clock=clock,
            hold_frames=session.hold_frames,
            final_text=session.final_text,
            on_failure=self._on_failure,
            on_loss=self.lost,
            watches_time=not lockstep,
        )
        self._lockstep, self._stop_asked, self._person = lockstep, stop_asked, person
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._leaving = threading.Event()
        self._stopping, self._plans_asked = False, 0
        self._began_s = self._heard_s = math.nan
        self._read_s = math.nan
        """When all that had arrived was read."""
        self._since_s = math.nan
        """What is answered now arrived no earlier."""
        self._track_at_s, self._track_every_s = -math.inf, _TRACK_S
        self._reserve_at_s = -math.inf
        self._ended_s: float | None = None

    def post(self, call: Callable[[], None]) -> None:
        """Have the loop make a call in its next turn; from any thread."""
        self._calls.put(call)

    def leave(self) -> None:
        """End soon."""
        self._leaving.set()

    def answered(self, number: int, outcome: PlanOutcome, took_s: float) -> None:
        """Take the answer to a plan request; from any thread."""
        self.post(partial(self._on_plan, number, outcome, took_s))

    def lost(self, failure: Failure) -> None:
        """A part is lost that the flight goes on without; from any thread."""
        self.post(partial(self._on_loss, failure))

    def run(self) -> None:
        """Run until the mission ends, or until stopped."""
        for _ in self.turns():
            pass

    def turns(self) -> Iterator[None]:
        """The same, turn by turn."""
        self._began_s = self._heard_s = self._read_s = self.clock()
        try:
            if not self._lockstep:
                self.session.silence(0.0)  # the first heartbeat waits for nobody
                self._carry_out(self.session.run())
                self._await_planner()
                for _ in range(_MOST_WAITING):  # what came meanwhile tells of the past
                    if self.link.receive(0.0) is None:
                        break
            while self.goes_on:
                self._turn()
                yield
            self._carry_out(self.session.farewell())
        except GeneratorExit:  # the caller has seen enough
            raise
        except BaseException as error:
            with contextlib.suppress(Exception):  # the error itself is what counts
                self._record_the_end(error)
            raise
        finally:
            self.ended.set()

    @property
    def goes_on(self) -> bool:
        """Whether the mission has not ended and nobody has said to leave."""
        return self.flown.end is None and not self._leaving.is_set()

    def _await_planner(self) -> None:
        """While the planner is loaded send heartbeats, obey Ctrl-C, and drop what is heard."""
        while self.goes_on and not self.planner_is_ready():
            self.flown.loads = True
            self._beat()
            self.link.receive(_POLL_S)
            self._hear()
            now_s = self.clock()
            self._carry_out(self.session.run())
            if now_s - self._heard_s >= _SILENCE_S:
                self.session.silence(0.0)  # nobody was listened to
                self._heard_s = now_s
        self.flown.loads = False

    def _record_the_end(self, error: BaseException) -> None:
        """Record the inputs before an error, to reproduce it."""
        out = self.session.take_output()
        _without_unsent(out, [])
        frames = (frame for frame, _ in traceback.walk_tb(error.__traceback__))
        calls = (f.f_code.co_name for f in frames if f.f_locals.get("self") is self.session)
        out.inputs.append(("raised", next(calls, ""), f"{type(error).__name__}: {error}"))
        self.record(out)

    def _turn(self) -> None:
        self._beat()
        self._read()
        self._hear()
        out = self.session.run()
        while out.awaits_plan and not self._leaving.is_set():
            self._carry_out(out)
            self._beat()
            self._hear(_POLL_S)
            self._heard_s = self.clock()  # the vehicle was not silent: it was made to wait
            out = self.session.run()
        self._carry_out(out)
        if self.flown.heard:
            self.flown.elapsed_s = self.clock() - self._began_s

    def _beat(self) -> None:
        if not self._lockstep:  # where nobody watches for how long a worker stalls
            self.part.beat(self.gate.stall_limit_s())

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
                self._heard_s = at_s
                if not self.flown.heard:
                    self.flown.heard, self._began_s = True, at_s

    def _hear(self, timeout_s: float = 0.0) -> None:
        """Hear what other threads, people and the silence say; wait for a thread up to a time."""
        with contextlib.suppress(queue.Empty):
            self._calls.get(block=timeout_s > 0.0, timeout=timeout_s or None)()
            while True:
                self._calls.get_nowait()()
        silent_s, quiet_s = self.clock() - self._heard_s, _SILENCE_S
        if self._lockstep:
            quiet_s = _LOCKSTEP_SILENCE_S if self.flown.heard else _LOCKSTEP_NOBODY_S
        if silent_s >= quiet_s:
            self.session.silence(silent_s)
        if not self._stopping and self._stop_asked():
            self._stopping = True
            self.session.stop()
        if self._person is not None and self._person.says_go():
            self._person.hears(self.session.say_go() or "go: it takes off")

    def _on_plan(self, number: int, outcome: PlanOutcome, took_s: float) -> None:
        if number < self._plans_asked:
            return  # a newer one is waited for
        self.flown.plans_s.append(took_s)
        if getattr(outcome, "stopped_after", None) is not None:
            self.flown.out_of_time += 1
        if isinstance(outcome, Planned):
            self.flown.plans.append(outcome)
        for grown in (self.flown.plans, self.flown.plans_s, self.flown.scans_nea_m):
            del grown[:-_MAX_PLANS]  # memory is bounded in long flights; the journal has it all
        self.session.deliver(outcome)

    def _on_loss(self, failure: Failure) -> None:
        if failure.part == WRITER:
            self.session.recording_stopped(failure.error)
        else:
            self.session.complain(f"{failure.part} is lost: {failure.error}")

    def _on_failure(self, failure: Failure, hold: list[bytes]) -> None:
        """A vital part has died, and the watchdog sends these frames: told in its thread."""
        now_s = self.session.now_s
        noted = {"t_s": round(now_s, 6), "kind": "part died", "part": failure.part}
        noted |= {"error": failure.error, "hold_frames": len(hold)}
        record = [(now_s, frame) for frame in hold]
        self.record(Output(record=record, journal=[noted], inputs=[("held", len(hold))]))
        self.post(lambda: self.session.part_died(failure.part, failure.error))

    # --- out

    def _carry_out(self, out: Output) -> None:
        try:
            self._send(out)
        finally:
            self.record(out)
        if out.plan is not None:
            self.flown.scans_nea_m.append(out.plan.scan_nea_m)
            self._plans_asked += 1
            self.plan(self._plans_asked, out.plan)
        if out.end is not None:  # it is over once the vehicle has confirmed its final mode
            self._ended_s = self.clock() if self._ended_s is None else self._ended_s
            patience_s = 0.0 if self.gate.is_shut else _SETTLE_S
            if out.settled or self.clock() - self._ended_s > patience_s:
                self.flown.end = out.end
        self._note_track()

    def _send(self, out: Output) -> None:
        """Send frames, and remove those not sent from the record."""
        sent = out.frames if self._lockstep else newest_setpoint(out.frames)
        if sent:
            sent = self.gate.send(sent, None if self._lockstep else self._since_s)
        _without_unsent(out, sent)
        now_s = self.clock()
        if out.journal or now_s - self._reserve_at_s >= _RESERVE_S:
            self._reserve_at_s = now_s
            self.watchdog.reserve(self.session.hold_frames())

    def _note_track(self) -> None:
        if not self.session.mission.task.limits.hovers:
            self.flown.note_passing()
        here, now_s = self.session.state.vehicle.position_nea_m, self.session.now_s
        waits = 0.0 <= now_s - self._track_at_s < self._track_every_s  # or its clock begins again
        if here is not None and not waits:
            self._track_at_s = now_s
            self.flown.track_nea_m.append(here)
            if len(self.flown.track_nea_m) > _MAX_TRACK:
                self._track_every_s *= 2.0
                del self.flown.track_nea_m[1::2]


def _without_unsent(out: Output, sent: list[bytes]) -> None:
    """Remove frames that were not sent from the record."""
    if len(sent) < len(out.frames):
        kept = set(sent)
        numbers = [number for number, each in enumerate(out.frames) if each not in kept]
        out.leave_out(numbers)
        out.inputs.append(("unsent", numbers))


def newest_setpoint(frames: list[bytes]) -> list[bytes]:
    """Frames without the setpoints that a newer one among them replaces.

    After a delay several positions are answered at once; only the last setpoint matters.
    """
    places = [place for place, frame in enumerate(frames) if is_setpoint(frame)]
    stale = set(places[:-1])
    return [frame for place, frame in enumerate(frames) if place not in stale] if stale else frames
