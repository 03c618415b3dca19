"""Real flights: two processes, real UDP, everything that they leave behind."""

import functools
import json
import os
import subprocess
import sys
from collections.abc import Container, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from programs import BIN, ROOT, Program, free_port

from companion.campaign.in_process import FlightFiles, fly_here
from companion.planner.plan import plan
from companion.runtime.in_process import fly_in_process
from companion.session import Session
from companion.telemetry.run_folder import RunFolder
from vehicle_sim.simulation import Simulation

ENVIRONMENTS = ROOT / "companion" / "environments"
HILLS = str(Path(__file__).parent / "hills" / "world.toml")
HILLS_MISSION = str(Path(__file__).parent / "hills" / "mission.toml")
BAD_LINK = ("--faults", str(Path(__file__).parent / "hills" / "faults.txt"))
"""Options of the simulator for the flight over the hills that all look at."""
RUNNING: list[Program] = []
"""All that was started and not ended yet."""
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


_NIGHTLY = ("valley", "environment-1", "environment-2")
EACH_SCENE = each("hills", *_NIGHTLY, nightly=_NIGHTLY)
"""The hills are of the same kind as the paper's environments, and a third as long."""
NIGHTLY = pytest.mark.nightly


@dataclass(kw_only=True)
class Recorded:
    """What a flight has left in its folder."""

    folder: Path

    @property
    def journal(self) -> list[dict[str, Any]]:
        return journal_of(self.folder)

    @property
    def kinds(self) -> list[str]:
        """Of the entries of the journal."""
        return [entry["kind"] for entry in self.journal if "kind" in entry]

    @property
    def says(self) -> list[str]:
        """What people were told."""
        return [entry["text"] for entry in self.journal if entry.get("kind") == "say"]

    @property
    def end(self) -> dict[str, Any]:
        [end] = [entry for entry in self.journal if entry.get("kind") == "end"]
        return end

    @property
    def outcome(self) -> str:
        """How the journal says that it ended."""
        return str(self.end["outcome"])

    @property
    def truth(self) -> list[dict[str, Any]]:
        lines = (self.folder / "truth.jsonl").read_text(encoding="utf-8").splitlines()
        return [json.loads(line) for line in lines[1:]]


@dataclass(kw_only=True)
class Flight(Recorded):
    """One flight: both programs, and the folder into which both write."""

    companion: Program
    simulator: Program

    def wait(self) -> None:
        """Wait for both sides to end by themselves."""
        self.companion.wait()
        self.simulator.wait()

    def kill(self) -> None:
        """End whatever still runs."""
        self.companion.end()
        self.simulator.end()

    def ended_well(self) -> None:
        """Both programs say so, and the journal."""
        assert self.companion.returncode == 0, self.companion.transcript
        assert self.simulator.returncode == 0, self.simulator.transcript
        assert self.outcome == "arrived"


def flown_here(
    folder: Path,
    world: str | Path,
    mission: str | Path,
    *,
    faults: str = "",
    limit_s: float = 600.0,
) -> Recorded:
    """A flight in this process, in lockstep, recorded until it ends or is stopped by then."""
    files = FlightFiles(world=Path(world), mission=Path(mission), faults=faults, folder=folder)
    fly_here(files, seed=1, limit_s=limit_s)
    return Recorded(folder=folder)


def flown_with(folder: Path, session: Session, vehicle: Simulation, **options: Any) -> Recorded:
    """The same with a session and a vehicle that a test has made, to its end."""
    with RunFolder(folder, mission_toml="", epoch_us=0, durable=False) as run:
        fly_in_process(session, vehicle, planner=plan, folder=run, **options)
    truth = "\n".join(vehicle.take_truth())
    (folder / "truth.jsonl").write_text(truth, encoding="utf-8")
    return Recorded(folder=folder)


def folder_of(scene: str) -> Path:
    """Where its world.toml and mission.toml are."""
    return Path(HILLS).parent if scene == "hills" else ENVIRONMENTS / scene


