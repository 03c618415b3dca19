"""The paper's operators, recognised in the candidates whatever was drawn.

`Dice` stands in for the random generator: a and Cr are what the test says, everything else is
random.  A trial is then compared with eq. 17 for every triple of members that could have been
drawn.
"""

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.paper.evolution import MEMBERS, ImprovedDE

FloatArray = NDArray[np.float64]

NP, D = 7, 3
INNER = (0.4, 0.6)  # members so near the middle that mutants are not clipped


class Dice:
    """A generator whose normal deviates are scripted: a first or second told by their mean."""

    def __init__(self, seed: int, a: FloatArray | float, cr: FloatArray | float) -> None:
        self.rng = np.random.default_rng(seed)
        self.a, self.cr = a, cr
        self.asked: list[tuple[float, float]] = []

    def normal(self, mean: float, spread: float, size: int) -> FloatArray:
        is_a = len(self.asked) % 2 == 0
        self.asked.append((mean, spread))
        return np.broadcast_to(np.asarray(self.a if is_a else self.cr, dtype=float), size).copy()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rng, name)


def started(
    dice: Dice, generations: int = 10, seed: int = 0, **factors: tuple[float, float]
) -> tuple[ImprovedDE, FloatArray, FloatArray]:
    """An optimiser with a population and costs, and both."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(*INNER, (NP, D))
    de = ImprovedDE(
        D,
        generations * NP,
        dice,  # type: ignore[arg-type]
        seeds=x,
        members=NP,
    )
    for name, ends in factors.items():
        assert hasattr(de, name)
        setattr(de, name, ends)
    assert (de.ask() == x).all()
    costs = rng.random(NP)
    de.tell(costs)
    return de, x, costs


def is_eq_17(
    trial: FloatArray, x: FloatArray, best: FloatArray, i: int, a: float, k1: float, k2: float
) -> bool:
    """Whether some r1, r2, r3, distinct and not i, make this trial."""
    for r1, r2, r3 in itertools.permutations([r for r in range(len(x)) if r != i], 3):
        mutant = [
            a * x[r1][j]
            + (1 - a) * best[j]
            + k1 * (1 - a) * (best[j] - x[r1][j])
            + k2 * a * (x[r2][j] - x[r3][j])
            for j in range(D)
        ]
        clipped = [min(max(v, 0.0), 1.0) for v in mutant]
        if np.allclose(trial, clipped, rtol=0.0, atol=1e-12):
            return True
    return False


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10**6),
    a=st.floats(0.0, 1.0),
    k1=st.floats(0.0, 1.0),
    k2=st.floats(0.0, 1.0),
)
def test_every_mutant_is_equation_17_of_three_other_members(
    seed: int, a: float, k1: float, k2: float
) -> None:
    dice = Dice(seed, a, 1.0)  # Cr = 1: the trial is the mutant
    de, x, costs = started(dice, seed=seed, k1=(k1, k1), k2=(k2, k2))
    best = x[costs.argmin()]
    for i, trial in enumerate(de.ask()):
        assert is_eq_17(trial, x, best, i, a, k1, k2)


def test_a_beyond_0_and_1_is_clipped() -> None:
    low, x, costs = started(Dice(1, -0.3, 1.0), k1=(0.0, 0.0))
    assert low.ask() == pytest.approx(np.tile(x[costs.argmin()], (NP, 1)))
    high, x, costs = started(Dice(1, 1.4, 1.0), k2=(0.7, 0.7))
    for i, trial in enumerate(high.ask()):
        assert is_eq_17(trial, x, x[costs.argmin()], i, 1.0, 0.0, 0.7)


@pytest.mark.parametrize("generation", [0, 1, 4, 9])
def test_k1_rises_and_k2_falls_with_the_square_of_the_generation(generation: int) -> None:
    """Eq. 18, with the paper's ranges: k1 from 0 to 0.5, k2 from 1 to 0.5."""
    de, x, costs = started(Dice(3, 0.5, 1.0), generations=10)
    for _ in range(generation):
        de.ask()
        de.tell(np.full(NP, np.inf))  # nothing succeeds: the members stay
    square = (generation / 10.0) ** 2
    k1, k2 = 0.0 + 0.5 * square, 1.0 - 0.5 * square
    best = x[costs.argmin()]
    for i, trial in enumerate(de.ask()):
        assert is_eq_17(trial, x, best, i, 0.5, k1, k2)


def test_a_starts_about_1_and_cr_about_a_half_with_deviation_a_fifth() -> None:
    dice = Dice(1, 0.5, 0.5)
    de, _, _ = started(dice)
    de.ask()
    assert dice.asked == [(1.0, 0.2), (0.5, 0.2)]


def test_the_means_of_a_and_cr_become_those_of_the_trials_that_succeeded() -> None:
    a = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
    cr = np.array([0.9, 0.1, 0.8, 0.2, 0.7, 0.3, 0.6])
    dice = Dice(1, a, cr)
    de, _, costs = started(dice)
    de.ask()
    succeeded = np.array([True, False, True, False, False, True, False])
    de.tell(np.where(succeeded, costs - 1.0, costs + 1.0))
    de.ask()
    assert dice.asked[2][0] == pytest.approx((0.1 + 0.3 + 0.6) / 3)
    assert dice.asked[3][0] == pytest.approx((0.9 + 0.8 + 0.3) / 3)


def test_the_means_stay_when_no_trial_succeeded() -> None:
    dice = Dice(1, 0.3, 0.9)
    de, _, costs = started(dice)
    de.ask()
    de.tell(costs + 1.0)
    de.ask()
    assert dice.asked[2:] == [(1.0, 0.2), (0.5, 0.2)]


def test_the_parameters_are_the_papers() -> None:
    assert (MEMBERS, ImprovedDE.k1, ImprovedDE.k2) == (60, (0.0, 0.5), (1.0, 0.5))
