"""Watchdog over the worker threads, and the gate that it shuts: a dead companion never streams.

The workers (planner, control loop, writer) beat; one that has died or stalled is detected
within _TICK_S of its limit.  Then, within 300 ms of the death, no frame of the session is sent any
more, heartbeats included, and the watchdog itself puts the autopilot on hold (design 7, mavlink.md
C1, C2).  The writer is not vital: a flight goes on without its recording.
"""

import contextlib
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
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
        self.beats = self.seen = 0
        """Beats, and how many of them the watchdog has seen."""
        self.still_s = 0.0
        """For how long the watchdog has seen no beat."""

    def beat(self, limit_s: float) -> None:
        """Alive; the next beat comes within limit_s."""
        self.limit_s = limit_s
        self.beats += 1

    def idle(self) -> None:
        """Alive and idle."""
        self.beat(math.inf)


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
        watches_time: bool = True,
    ) -> None:
        """A watchdog that is started by start().

        hold_frames: makes the frames that put the autopilot on hold; final_text: those with the
        reason as text.  on_failure: told of a vital worker's end, and of the frames that are sent
        on it; on_loss: of the end of a worker that is not vital.  watches_time: False in lockstep,
        where nothing depends on wall time: workers are only checked for death.
        """
        self.failure: Failure | None = None
        self._gate, self._clock = gate, clock
        self._hold_frames, self._final_text = hold_frames, final_text
        self._on_failure, self._on_loss = on_failure, on_loss
        self._watches_time = watches_time
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

        def guarded() -> None:
            try:
                work()
            except BaseException as error:  # noqa: BLE001 - whatever it was, the worker is dead
                self.died(part, f"{type(error).__name__}: {error}")
            else:
                self._forget(part)

        self._parts.append(part)
        threading.Thread(target=guarded, name=part.name, daemon=True).start()

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
        for part in tuple(self._parts) if self._watches_time else ():
            part.still_s = 0.0 if part.beats != part.seen else part.still_s + elapsed_s
            part.seen = part.beats
            if part.still_s > part.limit_s:
                self.died(part, f"it has stood still for {part.still_s:.1f} s")

    def _hold(self) -> None:
        """Put the vehicle on hold; the session is notified after its hold frames were made."""
        assert self.failure is not None
        try:
            frames = self._hold_frames()
        except Exception:  # noqa: BLE001 - the session is what may have died
            frames = self._reserve
        words: list[bytes] = []
        with contextlib.suppress(Exception):  # that it holds is what counts
            words = self._final_text(f"the {self.failure.part} has died ({self.failure.error})")
        self._on_failure(self.failure, [*frames, *words])
        for wait_s in _HOLD_AGAIN_S:
            time.sleep(wait_s)
            if frames or words:
                with contextlib.suppress(Exception):  # the next attempt is not given up for it
                    self._gate.send_last([*frames, *words])
            words = []  # once
