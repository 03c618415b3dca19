"""One flight of a campaign: in this process, or by both programs over UDP; and what it left.

Both ways leave the same journal and the same truth, and only these are looked at afterwards.
"""

import json
import math
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol, final

import numpy as np

from companion.config import load_mission, mission_text
from companion.entry_points import Parts
from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.mission.mission import Mission
from companion.runtime.compiler import Planner
from companion.runtime.in_process import SimulatedVehicle, loop_in_process
from companion.runtime.recorder import Batch, InlineWriter, Recorder
from companion.session import Session
from companion.telemetry.run_folder import RunFolder, journal_line

_EPOCH_US = 1_700_000_000_000_000
"""Stamps of logs begin here, so that a run leaves the same bytes each time."""
_SIMULATOR = "vehicle_sim"
_COMPANION = "from companion.cli import main; main()"
_PATIENCE_S = 3_600.0
"""Wall time for a flight over UDP."""
_ENDS_S = 60.0
_OVER = ("landing", "handing over", "done", "faulted")
"""Phases in which no subpath is flown any more."""


class Vehicle(SimulatedVehicle, Protocol):
    """Of an entry point in the group `companion.vehicles`."""

    def take_truth(self) -> list[str]:
        """Where it really was since the last call: lines of JSON, after a header."""
        ...


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FlightFiles:
    """What a flight is flown by; all that it writes is written into the folder."""

    world: Path
    mission: Path
    faults: str
    folder: Path


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """What a flight left."""

    mission: Mission
    journal: list[dict[str, Any]]
    truth: list[dict[str, Any]]
    plans_s: list[float]


@final
class _Listener:
    """A writer that remembers journal and frames, and hands all on to one that writes."""

    def __init__(self, shared: frozenset[int], system: int | None) -> None:
        self.journal: list[dict[str, Any]] = []
        self.said: list[bytes] = []
        """Frames of MAVLink 2 by this system with these numbers."""
        self.inner: InlineWriter | None = None
        self._shared, self._system = shared, system

    def put(self, batch: Batch) -> None:
        self.journal += [json.loads(journal_line(entry)) for entry in batch.journal]
        if self._shared:
            said = (frame for _, frame in batch.record if frame[5] == self._system)
            self.said += [f for f in said if int.from_bytes(f[7:10], "little") in self._shared]
        if self.inner is not None:
            self.inner.put(batch)

    def close(self) -> None:
        if self.inner is not None:
            self.inner.close()


def _wrong_with(maker: Callable[..., Vehicle]) -> str | None:
    return None if callable(maker) else "it cannot be called"


_VEHICLES: Parts[Callable[..., Vehicle]] = Parts(
    "companion.vehicles", {}, what="vehicle", check=_wrong_with
)


def _maker() -> Callable[..., Vehicle]:
    for name in _VEHICLES:
        return _VEHICLES[name]
    rule, remedy = "no package brings one", "Install the project again: pip install ."
    raise InputError("companion.vehicles", None, rule, remedy)


@cache
def _planner() -> Planner:
    """One for all flights of this process: it is compiled or loaded once."""
    return Planner(lockstep=True)


def check(files: FlightFiles) -> None:
    """Raises what is wrong with a mission, a world or faults."""
    load_mission(str(files.mission))
    _maker()(files.world, seed=0, faults=files.faults)


@final
class Flying:
    """A vehicle and its companion in this process, in lockstep, flown on turn by turn."""

    def __init__(
        self,
        files: FlightFiles,
        *,
        seed: int,
        limit_s: float,
        recorded: bool,
        shared: frozenset[int] = frozenset(),
    ) -> None:
        """shared: numbers of the messages of its own that `take_said` gives."""
        self._files, self._mission = files, load_mission(str(files.mission))
        self._vehicle = vehicle = _maker()(files.world, seed=seed, faults=files.faults)
        session = Session(self._mission, seed=seed, lockstep=True, version=version("companion"))
        self._limit_s, self._folder = limit_s, None
        self.loop = loop_in_process(
            session, vehicle, planner=_planner(), stop_asked=lambda: self.loop.clock() >= limit_s
        )
        self.loop.writer = self._listener = _Listener(shared, self._mission.system_id)
        if recorded:
            text = mission_text(str(files.mission))
            folder = RunFolder(files.folder, mission_toml=text, epoch_us=_EPOCH_US, durable=False)
            facts = {
                "mission": self._mission.name,
                "seed": seed,
                "profile": _profile(self._mission),
            }
            folder.header(facts | {"lockstep": True})
            recorder = Recorder(folder, self.loop.clock, persist=None)
            self._listener.inner, self._folder = InlineWriter(recorder, lambda _: None), folder
        self._turns = self.loop.turns()
        self.flies = True
        """Whether its mission has not ended."""
        self._truth: list[str] = []

    def fly_on(self, until_us: float) -> None:
        """To a time of the vehicle, or to the mission's end."""
        while self.flies and self._vehicle.now_us < until_us:
            self.flies = next(self._turns, self) is not self
            if self.loop.clock() > 2.0 * self._limit_s:
                text = f"the flight did not end when it was stopped after {self._limit_s:g} s"
                raise TimeoutError(text)

    def take_said(self) -> list[bytes]:
        """The frames to share since the last call."""
        said, self._listener.said = self._listener.said, []
        return said

    def close(self) -> None:
        """Write what is left."""
        self.loop.writer.close()
        self._truth = self._vehicle.take_truth()
        if self._folder is not None:
            self._folder.close()
            text = "".join(f"{line}\n" for line in self._truth)
            (self._files.folder / "truth.jsonl").write_text(text, encoding="utf-8")

    def flight(self) -> Flight:
        """What it left, once closed."""
        return Flight(
            mission=self._mission,
            journal=self._listener.journal,
            truth=_rows(self._truth),
            plans_s=self.loop.flown.plans_s,
        )


