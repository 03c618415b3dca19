"""A plan without a terrain radar: refused, or over stated ground flown at its altitudes."""

import json
from pathlib import Path
from typing import Any

import pytest
from flights import NIGHTLY, Recorded, flown_with

from companion.config import load_mission
from companion.mavlink.preflight import checks_of
from companion.session import Session
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

pytestmark = pytest.mark.closed_loop

HOME = (-35.3632621, 149.1652374, 584.0)
STATED = 'plan = "field.plan"\n[vehicle]\nscanner = false\n[terrain]\nhighest_amsl_m = 584.0\n'


def plan(folder: Path, *waypoints: tuple[float, float]) -> Path:
    """Waypoints to the north, each by its latitude beyond launch and its height above it."""
    items: list[dict[str, Any]] = [
        {
            "type": "SimpleItem",
            "command": 16,
            "frame": 3,
            "params": [0, 0, 0, None, HOME[0] + north_deg, HOME[1], height_m],
        }
        for north_deg, height_m in waypoints
    ]
    items.append({"type": "SimpleItem", "command": 20, "frame": 2, "params": [0] * 7})
    mission = {"plannedHomePosition": HOME, "vehicleType": 2, "hoverSpeed": 8, "items": items}
    path = folder / "field.plan"
    path.write_text(json.dumps({"fileType": "Plan", "mission": mission}), encoding="utf-8")
    return path


def flight_of(mission: Path, autopilot: str) -> tuple[Recorded, Session]:
    """Flown to its end, over level ground at launch."""
    world = flat_world(
        "copter",
        autopilot,  # type: ignore[arg-type]
        latitude_deg=HOME[0],
        longitude_deg=HOME[1],
        altitude_amsl_m=HOME[2],
        heading_deg=0.0,
    )
    session = Session(load_mission(str(mission)), seed=1, lockstep=True)
    flight = flown_with(mission.parent / "run", session, Simulation(world, seed=1))
    return flight, session


@pytest.mark.parametrize("autopilot", ["ardupilot", pytest.param("px4", marks=NIGHTLY)])
def test_a_plan_for_a_vehicle_without_a_radar_is_refused_before_it_is_armed(
    tmp_path: Path, autopilot: str
) -> None:
    flight, session = flight_of(plan(tmp_path, (0.003, 40.0)), autopilot)
    assert flight.outcome == "failed"
    assert not {"arm", "take off"} & set(flight.kinds)
    said = " ".join(f"{each.what}. {each.remedy}" for each in checks_of(session))
    for part in ("did not answer TERRAIN_REQUEST", "scanner = false", "highest_amsl_m"):
        assert part in said


@pytest.mark.parametrize("autopilot", ["px4", pytest.param("ardupilot", marks=NIGHTLY)])
def test_the_same_plan_over_stated_ground_is_flown_at_its_altitudes(
    tmp_path: Path, autopilot: str
) -> None:
    plan(tmp_path, (0.0012, 40.0), (0.0024, 60.0))
    mission = tmp_path / "mission.toml"
    mission.write_text(STATED, encoding="utf-8")
    flight, _ = flight_of(mission, autopilot)
    assert flight.outcome == "arrived"
    assert "mission field" in flight.says
    reached = [e["t_s"] for e in flight.journal if e.get("text") == "target reached"]
    truth = [(row["t_s"], row["altitude_amsl_m"] - HOME[2]) for row in flight.truth]
    for at_s, wanted_m in zip(reached, (40.0, 60.0), strict=False):
        there_m = min(truth, key=lambda each: abs(each[0] - at_s))[1]
        assert there_m == pytest.approx(wanted_m, abs=3.0)
    assert max(height_m for _, height_m in truth) < 65.0
    assert truth[-1][1] < 1.0
