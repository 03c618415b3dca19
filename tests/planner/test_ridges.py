"""Steep ridges seen at a grazing angle, and flights round their ends."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from planning import fly, hills

from companion.config import load_mission
from companion.world.known_map import empty_map
from companion.world.simulated_scan import true_map

FloatArray = NDArray[np.float64]

SIDE_M = 60_000.0
MIDDLE_M = 0.5 * SIDE_M
GAP_M = 3_000.0
HEIGHT_M = 4_800.0
SPREAD_EAST_M = 1_000.0


def peaks_east_m() -> FloatArray:
    """Two rows of peaks from the edges of the map to the gap between them."""
    apart = 0.5 * SPREAD_EAST_M
    west = np.arange(0.0, MIDDLE_M - 0.5 * GAP_M + 1.0, apart)
    return np.concatenate([west, SIDE_M - west])


def nearest_ground_m(points_nea_m: FloatArray, spread_north_m: float, reach_m: float) -> FloatArray:
    """Distance from points to the solid under eq. 1, or more than reach_m.  (S, 3) -> (S,).

    Columns of ground every 25 m about each point, so it is too great by at most 18 m.
    """
    offset = np.arange(-reach_m, reach_m + 1.0, 25.0)
    away2 = offset[:, None] ** 2 + offset**2
    north = np.exp(-(((points_nea_m[:, :1] + offset - MIDDLE_M) / spread_north_m) ** 2))
    east_at = points_nea_m[:, 1:2] + offset
    nearest = np.abs(east_at[..., None] - peaks_east_m()).min(axis=-1)
    height = HEIGHT_M * north[:, :, None] * np.exp(-((nearest / SPREAD_EAST_M) ** 2))[:, None]
    above = np.maximum(points_nea_m[:, 2, None, None] - np.maximum(height, 0.0), 0.0)
    return np.asarray(np.sqrt(away2 + above**2).min(axis=(1, 2)))


@pytest.mark.sample(2)
@pytest.mark.parametrize(("spread_north_m", "seed"), [(650.0, 2), (800.0, 1)])
def test_no_leg_comes_near_a_ridge_whose_faces_are_seen_at_a_grazing_angle(
    spread_north_m: float, seed: int
) -> None:
    """Faces of 81 and 79 degrees; the two rows leave a gap of 3 km, free only high up."""
    mission = load_mission("environment-2")
    limits = replace(mission.task.limits, north_m=(0.0, SIDE_M), east_m=(0.0, SIDE_M))
    settings = replace(mission.task.settings, evaluations=400)
    task = replace(mission.task, limits=limits, settings=settings, radars=(), zones=())
    shape = HEIGHT_M, spread_north_m, SPREAD_EAST_M
    ridge = hills(*((MIDDLE_M, east, *shape) for east in peaks_east_m().tolist()))
    blank = empty_map(task.cell_m, limits.north_m, limits.east_m)
    flight = fly(
        task,
        true_map(ridge, blank),
        (5_000.0, MIDDLE_M, mission.task.take_off_amsl_m),
        (SIDE_M - 5_000.0, MIDDLE_M),
        seed=seed,
        most_legs=20,
    )
    assert len(flight.legs) == 20 or flight.failure is None  # there and back before it, or over it
    for leg, first in itertools.product(flight.legs, range(0, 40_000, 2_000)):
        lengths = np.arange(float(first), min(first + 2_000.0, leg.subpath.length_m), 40.0)
        if len(lengths):
            points = leg.subpath.points_nea_m(lengths)
            nearest = nearest_ground_m(points, spread_north_m, task.settings.safety_distance_m)
            assert nearest.min() >= task.settings.safety_distance_m, leg.plan_id
