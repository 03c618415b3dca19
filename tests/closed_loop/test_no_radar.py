"""A plan without a terrain radar, and a radar that falls silent: nothing is left in the air."""

import json
from pathlib import Path
from typing import Any

import pytest
from flights import Flight, Launch

pytestmark = pytest.mark.closed_loop

HOME = (-35.3632621, 149.1652374, 584.0)
LAUNCH = f"{HOME[0]},{HOME[1]},{HOME[2]},0"
STATED = 'plan = "field.plan"\n[vehicle]\nscanner = false\n[terrain]\nhighest_amsl_m = 584.0\n'
AUTOPILOTS = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])


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


def begun(start: Launch, mission: Path, autopilot: str, *more: str) -> Flight:
    flight = start(
        f"--autopilot={autopilot}", str(mission), simulator_options=("--home", LAUNCH, *more)
    )
    flight.wait()
    return flight


def says(flight: Flight) -> list[str]:
    return [entry["text"] for entry in flight.journal if entry.get("kind") == "say"]


def kinds(flight: Flight) -> set[str]:
    return {entry["kind"] for entry in flight.journal if "kind" in entry}


def heights_m(flight: Flight) -> list[float]:
    """Above launch, as they truly were."""
    return [entry["altitude_amsl_m"] - HOME[2] for entry in flight.truth]


@AUTOPILOTS
def test_a_plan_for_a_vehicle_without_a_radar_is_refused_before_it_is_armed(
    start: Launch, tmp_path: Path, autopilot: str
) -> None:
    flight = begun(start, plan(tmp_path, (0.003, 40.0)), autopilot)
    assert flight.companion.returncode == 1
    assert not {"arm", "take off"} & kinds(flight)
    said = " ".join(flight.said["companion"].split())
    for part in ("did not answer TERRAIN_REQUEST", "scanner = false", "highest_amsl_m"):
        assert part in said


@AUTOPILOTS
def test_the_same_plan_over_stated_ground_is_flown_at_its_altitudes(
    start: Launch, tmp_path: Path, autopilot: str
) -> None:
    plan(tmp_path, (0.0012, 40.0), (0.0024, 60.0))
    mission = tmp_path / "mission.toml"
    mission.write_text(STATED, encoding="utf-8")
    flight = begun(start, mission, autopilot)
    assert flight.companion.returncode == 0, flight.said["companion"]
    assert "mission field" in says(flight)
    reached = [e["t_s"] for e in flight.journal if e.get("text") == "target reached"]
    truth = [(e["t_s"], e["altitude_amsl_m"] - HOME[2]) for e in flight.truth]
    for at_s, wanted_m in zip(reached, (40.0, 60.0), strict=False):
        there_m = min(truth, key=lambda each: abs(each[0] - at_s))[1]
        assert there_m == pytest.approx(wanted_m, abs=3.0)
    assert max(heights_m(flight)) < 65.0
    assert heights_m(flight)[-1] < 1.0


@pytest.mark.parametrize(
    ("autopilot", "fault"),
    [
        ("ardupilot", "radar_off"),
        ("px4", "battery 12 %"),
        pytest.param("ardupilot", "battery 12 %", marks=pytest.mark.nightly),
        pytest.param("px4", "radar_off", marks=pytest.mark.nightly),
    ],
)
def test_a_flight_that_fails_comes_back_the_way_it_came_and_lands(
    start: Launch, tmp_path: Path, autopilot: str, fault: str
) -> None:
    faults = tmp_path / "faults.txt"
    faults.write_text(f"at 100 s: {fault}\n", encoding="utf-8")
    mission = tmp_path / "mission.toml"
    mission.write_text('plan = "field.plan"\n[planner]\nscan_range_m = 600.0\n', encoding="utf-8")
    plan(tmp_path, (0.02, 60.0))
    options = ("--scan-range", "600", "--faults", str(faults))
    flight = begun(start, mission, autopilot, *options)
    assert flight.companion.returncode == 1
    assert any(text.endswith(": flying back and landing") for text in says(flight))
    [end] = [entry for entry in flight.journal if entry.get("kind") == "end"]
    assert end["reason"].startswith("landed: ")
    assert heights_m(flight)[-1] < 1.0
