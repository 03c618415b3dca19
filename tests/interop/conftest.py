"""Start the simulator and other people's programs; all of them end with the test."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from processes import CLIENTS, HOME, Vehicle, environments, plain
from programs import ROOT, Program


@pytest.fixture
def programs(tmp_path: Path) -> Iterator[Callable[..., Program]]:
    """Start programs; all end with the test, and what was said is in its folder: NAME.txt."""
    started: list[Program] = []

    def start(name: str, *arguments: object, folder: Path) -> Program:
        started.append(Program(name, *arguments, folder=folder, environment=plain(folder)))
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
        program = programs(
            "vehicle-sim", *command, "--out", tmp_path / "truth", *arguments, folder=ROOT
        )
        flying.append(program)
        program.expect("x real time\n")
        return Vehicle(program, tmp_path / "truth" / "truth.jsonl")

    yield start
    for program in flying:
        assert program.interrupt() == 0, program.transcript


@pytest.fixture
def mavproxy(programs: Callable[..., Program], tmp_path: Path) -> Callable[..., Program]:
    """Start MAVProxy without windows; its logs go to a folder of this name."""

    def start(master: str, *options: object, name: str = "mavproxy") -> Program:
        folder = tmp_path / name
        bin_folder = environments() / "mavproxy" / "bin"
        modules = "log,signing,wp,rally,fence,ftp,param,arm,mode,rc,misc,cmdlong,battery,output"
        return programs(
            name,
            bin_folder / "python",
            bin_folder / "mavproxy.py",
            f"--master={master}",
            f"--state-basedir={folder}",
            f"--default-modules={modules}",
            *options,
            folder=folder,
        )

    return start


@pytest.fixture
def client(programs: Callable[..., Program], tmp_path: Path) -> Callable[..., Program]:
    """Run one of the scripts in clients/ with the interpreter of that environment."""

    def start(environment: str, script: str, *arguments: object) -> Program:
        python = environments() / environment / "bin" / "python"
        name = f"{environment}-{Path(script).stem}"
        return programs(name, python, CLIENTS / script, *arguments, folder=tmp_path / name)

    return start
