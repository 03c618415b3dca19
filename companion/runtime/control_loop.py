"""The control loop: feeds the session with events and carries out its outputs."""

import contextlib
import math
import threading
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Protocol, final

from companion.mavlink.link import Output
from companion.planner.request import Planned, PlanRequest
from companion.runtime.link import Link, is_setpoint
from companion.runtime.recorder import WRITER, Batch, Writer
from companion.runtime.watchdog import Clock, Gate, Watchdog, Worker
from companion.runtime.workers import (
    POLL_S,
    Datagram,
    EventQueue,
    Item,
    LinkReader,
    PlanComputed,
    WorkerDelayed,
    WorkerLost,
)
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary

_SILENCE_S = 0.2
_LOCKSTEP_SILENCE_S = 30.0  # the simulator is busy, or has ended
_LOCKSTEP_NOBODY_S = 10.0
_STALE_S = 0.5  # a datagram that has waited so long tells of the past
_SETTLE_S = 3.0  # for the vehicle to confirm the mode in which it is left
_TRACK_S = 0.5
_MAX_TRACK = 20_000  # points; of a longer flight every second one, and so on
_MAX_PLANS = 2_000
_RESERVE_S = 10.0
_BUSY_AGAIN_S = 10.0  # between two texts that the computer is busy
_OBLIGES = frozenset({"phase", "set mode", "arm", "take off"})
"""Journal entries after which the vehicle has to be told something else at the end."""


class Planning(Protocol):
    """Who computes the plans, and puts them into the event queue."""

    @property
    def newest(self) -> int:
        """Number of the last request: an answer to an earlier one is not waited for."""
        ...

    def ask(self, request: PlanRequest) -> None:
        """Compute a request, now or soon."""
        ...


class Person(Protocol):
    """Who may say go at the terminal."""

    def says_go(self) -> bool:
        """Whether somebody has said it since this was asked last."""
        ...

    def hears(self, answer: str) -> None:
        """What became of it."""
        ...


@final
class Nobody:
    """Nobody is there to say it."""

    def says_go(self) -> bool:
        """Never."""
        return False

    def hears(self, answer: str) -> None:
        """Nobody does."""


