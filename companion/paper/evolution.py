"""Differential evolution: DE/rand/1/bin (paper 3.1, eq. 12-14) and the improved DE (3.2).

F and Cr of DE/rand/1/bin are constant; the paper does not give them, so they are those of Storn and
Price, Differential Evolution, J. Global Optimization 11 (1997): F = 0.5, Cr = 0.9.  Mutants beyond
the unit cube are clipped to it (row 30).
"""

import math
from abc import ABC, abstractmethod
from typing import ClassVar, final

import numpy as np
import numpy.typing as npt

from companion.errors import InputError
from companion.geodesy import BoolArray, FloatArray
from companion.optimise.loop import first_members

Indices = npt.NDArray[np.intp]
MEMBERS = 60  # NP (4.1); the paper gives it for its improved DE, the rivals have as many here
_F, _CR = 0.5, 0.9
_SPREAD = 0.2  # standard deviation of a and Cr (3.2)


class Generations(ABC):
    """An optimiser that asks for a whole generation at a time, the first one seeds and chance.

    `population` and `costs` are its members; before the first tell() there are none.
    """

    fewest: ClassVar[int] = 1
    """Members that it needs, of which it has a multiple of `multiple`."""
    multiple: ClassVar[int] = 1

    def __init__(
        self,
        dimensions: int,
        evaluations: int,
        rng: np.random.Generator,
        seeds: FloatArray | None = None,
        members: int = MEMBERS,
    ) -> None:
        """evaluations: the budget; seeds: candidates to start from, (K, D) in the unit cube."""
        if members < self.fewest or members % self.multiple:
            rule = f"it takes {self.fewest} or more, in steps of {self.multiple}"
            raise InputError("members", members, rule, f"Set it to {MEMBERS}.")
        self._evaluations, self._rng = evaluations, rng
        self._asked = first_members(members, dimensions, rng, seeds)
        self.population: FloatArray = np.empty((0, dimensions))
        self.costs: FloatArray = np.empty(0)

    def ask(self) -> FloatArray:
        """The candidates to evaluate next.  -> (NP, D) in the unit cube."""
        if len(self.population):
            self._asked = np.clip(self._next(), 0.0, 1.0)
        return self._asked

    def tell(self, costs: FloatArray) -> None:
        """The costs of the candidates of the last ask(): (NP,)."""
        if len(self.population):
            self._learn(costs)
        else:
            self.population, self.costs = self._asked.copy(), costs.copy()

    @abstractmethod
    def _next(self) -> FloatArray:
        """The generation after the first.  -> (NP, D)."""

    def _learn(self, costs: FloatArray) -> None:
        """What becomes of the members."""
        self._keep_better(costs)

    def _keep_better(self, costs: FloatArray) -> BoolArray:
        """Eq. 14: of member and candidate the better, the candidate if equal.  -> which, (NP,)."""
        better = costs <= self.costs
        self.population = np.where(better[:, None], self._asked, self.population)
        self.costs = np.where(better, costs, self.costs)
        return better


@final
class ClassicalDE(Generations):
    """DE/rand/1 (eq. 12) with constant parameters and binomial crossover."""

    fewest = 4

    def _next(self) -> FloatArray:
        mutants = blend(self.population, self.costs, 1.0, 0.0, _F, self._rng)
        return crossed(self.population, mutants, np.full(len(mutants), _CR), self._rng)


@final
class ImprovedDE(Generations):
    """Mutation between a random member and the best (eq. 17), with adaptive a and Cr.

    a and Cr are clipped to [0, 1], Cr starts about 0.5, and the means stay when no trial succeeded
    (row 4).
    """

    fewest = 4
    k1, k2 = (0.0, 0.5), (1.0, 0.5)
    """From the first to the second value (eq. 18; row 2); g counts from 0 (row 29)."""
    _generation = 0
    _a_mean, _cr_mean = 1.0, 0.5
    _a = _cr = np.empty(0)

    def _next(self) -> FloatArray:
        """Eq. 17: eq. 15 with F1 = k1 (1 - a), F2 = k2 a (eq. 16) and k1, k2 of eq. 18."""
        size = len(self.population)
        progress = (self._generation / max(self._evaluations // size, 1)) ** 2
        k1, k2 = (k[0] + (k[1] - k[0]) * progress for k in (self.k1, self.k2))
        self._a = np.clip(self._rng.normal(self._a_mean, _SPREAD, size), 0.0, 1.0)
        a = self._a[:, None]
        mutants = blend(self.population, self.costs, a, k1 * (1 - a), k2 * a, self._rng)
        self._cr = np.clip(self._rng.normal(self._cr_mean, _SPREAD, size), 0.0, 1.0)
        return crossed(self.population, mutants, self._cr, self._rng)

    def _learn(self, costs: FloatArray) -> None:
        better = self._keep_better(costs)
        if better.any():
            self._a_mean = float(self._a[better].mean())
            self._cr_mean = float(self._cr[better].mean())
        self._generation += 1


def blend(
    members: FloatArray,
    costs: FloatArray,
    a: FloatArray | float,
    f1: FloatArray | float,
    f2: FloatArray | float,
    rng: np.random.Generator,
) -> FloatArray:
    """Eq. 15: a x_r1 + (1 - a) x_best + F1 (x_best - x_r1) + F2 (x_r2 - x_r3).

    a = 1, F1 = 0 is DE/rand/1 (eq. 12); a = 0, F1 = 0 is DE/best/1; a = 1, F1 > 0 is
    DE/rand-to-best/1.  x_host is read as x_best (row 1).
    (NP, D), (NP,), (NP, 1) or scalar x3 -> (NP, D).
    """
    x_1, x_2, x_3 = (members[r] for r in distinct_others(len(members), 3, rng))
    best = members[np.argmin(costs)]
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
