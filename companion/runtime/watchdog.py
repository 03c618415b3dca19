"""Watchdog over the worker threads, and the gate that it shuts: a dead companion never streams.

The workers (planner, control loop, writer) beat; one that has died or stalled is detected
within _TICK_S of its limit.  Then, within 300 ms of the death, no frame of the session is sent any
more, heartbeats included, and the watchdog itself puts the autopilot on hold (design 7, mavlink.md
C1, C2).  The writer is not vital: a flight goes on without its recording.
"""

import contextlib
import math
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import final

from companion.runtime.link import Link, is_setpoint

Clock = Callable[[], float]
"""Seconds that only ever grow, of this computer."""

STALL_S = 0.2
"""How long a worker may stall while setpoints are streamed."""
IDLE_STALL_S = 5.0
"""The same without a stream: a busy computer at start-up is no danger."""
SETPOINT_AGE_S = 0.5
"""A setpoint is not sent later than this after the position that it answers has arrived."""
STREAMING_S = 0.4
"""Setpoints count as streamed if one was sent this recently."""
_TICK_S = 0.025
_HOLD_AGAIN_S = (0.0, 0.3, 0.7)
"""Waits before each time that the hold is sent: a datagram may get lost."""
_LOCK_S = 0.05
_COMPUTES = 0.5
"""What has run for so much of its limit without a beat does not wait: it does not come to an end.

A turn of the decider takes a twentieth.
"""
_SERVED = 0.2
"""What has a processor for so much of the time comes to the end of a turn within its limit."""
_POLL = 1.5
"""CPython looks for its lock once per switch interval; at most so many pass between two looks."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """A worker that has died."""

    part: str
    error: str


@final
class Worker:
    """One worker thread, as seen by the watchdog."""

    def __init__(self, name: str, *, vital: bool = True) -> None:
        self.name, self.vital = name, vital
        self.limit_s = math.inf
        self.beats = 0
        self.still_s = 0.0
        """For how long the watchdog has seen no beat."""
        self.seen = 0
        self.excused_s = 0.0
        """For how much longer there was none because it wanted to run and could not."""
        self.thread_id: int | None = None
        """As the operating system knows it, once it runs."""
        self.looked: tuple[float, int, int, int] | None = None
        """When the watchdog last looked, and what the operating system said: see `unserved_s`."""
        self.ran_s = 0.0
        """How long it has run since its last beat, as far as is known."""
        self.ahead_s = 0.0
        """Of a wait for the processor that is not over, what was counted already."""

    def beat(self, limit_s: float) -> None:
        """Alive; the next beat comes within limit_s."""
        self.limit_s = limit_s
        self.beats += 1

    def idle(self) -> None:
        """Alive and idle."""
        self.beat(math.inf)


def unserved_s(part: Worker) -> float:
    """For how long since the last call a worker wanted to run and could not: busy, not dead.

    Linux counts how long a thread has run and how long it has waited for a processor, ns, and how
    often it got one.  A thread that waits for the interpreter's lock runs for some microseconds
    once per switch interval, one that sleeps does not.  0 where nobody counts.
    """
    try:
        task = Path(f"/proc/self/task/{part.thread_id}")
        ran_ns, waited_ns, times = map(int, (task / "schedstat").read_text().split())
        state = (task / "stat").read_text().rpartition(")")[2].split()[0]
    except (OSError, ValueError, IndexError):
        return 0.0
    before, part.looked = part.looked, (time.monotonic(), ran_ns, waited_ns, times)
    if before is None:
        return 0.0
    passed_s, ran_s = part.looked[0] - before[0], (ran_ns - before[1]) * 1e-9
    part.ran_s += ran_s
    if state == "R" and ran_ns == before[1]:  # the wait is counted once it is over
        part.ahead_s += passed_s
        return passed_s
    if ran_s > _SERVED * passed_s:
        return 0.0
    waited_s = max((waited_ns - before[2]) * 1e-9 - part.ahead_s, 0.0)
    part.ahead_s = 0.0
    polled_s = (times - before[3]) * _POLL * sys.getswitchinterval()
    return waited_s + max(min(passed_s - ran_s - waited_s, polled_s), 0.0)


@final
class Gate:
    """The session's only way to the link.  Once shut it stays shut."""

    def __init__(
        self,
        link: Link,
        clock: Clock,
        signed: Callable[[list[bytes]], list[bytes]] = list,
    ) -> None:
        """signed: signs the watchdog's frames, for a link whose peer demands it."""
        self._link, self._clock, self._signed = link, clock, signed
        self._lock = threading.Lock()
        self._is_shut = False
        self._streamed_s = -math.inf

    @property
    def is_shut(self) -> bool:
        """Whether it is shut."""
        return self._is_shut

    def stall_limit_s(self) -> float:
        """How long a worker may stall now."""
        return STALL_S if self._clock() - self._streamed_s < STREAMING_S else IDLE_STALL_S

    def send(self, frames: list[bytes], since_s: float | None = None) -> list[bytes]:
        """Send frames; those that were sent: none if the gate is shut, and no stale setpoint.

        since_s: when what they answer has arrived; None: setpoints are sent whatever their age.
        """
        with self._lock:
            if self._is_shut:
                return []
            if since_s is not None and self._clock() - since_s > SETPOINT_AGE_S:
                frames = [frame for frame in frames if not is_setpoint(frame)]
            self._link.send(frames)
        if any(map(is_setpoint, frames)):
            self._streamed_s = self._clock()
        return frames

    def shut(self) -> None:
        """Shut: no frame of the session is sent from now on, except one being sent just now."""
        self._is_shut = True

    def send_last(self, frames: list[bytes]) -> None:
        """Send the watchdog's own unsigned frames through the shut gate, without waiting.

        They are signed here: a signature that is older than the last one sent is refused, and so is
        a copy of one that has arrived.
        """
        locked = self._lock.acquire(timeout=_LOCK_S)
        try:
            self._link.send(self._signed(frames))
        finally:
            if locked:
                self._lock.release()


