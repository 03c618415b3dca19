"""A genetic algorithm of real numbers: one of the paper's rivals (4.2).

The paper gives no operators.  These are the usual ones: binary tournaments, simulated binary
crossover (Deb and Agrawal, Complex Systems 9 (1995)), polynomial mutation of one variable in D
(Deb and Goyal, Computer Science and Informatics 26 (1996)), and the best member kept.
"""

from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.paper.evolution import Generations


@final
class Genetic(Generations):
    """Generations of children; the best member so far takes the place of the worst child."""

    crossover = 0.9
    """Probability that a pair of parents is crossed."""
    crossover_index = 15.0
    """Distribution index of the crossover: the larger, the more like their parents children are."""
    mutation_index = 20.0
    """Distribution index of the mutation: the larger, the smaller its steps."""

    def _next(self) -> FloatArray:
        return self._mutated(self._crossed(self._parents()))

    def _learn(self, costs: FloatArray) -> None:
        """Children take over from the parents, but for the best of them."""
        members, costs = self._asked.copy(), costs.copy()
        best, worst = np.argmin(self.costs), np.argmax(costs)
        if self.costs[best] < costs.min():
            members[worst], costs[worst] = self.population[best], self.costs[best]
        self.population, self.costs = members, costs

    def _parents(self) -> FloatArray:
        """The winners of binary tournaments.  -> (NP, D)."""
        size = len(self.population)
        first, second = self._rng.integers(size, size=(2, size))
        return self.population[np.where(self.costs[first] <= self.costs[second], first, second)]

    def _crossed(self, parents: FloatArray) -> FloatArray:
        """Simulated binary crossover of each half with the other.  (NP, D) -> (NP, D)."""
        one, two = np.split(parents, 2)
        u = self._rng.random(one.shape)
        power = 1.0 / (self.crossover_index + 1.0)
        spread = np.where(u <= 0.5, (2.0 * u) ** power, (2.0 * (1.0 - u)) ** -power)
        crossed = self._rng.random((len(one), 1)) < self.crossover
        spread = np.where(crossed & (self._rng.random(one.shape) < 0.5), spread, 1.0)
        middle, half = 0.5 * (one + two), 0.5 * spread * (one - two)
        return np.concatenate([middle + half, middle - half])

    def _mutated(self, children: FloatArray) -> FloatArray:
        """Polynomial mutation, each variable with probability 1 / D.  (NP, D) -> (NP, D)."""
        u = self._rng.random(children.shape)
        power = 1.0 / (self.mutation_index + 1.0)
        step = np.where(u < 0.5, (2.0 * u) ** power - 1.0, 1.0 - (2.0 * (1.0 - u)) ** power)
        chosen = self._rng.random(children.shape) < 1.0 / children.shape[1]
        return np.where(chosen, children + step, children)
