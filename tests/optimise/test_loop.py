"""The contract that every optimiser keeps under the one loop."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.optimise.improved_de import ImprovedDE, Settings
from companion.optimise.loop import Optimiser, minimise

FloatArray = NDArray[np.float64]
Maker = Callable[[int, int, int], Optimiser]  # seed, dimensions, generations
NP = 20


def improved_de(seed: int, dimensions: int, generations: int) -> Optimiser:
    settings = Settings(population=NP)
    return ImprovedDE(dimensions, generations, settings, np.random.default_rng(seed))


every_optimiser = pytest.mark.parametrize("make", [improved_de])  # a new one is one word here


def bowl(x: FloatArray) -> FloatArray:
    return ((x - 0.3) ** 2).sum(axis=1)


class Recorder:
    """An objective that keeps what it was asked."""

    def __init__(self, objective: Callable[[FloatArray], FloatArray]) -> None:
        self.objective = objective
        self.asked: list[FloatArray] = []

    def __call__(self, x: FloatArray) -> FloatArray:
        self.asked.append(x.copy())
        return self.objective(x)

    @property
    def evaluations(self) -> int:
        return sum(len(x) for x in self.asked)


class Scripted:
    """An optimiser of given candidates: for the loop itself."""

    def __init__(self, x: FloatArray) -> None:
        self.population = x
        self.costs = np.full(len(x), np.nan)

    def ask(self) -> FloatArray:
        return self.population

    def tell(self, costs: FloatArray) -> None:
        self.costs = costs


@every_optimiser
class TestEveryOptimiser:
    @given(seed=st.integers(0, 10**6))
    def test_the_same_seed_gives_the_same_bytes(self, make: Maker, seed: int) -> None:
        a = minimise(make(seed, 4, 10), bowl, 200)
        b = minimise(make(seed, 4, 10), bowl, 200)
        assert a.x.tobytes() == b.x.tobytes()
        assert a.costs.tobytes() == b.costs.tobytes()

    def test_another_seed_gives_another_search(self, make: Maker) -> None:
        a, b = (minimise(make(seed, 4, 10), bowl, 200) for seed in (1, 2))
        assert not np.array_equal(a.x, b.x)

    @given(seed=st.integers(0, 10**6), corner=st.floats(-1.0, 2.0))
    def test_candidates_stay_in_the_unit_cube(self, make: Maker, seed: int, corner: float) -> None:
        objective = Recorder(lambda x: ((x - corner) ** 2).sum(axis=1))
        minimise(make(seed, 3, 15), objective, 15 * NP)
        for x in objective.asked:
            assert x.min() >= 0.0
            assert x.max() <= 1.0

    @given(seed=st.integers(0, 10**6))
    def test_the_best_never_rises(self, make: Maker, seed: int) -> None:
        optimiser = make(seed, 5, 20)
        best = np.inf
        for _ in range(20):
            optimiser.tell(bowl(optimiser.ask()))
            assert optimiser.costs.min() <= best
            best = float(optimiser.costs.min())

    @given(seed=st.integers(0, 10**6))
    def test_the_best_is_the_best_of_all_that_were_evaluated(self, make: Maker, seed: int) -> None:
        objective = Recorder(bowl)
        ranked = minimise(make(seed, 4, 12), objective, 12 * NP)
        everything = np.concatenate(objective.asked)
        assert ranked.costs[0] == bowl(everything).min()
        assert bowl(ranked.x) == pytest.approx(ranked.costs, rel=1e-15)

    @pytest.mark.parametrize("value", [0.0, np.inf, np.nan], ids=["flat", "infinite", "NaN"])
    def test_an_objective_without_a_slope_is_survived(self, make: Maker, value: float) -> None:
        ranked = minimise(make(1, 4, 10), lambda x: np.full(len(x), value), 200)
        assert ranked.x.shape == (NP, 4)
        assert np.isfinite(ranked.x).all()
        assert not np.isnan(ranked.costs).any()

    @given(seed=st.integers(0, 10**6))
    def test_what_is_not_a_number_is_never_preferred(self, make: Maker, seed: int) -> None:
        def half_blind(x: FloatArray) -> FloatArray:
            return np.where(x[:, 0] < 0.5, np.nan, bowl(x))

        ranked = minimise(make(seed, 4, 20), half_blind, 20 * NP)
        assert ranked.x[0, 0] >= 0.5
        assert np.isfinite(ranked.costs[0])

    @given(budget=st.integers(1, 7 * NP), seed=st.integers(0, 100))
    def test_the_budget_is_spent_to_the_evaluation(
        self, make: Maker, budget: int, seed: int
    ) -> None:
        objective = Recorder(bowl)
        ranked = minimise(make(seed, 3, max(budget // NP, 1)), objective, budget)
        assert objective.evaluations == ranked.evaluations == budget
        # the best is one that was evaluated
        assert ranked.costs[0] == bowl(np.concatenate(objective.asked)).min()
        assert bowl(ranked.x[:1])[0] == pytest.approx(ranked.costs[0], rel=1e-15)

    def test_an_objective_of_one_point_is_found_to_be_that_point(self, make: Maker) -> None:
        # a needle: everything costs 1, but for a cell around the point
        point = np.array([0.25, 0.75])

        def needle(x: FloatArray) -> FloatArray:
            return np.where(np.abs(x - point).max(axis=1) < 0.15, np.abs(x - point).sum(1), 1.0)

        ranked = minimise(make(3, 2, 60), needle, 60 * NP)
        assert ranked.x[0] == pytest.approx(point, abs=0.01)

    def test_one_dimension_is_enough(self, make: Maker) -> None:
        ranked = minimise(make(3, 1, 40), bowl, 40 * NP)
        assert ranked.x[0] == pytest.approx([0.3], abs=1e-3)

    @pytest.mark.parametrize("seed", range(5))
    def test_a_bowl_in_six_dimensions_is_found_far_better_than_by_chance(
        self, make: Maker, seed: int
    ) -> None:
        ranked = minimise(make(seed, 6, 150), bowl, 150 * NP)
        by_chance = bowl(np.random.default_rng(seed).random((150 * NP, 6))).min()
        assert ranked.costs[0] < by_chance / 10.0


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
    objective = Recorder(lambda x: x[:, 0])
    minimise(Scripted(np.arange(size)[:, None] / size), objective, budget)
    sizes = [len(x) for x in objective.asked]
    assert sum(sizes) == budget
    assert all(asked == size for asked in sizes[:-1])
    assert objective.asked[-1][:, 0].tolist() == [k / size for k in range(sizes[-1])]
