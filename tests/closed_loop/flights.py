"""Real flights, as users fly them: two processes over UDP, or both programs in this process."""

import functools
import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from programs import BIN, ROOT, Program, free_port

from companion.campaign.in_process import FlightFiles, fly_here
from companion.planner.plan import plan
from companion.runtime.in_process import fly_in_process
from companion.session import Session
from companion.sources.files import merged, toml_text
from companion.telemetry.run_folder import RunFolder
from vehicle_sim.simulation import Simulation

ENVIRONMENTS = ROOT / "companion" / "environments"
HILLS = str(Path(__file__).parent / "hills" / "world.toml")
HILLS_MISSION = str(Path(__file__).parent / "hills" / "mission.toml")
SEED = 3
FAULTS = """at 80 s for 60 s: link_duplication 30 %
at 120 s for 4 s: gps_off
"""
"""Of the flight over the hills: a mountain and a radar like those of the paper, a third as far."""
SOON = 300
"""Candidates to a plan, a fifth of the usual: what is flown is proven all the same."""
NIGHTLY = pytest.mark.nightly
RUNNING: list[Program] = []
"""All that was started and not ended yet."""
ENVIRONMENT = dict(os.environ)
"""As it was before any test: a kernel that is loaded within the tests moves numba's cache."""


@dataclass(kw_only=True)
class Recorded:
    """What a flight has left in its folder."""

    folder: Path

    @property
    def mission(self) -> Path:
        """As flown."""
        return self.folder / "mission.toml"

    @property
    def journal(self) -> list[dict[str, Any]]:
        """All entries that are whole by now, and the header of each life."""
        file = self.folder / "journal.jsonl"
        lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
        return [json.loads(line) for line in lines if line.endswith("}")]

    def entries(self, kind: str) -> list[dict[str, Any]]:
        """Those of a kind."""
        return [entry for entry in self.journal if entry.get("kind") == kind]

    @property
    def says(self) -> list[str]:
        """What people were told."""
        return [entry["text"] for entry in self.entries("say")]

    @property
    def outcome(self) -> str:
        """How the journal says that it ended."""
        [end] = self.entries("end")
        return str(end["outcome"])

    @functools.cached_property
    def truth(self) -> list[dict[str, Any]]:
        """Where the vehicle really was."""
        lines = (self.folder / "truth.jsonl").read_text(encoding="utf-8").splitlines()
        return [json.loads(line) for line in lines[1:]]


@dataclass(kw_only=True)
class Flight(Recorded):
    """One flight: both programs, and the folder into which both write."""

    companion: Program
    simulator: Program

    def kill(self) -> None:
        """End whatever still runs."""
        self.companion.end()
        self.simulator.end()

    def ends_well(self) -> None:
        """Both programs end by themselves and say so, and the journal."""
        for program in (self.companion, self.simulator):
            assert program.wait() == 0, program.transcript
        assert self.outcome == "arrived"


def flown_here(
    folder: Path, world: str | Path, mission: str | Path, faults: str = "", seed: int = 1
) -> Recorded:
    """A flight in this process, in lockstep, recorded until it ends, or for ten minutes."""
    files = FlightFiles(world=Path(world), mission=Path(mission), faults=faults, folder=folder)
    fly_here(files, seed=seed, limit_s=600.0)
    return Recorded(folder=folder)


def flown_with(folder: Path, session: Session, vehicle: Simulation, **options: Any) -> Recorded:
    """The same with a session and a vehicle that a test has made, to its end."""
    with RunFolder(folder, mission_toml="", epoch_us=0, durable=False) as run:
        fly_in_process(session, vehicle, planner=plan, folder=run, **options)
    (folder / "truth.jsonl").write_text("\n".join(vehicle.take_truth()), encoding="utf-8")
    return Recorded(folder=folder)


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
    there = ("--connect", f"udpout:127.0.0.1:{port}", "--out", folder)
    vehicle = run(BIN / "vehicle-sim", world, *there, *clock, *simulator_options)
    return Flight(folder=folder, companion=us, simulator=vehicle)


def run(program: str | Path, *arguments: object) -> Program:
    """Start a program in the environment in which the tests were started."""
    warm_up()
    name = Path(program).name
    RUNNING.append(Program(name, program, *arguments, folder=ROOT, environment=ENVIRONMENT))
    return RUNNING[-1]


@functools.cache
def warm_up() -> None:
    """Fill the cache of compiled code: a simulator in lockstep has little patience."""
    load = "from companion.runtime.compiler import load_kernel; load_kernel()"
    subprocess.run([sys.executable, "-c", load], check=True, env=ENVIRONMENT, timeout=600)


def mission_file(name: str | Path, to: Path, **tables: Any) -> Path:
    """A mission with other values in some of its tables, written to a file; None: none.

    name: of the bundled one, or the folder that it is in.
    """
    table = tomllib.loads((ENVIRONMENTS / name / "mission.toml").read_text(encoding="utf-8"))
    table["planner"]["evaluations"] = SOON
    to.write_text(toml_text(merged(table, tables)), encoding="utf-8")
    return to


def one_target() -> str:
    """The mission of sitl-arducopter without its far targets and its landing."""
    path = ENVIRONMENTS / "sitl-arducopter" / "mission.toml"
    head, _, _, last = path.read_text(encoding="utf-8").split("[[targets]]")
    text = f"{head}[[targets]]{last}".replace('"land"', '"hold"')
    return text.replace("[planner]", f"[planner]\nevaluations = {SOON}", 1)
