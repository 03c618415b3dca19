"""The map, what scans make of it, its bytes, and lines of sight (bounds: test_soundness.py)."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nudge import SEEDS, nudged
from numpy.typing import NDArray
from rough_ground import COLUMNS, RANGE_M, ROWS, blank, scan_of

from companion.geodesy import LEAST_RADIUS_M
from companion.world.known_map import (
    NO_ANSWER,
    NOT_SEEN,
    Scan,
    digest_of,
    empty_map,
    packed_map,
    sight_line_m,
    unpacked_map,
)

FloatArray = NDArray[np.float64]

CELL_M = 100.0


# --- the lattice


@given(row=st.integers(-5, 60), column=st.integers(-5, 60), n=st.floats(-0.49, 0.49))
def test_the_cell_of_a_point_is_the_one_whose_middle_is_within_half_a_cell(
    row: int, column: int, n: float
) -> None:
    known = empty_map(250.0, (-4_000.0, 5_000.0), (1_000.0, 9_000.0)).bare()
    north, east = known.middles_m((slice(row, row + 1), slice(column, column + 1)))
    assert known.cell_of(north[0, 0] + n * 250.0, east[0, 0] - n * 250.0) == (row, column)
    for seed in SEEDS:  # that of a point on an edge hangs on no last digit
        assert known.cell_of(*nudged((0.0, 1_250.0), seed)) == (16, 1)


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


@given(seed=st.integers(0, 10**6), reach_m=st.floats(0.0, 3_000.0))
def test_the_cells_about_points_are_those_within_reach_and_off_the_map_nothing_is_known(
    seed: int, reach_m: float
) -> None:
    """Each cell of the map by itself."""
    rng = np.random.default_rng(seed)
    known = empty_map(250.0, (-4_000.0, 5_000.0), (1_000.0, 9_000.0))
    known.upper_m[:] = rng.choice([np.nan, np.inf, 10.0, 500.0], known.upper_m.shape)
    points = rng.uniform((-6_000.0, -1_000.0), (7_000.0, 11_000.0), (int(rng.integers(1, 4)), 2))
    ends = zip(points.min(axis=0) - reach_m, points.max(axis=0) + reach_m, strict=True)
    window, corner = known.about(points, reach_m), (-4_000.0, 1_000.0)
    for part, least, count, (low, high) in zip(window, corner, known.shape, ends, strict=True):
        begins = least + 250.0 * np.arange(count)
        meets = np.flatnonzero((begins <= high) & (begins + 250.0 > low))
        assert np.arange(count)[part].tolist() == meets.tolist()
    north, east = points[0].tolist()
    south_m, west_m, square = known.square_m((north, east), reach_m)
    size_m = 250.0 * len(square)
    assert max(south_m - north, west_m - east) <= -reach_m
    assert min(south_m + size_m - north, west_m + size_m - east) >= reach_m
    for i, j in rng.integers(0, len(square), (40, 2)).tolist():
        row, column = known.cell_of(south_m + 250.0 * i + 125.0, west_m + 250.0 * j + 125.0)
        inside = 0 <= row < known.shape[0] and 0 <= column < known.shape[1]
        upper_m = float(known.upper_m[row, column]) if inside else math.inf
        assert square[i, j] == (math.inf if math.isnan(upper_m) else upper_m)


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
    """And a scan means the same on a bigger map."""
    radar = 1_001.0, 1_001.0, 600.0
    north, east = blank().middles_m()
    far = np.hypot(north - radar[0], east - radar[1]) > reach_m
    scan = scan_of(np.full((ROWS, COLUMNS), 50.0), ~far, radar)
    known = blank().with_scan(scan)
    assert np.isposinf(known.upper_m[far]).all()
    assert (known.upper_m[~far] == 50.0).all()
    big = empty_map(CELL_M, (-700.0, 9_300.0), (-1_100.0, 9_900.0))
    after = big.with_scan(replace(scan, row=scan.row + 7, column=scan.column + 11))
    part = after.part(slice(7, 7 + ROWS), slice(11, 11 + COLUMNS))
    assert (part.upper_m == known.upper_m).all()
    assert (part.north_min_m, part.east_min_m) == (0.0, 0.0)
    assert np.isfinite(after.upper_m).sum() == np.isfinite(known.upper_m).sum()


# --- the sight line


@settings(max_examples=40)
@given(wall_cell=st.integers(4, 12), top_m=st.floats(0.0, 800.0), behind=st.integers(2, 12))
def test_the_sight_line_over_a_wall_is_the_straight_line_loosened_by_the_slack(
    wall_cell: int, top_m: float, behind: int
) -> None:
    known, slack = blank(), 150.0
    known.upper_m[:] = 0.0
    known.upper_m[wall_cell] = top_m
    radar = np.array([0.5 * CELL_M, 13.5 * CELL_M, 400.0])
    far = (wall_cell + behind) * CELL_M  # to the middle of a cell behind the wall
    point = np.array([radar[0] + far, radar[1]])
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
    assert sight_line_m(known, known.upper_m, radars, points, 50.0)[1] == found[1]
    beside = np.array([[120.0, 1_350.0]])  # nothing lies between
    assert np.isneginf(sight_line_m(known, known.upper_m, radars[:1], beside, 150.0)).all()


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
    away_m = 1_000.0 + slack_m  # of a line of this slope, over a round earth
    share = (100.0 / nearest_m * away_m + away_m**2 / (2.0 * LEAST_RADIUS_M)) / LEAST_RADIUS_M
    assert found == pytest.approx(400.0 + LEAST_RADIUS_M * share / (1.0 - share), rel=1e-9)


# --- as bytes


def test_a_map_survives_as_bytes_and_is_told_from_those_that_differ_in_anything() -> None:
    empty = empty_map(25.0, (0.0, 1000.0), (0.0, 500.0))
    upper, given_ = (
        np.random.default_rng(1).uniform(300.0, 900.0, empty.upper_m.shape),
        empty.seen.copy(),
    )
    upper[3, 4], given_[3, 4] = math.inf, True
    known = replace(empty, upper_m=upper, seen=np.isfinite(upper))
    back, by_m = unpacked_map(packed_map(known)), np.zeros_like(upper)
    assert np.array_equal(back.upper_m, known.upper_m)
    assert np.array_equal(back.seen, known.seen)
    told = replace(known, given=given_, guess_m=upper)  # in advance: files keep only the rest
    whole = unpacked_map(packed_map(told)).with_what_was_given(told)
    assert digest_of(whole) == digest_of(told)
    assert whole.guess_m is upper
    by_m[7, 2] = 1.0
    for each in (back, replace(known, upper_m=upper + 1e-9 * by_m)):  # of another processor
        assert digest_of(each) == digest_of(known)
    maps = [
        empty,
        known,
        replace(known, upper_m=upper + 0.01 * by_m),
        replace(known, seen=~known.seen),
        replace(known, given=given_),
        replace(known, north_min_m=25.0),
        replace(known, cell_m=50.0),
        replace(known, registration_m=1.0),
        empty_map(25.0, (0.0, 500.0), (0.0, 1000.0)),
    ]
    assert len({digest_of(each) for each in maps}) == len(maps)
    for length in (0, 1, 100, -1):
        with pytest.raises(ValueError, match="cut short or damaged"):
            unpacked_map(packed_map(known)[:length])
