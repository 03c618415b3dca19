"""Watchdog over the loop, and the gate that it shuts: a dead companion never streams.

The loop beats; once it has died, or stalled, that is noticed within _TICK_S of its limit.  Then,
within 300 ms of the death, no frame of the session is sent any more, heartbeats included, and the
watchdog itself puts the autopilot on hold (design 7, mavlink.md C1, C2).
"""

import contextlib
import math
import threading
import time
from collections.abc import Callable
from typing import Final, NamedTuple, final

from companion.runtime.link import Link, is_setpoint
from companion.session import Session

Clock = Callable[[], float]
"""Seconds that only ever grow, of this computer."""

STALL_S = 0.2
"""How long the loop may stall while setpoints are streamed."""
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
DECIDER: Final = "decider"
"""The name of the loop, as a part."""


class Failure(NamedTuple):
    """A part of the companion that has died."""

    part: str
    error: str


@final
class Gate:
    """The session's only way to the link.  Once shut it stays shut."""

    def __init__(
        self, link: Link, clock: Clock, signed: Callable[[list[bytes]], list[bytes]] = list
    ) -> None:
        """signed: signs the watchdog's frames, for a link whose peer demands it."""
        self._link, self._clock, self._signed = link, clock, signed
        self._lock = threading.Lock()
        self.is_shut = False
        self._streamed_s = -math.inf

    def stall_limit_s(self) -> float:
        """How long the loop may stall now."""
        return STALL_S if self._clock() - self._streamed_s < STREAMING_S else IDLE_STALL_S

    def send(self, frames: list[bytes], since_s: float | None = None) -> list[int]:
        """Send frames; the numbers of those that were not sent: all if the gate is shut.

        since_s: when what they answer has arrived.  After a delay several positions are answered at
        once: only the last setpoint counts, and a stale one not at all.  None: the vehicle waits,
        and all are sent.
        """
        setpoints = [number for number, frame in enumerate(frames) if is_setpoint(frame)]
        unsent = list[int]()
        with self._lock:
            if self.is_shut:
                return [*range(len(frames))]
            if since_s is not None:
                is_stale = self._clock() - since_s > SETPOINT_AGE_S
                unsent = setpoints if is_stale else setpoints[:-1]
            self._link.send([frame for at, frame in enumerate(frames) if at not in unsent])
        if len(unsent) < len(setpoints):
            self._streamed_s = self._clock()
        return unsent

    def shut(self) -> None:
        """Shut: no frame of the session is sent from now on, except one being sent just now."""
        self.is_shut = True

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
    """Looks after the loop from another thread: that of `watch`."""

    def __init__(
        self,
        gate: Gate,
        session: Session,
        *,
        clock: Clock,
        on_failure: Callable[[Failure, list[bytes]], None],
        watches_time: bool = True,
    ) -> None:
        """on_failure: told of a death, and of the frames that are sent on it.

        watches_time: False in lockstep, where nothing depends on wall time.
        """
        self.failure: Failure | None = None
        self.reserve: list[bytes] = []
        """Hold frames, sent if none can be made when needed."""
        self._gate, self._session, self._clock = gate, session, clock
        self._on_failure, self._watches_time = on_failure, watches_time
        self._error = ""
        self._limit_s, self._beats = math.inf, 0
        self._seen, self._seen_s, self._still_s = 0, math.nan, 0.0

    def beat(self) -> None:
        """The loop is alive; how soon it has to beat again depends on whether it streams."""
        if self._watches_time:
            self._limit_s = self._gate.stall_limit_s()
            self._beats += 1

    def died(self, error: str) -> None:
        """The loop ends with an error."""
        self._gate.shut()
        self._error = error

    def watch(
        self,
        ended: threading.Event,
        enough: Callable[[], bool] = lambda: False,
        longest_s: float = math.inf,
    ) -> None:
        """Watch the loop until it has ended; less if that is enough, or takes too long."""
        self._seen_s, until_s = self._clock(), time.monotonic() + longest_s
        while not (ended.wait(_TICK_S) or enough() or time.monotonic() > until_s):
            self._look()
        if self._error:
            self._hold(self._error)

    def _look(self) -> None:
        now_s = self._clock()
        # A computer that was asleep, or too busy to look, says nothing about the loop.
        more_s = min(now_s - self._seen_s, 2.0 * _TICK_S)
        self._still_s = 0.0 if self._seen != self._beats else self._still_s + more_s
        self._seen, self._seen_s = self._beats, now_s
        if self._still_s > self._limit_s:
            self._hold(f"it has stood still for {self._still_s:.1f} s")

    def _hold(self, error: str) -> None:
        """Put the vehicle on hold, once; the session is notified after its frames were made."""
        if self.failure is not None:
            return
        self._gate.shut()
        self.failure = Failure(DECIDER, error)
        try:
            frames = self._session.hold_frames()
        except Exception:  # noqa: BLE001 - the session is what may have died
            frames = self.reserve
        words: list[bytes] = []
        with contextlib.suppress(Exception):  # that it holds is what counts
            words = self._session.final_text(f"the {DECIDER} has died ({error})")
        self._on_failure(self.failure, [*frames, *words])
        for wait_s in _HOLD_AGAIN_S:
            time.sleep(wait_s)
            if frames or words:
                with contextlib.suppress(Exception):  # the next attempt is not given up for it
                    self._gate.send_last([*frames, *words])
            words = []  # once
