"""The bundled worlds keep their promises: they are hard enough (that they can be flown is flown).

An implementation of its own, on purpose: it uses no planner, no terrain code, no file reader of the
product.
"""

import functools
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ENVIRONMENTS = Path(__file__).parents[1] / "companion" / "environments"
NAMES = ("environment-1", "environment-2")
CELL_M = 250.0
AXIS_M = np.arange(-5_000.0, 105_000.0 + CELL_M, CELL_M)
EVERY_NAME = pytest.mark.parametrize("name", NAMES)


@functools.cache
def read(name: str, file: str) -> dict[str, Any]:
    return tomllib.loads((ENVIRONMENTS / name / file).read_text(encoding="utf-8"))


def terrain_m(world: dict[str, Any], north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    """Eq. 1, the highest of the mountains and the plain."""
    height = np.full(np.broadcast(north_m, east_m).shape, world["terrain"]["ground_amsl_m"])
    for p in world["terrain"]["peaks"]:
        x = (north_m - p["north_m"]) / p["spread_north_m"]
        y = (east_m - p["east_m"]) / p["spread_east_m"]
        height = np.maximum(height, p["height_amsl_m"] * np.exp(-x * x - y * y))
    return height


def radar_margin_m(world: dict[str, Any], north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    """Horizontal distance to the nearest radar circle, negative inside."""
    margins: list[FloatArray] = [
        np.hypot(north_m - r["north_m"], east_m - r["east_m"]) - r["range_m"]
        for r in world["radars"]
    ]
    nearest: FloatArray = np.min(margins, axis=0)
    return nearest


@EVERY_NAME
def test_the_straight_line_is_barred_by_terrain_and_by_a_radar(name: str) -> None:
    line = np.linspace(0.0, 100_000.0, 4_001)
    world = read(name, "world.toml")
    assert terrain_m(world, line, line).max() > 3_000.0
    assert radar_margin_m(world, line, line).min() < 0.0


@EVERY_NAME
def test_start_and_target_are_low_and_out_of_sight(name: str) -> None:
    north, east = np.meshgrid(AXIS_M, AXIS_M, indexing="ij")
    world = read(name, "world.toml")
    height, margin = terrain_m(world, north, east), radar_margin_m(world, north, east)
    start, target = np.hypot(north, east), np.hypot(north - 100_000.0, east - 100_000.0)
    assert height[start <= 3_000.0].max() < 300.0
    assert height[target <= 5_000.0].max() < 2_000.0
    assert margin[np.minimum(start, target) <= 5_000.0].min() > 0.0


@pytest.mark.parametrize(
    ("name", "peaks", "radars", "ranges_m", "overlaps"),
    [
        ("environment-1", 4, 3, (9_000.0, 15_000.0), 0),
        ("environment-2", 12, 10, (6_000.0, 11_000.0), 4),
    ],
)
def test_each_world_holds_what_its_kind_promises(
    name: str, peaks: int, radars: int, ranges_m: tuple[float, float], overlaps: int
) -> None:
    world = read(name, "world.toml")
    heights = [p["height_amsl_m"] for p in world["terrain"]["peaks"]]
    assert len(heights) == peaks
    assert 3_400.0 <= min(heights) <= max(heights) <= 6_000.0
    assert len(world["radars"]) == radars
    assert all(ranges_m[0] <= r["range_m"] <= ranges_m[1] for r in world["radars"])
    pairs = [(a, b) for i, a in enumerate(world["radars"]) for b in world["radars"][:i]]
    apart = [math.dist((a["north_m"], a["east_m"]), (b["north_m"], b["east_m"])) for a, b in pairs]
    reach = [a["range_m"] + b["range_m"] for a, b in pairs]
    assert sum(d < r for d, r in zip(apart, reach, strict=True)) >= overlaps


@EVERY_NAME
def test_radars_stand_on_the_ground_and_are_the_same_in_both_files(name: str) -> None:
    world, mission = read(name, "world.toml"), read(name, "mission.toml")
    assert world["radars"] == mission["radars"]
    assert len({r["name"] for r in world["radars"]}) == len(world["radars"])
    for r in world["radars"]:
        ground = terrain_m(world, np.array(r["north_m"]), np.array(r["east_m"])).item()
        assert -1.0 <= r["altitude_amsl_m"] - ground <= 50.0


@EVERY_NAME
def test_world_and_mission_agree_on_the_frame_and_the_vehicle(name: str) -> None:
    world, mission = read(name, "world.toml"), read(name, "mission.toml")
    assert world["name"] == mission["name"] == name
    assert world["schema"] == mission["schema"] == 1
    assert world["origin"] == mission["origin"] == {"latitude_deg": 47.0, "longitude_deg": 8.0}
    assert mission["targets"] == [{"north_m": 100_000.0, "east_m": 100_000.0}]
    assert world["vehicle"]["kind"] == mission["vehicle"]["kind"]
    assert mission["vehicle"]["autopilot"] == "ardupilot"
    assert world["vehicle"]["autopilot"] == "ideal"
    assert world["vehicle"]["speed_max_m_s"] > mission["vehicle"]["speed_m_s"]
    assert world["vehicle"]["acceleration_max_m_s2"] > mission["vehicle"]["acceleration_m_s2"]
    assert world["scanner"]["range_m"] >= mission["planner"]["scan_range_m"]
    turn_m_s2 = mission["vehicle"]["speed_m_s"] ** 2 / mission["vehicle"]["turn_radius_m"]
    assert turn_m_s2 <= world["vehicle"]["acceleration_max_m_s2"]


def test_the_posts_stand_where_those_of_ardupilots_simulation_do() -> None:
    """SITL.cpp:1327-1332 (docs/reference/proximity.md 1): lanes 8 m wide between them."""
    world, mission = (read("posts", file) for file in ("world.toml", "mission.toml"))
    rows = range(-10, 10)
    places = sorted((3.0 + 10.0 * i, 2.0 + 10.0 * j) for i in rows for j in rows)
    assert sorted((tree["north_m"], tree["east_m"]) for tree in world["trees"]) == places
    assert {tree["radius_m"] for tree in world["trees"]} == {1.0}
    origin = {"latitude_deg": 51.8752066, "longitude_deg": 14.648783}
    assert world["origin"] == mission["origin"] == origin
    tops_m = [world["terrain"]["ground_amsl_m"] + tree["height_m"] for tree in world["trees"]]
    assert min(tops_m) > mission["altitude"]["ceiling_amsl_m"] + mission["scanner"]["speaks_for_m"]
