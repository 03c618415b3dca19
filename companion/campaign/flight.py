"""One flight of a campaign: in this process, or by both programs over UDP; and what it left.

Both ways leave the same journal and the same truth, and only these are looked at afterwards.
"""

import ctypes
import gc
import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol, final

import numpy as np

from companion.campaign.drawn_faults import Happening, split
from companion.config import load_mission, mission_text
from companion.entry_points import Parts
from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.mission.mission import Mission
from companion.runtime.compiler import Planner
from companion.runtime.in_process import SimulatedVehicle, loop_in_process
from companion.runtime.recorder import Batch, InlineWriter, Recorder
from companion.session import Session
from companion.telemetry.resume import load_resume_data
from companion.telemetry.run_folder import RunFolder, journal_line

_EPOCH_US = 1_700_000_000_000_000
"""Stamps of logs begin here, so that a run leaves the same bytes each time."""
_SIMULATOR = "vehicle_sim"
_COMPANION = "from companion.cli import main; main()"
_PATIENCE_S = 3_600.0
"""Wall time for a flight over UDP."""
_ENDS_S = 60.0
_SPEEDUP = 4.0
"""Of a flight whose programs are killed: nobody waits for anybody."""
_LOOK_S = 60.0
_SETTLES_S, _LOOKS_S = 3_600.0, 600.0
_PLANNER = b"companion.runtime.planner_process"
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
    """A timeline, with what happens to the programs (`drawn_faults.split`)."""
    folder: Path
    drawn: str = ""
    """What the drawn faults are called."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """What a flight left."""

    mission: Mission
    journal: list[dict[str, Any]]
    truth: list[dict[str, Any]]
    plans_s: list[float]
    folder: Path
    """With the log of what was said, if it was recorded."""
    growth: "Growth | None" = None
    """Of this process in a flight of hours."""


@final
class Growth:
    """What this process takes up in a flight of hours, more than after its first hour."""

    def __init__(self) -> None:
        self._settled: tuple[float, int] | None = None
        self._looked_s = -math.inf
        self.now_mb = self.grown_mb = 0.0
        self.more_handles = 0

    @property
    def is_known(self) -> bool:
        """Whether it was long enough."""
        return self._settled is not None

    def look(self, now_s: float) -> None:
        """Once a minute of the flight; what is found counts until the next look."""
        if now_s < _SETTLES_S or now_s - self._looked_s < _LOOKS_S:
            return
        self._looked_s = now_s
        self.now_mb, handles = _in_use_mb(), _handles()
        self._settled = self._settled or (self.now_mb, handles)
        self.grown_mb = self.now_mb - self._settled[0]
        self.more_handles = handles - self._settled[1]


def _in_use_mb() -> float:
    """Resident once garbage and the allocator's reserve, some 30 MB, were given back."""
    gc.collect()
    with suppress(AttributeError, OSError):  # another C library than glibc
        ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _handles() -> int:
    """Open file descriptors of this process."""
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


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

    def heir(self) -> "_Listener":
        """One that goes on with the journal; this one hears nothing more that counts."""
        heir = _Listener(self._shared, self._system)
        heir.journal, self.journal, self.inner = self.journal, [], None
        return heir

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
    _maker()(files.world, seed=0, faults=split(files.faults)[0])


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
        self._vehicle = _maker()(files.world, seed=seed, faults=files.faults)
        self._seed, self._limit_s, self._recorded = seed, limit_s, recorded
        self._folder: RunFolder | None = None
        self._listener = _Listener(shared, self._mission.system_id)
        self.flies = True
        """Whether its mission has not ended."""
        self._begin()

    def _begin(self, *, again: bool = False) -> None:
        """One life of the companion."""
        resume = load_resume_data(self._files.folder, self._mission).resume if again else None
        session = Session(
            self._mission, seed=self._seed, lockstep=True, version=version("companion"),
            resume=resume,
        )  # fmt: skip
        self.loop = loop_in_process(
            session,
            self._vehicle,
            planner=_planner(),
            stop_asked=lambda: self.loop.clock() >= self._limit_s,
        )
        self.loop.writer = self._listener
        if self._recorded:
            text = mission_text(str(self._files.mission))
            folder = RunFolder(
                self._files.folder, mission_toml=text, epoch_us=_EPOCH_US, resume=again,
                durable=False,
            )  # fmt: skip
            facts = {
                "mission": self._mission.name,
                "seed": self._seed,
                "profile": _profile(self._mission),
            }
            folder.header(facts | {"lockstep": True})
            recorder = Recorder(folder, self.loop.clock, persist=None)
            self._listener.inner, self._folder = InlineWriter(recorder, lambda _: None), folder
        self._turns = self.loop.turns()

    def die(self, away_s: float) -> None:
        """The companion is killed: nothing more is written; after a time another one resumes."""
        dead = self._listener
        self._listener = dead.heir()
        self._turns = iter(())  # so the control loop of the dead one ends
        if self._folder is not None:
            self._folder.close()
        for _ in range(round(100.0 * away_s)):
            self._vehicle.step()
            self._vehicle.take_frames()
        self._begin(again=True)

    @property
    def now_s(self) -> float:
        """Vehicle time."""
        return self._vehicle.now_us * 1e-6

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

    def write_truth(self) -> None:
        """What there is of it."""
        with (self._files.folder / "truth.jsonl").open("a", encoding="utf-8") as file:
            file.writelines(f"{line}\n" for line in self._vehicle.take_truth())

    def close(self) -> None:
        """Write what is left."""
        self.loop.writer.close()
        self.write_truth()
        if self._folder is not None:
            self._folder.close()

    def flight(self) -> Flight:
        """What it left, once closed."""
        return Flight(
            mission=self._mission,
            journal=self._listener.journal,
            truth=_truth(self._files.folder),
            plans_s=self.loop.flown.plans_s,
            folder=self._files.folder,
        )


