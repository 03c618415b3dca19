"""Signals that end a process."""

import contextlib
import signal
from collections.abc import Iterator
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
