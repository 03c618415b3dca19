"""A map as bytes, and what tells it from any other."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.world.known_map import KnownMap, digest_of, empty_map, packed_map, unpacked_map

BLANK = empty_map(25.0, (0.0, 1000.0), (0.0, 500.0))


def known() -> KnownMap:
    upper = np.random.default_rng(1).uniform(300.0, 900.0, BLANK.upper_m.shape)
    upper[3, 4] = math.inf
    return replace(BLANK, upper_m=upper, seen=np.isfinite(upper))


def raised(by_m: float) -> KnownMap:
    upper = known().upper_m.copy()
    upper[7, 2] += by_m
    return replace(known(), upper_m=upper)


def test_a_map_comes_back_as_it_was() -> None:
    back = unpacked_map(packed_map(known()))
    assert np.array_equal(back.upper_m, known().upper_m)
    assert np.array_equal(back.seen, known().seen)
    assert digest_of(back) == digest_of(known())


def test_a_map_is_told_from_those_that_differ_in_anything() -> None:
    given = np.zeros(BLANK.seen.shape, dtype=bool)
    given[3, 4] = True
    maps = [
        BLANK,
        known(),
        raised(0.01),
        replace(known(), seen=~known().seen),
        replace(known(), given=given),
        replace(known(), north_min_m=25.0),
        replace(known(), cell_m=50.0),
        replace(known(), registration_m=1.0),
        empty_map(25.0, (0.0, 500.0), (0.0, 1000.0)),
    ]
    assert len({digest_of(each) for each in maps}) == len(maps)


def test_the_last_bits_of_another_processor_are_no_other_map() -> None:
    assert digest_of(raised(1e-9)) == digest_of(known())


@pytest.mark.parametrize("length", [0, 1, 100, -1])
def test_bytes_that_are_no_map_are_named(length: int) -> None:
    with pytest.raises(ValueError, match="cut short or damaged"):
        unpacked_map(packed_map(known())[:length])
