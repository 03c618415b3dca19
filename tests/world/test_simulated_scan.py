import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from companion.world.known_map import KnownMap, empty_map
from companion.world.simulated_scan import simulated_scan, true_map
from companion.world.terrain import Peak, PeakTerrain

CELL_M = 100.0


def random_terrain(rng: np.random.Generator) -> PeakTerrain:
    peaks = tuple(
        Peak(*rng.uniform((0, 0, 50, 200, 200), (4_000, 4_000, 1_200, 900, 900)).tolist())
        for _ in range(int(rng.integers(1, 6)))
    )
    return PeakTerrain(peaks=peaks, ground_amsl_m=30.0)


def blank() -> KnownMap:
    return empty_map(CELL_M, (0.0, 4_000.0), (0.0, 4_000.0))


def flat(ground_m: float = 100.0) -> KnownMap:
    return true_map(PeakTerrain(peaks=(), ground_amsl_m=ground_m), blank())


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6))
def test_the_true_map_holds_the_highest_terrain_of_each_cell_in_whole_metres(seed: int) -> None:
    rng = np.random.default_rng(seed)
    terrain = random_terrain(rng)
    truth = true_map(terrain, blank())
    inside = np.linspace(0.0, CELL_M, 21)
    for row, column in rng.integers(0, 40, (30, 2)):
        north, east = np.meshgrid(row * CELL_M + inside, column * CELL_M + inside)
        brute = float(terrain.height_m(north, east).max())
        # 21 points a side come within 2.5 m of the highest; no slope is above 1200 x 0.86 / 200
        assert brute <= truth.upper_m[row, column] <= math.ceil(brute + 2 * 2.5 * 5.2)
    assert (truth.upper_m == np.round(truth.upper_m)).all()
    assert truth.seen.all()


@example(north_min_dm=131_182, rows=488, cell_m=256)
@given(
    north_min_dm=st.integers(-1_000_000, 1_000_000),
    rows=st.integers(1, 500),
    cell_m=st.integers(1, 500),
)
def test_the_true_map_lies_on_the_lattice_of_the_map_it_is_like(
    north_min_dm: int, rows: int, cell_m: int
) -> None:
    north_min_m = north_min_dm / 10.0
    area = (north_min_m, north_min_m + rows * cell_m)
    like = empty_map(float(cell_m), area, (0.0, float(cell_m)))
    truth = true_map(PeakTerrain(peaks=(), ground_amsl_m=1.0), like)
    assert truth.upper_m.shape == like.upper_m.shape
    assert truth.cell_of(north_min_m + 0.5, 0.5) == (0, 0)


@given(n=st.floats(0, 4_000), e=st.floats(0, 4_000), range_m=st.floats(200, 2_500))
def test_over_flat_ground_just_the_cells_in_range_are_seen(
    n: float, e: float, range_m: float
) -> None:
    """Of those on the map, and each from where the radar is."""
    scan = simulated_scan(flat(), (n, e, 400.0), range_m)
    middles = (np.arange(40) + 0.5) * CELL_M
    far = np.hypot(middles[:, None] - n, middles[None, :] - e)
    heights = np.full((40, 40), -np.inf)
    rows, columns = scan.heights_m.shape
    heights[scan.row : scan.row + rows, scan.column : scan.column + columns] = scan.heights_m
    np.testing.assert_array_equal(heights, np.where(far <= range_m, 100.0, -np.inf))
    assert (scan.radar_nea_m == np.broadcast_to((n, e, 400.0), (rows, columns, 3))).all()


@settings(max_examples=40)
@given(wall=st.integers(5, 15), top_m=st.floats(0.0, 900.0), radar_m=st.floats(50.0, 900.0))
def test_a_wall_hides_just_what_lies_below_the_line_over_its_top(
    wall: int, top_m: float, radar_m: float
) -> None:
    truth = flat(0.0)
    truth.upper_m[wall] = top_m
    scan = simulated_scan(truth, (0.5 * CELL_M, 20.5 * CELL_M, radar_m), 3_500.0)
    due_north = scan.heights_m[:, 20 - scan.column]
    for cell in range(wall + 2, 34):  # the march ends a cell before the one it looks at
        line = radar_m + (top_m - radar_m) / wall * cell
        if abs(line) > 1e-6:
            assert np.isfinite(due_north[cell - scan.row]) == (line <= 0.0)


@given(offset=st.floats(-49.0, 49.0), bend=st.floats(0.5, 5.0))
def test_a_slope_that_rises_ever_more_steeply_hides_nothing(offset: float, bend: float) -> None:
    truth = flat(0.0)
    truth.upper_m[:] = bend * np.arange(40.0)[:, None] ** 2
    scan = simulated_scan(truth, (50.0, 2_050.0 + offset, bend + 50.0), 3_500.0)
    due_north = scan.heights_m[:, 20 - scan.column]
    assert np.isfinite(due_north[:34]).all()


@pytest.mark.parametrize("eye_m", [1.0, 5.0])
def test_the_plain_is_seen_up_to_the_horizon(eye_m: float) -> None:
    """At R acos(R / (R + h)), give or take a cell; the earth is as curved as it is anywhere."""
    truth = empty_map(CELL_M, (0.0, 200.0), (0.0, 12_000.0))
    truth.upper_m[:] = 0.0
    scan = simulated_scan(truth, (100.0, 50.0, eye_m), 11_000.0)
    seen = np.flatnonzero(np.isfinite(scan.heights_m[1]))
    horizon = [earth_m * math.acos(earth_m / (earth_m + eye_m)) for earth_m in (6.33e6, 6.371e6)]
    assert horizon[0] - 2 * CELL_M <= (seen.max() + 1) * CELL_M <= horizon[1] + 2 * CELL_M


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6))
def test_a_truth_that_is_made_where_it_is_looked_at_is_the_true_map(seed: int) -> None:
    rng = np.random.default_rng(seed)
    terrain = random_terrain(rng)
    n, e = rng.uniform(-500, 4_500, 2).tolist()
    radar, range_m = (n, e, float(rng.uniform(100, 1_500))), float(rng.uniform(300, 2_500))
    one = simulated_scan(blank(), radar, range_m, terrain)
    other = simulated_scan(true_map(terrain, blank()), radar, range_m)
    assert (one.row, one.column) == (other.row, other.column)
    assert (one.heights_m == other.heights_m).all()
