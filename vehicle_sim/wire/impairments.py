"""What a bad link does to frames: they get lost, late, doubled or overtaken.

One object for each link and direction, in the time of the simulation, seeded.
"""

import heapq
from typing import Generic, TypeVar, final

import numpy as np

from vehicle_sim.faults import LinkConditions

MAX_FRAMES = 20_000
"""Waiting at once; what comes on top is lost."""


_Frame = TypeVar("_Frame")


@final
class Impairments(Generic[_Frame]):
    """One direction of one link."""

    def __init__(self, rng: np.random.Generator, *, link: int = 0, to_vehicle: bool = True) -> None:
        self._rng, self._link, self._to_vehicle = rng, link, to_vehicle
        self._conditions = LinkConditions()
        self._waiting: list[tuple[int, int, _Frame]] = []
        """Heap of time, number, frame."""
        self._number = self._last_us = 0

    def impair(self, conditions: LinkConditions) -> None:
        """What is wrong from now on; what is on its way already stays on its way."""
        way = conditions.way != ("from_vehicle" if self._to_vehicle else "to_vehicle")
        concerned = way and conditions.only in (-1, self._link)
        self._conditions = conditions if concerned else LinkConditions()

    def push(self, now_us: int, frame: _Frame) -> None:
        """A frame sets out: it arrives in order, unless the jitter lets one overtake another."""
        wrong = self._conditions
        if wrong.off or self._happens(wrong.lost):
            return
        for _ in range(1 + self._happens(wrong.duplicated)):
            if len(self._waiting) == MAX_FRAMES:
                return
            time_us = now_us + wrong.delay_us
            if wrong.jitter_us:
                time_us += int(self._rng.random() * wrong.jitter_us)
            else:
                time_us = self._last_us = max(time_us, self._last_us)
            self._number += 1
            heapq.heappush(self._waiting, (time_us, self._number, frame))

    def pop(self, now_us: int) -> list[_Frame]:
        """What has arrived by now, in order."""
        frames = list[_Frame]()
        while self._waiting and self._waiting[0][0] <= now_us:
            frames.append(heapq.heappop(self._waiting)[2])
        return frames

    def _happens(self, share: float) -> bool:
        return share > 0.0 and self._rng.random() < share
