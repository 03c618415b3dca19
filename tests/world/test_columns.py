"""Safe surfaces and distances to ground, against columns that are compared one by one."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning import column_distance_m
from scipy.interpolate import RegularGridInterpolator

from companion.world.columns import (
    Surface,
    distance_to_terrain_m,
    distances_to_terrain_m,
    safe_surface,
)
from companion.world.known_map import KnownMap, empty_map

CELL_M, CELLS, UNKNOWN_M = 100.0, 24, 900.0
MIDDLE = np.array([1_230.0, 1_170.0])
seeds = st.integers(0, 10**6)


def random_map(rng: np.random.Generator, registration_m: float = 0.0) -> KnownMap:
    """Pillars, plains and holes in what is known."""
    blank = empty_map(CELL_M, (0.0, CELLS * CELL_M), (0.0, CELLS * CELL_M))
    upper = rng.uniform(0.0, 600.0, (CELLS, CELLS)) * (rng.random((CELLS, CELLS)) < 0.3)
    upper[rng.random((CELLS, CELLS)) < 0.05] = np.inf
    seen = np.isfinite(upper)
    return replace(blank, upper_m=upper, seen=seen, registration_m=registration_m)


@given(
    seed=seeds,
    clearance_m=st.floats(5.0, 260.0),
    registration_m=st.sampled_from([0.0, 3.0, 40.0, 130.0]),
    parts=st.sampled_from([1.0, 1.7, 4.0]),
)
def test_every_point_over_the_safe_surface_keeps_the_clearance_to_columns_of_cells(
    seed: int, clearance_m: float, registration_m: float, parts: float
) -> None:
    """Wherever the registration lets them be."""
    rng = np.random.default_rng(seed)
    known = replace(random_map(rng, registration_m), cell_m=CELL_M / parts)
    middle, reach_m = MIDDLE / parts, 900.0 / parts
    surface = safe_surface(
        known,
        centre_ne_m=(middle[0], middle[1]),
        reach_m=reach_m,
        clearance_m=clearance_m,
        unknown_m=UNKNOWN_M,
    )
    turn, far = rng.uniform(0.0, 2.0 * np.pi, 300), reach_m * np.sqrt(rng.random(300))
    ne = middle + far[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    altitude = surface.altitude_m(ne[:, 0], ne[:, 1]) + 1e-6 + rng.exponential(5.0, 300)
    tops = np.where(np.isfinite(known.upper_m), known.upper_m, UNKNOWN_M)
    away = column_distance_m(replace(known, upper_m=tops), np.column_stack([ne, altitude]))
    assert (away >= clearance_m - 1e-6).all()


@given(
    seed=seeds, most_m=st.floats(10.0, 400.0), registration_m=st.sampled_from([0.0, 12.0, 130.0])
)
def test_the_distance_of_a_point_is_that_to_the_nearest_column_that_counts(
    seed: int, most_m: float, registration_m: float
) -> None:
    """Unknown ground has no top; where only what was seen counts, the rest is not there."""
    rng = np.random.default_rng(seed)
    known = random_map(rng, registration_m)
    known.seen[rng.random(known.seen.shape) < 0.3] = False
    points = rng.uniform((-300.0, -300.0, 0.0), (2_700.0, 2_700.0, 900.0), (10, 3))
    seen = replace(known, upper_m=np.where(known.seen, known.upper_m, -np.inf))
    endless = replace(  # so much unknown ground about it that no point sees an end of it
        known,
        north_min_m=-10 * CELL_M,
        east_min_m=-10 * CELL_M,
        upper_m=np.pad(known.upper_m, 10, constant_values=np.inf),
        seen=np.pad(known.seen, 10),
    )
    for seen_only, map_ in ((False, endless), (True, seen)):
        away = np.minimum(column_distance_m(map_, points), most_m)
        found = distances_to_terrain_m(known, points, most_m, seen_only=seen_only)
        assert found == pytest.approx(away)
        one = distance_to_terrain_m(known, points[0], most_m, seen_only=seen_only)
        assert one == pytest.approx(away[0])


# --- the surface itself


@given(seed=seeds)
def test_a_surface_is_bilinear_between_its_vertices_and_goes_on_as_at_its_edges(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heights = rng.uniform(0.0, 400.0, (9, 7))
    surface = Surface(north_min_m=-200.0, east_min_m=300.0, cell_m=50.0, vertex_m=heights)
    axes = (-200.0 + 50.0 * np.arange(9), 300.0 + 50.0 * np.arange(7))
    for far_m in (0.0, 100.0, 1e4):
        north = rng.uniform(-200.0 - far_m, 200.0 + far_m, (4, 5))
        east = rng.uniform(300.0 - far_m, 600.0 + far_m, (4, 5))
        inside = np.stack([np.clip(north, -200.0, 200.0), np.clip(east, 300.0, 600.0)], axis=-1)
        expected = RegularGridInterpolator(axes, heights)(inside)
        assert surface.altitude_m(north, east) == pytest.approx(expected, abs=1e-3)
