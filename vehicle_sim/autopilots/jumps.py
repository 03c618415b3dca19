"""The order of a mission's items: one after the other, but for its jumps."""

import math
from collections.abc import Iterator, Sequence
from typing import final

from vehicle_sim.plans import PlanItem

DO_JUMP = 177


@final
class Jumps:
    """How often each DO_JUMP has been taken.  Mutable."""

    def __init__(self, first: int) -> None:
        self._first = first
        """Number of the first item that may be jumped to."""
        self._taken: dict[int, int] = {}

    def forget(self) -> None:
        """They count from 0 again."""
        self._taken.clear()

    def walk(
        self, items: Sequence[PlanItem], number: int, most: int
    ) -> Iterator[tuple[int, PlanItem]]:
        """So many items at most, from this one on, with their numbers."""
        for _ in range(most):
            if number >= len(items):
                return
            yield number, items[number]
            number = self._after(items, number)

    def _after(self, items: Sequence[PlanItem], number: int) -> int:
        target, times = items[number].parameters[:2]
        if items[number].command != DO_JUMP or not math.isfinite(target + times):
            return number + 1
        taken = self._taken.get(number, 0)
        if not self._first <= target < len(items) or 0.0 <= times <= taken:
            return number + 1
        self._taken[number] = taken + 1
        return int(target)
