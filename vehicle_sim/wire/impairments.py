"""What a bad link does to frames: they get lost, late, doubled, overtaken or broken.

One object for each link and direction, in the time of the simulation, seeded.
"""

import heapq
from typing import final

import numpy as np

from vehicle_sim.faults import LinkConditions

MAX_FRAMES = 20_000
"""Waiting at once; what comes on top is lost."""
_HELD_MOST_US = 500_000
"""A frame that is to be overtaken goes on after this even if none comes after it."""
_WRONG_BITS_MOST = 3


@final
class Impairments:
    """One direction of one link."""

    def __init__(self, rng: np.random.Generator, *, link: int = 0, to_vehicle: bool = True) -> None:
        self._rng, self._link, self._to_vehicle = rng, link, to_vehicle
        self._conditions = LinkConditions()
        self._waiting: list[tuple[int, int, bytes]] = []
        """Heap of time, number, frame."""
        self._held: list[bytes] = []
        """Frames that the next one overtakes."""
        self._number = self._last_us = self._held_us = 0

    def impair(self, conditions: LinkConditions) -> None:
        """What is wrong from now on; what is on its way already stays on its way."""
        way = conditions.to_vehicle if self._to_vehicle else conditions.from_vehicle
        concerned = way and conditions.only in (-1, self._link)
        self._conditions = conditions if concerned else LinkConditions()

    def push(self, now_us: int, frame: bytes) -> None:
        """A frame, or a whole datagram, sets out."""
        wrong = self._conditions
        if wrong.off or self._happens(wrong.lost):
            return
        for _ in range(1 + self._happens(wrong.duplicated)):
            sent = self._corrupted(frame) if frame and self._happens(wrong.corrupted) else frame
            if self._happens(wrong.reordered):
                self._held_us = self._held_us if self._held else now_us
                self._held.append(sent)
            else:
                self._enqueue(now_us, [sent, *self._held])

    def pop(self, now_us: int) -> list[bytes]:
        """What has arrived by now, in order."""
        if self._held and now_us >= self._held_us + _HELD_MOST_US:
            self._enqueue(self._held_us + _HELD_MOST_US, [*self._held])
        frames = list[bytes]()
        while self._waiting and self._waiting[0][0] <= now_us:
            frames.append(heapq.heappop(self._waiting)[2])
        return frames

    def _enqueue(self, now_us: int, frames: list[bytes]) -> None:
        """They arrive in order, unless the jitter lets one overtake another."""
        self._held.clear()
        for frame in frames[: MAX_FRAMES - len(self._waiting)]:
            time_us = now_us + self._conditions.delay_us
            if jitter_us := self._conditions.jitter_us:
                time_us += int(self._rng.random() * jitter_us)
            else:
                time_us = self._last_us = max(time_us, self._last_us)
            self._number += 1
            heapq.heappush(self._waiting, (time_us, self._number, frame))

    def _corrupted(self, frame: bytes) -> bytes:
        """A few bits of it turned over."""
        wrong = bytearray(frame)
        for bit in self._rng.integers(
            8 * len(wrong), size=self._rng.integers(_WRONG_BITS_MOST) + 1
        ):
            wrong[bit // 8] ^= 1 << bit % 8
        return bytes(wrong)

    def _happens(self, share: float) -> bool:
        return share > 0.0 and self._rng.random() < share
