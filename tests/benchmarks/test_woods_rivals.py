"""The rivals among near things: what they decide, against brute force and scipy."""

import math
from typing import Any

import numpy as np
import pytest
from woods_rivals import AStar, Bendy, Clearances

from companion.world.lattice import Lattice
from companion.world.near_map import NearMap

CELL_M, MARGIN_M, RANGE_M = 0.5, 1.0, 16.0
SIZE = 100


def map_with(row: Any, column: Any) -> NearMap:
    """Something stands in these cells."""
    lattice = Lattice(cell_m=CELL_M, north_min_m=0.0, east_min_m=0.0, shape=(SIZE, SIZE))
    near = NearMap(lattice)
    near.met_since_s[row, column], near.sharp[row, column] = 0.0, True
    return near


def looked(pilot: Any, near: NearMap) -> Any:
    pilot.look(near, 25.0 + 25.0j, 100.0)
    return pilot


def test_clearances_are_distances_to_what_stands() -> None:
    rng = np.random.default_rng(1)
    cells = rng.integers(0, SIZE, size=(60, 2))
    found = looked(Clearances(map_with(*cells.T), 3.0), map_with(*cells.T)).away_m
    every = np.argwhere(np.ones((SIZE, SIZE), dtype=bool))
    apart = np.hypot(*(every[:, None] - cells).transpose(2, 0, 1)).min(axis=1)
    expected = np.clip((apart - 0.5) * CELL_M, 0.0, 3.0).reshape(SIZE, SIZE)
    np.testing.assert_allclose(found, expected)


@pytest.mark.sample(4)
@pytest.mark.parametrize("seed", range(20))
def test_bendy_takes_the_first_clear_direction_aside_of_the_target(seed: int) -> None:
    cells = np.random.default_rng(seed).integers(0, SIZE, size=(30, 2))
    here, target = 10.0 + 10.0j, 45.0 + 40.0j
    near = map_with(*cells.T)
    things = (cells + 0.5) @ np.array([1.0, 1.0j]) * CELL_M

    def margin_m(start: complex, end: complex) -> float:
        places = start + np.linspace(0.0, 1.0, 400) * (end - start)
        return float(np.abs(places[:, None] - things).min()) - 0.5 * CELL_M

    def is_clear(aside_deg: float, slack_m: float) -> bool:
        way = np.exp(1j * (np.angle(target - here) + math.radians(aside_deg)))
        there = here + 15.0 * way
        if margin_m(here, there) <= MARGIN_M + slack_m:
            return False
        on = min(15.0, abs(target - there)) * np.exp(1j * np.angle(target - there))
        turns = (there + on * np.exp(1j * turn * math.pi) for turn in (0.0, 0.25, -0.25))
        return any(margin_m(there, end) > MARGIN_M + slack_m for end in turns)

    aim = looked(Bendy(near, target, MARGIN_M, RANGE_M), near).aim(here, 1.0 + 0.0j)
    aside_deg = float(np.degrees(np.angle((aim - here) / (target - here))))
    assert abs(aside_deg / 5.0 - round(aside_deg / 5.0)) < 1e-6
    tried = [side * step for step in range(0, 175, 5) for side in (-1, 1)]
    surely = [each for each in tried if is_clear(each, CELL_M)]  # a cell holds points as its middle
    perhaps = [each for each in tried if is_clear(each, -CELL_M)]
    assert abs(abs(aim - here) - 15.0) < 1e-9 or not surely
    if surely:
        assert abs(aside_deg) <= abs(surely[0]) + 1e-6
        assert any(abs(aside_deg - each) < 1e-6 for each in perhaps)


def test_where_nothing_stands_both_fly_to_the_target() -> None:
    near, here, target = map_with([], []), 10.0 + 10.0j, 45.0 + 45.0j
    for kind in (Bendy, AStar):
        aim = looked(kind(near, target, MARGIN_M, RANGE_M), near).aim(here, -1.0 + 0.0j)
        assert abs(np.angle((aim - here) / (target - here))) < 0.2
        aim = looked(kind(near, target, MARGIN_M, RANGE_M), near).aim(target - 0.5, 1.0 + 0.0j)
        assert abs(aim - target) < 1e-9
