"""Programs as processes: typed to, read from, waited for, ended; and free ports for them."""

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

ROOT = Path(__file__).parents[1]
BIN = Path(sys.executable).parent
GRACE_S = 5.0
"""What a program gets to end by itself."""
_PATIENCE_S = 400.0
_LOOK_S = 0.02
"""Between two looks at files, if nothing is printed meanwhile: they have no event to wait for."""
_T = TypeVar("_T")


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        port: int = one.getsockname()[1]
        return port


class Program:
    """A process that is typed to and read from, as by a person at a terminal."""

    def __init__(
        self, name: str, *arguments: object, folder: Path, environment: dict[str, str]
    ) -> None:
        """folder: its working directory."""
        folder.mkdir(parents=True, exist_ok=True)
        self.name = name
        self.process = subprocess.Popen(
            [str(argument) for argument in arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            cwd=folder,
            env=environment,
            start_new_session=True,  # so that what it starts itself can be ended with it
        )
        self.transcript = ""
        self._read = 0
        self._ended = False
        self._news = threading.Condition()
        self._reader = threading.Thread(target=self._follow, daemon=True)
        self._reader.start()

    def _follow(self) -> None:
        while chunk := os.read(self.process.stdout.fileno(), 65536):
            with self._news:
                self.transcript += chunk.decode(errors="replace")
                self._news.notify_all()
        with self._news:
            self._ended = True
            self._news.notify_all()

    def type(self, line: str) -> None:
        """Enter a line."""
        with self._news:
            self.transcript += f"{line}\n"
            self._read = len(self.transcript)  # what it answers comes after this
        self.process.stdin.write(f"{line}\n".encode())
        self.process.stdin.flush()

    def expect(self, pattern: str, within_s: float = 60.0) -> "re.Match[str]":
        """Wait until it prints this; what comes after it is left for the next time."""

        def printed() -> "re.Match[str] | None":
            return re.search(pattern, self.transcript[self._read :])

        found = self.until(printed, within_s, what=f"print {pattern!r}")
        self._read += found.end()
        return found

    def ask(self, line: str, pattern: str, within_s: float = 60.0) -> "re.Match[str]":
        """Enter a line and wait for this answer."""
        self.type(line)
        return self.expect(pattern, within_s)

    def until(
        self,
        look: Callable[[], _T | None],
        within_s: float = 120.0,
        *,
        every_s: float = _LOOK_S,
        what: str = "come to that",
    ) -> _T:
        """What a look finds in the end, at what it prints or at its files, while it runs."""
        deadline_s = time.monotonic() + within_s
        with self._news:
            while True:
                has_ended = self._ended
                if found := look():
                    return found
                if has_ended or time.monotonic() > deadline_s:
                    break
                self._news.wait(every_s)
        state = "it has ended" if has_ended else f"{within_s:g} s have passed"
        pytest.fail(f"{self.name} did not {what}, {state}:\n{self.transcript}")

    def wait(self, within_s: float = _PATIENCE_S) -> int:
        """Wait until it has ended by itself; its exit code."""
        try:
            code = self.process.wait(within_s)
        except subprocess.TimeoutExpired:
            pytest.fail(f"{self.name} has not ended within {within_s:g} s:\n{self.transcript}")
        self._reader.join(GRACE_S)
        return code

    def hang_up(self) -> None:
        """Close its input, which ends most programs."""
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()

    def interrupt(self, within_s: float = GRACE_S) -> int:
        """As Ctrl-C does; its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.wait(within_s)

    def kill(self) -> None:
        """As a power cut does, with all that it has started."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self._reader.join(GRACE_S)

    def end(self) -> None:
        """End it and what it has started, whether it likes to or not."""
        self.kill()
        self.hang_up()
        self.process.stdout.close()
