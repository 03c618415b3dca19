"""Link impairments: loss, delay, duplication, reordering and corruption of frames.

One object for each link and direction, in the time of the simulation, seeded.  While `active` is
False frames need not pass through here at all.
"""

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from vehicle_sim.conditions import LinkConditions

MAX_FRAMES = 20_000
"""Waiting at once; what comes on top is lost."""
_HELD_MOST_US = 500_000
"""A frame that is to be overtaken goes on after this even if none comes after it."""
_OVERTAKEN_BY_MOST = 3
_WRONG_BITS_MOST = 3
_BLOCK = 1024


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
        self._rng, self._link, self._to_vehicle = rng, link, to_vehicle
        self._conditions = LinkConditions()
        self._clear = True
        self._uniform: list[float] = []
        self._waiting: list[tuple[int, int, bytes]] = []
        """Heap of time, number, frame."""
        self._held: list[_Held] = []
        self._number = 0
        self._last_us = 0
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

    @property
    def active(self) -> bool:
        """Whether frames have to pass through here now."""
        return not self._clear or bool(self._waiting or self._held)

    def push(self, now_us: int, frame: bytes) -> None:
        """A frame, or a whole datagram, sets out."""
        if self._clear:
            self._enqueue(now_us, frame)
        elif self._conditions.off or self._happens(self._conditions.lost):
            self.lost += 1
        else:
            for _ in range(2 if self._happens(self._conditions.duplicated) else 1):
                self._impair(now_us, frame)
        for held in self._held:
            held.left -= 1
        self._let_go(now_us, lambda held: held.left <= 0)

    def pop(self, now_us: int) -> Sequence[bytes]:
        """What has arrived by now, in order."""
        self._let_go(now_us, lambda held: held.until_us <= now_us)
        frames = list[bytes]()
        while self._waiting and self._waiting[0][0] <= now_us:
            frames.append(heapq.heappop(self._waiting)[2])
        return tuple(frames)

    def _impair(self, now_us: int, frame: bytes) -> None:
        if frame and self._happens(self._conditions.corrupted):
            frame = self._corrupted(frame)
        if self._happens(self._conditions.reordered) and len(self._held) < MAX_FRAMES:
            overtakers = 1 + int(self._draw() * _OVERTAKEN_BY_MOST)
            # Its own push counts as one of those that overtake it.
            self._held.append(_Held(overtakers + 1, now_us + _HELD_MOST_US, frame))
        else:
            self._enqueue(now_us, frame)

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

    def _let_go(self, now_us: int, goes: Callable[[_Held], bool]) -> None:
        if not self._held:
            return
        gone = [held for held in self._held if goes(held)]
        self._held = [held for held in self._held if not goes(held)]
        for held in gone:
            self._enqueue(min(now_us, held.until_us), held.frame)

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
