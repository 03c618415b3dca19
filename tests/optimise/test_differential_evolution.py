"""Classical DE against its published formulae, with the draws that the optimiser made."""

import numpy as np
import pytest
from companion.optimise.differential_evolution import (
    ClassicalDE,
    Settings,
    blend,
    crossed,
    distinct_others,
)
from companion.optimise.improved_de import ImprovedDE
from companion.optimise.improved_de import Settings as ImprovedSettings
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.errors import InputError

FloatArray = NDArray[np.float64]

NP, D = 8, 3


def twin(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed + 2)


@given(seed=st.integers(0, 10**6))
def test_the_same_draws_make_the_trials_of_equations_12_to_14(seed: int) -> None:
    x = np.random.default_rng(seed).random((NP, D))
    costs = np.random.default_rng(seed + 1).random(NP)
    de = ClassicalDE(D, 0, twin(seed), x, Settings(population=NP))
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
    rng = np.random.default_rng(seed)
    x = rng.random((NP, D))
    others = distinct_others(NP, 3, rng)
    mutants = blend([x[r] for r in others], x[0], a, f1, f2)
    for i in range(NP):
        for j in range(D):
            r1, r2, r3 = (x[r[i], j] for r in others)
            printed = a * r1 + (1 - a) * x[0, j] + f1 * (x[0, j] - r1) + f2 * (r2 - r3)
            assert mutants[i, j] == pytest.approx(printed, abs=1e-14)


class Fixed:
    """A generator whose normal deviates are all one number: a, then Cr, of the improved DE."""

    def __init__(self, seed: int, values: list[float]) -> None:
        self.rng, self.values = np.random.default_rng(seed), values

    def normal(self, _mean: float, _spread: float, size: int) -> FloatArray:
        return np.full(size, self.values.pop(0))

    def random(self, shape: tuple[int, int]) -> FloatArray:
        return self.rng.random(shape)

    def integers(self, high: int, size: int) -> NDArray[np.int64]:
        return self.rng.integers(high, size=size)


@given(seed=st.integers(0, 10**6), a=st.floats(0.0, 1.0))
def test_the_improved_de_with_fixed_parameters_is_equation_15(seed: int, a: float) -> None:
    # eq. 16: F1 = k1 (1 - a), F2 = k2 a; with the same draws by hand
    x = np.random.default_rng(seed).random((NP, D))
    costs = np.random.default_rng(seed + 1).random(NP)
    k1, k2 = 0.3, 0.8
    improved = ImprovedDE(
        D,
        9 * NP,
        Fixed(seed, [a, 0.7]),  # type: ignore[arg-type]
        x,
        ImprovedSettings(population=NP, k1=(k1, k1), k2=(k2, k2)),
    )
    improved.ask()
    improved.tell(costs)
    draws = np.random.default_rng(seed)
    draws.random((NP, D))
    others = [x[r] for r in distinct_others(NP, 3, draws)]
    mutants = np.clip(blend(others, x[costs.argmin()], a, k1 * (1 - a), k2 * a), 0.0, 1.0)
    trials = crossed(x, mutants, np.full(NP, 0.7), draws)
    assert improved.ask() == pytest.approx(trials, abs=1e-14)


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


def test_a_population_too_small_for_its_mutation_is_refused() -> None:
    with pytest.raises(InputError, match=r"population = 3: .* Set it to 4 or"):
        Settings(population=3)
    Settings(population=4)
