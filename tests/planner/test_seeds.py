"""What a search begins with."""

import numpy as np
import pytest

from companion import jit
from companion.planner import seeds


@pytest.mark.parametrize("compiled", [False, True])
def test_places_are_at_shares_of_the_length_of_each_way(*, compiled: bool) -> None:
    """As numpy interpolates, to the last digit; steps may coincide."""
    along = jit.compiled(seeds.places_along) if compiled else seeds.places_along
    rng = np.random.default_rng(1)
    ways = [rng.normal(scale=1e3, size=(count, 2)) for count in (2, 3, 7, 40)]
    ways.append(np.repeat(ways[2], 2, axis=0))
    shares = np.array([0.0, 0.3, 0.5, 1.0])
    places = along(np.concatenate(ways), np.cumsum([0, *map(len, ways)]), shares)
    for way, found in zip(ways, places, strict=True):
        flown = np.append(0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T)))
        expected = [np.interp(shares * flown[-1], flown, axis) for axis in way.T]
        assert np.array_equal(found, np.stack(expected, axis=-1))
