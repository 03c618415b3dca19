"""A person at the terminal, who says go."""

import os
import queue
import signal
import threading
import time
from collections.abc import Callable
from typing import Final, Self, TextIO, final

HOW_TO: Final = "once it is ready, type yes to take off; Ctrl-C ends it"
_AGAIN_S = 1.0  # in the background what is typed is for the shell
_MOST = 4096


@final
class Terminal:
    """Reads lines from a terminal in a thread of its own; a context manager.

    The thread may be left waiting: it holds no lock, and ends with the program.
    """

    def __init__(self, stream: TextIO, say: Callable[[str], None]) -> None:
        """stream: a terminal; say: prints a line for the person."""
        self._descriptor, self._say = stream.fileno(), say
        self._yes: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._before: object = None
        self._stopping = getattr(signal, "SIGTTIN", None)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._read, name="terminal", daemon=True)

    def says_go(self) -> bool:
        """Whether a yes was typed since this was asked last."""
        if self._yes.empty():
            return False
        self._yes.get()
        return True

    def hears(self, answer: str) -> None:
        """Tell what became of it."""
        self._say(answer)

    def __enter__(self) -> Self:
        if self._stopping is not None:  # reading in the background would stop the whole program
            self._before = signal.signal(self._stopping, signal.SIG_IGN)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._stopping is not None:
            signal.signal(self._stopping, self._before)  # type: ignore[arg-type]

    def _read(self) -> None:
        typed = b""
        while not self._over.is_set():
            try:
                data = os.read(self._descriptor, _MOST)
            except OSError:
                time.sleep(_AGAIN_S)
                continue
            if not data:  # Ctrl-D, or nobody is there any more
                return
            *lines, typed = (typed + data).split(b"\n")
            for line in lines:
                self._hear(line)
            typed = typed[-_MOST:]

    def _hear(self, line: bytes) -> None:
        if line.strip().lower() in (b"yes", b"y"):
            self._yes.put(None)
        elif not self._over.is_set():
            self._say(HOW_TO)
