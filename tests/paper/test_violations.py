"""Dense measures of curves whose violations are known in closed form."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.paper.compare.missions import bundled_case
from companion.paper.compare.violations import Violations, peak_distance_m, violations
from companion.path.subpath import Subpath
from companion.planner.settings import Task
from companion.world.radars import Radar
from companion.world.terrain import Peak, PeakTerrain

FloatArray = NDArray[np.float64]
FLAT = PeakTerrain(peaks=(), ground_amsl_m=0.0)
STEP_M = 10.0


@pytest.fixture(scope="module")
def task() -> Task:
    """The limits of environment-1: 3 to 5 km, turns of 2.5 km, 10 degrees; d_s 500 m."""
    return replace(bundled_case("environment-1").task, radars=())


def straight(one: tuple[float, float, float], two: tuple[float, float, float]) -> Subpath:
    return Subpath(control_nea_m=np.linspace(one, two, 4))


def measured(
    subpath: Subpath, task: Task, terrain: PeakTerrain = FLAT, flown_m: float | None = None
) -> Violations:
    flown_m = subpath.length_m if flown_m is None else flown_m
    return violations([(subpath, flown_m)], task, terrain)


def test_a_level_straight_line_over_a_plain_violates_nothing(task: Task) -> None:
    found = measured(straight((0.0, 0.0, 3000.0), (20_000.0, 0.0, 3000.0)), task)
    assert not found.any


@given(range_m=st.floats(4_000.0, 15_000.0), off=st.floats(0.0, 0.95))
def test_a_line_through_a_radar_is_seen_for_the_length_of_the_chord(
    range_m: float, off: float
) -> None:
    task = bundled_case("environment-1").task
    aside_m = off * math.sqrt(range_m**2 - 3000.0**2)
    radar = Radar(name="r", centre_nea_m=(25_000.0, aside_m, 0.0), range_m=range_m)
    found = measured(
        straight((0.0, 0.0, 3000.0), (50_000.0, 0.0, 3000.0)), replace(task, radars=(radar,))
    )
    chord_m = 2.0 * math.sqrt(range_m**2 - 3000.0**2 - aside_m**2)
    assert found.radar_m == pytest.approx(chord_m, abs=2.0 * STEP_M)


def test_ground_seen_by_two_radars_counts_once(task: Task) -> None:
    radar = Radar(name="r", centre_nea_m=(10_000.0, 0.0, 0.0), range_m=5_000.0)
    line = straight((0.0, 0.0, 3000.0), (20_000.0, 0.0, 3000.0))
    one = measured(line, replace(task, radars=(radar,)))
    two = measured(line, replace(task, radars=(radar, radar)))
    assert one.radar_m == two.radar_m == pytest.approx(8_000.0, abs=2.0 * STEP_M)


@given(bottom_m=st.floats(2_000.0, 2_990.0), top_m=st.floats(5_010.0, 6_000.0))
def test_a_line_that_rises_through_the_band_leaves_it_at_both_ends(
    bottom_m: float, top_m: float
) -> None:
    task = bundled_case("environment-1").task
    line = straight((0.0, 0.0, bottom_m), (30_000.0, 0.0, top_m))
    found = measured(line, task)
    outside = (3000.0 - bottom_m + top_m - 5000.0) / (top_m - bottom_m)
    assert found.band_m == pytest.approx(outside * line.length_m, abs=2.0 * STEP_M)


@pytest.mark.parametrize(("angle_deg", "broken"), [(9.9, 0.0), (10.1, 1.0), (-9.9, 0), (-10.1, 1)])
def test_a_slope_counts_when_it_is_steeper_than_the_limit(
    task: Task, angle_deg: float, broken: float
) -> None:
    rise_m = 5_000.0 * math.tan(math.radians(angle_deg))
    line = straight((0.0, 0.0, 4000.0), (5_000.0, 0.0, 4000.0 + rise_m))
    assert measured(line, task).climb_m == pytest.approx(broken * line.length_m)


@pytest.mark.parametrize(("radius_m", "breaks"), [(2_300.0, True), (2_700.0, False)])
def test_a_turn_counts_when_it_is_tighter_than_the_limit(
    task: Task, radius_m: float, breaks: bool
) -> None:
    # a quarter of a circle; the cubic Bezier curve is one to 0.03 % (its curvature to 1.5 %)
    k = 4.0 / 3.0 * math.tan(math.pi / 8.0)
    corners = np.array([(0.0, 0.0), (k, 0.0), (1.0, 1.0 - k), (1.0, 1.0)]) * radius_m
    curve = Subpath(control_nea_m=np.insert(corners, 2, 3000.0, axis=1))
    found = measured(curve, task)
    assert (found.turn_m == pytest.approx(curve.length_m, rel=0.01)) if breaks else not found.turn_m


def test_a_join_with_r2_of_0_is_a_corner(task: Task) -> None:
    corners = np.array([(0.0, 0.0), (0.0, 0.0), (9_000.0, 4_000.0), (20_000.0, 0.0)])
    found = measured(Subpath(control_nea_m=np.insert(corners, 2, 3000.0, axis=1)), task)
    assert found.turn_m > 0.0


def test_what_is_not_flown_is_not_measured(task: Task) -> None:
    radar = Radar(name="r", centre_nea_m=(20_000.0, 0.0, 0.0), range_m=5_000.0)
    line = straight((0.0, 0.0, 3000.0), (20_000.0, 0.0, 3000.0))
    with_radar = replace(task, radars=(radar,))
    assert measured(line, with_radar).radar_m > 3_900.0
    found = measured(line, with_radar, flown_m=15_000.0)
    assert found.radar_m == 0.0


def test_subpaths_add_up(task: Task) -> None:
    one = straight((0.0, 0.0, 2900.0), (5_000.0, 0.0, 2900.0))
    two = straight((5_000.0, 0.0, 3000.0), (9_000.0, 0.0, 3000.0))
    found = violations([(one, 4_000.0), (two, two.length_m)], task, FLAT)
    assert found.band_m == pytest.approx(4_000.0)
    assert not violations([], task, FLAT).any


@given(
    spread_m=st.floats(4_000.0, 12_000.0),
    at_m=st.floats(-9_000.0, 9_000.0),
    above_m=st.floats(50.0, 600.0),
)
def test_near_a_peak_its_distance_is_that_of_the_nearest_of_many_points_of_its_surface(
    spread_m: float, at_m: float, above_m: float
) -> None:
    peak = Peak(
        north_m=0.0, east_m=0.0, height_amsl_m=4000.0, spread_north_m=spread_m, spread_east_m=9e3
    )
    terrain = PeakTerrain(peaks=(peak,), ground_amsl_m=-1e6)
    east_m = 2_000.0
    ground_m = 4000.0 * math.exp(-((at_m / spread_m) ** 2) - (east_m / 9e3) ** 2)
    point = np.array([at_m, east_m, ground_m + above_m])
    offsets = np.arange(-1_000.0, 1_001.0, 20.0)
    north, east = np.meshgrid(at_m + offsets, east_m + offsets, indexing="ij")
    surface = 4000.0 * np.exp(-((north / spread_m) ** 2) - (east / 9e3) ** 2)
    gap = np.sqrt((north - at_m) ** 2 + (east - east_m) ** 2 + (surface - point[2]) ** 2).min()
    # planner-numbers A, row 12: 0.954 to 1.048 of the Euclidean distance
    assert peak_distance_m(point[None], terrain)[0] == pytest.approx(gap, rel=0.07, abs=2.0)


def test_the_nearest_of_peaks_and_ground_counts_and_inside_is_negative() -> None:
    peak = Peak(
        north_m=7e3, east_m=-4e3, height_amsl_m=1000.0, spread_north_m=5e3, spread_east_m=5e3
    )
    terrain = PeakTerrain(peaks=(peak,), ground_amsl_m=100.0)
    points = np.array([(7e3, -4e3, 1300.0), (7e3, -4e3, 900.0), (9e4, 0.0, 350.0)])
    assert peak_distance_m(points, terrain).tolist() == pytest.approx([300.0, -100.0, 250.0])
