"""The pending plan: it takes effect when due, however early it is ready."""

import math
from typing import final

from companion.mission.events import PlannerDied, PlanReady
from companion.planner.request import PlanOutcome


@final
class PendingPlan:
    """At most one plan request, and its answer."""

    def __init__(self) -> None:
        self.due_s = math.inf
        """When the answer counts; inf: nothing was asked."""
        self._answer: PlanOutcome | PlannerDied | None = None
        self._late_told = False

    def ask(self, due_s: float) -> None:
        """A new request; the answer to the previous one is dropped, but for its planner's death."""
        if not isinstance(self._answer, PlannerDied):  # which nobody would answer
            self.due_s, self._answer, self._late_told = due_s, None, False

    def forget(self) -> None:
        """No question."""
        self.ask(math.inf)

    def deliver(self, answer: PlanOutcome | PlannerDied) -> None:
        """Take the answer; a dead planner is reported at once."""
        self._answer = answer
        if isinstance(answer, PlannerDied):
            self.due_s = -math.inf

    def is_missing(self, at_s: float) -> bool:
        """Whether the answer is due by then and missing."""
        return self._answer is None and at_s >= self.due_s

    def newly_late(self) -> bool:
        """Whether the answer is late and that was not reported yet."""
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
