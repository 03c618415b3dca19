"""The contract that every optimiser keeps under the one loop."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.optimise.loop import Ranked, minimise
from companion.optimise.registry import OPTIMISERS

FloatArray = NDArray[np.float64]
Objective = Callable[[FloatArray], FloatArray]

PAPERS = set(OPTIMISERS) - {"refined-de"}
every_optimiser = pytest.mark.parametrize("name", OPTIMISERS)
few = settings(max_examples=10)


def bowl(x: FloatArray) -> FloatArray:
    return ((x - 0.3) ** 2).sum(axis=1)


class Recorder:
    """An objective that keeps what it was asked."""

    def __init__(self, objective: Objective) -> None:
        self.objective = objective
        self.asked: list[FloatArray] = []

    def __call__(self, x: FloatArray) -> FloatArray:
        self.asked.append(x.copy())
        return self.objective(x)

    @property
    def points(self) -> FloatArray:
        return np.concatenate(self.asked)


def search(
    name: str,
    objective: Objective,
    *,
    seed: int = 1,
    dimensions: int = 4,
    evaluations: int = 600,
    seeds: FloatArray | None = None,
) -> Ranked:
    optimiser = OPTIMISERS[name](dimensions, evaluations, np.random.default_rng(seed), seeds)
    return minimise(optimiser, objective, evaluations)


@every_optimiser
class TestEveryOptimiser:
    @few
    @given(seed=st.integers(0, 10**6))
    def test_the_same_seed_gives_the_same_bytes(self, name: str, seed: int) -> None:
        a, b = (search(name, bowl, seed=seed) for _ in range(2))
        assert a.x.tobytes() == b.x.tobytes()
        assert a.costs.tobytes() == b.costs.tobytes()

    def test_another_seed_gives_another_search(self, name: str) -> None:
        a, b = (search(name, bowl, seed=seed) for seed in (1, 2))
        assert not np.array_equal(a.x, b.x)

    @few
    @given(seed=st.integers(0, 10**6), corner=st.floats(-1.0, 2.0))
    def test_candidates_stay_in_the_unit_cube(self, name: str, seed: int, corner: float) -> None:
        objective = Recorder(lambda x: ((x - corner) ** 2).sum(axis=1))
        search(name, objective, seed=seed, dimensions=3, evaluations=900)
        assert objective.points.min() >= 0.0
        assert objective.points.max() <= 1.0

    @few
    @given(seed=st.integers(0, 10**6))
    def test_the_best_is_the_best_of_all_that_were_evaluated(self, name: str, seed: int) -> None:
        objective = Recorder(bowl)
        ranked = search(name, objective, seed=seed, evaluations=720)
        assert ranked.costs[0] == bowl(objective.points).min()
        assert bowl(ranked.x) == pytest.approx(ranked.costs, rel=1e-12)
        assert (np.diff(ranked.costs) >= 0.0).all()

    @pytest.mark.parametrize("value", [0.0, np.inf, np.nan], ids=["flat", "infinite", "NaN"])
    def test_an_objective_without_a_slope_is_survived(self, name: str, value: float) -> None:
        objective = Recorder(lambda x: np.full(len(x), value))
        ranked = search(name, objective)
        assert len(objective.points) == 600
        assert np.isfinite(objective.points).all()
        assert ranked.x.shape == (len(ranked.costs), 4)
        assert np.isfinite(ranked.x).all()
        assert ranked.costs[0] == (np.inf if np.isnan(value) else value)

    @few
    @given(seed=st.integers(0, 10**6))
    def test_what_is_not_a_number_is_never_preferred(self, name: str, seed: int) -> None:
        def half_blind(x: FloatArray) -> FloatArray:
            return np.where(x[:, 0] < 0.5, np.nan, bowl(x))

        ranked = search(name, half_blind, seed=seed)
        assert ranked.x[0, 0] >= 0.5
        assert np.isfinite(ranked.costs[0])

    @few
    @given(budget=st.integers(1, 300), seed=st.integers(0, 100))
    def test_the_budget_is_spent_to_the_evaluation(self, name: str, budget: int, seed: int) -> None:
        objective = Recorder(bowl)
        ranked = search(name, objective, seed=seed, dimensions=3, evaluations=budget)
        assert len(objective.points) == ranked.evaluations == budget
        # the best is one that was evaluated, however small the budget
        assert ranked.costs[0] == bowl(objective.points).min()
        assert bowl(ranked.x[:1])[0] == pytest.approx(ranked.costs[0], rel=1e-12)

    @pytest.mark.parametrize("budget", [1, 3, 59])
    def test_a_budget_of_less_than_a_population_goes_to_the_seeds_first(
        self, name: str, budget: int
    ) -> None:
        seeds = np.random.default_rng(5).random((5, 3))
        objective = Recorder(bowl)
        search(name, objective, dimensions=3, evaluations=budget, seeds=seeds)
        first = min(budget, len(seeds))
        assert objective.points[:first].tolist() == seeds[:first].tolist()

    def test_a_single_feasible_point_that_is_known_is_kept(self, name: str) -> None:
        point = np.array([0.25, 0.75, 0.5])

        def only_there(x: FloatArray) -> FloatArray:
            return np.where((x == point).all(axis=1), 7.0, np.inf)

        ranked = search(name, only_there, dimensions=3, seeds=point[None])
        assert ranked.x[0].tolist() == point.tolist()
        assert ranked.costs[0] == 7.0

    def test_a_population_all_at_one_point_stays_finite_and_in_bounds(self, name: str) -> None:
        objective = Recorder(bowl)
        seeds = np.ones((200, 3))  # a corner: every difference is zero
        ranked = search(name, objective, dimensions=3, seeds=seeds)
        assert np.isfinite(objective.points).all()
        assert objective.points.min() >= 0.0
        assert objective.points.max() <= 1.0
        assert ranked.costs[0] <= bowl(np.ones((1, 3)))[0]

    def test_a_needle_is_found(self, name: str) -> None:
        # everything costs 1, but for a cell around the point
        point = np.array([0.25, 0.75])

        def needle(x: FloatArray) -> FloatArray:
            return np.where(np.abs(x - point).max(axis=1) < 0.15, np.abs(x - point).sum(1), 1.0)

        ranked = search(name, needle, seed=3, dimensions=2, evaluations=3_600)
        assert ranked.x[0] == pytest.approx(point, abs=0.01)

    def test_one_dimension_is_enough(self, name: str) -> None:
        ranked = search(name, bowl, seed=3, dimensions=1, evaluations=2_400)
        assert ranked.x[0] == pytest.approx([0.3], abs=1e-3)

    @pytest.mark.parametrize("seed", range(3))
    def test_the_middle_of_a_sphere_in_six_dimensions_is_found(self, name: str, seed: int) -> None:
        ranked = search(name, bowl, seed=seed, dimensions=6, evaluations=6_000)
        assert ranked.x[0] == pytest.approx(np.full(6, 0.3), abs=0.01)

    @pytest.mark.parametrize("seed", range(3))
    def test_the_middle_of_a_rotated_ellipsoid_is_found(self, name: str, seed: int) -> None:
        turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(4, 4)))[0]
        middle, scale = np.array([0.4, 0.6, 0.3, 0.5]), 10.0 ** np.linspace(0.0, 1.0, 4)

        def ellipsoid(x: FloatArray) -> FloatArray:
            return (((x - middle) @ turn * scale) ** 2).sum(axis=1)

        ranked = search(name, ellipsoid, seed=seed, evaluations=6_000)
        assert ranked.x[0] == pytest.approx(middle, abs=0.06)

    def test_an_optimum_in_a_corner_is_found(self, name: str) -> None:
        outside = np.array([1.3, -0.2, 1.1, 0.6])

        def beyond(x: FloatArray) -> FloatArray:
            return ((x - outside) ** 2).sum(axis=1)

        ranked = search(name, beyond, evaluations=6_000)
        assert ranked.x[0] == pytest.approx([1.0, 0.0, 1.0, 0.6], abs=0.02)

    @few
    @given(seed=st.integers(0, 10**6))
    def test_a_search_from_a_good_seed_ends_no_worse_than_it(self, name: str, seed: int) -> None:
        rng = np.random.default_rng(seed)
        good = np.clip(0.3 + rng.normal(0.0, 1e-4, (1, 6)), 0.0, 1.0)
        ranked = search(name, bowl, seed=seed, dimensions=6, evaluations=120, seeds=good)
        assert ranked.costs[0] <= bowl(good)[0]
        # 120 evaluations alone come nowhere near it
        assert search(name, bowl, seed=seed, dimensions=6, evaluations=120).costs[0] > 1e-3


def test_no_two_names_are_the_same_search_and_the_papers_have_its_60_members() -> None:
    assert {"improved-de", "pso", "ga", "de/rand/1/bin"} <= PAPERS
    assert len({search(name, bowl, seed=3).x.tobytes() for name in OPTIMISERS}) == len(OPTIMISERS)
    for name in PAPERS:
        assert OPTIMISERS[name](6, 3_000, np.random.default_rng(1), None).ask().shape == (60, 6)
