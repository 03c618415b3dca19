"""The planner's own process: no plan ever delays a setpoint, and one that hangs is killed.

In the same process it would: numba holds the interpreter lock for seconds while it compiles, and
what guidance and search do between their compiled parts holds it for some milliseconds each.
A thread of the companion waits for the answer (`PlannerWorker`).

Of a question's map only what has changed since the last question is sent: that of a near mission
has 28 MB, which take longer than a plan.  Arrays follow the pickle, which would hold the
interpreter lock meanwhile.
"""

import contextlib
import gc
import multiprocessing
import os
import pickle
import queue
import signal
import threading
import time
from collections.abc import Callable
from ctypes import c_int64
from dataclasses import replace
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Final, final

from companion.planner.request import PlanOutcome, PlanRequest
from companion.planning import plan
from companion.runtime.compiler import load_kernel, load_libraries
from companion.runtime.processes import end_with_parent
from companion.runtime.watchdog import Worker
from companion.world.known_map import KnownMap, MapNews

PlanFunction = Callable[[PlanRequest, Callable[[], bool]], PlanOutcome]
"""Computes a plan; the second argument tells it when to stop searching."""
OnAnswer = Callable[[int, PlanOutcome, float], None]
"""Told of the answer to a request, by the request's number, and how long it took, in seconds."""
_SPAWN: Final = multiprocessing.get_context("spawn")  # threads and fork do not mix
_LOOK_S = 0.02
_ENDS_S = 1.0
"""For the exit code of a process whose pipe has ended."""
_READY = "ready"
_SEARCHING: Final = 0.8  # of T: the rest is for the proof
_STARTS_S: Final = 300.0  # a slow computer may compile it first
_SLACK_S: Final = 5.0  # on top of T: the plan is late long before, and dead only now
_ALIVE_S: Final = 0.05  # between two looks whether the process is alive


class PlannerEndedError(Exception):
    """The planner process has ended or failed."""


@final
class PlannerProcess:
    """Answers plan requests as `plan` does, from another process."""

    def __init__(
        self, planner: PlanFunction = plan, prepare: Callable[[], object] = load_kernel
    ) -> None:
        """prepare: called in the process before it is ready; both can be pickled."""
        self._does = planner, prepare
        self._enough = _SPAWN.RawValue(c_int64, -1)
        """The number of the plan whose search is to stop."""
        self._child: SpawnProcess | None = None
        self._pipe: Connection | None = None
        self.is_ready = False
        self._told: int | None = None
        """The name of the map that it has."""

    @property
    def pid(self) -> int | None:
        """Of the process, once there is one."""
        return None if self._child is None else self._child.pid

    def start(self) -> None:
        """Start the process and wait until it is prepared; PlannerEndedError if it fails."""
        if self._child is None:
            self._pipe, theirs = _SPAWN.Pipe()
            self._child = _SPAWN.Process(
                target=_main, args=(theirs, self._enough, *self._does), daemon=True
            )
            # Ctrl-C is this process's to decide about, from the child's beginning.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                self._child.start()
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
                theirs.close()
        if not self.is_ready:
            self._answer(lambda: None)
            self.is_ready = True

    def __call__(self, request: PlanRequest, stop: Callable[[], bool]) -> PlanOutcome:
        """One plan; PlannerEndedError if the process does not survive it."""
        self.start()
        assert self._pipe is not None
        news, self._told = MapNews.of(request.known, self._told), request.known.name
        arrays, told = list[pickle.PickleBuffer](), (replace(request, known=news.part), news)
        text = pickle.dumps(told, pickle.HIGHEST_PROTOCOL, buffer_callback=arrays.append)
        with contextlib.suppress(OSError):  # then there is no answer
            self._pipe.send((len(arrays), text))
            for array in arrays:
                self._pipe.send_bytes(array.raw())

        def look() -> None:
            if stop():
                self._enough.value = request.plan_id

        return self._answer(look)

    def check(self) -> None:
        """PlannerEndedError if the process has ended."""
        if self._child is not None and not self._child.is_alive():
            raise self._ended()

    def close(self) -> None:
        """Kill the process."""
        if self._child is not None and self._child.pid is not None:
            self._child.kill()
            self._child.join()

    def _answer(self, look: Callable[[], None]) -> PlanOutcome:
        assert self._pipe is not None
        try:
            while not self._pipe.poll(_LOOK_S):
                look()
            answer = self._pipe.recv()
        except Exception:  # noqa: BLE001 - however the pipe ends, the child is of no use
            raise self._ended() from None
        if isinstance(answer, PlannerEndedError):
            raise answer
        outcome: PlanOutcome = answer
        return outcome

    def _ended(self) -> PlannerEndedError:
        assert self._child is not None
        self._child.join(_ENDS_S)
        code = self._child.exitcode
        how = f"exit code {code}"
        if code is None:
            how = "it says nothing that can be read"
        elif code < 0:
            with contextlib.suppress(ValueError):
                how = signal.Signals(-code).name
        return PlannerEndedError(f"its process has ended ({how})")


