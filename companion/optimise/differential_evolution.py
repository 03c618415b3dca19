"""Classical differential evolution (paper 3.1, eq. 12-14) and the general mutation of eq. 15.

F and Cr are constant; the paper does not give them, so they are those of Storn and Price,
Differential Evolution, J. Global Optimization 11 (1997): F = 0.5, Cr = 0.9.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
import numpy.typing as npt

from companion.geodesy import FloatArray
from companion.optimise.loop import Generations, check_population

Indices = npt.NDArray[np.intp]
_F, _CR = 0.5, 0.9


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Classical DE's parameters."""

    population: int = 60
    """NP; as many as the paper gives its improved DE."""

    def __post_init__(self) -> None:
        check_population(self.population, 3)


@final
class ClassicalDE(Generations[Settings]):
    """DE/rand/1 (eq. 12) with constant parameters and binomial crossover."""

    _usual = Settings

    def _next(self) -> FloatArray:
        x = self.population
        others = [x[r] for r in distinct_others(len(x), 3, self._rng)]
        best = x[np.argmin(self.costs)]
        mutant = np.clip(blend(others, best, 1.0, 0.0, _F), 0.0, 1.0)
        return crossed(x, mutant, np.full(len(x), _CR), self._rng)


# --- what all differential evolutions share


def blend(
    others: list[FloatArray],
    best: FloatArray,
    a: FloatArray | float,
    f1: FloatArray | float,
    f2: FloatArray | float,
) -> FloatArray:
    """Eq. 15: a x_r1 + (1 - a) x_best + F1 (x_best - x_r1) + F2 (x_r2 - x_r3).

    a = 1, F1 = 0 is DE/rand/1 (eq. 12); a = 0, F1 = 0 is DE/best/1; a = 1, F1 > 0 is
    DE/rand-to-best/1.  x_host is read as x_best (part A, row 1).
    3 x (NP, D), (D,), (NP, 1) or scalar x3 -> (NP, D).
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
