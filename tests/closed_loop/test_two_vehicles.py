"""Two companions and two vehicles on one port: each flies its own mission, and no other vehicle."""

import json
import math
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from flights import BIN, ROOT, warm_up
from pymavlink.dialects.v20 import all as wire
from router import Router

pytestmark = pytest.mark.closed_loop

TARGETS_NE_M = {1: (90.0, 0.0), 2: (-60.0, 110.0)}
COMPANION = 195
PATIENCE_S = 400.0
WORLD = """
schema = 1
name = "meadow"
[origin]
latitude_deg = 47.397742
longitude_deg = 8.545594
[terrain]
combine = "maximum"
ground_amsl_m = 488.0
[vehicle]
kind = "copter"
autopilot = "px4"
[scanner]
component_id = 100
range_m = 300.0
"""
MISSION = """
schema = 1
name = "vehicle {system}"
[origin]
latitude_deg = 47.397742
longitude_deg = 8.545594
[area]
north_min_m = -400.0
north_max_m = 400.0
east_min_m = -400.0
east_max_m = 400.0
[altitude]
floor_amsl_m = 505.0
ceiling_amsl_m = 560.0
[[targets]]
north_m = {north}
east_m = {east}
[vehicle]
kind = "copter"
system_id = {system}
speed_m_s = 6.0
acceleration_m_s2 = 2.0
climb_rate_m_s = 1.5
turn_radius_m = 20.0
climb_angle_deg = 12.0
dive_angle_deg = 10.0
tracking_error_m = 4.0
navigation_error_m = 3.0
dead_man_s = 1.5
[planner]
scan_range_m = 300.0
safety_distance_m = 8.0
planning_time_s = 3.0
[end]
action = "hold"
"""


@pytest.fixture
def processes() -> Iterator[list[subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []
    yield started
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


def start(*command: Any) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [str(part) for part in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
    )


def spoken(datagrams: list[bytes]) -> list[Any]:
    """All messages, of all systems."""
    parser = wire.MAVLink(None)
    parser.robust_parsing = True
    return [message for data in datagrams for message in parser.parse_buffer(data) or ()]


def recorded(tlog: Path) -> list[Any]:
    """The messages of a telemetry log, in their order."""
    data, at, found = tlog.read_bytes(), 0, []
    parser = wire.MAVLink(None)
    while at + 8 < len(data):
        size = 12 + data[at + 9]
        found += parser.parse_buffer(data[at + 8 : at + 8 + size]) or []
        at += 8 + size
    return found


@pytest.mark.xdist_group("two vehicles")
def test_each_companion_flies_its_own_vehicle_and_never_commands_the_other(
    tmp_path: Path, processes: list[subprocess.Popen[str]]
) -> None:
    warm_up()
    world = tmp_path / "world.toml"
    world.write_text(WORLD, encoding="utf-8")
    companions = {}
    with Router() as router:
        port = f"udpout:127.0.0.1:{router.port}"
        for system, (north, east) in TARGETS_NE_M.items():
            mission = tmp_path / f"mission-{system}.toml"
            mission.write_text(
                MISSION.format(system=system, north=north, east=east), encoding="utf-8"
            )
            out = tmp_path / f"run-{system}"
            command = (BIN / "companion", "fly", mission, "--connect", port, "--out", out)
            companions[system] = start(*command)
        simulator = (BIN / "vehicle-sim", world, "--connect", port, "--count", 2)
        processes += [
            start(*simulator, "--speedup", 3, "--out", tmp_path / "truth"),
            *companions.values(),
        ]
        for system, companion in companions.items():
            said, _ = companion.communicate(timeout=PATIENCE_S)
            assert companion.returncode == 0, f"companion {system}: {said}"

    commanded = {1: 0, 2: 0}
    for message in spoken(router.passed):
        if message.get_srcComponent() == COMPANION and hasattr(message, "target_system"):
            system = message.get_srcSystem()
            assert message.target_system == system, message
            commanded[system] += message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"
    assert min(commanded.values()) > 100

    for system, target in TARGETS_NE_M.items():
        name = "truth.jsonl" if system == 1 else f"truth-{system}.jsonl"
        last = (tmp_path / "truth" / name).read_text(encoding="utf-8").splitlines()[-1]
        place = json.loads(last)
        assert math.dist((place["north_m"], place["east_m"]), target) < 5.0
        mine = recorded(tmp_path / f"run-{system}" / "flight.tlog")
        setpoints = [m for m in mine if m.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"]
        own = [m for m in setpoints if m.get_srcSystem() == system]
        assert len(own) == commanded[system]
        assert {m.target_system for m in own} == {system}


def test_a_log_is_read_as_it_was_written(tmp_path: Path) -> None:
    codec = wire.MAVLink(None, srcSystem=1, srcComponent=COMPANION)
    frame = wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(codec)
    log = tmp_path / "flight.tlog"
    log.write_bytes(b"".join(struct.pack(">Q", k) + frame for k in range(3)))
    assert [message.get_type() for message in recorded(log)] == ["HEARTBEAT"] * 3
