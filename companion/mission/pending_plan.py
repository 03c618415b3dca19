"""The plan that was asked for: it counts from when it is due, however soon it is there."""

import math
from typing import final

from companion.mission.events import PlannerDied, PlanReady
from companion.planner.request import PlanOutcome


@final
class PendingPlan:
    """At most one question to the planner, and its answer."""

    def __init__(self) -> None:
        self.due_s = math.inf
        """When the answer counts; inf: nothing was asked."""
        self._answer: PlanOutcome | PlannerDied | None = None
        self._late_told = False

    def ask(self, due_s: float) -> None:
        """Another question; the answer to the one before is not wanted any more."""
        self.due_s, self._answer, self._late_told = due_s, None, False

    def forget(self) -> None:
        """No question."""
        self.ask(math.inf)

    def deliver(self, answer: PlanOutcome | PlannerDied, now_s: float) -> None:
        """The answer; that there will be none counts at once."""
        self._answer = answer
        if isinstance(answer, PlannerDied):
            self.due_s = min(self.due_s, now_s)

    def is_missing(self, at_s: float) -> bool:
        """Whether there is no answer by then though it is due."""
        return self._answer is None and at_s >= self.due_s

    def tell_late(self) -> bool:
        """Whether it is news that the answer is late."""
        news, self._late_told = not self._late_told, True
        return news

    def take(self, now_s: float) -> PlanReady | PlannerDied | None:
        """The answer as an event, once it is due."""
        answer = self._answer
        if answer is None or now_s < self.due_s:
            return None
        self._answer, self.due_s = None, math.inf
        if isinstance(answer, PlannerDied):
            return answer
        return PlanReady(time_s=now_s, outcome=answer)