def flown_as(scene: str) -> tuple[str, ...]:
    """World, mission and options of the flight that all look at."""
    folder = folder_of(scene)
    files = str(folder / "world.toml"), str(folder / "mission.toml")
    return (*files, "--seed", "3") if scene == "hills" else files


def journal_of(folder: Path) -> list[dict[str, Any]]:
    """What has been written of a journal so far; a line that is not whole is left out."""
    file = folder / "journal.jsonl"
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return [json.loads(line) for line in lines if line.endswith("}")]


def kept(folder: Path) -> dict[str, Any] | None:
    """What a companion has kept of its flight by now, for the one that follows it."""
    try:
        values: dict[str, Any] = json.loads((folder / "resume.json").read_bytes())["values"]
    except (OSError, ValueError):
        return None
    return values


def simulator(world: str | Path, folder: Path, *options: object) -> Program:
    """Start the simulator, as a user does."""
    return run(BIN / "vehicle-sim", world, "--out", folder, *options)


def run(program: str | Path, *arguments: object) -> Program:
    """Start a program in the environment in which the tests were started."""
    warm_up()
    name = Path(program).name
    RUNNING.append(Program(name, program, *arguments, folder=ROOT, environment=_ENVIRONMENT))
    return RUNNING[-1]


def launch(
    folder: Path,
    world: str | Path,
    mission: str | Path,
    *options: object,
    clock: Sequence[str] = ("--lockstep",),
    simulator_options: Sequence[object] = (),
) -> Flight:
    """Start both programs on a free port of loopback, as a user does."""
    port = free_port()
    here = ("--connect", f"udpin:127.0.0.1:{port}", "--start", "--out", folder)
    lockstep = [option for option in clock if option == "--lockstep"]
    us = run(BIN / "companion", "fly", mission, *here, *lockstep, *options)
    there = ("--connect", f"udpout:127.0.0.1:{port}")
    vehicle = simulator(world, folder, *there, *clock, *simulator_options)
    return Flight(folder=folder, companion=us, simulator=vehicle)


@functools.cache
def warm_up() -> None:
    """Fill the cache of compiled code: a simulator in lockstep has little patience."""
    load = "from companion.runtime.compiler import load_kernel; load_kernel()"
    subprocess.run([sys.executable, "-c", load], check=True, env=_ENVIRONMENT, timeout=600)


def edited(source: str | Path, target: Path, *changes: tuple[str, str]) -> Path:
    """A file in which each of these texts, which stand in it once, is another."""
    text = Path(source).read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    target.write_text(text, encoding="utf-8")
    return target


def one_target() -> str:
    """The mission of sitl-arducopter without its far targets."""
    path = ENVIRONMENTS / "sitl-arducopter" / "mission.toml"
    head, _, _, last = path.read_text(encoding="utf-8").split("[[targets]]")
    return f"{head}[[targets]]{last}"


def short_mission(name: str, folder: Path) -> Path:
    """A bundled mission with a battery that lasts; of a copter it is shorter, with more joins."""
    changes = [("\n[end]\n", "\n[battery]\nreserve_percent = 2\n[end]\n")]
    if "plane" not in name:
        for axis in ("north", "east"):
            changes.append((f"{axis}_max_m = 1400.0", f"{axis}_max_m = 600.0"))
            changes.append((f"{axis}_min_m = -800.0", f"{axis}_min_m = -100.0"))
        changes += [
            ("scan_range_m = 800.0", "scan_range_m = 200.0"),
            ("north_m = 600.0", "north_m = 300.0"),
            ("north_m = 500.0\neast_m = 700.0", "north_m = 300.0\neast_m = 400.0"),
            ("[[targets]]\nnorth_m = 60.0\neast_m = 150.0\n", ""),
        ]
    return edited(ENVIRONMENTS / name / "mission.toml", folder / f"{name}.toml", *changes)
