"""The lattice of the map, what scans make of it, and lines of sight (bounds: test_soundness.py)."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from nudge import SEEDS, nudged
from numpy.typing import NDArray
from rough_ground import COLUMNS, RANGE_M, ROWS, blank, ground, scan_of

from companion.geodesy import LEAST_RADIUS_M
from companion.world.known_map import NO_ANSWER, NOT_SEEN, KnownMap, Scan, empty_map
from companion.world.sight_lines import sight_line_m
from companion.world.simulated_scan import simulated_scan

FloatArray = NDArray[np.float64]

CELL_M = 100.0


# --- the lattice


@given(row=st.integers(-5, 60), column=st.integers(-5, 60), n=st.floats(-0.49, 0.49))
def test_the_cell_of_a_point_is_the_one_whose_middle_is_within_half_a_cell(
    row: int, column: int, n: float
) -> None:
    known = empty_map(250.0, (-4_000.0, 5_000.0), (1_000.0, 9_000.0))
    north, east = known.middles_m(row, column, (1, 1))
    assert known.cell_of(north[0, 0] + n * 250.0, east[0, 0] - n * 250.0) == (row, column)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_cell_of_a_point_on_an_edge_hangs_on_no_last_digit(seed: int) -> None:
    known = empty_map(250.0, (-5_000.0, 5_000.0), (-5_000.0, 5_000.0))
    assert known.cell_of(*nudged((0.0, 250.0), seed)) == (20, 21)


def test_an_empty_map_covers_its_area_and_nothing_is_known_off_a_map() -> None:
    known = empty_map(250.0, (-10.0, 990.0), (0.0, 1_010.0))
    assert known.upper_m.shape == (4, 5)
    assert np.isposinf(known.upper_m).all()
    assert not known.seen.any()
    assert not known.is_known(0.0, 0.0)
    known.upper_m[:] = 10.0
    assert known.is_known(0.0, 0.0)
    for north, east in ((-11.0, 0.0), (0.0, -1.0), (991.0, 0.0), (0.0, 1_251.0)):
        assert not known.is_known(north, east)


# --- scans


@given(seed=st.integers(0, 10**6))
def test_a_scan_changes_what_it_answers_and_what_it_supersedes(seed: int) -> None:
    """And loses nothing else; a complete one bounds what it has not seen, too."""
    rng = np.random.default_rng(seed)
    before = empty_map(CELL_M, (0.0, 2_000.0), (0.0, 2_000.0))
    before.upper_m[:] = rng.choice([np.inf, 10.0, 500.0], before.upper_m.shape)
    before.seen[:] = np.isfinite(before.upper_m) & (rng.random(before.seen.shape) < 0.7)
    row, column = rng.integers(0, 10, 2).tolist()
    heights = rng.choice([NO_ANSWER, NOT_SEEN, 42.0], rng.integers(0, 10, 2))
    window = np.s_[row : row + heights.shape[0], column : column + heights.shape[1]]
    for supersedes, complete in product((True, False), repeat=2):
        scan = Scan(
            row=row,
            column=column,
            heights_m=heights,
            radar_nea_m=np.broadcast_to((900.0, 900.0, 600.0), (*heights.shape, 3)),
            range_m=1_150.0,
            registration_m=float(rng.uniform(0.0, 9.0)),
            complete=complete,
            supersedes=supersedes,
        )
        upper, seen = before.upper_m.copy(), before.seen.copy()
        answered, shown = ~np.isnan(heights), np.isfinite(heights)
        if supersedes:
            upper[window], seen[window] = np.inf, False
        upper[window][shown], seen[window][shown] = 42.0, True
        bounded = np.zeros_like(seen)
        bounded[window] = answered & ~shown & complete
        after, kept = before.with_scan(scan), before.upper_m.copy()
        np.testing.assert_array_equal(after.seen, seen)
        np.testing.assert_array_equal(after.upper_m[~bounded], upper[~bounded])
        assert (after.upper_m <= upper).all()
        np.testing.assert_array_equal(before.upper_m, kept)
        assert after.registration_m == max(before.registration_m, scan.registration_m)
        before = after


@pytest.mark.parametrize("reach_m", [1_150.0, RANGE_M], ids=["shown so far", "promised"])
def test_a_cell_out_of_range_stays_unknown_although_the_radar_answered(reach_m: float) -> None:
    radar = 1_001.0, 1_001.0, 600.0
    north, east = blank().middles_m(0, 0, (ROWS, COLUMNS))
    far = np.hypot(north - radar[0], east - radar[1]) > reach_m
    assert far.any()
    known = blank().with_scan(scan_of(np.full((ROWS, COLUMNS), 50.0), ~far, radar))
    assert np.isposinf(known.upper_m[far]).all()
    assert (known.upper_m[~far] == 50.0).all()


@settings(max_examples=10)
@given(number=st.integers(0, 10**4), row=st.integers(0, 40), column=st.integers(0, 40))
def test_a_scan_means_the_same_on_a_bigger_map(number: int, row: int, column: int) -> None:
    place, rng = ground(number)
    tops = place.tops_m()
    truth = KnownMap(cell_m=CELL_M, north_min_m=0.0, east_min_m=0.0, upper_m=np.ceil(tops),
                     seen=np.ones(tops.shape, dtype=bool))  # fmt: skip
    radar = 2_790.0, 3_210.0, float(tops[27:30, 31:34].max() + rng.uniform(5.0, 700.0))
    scan = simulated_scan(truth, radar, 2_000.0)
    alone = blank().with_scan(scan)
    low_n, low_e = -row * CELL_M, -column * CELL_M
    big = empty_map(CELL_M, (low_n, low_n + 100 * CELL_M), (low_e, low_e + 110 * CELL_M))
    after = big.with_scan(replace(scan, row=scan.row + row, column=scan.column + column))
    part = after.part(slice(row, row + ROWS), slice(column, column + COLUMNS))
    assert (part.upper_m == alone.upper_m).all()
    assert (part.north_min_m, part.east_min_m) == (0.0, 0.0)
    assert np.isfinite(after.upper_m).sum() == np.isfinite(alone.upper_m).sum()


# --- the sight line


@settings(max_examples=40)
@given(wall_cell=st.integers(4, 12), top_m=st.floats(0.0, 800.0), behind=st.integers(2, 12))
def test_the_sight_line_over_a_wall_is_the_straight_line_loosened_by_the_slack(
    wall_cell: int, top_m: float, behind: int
) -> None:
    known = blank()
    known.upper_m[:] = 0.0
    known.upper_m[wall_cell] = top_m
    radar = np.array([0.5 * CELL_M, 13.5 * CELL_M, 400.0])
    far = (wall_cell + behind) * CELL_M  # to the middle of a cell behind the wall
    point = np.array([radar[0] + far, radar[1]])
    slack = 150.0
    found = sight_line_m(known, known.upper_m, radar[None], point[None], slack)[0]

    def line(over_m: float, to_m: float) -> float:
        return 400.0 + (top_m - 400.0) / over_m * to_m

    middle = wall_cell * CELL_M
    steepest_over = middle - CELL_M / 2 if top_m > 400.0 else middle + CELL_M / 2
    over_the_ground = 400.0 - 400.0 / (far - CELL_M) * far
    assert found >= max(line(steepest_over, far), over_the_ground) - 1e-6
    # no looser than the march: it looks a cell around, and a slack before or behind
    if top_m > 400.0:
        loosest = line(max(middle - CELL_M - slack, 0.5 * CELL_M), far + slack)
    else:
        ground = 400.0 - 400.0 / (far + slack) * (far - slack)
        loosest = max(line(middle + CELL_M + slack, far - slack), ground)
    curved = (far + slack) ** 2 / 2.0 / 6.33e6 + (loosest - 400.0) ** 2 / 6.3e6
    assert found <= loosest + curved + 1e-6


def test_a_sight_line_knows_no_bound_over_unknown_ground_and_looks_no_farther_than_its_point() -> (
    None
):
    known = blank()
    known.upper_m[:] = 10.0
    known.upper_m[9, :] = np.inf
    radars, points = np.array([[50.0, 1_350.0, 100.0]] * 2), np.array([[2e3, 1_350], [500, 1_350]])
    found = sight_line_m(known, known.upper_m, radars, points, 50.0)
    assert np.isposinf(found[0])
    assert math.isfinite(found[1])
    known.upper_m[9:] = 5_000.0
    again = sight_line_m(known, known.upper_m, radars, points, 50.0)
    assert again[1] == found[1]
    beside = np.array([[120.0, 1_350.0]])  # nothing lies between
    assert np.isneginf(sight_line_m(known, known.upper_m, radars[:1], beside, 150.0)).all()


def line_of_slope_m(slope: float, away_m: float) -> float:
    """Altitude above the radar of a line, so far away, over a round earth."""
    share = (slope * away_m + away_m**2 / (2.0 * LEAST_RADIUS_M)) / LEAST_RADIUS_M
    return LEAST_RADIUS_M * share / (1.0 - share)


@pytest.mark.parametrize("error_m", [0.0, 3.0])
@pytest.mark.parametrize(
    ("turn_deg", "is_behind"), [(0, True), (-67, True), (67, True), (79, False)]
)
def test_a_cell_beside_the_radar_hides_what_is_behind_it_by_its_nearest_corner(
    error_m: float, turn_deg: float, is_behind: bool
) -> None:
    """5 m from the radar in north and in east, 100 m above it: with errors, as much nearer.

    Its circle is seen 65 (71) degrees to either side of north-east, that of the cell a line leads
    to 4.  To the side of both only the march has it: no nearer than half a cell.
    """
    known = blank()
    known.upper_m[:] = 0.0
    known.upper_m[15, 14] = 500.0
    bearing, slack_m = math.radians(45.0 + turn_deg), 1.5 * CELL_M + error_m
    radar = np.array([[1_495.0, 1_395.0, 400.0]])
    point = radar[:, :2] + 1_000.0 * np.array([[math.cos(bearing), math.sin(bearing)]])
    found = sight_line_m(known, known.upper_m, radar, point, slack_m)
    nearest_m = math.hypot(5.0, 5.0) - error_m if is_behind else 0.5 * CELL_M
    line_m = 400.0 + line_of_slope_m(100.0 / nearest_m, 1_000.0 + slack_m)
    assert found == pytest.approx(line_m, rel=1e-9)


def brute_force_line_m(
    known: KnownMap, radar: FloatArray, centre: FloatArray, reach_m: float
) -> float:
    """The steepest line to points of a cell (centre, half its side) by marching every 2 m."""
    steepest = -math.inf
    for offset in ((0, 0), (-1, -1), (-1, 1), (1, -1), (1, 1), (0, 1), (1, 0), (0, -1), (-1, 0)):
        point = centre + np.asarray(offset) * reach_m
        far = float(np.hypot(*(point - radar[:2])))
        along = np.arange(2.0, far - CELL_M, 2.0)[:, None]
        places = radar[:2] + along * (point - radar[:2]) / far
        index = (places / CELL_M).astype(int)
        rise = known.upper_m[index[:, 0], index[:, 1]] - radar[2]
        if len(rise):
            steepest = max(steepest, radar[2] + float((rise / along[:, 0]).max()) * far)
    return steepest


@settings(max_examples=25)
@example(seed=3, apart_m=0.0)
@given(seed=st.integers(0, 10**6), apart_m=st.floats(0.0, 200.0))
def test_the_sight_lines_of_radars_near_each_other_are_above_those_of_brute_force_from_each(
    seed: int, apart_m: float
) -> None:
    rng = np.random.default_rng(seed)
    known = blank()
    known.upper_m[:] = rng.choice([0.0, 100.0, 300.0, 900.0], size=known.upper_m.shape)
    first = np.array([*rng.uniform(0.3, 0.7, 2) * 2_800.0, rng.uniform(50.0, 1_000.0)])
    radars = first + rng.uniform(-apart_m, apart_m, (30, 3)) * (1.0, 1.0, 0.3)
    middles = (rng.integers(0, 28, (30, 2)) + 0.5) * CELL_M
    found = sight_line_m(known, known.upper_m, radars, middles, 1.5 * CELL_M)
    brute = [
        brute_force_line_m(known, radar, middle, 0.5 * CELL_M)
        for radar, middle in zip(radars, middles, strict=True)
    ]
    bounded = ~np.isneginf(found)  # beside the radar there is nothing to look over
    assert (found[bounded] >= np.array(brute)[bounded] - 1e-6).all()
