"""Who computes the plans that are asked for: a thread of its own, or the caller at once."""

import queue
import time
from collections.abc import Callable
from typing import Final, Protocol, final

from companion.planner.request import PlanOutcome, PlanRequest
from companion.planning import plan
from companion.runtime.planner_process import PlanFunction, PlannerProcess
from companion.runtime.watchdog import Worker

OnAnswer = Callable[[int, PlanOutcome, float], None]
"""Told of the answer to a request, counted from 1, and how long it took, in seconds."""

_SEARCHING: Final = 0.8  # of T: the rest is for the proof
_STARTS_S: Final = 300.0  # a slow computer may compile it first
_SLACK_S: Final = 5.0  # on top of T: the plan is late long before, and dead only now
_LOOK_S: Final = 0.05  # between two looks whether the process is alive


class Planning(Protocol):
    """Answers requests; the answer to any but the newest is not waited for."""

    newest: int
    """Number of the last request."""

    def ask(self, request: PlanRequest) -> None:
        """Compute a request, now or soon."""


@final
class AtOnce(Planning):
    """Computes a plan while who asks for it waits."""

    def __init__(self, planner: PlanFunction, on_answer: OnAnswer) -> None:
        self.newest = 0
        self._planner, self._on_answer = planner, on_answer

    def ask(self, request: PlanRequest) -> None:
        """Compute it now; what the planner raises is raised."""
        self.newest += 1
        began_s = time.perf_counter()
        outcome = self._planner(request, lambda: False)
        self._on_answer(self.newest, outcome, time.perf_counter() - began_s)


@final
class PlannerWorker(Planning):
    """Computes plans in a thread, one at a time."""

    def __init__(self, planner: PlanFunction, on_answer: OnAnswer, *, lockstep: bool) -> None:
        self.part = Worker("planner")
        self.newest = 0
        self._planner, self._on_answer, self._lockstep = planner, on_answer, lockstep
        self._requests: queue.SimpleQueue[PlanRequest] = queue.SimpleQueue()
        self._left = False

    def ask(self, request: PlanRequest) -> None:
        """Compute a request; the search in progress may stop."""
        self.newest += 1
        self._requests.put(request)

    def run(self) -> None:
        """Answer requests until stopped; an exception of the planner ends it."""
        process = self._planner if isinstance(self._planner, PlannerProcess) else None
        if process is not None:
            self.part.beat(_STARTS_S)
            try:
                process.start()
            except OSError:  # no room for another process
                self._planner, process = plan, None
        self.part.idle()
        asked = 0
        while not self._left:
            try:
                request = self._requests.get(timeout=_LOOK_S)
            except queue.Empty:
                if process is not None:
                    process.check()
                continue
            asked += 1
            self.part.beat(request.time_s + _SLACK_S)
            began_s = time.perf_counter()
            outcome = self._planner(request, self._enough(request, asked, began_s))
            self.part.idle()
            self._on_answer(asked, outcome, time.perf_counter() - began_s)

    def leave(self) -> None:
        """Stop, in the middle of a plan if the planner supports it."""
        self._left = True
        if isinstance(self._planner, PlannerProcess):
            self._planner.close()

    def _enough(self, request: PlanRequest, number: int, began_s: float) -> Callable[[], bool]:
        """When to stop searching: before T is over in real time, or if obsolete."""
        due_s = began_s + _SEARCHING * request.time_s
        return lambda: (
            self._left
            or (not self._lockstep and (time.perf_counter() > due_s or number < self.newest))
        )
