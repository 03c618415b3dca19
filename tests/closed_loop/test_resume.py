"""A companion that is killed with -9 again and again in one flight, and started again each time.

Real processes in lockstep.  What the autopilot was told is read from the telemetry log, which all
lives have written one after the other.
"""

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tlog
from flights import ENVIRONMENTS, NIGHTLY, launch, mission_file, run
from pymavlink.dialects.v20 import all as wire

pytestmark = pytest.mark.closed_loop

LOOK_S = 0.01
"""How long it flies between two looks at what it has kept."""
ALOFT = ("TAKING_OFF", "HOLDING", "FLYING")
Values = dict[str, Any]
WHEN: dict[str, Callable[[Values], bool]] = {
    "before its first leg": lambda now: now["phase"] in ALOFT and now["leg"] is None,
    "in a leg": lambda now: now["phase"] == "FLYING" and now["leg"] is not None,
    "at a join": lambda now: now["phase"] == "FLYING" and now["legs_flown"] >= 2,
    "landing": lambda now: bool(now["phase"] == "LANDING"),
}
EDGES = ("min", -100.0), ("max", 600.0)
SHORTER: dict[str, Any] = {
    "area": {f"{side}_{end}_m": at for side in ("north", "east") for end, at in EDGES},
    "planner": {"scan_range_m": 200.0},
    "battery": {"reserve_percent": 2},
}
"""Tables of a mission with more joins, and a battery that lasts."""


@pytest.mark.parametrize(
    ("name", "moments", "far_m"),
    [
        ("sitl-arducopter", ["in a leg"], 120.0),  # at any: `tests/mission/test_kinds.py`
        pytest.param("sitl-px4", [*WHEN], 300.0, marks=NIGHTLY),  # a plane: a golden flight
    ],
)
def test_it_arrives_however_often_it_was_killed_and_is_armed_once(
    name: str, moments: list[str], far_m: float, tmp_path: Path
) -> None:
    """Journal and log hold all lives: in lockstep the vehicle waits for the next one."""
    targets = [{"north_m": far_m, "east_m": 100.0}, {"north_m": far_m, "east_m": 100.0 + far_m}]
    file, folder = tmp_path / f"{name}.toml", tmp_path / "run"
    mission = mission_file(name, file, **SHORTER, targets=targets)
    flight = launch(folder, ENVIRONMENTS / name / "world.toml", mission, "--resume", "--system", 1)
    for moment in moments:

        def is_now(moment: str = moment) -> bool:
            try:  # what it has kept of its flight by now, for the one that follows it
                return WHEN[moment](json.loads((folder / "resume.json").read_bytes())["values"])
            except (OSError, ValueError):
                return False

        flight.companion.until(is_now, every_s=LOOK_S)
        flight.companion.kill()
        flight.companion = run(*map(str, flight.companion.process.args))
    flight.ends_well()
    last = flight.truth[-1]
    assert last["landed"]
    assert not last["armed"]
    assert flight.says.count("target reached") >= 2
    heads = [k for k, entry in enumerate(flight.journal) if "schema" in entry]
    lives = [flight.journal[k].get("resumed", 0) for k in heads]
    assert lives == list(range(len(moments) + 1))
    assert "arm" not in [entry.get("kind") for entry in flight.journal[heads[1] :]]
    log = tlog.messages(folder)
    times = [m.time_boot_ms * 1e-3 for m in log if m.get_type() == "GLOBAL_POSITION_INT"]
    gaps = [after - before for before, after in itertools.pairwise(times)]
    assert 0.0 <= min(gaps) <= max(gaps) < 3.0
    commands = [m for m in log if m.get_type() in ("COMMAND_LONG", "COMMAND_INT")]
    arms = [m for m in commands if m.command == wire.MAV_CMD_COMPONENT_ARM_DISARM]
    ours = [(m.param1, m.param2) for m in arms if m.get_srcComponent() == 195]
    assert set(ours) == {(1.0, 0.0)}
    armed = [row["armed"] for row in flight.truth]
    changes = [after for before, after in itertools.pairwise(armed) if before != after]
    assert changes == [True, False]
