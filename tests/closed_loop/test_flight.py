"""Whole flights: what they leave, and that over UDP they are the same to the byte.

The flight over the hills is flown twice: in this process, and over UDP by two processes, where it
is shown on a terminal and as JSON, on a disk that becomes full.
"""

import contextlib
import json
import math
import os
import pty
import re
import socket
import subprocess
import sys
import termios
import threading
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import pytest
import true_track
from flights import (
    ENVIRONMENT,
    ENVIRONMENTS,
    FAULTS,
    HILLS,
    HILLS_MISSION,
    SEED,
    Recorded,
    flown_here,
    launch,
    run,
    warm_up,
)
from programs import BIN, free_port
from pymavlink.dialects.v20 import all as wire
from tlog import recorded_frames

from companion.campaign import in_process, judge
from companion.campaign.drawn_world import of_files
from companion.config import load_mission
from companion.planner.plan import plan
from companion.runtime.compiler import load_kernel
from companion.runtime.in_process import fly_in_process
from companion.session import Session
from companion.telemetry.flight_status import FlightBegun, FlightEnded, FlightStatus
from companion.telemetry.journal import Journal
from companion.telemetry.run_folder import whole_records
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

pytestmark = [pytest.mark.closed_loop, pytest.mark.xdist_group("hills")]
TICK_S = 0.15  # a position, and its rounding
WIDTH = 80
MOST_BYTES = 600_000
"""The operating system refuses more than so many bytes of any file of the companion's."""
FLY = (
    f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({MOST_BYTES},) * 2)\n"
    "from companion.cli import main\nmain()"
)


# --- in this process


def keeps_every_bound(flight: Recorded, world: str | Path, mission: str | Path) -> None:
    """By the judge of campaigns: ground, zones, crashes; turns, slopes and heights by their own."""
    drawn, asked = of_files(str(world), str(mission)), load_mission(str(mission))
    left = in_process.Flight(
        mission=asked, journal=flight.journal[1:], truth=flight.truth,
        plans_s=[], reported=np.empty((0, 5)),
    )  # fmt: skip
    assert flight.outcome == "arrived"
    assert judge.judged(left, drawn, None)["violated"] is None
    keys, begun_s = ("north_m", "east_m", "altitude_amsl_m"), flight.entries("leg")[0]["t_s"]
    led = np.array([[row[key] for key in keys] for row in flight.truth if row["t_s"] >= begun_s])
    margins = true_track.margins(asked.task, led)
    assert min(margins.values()) >= 0.0, margins
    assert math.dist(led[-1, :2], asked.targets_ne_m[-1]) < 50.0


def test_a_flight_arrives_by_proven_legs_and_its_true_track_keeps_every_bound(
    hills: Recorded,
) -> None:
    legs = hills.entries("plan ready")
    assert len(legs) >= len(hills.entries("leg")) > 2
    assert all(leg["certificate"]["broken"] == [] for leg in legs)
    assert {leg["kernel"].split()[0] for leg in legs} == {"numba"}
    keeps_every_bound(hills, HILLS, hills.mission)
    assert hills.truth[-1]["mode"] == "BRAKE"


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["valley", "environment-1", "environment-2"])
def test_so_it_does_over_each_bundled_ground(name: str, tmp_path: Path) -> None:
    world, mission = (ENVIRONMENTS / name / f"{what}.toml" for what in ("world", "mission"))
    keeps_every_bound(flown_here(tmp_path / "run", world, mission), world, mission)


@pytest.mark.nightly
def test_the_paper_profile_flies_too(tmp_path: Path) -> None:
    flight = launch(tmp_path / "run", HILLS, HILLS_MISSION, "--profile", "paper")
    flight.ends_well()
    assert flight.journal[0]["profile"] == "paper"


def test_a_flight_in_one_process_opens_no_socket_and_starts_no_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise AssertionError

    load_kernel()
    monkeypatch.setattr(socket, "socket", refused)
    monkeypatch.setattr(threading.Thread, "start", refused)
    session = Session(load_mission(HILLS_MISSION), seed=SEED, lockstep=True)
    vehicle = Simulation(read_world(Path(HILLS)))
    flown = fly_in_process(
        session, vehicle, planner=plan, stop_asked=lambda: vehicle.now_us >= 60_000_000
    )
    assert flown.end.outcome.value == "stopped"
    assert 60.0 <= vehicle.now_us * 1e-6 < 61.0


# --- over UDP


