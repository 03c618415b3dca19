"""The four optimisers of Table 1 against their published formulae.

What all optimisers keep is in tests/contracts/test_optimisers.py.
"""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geodesy import FloatArray
from companion.paper.optimisers import (
    ClassicalDE,
    DifferentialEvolution,
    Generations,
    Genetic,
    ImprovedDE,
    ParticleSwarm,
    three_others,
)

NP, D, GENERATIONS, MANY = 7, 3, 8, 40_000
CHI = 0.7298437881283576  # the root for phi = 4.1, to all digits
seeds = st.integers(0, 10**6)


@pytest.fixture(autouse=True, scope="module")
def few_members() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Generations, "members", NP)
        yield


# --- differential evolution: the same draws by hand


@pytest.mark.parametrize("make", [ClassicalDE, ImprovedDE])
@given(seed=seeds)
def test_the_same_draws_make_the_trials_of_equations_12_to_18(
    make: type[DifferentialEvolution], seed: int
) -> None:
    de = make(D, GENERATIONS * NP, np.random.default_rng(seed))
    draws, judge = np.random.default_rng(seed), np.random.default_rng(seed + 1)
    x, costs = draws.random((NP, D)), judge.random(NP)
    assert de.ask().tolist() == x.tolist()
    de.tell(costs)
    a_mean, cr_mean = 1.0, 0.5  # 3.2; row 4
    for g in range(GENERATIONS - 1):
        if make is ClassicalDE:
            a, f1, f2, cr = np.ones(NP), np.zeros(NP), np.full(NP, 0.5), np.full(NP, 0.9)
            others = three_others(NP, draws)
        else:
            k1, k2 = 0.5 * (g / GENERATIONS) ** 2, 1.0 - 0.5 * (g / GENERATIONS) ** 2  # eq. 18
            a = np.clip(draws.normal(a_mean, 0.2, NP), 0.0, 1.0)
            f1, f2 = k1 * (1.0 - a), k2 * a  # eq. 16
            others = three_others(NP, draws)
            cr = np.clip(draws.normal(cr_mean, 0.2, NP), 0.0, 1.0)
        taken, certain = draws.random((NP, D)), draws.integers(D, size=NP)
        told, trials = judge.choice([-0.1, 0.0, 0.1], NP) + costs, de.ask().copy()
        if g == 3:
            told = costs + 1.0  # nothing succeeds: the means stay
        best, (one, two, three) = x[costs.argmin()], x[others]
        mutants = a[:, None] * one + (1.0 - a[:, None]) * best  # eq. 15
        mutants += f1[:, None] * (best - one) + f2[:, None] * (two - three)
        is_taken = (taken <= cr[:, None]) | (certain[:, None] == np.arange(D))  # eq. 13
        assert trials == pytest.approx(np.where(is_taken, mutants, x).clip(0.0, 1.0), abs=1e-13)
        de.tell(told)
        survives = told <= costs  # eq. 14
        if survives.any():
            a_mean, cr_mean = a[survives].mean(), cr[survives].mean()
        x, costs = np.where(survives[:, None], trials, x), np.minimum(told, costs)
        assert de.population.tolist() == x.tolist()
        assert de.costs.tolist() == costs.tolist()


def test_every_ordered_triple_of_others_is_drawn_about_as_often_and_never_oneself() -> None:
    rng = np.random.default_rng(1)
    draws = np.concatenate([three_others(5, rng).T[:1] for _ in range(24_000)])
    triples, counts = np.unique(draws, axis=0, return_counts=True)
    assert len(triples) == 4 * 3 * 2
    assert all(len({0, *triple}) == 4 for triple in triples.tolist())
    # 1000 expected of each: 6 standard deviations
    assert abs(counts - 1_000).max() < 6 * np.sqrt(1_000)


# --- the swarm


@given(seed=seeds)
def test_every_particle_moves_by_the_equations_of_clerc_and_kennedy(seed: int) -> None:
    swarm = ParticleSwarm(D, 0, np.random.default_rng(seed))
    draws = np.random.default_rng(seed)  # the same numbers, drawn by hand
    costs_of = np.random.default_rng(seed + 1)
    x = draws.random((NP, D))
    v = np.zeros((NP, D))
    own, own_costs = x.copy(), np.full(NP, np.inf)
    for generation in range(6):
        assert swarm.ask() == pytest.approx(x, abs=1e-12)
        costs = costs_of.random(NP)
        swarm.tell(costs)
        better = costs <= own_costs
        own[better], own_costs[better] = x[better], costs[better]
        assert swarm.costs == pytest.approx(own_costs)
        assert swarm.population == pytest.approx(own, abs=1e-12), generation
        best = own[own_costs.argmin()]
        u1, u2 = draws.random((NP, D)), draws.random((NP, D))
        v = np.clip(CHI * (v + 2.05 * u1 * (own - x) + 2.05 * u2 * (best - x)), -0.5, 0.5)
        free = x + v
        x = free.clip(0.0, 1.0)
        v[x != free] = 0.0


# --- the genetic algorithm: who is a parent, and who stays


def told(x: FloatArray, costs: FloatArray, **operators: float) -> Genetic:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Genetic, "members", len(x))
        ga = Genetic(x.shape[1], 0, np.random.default_rng(1), x)
    for name, value in operators.items():
        assert hasattr(ga, name)
        setattr(ga, name, value)
    assert (ga.ask() == x).all()
    ga.tell(costs)
    return ga


def test_a_parent_is_the_better_of_two() -> None:
    ranks = np.arange(MANY) / MANY
    # neither crossover nor mutations of any size: children are parents
    children = told(ranks[:, None], ranks, crossover=0.0, mutation_index=1e12).ask()[:, 0]
    # the lesser of two uniform numbers has mean 1/3 and median 1 - sqrt(1/2)
    assert children.mean() == pytest.approx(1 / 3, abs=0.006)
    assert np.median(children) == pytest.approx(1.0 - np.sqrt(0.5), abs=0.009)


@given(seed=seeds)
def test_the_best_parent_takes_the_place_of_the_worst_child_unless_a_child_is_as_good(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    x, costs, after = rng.random((6, 2)), rng.random(6), rng.random(6)
    ga = told(x, costs)
    expected, expected_costs = ga.ask().tolist(), after.tolist()
    ga.tell(after)
    if costs.min() < after.min():
        worst = expected_costs.index(max(expected_costs))
        expected[worst], expected_costs[worst] = x[costs.argmin()].tolist(), costs.min()
    assert ga.population.tolist() == expected
    assert ga.costs.tolist() == expected_costs
