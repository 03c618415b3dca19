"""The paper's improved differential evolution (3.2, eq. 13-18)."""

from dataclasses import dataclass
from typing import final

import numpy as np

from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.optimise.differential_evolution import (
    blend,
    check_population,
    crossed,
    distinct_others,
    survivors,
)
from companion.optimise.loop import first_members

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

    def __post_init__(self) -> None:
        check_population(self.population, 3)
        for name, ends in (("k1", self.k1), ("k2", self.k2)):
            if not all(0.0 <= end <= 2.0 for end in ends):
                raise InputError(name, ends, "it scales differences", "Set both from 0 to 2.")


@final
class ImprovedDE:
    """Mutation between a random member and the best (eq. 17), with adaptive a and Cr.

    ask() gives a generation of candidates, tell() their costs.  a and Cr are clipped to [0, 1],
    Cr starts about 0.5, and the means stay when no trial succeeded (part A, row 4).
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
        self._trial = first_members(settings.population, dimensions, rng, seeds)
        self._a = self._cr = np.empty(0)
        self.population: FloatArray = np.empty((0, dimensions))
        self.costs: FloatArray = np.empty(0)

    def ask(self) -> FloatArray:
        """The candidates to evaluate next.  -> (NP, D) in the unit cube."""
        size = len(self.population)
        if size:
            mutant = self._mutate()
            self._cr = np.clip(self._rng.normal(self._cr_mean, _SPREAD, size), 0.0, 1.0)
            self._trial = crossed(self.population, mutant, self._cr, self._rng)
        return self._trial

    def tell(self, costs: FloatArray) -> None:
        """Select (eq. 14) and adapt a and Cr.  costs of the last ask(): (NP,)."""
        if not len(self.population):
            self.population, self.costs = self._trial.copy(), costs.copy()
            return
        self.population, self.costs, better = survivors(
            self.population, self.costs, self._trial, costs
        )
        if better.any():
            self._a_mean = float(self._a[better].mean())
            self._cr_mean = float(self._cr[better].mean())
        self._generation += 1

    def _mutate(self) -> FloatArray:
        """Eq. 17: eq. 15 with F1 = k1 (1 - a), F2 = k2 a (eq. 16) and k1, k2 of eq. 18."""
        size = len(self.population)
        progress = (self._generation / self._generations) ** 2
        k1 = self._settings.k1[0] + (self._settings.k1[1] - self._settings.k1[0]) * progress
        k2 = self._settings.k2[0] + (self._settings.k2[1] - self._settings.k2[0]) * progress
        self._a = np.clip(self._rng.normal(self._a_mean, _SPREAD, size), 0.0, 1.0)
        a = self._a[:, None]
        x_1, x_2, x_3 = (self.population[r] for r in distinct_others(size, 3, self._rng))
        best = self.population[np.argmin(self.costs)]
        mutant = blend(x_1, x_2, x_3, best, a, k1 * (1 - a), k2 * a)
        return np.clip(mutant, 0.0, 1.0)
