"""The bundled worlds are hard enough, as they promise (that they can be flown is flown)."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.campaign.drawn_world import bundled

ENVIRONMENTS = Path(__file__).parents[1] / "companion" / "environments"


def read(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """World and mission."""
    files = (ENVIRONMENTS / name / file for file in ("world.toml", "mission.toml"))
    world, mission = (tomllib.loads(file.read_text(encoding="utf-8")) for file in files)
    return world, mission


@pytest.mark.parametrize(
    ("name", "barred_m", "clear_m"),
    [("environment-1", 3e3, 5e3), ("environment-2", 3e3, 5e3), ("valley", 660.0, 200.0)],
)
def test_the_straight_way_is_barred_and_start_and_target_are_low_and_clear(
    name: str, barred_m: float, clear_m: float
) -> None:
    """By ground higher than so much, and in the environments by radars, too."""
    world = bundled(name)
    north, east = np.linspace(world.start_nea_m[:2], world.targets_ne_m[0], 4_001).T
    ground_m = world.terrain.height_m(north, east)
    assert ground_m.max() > barred_m
    assert ground_m[[0, -1]].max() < world.task.limits.floor_amsl_m - 50.0
    gaps_m = [zone.distance_m(north, east) for zone in world.task.zones]
    for radar in world.task.radars:
        n, e, _ = radar.centre_nea_m
        gaps_m.append(np.hypot(north - n, east - e) - radar.range_m)
    assert np.min(gaps_m, axis=0)[[0, -1]].min() > clear_m
    assert name == "valley" or np.min(gaps_m) < 0.0


@pytest.mark.parametrize("name", ["environment-1", "environment-2", "valley"])
def test_world_and_mission_agree_on_the_frame_and_the_vehicle(name: str) -> None:
    world, mission = read(name)
    flies, limits = world["vehicle"], mission["vehicle"]
    assert world["origin"] == mission["origin"]
    assert world.get("radars") == mission.get("radars")
    assert flies["kind"] == limits["kind"]
    assert flies["speed_max_m_s"] > limits["speed_m_s"]
    assert flies["acceleration_max_m_s2"] > limits["acceleration_m_s2"]
    assert limits["speed_m_s"] ** 2 / limits["turn_radius_m"] <= flies["acceleration_max_m_s2"]
    assert world["scanner"]["range_m"] >= mission["planner"]["scan_range_m"]
    if name == "valley":
        for side, sign in (("north_min", 1), ("east_min", 1), ("north_max", -1), ("east_max", -1)):
            assert sign * world["area"][f"{side}_m"] <= sign * mission["area"][f"{side}_m"]


def test_the_posts_stand_where_those_of_ardupilots_simulation_do() -> None:
    """SITL.cpp:1327-1332 (docs/lab/proximity.md 1): lanes 8 m wide between them."""
    world, mission = read("posts")
    rows = range(-10, 10)
    places = sorted((3.0 + 10.0 * i, 2.0 + 10.0 * j) for i in rows for j in rows)
    assert sorted((tree["north_m"], tree["east_m"]) for tree in world["trees"]) == places
    assert {tree["radius_m"] for tree in world["trees"]} == {1.0}
    origin = {"latitude_deg": 51.8752066, "longitude_deg": 14.648783}
    assert world["origin"] == mission["origin"] == origin
    tops_m = [world["terrain"]["ground_amsl_m"] + tree["height_m"] for tree in world["trees"]]
    assert min(tops_m) > mission["altitude"]["ceiling_amsl_m"] + mission["scanner"]["speaks_for_m"]
