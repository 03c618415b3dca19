"""Classical DE against its published formulae, with the draws that the optimiser made."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.errors import InputError
from companion.paper.evolution import (
    ClassicalDE,
    Generations,
    ImprovedDE,
    blend,
    crossed,
    distinct_others,
)
from companion.paper.genetic import Genetic
from companion.paper.swarm import ParticleSwarm

FloatArray = NDArray[np.float64]

NP, D = 8, 3


def twin(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed + 2)


@given(seed=st.integers(0, 10**6))
def test_the_same_draws_make_the_trials_of_equations_12_to_14(seed: int) -> None:
    x = np.random.default_rng(seed).random((NP, D))
    costs = np.random.default_rng(seed + 1).random(NP)
    de = ClassicalDE(D, 0, twin(seed), x, NP)
    de.ask()
    de.tell(costs)
    draws = twin(seed)  # the same numbers, drawn by hand
    draws.random((NP, D))  # the first members
    r = distinct_others(NP, 3, draws)
    taken, certain = draws.random((NP, D)) <= 0.9, draws.integers(D, size=NP)
    trial = de.ask().copy()
    for i in range(NP):
        for j in range(D):
            mutant = x[r[0][i], j] + 0.5 * (x[r[1][i], j] - x[r[2][i], j])
            if not (taken[i, j] or certain[i] == j):
                mutant = x[i, j]
            assert trial[i, j] == pytest.approx(min(max(mutant, 0.0), 1.0), abs=1e-14)
    told = costs + np.random.default_rng(seed + 3).choice([-0.1, 0.0, 0.1], NP)
    de.tell(told)  # eq. 14: the better survives, and the trial if equal
    for i in range(NP):
        assert de.population[i].tolist() == (trial if told[i] <= costs[i] else x)[i].tolist()
        assert de.costs[i] == min(told[i], costs[i])


@given(
    seed=st.integers(0, 10**6),
    a=st.floats(0.0, 1.0),
    f1=st.floats(0.0, 1.0),
    f2=st.floats(0.0, 1.0),
)
def test_the_blend_is_the_sum_that_equation_15_prints(
    seed: int, a: float, f1: float, f2: float
) -> None:
    x, costs = (np.random.default_rng(seed).random(shape) for shape in ((NP, D), NP))
    others = distinct_others(NP, 3, twin(seed))
    mutants = blend(x, costs, a, f1, f2, twin(seed))
    best = x[costs.tolist().index(min(costs))]
    for i in range(NP):
        for j in range(D):
            r1, r2, r3 = (x[r[i], j] for r in others)
            printed = a * r1 + (1 - a) * best[j] + f1 * (best[j] - r1) + f2 * (r2 - r3)
            assert mutants[i, j] == pytest.approx(printed, abs=1e-14)


@pytest.mark.parametrize("cr", [0.0, 0.3, 1.0])
def test_a_trial_takes_a_variable_with_probability_cr_and_at_least_one(cr: float) -> None:
    rng = np.random.default_rng(1)
    trial = crossed(np.zeros((4_000, D)), np.ones((4_000, D)), np.full(4_000, cr), rng)
    assert set(np.unique(trial)) <= {0.0, 1.0}
    assert trial.any(axis=1).all()
    # one of D for certain, the others with Cr; 12,000 draws: 5 standard deviations are 0.023
    assert trial.mean() == pytest.approx(cr + (1 - cr) / D, abs=0.023)


@given(size=st.integers(5, 40), count=st.integers(1, 4), seed=st.integers(0, 10**6))
@example(size=4, count=3, seed=1)
def test_others_are_distinct_and_never_oneself(size: int, count: int, seed: int) -> None:
    others = np.array(distinct_others(size, count, np.random.default_rng(seed)))
    assert others.shape == (count, size)
    for i in range(size):
        drawn = set(others[:, i].tolist())
        assert len(drawn) == count
        assert drawn <= set(range(size)) - {i}


def test_every_ordered_triple_of_others_is_drawn_about_as_often() -> None:
    rng = np.random.default_rng(1)
    draws = np.concatenate([np.array(distinct_others(5, 3, rng)).T[:1] for _ in range(24_000)])
    triples, counts = np.unique(draws, axis=0, return_counts=True)
    assert len(triples) == 4 * 3 * 2
    # 1000 expected of each: 6 standard deviations
    assert abs(counts - 1_000).max() < 6 * np.sqrt(1_000)


@pytest.mark.parametrize(
    ("make", "wrong", "right"),
    [
        (ClassicalDE, 3, 4),
        (ImprovedDE, 3, 4),
        (ParticleSwarm, 0, 1),
        (Genetic, 0, 2),
        (Genetic, 7, 8),
    ],
)
def test_too_few_members_are_refused(make: type[Generations], wrong: int, right: int) -> None:
    with pytest.raises(InputError, match=f"members = {wrong}: .* Set it to 60"):
        make(D, 100, twin(1), members=wrong)
    optimiser = make(D, 200, twin(1), members=right)
    for _ in range(3):
        optimiser.tell(optimiser.ask().sum(axis=1))
    assert optimiser.population.shape == (right, D)