def _main(
    pipe: Connection, enough: c_int64, planner: PlanFunction, prepare: Callable[[], object]
) -> None:
    """In the child: answer requests until the parent has ended."""
    for number in (signal.SIGINT, signal.SIGTERM):  # it ends with its parent, who says farewell
        signal.signal(number, signal.SIG_IGN)
    os.dup2(2, 1)  # what is printed must not mix with what the parent says to machines
    end_with_parent()
    load_libraries()
    prepare()
    gc.collect()
    gc.freeze()  # looking through what numba has loaded would hold a plan up for 0.2 s
    known: KnownMap | None = None
    with contextlib.suppress(EOFError, OSError):
        pipe.send(_READY)
        while True:
            count, text = pipe.recv()
            arrays = [bytearray(pipe.recv_bytes()) for _ in range(count)]
            request, news = pickle.loads(text, buffers=arrays)
            known = news.after(known)
            pipe.send(_outcome(replace(request, known=known), enough, planner))


def _outcome(
    request: PlanRequest, enough: c_int64, planner: PlanFunction
) -> PlanOutcome | PlannerEndedError:
    try:
        return planner(request, lambda: enough.value == request.plan_id)
    except Exception as error:  # noqa: BLE001 - the parent puts the vehicle on hold
        return PlannerEndedError(f"{type(error).__name__}: {error}")


# --- the thread that waits for it


@final
class PlannerWorker:
    """Computes plans in a thread, one at a time; of those asked for the newest counts."""

    def __init__(self, planner: PlanFunction, on_answer: OnAnswer, *, lockstep: bool) -> None:
        self.part, self.ready = Worker("planner"), threading.Event()
        self._newest = 0
        self._planner, self._on_answer, self._lockstep = planner, on_answer, lockstep
        self._requests: queue.SimpleQueue[tuple[int, PlanRequest]] = queue.SimpleQueue()
        self._left = False

    def ask(self, number: int, request: PlanRequest) -> None:
        """Compute a request; the search in progress may stop."""
        self._newest = number
        self._requests.put((number, request))

    def run(self) -> None:
        """Answer requests until stopped; an exception of the planner ends it."""
        process = self._planner if isinstance(self._planner, PlannerProcess) else None
        if process is not None:
            self.part.beat(_STARTS_S)
            try:
                process.start()
            except OSError:  # no room for another process
                self._planner, process = plan, None
        load_libraries()
        self.ready.set()
        self.part.idle()
        while not self._left:
            try:
                number, request = self._requests.get(timeout=_ALIVE_S)
            except queue.Empty:
                if process is not None:
                    process.check()
                continue
            self.part.beat(request.time_s + _SLACK_S)
            began_s = time.perf_counter()
            outcome = self._planner(request, self._enough(request, number, began_s))
            self.part.idle()
            self._on_answer(number, outcome, time.perf_counter() - began_s)

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
            or (not self._lockstep and (time.perf_counter() > due_s or number < self._newest))
        )
