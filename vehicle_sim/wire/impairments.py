"""Link impairments: loss, delay, duplication, reordering and corruption of frames.

One object for each link and direction, in the time of the simulation, seeded.
"""

import heapq
from collections.abc import Sequence
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
class Impairments:
    """One direction of one link."""

    def __init__(self, rng: np.random.Generator, *, link: int = 0, to_vehicle: bool = True) -> None:
        self._rng, self._link, self._to_vehicle = rng, link, to_vehicle
        self._conditions = self._clear = LinkConditions()
        self._waiting: list[tuple[int, int, bytes]] = []
        """Heap of time, number, frame."""
        self._held: list[tuple[int, int, bytes]] = []
        """Frames that are to be overtaken: by which number, and when they leave at the latest."""
        self._number = self._order = 0
        """Of the newest frame that set out, and of the newest that waits."""
        self._last_us = 0
        self._drawn: list[float] = []

    @property
    def conditions(self) -> LinkConditions:
        """What is wrong from now on; what is on its way already stays on its way."""
        return self._conditions

    @conditions.setter
    def conditions(self, conditions: LinkConditions) -> None:
        way = conditions.to_vehicle if self._to_vehicle else conditions.from_vehicle
        concerned = way and (not conditions.mask or bool(conditions.mask >> self._link & 1))
        self._conditions = conditions if concerned else self._clear

    def push(self, now_us: int, frame: bytes) -> None:
        """A frame, or a whole datagram, sets out."""
        wrong = self._conditions
        self._number += 1
        if not (wrong.off or self._happens(wrong.lost)):
            for _ in range(2 if self._happens(wrong.duplicated) else 1):
                sent = self._corrupted(frame) if frame and self._happens(wrong.corrupted) else frame
                if self._happens(wrong.reordered):
                    behind = self._number + 1 + int(self._draw() * _OVERTAKEN_BY_MOST)
                    self._held.append((behind, now_us + _HELD_MOST_US, sent))
                else:
                    self._enqueue(now_us, sent)
        self._let_go(now_us)

    def pop(self, now_us: int) -> Sequence[bytes]:
        """What has arrived by now, in order."""
        self._let_go(now_us)
        frames = list[bytes]()
        while self._waiting and self._waiting[0][0] <= now_us:
            frames.append(heapq.heappop(self._waiting)[2])
        return frames

    def _let_go(self, now_us: int) -> None:
        """Of the held ones those that have been overtaken, or have waited too long."""
        held, self._held = self._held, []
        for each in held:
            behind, until_us, frame = each
            if self._number >= behind or now_us >= until_us:
                self._enqueue(min(now_us, until_us), frame)
            else:
                self._held.append(each)

    def _enqueue(self, now_us: int, frame: bytes) -> None:
        """Arrives in order, unless the jitter lets it overtake."""
        if len(self._waiting) >= MAX_FRAMES:
            return
        time_us = now_us + self._conditions.delay_us
        if self._conditions.jitter_us:
            time_us += int(self._draw() * self._conditions.jitter_us)
        else:
            time_us = self._last_us = max(time_us, self._last_us)
        self._order += 1
        heapq.heappush(self._waiting, (time_us, self._order, frame))

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
        """From 0 to below 1; drawn in blocks, which is faster."""
        self._drawn = self._drawn or self._rng.random(_BLOCK).tolist()
        return self._drawn.pop()
