"""Real flights: two processes, real UDP, everything that they leave behind."""

import functools
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Container
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
BIN = Path(sys.executable).parent
_PATIENCE_S = 400.0
_ENVIRONMENT = dict(os.environ)
"""As it was before any test: a kernel that is loaded within the tests moves numba's cache."""


def each(*names: str, nightly: Container[str] = ()) -> pytest.MarkDecorator:
    """A test for each name; one worker runs all that look at the same flight, by its name.

    nightly: those that are flown with `--all` alone.
    """
    marks = {
        name: [pytest.mark.xdist_group(name), *([pytest.mark.nightly] if name in nightly else [])]
        for name in names
    }
    return pytest.mark.parametrize(
        "name", [pytest.param(name, marks=marks[name]) for name in names]
    )


EACH_ENVIRONMENT = each("environment-1", "environment-2", "valley", nightly=["environment-2"])
NIGHTLY_AUTOPILOTS = ("sitl-px4", "sitl-arduplane")
"""The others are of both makers, and of both kinds."""


@dataclass(kw_only=True)
class Flight:
    """One flight, flown to its end unless it was interrupted."""

    folder: Path
    companion: subprocess.Popen[str]
    simulator: subprocess.Popen[str]
    said: dict[str, str] = field(default_factory=dict)

    def wait(self) -> None:
        """Wait for both sides to end by themselves."""
        for name in ("companion", "simulator"):
            process = getattr(self, name)
            out, _ = process.communicate(timeout=_PATIENCE_S)
            self.said[name] = out

    def kill(self) -> None:
        """End whatever still runs; a flight leaves no process behind."""
        for process in (self.companion, self.simulator):
            if process.poll() is None:
                process.kill()
            process.communicate()

    @property
    def journal(self) -> list[dict[str, Any]]:
        lines = (self.folder / "journal.jsonl").read_text(encoding="utf-8").splitlines()
        return [json.loads(line) for line in lines]

    @property
    def outcome(self) -> str:
        """How the journal says that it ended."""
        [end] = [entry for entry in self.journal if entry.get("kind") == "end"]
        return str(end["outcome"])

    @property
    def truth(self) -> list[dict[str, Any]]:
        lines = (self.folder / "truth.jsonl").read_text(encoding="utf-8").splitlines()
        return [json.loads(line) for line in lines[1:]]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


Launch = Callable[..., Flight]


def launch(
    folder: Path,
    world: str,
    mission: str,
    *options: str,
    clock: tuple[str, ...] = ("--lockstep",),
    simulator_options: tuple[str, ...] = (),
) -> Flight:
    """Start both programs on a free port of loopback."""
    warm_up()
    port = free_port()
    companion_clock = [option for option in clock if option == "--lockstep"]
    companion = run(
        *("companion", "fly", mission, "--connect", f"udpin:127.0.0.1:{port}"),
        *("--out", folder, *companion_clock, *options),
    )
    simulator = run(
        *("vehicle-sim", world, "--connect", f"udpout:127.0.0.1:{port}"),
        *("--out", folder, *clock, *simulator_options),
    )
    return Flight(folder=folder, companion=companion, simulator=simulator)


def run(program: str, *arguments: str | Path) -> subprocess.Popen[str]:
    """Start one of the programs, as a user does."""
    return subprocess.Popen(
        [BIN / program, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
        env=_ENVIRONMENT,
    )


@functools.cache
def warm_up() -> None:
    """Fill the cache of compiled code: a simulator in lockstep has little patience."""
    load = "from companion.runtime.compiler import load_kernel; load_kernel()"
    subprocess.run([sys.executable, "-c", load], check=True, env=_ENVIRONMENT, timeout=600)


def interrupt(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGINT)