def fly_here(files: FlightFiles, *, seed: int, limit_s: float, recorded: bool) -> Flight:
    """Both in this process."""
    flying = Flying(files, seed=seed, limit_s=limit_s, recorded=recorded)
    try:
        flying.fly_on(math.inf)
    finally:
        flying.close()
    return flying.flight()


def _profile(mission: Mission) -> str:
    return mission.task.settings.profile.name


def fly_over_udp(files: FlightFiles, *, seed: int, limit_s: float) -> Flight:
    """By both programs, in processes of their own."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        at = f"127.0.0.1:{free.getsockname()[1]}"
    faults, run = files.folder / "faults.txt", files.folder / "run"
    faults.write_text(files.faults, encoding="utf-8")
    simulator = [sys.executable, "-m", _SIMULATOR, str(files.world), "--faults", str(faults)]
    simulator += ["--connect", f"udpout:{at}", "--out", str(files.folder), "--lockstep"]
    simulator += ["--seed", str(seed), "--duration", str(limit_s)]
    companion = [sys.executable, "-c", _COMPANION, "fly", str(files.mission), "--lockstep"]
    companion += ["--connect", f"udpin:{at}", "--out", str(run), "--seed", str(seed)]
    log = files.folder / "programs.log"
    with log.open("wb") as out, _started(simulator, out) as sim, _started(companion, out) as ours:
        try:
            ours.wait(_PATIENCE_S)
            sim.wait(_ENDS_S)
        finally:
            end_programs()
            _started_here.clear()
    journal_file = run / "journal.jsonl"
    if not journal_file.is_file():
        last = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-1:]
        raise RuntimeError(f"the companion did not fly: {' '.join(last)}")
    journal = [json.loads(line) for line in journal_file.read_bytes().splitlines()]
    truth = (files.folder / "truth.jsonl").read_text(encoding="utf-8").splitlines()
    for written in run.iterdir():  # a run folder like that of a flight in one process
        written.replace(files.folder / written.name)
    run.rmdir()
    facts = json.loads((files.folder / "run.json").read_bytes())
    return Flight(
        mission=load_mission(str(files.mission)),
        journal=[entry for entry in journal if "kind" in entry],
        truth=_rows(truth),
        plans_s=list(facts.get("planning_s", ())),
    )


_started_here: list["subprocess.Popen[bytes]"] = []
"""The programs of the flight that this process flies over UDP."""


def end_programs() -> None:
    """Before this process ends in the middle of a flight."""
    for program in _started_here:
        program.kill()


def _started(command: list[str], out: Any) -> "subprocess.Popen[bytes]":
    quiet: Any = {"stdin": subprocess.DEVNULL, "stdout": out, "stderr": subprocess.STDOUT}
    program = subprocess.Popen(command, env=os.environ | {"COLUMNS": "200"}, **quiet)
    _started_here.append(program)
    return program


def _rows(truth: Iterable[str]) -> list[dict[str, Any]]:
    return [row for line in truth if "t_s" in (row := json.loads(line))]


def in_the_air(flight: Flight) -> tuple[FloatArray, FloatArray]:
    """The true track while subpaths were flown -> times (S,), north, east, altitude (S, 3).

    Until the vehicle is told to land or is let go.  Of a flight whose vehicle's clock began again,
    the whole time in the air.
    """
    rows = [row for row in flight.truth if not row["landed"]]
    begun_s = next((e["t_s"] for e in flight.journal if e["kind"] == "leg"), math.inf)
    over = (e["t_s"] for e in flight.journal if e.get("phase") in _OVER and e["t_s"] >= begun_s)
    until_s = next(over, math.inf)
    if until_s < math.inf:
        rows = [row for row in rows if begun_s <= row["t_s"] <= until_s]
    track = [(row["north_m"], row["east_m"], row["altitude_amsl_m"]) for row in rows]
    return np.array([row["t_s"] for row in rows]), np.array(track).reshape(-1, 3)
