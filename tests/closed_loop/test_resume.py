"""A companion that is killed with -9 again and again in one flight, and started again each time.

Real processes in lockstep.  What the autopilot was told is read from the telemetry log, which all
lives have written one after the other.
"""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import tlog
from flights import Flight, each, kept, launch, run, short_mission
from pymavlink.dialects.v20 import all as wire

pytestmark = pytest.mark.closed_loop

LOOK_S = 0.01
"""How long it flies between two looks at what it has kept."""
ALOFT = ("TAKING_OFF", "HOLDING", "FLYING")
Values = dict[str, Any]
Moment = Callable[[Values], bool]


WHEN: dict[str, Moment] = {
    "before its first leg": lambda now: now["phase"] in ALOFT and now["leg"] is None,
    "in a leg": lambda now: now["phase"] == "FLYING" and now["leg"] is not None,
    "at a join": lambda now: now["phase"] == "FLYING" and now["legs_flown"] >= 2,
    "landing": lambda now: bool(now["phase"] == "LANDING"),
}
MOMENTS: dict[str, tuple[str, ...]] = {
    "sitl-arducopter": ("in a leg",),  # at any: `tests/mission/test_kinds.py`
    "sitl-px4": tuple(WHEN),
    "sitl-arduplane": ("in a leg", "at a join"),
    "sitl-px4-plane": ("in a leg", "at a join"),
}


class Killed(NamedTuple):
    """A flight to its end, and where it was killed."""

    flight: Flight
    killed_at_s: list[float]


def killed(folder: Path, name: str) -> Killed:
    """Kill it at each of its moments, and start it again, as its service does."""
    mission = short_mission(name, folder.parent)
    it = Killed(launch(folder, name, mission, "--resume", "--system", 1), [])
    for moment in MOMENTS[name]:

        def look(is_now: Moment = WHEN[moment]) -> Values | None:
            values = kept(folder)
            return values if values is not None and is_now(values) else None

        companion = it.flight.companion
        it.killed_at_s.append(companion.until(look, every_s=LOOK_S)["t_s"])
        companion.kill()
        it.flight.companion = run(*map(str, companion.process.args))  # type: ignore[union-attr]
    it.flight.wait()
    return it


@each(
    *MOMENTS, nightly=["sitl-px4", "sitl-arduplane", "sitl-px4-plane"]
)  # planes: `replay/test_golden`
def test_it_arrives_however_often_it_was_killed_and_is_armed_once(flown: Any, name: str) -> None:
    """Journal and log hold all lives: in lockstep the vehicle waits for the next one."""
    flight, killed_at_s = flown(name, by=killed)
    flight.ended_well()
    last = flight.truth[-1]
    assert "plane" in name or (last["landed"] and not last["armed"])
    assert killed_at_s == sorted(killed_at_s)
    assert flight.says.count("target reached") >= 2
    heads = [k for k, entry in enumerate(flight.journal) if "schema" in entry]
    lives = [flight.journal[k].get("resumed", 0) for k in heads]
    assert lives == list(range(len(killed_at_s) + 1))
    assert "arm" not in [entry.get("kind") for entry in flight.journal[heads[1] :]]
    log = tlog.messages(flight.folder)
    times = [m.time_boot_ms * 1e-3 for m in log if m.get_type() == "GLOBAL_POSITION_INT"]
    gaps = [after - before for before, after in itertools.pairwise(times)]
    assert min(gaps) >= 0.0
    assert max(gaps) < 3.0
    arming = wire.MAV_CMD_COMPONENT_ARM_DISARM
    commands = [m for m in log if m.get_type() in ("COMMAND_LONG", "COMMAND_INT")]
    arms = [m for m in commands if m.command == arming and m.get_srcComponent() == 195]
    assert arms
    assert all((m.param1, m.param2) == (1.0, 0.0) for m in arms)
    armed = [row["armed"] for row in flight.truth]
    changes = [after for before, after in itertools.pairwise(armed) if before != after]
    assert changes in ([True], [True, False])
