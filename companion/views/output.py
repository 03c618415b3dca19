"""Standard output for a program that may not wait: what reads it may be slow, stuck or gone."""

import io
import os
import queue
import sys
import threading
from typing import Any, Self, TextIO, final

from rich.console import Console

_MOST = 1000  # texts that wait for a reader: a log that nobody reads is given up
_FILE_COLUMNS = 130
_LEAVES_S = 1.0  # what a reader gets at the end to take the rest


def plain_console(**options: Any) -> Console:
    """A console that prints what it is given: brackets and colons in names are no markup."""
    return Console(markup=False, emoji=False, **options)


def table_console(**options: Any) -> Console:
    """For tables: as wide as the terminal, or as a file that is read in an editor."""
    return plain_console(width=None if sys.stdout.isatty() else _FILE_COLUMNS, **options)


@final
class PatientOutput(io.TextIOBase):
    """A text stream that a thread of its own writes: whoever prints never waits, and never fails.

    A context manager; at its end the reader has a second for what it has not taken yet.
    """

    def __init__(self, stream: TextIO) -> None:
        """stream: one with a file descriptor is written to past its own buffer and lock.

        So the end of the program does not wait for it either.
        """
        self._stream = stream
        self._texts: queue.Queue[str | None] = queue.Queue()
        self._gone = False
        self._thread = threading.Thread(target=self._run, name="output", daemon=True)

    @property
    def is_behind(self) -> bool:
        """Whether there is more to write: what is soon replaced anyway had better be left out."""
        return self._texts.unfinished_tasks > 0

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """As of the stream."""
        return self._stream.encoding or "utf-8"

    def isatty(self) -> bool:
        """As of the stream."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """As of the stream."""
        return self._stream.fileno()

    def writable(self) -> bool:
        """Always."""
        return True

    def write(self, text: str) -> int:
        """Have it written as soon as the reader takes it."""
        if not self._gone and self._texts.qsize() < _MOST:
            self._texts.put(text)
        return len(text)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._texts.put(None)
        self._thread.join(_LEAVES_S)

    def _run(self) -> None:
        while (text := self._texts.get()) is not None:
            try:
                if not self._gone:
                    self._put(text)
            except (OSError, ValueError):  # the reader has left: so be it
                self._gone = True
            self._texts.task_done()

    def _put(self, text: str) -> None:
        try:
            descriptor = self._stream.fileno()
        except io.UnsupportedOperation:  # it is in memory
            self._stream.write(text)
            return
        left = memoryview(text.encode(self.encoding, errors="replace"))
        while left:
            left = left[os.write(descriptor, left) :]
