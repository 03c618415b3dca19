"""The downward rangefinder against a known map, on ground whose height is known everywhere."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lidars import attitude, beam
from wires import FRAME

from companion.mavlink.poses import Poses
from companion.mavlink.rangefinder import Rangefinder
from companion.world.known_map import KnownMap

MAP_M, ERROR_M, ALTITUDE_M = 400.0, 1.0, 408.0


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
    finder, now_s = Rangefinder(poses, ERROR_M), 50.0
    for distance_m in distances_m:
        poses.on_attitude(attitude(now_s, *lean))
        values = {"orientation": 25, "max_distance": 4000, "id": 0, **fields}
        finder.on_message(beam(now_s, round(100.0 * distance_m), **values), now_s)
        poses.on_position(now_s, (0.0, 0.0, ALTITUDE_M))
        found.append(finder.seen(now_s, known))
        now_s += 0.1
    return [seen.above_m for seen in found if seen is not None]


@given(ground_m=st.floats(380.0, 406.0), roll=st.floats(-0.5, 0.5), pitch=st.floats(-0.5, 0.5))
def test_higher_ground_is_told(ground_m: float, roll: float, pitch: float) -> None:
    """However the vehicle leans; what it is told is by how much."""
    slant_m = (ALTITUDE_M - ground_m) / (math.cos(roll) * math.cos(pitch))
    found = above_m(*[slant_m] * 6, lean=(roll, pitch, 0.7))
    expected_m = ground_m - MAP_M
    if abs(expected_m - ERROR_M) > 0.02:
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


@pytest.mark.parametrize(
    ("lean_deg", "low_to", "is_told"),
    [
        # nose up by 45 degrees, towards the east: its foot is 3 m to the east
        ((0.0, 45.0, 90.0), 23, True),
        ((0.0, 45.0, 90.0), 21, False),
        ((0.0, 45.0, -90.0), 21, True),
        ((45.0, 0.0, 0.0), 21, True),  # right side down: the foot lies to the left, west
        ((-45.0, 0.0, 0.0), 21, False),
    ],
)
@pytest.mark.parametrize("beyond_m", [MAP_M + 5.0, math.inf])  # where nothing is known, too
def test_the_beam_is_compared_with_the_map_where_it_ends(
    lean_deg: tuple[float, float, float], low_to: int, is_told: bool, beyond_m: float
) -> None:
    roll, pitch, yaw = map(math.radians, lean_deg)
    far = {"low_to": low_to, "beyond_m": beyond_m}
    assert bool(above_m(*[3.0 * math.sqrt(2.0)] * 6, lean=(roll, pitch, yaw), **far)) is is_told
