"""A person at the terminal, who says go, or Ctrl-C."""

import contextlib
import os
import select
import signal
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Final, Self, TextIO, final

HOW_TO: Final = "once it is ready, type yes to take off; Ctrl-C ends it"
_MOST = 4096


@final
class Terminal:
    """Lines from a terminal, looked at whenever it is asked for them; a context manager."""

    def __init__(self, stream: TextIO, say: Callable[[str], None]) -> None:
        """stream: a terminal; say: prints a line for the person, without waiting."""
        self._descriptor: int | None = stream.fileno()
        self.hears = say
        """Tells what became of it."""
        self._typed = b""
        self._before: object = None

    def says_go(self) -> bool:
        """Whether a yes was typed since this was asked last; another line is told how to."""
        if self._descriptor is None or not select.select([self._descriptor], (), (), 0.0)[0]:
            return False
        try:
            data = os.read(self._descriptor, _MOST)
        except OSError:  # in the background what is typed is for the shell
            return False
        if not data:  # Ctrl-D, or nobody is there any more
            self._descriptor = None
        *lines, rest = (self._typed + data).split(b"\n")
        self._typed = rest[-_MOST:]
        says_yes = any(line.strip().lower() in (b"yes", b"y") for line in lines)
        if lines and not says_yes:
            self.hears(HOW_TO)
        return says_yes

    def __enter__(self) -> Self:
        # Reading in the background would stop the whole program.
        self._before = signal.signal(signal.SIGTTIN, signal.SIG_IGN)
        return self

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGTTIN, self._before)  # type: ignore[arg-type]


@contextlib.contextmanager
def stop_signals() -> Iterator[list[int]]:
    """Collect termination signals, so that the vehicle is put on hold first."""
    received: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        received.append(number)

    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    before = {number: signal.signal(number, note) for number in numbers}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