class Shown(NamedTuple):
    """A flight that was shown: its folders, and what both of its outputs showed."""

    flight: Recorded
    truth: Path
    screen: str
    lines: list[str]


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory, hills: Recorded) -> Shown:
    folder, port = tmp_path_factory.mktemp("shown"), free_port()
    (folder / "faults.txt").write_text(FAULTS, encoding="utf-8")
    screen, terminal = pty.openpty()
    termios.tcsetwinsize(terminal, (24, WIDTH))
    warm_up()
    how = f"--seed {SEED} --start --lockstep --json --connect udpin:127.0.0.1:{port} --out run"
    with (folder / "lines.json").open("wb") as lines:
        us = subprocess.Popen(
            [sys.executable, "-c", FLY, "fly", hills.mission, *how.split()],
            stdin=terminal, stdout=lines, stderr=terminal, cwd=folder,
            env={**ENVIRONMENT, "TERM": "xterm-256color", "COLUMNS": f"{WIDTH}"},
        )  # fmt: skip
    os.close(terminal)
    how = f"--seed {SEED} --connect udpout:127.0.0.1:{port} --lockstep --out {folder} --faults"
    vehicle = run(BIN / "vehicle-sim", HILLS, *how.split(), folder / "faults.txt")
    try:
        drawn = b""
        with contextlib.suppress(OSError):  # Linux's end of a terminal
            while chunk := os.read(screen, 65536):
                drawn += chunk
        assert us.wait(60.0) == 0, drawn.decode()
        assert vehicle.wait() == 0, vehicle.transcript
    finally:
        us.kill()
        os.close(screen)
    told = (folder / "lines.json").read_text(encoding="utf-8").splitlines()
    return Shown(Recorded(folder=folder / "run"), folder, drawn.decode(), told)


def from_the_first_sync(log: Path) -> list[tuple[int, int, bytes]]:
    """Microseconds, numbers and contents of a log's frames from lockstep's first question on.

    Before it the simulator sends heartbeats by the wall clock, until it is heard.  By that clock it
    also asks again; what is asked and answered again is left out, and in the companion's numbers.
    """
    found, syncs, repeated = list[tuple[int, int, bytes]](), set[bytes](), 0
    for stamp_us, frame in recorded_frames(log):
        ours, told = frame[6] == wire.MAV_COMP_ID_PATHPLANNER, frame[5:-2]
        if told in syncs:
            repeated += ours
            continue
        if int.from_bytes(frame[7:10], "little") == wire.MAVLINK_MSG_ID_TIMESYNC:
            syncs.add(told)
        if syncs:
            found.append((stamp_us, (frame[4] - ours * repeated) % 256, told))
    return [(stamp_us - found[0][0], *frame) for stamp_us, *frame in found]


def test_over_udp_and_while_it_is_shown_it_is_the_same_to_the_byte(
    shown: Shown, hills: Recorded
) -> None:
    """As far as it could be recorded; and to its end, as the vehicle truly flew."""
    there = from_the_first_sync(shown.flight.folder / "flight.tlog")
    assert len(there) > 5_000
    assert there == from_the_first_sync(hills.folder / "flight.tlog")[: len(there)]
    _, *entries = shown.flight.journal
    assert entries == hills.journal[1 : len(entries) + 1]
    assert Recorded(folder=shown.truth).truth[: len(hills.truth)] == hills.truth


def test_a_flight_whose_disk_is_full_goes_on_says_so_and_leaves_whole_records(shown: Shown) -> None:
    for said in ("arrived", "not recorded any more: File too large", "recording stopped: File"):
        assert said in shown.screen
    folder = shown.flight.folder
    log = folder / "flight.tlog"
    assert MOST_BYTES - 300 < log.stat().st_size == whole_records(log) <= MOST_BYTES
    journal = Journal(folder / "journal.jsonl")
    assert "end" not in {entry.kind for entry in journal.entries()}  # that was later
    assert journal.findings == ()


def test_its_lines_of_json_are_as_documented_and_say_what_its_journal_says(
    shown: Shown, hills: Recorded
) -> None:
    """The page is made from these classes."""
    kinds = FlightBegun | FlightStatus | FlightEnded
    begun, *statuses, ended = (msgspec.json.decode(line, type=kinds) for line in shown.lines)
    assert isinstance(begun, FlightBegun)
    for line, told in zip(shown.lines, (begun, *statuses, ended), strict=True):
        assert json.loads(line) == json.loads(msgspec.json.encode(told))  # no other fields
    [end] = hills.entries("end")
    said = ended.outcome.value, ended.reason, ended.exit_code
    assert said == (end["outcome"], end["reason"], 0)
    phases = [(0.0, "waiting"), *((e["t_s"], e["phase"]) for e in hills.entries("phase"))]
    for status in statuses:
        begins = [phase for t_s, phase in phases if abs(t_s - status.t_s) <= TICK_S]
        before = [phase for t_s, phase in phases if t_s <= max(status.t_s - TICK_S, 0.0)][-1]
        assert status.phase in (before, *begins), status
    assert {"flying", "done"} <= {status.phase for status in statuses}


def test_on_a_terminal_a_table_is_drawn_and_the_cursor_is_given_back(shown: Shown) -> None:
    assert shown.screen.count("\x1b[?25l") == shown.screen.count("\x1b[?25h") > 0
    assert shown.screen.rindex("\x1b[?25h") < shown.screen.index("run folder: ")
    text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.screen)  # no colours, no moves
    table = [line for line in text.splitlines() if line.startswith(("to go ", "FLYING "))]
    assert table
    assert max(map(len, table)) <= WIDTH
