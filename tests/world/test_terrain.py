import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.world.terrain import Peak, PeakTerrain

peaks = st.builds(
    Peak,
    north_m=st.floats(-2_000, 2_000),
    east_m=st.floats(-2_000, 2_000),
    height_amsl_m=st.floats(10, 3_000),
    spread_north_m=st.floats(200, 3_000),
    spread_east_m=st.floats(200, 3_000),
)
terrains = st.builds(
    PeakTerrain,
    peaks=st.lists(peaks, min_size=1, max_size=4).map(tuple),
    ground_amsl_m=st.floats(0, 500),
    sum_of_peaks=st.booleans(),
)
places = st.floats(-3_000, 3_000)


def eq_1(terrain: PeakTerrain, north: float, east: float) -> float:
    """Eq. 1 of the paper, peak by peak."""
    heights = []
    for peak in terrain.peaks:
        x = (north - peak.north_m) / peak.spread_north_m
        y = (east - peak.east_m) / peak.spread_east_m
        heights.append(peak.height_amsl_m * math.exp(-x * x - y * y))
    top = sum(heights) if terrain.sum_of_peaks else max(heights)
    return max(top, terrain.ground_amsl_m)


@given(terrain=terrains, north=places, east=places)
def test_the_height_is_equation_1_over_the_ground(
    terrain: PeakTerrain, north: float, east: float
) -> None:
    height = terrain.height_m(np.array(north), np.array(east))
    assert height == pytest.approx(eq_1(terrain, north, east), rel=1e-12)


@given(terrain=terrains)
def test_heights_come_in_the_shape_of_the_points(terrain: PeakTerrain) -> None:
    north, east = np.linspace(-1e3, 1e3, 6).reshape(2, 3), np.linspace(0, 1e3, 6).reshape(2, 3)
    heights = terrain.height_m(north, east)
    assert heights.shape == (2, 3)
    for index in np.ndindex(2, 3):
        assert heights[index] == pytest.approx(eq_1(terrain, north[index], east[index]))


@given(terrain=terrains, n=places, e=places, dn=st.floats(1, 2_000), de=st.floats(1, 2_000))
def test_no_point_of_a_box_is_higher_than_the_highest_in_it(
    terrain: PeakTerrain, n: float, e: float, dn: float, de: float
) -> None:
    north, east = np.meshgrid(np.linspace(n, n + dn, 41), np.linspace(e, e + de, 41))
    bound = terrain.highest_in_box_m(*(np.array(v) for v in (n, n + dn, e, e + de)))
    brute = terrain.height_m(north, east).max()
    assert bound >= brute - 1e-9
    if not terrain.sum_of_peaks or len(terrain.peaks) == 1:
        # between two points of the lattice the terrain rises by its steepest slope at most
        steepest = 0.858  # of exp(-x^2)
        rises = [
            p.height_amsl_m * steepest * (dn / p.spread_north_m + de / p.spread_east_m) / 80.0
            for p in terrain.peaks
        ]
        assert bound <= brute + max(rises)


def test_the_highest_in_a_box_that_holds_the_summit_is_the_summit() -> None:
    peak = Peak(
        north_m=10.0, east_m=20.0, height_amsl_m=900.0, spread_north_m=300.0, spread_east_m=400.0
    )
    terrain = PeakTerrain(peaks=(peak,), ground_amsl_m=0.0)
    box = (np.array(v) for v in (0.0, 50.0, 0.0, 50.0))
    assert terrain.highest_in_box_m(*box) == 900.0


def test_boxes_broadcast_rows_against_columns() -> None:
    peak = Peak(
        north_m=10.0, east_m=20.0, height_amsl_m=900.0, spread_north_m=300.0, spread_east_m=400.0
    )
    terrain = PeakTerrain(peaks=(peak,), ground_amsl_m=0.0)
    rows, columns = np.arange(3.0)[:, None] * 100.0, np.arange(4.0)[None, :] * 100.0
    boxes = terrain.highest_in_box_m(rows, rows + 100.0, columns, columns + 100.0)
    assert boxes.shape == (3, 4)
    one = terrain.highest_in_box_m(*(np.array(v) for v in (200.0, 300.0, 300.0, 400.0)))
    assert boxes[2, 3] == one


@pytest.mark.parametrize("ground_amsl_m", [120.0, 0.0, -350.0])
def test_without_peaks_the_terrain_is_the_ground_everywhere(ground_amsl_m: float) -> None:
    terrain = PeakTerrain(peaks=(), ground_amsl_m=ground_amsl_m)
    assert terrain.height_m(np.array(5.0), np.array(7.0)) == ground_amsl_m
