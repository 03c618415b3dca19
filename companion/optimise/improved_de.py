"""The paper's improved differential evolution (3.2, eq. 13-18)."""

from dataclasses import dataclass
from typing import final

import numpy as np

from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.optimise.differential_evolution import blend, crossed, distinct_others
from companion.optimise.loop import Generations, check_population

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
class ImprovedDE(Generations[Settings]):
    """Mutation between a random member and the best (eq. 17), with adaptive a and Cr.

    a and Cr are clipped to [0, 1], Cr starts about 0.5, and the means stay when no trial succeeded
    (part A, row 4).
    """

    _usual = Settings
    _generation = 0
    _a_mean, _cr_mean = 1.0, 0.5
    _a = _cr = np.empty(0)

    def _next(self) -> FloatArray:
        """Eq. 17: eq. 15 with F1 = k1 (1 - a), F2 = k2 a (eq. 16) and k1, k2 of eq. 18."""
        x, size, settings = self.population, len(self.population), self._settings
        generations = max(self._evaluations // size, 1)
        progress = (self._generation / generations) ** 2
        k1, k2 = (k[0] + (k[1] - k[0]) * progress for k in (settings.k1, settings.k2))
        self._a = np.clip(self._rng.normal(self._a_mean, _SPREAD, size), 0.0, 1.0)
        a = self._a[:, None]
        others = [x[r] for r in distinct_others(size, 3, self._rng)]
        best = x[np.argmin(self.costs)]
        mutant = np.clip(blend(others, best, a, k1 * (1 - a), k2 * a), 0.0, 1.0)
        self._cr = np.clip(self._rng.normal(self._cr_mean, _SPREAD, size), 0.0, 1.0)
        return crossed(x, mutant, self._cr, self._rng)

    def _learn(self, costs: FloatArray) -> None:
        better = self._keep_better(costs)
        if better.any():
            self._a_mean = float(self._a[better].mean())
            self._cr_mean = float(self._cr[better].mean())
        self._generation += 1
