"""Processes that work for this one: how many, and that they end with it."""

import multiprocessing
import multiprocessing.connection
import os
import threading


def processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0))


def end_with_parent() -> None:
    """In a worker process: end at once when its parent has, however it has."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
