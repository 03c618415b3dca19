"""The paper's improved differential evolution (3.2, eq. 13-18)."""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
import numpy.typing as npt

from companion.geodesy import FloatArray

_SPREAD = 0.2  # standard deviation of a and Cr (3.2)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The improved DE's parameters; defaults are the paper's (4.1, misprints by part A, row 2)."""

    population: int = 60
    """NP."""
    k1: tuple[float, float] = (0.0, 0.5)
    """k1 rises from the first to the second value (eq. 18)."""
    k2: tuple[float, float] = (1.0, 0.5)
    """k2 falls from the first to the second value (eq. 18)."""


@final
class ImprovedDE:
    """Mutation between a random member and the best (eq. 17), with adaptive a and Cr.

    ask() gives a generation of candidates, tell() their costs.  x_host in eq. 15 is read as x_best
    (part A, row 1); a and Cr are clipped to [0, 1], Cr starts about 0.5, and the means
    stay when no trial succeeded (row 4).
    """

    def __init__(
        self,
        dimensions: int,
        generations: int,
        settings: Settings,
        rng: np.random.Generator,
        seeds: FloatArray | None = None,
    ) -> None:
        """generations: N of eq. 18; seeds: candidates to start from, (K, D) in the unit cube."""
        self._settings = settings
        self._generations = max(generations, 1)
        self._rng = rng
        self._generation = 0
        self._a_mean, self._cr_mean = 1.0, 0.5
        self._trial = rng.random((settings.population, dimensions))
        if seeds is not None:
            count = min(len(seeds), settings.population)
            self._trial[:count] = np.clip(seeds[:count], 0.0, 1.0)
        self._a = self._cr = np.empty(0)
        self.population: FloatArray = np.empty((0, dimensions))
        self.costs: FloatArray = np.empty(0)

    def ask(self) -> FloatArray:
        """The candidates to evaluate next.  -> (NP, D) in the unit cube."""
        if len(self.population):
            self._trial = self._crossover(self._mutate())
        return self._trial

    def tell(self, costs: FloatArray) -> None:
        """Select (eq. 14) and adapt a and Cr.  costs of the last ask(): (NP,)."""
        if not len(self.population):
            self.population, self.costs = self._trial.copy(), costs.copy()
            return
        better = costs <= self.costs
        self.population = np.where(better[:, None], self._trial, self.population)
        self.costs = np.where(better, costs, self.costs)
        if better.any():
            self._a_mean = float(self._a[better].mean())
            self._cr_mean = float(self._cr[better].mean())
        self._generation += 1

    def _mutate(self) -> FloatArray:
        """Eq. 17, with k1 and k2 of eq. 18."""
        size = len(self.population)
        progress = (self._generation / self._generations) ** 2
        k1 = self._settings.k1[0] + (self._settings.k1[1] - self._settings.k1[0]) * progress
        k2 = self._settings.k2[0] + (self._settings.k2[1] - self._settings.k2[0]) * progress
        self._a = np.clip(self._rng.normal(self._a_mean, _SPREAD, size), 0.0, 1.0)
        a = self._a[:, None]
        x_1, x_2, x_3 = (self.population[r] for r in distinct_others(size, 3, self._rng))
        best = self.population[np.argmin(self.costs)]
        mutant = a * x_1 + (1 - a) * best + k1 * (1 - a) * (best - x_1) + k2 * a * (x_2 - x_3)
        return np.clip(mutant, 0.0, 1.0)

    def _crossover(self, mutant: FloatArray) -> FloatArray:
        """Eq. 13, with a Cr of its own for each member."""
        size, dimensions = mutant.shape
        self._cr = np.clip(self._rng.normal(self._cr_mean, _SPREAD, size), 0.0, 1.0)
        take = self._rng.random((size, dimensions)) <= self._cr[:, None]
        take[np.arange(size), self._rng.integers(dimensions, size=size)] = True
        return np.where(take, mutant, self.population)


def distinct_others(size: int, count: int, rng: np.random.Generator) -> list[npt.NDArray[np.intp]]:
    """For each i of size members, count distinct members other than i.  -> count x (size,)."""
    keys = rng.random((size, size))
    np.fill_diagonal(keys, math.inf)
    order = np.argpartition(keys, count, axis=1)[:, :count]
    return [order[:, k] for k in range(count)]
