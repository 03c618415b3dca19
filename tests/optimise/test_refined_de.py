"""The refined search, operator by operator; the contract of all optimisers is in tests/contracts.

The state is open, so a test sets what was drawn and what is remembered, and compares the trials
with eq. 17 for every choice of members that could have been made.
"""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geodesy import FloatArray
from companion.optimise import refined_de as names
from companion.optimise.refined_de import Settings, State, ask, begin, ranked, spent, tell

D = 3
NO_SEEDS = np.empty((0, D))
SMALL = Settings(population=7, smallest=7, spread=0.0, own=0.0)
few = settings(max_examples=20)


def rugged(x: FloatArray) -> float:
    """Many basins, a kink at a bound and a step: like a subpath's cost."""
    waves = np.sin(9.0 * x + 3.0 * x[::-1]).sum()
    return float(waves + 4.0 * np.abs(x - 0.1).sum() + (2.0 if x[0] + x[1] > 1.2 else 0.0))


def search(evaluations: int, seed: int, *, stops_early: bool) -> State:
    """A whole search; stops_early: costs above the bounds are told as infinite."""
    state = begin(D, evaluations, NO_SEEDS, Settings(), np.random.default_rng(seed))
    while n := ask(state):
        for i in range(n):
            value = rugged(state.trial[i])
            over = stops_early and value > state.trial_bounds[i]
            state.trial_costs[i] = math.inf if over else value
        tell(state, n)
    return state


def started(how: Settings, seed: int, a: float = 0.5) -> State:
    """A search whose population has random costs, and so far from the bounds that none clips."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.45, 0.55, (how.members(700), D))
    state = begin(D, 700, x, how, rng)
    n = ask(state)
    assert (state.trial[:n] == x).all()
    state.trial_costs[:n] = rng.random(n)
    tell(state, n)
    state.memory[:] = 1.0 - a, 1.0
    return state


def members(state: State) -> FloatArray:
    return state.population[: state.now[names.SIZE]].copy()


def mutants(state: State, i: int, a: float, best: list[FloatArray]) -> FloatArray:
    """Every mutant that member i can have: eq. 17 with k1 = 0 and 1 - a for k2 a."""
    x = members(state)
    rest = [r for r in range(len(x)) if r != i]
    kept = state.archive[: state.now[names.KEPT]]
    triples = [
        (r1, r2, third)
        for r1, r2 in itertools.permutations(rest, 2)
        for third in (*(r for r in rest if r not in (r1, r2)), *range(len(x), len(x) + len(kept)))
    ]
    r1, r2, third = np.array(triples).T
    apart = (1 - a) * (x[r2] - np.concatenate([x, kept])[third])
    pulled = [a * x[r1] + (1 - a) * b for b in best]
    return np.concatenate([each + apart for each in pulled])


@few
@given(seed=st.integers(0, 10**6), a=st.floats(0.0, 1.0))
def test_every_mutant_is_equation_17_of_one_of_the_p_best_and_three_others(
    seed: int, a: float
) -> None:
    state = started(SMALL._replace(p_best=0.43), seed, a)
    kept = np.random.default_rng(seed + 1).uniform(0.45, 0.55, (4, D))
    state.archive[:4], state.now[names.KEPT] = kept, 4
    best = [members(state)[k] for k in np.argsort(state.costs)[:3]]
    n = ask(state)
    assert n == 7
    for i in range(n):
        off = np.abs(mutants(state, i, a, best) - state.trial[i]).max(axis=1)
        assert off.min() < 1e-12


@few
@given(seed=st.integers(0, 10**6))
def test_the_better_survives_and_the_trial_if_equal_and_beaten_parents_are_kept(seed: int) -> None:
    state = started(SMALL, seed)
    before, costs = members(state), state.costs.copy()
    n = ask(state)
    trial, bounds = state.trial[:n].copy(), state.trial_bounds[:n].copy()
    change = np.random.default_rng(seed).choice([-0.1, 0.0, 0.1], n)
    state.trial_costs[:n] = costs + change
    tell(state, n)
    assert (bounds == costs).all()
    assert (state.population == np.where((change <= 0.0)[:, None], trial, before)).all()
    assert (state.costs == np.minimum(costs, costs + change)).all()
    assert state.archive[: state.now[names.KEPT]].tolist() == before[change < 0].tolist()
    assert (state.costs[state.order] == np.sort(state.costs)).all()


def test_the_population_begins_as_large_as_allowed_falls_linearly_and_its_worst_go() -> None:
    for evaluations, expected in ((10, 20), (600, 27), (3_000, 60), (10**6, 150)):
        assert Settings().members(evaluations) == expected
        state = begin(D, evaluations, NO_SEEDS, Settings(), np.random.default_rng(0))
        assert ask(state) == min(expected, evaluations)
    state = begin(D, 2_000, NO_SEEDS, Settings(population=60, smallest=6), np.random.default_rng(1))
    while n := ask(state):
        before = np.sort(state.costs[: state.now[names.SIZE] or 60])
        told = [rugged(x) for x in state.trial[:n]]
        state.trial_costs[:n] = told
        tell(state, n)
        size = int(state.now[names.SIZE])
        assert size == pytest.approx(60.0 - 54.0 * spent(state) / 2_000.0, abs=0.5)
        now = np.sort(state.costs[:size])
        assert now[0] == min(min(told), before[0])
        assert (now <= before[:size]).all()
        assert (state.costs[state.order[:size]] == now).all()
        assert all(rugged(state.population[k]) == state.costs[k] for k in range(size))
        assert state.now[names.KEPT] <= size
    assert size == 6
    assert spent(state) == 2_000


@few
@given(seed=st.integers(0, 10**6), evaluations=st.integers(30, 500))
def test_a_search_told_infinity_above_its_bounds_is_the_same_search(
    seed: int, evaluations: int
) -> None:
    whole, short = (search(evaluations, seed, stops_early=early) for early in (False, True))
    for a, b in zip(ranked(whole), ranked(short), strict=True):
        assert a.tobytes() == b.tobytes()
    assert (whole.population == short.population).all()
