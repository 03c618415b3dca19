"""The map, what scans make of it, its bytes, and lines of sight (bounds: test_soundness.py)."""

import math
import pickle
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nudge import SEEDS, nudged

from companion.world.known_map import (
    NO_ANSWER,
    NOT_SEEN,
    KnownMap,
    MapNews,
    Scan,
    digest_of,
    empty_map,
    packed_map,
    unpacked_map,
)

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


# --- as bytes


@given(seed=st.integers(0, 10**6))
def test_what_differs_from_a_map_before_lies_where_the_map_says(seed: int) -> None:
    """From one that it does not know, everywhere; a map made in another way knows none."""
    rng = np.random.default_rng(seed)
    maps = [empty_map(CELL_M, (0.0, 2_000.0), (0.0, 2_000.0))]
    for _ in range(int(rng.integers(1, 20))):
        row, column = rng.integers(0, 15, 2).tolist()
        heights = rng.choice([NO_ANSWER, 42.0, 17.0], rng.integers(0, 6, 2))
        scan = Scan(row=row, column=column, heights_m=heights, radar_nea_m=np.zeros((1, 1, 3)),
                    range_m=0.0, complete=False, supersedes=bool(rng.random() < 0.5))  # fmt: skip
        maps.append(maps[-1].with_scan(scan))
    last = maps[-1].grown(3.0)
    for before in maps[1:]:
        outside = np.ones(last.shape, dtype=bool)
        outside[last.changed_since(before.name)] = False
        assert (last.upper_m[outside] == before.upper_m[outside]).all()
        assert (last.seen[outside] == before.seen[outside]).all()
    had: KnownMap | None = None
    for known in (*maps, last):  # to somebody who is told of some of them only that is told
        if rng.random() < 0.5 or known is last:
            news = MapNews.of(known, None if had is None else had.name)
            had = pickle.loads(pickle.dumps(news)).after(had)
            assert digest_of(had) == digest_of(known)
            assert had.changes == known.changes
    whole = slice(0, 20), slice(0, 20)
    assert last.changed_since(maps[0].name) == whole == replace(last).changed_since(last.name)
    assert last.changed_since(last.name) == (slice(0, 0), slice(0, 0))


def test_a_map_survives_as_bytes_and_is_told_from_those_that_differ_in_anything() -> None:
    empty = empty_map(25.0, (0.0, 1000.0), (0.0, 500.0))
    upper, given_ = np.random.default_rng(1).uniform(300.0, 900.0, empty.shape), empty.seen.copy()
    upper[3, 4], given_[3, 4] = math.inf, True
    known = replace(empty, upper_m=upper, seen=np.isfinite(upper))
    back, by_m = unpacked_map(packed_map(known)), np.zeros_like(upper)
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
