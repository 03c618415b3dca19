"""Processes that work for this one, and end with it."""

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from typing import Any


def processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on every system
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextlib.contextmanager
def worker_pool(jobs: int) -> Iterator[Callable[..., "Future[Any]"]]:
    """Give work to so many processes, by what this yields; they end with this one.

    Ctrl-C is for this process alone, though a terminal sends it to all.  If the block ends by an
    exception, they end at once, else when their work is done.
    """
    others = set(multiprocessing.active_children())
    spawn = multiprocessing.get_context("spawn")  # threads and fork do not mix
    pool = ProcessPoolExecutor(jobs, mp_context=spawn, initializer=end_with_parent)

    def submit(work: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        # what starts meanwhile never hears of it, from the beginning
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return pool.submit(work, *arguments)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    try:
        yield submit
    except BaseException:
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def end_with_parent() -> None:
    """In a worker process: end at once when its parent has, however it has."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
