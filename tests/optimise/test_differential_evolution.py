"""Mutations against their published formulae, with the draws that the optimiser made."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.errors import InputError
from companion.optimise.differential_evolution import (
    BEST_1,
    BEST_2,
    CURRENT_TO_BEST_1,
    RAND_1,
    RAND_TO_BEST_1,
    BestTwo,
    Blend,
    ClassicalDE,
    CurrentToBest,
    Mutation,
    Settings,
    crossed,
    distinct_others,
    survivors,
)
from companion.optimise.improved_de import ImprovedDE
from companion.optimise.improved_de import Settings as ImprovedSettings

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


def special_cases(f: float) -> list[tuple[Mutation, Formula]]:
    """Each variant, by the parameters of eq. 15 where the paper's text says so."""
    return [
        (Blend(a=1.0, f1=0.0, f2=f), rand_1),
        (Blend(a=0.0, f1=0.0, f2=f), best_1),
        (Blend(a=1.0, f1=f, f2=f), rand_to_best_1),
        (BestTwo(f=f), best_2),
        (CurrentToBest(f=f), current_to_best_1),
    ]


@given(seed=st.integers(0, 10**6), f=st.floats(0.05, 1.5), case=st.integers(0, 4))
def test_the_same_draws_make_the_mutants_of_the_special_cases_formula(
    seed: int, f: float, case: int
) -> None:
    mutation, formula = special_cases(f)[case]
    x = np.random.default_rng(seed).random((NP, D))
    costs = np.random.default_rng(seed + 1).random(NP)
    de = ClassicalDE(
        D, Settings(population=NP, mutation=mutation, crossover=1.0), twin(seed), seeds=x
    )
    de.ask()
    de.tell(costs)
    draws = twin(seed)  # the same numbers, drawn by hand
    draws.random((NP, D))  # the first members
    others = distinct_others(NP, mutation.others, draws)
    best = x[costs.argmin()].tolist()
    for i, trial in enumerate(de.ask()):
        mutant = formula(x[i].tolist(), best, [x[r[i]].tolist() for r in others], f)
        assert trial == pytest.approx([min(max(v, 0.0), 1.0) for v in mutant], abs=1e-14)


def twin(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed + 2)


@given(seed=st.integers(0, 10**6), f1=st.floats(0.0, 1.0), f2=st.floats(0.0, 1.0))
def test_equation_15_between_its_ends_is_the_sum_that_is_printed(
    seed: int, f1: float, f2: float
) -> None:
    rng = np.random.default_rng(seed)
    x, a = rng.random((NP, D)), rng.random()
    others = distinct_others(NP, 3, rng)
    mutants = Blend(a=a, f1=f1, f2=f2).mutants(x, x[0], others)
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
        9,
        ImprovedSettings(population=NP, k1=(k1, k1), k2=(k2, k2)),
        Fixed(seed, [a, 0.7]),  # type: ignore[arg-type]
        seeds=x,
    )
    general = ClassicalDE(
        D,
        Settings(population=NP, mutation=Blend(a=a, f1=k1 * (1 - a), f2=k2 * a), crossover=0.7),
        Fixed(seed, []),  # type: ignore[arg-type]
        seeds=x,
    )
    for each in (improved, general):
        each.ask()
        each.tell(costs)
    assert improved.ask() == pytest.approx(general.ask(), abs=1e-14)


def test_the_variants_that_have_a_name_are_their_formulae_with_f_of_a_half() -> None:
    named = [RAND_1, BEST_1, RAND_TO_BEST_1, BEST_2, CURRENT_TO_BEST_1]
    assert named == [mutation for mutation, _ in special_cases(0.5)]


@pytest.mark.parametrize("cr", [0.0, 0.3, 1.0])
def test_a_trial_takes_a_variable_with_probability_cr_and_at_least_one(cr: float) -> None:
    rng = np.random.default_rng(1)
    trial = crossed(np.zeros((4_000, D)), np.ones((4_000, D)), np.full(4_000, cr), rng)
    assert set(np.unique(trial)) <= {0.0, 1.0}
    assert trial.any(axis=1).all()
    # one of D for certain, the others with Cr; 12,000 draws: 5 standard deviations are 0.023
    assert trial.mean() == pytest.approx(cr + (1 - cr) / D, abs=0.023)


@given(seed=st.integers(0, 10**6))
def test_the_better_survives_and_the_trial_if_equal(seed: int) -> None:
    rng = np.random.default_rng(seed)
    members, trial = rng.random((2, NP, D))
    costs, trial_costs = rng.integers(3, size=(2, NP)).astype(float)
    x, f, won = survivors(members, costs, trial, trial_costs)
    for i in range(NP):
        better = trial_costs[i] <= costs[i]
        assert won[i] == better
        assert x[i].tolist() == (trial if better else members)[i].tolist()
        assert f[i] == min(costs[i], trial_costs[i])


@given(size=st.integers(5, 40), count=st.integers(1, 4), seed=st.integers(0, 10**6))
def test_others_are_distinct_and_never_oneself(size: int, count: int, seed: int) -> None:
    others = np.array(distinct_others(size, count, np.random.default_rng(seed)))
    assert others.shape == (count, size)
    for i in range(size):
        drawn = set(others[:, i].tolist())
        assert len(drawn) == count
        assert drawn <= set(range(size)) - {i}


def test_four_members_are_enough_for_three_others() -> None:
    others = np.array(distinct_others(4, 3, np.random.default_rng(1)))
    for i in range(4):
        assert sorted([*others[:, i], i]) == [0, 1, 2, 3]


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