@final
class Watchdog:
    """Supervises the workers in a thread of its own."""

    def __init__(
        self,
        gate: Gate,
        *,
        clock: Clock,
        hold_frames: Callable[[], list[bytes]],
        final_text: Callable[[str], list[bytes]] = lambda _: [],
        on_failure: Callable[[Failure, list[bytes]], None],
        on_loss: Callable[[Failure], None],
        on_delay: Callable[[str, float], None] = lambda _part, _waited_s: None,
        watches_time: bool = True,
        waits: Callable[[Worker], float] = unserved_s,
    ) -> None:
        """A watchdog that is started by start().

        hold_frames: makes the frames that put the autopilot on hold; final_text: those with the
        reason as text.  on_failure: told of a vital worker's end, and of the frames that are sent
        on it; on_loss: of the end of a worker that is not vital; on_delay: of one that is busy
        again after it was excused for so many seconds.  watches_time: False in lockstep, where
        nothing depends on wall time: workers are only checked for death.  waits: for how much of
        the time since it was last asked a worker could not run, which is tolerated for 5 s.
        """
        self.failure: Failure | None = None
        self._gate, self._clock = gate, clock
        self._hold_frames, self._final_text = hold_frames, final_text
        self._on_failure, self._on_loss, self._on_delay = on_failure, on_loss, on_delay
        self._watches_time, self._waits = watches_time, waits
        self._parts: list[Worker] = []
        self._reserve: list[bytes] = []
        self._first = threading.Lock()
        self._wake = threading.Event()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watchdog", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def watch(self, part: Worker, work: Callable[[], None]) -> None:
        """Start a worker in a thread of its own, whose end is detected."""
        self._parts.append(part)
        threading.Thread(
            target=self._guarded, args=(part, work), name=part.name, daemon=True
        ).start()

    def reserve(self, frames: list[bytes]) -> None:
        """Store hold frames, sent if none can be made when needed."""
        self._reserve = frames

    def died(self, part: Worker, error: str) -> None:
        """A worker has ended, or must be considered dead."""
        self._forget(part)
        if self._ended.is_set():
            return
        failure = Failure(part=part.name, error=error)
        if not part.vital:
            self._on_loss(failure)
            return
        if not self._first.acquire(blocking=False):
            return  # another was first; all is stopped already
        self._gate.shut()
        self.failure = failure
        self._wake.set()

    def end(self, timeout_s: float) -> None:
        """Stop; a hold that is being sent is completed."""
        self._ended.set()
        if self.failure is None:
            self._wake.set()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    def check(self) -> None:
        """Check the workers if the watchdog's own thread has died."""
        if not self._thread.is_alive() and self.failure is None:
            self.died(Worker("watchdog"), "its thread has ended")
            self._hold()

    # --- its thread

    def _guarded(self, part: Worker, work: Callable[[], None]) -> None:
        part.thread_id = threading.get_native_id()
        try:
            work()
        except BaseException as error:  # noqa: BLE001 - whatever it was, the worker is dead
            self.died(part, f"{type(error).__name__}: {error}")
        else:
            self._forget(part)

    def _forget(self, part: Worker) -> None:
        if part in self._parts:
            self._parts.remove(part)

    def _run(self) -> None:
        looked_s = self._clock()
        while not self._wake.wait(_TICK_S):
            now_s = self._clock()
            # A computer that was asleep, or too busy to look, says nothing about the parts.
            self._look(min(now_s - looked_s, 2.0 * _TICK_S))
            looked_s = now_s
        if self.failure is not None:
            self._hold()

    def _look(self, elapsed_s: float) -> None:
        for part in tuple(self._parts):
            if not self._watches_time:
                continue
            unserved_s = min(self._waits(part), elapsed_s) if part.limit_s < math.inf else 0.0
            if part.beats != part.seen:
                if part.excused_s > STALL_S:
                    self._on_delay(part.name, part.excused_s)
                part.seen, part.still_s, part.excused_s, part.ran_s = part.beats, 0.0, 0.0, 0.0
            elif part.limit_s < math.inf:
                unserved_s = min(unserved_s, IDLE_STALL_S - part.excused_s)
                part.excused_s += unserved_s
                part.still_s += elapsed_s - unserved_s
                computes = part.ran_s > _COMPUTES * part.limit_s
                if part.still_s + (part.excused_s if computes else 0.0) > part.limit_s:
                    self.died(part, _stood_still(part))

    def _hold(self) -> None:
        """Put the vehicle on hold; the session is notified after its hold frames were made."""
        try:
            frames = self._hold_frames()
        except Exception:  # noqa: BLE001 - the session is what may have died
            frames = self._reserve
        assert self.failure is not None
        words: list[bytes] = []
        with contextlib.suppress(Exception):  # that it holds is what counts
            words = self._final_text(f"the {self.failure.part} has died ({self.failure.error})")
        self._on_failure(self.failure, [*frames, *words])
        for wait_s in _HOLD_AGAIN_S:
            threading.Event().wait(wait_s)
            if frames or words:
                with contextlib.suppress(Exception):  # the next attempt is not given up for it
                    self._gate.send_last([*frames, *words])
            words = []  # once


def _stood_still(part: Worker) -> str:
    """For how long, and for how much longer it could not run."""
    text = f"it has stood still for {part.still_s:.1f} s"
    if part.excused_s < 0.1:
        return text
    return f"{text}, after {part.excused_s:.1f} s in which the computer did not let it run"
