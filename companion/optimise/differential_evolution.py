"""Classical differential evolution (paper 3.1, eq. 12-14) and its general mutation (eq. 15).

F and Cr are constant; the paper does not give them, so they are those of Storn and Price,
Differential Evolution, J. Global Optimization 11 (1997): F = 0.5, Cr = 0.9.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np
import numpy.typing as npt

from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.optimise.loop import Generations, check_population

Indices = npt.NDArray[np.intp]
_F, _CR = 0.5, 0.9


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Mutation:
    """How mutants are made of the members of a generation."""

    others: int
    """How many members, distinct and not the target itself, each mutant is made of."""
    mutants: Callable[[FloatArray, FloatArray, list[FloatArray]], FloatArray]
    """One mutant for each member, of members, the best, and so many others of each.

    (NP, D), (D,), others x (NP, D) -> (NP, D)."""


def blended(a: float, f1: float, f2: float) -> Mutation:
    """Eq. 15: a base between a random member and the best, a pull to the best, a difference.

    a = 1, F1 = 0 is DE/rand/1 (eq. 12); a = 0, F1 = 0 is DE/best/1; a = 1, F1 > 0 is
    DE/rand-to-best/1.
    """
    return Mutation(others=3, mutants=lambda _, best, r: blend(r, best, a, f1, f2))


def best_two(f: float = _F) -> Mutation:
    """DE/best/2: the best member and two differences (Price et al. 2005, 2.6)."""
    return Mutation(
        others=4, mutants=lambda _, best, r: best + f * (r[0] - r[1]) + f * (r[2] - r[3])
    )


def current_to_best(f: float = _F) -> Mutation:
    """DE/current-to-best/1: from the member itself towards the best (Price et al. 2005, 2.6)."""
    return Mutation(others=2, mutants=lambda x, best, r: x + f * (best - x) + f * (r[0] - r[1]))


RAND_1 = blended(1.0, 0.0, _F)  # eq. 12
BEST_1 = blended(0.0, 0.0, _F)
RAND_TO_BEST_1 = blended(1.0, _F, _F)
BEST_2 = best_two()
CURRENT_TO_BEST_1 = current_to_best()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Classical DE's parameters."""

    population: int = 60
    """NP; as many as the paper gives its improved DE."""
    mutation: Mutation = RAND_1
    crossover: float = _CR
    """Cr, the probability with which a trial takes a variable from the mutant, 0 to 1."""

    def __post_init__(self) -> None:
        check_population(self.population, self.mutation.others)
        if not 0.0 <= self.crossover <= 1.0:
            rule = "it is a probability"
            raise InputError("crossover", self.crossover, rule, "Set it between 0 and 1.")


@final
class ClassicalDE(Generations[Settings]):
    """Differential evolution with constant parameters and binomial crossover."""

    _usual = Settings

    def _next(self) -> FloatArray:
        x, mutation = self.population, self._settings.mutation
        others = [x[r] for r in distinct_others(len(x), mutation.others, self._rng)]
        mutant = np.clip(mutation.mutants(x, x[np.argmin(self.costs)], others), 0.0, 1.0)
        return crossed(x, mutant, np.full(len(x), self._settings.crossover), self._rng)


# --- what all differential evolutions share


def blend(
    others: list[FloatArray],
    best: FloatArray,
    a: FloatArray | float,
    f1: FloatArray | float,
    f2: FloatArray | float,
) -> FloatArray:
    """Eq. 15: a x_r1 + (1 - a) x_best + F1 (x_best - x_r1) + F2 (x_r2 - x_r3).

    x_host is read as x_best (part A, row 1).  3 x (NP, D), (D,), (NP, 1) or scalar x3 -> (NP, D).
    """
    x_1, x_2, x_3 = others
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


def distinct_others(size: int, count: int, rng: np.random.Generator) -> list[Indices]:
    """For each i of size members, count distinct members other than i.  -> count x (size,)."""
    keys = rng.random((size, size))
    np.fill_diagonal(keys, math.inf)
    order = np.argpartition(keys, count, axis=1)[:, :count]
    return [order[:, k] for k in range(count)]
