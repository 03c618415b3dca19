"""The judge of true tracks, against closed forms: it finds each kind of fault.

Of the ground, zones and crashes: `tests/campaign/test_truth.py`, `tests/campaign/test_faults.py`.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from planning import LARGE, TASK
from true_track import margins

from companion.geodesy import FloatArray
from companion.world.radars import Radar

SLOPES = {"climb_angle_rad": math.radians(10.0), "dive_angle_rad": math.radians(10.0)}
SETTINGS = replace(TASK.settings, safety_distance_m=500.0)
SLOW = {"speed_m_s": 8.0, "turn_radius_m": 25.0}


def straight(altitude_m: float) -> FloatArray:
    """20 km to the north at 150 m/s."""
    north_m = np.arange(0.0, 20_000.0, 15.0)
    return np.stack([north_m, 0 * north_m, 0 * north_m + altitude_m], axis=-1)


def helix(radius_m: float, speed_m_s: float, climb_deg: float = 0.0) -> FloatArray:
    """For ten seconds."""
    along_m = speed_m_s * np.arange(0.0, 10.0, 0.1)
    north, east = (radius_m * wave(along_m / radius_m) for wave in (np.cos, np.sin))
    up = 4000.0 + along_m * math.tan(math.radians(climb_deg))
    return np.stack([north, east, up], axis=-1)


@pytest.mark.parametrize(
    ("name", "margin", "track", "changes"),
    [
        ("turn radius, m", 25.0, helix(2_400.0, 150.0), {}),
        ("turn radius, m", -25.0, helix(2_350.0, 150.0), {}),
        ("turn radius, m", -1.75, helix(22.0, 8.0), SLOW),
        ("turn radius, m", math.inf, helix(22.0, 8.0), {}),  # too slow to be judged
        ("climb, deg", 0.1, helix(9_000.0, 25.0, 10.4), {}),
        ("climb, deg", -0.1, helix(9_000.0, 25.0, 10.6), {}),
        ("dive, deg", -0.1, helix(9_000.0, 25.0, -10.6), {}),
        ("ceiling, m", -1.0, straight(5026.0), {}),
        ("floor, m", -1.0, straight(2974.0), {}),
        ("radar, m", -1500.0, straight(3500.0), {}),
        ("radar, m", 500.0, straight(5500.0), {}),
    ],
)
def test_a_bound_may_be_missed_by_its_tolerance_and_no_more(
    name: str, margin: float, track: FloatArray, changes: dict[str, Any]
) -> None:
    radar = Radar(name="radar", centre_nea_m=(10_000.0, 0.0, 0.0), range_m=5_000.0)
    task = replace(TASK, limits=replace(LARGE, **SLOPES | changes), settings=SETTINGS)
    found = margins(replace(task, radars=(radar,)), track)
    assert found[name] == pytest.approx(margin, rel=0.1)
