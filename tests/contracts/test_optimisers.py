"""The contract that every optimiser keeps under the one loop, and the loop itself."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geodesy import FloatArray
from companion.optimise.loop import Ranked, minimise
from companion.optimise.registry import OPTIMISERS

Objective = Callable[[FloatArray], FloatArray]

PAPERS = ("improved-de", "de/rand/1/bin", "pso", "ga")
every_optimiser = pytest.mark.parametrize("name", OPTIMISERS)
seeds = st.integers(0, 10**6)


def about(*middle: float) -> Objective:
    """The squared distance from there."""
    return lambda x: ((x - np.array(middle)) ** 2).sum(axis=1)


def search(
    name: str, objective: Objective, *, seed: int = 1, dimensions: int = 4,
    evaluations: int = 600, seeds: FloatArray | None = None,
) -> tuple[Ranked, FloatArray]:  # fmt: skip
    """What is found, and the points that were asked for."""
    asked = list[FloatArray]()

    def noted(x: FloatArray) -> FloatArray:
        asked.append(x.copy())
        return objective(x)

    optimiser = OPTIMISERS[name](dimensions, evaluations, np.random.default_rng(seed), seeds)
    return minimise(optimiser, noted, evaluations), np.concatenate(asked)


def half_of_it_no_number(x: FloatArray) -> FloatArray:
    return np.where(x[:, 0] < 0.5, np.nan, about(0.6)(x))


def level(value: float) -> Objective:
    return lambda x: np.full(len(x), value)


OBJECTIVES = [about(0.3), about(-1.0), half_of_it_no_number, *map(level, (0.0, np.inf, np.nan))]


@every_optimiser
@given(
    seed=seeds,
    objective=st.sampled_from(OBJECTIVES),
    budget=st.integers(1, 900) | st.just(720),
    count=st.integers(0, 100),
    spread=st.sampled_from([0.0, 1e-4, 0.5]),
)
def test_what_is_known_is_tried_first_and_the_best_of_the_budget_is_told_whatever_the_objective(
    name: str, seed: int, objective: Objective, budget: int, count: int, spread: float
) -> None:
    """All in the unit cube; a seed repeats it to the last bit."""
    rng = np.random.default_rng(seed)
    known = rng.uniform(0.0, 1.0, 3) + rng.normal(0.0, spread, (count, 3))
    options = {"dimensions": 3, "evaluations": budget, "seeds": known if count else None}
    ranked, asked = search(name, objective, seed=seed, **options)
    assert len(asked) == ranked.evaluations == budget
    assert 0.0 <= asked.min() <= asked.max() <= 1.0
    first = min(budget, count, 20)  # as many as the smallest population has
    assert asked[:first].tolist() == np.clip(known[:first], 0.0, 1.0).tolist()
    costs = np.nan_to_num(objective(asked), nan=np.inf, posinf=np.inf)
    assert ranked.costs[0] == costs.min()
    told = slice(None if budget % len(ranked.x) == 0 else 1)  # else some were not evaluated
    found = np.nan_to_num(objective(ranked.x[told]), nan=np.inf, posinf=np.inf)
    assert found == pytest.approx(ranked.costs[told], rel=1e-12)
    assert ranked.costs[told].tolist() == sorted(ranked.costs[told])
    again, asked_again = search(name, objective, seed=seed, **options)
    assert (asked.tobytes(), ranked.x.tobytes()) == (asked_again.tobytes(), again.x.tobytes())


def needle(x: FloatArray) -> FloatArray:
    """Everything costs 1, but for a cell around a point."""
    off = np.abs(x - np.array([0.25, 0.75]))
    return np.where(off.max(axis=1) < 0.15, off.sum(axis=1), 1.0)


def ellipsoid(x: FloatArray) -> FloatArray:
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(4, 4)))[0]
    scale = 10.0 ** np.linspace(0.0, 1.0, 4)
    return (((x - np.array([0.4, 0.6, 0.3, 0.5])) @ turn * scale) ** 2).sum(axis=1)


@every_optimiser
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("objective", "best", "budget", "near"),
    [
        (about(0.3), (0.3,), 2_400, 1e-3),
        (about(0.3), (0.3,) * 6, 6_000, 0.01),
        (about(1.3, -0.2, 1.1, 0.6), (1.0, 0.0, 1.0, 0.6), 6_000, 0.02),
        (half_of_it_no_number, (0.6,) * 3, 6_000, 0.01),
        (needle, (0.25, 0.75), 3_600, 0.01),
        (ellipsoid, (0.4, 0.6, 0.3, 0.5), 6_000, 0.06),
    ],
)
def test_the_lowest_place_is_found(
    name: str, seed: int, objective: Objective, best: tuple[float, ...], budget: int, near: float
) -> None:
    ranked, _ = search(name, objective, seed=seed, dimensions=len(best), evaluations=budget)
    assert ranked.x[0] == pytest.approx(best, abs=near)


def test_no_two_names_are_the_same_search_and_the_papers_have_its_60_members() -> None:
    asked = {search(name, about(0.3), seed=3)[1].tobytes() for name in OPTIMISERS}
    assert len(asked) == len(OPTIMISERS)
    for name in PAPERS:
        assert OPTIMISERS[name](6, 3_000, np.random.default_rng(1), None).ask().shape == (60, 6)


def test_members_are_ranked_by_cost_equals_in_their_order_and_nan_as_infinite() -> None:
    """Else the same seed may find another plan on another computer."""

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
