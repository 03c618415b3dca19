"""The bundled valley keeps its promises: real ground, and a straight way that is barred.

An implementation of its own, on purpose: heights come from matplotlib's sample and not from the
file that was made of it, positions from geodesics.
"""

import functools
import math
import tomllib
from pathlib import Path

import numpy as np
from matplotlib import cbook
from matplotlib.path import Path as Outline
from numpy.typing import NDArray
from pyproj import Geod
from scipy.ndimage import map_coordinates

FloatArray = NDArray[np.float64]
FOLDER = Path(__file__).parents[1] / "companion" / "environments" / "valley"
WORLD = tomllib.loads((FOLDER / "world.toml").read_text(encoding="utf-8"))
MISSION = tomllib.loads((FOLDER / "mission.toml").read_text(encoding="utf-8"))
WGS84 = Geod(ellps="WGS84")
START = (WORLD["vehicle"]["north_m"], WORLD["vehicle"]["east_m"])
TARGET = (MISSION["targets"][0]["north_m"], MISSION["targets"][0]["east_m"])
CEILING_M = MISSION["altitude"]["ceiling_amsl_m"]
FLOOR_M = MISSION["altitude"]["floor_amsl_m"]


@functools.cache
def sample() -> FloatArray:
    """Elevations, row 0 in the north: the Valley and Ridge lies south-east of the mountains."""
    elevation = cbook.get_sample_data("jacksboro_fault_dem.npz")["elevation"]
    return np.asarray(elevation, dtype=float)


def terrain_m(north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    north, east = (x.ravel() for x in np.broadcast_arrays(north_m, east_m))
    ones = np.ones_like(north)
    longitude, latitude, _ = WGS84.fwd(
        WORLD["origin"]["longitude_deg"] * ones,
        WORLD["origin"]["latitude_deg"] * ones,
        np.degrees(np.arctan2(east, north)),
        np.hypot(north, east),
    )
    row, column = (36.73291667 - latitude) * 1200 - 0.5, (longitude + 84.41375) * 1200 - 0.5
    assert row.min() >= 0
    assert column.min() >= 0
    assert row.max() <= 343
    assert column.max() <= 402
    found: FloatArray = map_coordinates(sample(), [row, column], order=1)
    return found.reshape(np.broadcast(north_m, east_m).shape)


def keep_out_margins_m(north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    """Distance to each keep-out's edge, negative inside.  (...) x2 -> (4, ...)."""
    points = np.stack([north_m, east_m], axis=-1)
    margins = []
    for zone in MISSION["keep_outs"]:
        if "radius_m" in zone:
            centre = (zone["north_m"], zone["east_m"])
            margins.append(np.linalg.norm(points - centre, axis=-1) - zone["radius_m"])
            continue
        corners = np.array(zone["vertices_m"])
        nearest = np.full(north_m.shape, math.inf)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            foot = a + share[..., None] * (b - a)
            nearest = np.minimum(nearest, np.linalg.norm(points - foot, axis=-1))
        inside = Outline(corners).contains_points(points.reshape(-1, 2)).reshape(north_m.shape)
        margins.append(np.where(inside, -nearest, nearest))
    return np.stack(margins)


def test_world_and_mission_agree_on_the_frame_and_the_vehicle() -> None:
    assert WORLD["name"] == MISSION["name"] == "valley"
    assert WORLD["origin"] == MISSION["origin"]
    for key in ("north_min_m", "east_min_m"):
        assert WORLD["area"][key] <= MISSION["area"][key]
    for key in ("north_max_m", "east_max_m"):
        assert WORLD["area"][key] >= MISSION["area"][key]
    vehicle, limits = WORLD["vehicle"], MISSION["vehicle"]
    assert vehicle["speed_max_m_s"] > limits["speed_m_s"] == 8.0
    assert limits["speed_m_s"] ** 2 / limits["turn_radius_m"] < vehicle["acceleration_max_m_s2"]
    assert limits["speed_m_s"] * math.tan(math.radians(limits["climb_angle_deg"])) <= 2.5
    assert WORLD["scanner"]["range_m"] >= MISSION["planner"]["scan_range_m"] == 1_500.0
    assert MISSION["planner"]["safety_distance_m"] == 40.0


def test_there_are_four_keep_outs_two_of_them_circles_and_start_and_target_lie_outside() -> None:
    assert sum("radius_m" in zone for zone in MISSION["keep_outs"]) == 2
    assert sum("vertices_m" in zone for zone in MISSION["keep_outs"]) == 2
    for place in (START, TARGET):
        assert keep_out_margins_m(np.array([place[0]]), np.array([place[1]])).min() > 200.0


def test_the_ground_at_start_and_target_is_low_and_the_straight_way_between_is_barred() -> None:
    share = np.linspace(0.0, 1.0, 2_000)
    straight = [a + share * (b - a) for a, b in zip(START, TARGET, strict=True)]
    below = terrain_m(*straight)
    assert below[0] < FLOOR_M - 50.0
    assert below[-1] < FLOOR_M - 50.0
    assert below.max() > CEILING_M