def fly_here(files: FlightFiles, *, seed: int, limit_s: float, recorded: bool) -> Flight:
    """Both in this process; a companion that is killed is resumed from its folder."""
    timeline, to_come = split(files.faults)
    flying = Flying(
        replace(files, faults=timeline),
        seed=seed,
        limit_s=limit_s,
        recorded=recorded or bool(to_come),
    )
    growth = Growth()
    try:
        while flying.flies:
            look_s = flying.now_s + _LOOK_S
            if to_come and to_come[0].at_s < look_s:
                flying.fly_on(1e6 * to_come[0].at_s)
                happening = to_come.pop(0)
                if flying.flies:
                    flying.die(happening.until_s - happening.at_s)
                continue
            flying.fly_on(1e6 * look_s)
            flying.write_truth()
            growth.look(flying.now_s)
    finally:
        flying.close()
    return replace(flying.flight(), growth=growth if growth.is_known else None)


def _profile(mission: Mission) -> str:
    return mission.task.settings.profile.name


def fly_over_udp(files: FlightFiles, *, seed: int, limit_s: float) -> Flight:
    """By both programs, in processes of their own; in lockstep, unless one of them is killed."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        at = f"127.0.0.1:{free.getsockname()[1]}"
    timeline, to_come = split(files.faults)
    faults, run = files.folder / "faults.txt", files.folder / "run"
    faults.write_text(timeline, encoding="utf-8")
    pace = ["--speedup", f"{_SPEEDUP:g}"] if to_come else ["--lockstep"]
    simulator = [sys.executable, "-m", _SIMULATOR, str(files.world), "--faults", str(faults)]
    simulator += ["--connect", f"udpout:{at}", "--out", str(files.folder), *pace]
    simulator += ["--seed", str(seed), "--duration", str(limit_s)]
    companion = [sys.executable, "-c", _COMPANION, "fly", str(files.mission)]
    companion += [] if to_come else ["--lockstep"]
    companion += ["--connect", f"udpin:{at}", "--out", str(run), "--seed", str(seed)]
    log = files.folder / "programs.log"
    with log.open("wb") as out:
        try:
            sim, ours = _started(simulator, out), _started(companion, out)
            for happening in to_come:
                ours = _make_happen(happening, files.folder, ours, [*companion, "--resume"], out)
            ours.wait(_PATIENCE_S)
            sim.wait(_ENDS_S if not to_come else _PATIENCE_S)
        finally:
            end_programs()
            _started_here.clear()
    said = log.read_text(encoding="utf-8", errors="replace").strip()
    if "Traceback (most recent call last)" in said:
        raise RuntimeError(f"a program raised: {said.splitlines()[-1]}")
    journal_file = run / "journal.jsonl"
    if not journal_file.is_file():
        raise RuntimeError(f"the companion did not fly: {' '.join(said.splitlines()[-1:])}")
    journal = [json.loads(line) for line in journal_file.read_bytes().splitlines()]
    for written in run.iterdir():  # a run folder like that of a flight in one process
        written.replace(files.folder / written.name)
    run.rmdir()
    facts = json.loads((files.folder / "run.json").read_bytes())
    return Flight(
        mission=load_mission(str(files.mission)),
        journal=[entry for entry in journal if "kind" in entry],
        truth=_truth(files.folder),
        plans_s=list(facts.get("planning_s", ())),
        folder=files.folder,
    )


def _make_happen(
    happening: Happening, folder: Path, ours: "subprocess.Popen[bytes]", again: list[str], out: Any
) -> "subprocess.Popen[bytes]":
    """Kill or stop a program when its time has come -> the companion, perhaps another one."""

    def wait_until(at_s: float) -> None:
        while _vehicle_s(folder) < at_s and ours.poll() is None:
            time.sleep(0.02)

    wait_until(happening.at_s)
    if ours.poll() is not None:
        return ours
    if happening.what == "companion_off":
        ours.kill()
        ours.wait()
        time.sleep((happening.until_s - happening.at_s) / _SPEEDUP)
        return _started(again, out)
    planner = _planner_of(ours.pid)
    if planner is None:
        raise RuntimeError("the companion has no process that plans")
    if happening.what == "planner_off":
        os.kill(planner, signal.SIGKILL)
        return ours
    os.kill(planner, signal.SIGSTOP)
    wait_until(happening.until_s)
    with suppress(ProcessLookupError):
        os.kill(planner, signal.SIGCONT)
    return ours


def _vehicle_s(folder: Path) -> float:
    """Vehicle time, as far as the simulator has written down the truth."""
    try:
        with (folder / "truth.jsonl").open("rb") as file:
            file.seek(max(file.seek(0, os.SEEK_END) - 2_000, 0))
            return float(json.loads(file.read().splitlines()[-2])["t_s"])
    except (OSError, ValueError, KeyError, IndexError):  # not begun
        return 0.0


def _planner_of(companion: int) -> int | None:
    """The process that computes a companion's plans."""
    for file in Path(f"/proc/{companion}/task").glob("*/children"):
        for child in file.read_text(encoding="ascii").split():
            if _PLANNER in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
    return None


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


def _truth(folder: Path) -> list[dict[str, Any]]:
    lines = (folder / "truth.jsonl").read_text(encoding="utf-8").splitlines()
    return [row for line in lines if "t_s" in (row := json.loads(line))]


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
