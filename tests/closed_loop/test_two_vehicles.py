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

from companion.config import mission_text
from companion.sources.files import toml_table, toml_text

pytestmark = [pytest.mark.closed_loop, pytest.mark.nightly]

TARGETS_NE_M = {1: (90.0, 0.0), 2: (-60.0, 110.0)}
COMPANION = 195


def spoken(datagrams: list[bytes]) -> list[Any]:
    """All messages, of all systems."""
    parser = wire.MAVLink(None)
    parser.robust_parsing = True
    return [message for data in datagrams for message in parser.parse_buffer(data) or ()]


def test_each_companion_flies_its_own_vehicle_and_never_commands_the_other(
    tmp_path: Path,
) -> None:
    companions, table = [], toml_table(mission_text("sitl-px4"), "sitl-px4")
    with Router() as router:
        port = f"udpout:127.0.0.1:{router.port}"
        for system, (north_m, east_m) in TARGETS_NE_M.items():
            mission = tmp_path / f"mission-{system}.toml"
            own = {"targets": [{"north_m": north_m, "east_m": east_m}]}
            own |= {"vehicle": table["vehicle"] | {"system_id": system}}
            mission.write_text(toml_text(table | own), encoding="utf-8")
            companions.append(companion(mission, tmp_path / f"run-{system}", port))
        options = "--connect", port, "--count", 2, "--speedup", 3
        simulator("sitl-px4", tmp_path / "truth", *options)
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
