"""Differential evolution: DE/rand/1/bin (paper 3.1, eq. 12-14) and the improved DE (3.2).

F and Cr of DE/rand/1/bin are constant; the paper does not give them, so they are those of Storn and
Price, Differential Evolution, J. Global Optimization 11 (1997): F = 0.5, Cr = 0.9.  Mutants beyond
the unit cube are clipped to it (row 30).
"""

from abc import ABC, abstractmethod
from typing import final

import numpy as np
import numpy.typing as npt

from companion.geodesy import FloatArray
from companion.optimise.loop import first_members

_F, _CR = 0.5, 0.9
_SPREAD = 0.2  # standard deviation of a and Cr (3.2)


class Generations(ABC):
    """An optimiser that asks for a whole generation at a time, the first one seeds and chance."""

    members = 60
    """NP (4.1); the paper gives it for its improved DE, the rivals have as many here."""

    def __init__(
        self,
        dimensions: int,
        evaluations: int,
        rng: np.random.Generator,
        seeds: FloatArray | None = None,
    ) -> None:
        """evaluations: the budget; seeds: candidates to start from, (K, D) in the unit cube."""
        self._evaluations, self._rng = evaluations, rng
        self._asked = first_members(self.members, dimensions, rng, seeds)
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
        """Eq. 14: of member and candidate the better stays, the candidate if they are equal."""
        better = costs <= self.costs
        self.population = np.where(better[:, None], self._asked, self.population)
        self.costs = np.where(better, costs, self.costs)


class DifferentialEvolution(Generations):
    """What both kinds share: the hybrid mutation and the binomial crossover."""

    def blend(
        self, a: FloatArray | float, f1: FloatArray | float, f2: FloatArray | float
    ) -> FloatArray:
        """Eq. 15: a x_r1 + (1 - a) x_best + F1 (x_best - x_r1) + F2 (x_r2 - x_r3).  -> (NP, D).

        a = 1, F1 = 0 is DE/rand/1 (eq. 12); a = 0, F1 = 0 is DE/best/1; a = 1, F1 > 0 is
        DE/rand-to-best/1.  x_host is read as x_best (row 1).  Scalars, or (NP, 1).
        """
        x_1, x_2, x_3 = self.population[three_others(self.members, self._rng)]
        best = self.population[np.argmin(self.costs)]
        return a * x_1 + (1 - a) * best + f1 * (best - x_1) + f2 * (x_2 - x_3)

    def crossed(self, mutants: FloatArray, cr: FloatArray | float) -> FloatArray:
        """Eq. 13: each variable from the mutant with probability Cr, one for certain.

        (NP, D), Cr of all or of each member (NP, 1) -> (NP, D).
        """
        size, dimensions = mutants.shape
        take = self._rng.random(mutants.shape) <= cr
        take[np.arange(size), self._rng.integers(dimensions, size=size)] = True
        return np.where(take, mutants, self.population)


@final
class ClassicalDE(DifferentialEvolution):
    """DE/rand/1 (eq. 12) with constant parameters and binomial crossover."""

    def _next(self) -> FloatArray:
        return self.crossed(self.blend(1.0, 0.0, _F), _CR)


@final
class ImprovedDE(DifferentialEvolution):
    """Mutation between a random member and the best (eq. 17), with adaptive a and Cr.

    a and Cr are clipped to [0, 1], Cr starts about 0.5, and the means stay when no trial succeeded
    (row 4).
    """

    k1, k2 = (0.0, 0.5), (1.0, 0.5)
    """From the first to the second value (eq. 18; row 2); g counts from 0 (row 29)."""
    _generation = 0
    _a_mean, _cr_mean = 1.0, 0.5
    _a = _cr = np.empty((0, 1))  # of each trial

    def _next(self) -> FloatArray:
        """Eq. 17: eq. 15 with F1 = k1 (1 - a), F2 = k2 a (eq. 16) and k1, k2 of eq. 18."""
        progress = (self._generation / max(self._evaluations // self.members, 1)) ** 2
        k1, k2 = (k[0] + (k[1] - k[0]) * progress for k in (self.k1, self.k2))
        self._a = a = self._drawn(self._a_mean)
        mutants = self.blend(a, k1 * (1 - a), k2 * a)
        self._cr = self._drawn(self._cr_mean)
        return self.crossed(mutants, self._cr)

    def _drawn(self, mean: float) -> FloatArray:
        """Values of a or of Cr, one for each trial.  -> (NP, 1)."""
        return np.clip(self._rng.normal(mean, _SPREAD, (self.members, 1)), 0.0, 1.0)

    def _learn(self, costs: FloatArray) -> None:
        better = costs <= self.costs
        if better.any():
            self._a_mean = float(self._a[better].mean())
            self._cr_mean = float(self._cr[better].mean())
        self._generation += 1
        super()._learn(costs)


def three_others(size: int, rng: np.random.Generator) -> npt.NDArray[np.intp]:
    """Three members for each of so many, distinct and not itself: r1, r2, r3.  -> (3, size)."""
    keys = rng.random((size, size))
    np.fill_diagonal(keys, np.inf)
    return np.argpartition(keys, 3, axis=1)[:, :3].T
