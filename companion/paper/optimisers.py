"""The optimisers of Table 1: classical and improved DE, PSO and GA (paper 3 and 4.2).

Where the paper gives no operator or parameter, it is the usual one:

- DE/rand/1/bin: F = 0.5, Cr = 0.9 (Storn and Price, J. Global Optimization 11 (1997)); mutants
  beyond the unit cube are clipped to it (row 30);
- PSO: constriction chi = 0.7298 with c1 = c2 = 2.05 chi (Clerc and Kennedy, IEEE Trans.
  Evolutionary Computation 6 (2002)), speeds limited to half the range (Eberhart and Shi, CEC 2000),
  from rest (Engelbrecht, CEC 2012); at a bound a particle stops in that variable (Robinson and
  Rahmat-Samii, IEEE Trans. Antennas and Propagation 52 (2004));
- GA: binary tournaments, simulated binary crossover (Deb and Agrawal, Complex Systems 9 (1995)),
  polynomial mutation of one variable in D (Deb and Goyal, Computer Science and Informatics 26
  (1996)), and the best member kept.
"""

import math
from abc import ABC, abstractmethod
from typing import final

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from companion.geodesy import FloatArray
from companion.optimise.loop import first_members

_F, _CR = 0.5, 0.9  # of the classical DE
_SPREAD = 0.2  # standard deviation of a and Cr (3.2)
_PHI = 2.05  # of each of the two pulls on a particle (Clerc and Kennedy)
_CHI = 2.0 / (2.0 * _PHI - 2.0 + math.sqrt(4.0 * _PHI**2 - 8.0 * _PHI))  # 0.7298
_FASTEST = 0.5  # greatest step of a particle in one variable, in the unit cube


class Generations(ABC):
    """An optimiser that asks for a whole generation at a time, the first one seeds and chance."""

    members = 60  # NP (4.1); the paper gives it for its improved DE alone

    def __init__(
        self, dimensions: int, evaluations: int, rng: Generator, seeds: FloatArray | None = None
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

    @property
    def _best(self) -> FloatArray:
        return self.population[np.argmin(self.costs)]


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
        return a * x_1 + (1 - a) * self._best + f1 * (self._best - x_1) + f2 * (x_2 - x_3)

    def crossed(self, mutants: FloatArray, cr: FloatArray | float) -> FloatArray:
        """Eq. 13: each variable from the mutant with probability Cr, one for certain.

        (NP, D), Cr of all or of each member (NP, 1) -> (NP, D).
        """
        size, dimensions = mutants.shape
        take = self._rng.random(mutants.shape) <= cr
        take[np.arange(size), self._rng.integers(dimensions, size=size)] = True
        return np.where(take, mutants, self.population)


def three_others(size: int, rng: Generator) -> npt.NDArray[np.intp]:
    """Three members for each of so many, distinct and not itself: r1, r2, r3.  -> (3, size)."""
    keys = rng.random((size, size))
    np.fill_diagonal(keys, np.inf)
    return np.argpartition(keys, 3, axis=1)[:, :3].T


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

    _generation = 0  # g of eq. 18 (row 29)
    _a_mean, _cr_mean = 1.0, 0.5
    _a = _cr = np.empty((0, 1))  # of each trial

    def _next(self) -> FloatArray:
        """Eq. 17: eq. 15 with F1 = k1 (1 - a), F2 = k2 a (eq. 16).

        k1 rises from 0 to 0.5, k2 falls from 1 to 0.5 (eq. 18; row 2).
        """
        progress = (self._generation / max(self._evaluations // self.members, 1)) ** 2
        k1, k2 = 0.5 * progress, 1.0 - 0.5 * progress
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


@final
class ParticleSwarm(Generations):
    """Particles that remember where each, and where all together, found the least cost.

    `population` and `costs` are the best places of the particles, not where they are now.
    """

    _velocity: FloatArray | float = 0.0

    def _next(self) -> FloatArray:
        """Where the particles go next."""
        x, pull = self._asked, _PHI * _CHI
        velocity = (
            _CHI * self._velocity
            + pull * self._rng.random(x.shape) * (self.population - x)
            + pull * self._rng.random(x.shape) * (self._best - x)
        )
        velocity = np.clip(velocity, -_FASTEST, _FASTEST)
        moved = np.clip(x + velocity, 0.0, 1.0)
        self._velocity = np.where(moved == x + velocity, velocity, 0.0)
        return moved


@final
class Genetic(Generations):
    """Generations of children; the best member so far takes the place of the worst child."""

    crossover = 0.9  # probability that a pair of parents is crossed
    crossover_index = 15.0  # the larger, the more like their parents children are
    mutation_index = 20.0  # the larger, the smaller the steps of mutations

    def _next(self) -> FloatArray:
        # the winners of binary tournaments
        size, dimensions = self.population.shape
        first, second = self._rng.integers(size, size=(2, size))
        winners = np.where(self.costs[first] <= self.costs[second], first, second)
        # simulated binary crossover of each half with the other
        one, two = np.split(self.population[winners], 2)
        u, power = self._rng.random(one.shape), 1.0 / (self.crossover_index + 1.0)
        spread = np.where(u <= 0.5, (2.0 * u) ** power, (2.0 * (1.0 - u)) ** -power)
        crossed = self._rng.random((len(one), 1)) < self.crossover
        spread = np.where(crossed & (self._rng.random(one.shape) < 0.5), spread, 1.0)
        middle, half = 0.5 * (one + two), 0.5 * spread * (one - two)
        children = np.concatenate([middle + half, middle - half])
        # polynomial mutation of each variable with probability 1 / D
        u, power = self._rng.random(children.shape), 1.0 / (self.mutation_index + 1.0)
        step = np.where(u < 0.5, (2.0 * u) ** power - 1.0, 1.0 - (2.0 * (1.0 - u)) ** power)
        chosen = self._rng.random(children.shape) < 1.0 / dimensions
        return np.where(chosen, children + step, children)

    def _learn(self, costs: FloatArray) -> None:
        """Children take over from the parents, but for the best of them."""
        best, worst = np.argmin(self.costs), np.argmax(costs)
        members, costs = self._asked.copy(), costs.copy()
        if self.costs[best] < costs.min():
            members[worst], costs[worst] = self.population[best], self.costs[best]
        self.population, self.costs = members, costs
