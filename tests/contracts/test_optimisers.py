"""The contract that every optimiser keeps under the one loop, and the loop itself."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.optimise.loop import Ranked, first_members, minimise
from companion.optimise.registry import OPTIMISERS

FloatArray = NDArray[np.float64]
Objective = Callable[[FloatArray], FloatArray]

PAPERS = set(OPTIMISERS) - {"refined-de"}
every_optimiser = pytest.mark.parametrize("name", OPTIMISERS)
few = settings(max_examples=10)
seeds = st.integers(0, 10**6)


def about(*middle: float) -> Objective:
    """The squared distance from there."""
    return lambda x: ((x - np.array(middle)) ** 2).sum(axis=1)


bowl = about(0.3)


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
    name: str, objective: Objective, *, seed: int = 1, dimensions: int = 4,
    evaluations: int = 600, seeds: FloatArray | None = None,
) -> Ranked:  # fmt: skip
    optimiser = OPTIMISERS[name](dimensions, evaluations, np.random.default_rng(seed), seeds)
    return minimise(optimiser, objective, evaluations)


@every_optimiser
class TestEveryOptimiser:
    @few
    @given(seed=seeds)
    def test_a_seed_repeats_its_search(self, name: str, seed: int) -> None:
        a, b, c = (search(name, bowl, seed=each) for each in (seed, seed, seed + 1))
        assert a.x.tobytes() == b.x.tobytes() != c.x.tobytes()
        assert a.costs.tobytes() == b.costs.tobytes()

    @few
    @given(seed=seeds, corner=st.floats(-1.0, 2.0), budget=st.integers(1, 900) | st.just(720))
    def test_the_budget_is_spent_to_the_evaluation_in_the_unit_cube_and_the_best_of_it_is_told(
        self, name: str, seed: int, corner: float, budget: int
    ) -> None:
        cost = about(corner)
        objective = Recorder(cost)
        ranked = search(name, objective, seed=seed, dimensions=3, evaluations=budget)
        assert len(objective.points) == ranked.evaluations == budget
        assert 0.0 <= objective.points.min() <= objective.points.max() <= 1.0
        assert ranked.costs[0] == cost(objective.points).min()
        told = slice(None if budget % 60 == 0 else 1)  # members that were not evaluated are none
        assert cost(ranked.x[told]) == pytest.approx(ranked.costs[told], rel=1e-12)
        assert (np.diff(ranked.costs[told]) >= 0.0).all()

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
    @given(seed=seeds)
    def test_what_is_not_a_number_is_never_preferred(self, name: str, seed: int) -> None:
        ranked = search(name, lambda x: np.where(x[:, 0] < 0.5, np.nan, bowl(x)), seed=seed)
        assert ranked.x[0, 0] >= 0.5
        assert np.isfinite(ranked.costs[0])

    @pytest.mark.parametrize("budget", [1, 3, 59])
    def test_a_small_budget_goes_to_the_seeds_first(self, name: str, budget: int) -> None:
        seeds, objective = np.random.default_rng(5).random((5, 3)), Recorder(bowl)
        search(name, objective, dimensions=3, evaluations=budget, seeds=seeds)
        first = min(budget, len(seeds))
        assert objective.points[:first].tolist() == seeds[:first].tolist()

    def test_a_single_feasible_point_that_is_known_is_kept(self, name: str) -> None:
        point = np.array([0.25, 0.75, 0.5])
        only_there: Objective = lambda x: np.where((x == point).all(axis=1), 7.0, np.inf)  # noqa: E731
        ranked = search(name, only_there, dimensions=3, seeds=point[None])
        assert (ranked.x[0].tolist(), ranked.costs[0]) == (point.tolist(), 7.0)

    def test_a_population_all_in_one_corner_stays_in_bounds(self, name: str) -> None:
        objective, seeds = Recorder(bowl), np.ones((200, 3))  # every difference is zero
        ranked = search(name, objective, dimensions=3, seeds=seeds)
        assert 0.0 <= objective.points.min() <= objective.points.max() <= 1.0
        assert ranked.costs[0] <= bowl(np.ones((1, 3)))[0]

    def test_a_needle_is_found(self, name: str) -> None:
        # everything costs 1, but for a cell around the point
        point = np.array([0.25, 0.75])

        def needle(x: FloatArray) -> FloatArray:
            return np.where(np.abs(x - point).max(axis=1) < 0.15, np.abs(x - point).sum(1), 1.0)

        ranked = search(name, needle, seed=3, dimensions=2, evaluations=3_600)
        assert ranked.x[0] == pytest.approx(point, abs=0.01)

    @pytest.mark.parametrize(("middle", "evaluations", "near"), [
        ((0.3,), 2_400, 1e-3), ((0.3,) * 6, 6_000, 0.01), ((1.3, -0.2, 1.1, 0.6), 6_000, 0.02),
    ])  # fmt: skip
    @pytest.mark.parametrize("seed", range(3))
    def test_the_middle_of_a_sphere_is_found_or_the_corner_that_is_nearest_to_it(
        self, name: str, middle: tuple[float, ...], evaluations: int, near: float, seed: int
    ) -> None:
        options = {"dimensions": len(middle), "evaluations": evaluations, "seed": seed}
        ranked = search(name, about(*middle), **options)  # type: ignore[arg-type]
        assert ranked.x[0] == pytest.approx(np.clip(middle, 0.0, 1.0), abs=near)

    @pytest.mark.parametrize("seed", range(3))
    def test_the_middle_of_a_rotated_ellipsoid_is_found(self, name: str, seed: int) -> None:
        turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(4, 4)))[0]
        middle, scale = np.array([0.4, 0.6, 0.3, 0.5]), 10.0 ** np.linspace(0.0, 1.0, 4)

        def ellipsoid(x: FloatArray) -> FloatArray:
            return (((x - middle) @ turn * scale) ** 2).sum(axis=1)

        ranked = search(name, ellipsoid, seed=seed, evaluations=6_000)
        assert ranked.x[0] == pytest.approx(middle, abs=0.06)

    @few
    @given(seed=seeds)
    def test_a_search_from_a_good_seed_ends_no_worse_than_it(self, name: str, seed: int) -> None:
        rng = np.random.default_rng(seed)
        good = np.clip(0.3 + rng.normal(0.0, 1e-4, (1, 6)), 0.0, 1.0)
        ranked = search(name, bowl, seed=seed, dimensions=6, evaluations=120, seeds=good)
        assert ranked.costs[0] <= bowl(good)[0]
        # 120 evaluations alone come nowhere near it
        assert search(name, bowl, seed=seed, dimensions=6, evaluations=120).costs[0] > 1e-4


def test_no_two_names_are_the_same_search_and_the_papers_have_its_60_members() -> None:
    assert {"improved-de", "pso", "ga", "de/rand/1/bin"} <= PAPERS
    assert len({search(name, bowl, seed=3).x.tobytes() for name in OPTIMISERS}) == len(OPTIMISERS)
    for name in PAPERS:
        assert OPTIMISERS[name](6, 3_000, np.random.default_rng(1), None).ask().shape == (60, 6)


def test_members_are_ranked_by_cost_equals_in_their_order_and_nan_as_infinite() -> None:
    class Scripted:
        population = np.array([[0.3], [0.1], [0.4], [0.2], [0.5]])
        costs = np.full(5, np.nan)

        def ask(self) -> FloatArray:
            return self.population

        def tell(self, costs: FloatArray) -> None:
            self.costs = costs

    costs = {0.3: 5.0, 0.1: 1.0, 0.2: 1.0, 0.4: np.nan, 0.5: -np.inf}
    ranked = minimise(Scripted(), lambda x: np.array([costs[v] for v in x[:, 0]]), 5)
    assert ranked.costs.tolist() == [-np.inf, 1.0, 1.0, 5.0, np.inf]
    assert ranked.x[:, 0].tolist() == [0.5, 0.1, 0.2, 0.3, 0.4]
    assert ranked.evaluations == 5


@given(count=st.integers(0, 12), size=st.integers(1, 9), seed=seeds)
def test_seeds_come_first_clipped_then_random_points(count: int, size: int, seed: int) -> None:
    known = np.random.default_rng(seed + 1).uniform(-0.5, 1.5, (count, 3))
    members = first_members(size, 3, np.random.default_rng(seed), known)
    alone = first_members(size, 3, np.random.default_rng(seed), None)
    first = min(count, size)
    assert members[:first].tolist() == np.clip(known[:first], 0.0, 1.0).tolist()
    assert members[first:].tolist() == alone[first:].tolist()
    assert members.shape == (size, 3)
