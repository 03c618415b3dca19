"""Many missions on many processors."""

import contextlib
import multiprocessing
import multiprocessing.process
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from types import FrameType

from companion.compare.missions import Case, Run, fly
from companion.errors import CompanionError


def processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def fly_all(cases: Sequence[Case], jobs: int, on_done: Callable[[], None]) -> list[Run]:
    """Fly all cases, in that many processes; the results in the order of the cases.

    They do not depend on the number of processes.  Interrupted, it ends its processes before it
    raises KeyboardInterrupt.
    """
    with _signals_interrupt():
        if jobs == 1:
            runs = []
            for case in cases:
                runs.append(fly(case))
                on_done()
            return runs
        return _fly_in_processes(cases, jobs, on_done)


def _fly_in_processes(cases: Sequence[Case], jobs: int, on_done: Callable[[], None]) -> list[Run]:
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        min(jobs, len(cases)),
        mp_context=multiprocessing.get_context("spawn"),  # threads and fork do not mix
        initializer=_end_with_parent,
    )
    try:
        with _workers_ignore_interrupts():
            futures = [pool.submit(fly, case) for case in cases]
        for done in as_completed(futures):
            done.result()
            on_done()
        pool.shutdown()
        return [future.result() for future in futures]
    except BaseException as error:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
        if isinstance(error, BrokenProcessPool):
            raise CompanionError("a worker process ended early. Try fewer --jobs.") from error
        raise


def _end_with_parent() -> None:
    """In a worker: end when the parent does, however it does."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)


@contextlib.contextmanager
def _workers_ignore_interrupts() -> Iterator[None]:
    """Ctrl-C goes to all processes of a terminal: workers that start now leave it to us."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


@contextlib.contextmanager
def _signals_interrupt() -> Iterator[None]:
    """SIGTERM and SIGHUP end the work as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    names = (name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
    before = {
        each: signal.signal(each, interrupt) for each in map(signal.Signals.__getitem__, names)
    }
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
