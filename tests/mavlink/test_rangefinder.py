"""The downward rangefinder against a known map."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from lidars import attitude, beam
from scipy.spatial.transform import Rotation
from wires import FRAME

from companion.config import load_mission
from companion.mavlink.poses import Poses
from companion.mavlink.rangefinder import Rangefinder
from companion.world.known_map import KnownMap

MAP_M, ERROR_M, ALTITUDE_M = 400.0, 1.0, 408.0
MISSION = replace(load_mission("valley"), rangefinder_error_m=ERROR_M)


def above_m(
    *distances_m: float, lean: tuple[float, float, float] = (0.0, 0.0, 0.0), **fields: Any
) -> list[float]:
    """What it makes of readings at 10 Hz, a position after each, over the middle of a map.

    Its cells are 2 m wide; low_to, beyond_m: from this column on so much is known of the ground.
    """
    upper = np.full((40, 40), MAP_M)
    upper[:, fields.pop("low_to", 40) :] = fields.pop("beyond_m", MAP_M)
    known = KnownMap(
        cell_m=2.0, north_min_m=-40.0, east_min_m=-40.0, upper_m=upper, seen=np.isfinite(upper)
    )
    poses, found = Poses(FRAME), []
    finder, now_s = Rangefinder(MISSION, poses), 50.0
    for distance_m in distances_m:
        poses.on_attitude(attitude(now_s, *lean))
        values = {"orientation": 25, "max_distance": 4000, "id": 0, **fields}
        finder.on_message(beam(now_s, round(100.0 * distance_m), **values), now_s)
        assert finder.seen(now_s, known) is None  # where it is, is not known yet
        poses.on_position(now_s, (0.0, 0.0, ALTITUDE_M))
        found.append(finder.seen(now_s, known))
        now_s += 0.1
    return [seen.above_m for seen in found if seen is not None]


@given(
    ground_m=st.floats(385.0, 406.0),
    lean=st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-math.pi, math.pi)),
    low_to=st.integers(16, 26),
    beyond_m=st.sampled_from([MAP_M + 5.0, math.inf]),
)
def test_ground_higher_than_the_map_where_the_beam_ends_is_told(
    ground_m: float, lean: tuple[float, float, float], low_to: int, beyond_m: float
) -> None:
    """However the vehicle leans, and by how much; not where nothing is known."""
    down = Rotation.from_euler("ZYX", lean[::-1]).apply((0.0, 0.0, 1.0))  # north, east, down
    slant_m = (ALTITUDE_M - ground_m) / down[2]
    column = (slant_m * down[1] + 40.0) / 2.0
    highest_m = MAP_M if math.floor(column) + 1 < low_to else beyond_m  # of the cells about it
    expected_m = ground_m - highest_m
    assume(abs(column % 1.0 - 0.5) < 0.45)  # a reading is of whole centimetres
    assume(abs(expected_m - ERROR_M) > 0.02)
    found = above_m(*[slant_m] * 6, lean=lean, low_to=low_to, beyond_m=beyond_m)
    assert bool(found) == (expected_m > ERROR_M)
    assert found == pytest.approx([expected_m] * len(found), abs=0.02)


UNBELIEVED: list[dict[str, int]] = [
    {"current_distance": 0},
    {"current_distance": 15},  # below the least
    {"current_distance": 65_534, "max_distance": 400},  # PX4 in the air
    {"current_distance": 500, "max_distance": 400},  # ArduPilot above its limit
    {"min_distance": 500, "max_distance": 400},
    {"orientation": 0},
    {"orientation": 24},
    {"time_boot_ms": 0},  # of another clock: there is no pose of that time
    {"time_boot_ms": 4_294_967_295},
]


@pytest.mark.parametrize(
    ("distances_m", "fields", "expected_m"),
    [
        # for as long as it lasts, and once when it is over
        ([5.0] * 9 + [8.0] * 13, {}, [3.0] * 6 + [0.0]),
        # single wrong readings are no ground
        *(([8.0, 8.0, *wrong, 8.0, 8.0], {}, []) for wrong in ([3.0], [3.0] * 2, [3.0, 8.0] * 3)),
        *(([3.0] * 8, fields, []) for fields in UNBELIEVED),
    ],
)
def test_what_readings_say(distances_m: Any, fields: dict[str, int], expected_m: Any) -> None:
    assert above_m(*distances_m, **fields) == pytest.approx(expected_m)
