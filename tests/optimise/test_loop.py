"""The loop itself; what every optimiser keeps under it is in tests/contracts."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.optimise.loop import first_members, minimise

FloatArray = NDArray[np.float64]


class Scripted:
    """An optimiser of given candidates: for the loop itself."""

    def __init__(self, x: FloatArray) -> None:
        self.population = x
        self.costs = np.full(len(x), np.nan)

    def ask(self) -> FloatArray:
        return self.population

    def tell(self, costs: FloatArray) -> None:
        self.costs = costs


def test_members_are_ranked_by_cost_equals_in_their_order_and_nan_as_infinite() -> None:
    x = np.array([[0.3], [0.1], [0.4], [0.2], [0.5]])
    costs = {0.3: 5.0, 0.1: 1.0, 0.2: 1.0, 0.4: np.nan, 0.5: -np.inf}
    ranked = minimise(Scripted(x), lambda x: np.array([costs[v] for v in x[:, 0]]), 5)
    assert ranked.costs.tolist() == [-np.inf, 1.0, 1.0, 5.0, np.inf]
    assert ranked.x[:, 0].tolist() == [0.5, 0.1, 0.2, 0.3, 0.4]
    assert ranked.evaluations == 5


@given(count=st.integers(0, 12), size=st.integers(1, 9), seed=st.integers(0, 10**6))
def test_the_first_members_are_the_seeds_clipped_and_then_random_points(
    count: int, size: int, seed: int
) -> None:
    seeds = np.random.default_rng(seed + 1).uniform(-0.5, 1.5, (count, 3))
    members = first_members(size, 3, np.random.default_rng(seed), seeds)
    alone = first_members(size, 3, np.random.default_rng(seed), None)
    known = min(count, size)
    clipped = [[min(max(v, 0.0), 1.0) for v in row] for row in seeds[:known].tolist()]
    assert members[:known].tolist() == clipped
    assert members[known:].tolist() == alone[known:].tolist()
    assert members.shape == (size, 3)
