"""Other people's missions, flown by both programs in one process: what truly comes of them.

A plane that is to land, and a plan for a copter without a radar, over ground that is stated.
"""

import json
import math
from pathlib import Path
from typing import Any, Literal

import pytest
from flights import ENVIRONMENTS, NIGHTLY, flown_here, flown_with

from companion.config import load_mission
from companion.session import Session
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

pytestmark = pytest.mark.closed_loop
ARDUPLANE, PX4_PLANE = "sitl-arduplane", "sitl-px4-plane"


@pytest.mark.parametrize("name", [pytest.param(ARDUPLANE, marks=NIGHTLY), PX4_PLANE])
def test_a_plane_passes_its_target_and_ends_where_it_said_before_its_take_off(
    name: str, tmp_path: Path
) -> None:
    """Told to land, ArduPlane circles the target; PX4's comes down on a circle about it."""
    target = (1_000.0, 250.0)
    text = (ENVIRONMENTS / name / "mission.toml").read_text(encoding="utf-8")
    text = text.replace('autopilot = "ardupilot"\n', "")  # a file that names it is refused
    head, *_, last = text.replace('action = "hold"', 'action = "land"').split("[[targets]]")
    place = "[[targets]]\nnorth_m = {}\neast_m = {}\n\n".format(*target)
    mission = tmp_path / "mission.toml"
    mission.write_text(f"{head}{place}{last[last.index('[') :]}", encoding="utf-8")
    limits = load_mission(str(mission)).task.limits
    flight = flown_here(tmp_path / "run", ENVIRONMENTS / name / "world.toml", mission)
    away_m = [math.dist((row["north_m"], row["east_m"]), target) for row in flight.truth]
    assert min(away_m) <= limits.tracking_error_m
    assert flight.outcome == "arrived"
    assert away_m[-1] <= 1.5 * limits.loiter_radius_m
    words = "lands on a circle: up to" if name == PX4_PLANE else "is not told to land: it circles"
    assert words in flight.says[1]  # after the mission's name
    refused = [e for e in flight.journal if e.get("kind") == "acknowledged" and e["command"] == 192]
    assert not refused  # DO_REPOSITION: one that is taken is not in the journal


LAUNCH = (-35.3632621, 149.1652374, 584.0)
STATED = 'plan = "field.plan"\n[vehicle]\nscanner = false\n[terrain]\nhighest_amsl_m = 584.0\n'
HEIGHTS_M = (40.0, 60.0)
"""Above launch, of one waypoint to the north of the other."""


@pytest.mark.parametrize("autopilot", ["px4", pytest.param("ardupilot", marks=NIGHTLY)])
def test_a_plan_over_stated_ground_is_flown_at_its_altitudes(
    tmp_path: Path, autopilot: Literal["px4", "ardupilot"]
) -> None:
    """Without a radar; where its ground is not stated either: `tests/mavlink/test_preflight.py`."""
    latitude, longitude, home_m = LAUNCH
    places = [(latitude + 3e-5 * height_m, longitude, height_m) for height_m in HEIGHTS_M]
    items: list[dict[str, Any]] = [
        {"type": "SimpleItem", "command": 16, "frame": 3, "params": [0, 0, 0, None, *place]}
        for place in places
    ]
    items.append({"type": "SimpleItem", "command": 20, "frame": 2, "params": [0] * 7})
    plan = {"plannedHomePosition": LAUNCH, "vehicleType": 2, "hoverSpeed": 8, "items": items}
    mission = tmp_path / "mission.toml"
    mission.write_text(STATED, encoding="utf-8")
    (tmp_path / "field.plan").write_text(json.dumps({"fileType": "Plan", "mission": plan}))
    world = flat_world(
        "copter",
        autopilot,
        latitude_deg=latitude,
        longitude_deg=longitude,
        altitude_amsl_m=home_m,
        heading_deg=0.0,
    )
    session = Session(load_mission(str(mission)), seed=1, lockstep=True)
    flight = flown_with(tmp_path / "run", session, Simulation(world, seed=1))
    assert flight.outcome == "arrived"
    assert "mission field" in flight.says
    reached = [e["t_s"] for e in flight.journal if e.get("text") == "target reached"]
    truth = [(row["t_s"], row["altitude_amsl_m"] - home_m) for row in flight.truth]
    for at_s, wanted_m in zip(reached, HEIGHTS_M, strict=False):
        there_m = min(truth, key=lambda each: abs(each[0] - at_s))[1]
        assert there_m == pytest.approx(wanted_m, abs=3.0)
    assert max(height_m for _, height_m in truth) < 65.0
    assert truth[-1][1] < 1.0
