"""The rival among near things: what it decides, against brute force."""

from typing import Any

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra
from woods import AStar, a_star

from companion.world.known_map import Lattice
from companion.world.near_map import NearMap

CELL_M, MARGIN_M, RANGE_M = 0.5, 2.5, 16.0
SIZE = 100


def looked(cells: Any) -> AStar:
    """Something stands in these cells."""
    lattice = Lattice(cell_m=CELL_M, north_min_m=0.0, east_min_m=0.0, shape=(SIZE, SIZE))
    near = NearMap(lattice)
    near.met_since_s[*cells.T], near.sharp[*cells.T] = 0.0, True
    pilot = AStar(near, 45.0 + 45.0j, MARGIN_M, RANGE_M)
    pilot.look(near, 25.0 + 25.0j, 100.0)
    return pilot


def test_clearances_are_distances_to_what_stands() -> None:
    cells = np.random.default_rng(1).integers(0, SIZE, size=(60, 2))
    every = np.argwhere(np.ones((SIZE, SIZE), dtype=bool))
    apart = np.hypot(*(every[:, None] - cells).transpose(2, 0, 1)).min(axis=1)
    expected = np.clip((apart - 0.5) * CELL_M, 0.0, MARGIN_M + CELL_M).reshape(SIZE, SIZE)
    np.testing.assert_allclose(looked(cells).away_m, expected)


def test_it_flies_to_the_target_and_round_a_wall_with_the_margin() -> None:
    here = 10.0 + 10.0j
    open_ground = looked(np.empty((0, 2), dtype=int))
    assert abs(np.angle((open_ground.aim(here) - here) / (1.0 + 1.0j))) < 0.2
    assert open_ground.aim(44.5 + 45.0j) == 45.0 + 45.0j
    wall = np.array([(40, column) for column in range(80)])  # north 20 m, to 40 m east
    pilot, way = looked(wall), [here]
    while abs(way[-1] - (45.0 + 45.0j)) > 1.0:
        away = pilot.aim(way[-1]) - way[-1]
        way.append(way[-1] + 0.5 * away / abs(away))
        assert len(way) < 300
    gaps = [abs(place - complex(20.25, min(place.imag, 39.75))) for place in way]
    assert min(gaps) > MARGIN_M - 2 * CELL_M
    closed = looked(np.array([(40, column) for column in range(SIZE)]))
    assert closed.aim(here) == here  # there is no way


def test_its_way_costs_as_much_as_the_cheapest_of_all() -> None:
    rng = np.random.default_rng(2)
    for shape in rng.integers(3, 15, size=(30, 2)).tolist():
        rate = rng.choice([1.0, 1.0, 20.0, np.inf], size=shape)
        ends = [tuple(rng.integers(0, shape).tolist()) for _ in range(2)]
        rate[ends[0]] = 1.0
        places = np.argwhere(np.ones(shape, dtype=bool))
        apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
        mean = 0.5 * (rate.ravel()[:, None] + rate.ravel())
        joined = (apart < 1.5) & (apart > 0.0) & np.isfinite(mean)
        steps = np.where(joined, apart * np.where(joined, mean, 0.0), 0.0)
        start, end = (np.ravel_multi_index(place, shape) for place in ends)
        least = dijkstra(steps, indices=start)[end]
        way = a_star(rate, *ends)
        index = np.ravel_multi_index(tuple(way.T), shape)
        assert len(way) if np.isfinite(least) else not len(way)
        assert steps[index[:-1], index[1:]].sum() == pytest.approx(least if len(way) else 0.0)
        assert not len(way) or (index[0], index[-1]) == (start, end)
