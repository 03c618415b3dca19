"""Flights by both programs, in processes of their own, over UDP; some of them are killed."""

import json
import os
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from companion.campaign.drawn_faults import Happening, split
from companion.campaign.flight import Flight, FlightFiles, truth_of
from companion.config import load_mission

_Program = subprocess.Popen[bytes]
_SIMULATOR = "vehicle_sim"
_COMPANION = "from companion.cli import main; main()"
_PATIENCE_S = 3_600.0
"""Wall time for a flight."""
_ENDS_S = 60.0
_SPEEDUP = 4.0
"""Of a flight whose programs are killed: nobody waits for anybody."""
_LOOK_S = 0.02
_PLANNER = b"companion.runtime.planner_process"


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
    companion += ["--start"] if to_come else ["--lockstep"]
    companion += ["--connect", f"udpin:{at}", "--out", str(run), "--seed", str(seed)]
    log, again = files.folder / "programs.log", [*companion, "--resume"]
    with log.open("wb") as out:
        try:
            sim, ours = _started(simulator, out), _started(companion, out)
            for happening in to_come:
                ours = _make_happen(happening, files.folder, sim, ours, again, out)
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
        truth=truth_of(files.folder),
        plans_s=list(facts.get("planning_s", ())),
        folder=files.folder,
    )


def _make_happen(
    happening: Happening, folder: Path, sim: _Program, ours: _Program, again: list[str], out: Any
) -> _Program:
    """Kill or stop a program when its time has come -> the companion, perhaps another one."""
    if _ends_before(ours, happening.at_s, folder):
        return ours
    if happening.what == "companion_off":
        ours.kill()
        ours.wait()
        _ends_before(sim, happening.until_s, folder)
        return _started(again, out)
    planner = _planner_of(ours.pid)
    if planner is None:
        raise RuntimeError("the companion has no process that plans")
    if happening.what == "planner_off":
        os.kill(planner, signal.SIGKILL)
        return ours
    os.kill(planner, signal.SIGSTOP)
    _ends_before(ours, happening.until_s, folder)
    with suppress(ProcessLookupError):
        os.kill(planner, signal.SIGCONT)
    return ours


def _ends_before(program: _Program, at_s: float, folder: Path) -> bool:
    """Wait until it is that late for the vehicle -> whether the program ended before."""
    while _vehicle_s(folder) < at_s:
        with suppress(subprocess.TimeoutExpired):
            program.wait(_LOOK_S)
            return True
    return False


def _vehicle_s(folder: Path) -> float:
    """Vehicle time, as far as the simulator has written down the truth."""
    file = folder / "truth.jsonl"
    if not file.exists():
        return 0.0
    with file.open("rb") as truth:
        truth.seek(max(truth.seek(0, os.SEEK_END) - 2_000, 0))
        *_, last, _ = [b"", b"", *truth.read().split(b"\n")]  # the last line may be half there
    return float(json.loads(last or b"{}").get("t_s", 0.0))


def _planner_of(companion: int) -> int | None:
    """The process that computes a companion's plans."""
    for file in Path(f"/proc/{companion}/task").glob("*/children"):
        for child in file.read_text(encoding="ascii").split():
            if _PLANNER in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
    return None


_started_here: list[_Program] = []
"""The programs of the flight that this process flies over UDP."""


def end_programs() -> None:
    """Before this process ends in the middle of a flight."""
    for program in _started_here:
        program.kill()


def _started(command: list[str], out: Any) -> _Program:
    quiet: Any = {"stdin": subprocess.DEVNULL, "stdout": out, "stderr": subprocess.STDOUT}
    program = subprocess.Popen(command, env=os.environ | {"COLUMNS": "200"}, **quiet)
    _started_here.append(program)
    return program
