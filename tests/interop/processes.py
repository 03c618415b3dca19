"""Other people's programs and the simulator, as processes on real sockets, and the truth."""

import contextlib
import json
import math
import os
import re
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
CLIENTS = Path(__file__).parent / "clients"
HOME = (47.397742, 8.545594, 488.0)
METRES_PER_DEG = (111_200.0, 75_390.0)  # north and east, at HOME; good to 1 in 1000
GRACE_S = 5.0  # what a program gets to end by itself


def environments() -> Path:
    """Where scripts/setup-interop.sh has installed the programs."""
    folder = ROOT / os.environ.get("INTEROP_VENVS", ".venv-interop")
    if not folder.is_dir():
        pytest.fail(f"{folder} is missing: run scripts/test, or source scripts/setup-interop.sh")
    return folder


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        port: int = one.getsockname()[1]
        return port


class Program:
    """A process that is typed to and read from, as by a person at a terminal."""

    def __init__(self, name: str, *arguments: object, folder: Path, **environment: str) -> None:
        """`folder`: its working directory and its home."""
        folder.mkdir(parents=True, exist_ok=True)
        plain = {"PATH": os.defpath, "HOME": str(folder), "TERM": "dumb", "PYTHONUNBUFFERED": "1"}
        self.name = name
        self.process = subprocess.Popen(
            [str(argument) for argument in arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            cwd=folder,
            env={**plain, **environment},
            start_new_session=True,  # so that what it starts itself can be ended with it
        )
        self.transcript = ""
        self._read = 0
        self._ended = False
        self._news = threading.Condition()
        self._reader = threading.Thread(target=self._follow, daemon=True)
        self._reader.start()

    def _follow(self) -> None:
        output = self.process.stdout
        assert output is not None
        while chunk := os.read(output.fileno(), 65536):
            with self._news:
                self.transcript += chunk.decode(errors="replace")
                self._news.notify_all()
        with self._news:
            self._ended = True
            self._news.notify_all()

    def type(self, line: str) -> None:
        """Enter a line."""
        assert self.process.stdin is not None
        with self._news:
            self.transcript += f"{line}\n"
            self._read = len(self.transcript)  # what it answers comes after this
        self.process.stdin.write(f"{line}\n".encode())
        self.process.stdin.flush()

    def expect(self, pattern: str, within_s: float = 60.0) -> "re.Match[str]":
        """Wait until it prints this; what comes after it is left for the next time."""
        deadline_s = time.monotonic() + within_s
        with self._news:
            while True:
                found = re.search(pattern, self.transcript[self._read :])
                if found:
                    self._read += found.end()
                    return found
                left_s = deadline_s - time.monotonic()
                if left_s <= 0.0 or self._ended:
                    break
                self._news.wait(left_s)
        state = "ended" if self._ended else f"{within_s:g} s passed"
        pytest.fail(f"{self.name} has not printed {pattern!r} ({state}):\n{self.transcript}")

    def ask(self, line: str, pattern: str, within_s: float = 60.0) -> "re.Match[str]":
        """Enter a line and wait for this answer."""
        self.type(line)
        return self.expect(pattern, within_s)

    def wait(self, within_s: float) -> int:
        """Wait until it has ended; its exit code."""
        try:
            code = self.process.wait(within_s)
        except subprocess.TimeoutExpired:
            pytest.fail(f"{self.name} has not ended within {within_s:g} s:\n{self.transcript}")
        self._reader.join(GRACE_S)
        return code

    def hang_up(self) -> None:
        """Close its input, which ends most programs."""
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()

    def interrupt(self) -> int:
        """As Ctrl-C does; its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.wait(GRACE_S)

    def kill(self) -> None:
        """As a power cut does, with all that it has started."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def end(self) -> None:
        """End it and what it has started, whether it likes to or not."""
        self.kill()
        self.hang_up()
        self._reader.join(GRACE_S)
        assert self.process.stdout is not None
        self.process.stdout.close()


class Vehicle:
    """A running vehicle-sim, and where its vehicle really is."""

    def __init__(self, program: Program, truth: Path) -> None:
        self.program = program
        self._truth = truth

    def now(self) -> dict[str, Any]:
        """The newest line of truth."""
        return self.track()[-1]

    def track(self) -> list[dict[str, Any]]:
        """All that has been written of the truth so far."""
        text = self._truth.read_text(encoding="utf-8") if self._truth.exists() else ""
        rows = [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]
        return [row for row in rows if "t_s" in row]

    def wait_until(
        self, reached: Callable[[dict[str, Any]], bool], within_s: float = 60.0
    ) -> dict[str, Any]:
        """Wait until the truth is so."""
        deadline_s = time.monotonic() + within_s
        while time.monotonic() < deadline_s:
            rows = self.track()
            if rows and reached(rows[-1]):
                return rows[-1]
            time.sleep(0.05)  # a file has no event to wait for
        pytest.fail(f"not within {within_s:g} s: {rows[-1:]}\n{self.program.transcript}")


def height_m(row: dict[str, Any]) -> float:
    return float(row["altitude_amsl_m"]) - HOME[2]


def away_m(row: dict[str, Any], latitude_deg: float, longitude_deg: float) -> float:
    return math.hypot(
        (row["lat_deg"] - latitude_deg) * METRES_PER_DEG[0],
        (row["lon_deg"] - longitude_deg) * METRES_PER_DEG[1],
    )


def place(north_m: float, east_m: float) -> tuple[float, float]:
    """Latitude and longitude so far from home, in degrees."""
    return HOME[0] + north_m / METRES_PER_DEG[0], HOME[1] + east_m / METRES_PER_DEG[1]
