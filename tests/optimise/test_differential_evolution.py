"""Mutations against their published formulae, with the draws that the optimiser made."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.errors import InputError
from companion.optimise.differential_evolution import (
    BEST_2,
    CURRENT_TO_BEST_1,
    RAND_1,
    ClassicalDE,
    Mutation,
    Settings,
    best_two,
    blended,
    crossed,
    current_to_best,
    distinct_others,
)
from companion.optimise.improved_de import ImprovedDE
from companion.optimise.improved_de import Settings as ImprovedSettings
from companion.optimise.registry import OPTIMISERS

FloatArray = NDArray[np.float64]
Row = list[float]
Formula = Callable[[Row, Row, list[Row], float], Row]  # member, best, others, F -> mutant

NP, D = 8, 3


def rand_1(_: Row, __: Row, r: list[Row], f: float) -> Row:
    return [r[0][j] + f * (r[1][j] - r[2][j]) for j in range(D)]


def best_1(_: Row, best: Row, r: list[Row], f: float) -> Row:
    return [best[j] + f * (r[1][j] - r[2][j]) for j in range(D)]


def rand_to_best_1(_: Row, best: Row, r: list[Row], f: float) -> Row:
    return [r[0][j] + f * (best[j] - r[0][j]) + f * (r[1][j] - r[2][j]) for j in range(D)]


def best_2(_: Row, best: Row, r: list[Row], f: float) -> Row:
    return [best[j] + f * (r[0][j] - r[1][j]) + f * (r[2][j] - r[3][j]) for j in range(D)]


def current_to_best_1(member: Row, best: Row, r: list[Row], f: float) -> Row:
    return [member[j] + f * (best[j] - member[j]) + f * (r[0][j] - r[1][j]) for j in range(D)]


#: Each variant, by the parameters of eq. 15 where the paper's text says so.
CASES: dict[str, tuple[Callable[[float], Mutation], Formula]] = {
    "de/rand/1/bin": (lambda f: blended(1.0, 0.0, f), rand_1),
    "de/best/1": (lambda f: blended(0.0, 0.0, f), best_1),
    "de/rand-to-best/1": (lambda f: blended(1.0, f, f), rand_to_best_1),
    "de/best/2": (best_two, best_2),
    "de/current-to-best/1": (current_to_best, current_to_best_1),
}


@pytest.mark.parametrize("name", CASES)
@given(seed=st.integers(0, 10**6), f=st.floats(0.05, 1.5))
def test_the_same_draws_make_the_mutants_of_the_special_cases_formula(
    name: str, seed: int, f: float
) -> None:
    make, formula = CASES[name]
    mutation = make(f)
    x = np.random.default_rng(seed).random((NP, D))
    costs = np.random.default_rng(seed + 1).random(NP)
    how = Settings(population=NP, mutation=mutation, crossover=1.0)
    de = ClassicalDE(D, 0, twin(seed), x, how)
    de.ask()
    de.tell(costs)
    draws = twin(seed)  # the same numbers, drawn by hand
    draws.random((NP, D))  # the first members
    others = distinct_others(NP, mutation.others, draws)
    best = x[costs.argmin()].tolist()
    trial = de.ask().copy()
    for i in range(NP):
        mutant = formula(x[i].tolist(), best, [x[r[i]].tolist() for r in others], f)
        assert trial[i] == pytest.approx([min(max(v, 0.0), 1.0) for v in mutant], abs=1e-14)
    told = costs + np.random.default_rng(seed + 3).choice([-0.1, 0.0, 0.1], NP)
    de.tell(told)  # eq. 14: the better survives, and the trial if equal
    for i in range(NP):
        assert de.population[i].tolist() == (trial if told[i] <= costs[i] else x)[i].tolist()
        assert de.costs[i] == min(told[i], costs[i])


@pytest.mark.parametrize("name", CASES)
def test_the_variants_that_have_a_name_are_their_formulae_with_f_of_a_half(name: str) -> None:
    x, how = np.random.default_rng(1).random((60, D)), Settings(mutation=CASES[name][0](0.5))
    by_hand = ClassicalDE(D, 0, np.random.default_rng(2), x, how)
    asked = OPTIMISERS[name](D, 0, np.random.default_rng(2), x)
    for de in (by_hand, asked):
        de.tell(np.arange(float(len(de.ask()))))
    assert (asked.ask() == by_hand.ask()).all()


def twin(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed + 2)


@given(seed=st.integers(0, 10**6), f1=st.floats(0.0, 1.0), f2=st.floats(0.0, 1.0))
def test_equation_15_between_its_ends_is_the_sum_that_is_printed(
    seed: int, f1: float, f2: float
) -> None:
    rng = np.random.default_rng(seed)
    x, a = rng.random((NP, D)), rng.random()
    others = distinct_others(NP, 3, rng)
    mutants = blended(a, f1, f2).mutants(x, x[0], [x[r] for r in others])
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
    # eq. 16: F1 = k1 (1 - a), F2 = k2 a; with the same draws both make the same trials
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
    mutation = blended(a, k1 * (1 - a), k2 * a)
    general = ClassicalDE(
        D,
        0,
        Fixed(seed, []),  # type: ignore[arg-type]
        x,
        Settings(population=NP, mutation=mutation, crossover=0.7),
    )
    for each in (improved, general):
        each.ask()
        each.tell(costs)
    assert improved.ask() == pytest.approx(general.ask(), abs=1e-14)


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


@pytest.mark.parametrize(("mutation", "least"), [(RAND_1, 4), (BEST_2, 5), (CURRENT_TO_BEST_1, 3)])
def test_a_population_too_small_for_its_mutation_is_refused(mutation: Mutation, least: int) -> None:
    with pytest.raises(InputError, match=f"population = {least - 1}: .* Set it to {least} or"):
        Settings(population=least - 1, mutation=mutation)
    Settings(population=least, mutation=mutation)


@pytest.mark.parametrize("crossover", [-0.1, 1.1, np.nan])
def test_a_crossover_that_is_no_probability_is_refused(crossover: float) -> None:
    with pytest.raises(InputError, match="crossover"):
        Settings(crossover=crossover)
