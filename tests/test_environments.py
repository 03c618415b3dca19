"""The bundled worlds keep their promises: they are hard enough (that they can be flown is flown).

An implementation of its own, on purpose: it uses no planner, no terrain code, no file reader of the
product.  Heights of the valley come from matplotlib's sample and not from the file that was made of
it, positions in it from geodesics.
"""

import functools
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from matplotlib import cbook
from numpy.typing import NDArray
from pyproj import Geod
from scipy.ndimage import map_coordinates

FloatArray = NDArray[np.float64]
ENVIRONMENTS = Path(__file__).parents[1] / "companion" / "environments"
CELL_M = 250.0
AXIS_M = np.arange(-5_000.0, 105_000.0 + CELL_M, CELL_M)
EVERY_NAME = pytest.mark.parametrize("name", ["environment-1", "environment-2"])


@functools.cache
def read(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """World and mission."""
    files = (ENVIRONMENTS / name / file for file in ("world.toml", "mission.toml"))
    world, mission = (tomllib.loads(file.read_text(encoding="utf-8")) for file in files)
    return world, mission


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
    margins = [
        np.hypot(north_m - r["north_m"], east_m - r["east_m"]) - r["range_m"]
        for r in world["radars"]
    ]
    return np.asarray(np.min(margins, axis=0))


@EVERY_NAME
def test_the_straight_line_is_barred_and_start_and_target_are_low_and_out_of_sight(
    name: str,
) -> None:
    world, line = read(name)[0], np.linspace(0.0, 100_000.0, 4_001)
    assert terrain_m(world, line, line).max() > 3_000.0
    assert radar_margin_m(world, line, line).min() < 0.0
    north, east = np.meshgrid(AXIS_M, AXIS_M, indexing="ij")
    height, margin = terrain_m(world, north, east), radar_margin_m(world, north, east)
    start, target = np.hypot(north, east), np.hypot(north - 100_000.0, east - 100_000.0)
    assert height[start <= 3_000.0].max() < 300.0
    assert height[target <= 5_000.0].max() < 2_000.0
    assert margin[np.minimum(start, target) <= 5_000.0].min() > 0.0


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


def valley_m(north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    """Row 0 of the sample is in the north; the Valley and Ridge lies south-east of mountains."""
    origin = read("valley")[0]["origin"]
    longitude, latitude, _ = Geod(ellps="WGS84").fwd(
        np.full_like(north_m, origin["longitude_deg"]),
        np.full_like(north_m, origin["latitude_deg"]),
        np.degrees(np.arctan2(east_m, north_m)),
        np.hypot(north_m, east_m),
    )
    row, column = (36.73291667 - latitude) * 1200 - 0.5, (longitude + 84.41375) * 1200 - 0.5
    assert 0 <= row.min() <= row.max() <= 343
    assert 0 <= column.min() <= column.max() <= 402
    sample = np.asarray(cbook.get_sample_data("jacksboro_fault_dem.npz")["elevation"], dtype=float)
    return np.asarray(map_coordinates(sample, [row, column], order=1))


def test_in_the_valley_start_and_target_are_low_and_clear_and_the_straight_way_is_barred() -> None:
    world, mission = read("valley")
    (start, target), outlines = (world["vehicle"], mission["targets"][0]), []
    for zone in mission["keep_outs"]:
        if "radius_m" in zone:
            outlines.append(shapely.Point(zone["north_m"], zone["east_m"]).buffer(zone["radius_m"]))
        else:
            outlines.append(shapely.Polygon(zone["vertices_m"]))
    assert sorted("radius_m" in zone for zone in mission["keep_outs"]) == [False] * 2 + [True] * 2
    for place in (start, target):
        here = shapely.Point(place["north_m"], place["east_m"])
        assert min(outline.distance(here) for outline in outlines) > 200.0
    straight = (np.linspace(start[key], target[key], 2_000) for key in ("north_m", "east_m"))
    below = valley_m(*straight)
    assert max(below[0], below[-1]) < mission["altitude"]["floor_amsl_m"] - 50.0
    assert below.max() > mission["altitude"]["ceiling_amsl_m"]


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
