"""The operators of the genetic algorithm against their published distributions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.paper.genetic import Genetic

FloatArray = NDArray[np.float64]
MANY = 40_000


def told(x: FloatArray, costs: FloatArray, seed: int = 1, **operators: float) -> Genetic:
    ga = Genetic(x.shape[1], 0, np.random.default_rng(seed), x, len(x))
    for name, value in operators.items():
        assert hasattr(ga, name)
        setattr(ga, name, value)
    assert (ga.ask() == x).all()
    ga.tell(costs)
    return ga


def test_children_without_crossover_are_parents_but_for_mutations_of_one_in_d() -> None:
    d = 5
    x = np.full((MANY, d), 0.5)
    ga = told(x, np.zeros(MANY), crossover=0.0)
    changed = ga.ask() != 0.5
    # 200,000 draws of 1 / 5: 5 standard deviations are 0.0045
    assert changed.mean() == pytest.approx(1 / d, abs=0.0045)


def test_mutations_have_the_polynomial_distribution() -> None:
    index = 20.0
    x = np.full((MANY, 1), 0.5)  # one variable: it is always mutated
    ga = told(x, np.zeros(MANY), crossover=0.0, mutation_index=index)
    step = np.sort(ga.ask()[:, 0] - 0.5)
    assert np.abs(step).max() < 0.5  # nothing was clipped
    # density (n + 1) / 2 (1 - |s|)^n: the distribution function by hand
    half = 0.5 * (1.0 - np.abs(step)) ** (index + 1.0)
    expected = np.where(step < 0.0, half, 1.0 - half)
    empirical = (np.arange(MANY) + 0.5) / MANY
    assert np.abs(expected - empirical).max() < 2.0 / np.sqrt(MANY)  # Kolmogorov, p < 0.001


def test_crossed_children_have_the_binary_distribution_about_the_middle_of_their_parents() -> None:
    index = 15.0
    x = np.tile([[0.4], [0.6]], (MANY // 2, 1))
    # mutations of no size; parents in both halves are drawn at random
    ga = told(x, np.zeros(MANY), crossover=1.0, mutation_index=1e12)
    children = ga.ask()[:, 0]
    one, two = np.split(children, 2)
    assert (one + two)[np.abs(one - two) > 1e-9] == pytest.approx(1.0, abs=1e-9)
    spread = np.abs(one - two) / 0.2  # of pairs whose parents differ
    different = np.abs(one + two - 1.0) < 1e-6
    crossed = np.sort(spread[different & (np.abs(spread - 1.0) > 1e-9)])
    # beta has density 0.5 (n + 1) beta^n below 1 and 0.5 (n + 1) beta^-(n + 2) above
    expected = np.where(
        crossed < 1.0, 0.5 * crossed ** (index + 1.0), 1.0 - 0.5 * crossed ** -(index + 1.0)
    )
    empirical = (np.arange(len(crossed)) + 0.5) / len(crossed)
    assert len(crossed) > 3_000
    assert np.abs(expected - empirical).max() < 2.0 / np.sqrt(len(crossed))
    # of the pairs that differ, half the variables are crossed
    assert len(crossed) / different.sum() == pytest.approx(0.5, abs=0.03)


def test_a_parent_is_the_better_of_two() -> None:
    ranks = np.arange(MANY) / MANY
    # neither crossover nor mutations of any size: children are parents
    children = told(ranks[:, None], ranks, crossover=0.0, mutation_index=1e12).ask()[:, 0]
    # the lesser of two uniform numbers has mean 1/3 and median 1 - sqrt(1/2)
    assert children.mean() == pytest.approx(1 / 3, abs=0.006)
    assert np.median(children) == pytest.approx(1.0 - np.sqrt(0.5), abs=0.009)


@given(seed=st.integers(0, 10**6))
def test_the_best_parent_takes_the_place_of_the_worst_child_unless_a_child_is_as_good(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    x, costs = rng.random((6, 2)), rng.random(6)
    ga = told(x, costs, seed)
    children, after = ga.ask().copy(), rng.random(6)
    ga.tell(after)
    expected, expected_costs = children.tolist(), after.tolist()
    if costs.min() < after.min():
        worst = expected_costs.index(max(expected_costs))
        expected[worst] = x[costs.argmin()].tolist()
        expected_costs[worst] = costs.min()
    assert ga.population.tolist() == expected
    assert ga.costs.tolist() == expected_costs
