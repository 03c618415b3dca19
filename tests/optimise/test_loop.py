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


def test_members_are_ranked_by_cost_and_equals_in_their_order() -> None:
    x = np.array([[0.3], [0.1], [0.2], [0.1]])
    costs = {0.3: 5.0, 0.1: 1.0, 0.2: 1.0}
    ranked = minimise(Scripted(x), lambda x: np.array([costs[v] for v in x[:, 0]]), 4)
    assert ranked.costs.tolist() == [1.0, 1.0, 1.0, 5.0]
    assert ranked.x[:, 0].tolist() == [0.1, 0.2, 0.1, 0.3]
    assert ranked.evaluations == 4


def test_costs_that_are_not_numbers_are_told_as_infinite() -> None:
    optimiser = Scripted(np.zeros((3, 2)))
    ranked = minimise(optimiser, lambda _: np.array([np.nan, -np.inf, 2.0]), 3)
    assert ranked.costs.tolist() == [-np.inf, 2.0, np.inf]


@given(size=st.integers(1, 30), budget=st.integers(1, 200))
def test_the_last_generation_is_cut_to_what_is_left_of_the_budget(size: int, budget: int) -> None:
    asked: list[FloatArray] = []

    def objective(x: FloatArray) -> FloatArray:
        asked.append(x)
        return x[:, 0]

    minimise(Scripted(np.arange(size)[:, None] / size), objective, budget)
    sizes = [len(x) for x in asked]
    assert sum(sizes) == budget
    assert all(each == size for each in sizes[:-1])
    assert asked[-1][:, 0].tolist() == [k / size for k in range(sizes[-1])]


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
