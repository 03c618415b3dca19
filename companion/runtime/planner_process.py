"""The planner's own process: no plan ever delays a setpoint, and one that hangs is killed.

In the same process it would: numba holds the interpreter lock for seconds while it compiles, and
what guidance and search do between their compiled parts holds it for some milliseconds each.
The loop asks, and looks in each of its turns whether there is an answer.

Of a question's map only what has changed since the last question is sent: that of a near mission
has 28 MB, which take longer than a plan.  So a thread sends it.
"""

import contextlib
import gc
import math
import multiprocessing
import os
import select
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Final, final

from companion.planner.request import PlanOutcome, PlanRequest
from companion.planning import plan
from companion.runtime.compiler import load_kernel
from companion.runtime.processes import end_with_parent
from companion.world.known_map import KnownMap, MapNews

PlanFunction = Callable[[PlanRequest, Callable[[], bool]], PlanOutcome]
"""Computes a plan; the second argument tells it when to stop searching."""
Answer = tuple[PlanOutcome, float]
"""A plan, and how long it took, in seconds."""
_SPAWN: Final = multiprocessing.get_context("spawn")  # threads and fork do not mix
_ENDS_S: Final = 1.0
"""For the exit code of a process whose pipe has ended."""
_SEARCHING: Final = 0.8  # of T: the rest is for the proof
_STARTS_S: Final = 300.0  # a slow computer may compile it first
_SLACK_S: Final = 5.0  # on top of T: the plan is late long before, and dead only now


class PlannerEndedError(Exception):
    """The planner process has ended or failed."""


@final
class PlannerHere:
    """Plans in the caller's thread, for a vehicle that waits; errors are passed on."""

    is_ready = True

    def __init__(self, planner: PlanFunction) -> None:
        self._planner = planner
        self._answer: Answer | None = None

    def ask(self, request: PlanRequest) -> None:
        """Compute a plan."""
        began_s = time.perf_counter()
        outcome = self._planner(request, lambda: False)
        self._answer = outcome, time.perf_counter() - began_s

    def answer(self, _wait_s: float = 0.0) -> Answer | None:
        """It, once."""
        answer, self._answer = self._answer, None
        return answer

    def close(self) -> None:
        """There is nothing to let go of."""


@final
class PlannerProcess:
    """Plans as `plan` does, in another process; of the plans asked for only the newest counts."""

    def __init__(
        self,
        planner: PlanFunction = plan,
        prepare: Callable[[], object] = load_kernel,
        *,
        hurries: bool = True,
    ) -> None:
        """prepare: called in the process before it is ready; both can be pickled.

        hurries: whether a plan has to be there in time, by the clock.
        """
        self._does, self._hurries = (planner, prepare), hurries
        self.process: SpawnProcess | None = None
        """Once it is started."""
        self.is_ready = False
        self._map_sent: int | None = None
        """The name of the map that it has."""
        self._asked: PlanRequest | None = None
        """What is to be sent once it has answered the last one."""
        self._is_busy = False
        self._due_s = math.inf
        """When it has to be ready, or to have answered."""

    def ask(self, request: PlanRequest) -> None:
        """Have a plan computed; the search for an earlier one stops."""
        self._asked = request
        if self._is_busy and not self._sender.is_alive():
            with contextlib.suppress(OSError):  # then there is no answer
                self._pipe.send(None)
        self._send()

    def answer(self, wait_s: float = 0.0) -> Answer | None:
        """The plan that was asked for last, if it is there in time; starts the process.

        PlannerEndedError if it does not come up, has failed or ended, or is overdue.
        """
        try:
            if self.process is None:
                self._start()
            if not select.select([self._pipe], (), (), wait_s)[0]:
                answer: Answer | str | None = "it has stood still"
                if time.monotonic() <= self._due_s:
                    return None
            else:
                answer = self._pipe.recv()
        except Exception as error:  # noqa: BLE001 - however the pipe ends, the child is of no use
            raise PlannerEndedError(self._how_it_ended(error)) from None
        if isinstance(answer, str):
            raise PlannerEndedError(answer)
        self.is_ready, self._is_busy, self._due_s = True, False, math.inf
        self._send()
        return None if self._is_busy else answer

    def close(self) -> None:
        """Kill the process."""
        if self.process is not None and self.process.pid is not None:
            self.process.kill()
            self.process.join()

    def _start(self) -> None:
        self._pipe, theirs = _SPAWN.Pipe()
        process = _SPAWN.Process(target=_main, args=(theirs, *self._does), daemon=True)
        # Ctrl-C is this process's to decide about, from the child's beginning.  Before its first
        # child multiprocessing starts a process that would let it through again.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            theirs.close()
        self.process, self._due_s = process, time.monotonic() + _STARTS_S

    def _send(self) -> None:
        """Send what is asked for to a process that has nothing to do."""
        if self._asked is None or self._is_busy or not self.is_ready:
            return
        request, self._asked, self._is_busy = self._asked, None, True
        searching_s = _SEARCHING * request.time_s if self._hurries else math.inf
        self._due_s = time.monotonic() + searching_s / _SEARCHING + _SLACK_S
        news, self._map_sent = MapNews.of(request.known, self._map_sent), request.known.name

        def send() -> None:
            with contextlib.suppress(OSError):  # then there is no answer
                self._pipe.send((replace(request, known=news.part), news, searching_s))

        self._sender = threading.Thread(target=send, name="question", daemon=True)
        self._sender.start()

    def _how_it_ended(self, error: Exception) -> str:
        if self.process is None:
            return str(error)
        self.process.join(_ENDS_S)
        code = self.process.exitcode
        how = f"exit code {code}"
        if code is None:
            how = "it says nothing that can be read"
        elif code < 0:
            with contextlib.suppress(ValueError):
                how = signal.Signals(-code).name
        return f"its process has ended ({how})"


def _main(pipe: Connection, planner: PlanFunction, prepare: Callable[[], object]) -> None:
    """In the child: answer requests until the parent has ended.

    It says None once it is ready, and of each request the answer, or why there is none.
    """
    for number in (signal.SIGINT, signal.SIGTERM):  # it ends with its parent, who says farewell
        signal.signal(number, signal.SIG_IGN)
    os.dup2(2, 1)  # what is printed must not mix with what the parent says to machines
    end_with_parent()
    prepare()
    gc.collect()
    gc.freeze()  # looking through what numba has loaded would hold a plan up for 0.2 s
    known: KnownMap | None = None
    began_s = searching_s = 0.0

    def enough() -> bool:
        """Whether the time is over, or the parent says that nobody waits for the answer."""
        is_over = time.perf_counter() - began_s > searching_s
        return is_over or bool(select.select([pipe], (), (), 0.0)[0])

    with contextlib.suppress(EOFError, OSError):
        pipe.send(None)
        while True:
            question = pipe.recv()
            if question is None:  # it came too late to stop anything
                continue
            request, news, searching_s = question
            known, began_s = news.after(known), time.perf_counter()
            try:
                outcome = planner(replace(request, known=known), enough)
            except Exception as error:  # noqa: BLE001 - the parent puts the vehicle on hold
                pipe.send(f"{type(error).__name__}: {error}")
            else:
                pipe.send((outcome, time.perf_counter() - began_s))
