"""The rival among near things: what it decides, against brute force."""

from typing import Any

import numpy as np
from woods import AStar

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
