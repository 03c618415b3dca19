"""A flight without sockets is the flight over UDP, byte for byte."""

import socket
import threading
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from flights import BAD_LINK, flown_as, journal_of
from pymavlink.dialects.v20 import all as wire

from companion.config import load_mission, mission_text
from companion.planner.plan import plan
from companion.runtime.compiler import load_kernel
from companion.runtime.in_process import fly_in_process
from companion.session import Session
from companion.telemetry.run_folder import RunFolder
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

pytestmark = [pytest.mark.closed_loop, pytest.mark.xdist_group("hills")]
WORLD, MISSION, _, SEED = flown_as("hills")
EPOCH_US = 1_700_000_000_000_000


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The flight of the hills, over the same bad link."""
    folder = tmp_path_factory.mktemp("here") / "run"
    faults = Path(BAD_LINK[1]).read_text(encoding="utf-8")
    us = Session(load_mission(MISSION), seed=int(SEED), lockstep=True, version=version("companion"))
    vehicle = Simulation(read_world(Path(WORLD)), faults=faults)
    with RunFolder(
        folder, mission_toml=mission_text(MISSION), epoch_us=EPOCH_US, durable=False
    ) as run:
        fly_in_process(us, vehicle, planner=plan, folder=run)
    return folder


def log_of(folder: Path) -> list[tuple[int, bytes]]:
    """Vehicle time, microseconds, and frame, from the first question of the lockstep on.

    Before it the simulator sends heartbeats by the wall clock, until it is heard.
    """
    data, at, found = (folder / "flight.tlog").read_bytes(), 0, list[tuple[int, bytes]]()
    while at < len(data):
        stamp_us = int.from_bytes(data[at : at + 8], "big")
        end = at + 8 + 12 + data[at + 9]
        found.append((stamp_us, data[at + 8 : end]))
        at = end
    sync = wire.MAVLINK_MSG_ID_TIMESYNC
    first = next(i for i, (_, f) in enumerate(found) if int.from_bytes(f[7:10], "little") == sync)
    return [(stamp_us - found[first][0], frame) for stamp_us, frame in found[first:]]


def test_it_says_and_decides_what_it_does_over_udp(flown: Any, here: Path) -> None:
    over_udp = flown(*flown_as("hills")).folder
    _, *theirs = journal_of(over_udp)
    ours = journal_of(here)
    assert ours == theirs
    assert len(ours) > 50
    assert [entry["outcome"] for entry in ours if entry["kind"] == "end"] == ["arrived"]
    assert log_of(here) == log_of(over_udp)


def test_it_opens_no_socket_and_starts_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise AssertionError

    load_kernel()
    monkeypatch.setattr(socket, "socket", refused)
    monkeypatch.setattr(threading.Thread, "start", refused)
    mission = load_mission(MISSION)
    simulation = Simulation(read_world(Path(WORLD)))
    flown = fly_in_process(
        Session(mission, seed=3, lockstep=True),
        simulation,
        planner=plan,
        stop_asked=lambda: simulation.now_us >= 60_000_000,
    )
    assert flown.end is not None
    assert flown.end.outcome.value == "stopped"
    assert 60.0 <= simulation.now_us * 1e-6 < 61.0
