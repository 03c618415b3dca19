"""Two companions and two vehicles on one port: each flies its own mission, and no other vehicle."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
import tlog
from flights import companion, simulator
from pymavlink.dialects.v20 import all as wire
from router import Router

pytestmark = [pytest.mark.closed_loop, pytest.mark.nightly]

TARGETS_NE_M = {1: (90.0, 0.0), 2: (-60.0, 110.0)}
COMPANION = 195
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


def spoken(datagrams: list[bytes]) -> list[Any]:
    """All messages, of all systems."""
    parser = wire.MAVLink(None)
    parser.robust_parsing = True
    return [message for data in datagrams for message in parser.parse_buffer(data) or ()]


def test_each_companion_flies_its_own_vehicle_and_never_commands_the_other(
    tmp_path: Path,
) -> None:
    world = tmp_path / "world.toml"
    world.write_text(WORLD, encoding="utf-8")
    companions = []
    with Router() as router:
        port = f"udpout:127.0.0.1:{router.port}"
        for system, (north, east) in TARGETS_NE_M.items():
            mission = tmp_path / f"mission-{system}.toml"
            text = MISSION.format(system=system, north=north, east=east)
            mission.write_text(text, encoding="utf-8")
            companions.append(companion(mission, tmp_path / f"run-{system}", port))
        options = "--connect", port, "--count", 2, "--speedup", 3
        simulator(world, tmp_path / "truth", *options)
        for each in companions:
            assert each.wait() == 0, each.transcript

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
        mine = tlog.messages(tmp_path / f"run-{system}")
        setpoints = [m for m in mine if m.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"]
        own = [m for m in setpoints if m.get_srcSystem() == system]
        assert len(own) == commanded[system]
        assert {m.target_system for m in own} == {system}
