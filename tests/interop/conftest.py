"""Start the simulator and other people's programs; all of them end with the test."""

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from processes import HOME, Vehicle, python_of
from programs import ROOT, Program

CLIENTS = Path(__file__).parent / "clients"


@pytest.fixture
def programs(tmp_path: Path) -> Iterator[Callable[..., Program]]:
    """Start programs, each with a home of its own, in which nothing is set up.

    All end with the test, and what was said is in its folder: NAME.txt.
    """
    started: list[Program] = []

    def start(name: str, *arguments: object, folder: Path | None = None) -> Program:
        home = folder or tmp_path / name
        plain = {"PATH": os.defpath, "HOME": str(home), "TERM": "dumb", "PYTHONUNBUFFERED": "1"}
        started.append(Program(name, *arguments, folder=home, environment=plain))
        return started[-1]

    yield start
    for program in reversed(started):
        program.end()
        (tmp_path / f"{program.name}.txt").write_text(program.transcript, encoding="utf-8")


@pytest.fixture
def fly(programs: Callable[..., Program], tmp_path: Path) -> Iterator[Callable[..., Vehicle]]:
    """Start vehicle-sim at HOME; it must end well when it is told to."""
    flying: list[Program] = []

    def start(*arguments: object, speedup: float) -> Vehicle:
        home = ",".join(f"{value:.6f}" for value in (*HOME, 0.0))
        command = [sys.executable, "-m", "vehicle_sim", "--home", home, "--speedup", speedup]
        out = tmp_path / "truth"
        flying.append(programs("vehicle-sim", *command, "--out", out, *arguments, folder=ROOT))
        flying[-1].expect("x real time\n")
        return Vehicle(flying[-1], out / "truth.jsonl")

    yield start
    for program in flying:
        assert program.interrupt() == 0, program.transcript


@pytest.fixture
def mavproxy(programs: Callable[..., Program], tmp_path: Path) -> Callable[..., Program]:
    """Start MAVProxy without windows; its logs go to a folder of this name."""

    def start(master: str, *options: object, name: str = "mavproxy") -> Program:
        python = python_of("mavproxy")
        modules = "log,signing,wp,rally,fence,ftp,param,arm,mode,rc,misc,cmdlong,battery,output"
        how = (f"--state-basedir={tmp_path / name}", f"--default-modules={modules}", *options)
        return programs(name, python, python.with_name("mavproxy.py"), f"--master={master}", *how)

    return start


@pytest.fixture
def client(programs: Callable[..., Program]) -> Callable[..., Program]:
    """Run one of the scripts in clients/ with the interpreter of that environment."""

    def start(environment: str, script: str, *arguments: object) -> Program:
        name = f"{environment}-{Path(script).stem}"
        return programs(name, python_of(environment), CLIENTS / script, *arguments)

    return start
