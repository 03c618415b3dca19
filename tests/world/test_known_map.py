import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from nudge import SEEDS, nudged
from numpy.typing import NDArray

from companion.world.known_map import (
    NO_ANSWER,
    NOT_SEEN,
    KnownMap,
    Scan,
    empty_map,
)
from companion.world.sight_lines import sight_line_m

FloatArray = NDArray[np.float64]
Heights = Callable[[FloatArray, FloatArray], FloatArray]

CELL_M = 100.0
CELLS = 28
RANGE_M = 1_150.0
SUB = 6  # points a side at which a cell of the true terrain is looked at


def random_hills(rng: np.random.Generator) -> Heights:
    """A true terrain, written apart from the product's: ground 50 m and a few Gaussian hills."""
    count = int(rng.integers(1, 7))
    north, east = rng.uniform(0.0, CELLS * CELL_M, (2, count))
    height = rng.uniform(50.0, 900.0, count)
    width_n, width_e = rng.uniform(120.0, 600.0, (2, count))

    def terrain(n: FloatArray, e: FloatArray) -> FloatArray:
        result = np.full(np.broadcast(n, e).shape, 50.0)
        for k in range(count):
            x, y = (n - north[k]) / width_n[k], (e - east[k]) / width_e[k]
            result = np.maximum(result, height[k] * np.exp(-x * x - y * y))
        return result

    return terrain


def looked_at() -> tuple[FloatArray, FloatArray]:
    """North and east of SUB x SUB points of all cells, edges included.  (CELLS, CELLS, SUB^2)."""
    inside, corner = np.linspace(0.0, CELL_M, SUB), np.arange(CELLS) * CELL_M
    along = corner[:, None] + inside  # (CELLS, SUB)
    north, east = np.broadcast_arrays(along[:, None, :, None], along[None, :, None, :])
    return north.reshape(CELLS, CELLS, -1), east.reshape(CELLS, CELLS, -1)


