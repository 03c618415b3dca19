"""What a bad link does to frames: they get lost, late, doubled or overtaken.

In the time of the simulation, seeded.
"""

import heapq
from collections import defaultdict
from typing import Generic, TypeVar, final

import numpy as np

from vehicle_sim.faults import LinkConditions

MAX_FRAMES = 20_000
"""Waiting at once; what comes on top is lost."""
_Frame = TypeVar("_Frame")


@final
class Impairments(Generic[_Frame]):
    """One direction of all links."""

    def __init__(self, rng: np.random.Generator, *, to_vehicle: bool = True) -> None:
        self._rng, self._to_vehicle = rng, to_vehicle
        self._conditions = LinkConditions()
        self._waiting: list[tuple[int, int, int, _Frame]] = []
        """Heap of time, number, link, frame."""
        self._number, self._last_us = 0, defaultdict[int, int](int)
        """Of the newest frame; and by link when the last one in order arrives."""

    def impair(self, conditions: LinkConditions) -> None:
        """What is wrong from now on; what is on its way already stays on its way."""
        concerned = conditions.way != ("from_vehicle" if self._to_vehicle else "to_vehicle")
        self._conditions = conditions if concerned else LinkConditions()

    def push(self, now_us: int, link: int, frame: _Frame) -> None:
        """A frame sets out: it arrives in order, unless the jitter lets one overtake another."""
        wrong = self._conditions
        if wrong.only not in (-1, link):
            wrong = LinkConditions()
        if wrong.off or self._happens(wrong.lost):
            return
        for _ in range(1 + self._happens(wrong.duplicated)):
            if len(self._waiting) == MAX_FRAMES:
                return
            time_us = now_us + wrong.delay_us
            if wrong.jitter_us:
                time_us += int(self._rng.random() * wrong.jitter_us)
            else:
                time_us = self._last_us[link] = max(time_us, self._last_us[link])
            self._number += 1
            heapq.heappush(self._waiting, (time_us, self._number, link, frame))

    def pop(self, now_us: int) -> list[tuple[int, _Frame]]:
        """Link and frame of what has arrived by now, in order."""
        arrived = list[tuple[int, _Frame]]()
        while self._waiting and self._waiting[0][0] <= now_us:
            arrived.append(heapq.heappop(self._waiting)[2:])
        return arrived

    def _happens(self, share: float) -> bool:
        return share > 0.0 and self._rng.random() < share
