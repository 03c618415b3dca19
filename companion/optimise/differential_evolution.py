"""Classical differential evolution (paper 3.1, eq. 12-14) and its general mutation (eq. 15).

F and Cr are constant; the paper does not give them, so they are those of Storn and Price,
Differential Evolution, J. Global Optimization 11 (1997): F = 0.5, Cr = 0.9.
"""

import math
from dataclasses import dataclass, field
from typing import Protocol, final

import numpy as np
import numpy.typing as npt

from companion.errors import InputError
from companion.geodesy import BoolArray, FloatArray
from companion.optimise.loop import first_members

Indices = npt.NDArray[np.intp]
_F, _CR = 0.5, 0.9


class Mutation(Protocol):
    """How mutants are made of the members of a generation."""

    @property
    def others(self) -> int:
        """How many members, distinct and not the target itself, each mutant is made of."""

    def mutants(self, members: FloatArray, best: FloatArray, others: list[Indices]) -> FloatArray:
        """One mutant for each member.  (NP, D), (D,), others x (NP,) -> (NP, D)."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Blend:
    """Eq. 15: a base between a random member and the best, a pull to the best, a difference.

    a = 1, F1 = 0 is DE/rand/1 (eq. 12); a = 0, F1 = 0 is DE/best/1; a = 1, F1 > 0 is
    DE/rand-to-best/1.
    """

    a: float
    f1: float
    f2: float

    @property
    def others(self) -> int:
        """x_r1, x_r2, x_r3."""
        return 3

    def mutants(self, members: FloatArray, best: FloatArray, others: list[Indices]) -> FloatArray:
        """Eq. 15.  (NP, D), (D,), 3 x (NP,) -> (NP, D)."""
        x_1, x_2, x_3 = (members[r] for r in others)
        return blend(x_1, x_2, x_3, best, self.a, self.f1, self.f2)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BestTwo:
    """DE/best/2: the best member and two differences (Price et al. 2005, 2.6)."""

    f: float = _F

    @property
    def others(self) -> int:
        """x_r1 .. x_r4."""
        return 4

    def mutants(self, members: FloatArray, best: FloatArray, others: list[Indices]) -> FloatArray:
        """x_best + F (x_r1 - x_r2) + F (x_r3 - x_r4)."""
        x_1, x_2, x_3, x_4 = (members[r] for r in others)
        return best + self.f * (x_1 - x_2) + self.f * (x_3 - x_4)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CurrentToBest:
    """DE/current-to-best/1: from the member itself towards the best (Price et al. 2005, 2.6)."""

    f: float = _F

    @property
    def others(self) -> int:
        """x_r1, x_r2."""
        return 2

    def mutants(self, members: FloatArray, best: FloatArray, others: list[Indices]) -> FloatArray:
        """x_i + F (x_best - x_i) + F (x_r1 - x_r2)."""
        x_1, x_2 = (members[r] for r in others)
        return members + self.f * (best - members) + self.f * (x_1 - x_2)


RAND_1 = Blend(a=1.0, f1=0.0, f2=_F)  # eq. 12
BEST_1 = Blend(a=0.0, f1=0.0, f2=_F)
RAND_TO_BEST_1 = Blend(a=1.0, f1=_F, f2=_F)
BEST_2 = BestTwo()
CURRENT_TO_BEST_1 = CurrentToBest()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Classical DE's parameters."""

    population: int = 60
    """NP; as many as the paper gives its improved DE."""
    mutation: Mutation = field(default=RAND_1)
    crossover: float = _CR
    """Cr, the probability with which a trial takes a variable from the mutant, 0 to 1."""

    def __post_init__(self) -> None:
        check_population(self.population, self.mutation.others)
        if not 0.0 <= self.crossover <= 1.0:
            rule = "it is a probability"
            raise InputError("crossover", self.crossover, rule, "Set it between 0 and 1.")


@final
class ClassicalDE:
    """Differential evolution with constant parameters and binomial crossover."""

    def __init__(
        self,
        dimensions: int,
        settings: Settings,
        rng: np.random.Generator,
        seeds: FloatArray | None = None,
    ) -> None:
        """seeds: candidates to start from, (K, D) in the unit cube."""
        self._settings = settings
        self._rng = rng
        self._trial = first_members(settings.population, dimensions, rng, seeds)
        self.population: FloatArray = np.empty((0, dimensions))
        self.costs: FloatArray = np.empty(0)

    def ask(self) -> FloatArray:
        """The candidates to evaluate next.  -> (NP, D) in the unit cube."""
        size = len(self.population)
        if size:
            mutation = self._settings.mutation
            others = distinct_others(size, mutation.others, self._rng)
            best = self.population[np.argmin(self.costs)]
            mutant = np.clip(mutation.mutants(self.population, best, others), 0.0, 1.0)
            cr = np.full(size, self._settings.crossover)
            self._trial = crossed(self.population, mutant, cr, self._rng)
        return self._trial

    def tell(self, costs: FloatArray) -> None:
        """Select (eq. 14).  costs of the last ask(): (NP,)."""
        if len(self.population):
            self.population, self.costs, _ = survivors(
                self.population, self.costs, self._trial, costs
            )
        else:
            self.population, self.costs = self._trial.copy(), costs.copy()


# --- what all differential evolutions share


def blend(
    x_1: FloatArray,
    x_2: FloatArray,
    x_3: FloatArray,
    best: FloatArray,
    a: FloatArray | float,
    f1: FloatArray | float,
    f2: FloatArray | float,
) -> FloatArray:
    """Eq. 15: a x_r1 + (1 - a) x_best + F1 (x_best - x_r1) + F2 (x_r2 - x_r3).

    x_host is read as x_best (part A, row 1).  (NP, D) x3, (D,), (NP, 1) or scalar x3 -> (NP, D).
    """
    return a * x_1 + (1 - a) * best + f1 * (best - x_1) + f2 * (x_2 - x_3)


def crossed(
    members: FloatArray, mutants: FloatArray, cr: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Eq. 13, binomial: each variable from the mutant with probability Cr, one for certain.

    (NP, D) x2, Cr of each member (NP,) -> (NP, D).
    """
    size, dimensions = mutants.shape
    take = rng.random((size, dimensions)) <= cr[:, None]
    take[np.arange(size), rng.integers(dimensions, size=size)] = True
    return np.where(take, mutants, members)


def survivors(
    members: FloatArray, costs: FloatArray, trial: FloatArray, trial_costs: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Eq. 14: of member and trial the better, the trial if equal; and which trials these are."""
    better = trial_costs <= costs
    return (
        np.where(better[:, None], trial, members),
        np.where(better, trial_costs, costs),
        better,
    )


def distinct_others(size: int, count: int, rng: np.random.Generator) -> list[Indices]:
    """For each i of size members, count distinct members other than i.  -> count x (size,)."""
    keys = rng.random((size, size))
    np.fill_diagonal(keys, math.inf)
    order = np.argpartition(keys, count, axis=1)[:, :count]
    return [order[:, k] for k in range(count)]


def check_population(population: int, others: int) -> None:
    """Refuse a population in which a member does not have that many others (InputError)."""
    if population <= others:
        rule = f"a mutant needs {others} members besides its own"
        raise InputError("population", population, rule, f"Set it to {others + 1} or more.")