def brute_force_scan(terrain: Heights, radar: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What a radar truly sees, by marching rays over the true terrain.

    -> the answers (CELLS, CELLS): highest terrain of a cell, rounded up, where any of its points
    is in sight and its middle in range; and the true highest terrain of every cell.
    """
    north, east = looked_at()
    height = terrain(north, east)  # (CELLS, CELLS, SUB^2)
    middle_m = np.hypot(north - radar[0], east - radar[1]).mean(axis=-1, keepdims=True)
    in_sight = np.broadcast_to(middle_m <= RANGE_M, height.shape).copy()
    for fraction in (np.arange(60) + 0.5) / 60.0:
        n, e, top = (each[in_sight] for each in (north, east, height))
        n, e = radar[0] + fraction * (n - radar[0]), radar[1] + fraction * (e - radar[1])
        in_sight[in_sight] = terrain(n, e) <= radar[2] + fraction * (top - radar[2]) + 1e-6
    tops = height.max(axis=-1)
    return np.where(in_sight.any(axis=-1), np.ceil(tops + 1.0), NOT_SEEN), tops


def as_scan(answers: FloatArray, radar: FloatArray, **changes: float) -> Scan:
    scan = Scan(
        row=0,
        column=0,
        heights_m=answers,
        radar_nea_m=np.broadcast_to(radar, (*answers.shape, 3)),
        range_m=RANGE_M,
        drift_m=0.0,
        registration_m=0.0,
    )
    return replace(scan, **changes)


def blank() -> KnownMap:
    size = CELLS * CELL_M
    return empty_map(CELL_M, (0.0, size), (0.0, size))


def random_radar(rng: np.random.Generator, terrain: Heights) -> FloatArray:
    """In the middle half of the map and 20 to 700 m over the terrain."""
    n, e = rng.uniform(0.25, 0.75, 2) * CELLS * CELL_M
    return np.array([n, e, float(terrain(np.array(n), np.array(e))) + rng.uniform(20.0, 700.0)])


# --- the lattice


@given(row=st.integers(-5, 60), column=st.integers(-5, 60), n=st.floats(-0.49, 0.49))
def test_the_cell_of_a_point_is_the_one_whose_middle_is_within_half_a_cell(
    row: int, column: int, n: float
) -> None:
    known = empty_map(250.0, (-4_000.0, 5_000.0), (1_000.0, 9_000.0))
    north, east = known.middles_m(row, column, (1, 1))
    assert known.cell_of(north[0, 0] + n * 250.0, east[0, 0] - n * 250.0) == (row, column)


def test_an_empty_map_covers_its_area_and_knows_nothing() -> None:
    known = empty_map(250.0, (-10.0, 990.0), (0.0, 1_010.0))
    assert known.upper_m.shape == (4, 5)
    assert np.isposinf(known.upper_m).all()
    assert not known.seen.any()
    assert not known.is_known(0.0, 0.0)


def test_nothing_is_known_off_the_map() -> None:
    known = blank()
    known.upper_m[:] = 10.0
    inside, outside = 0.5 * CELL_M, CELLS * CELL_M + 1.0
    assert known.is_known(inside, inside)
    for north, east in ((-1.0, inside), (inside, -1.0), (outside, inside), (inside, outside)):
        assert not known.is_known(north, east)


# --- scans


@settings(max_examples=10)
@given(seed=st.integers(0, 10**6))
def test_a_hidden_cells_bound_is_sound_for_a_radar_that_moves_during_the_scan(seed: int) -> None:
    rng = np.random.default_rng(seed)
    terrain = random_hills(rng)
    here = random_radar(rng, terrain)
    angle = rng.uniform(0.0, 2.0 * math.pi)
    there = here + 300.0 * np.array([math.cos(angle), math.sin(angle), 0.0])
    there[2] = max(there[2], float(terrain(there[:1], there[1:2])[0]) + 20.0)
    early, truth = brute_force_scan(terrain, here)
    late, _ = brute_force_scan(terrain, there)
    moved = np.kron(rng.random((CELLS // 4, CELLS // 4)) < 0.5, np.ones((4, 4))) > 0.0
    scan = replace(
        as_scan(np.where(moved, late, early), here),
        radar_nea_m=np.where(moved[..., None], there, here),
    )
    assert (blank().with_scan(scan).upper_m >= truth).all()


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), row=st.integers(0, 9), column=st.integers(0, 9))
def test_cells_without_an_answer_or_outside_the_window_stay_as_they_were(
    seed: int, row: int, column: int
) -> None:
    rng = np.random.default_rng(seed)
    before = blank()
    before.upper_m[rng.random(before.upper_m.shape) < 0.5] = 123.0
    answers = rng.choice([NO_ANSWER, NOT_SEEN, 77.0], size=(12, 15))
    radar = np.array([900.0, 900.0, 600.0])
    after = before.with_scan(as_scan(answers, radar, row=row, column=column))
    touched = np.zeros((CELLS, CELLS), dtype=bool)
    touched[row : row + 12, column : column + 15] = ~np.isnan(answers)
    assert (after.upper_m[~touched] == before.upper_m[~touched]).all()
    window = np.s_[row : row + 12, column : column + 15]
    seen = np.isfinite(answers)
    assert (after.upper_m[window][seen] <= 77.0).all()
    assert (after.seen[window] == seen).all()


def test_a_cell_out_of_range_stays_unknown_although_the_radar_answered() -> None:
    radar = np.array([13.5 * CELL_M, 13.5 * CELL_M, 600.0])
    north, east = looked_at()
    far = np.hypot(north.mean(axis=-1) - radar[0], east.mean(axis=-1) - radar[1]) > RANGE_M
    known = blank().with_scan(as_scan(np.where(far, NOT_SEEN, 50.0), radar))
    assert np.isposinf(known.upper_m[far]).all()
    assert (known.upper_m[~far] == 50.0).all()


def test_the_registration_of_a_map_is_the_worst_of_its_scans() -> None:
    known = blank()
    answers = np.full((CELLS, CELLS), 50.0)
    for registration_m, worst in ((3.0, 3.0), (8.0, 8.0), (5.0, 8.0)):
        scan = as_scan(answers, np.array([1e3, 1e3, 1e3]), registration_m=registration_m)
        known = known.with_scan(scan)
        assert known.registration_m == worst


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


def test_the_sight_line_over_unknown_ground_is_infinitely_high() -> None:
    known = blank()
    known.upper_m[:] = 10.0
    known.upper_m[9, :] = np.inf
    radars, points = np.array([[50.0, 1_350.0, 100.0]] * 2), np.array([[2e3, 1_350], [500, 1_350]])
    found = sight_line_m(known, known.upper_m, radars, points, 50.0)
    assert np.isposinf(found[0])
    assert math.isfinite(found[1])


def test_there_is_no_sight_line_where_nothing_lies_between() -> None:
    radar, point = np.array([[50.0, 50.0, 100.0]]), np.array([[120.0, 50.0]])
    assert np.isneginf(sight_line_m(blank(), blank().upper_m, radar, point, 150.0)).all()


def test_the_sight_line_does_not_depend_on_what_lies_behind_the_point() -> None:
    known = blank()
    known.upper_m[:] = 10.0
    radar, point = np.array([[50.0, 1_350.0, 400.0]]), np.array([[1_050.0, 1_350.0]])
    before = sight_line_m(known, known.upper_m, radar, point, 50.0)
    known.upper_m[13:] = 5_000.0
    assert sight_line_m(known, known.upper_m, radar, point, 50.0) == before
    assert math.isfinite(before[0])


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
    known.upper_m[:] = rng.choice([0.0, 100.0, 300.0, 900.0], size=(CELLS, CELLS))
    first = np.array([*rng.uniform(0.3, 0.7, 2) * CELLS * CELL_M, rng.uniform(50.0, 1_000.0)])
    radars = first + rng.uniform(-apart_m, apart_m, (30, 3)) * (1.0, 1.0, 0.3)
    middles = (rng.integers(0, CELLS, (30, 2)) + 0.5) * CELL_M
    found = sight_line_m(known, known.upper_m, radars, middles, 1.5 * CELL_M)
    brute = [
        brute_force_line_m(known, radar, middle, 0.5 * CELL_M)
        for radar, middle in zip(radars, middles, strict=True)
    ]
    bounded = ~np.isneginf(found)  # beside the radar there is nothing to look over
    assert (found[bounded] >= np.array(brute)[bounded] - 1e-6).all()


@settings(max_examples=10)
@given(seed=st.integers(0, 10**6), row=st.integers(0, 40), column=st.integers(0, 40))
def test_a_scan_means_the_same_on_a_bigger_map(seed: int, row: int, column: int) -> None:
    rng = np.random.default_rng(seed)
    terrain = random_hills(rng)
    radar = random_radar(rng, terrain)
    answers, _ = brute_force_scan(terrain, radar)
    alone = blank().with_scan(as_scan(answers, radar))
    low_n, low_e = -row * CELL_M, -column * CELL_M
    size = (CELLS + 45) * CELL_M
    big = empty_map(CELL_M, (low_n, low_n + size), (low_e, low_e + size))
    after = big.with_scan(as_scan(answers, radar, row=row, column=column))
    part = after.part(slice(row, row + CELLS), slice(column, column + CELLS))
    assert (part.upper_m == alone.upper_m).all()
    assert (part.north_min_m, part.east_min_m) == (0.0, 0.0)
    assert np.isfinite(after.upper_m).sum() == np.isfinite(alone.upper_m).sum()


@pytest.mark.parametrize("seed", SEEDS)
def test_the_cell_of_a_point_on_an_edge_hangs_on_no_last_digit(seed: int) -> None:
    known = empty_map(250.0, (-5_000.0, 5_000.0), (-5_000.0, 5_000.0))
    assert known.cell_of(*nudged((0.0, 250.0), seed)) == (20, 21)


@given(seed=st.integers(0, 10**6))
def test_a_scan_that_supersedes_is_all_that_is_known_of_its_window(seed: int) -> None:
    """And one that does not loses nothing; neither changes a cell outside, or the map before it."""
    rng = np.random.default_rng(seed)
    before = empty_map(CELL_M, (0.0, 2000.0), (0.0, 2000.0))
    before.upper_m[:] = rng.choice([np.inf, 10.0, 500.0], before.upper_m.shape)
    before.seen[:] = np.isfinite(before.upper_m)
    row, column = rng.integers(0, 10, 2)
    heights = rng.choice([NO_ANSWER, NOT_SEEN, 42.0], rng.integers(0, 10, 2))
    for supersedes in (True, False):
        scan = Scan(
            row=int(row),
            column=int(column),
            heights_m=heights,
            radar_nea_m=np.zeros((1, 1, 3)),
            range_m=0.0,
            drift_m=0.0,
            registration_m=0.0,
            complete=False,
            supersedes=supersedes,
        )
        upper, seen = before.upper_m.copy(), before.seen.copy()
        after = before.with_scan(scan)
        np.testing.assert_array_equal(before.upper_m, upper)
        for place, height in np.ndenumerate(heights):
            cell = row + place[0], column + place[1]
            if height == 42.0:
                upper[cell], seen[cell] = height, True
            elif supersedes:
                upper[cell], seen[cell] = np.inf, False
        np.testing.assert_array_equal(after.upper_m, upper)
        np.testing.assert_array_equal(after.seen, seen)
