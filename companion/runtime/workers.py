"""Worker threads of a flight: link readers and the planner.

Each does one thing that may block, and reports to the control loop through a queue.  In lockstep
the control loop reads and writes by itself, as the vehicle waits.
"""

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, final

from companion.planner.request import PlanOutcome, PlanRequest
from companion.planning import plan
from companion.runtime.link import Link
from companion.runtime.planner_process import PlannerEndedError, PlannerProcess
from companion.runtime.watchdog import Clock, Failure, Gate, Worker

PlanFunction = Callable[[PlanRequest, Callable[[], bool]], PlanOutcome]
"""Computes a plan; the second argument tells it when to stop searching."""

POLL_S = 0.05
_MAX_WAITING = 5000  # datagrams: what comes on top of them is as good as lost on the way
_SEARCHING = 0.8  # of T: the rest is for the proof
_PLANNER_STARTS_S = 300.0  # a slow computer may compile it first
_PLANNER_SLACK_S = 5.0  # on top of T: the plan is late long before, and dead only now


@final
class Datagram(NamedTuple):
    """Received bytes, with sender and time."""

    data: bytes
    sender: object
    at_s: float


@final
@dataclass(frozen=True, slots=True)
class PlanComputed:
    """The answer to a plan request, counted from 1."""

    number: int
    outcome: PlanOutcome
    took_s: float


@final
@dataclass(frozen=True, slots=True)
class WorkerLost:
    """A worker has died; if vital, the stream has already stopped."""

    failure: Failure
    vital: bool


@final
@dataclass(frozen=True, slots=True)
class WorkerDelayed:
    """A worker goes on that could not run for so long: the computer is busy."""

    part: str
    waited_s: float


Item = Datagram | PlanComputed | WorkerLost | WorkerDelayed


@final
class EventQueue:
    """Queue of events for the control loop, in order."""

    def __init__(self) -> None:
        self._items: queue.SimpleQueue[Item] = queue.SimpleQueue()

    def put(self, item: Item) -> None:
        """Add an item; datagrams are dropped if the queue is full."""
        if not isinstance(item, Datagram) or self._items.qsize() < _MAX_WAITING:
            self._items.put(item)

    def take(self, timeout_s: float, most: int = 64) -> list[Item]:
        """Take the queued items; if there is none, wait for the next."""
        try:
            items = [self._items.get(block=timeout_s > 0.0, timeout=timeout_s or None)]
        except queue.Empty:
            return []
        while len(items) < most and not self._items.empty():  # nobody else takes any
            items.append(self._items.get_nowait())
        return items


@final
class LinkReader:
    """Receives from the vehicle's link, with time stamps."""

    def __init__(self, link: Link, event_queue: EventQueue, gate: Gate, clock: Clock) -> None:
        self.part = Worker("reader")
        self._link, self._event_queue, self._gate, self._clock = link, event_queue, gate, clock
        self._leaving = threading.Event()

    def run(self) -> None:
        """Receive until stopped; an exception of the link ends it."""
        while not self._leaving.is_set():
            self.part.beat(self._gate.stall_limit_s())
            self.once(POLL_S)

    def once(self, timeout_s: float) -> None:
        """Wait so long for one datagram."""
        data = self._link.receive(timeout_s)
        if data is not None:
            self._event_queue.put(Datagram(data, self._link.sender, self._clock()))

    def leave(self) -> None:
        """End soon."""
        self._leaving.set()


# --- planning


@final
class PlannerWorker:
    """Computes plans, one at a time."""

    def __init__(self, planner: PlanFunction, event_queue: EventQueue, *, lockstep: bool) -> None:
        self.part = Worker("planner")
        self._planner, self._event_queue, self._lockstep = planner, event_queue, lockstep
        self._requests: queue.SimpleQueue[PlanRequest | PlannerEndedError | None] = (
            queue.SimpleQueue()
        )
        self.newest = 0
        """Number of the last request: an answer to an earlier one is not waited for."""
        self._left = False

    def ask(self, request: PlanRequest) -> None:
        """Compute a request; the search in progress may stop."""
        self.newest += 1
        self._requests.put(request)

    def run(self) -> None:
        """Answer requests until stopped; an exception of the planner ends it."""
        self._prepare()
        self.part.idle()
        asked = 0
        while (request := self._requests.get()) is not None:
            if isinstance(request, PlannerEndedError):
                raise request
            asked += 1
            self.part.beat(request.time_s + _PLANNER_SLACK_S)
            began_s = time.perf_counter()
            outcome = self._planner(request, self._enough(request, asked, began_s))
            self.part.idle()
            self._event_queue.put(PlanComputed(asked, outcome, time.perf_counter() - began_s))

    def leave(self) -> None:
        """Stop, in the middle of a plan if the planner supports it."""
        self._left = True
        self._requests.put(None)
        if isinstance(self._planner, PlannerProcess):
            self._planner.close()

    def _prepare(self) -> None:
        if isinstance(self._planner, PlannerProcess):
            self.part.beat(_PLANNER_STARTS_S)
            self._planner.on_end = self._requests.put
            try:
                self._planner.start()
            except OSError:  # no room for another process
                self._planner = plan

    def _enough(self, request: PlanRequest, number: int, began_s: float) -> Callable[[], bool]:
        """When to stop searching: before T is over in real time, or if obsolete."""
        due_s = began_s + _SEARCHING * request.time_s
        return lambda: (
            self._left
            or (not self._lockstep and (time.perf_counter() > due_s or number < self.newest))
        )