@final
@dataclass(slots=True, kw_only=True)
class ControlLoop:
    """Feeds the session with events and carries out its outputs."""

    session: Session
    flown: FlightSummary
    link: Link
    gate: Gate
    event_queue: EventQueue
    reader: LinkReader
    planning: Planning
    writer: Writer
    watchdog: Watchdog
    lockstep: bool
    stop_asked: Callable[[], bool]
    clock: Clock
    person: Person = field(default_factory=Nobody)
    part: Worker = field(default_factory=lambda: Worker("decider"))
    ended: threading.Event = field(default_factory=threading.Event)
    _leaving: threading.Event = field(default_factory=threading.Event)
    _stopping: bool = False
    _began_s: float = math.nan
    _heard_s: float = math.nan
    _turned_s: float = math.nan
    _arrived_s: float | None = None
    _track_at_s: float = -math.inf
    _track_every_s: float = _TRACK_S
    _reserve_at_s: float = -math.inf
    _busy_at_s: float = -math.inf
    _ended_s: float | None = None

    def leave(self) -> None:
        """End soon."""
        self._leaving.set()

    def run(self) -> None:
        """Run until the mission ends, or until stopped."""
        for _ in self.turns():
            pass

    def turns(self) -> Iterator[None]:
        """The same, turn by turn."""
        self._began_s = self._heard_s = self.clock()
        try:
            if not self.lockstep:
                self.session.silence(0.0)  # the first heartbeat waits for nobody
            while self.flown.end is None and not self._leaving.is_set():
                self._iterate()
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

    def _record_the_end(self, error: BaseException) -> None:
        """Record the inputs before an error, to reproduce it."""
        out = self.session.take_output()
        self._not_sent(out, [])
        calls = [
            frame.f_code.co_name
            for frame, _ in traceback.walk_tb(error.__traceback__)
            if frame.f_locals.get("self") is self.session
        ]
        raised = "raised", calls[0] if calls else "", f"{type(error).__name__}: {error}"
        self.writer.put(Batch(record=out.record, journal=out.journal, inputs=[*out.inputs, raised]))

    def _iterate(self) -> None:
        if self.lockstep:
            self.reader.once(POLL_S)
        self._take(0.0 if self.lockstep else POLL_S)
        out = self.session.run()
        while out.awaits_plan and not self._leaving.is_set():
            self._carry_out(out)
            self._take(POLL_S)
            self._heard_s = self.clock()  # the vehicle was not silent: it was made to wait
            out = self.session.run()
        self._carry_out(out)
        if self.flown.heard:
            self.flown.elapsed_s = self.clock() - self._began_s

    def _take(self, timeout_s: float) -> None:
        """Feed new events to the session; wait up to a time for the first."""
        if not self.lockstep:  # where nobody watches for how long a worker stalls
            self.part.beat(self.gate.stall_limit_s())
        items = self.event_queue.take(timeout_s)
        now_s = self.clock()
        self._arrived_s, self._turned_s = None, now_s
        for item in items:
            self._on_item(item, now_s)
        silent_s = now_s - self._heard_s
        if silent_s >= self._quiet_s():
            self.session.silence(silent_s)
        if not self._stopping and self.stop_asked():
            self._stopping = True
            self.session.stop()
        if self.person.says_go():
            self.person.hears(self.session.say_go() or "go: it takes off")

    def _quiet_s(self) -> float:
        """The shortest time that counts as a silence."""
        if not self.lockstep:
            return _SILENCE_S
        return _LOCKSTEP_SILENCE_S if self.flown.heard else _LOCKSTEP_NOBODY_S

    def _on_item(self, item: Item, now_s: float) -> None:
        match item:
            case Datagram():
                if self.lockstep or now_s - item.at_s < _STALE_S:
                    self._on_datagram(item)
            case PlanComputed() if item.number < self.planning.newest:
                pass
            case PlanComputed():
                self.flown.plans_s.append(item.took_s)
                if getattr(item.outcome, "stopped_after", None) is not None:
                    self.flown.out_of_time += 1
                if isinstance(item.outcome, Planned):
                    self.flown.plans.append(item.outcome)
                self._forget()
                self.session.deliver(item.outcome)
            case WorkerDelayed(part=part, waited_s=waited_s):
                if now_s - self._busy_at_s >= _BUSY_AGAIN_S:
                    self._busy_at_s = now_s
                    self.session.complain(f"computer busy: the {part} waited for {waited_s:.1f} s")
            case WorkerLost(failure=failure, vital=True):
                self.session.part_died(failure.part, failure.error)
            case WorkerLost(failure=failure) if failure.part != WRITER:
                self.session.complain(f"{failure.part} is lost: {failure.error}")
            case WorkerLost(failure=failure):
                self.session.recording_stopped(failure.error)

    def _on_datagram(self, datagram: Datagram) -> None:
        if self._arrived_s is None:
            self._arrived_s = datagram.at_s
        if not self.session.receive(datagram.data, datagram.at_s):
            return
        self.link.answer_to(datagram.sender)
        if not self.flown.heard:
            self.flown.heard, self._began_s = True, datagram.at_s
        self._heard_s = datagram.at_s

    def _carry_out(self, out: Output) -> None:
        frames = out.frames if self.lockstep else newest_setpoint(out.frames)
        try:
            self._send(frames, out)
        finally:
            self.writer.put(
                Batch(
                    record=out.record,
                    journal=out.journal,
                    inputs=out.inputs,
                    checkpoint=out.checkpoint,
                    known=out.known,
                )
            )
        if out.plan is not None:
            self.flown.scans_nea_m.append(out.plan.scan_nea_m)
            self.planning.ask(out.plan)
        if out.end is not None:
            self._on_end(out)
        self._note_track()

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

    def _forget(self) -> None:
        """Drop old data, so that memory is bounded in long flights; the journal has it all."""
        for grown in (self.flown.plans, self.flown.plans_s, self.flown.scans_nea_m):
            del grown[:-_MAX_PLANS]

    def _send(self, frames: list[bytes], out: Output) -> None:
        """Send frames, and remove those not sent from the record."""
        sent = frames
        if frames:
            since_s = self._turned_s if self._arrived_s is None else self._arrived_s
            sent = self.gate.send(frames, None if self.lockstep else since_s)
        self._not_sent(out, sent)
        now_s = self.clock()
        if any(entry["kind"] in _OBLIGES for entry in out.journal):
            self._reserve_at_s = -math.inf
        if now_s - self._reserve_at_s >= _RESERVE_S:
            self._reserve_at_s = now_s
            self.watchdog.reserve(self.session.hold_frames())

    @staticmethod
    def _not_sent(out: Output, sent: list[bytes]) -> None:
        """Remove frames that were not sent from the record."""
        if len(sent) < len(out.frames):
            kept = set(sent)
            numbers = [number for number, each in enumerate(out.frames) if each not in kept]
            out.leave_out(numbers)
            out.inputs.append(("unsent", numbers))

    def _on_end(self, out: Output) -> None:
        """End once the vehicle has confirmed its final mode."""
        if self._ended_s is None:
            self._ended_s = self.clock()
        patience_s = 0.0 if self.gate.is_shut else _SETTLE_S
        if out.settled or self.clock() - self._ended_s > patience_s:
            self.flown.end = out.end


def newest_setpoint(frames: list[bytes]) -> list[bytes]:
    """Frames without the setpoints that a newer one among them replaces.

    After a delay several positions are answered at once; only the last setpoint matters.
    """
    places = [place for place, frame in enumerate(frames) if is_setpoint(frame)]
    stale = set(places[:-1])
    return [frame for place, frame in enumerate(frames) if place not in stale] if stale else frames
