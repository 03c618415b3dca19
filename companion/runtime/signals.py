"""What ends a process: signals, and the end of its parent."""

import contextlib
import multiprocessing
import multiprocessing.connection
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType


@contextlib.contextmanager
def stop_signals() -> Iterator[list[int]]:
    """Collect termination signals, so that the vehicle is put on hold first."""
    received: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        received.append(number)

    before = {
        each: signal.signal(each, note)
        for name in ("SIGINT", "SIGTERM", "SIGHUP")
        if (each := getattr(signal, name, None)) is not None
    }
    try:
        yield received
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def end_with_parent(end: Callable[[], None]) -> None:
    """In a worker process: call this when its parent has ended, however it has."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        end()

    threading.Thread(target=follow, daemon=True).start()
