"""Link impairments: loss, delay, duplication, reordering and corruption of frames.

One object for each link and direction, in the time of the simulation, seeded.  While `active` is
False frames need not pass through here at all.
"""

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from vehicle_sim.faults.conditions import LinkConditions

MAX_FRAMES = 20_000
"""Waiting at once; what comes on top is lost."""
_HELD_MOST_US = 500_000
"""A frame that is to be overtaken goes on after this even if none comes after it."""
_OVERTAKEN_BY_MOST = 3
_WRONG_BITS_MOST = 3
_BLOCK = 1024
_NEVER_US = 2**63 - 1
_NOTHING: tuple[bytes, ...] = ()


@final
@dataclass(slots=True)
class _Held:
    """A frame that is to be overtaken by so many still, and when it leaves at last."""

    left: int
    until_us: int
    frame: bytes


@final
class Impairments:
    """One direction of one link."""

    def __init__(self, rng: np.random.Generator, *, link: int = 0, to_vehicle: bool = True) -> None:
        self._rng = rng
        self._link = link
        self._to_vehicle = to_vehicle
        self._conditions = LinkConditions()
        self._clear = True
        self._uniform: list[float] = []
        self._waiting: list[tuple[int, int, bytes]] = []
        """Heap of time, number, frame."""
        self._held: list[_Held] = []
        self._number = 0
        self._last_us = 0
        self.active = False
        """Whether frames have to pass through here now."""
        self.due_us = _NEVER_US
        """When the next frame comes out."""
        self.lost = 0
        """Frames that never came out."""

    @property
    def conditions(self) -> LinkConditions:
        """What is wrong from now on; what is on its way already stays on its way."""
        return self._conditions

    @conditions.setter
    def conditions(self, conditions: LinkConditions) -> None:
        way = conditions.to_vehicle if self._to_vehicle else conditions.from_vehicle
        concerned = way and (not conditions.mask or bool(conditions.mask >> self._link & 1))
        self._conditions = conditions
        self._clear = not (concerned and conditions.any)
        self._find_due()

    def push(self, now_us: int, frame: bytes) -> None:
        """A frame, or a whole datagram, sets out."""
        if self._clear:
            self._enqueue(now_us, frame)
        elif self._conditions.off or self._happens(self._conditions.lost):
            self.lost += 1
        else:
            self._impair(now_us, frame)
        if self._held:
            self._overtake(now_us)
        self._find_due()

    def pop(self, now_us: int) -> Sequence[bytes]:
        """What has arrived by now, in order."""
        if now_us < self.due_us:
            return _NOTHING
        if self._held:
            self._let_go(now_us, lambda held: held.until_us <= now_us)
        frames = list[bytes]()
        while self._waiting and self._waiting[0][0] <= now_us:
            frames.append(heapq.heappop(self._waiting)[2])
        self._find_due()
        return frames

    def _impair(self, now_us: int, frame: bytes) -> None:
        conditions = self._conditions
        copies = 2 if self._happens(conditions.duplicated) else 1
        for _ in range(copies):
            sent = frame
            if frame and self._happens(conditions.corrupted):
                sent = self._corrupted(frame)
            if self._happens(conditions.reordered) and len(self._held) < MAX_FRAMES:
                overtakers = 1 + int(self._draw() * _OVERTAKEN_BY_MOST)
                # Its own push counts as one of those that overtake it.
                self._held.append(_Held(overtakers + 1, now_us + _HELD_MOST_US, sent))
            else:
                self._enqueue(now_us, sent)

    def _enqueue(self, now_us: int, frame: bytes) -> None:
        """Arrives in order, unless the jitter lets it overtake."""
        if len(self._waiting) >= MAX_FRAMES:
            self.lost += 1
            return
        conditions = self._conditions
        time_us = now_us if self._clear else now_us + conditions.delay_us
        if not self._clear and conditions.jitter_us:
            time_us += int(self._draw() * conditions.jitter_us)
        else:
            time_us = self._last_us = max(time_us, self._last_us)
        self._number += 1
        heapq.heappush(self._waiting, (time_us, self._number, frame))

    def _overtake(self, now_us: int) -> None:
        for held in self._held:
            held.left -= 1
        self._let_go(now_us, lambda held: held.left <= 0)

    def _let_go(self, now_us: int, goes: Callable[[_Held], bool]) -> None:
        gone = [held for held in self._held if goes(held)]
        if gone:
            self._held = [held for held in self._held if not goes(held)]
        for held in gone:
            self._enqueue(min(now_us, held.until_us), held.frame)

    def _find_due(self) -> None:
        times_us = [held.until_us for held in self._held]
        if self._waiting:
            times_us.append(self._waiting[0][0])
        self.due_us = min(times_us, default=_NEVER_US)
        self.active = not self._clear or self.due_us != _NEVER_US

    def _corrupted(self, frame: bytes) -> bytes:
        """A few bits of it turned over."""
        wrong = bytearray(frame)
        for _ in range(1 + int(self._draw() * _WRONG_BITS_MOST)):
            bit = int(self._draw() * len(wrong) * 8)
            wrong[bit // 8] ^= 1 << bit % 8
        return bytes(wrong)

    def _happens(self, share: float) -> bool:
        return share > 0.0 and self._draw() < share

    def _draw(self) -> float:
        """From 0 to below 1."""
        if not self._uniform:
            self._uniform = self._rng.random(_BLOCK).tolist()
        return self._uniform.pop()
