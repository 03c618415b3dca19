"""Particle swarm optimisation with a global best: one of the paper's rivals (4.2).

The paper gives no parameters.  These are the standard ones: constriction chi = 0.7298 with
c1 = c2 = 2.05 chi (Clerc and Kennedy, IEEE Trans. Evolutionary Computation 6 (2002)), speeds
limited to half the range (Eberhart and Shi, CEC 2000), from rest (Engelbrecht, CEC 2012); at a
bound a particle stops in that variable (Robinson and Rahmat-Samii, IEEE Trans. Antennas and
Propagation 52 (2004)).
"""

import math
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.paper.evolution import Generations

_PHI = 2.05
_CHI = 2.0 / (2.0 * _PHI - 2.0 + math.sqrt(4.0 * _PHI**2 - 8.0 * _PHI))  # 0.7298
_FASTEST = 0.5  # greatest step in one variable, in the unit cube


@final
class ParticleSwarm(Generations):
    """Particles that remember where each, and where all together, found the least cost.

    `population` and `costs` are the best places of the particles, not where they are now.
    """

    _velocity: FloatArray | float = 0.0

    def _next(self) -> FloatArray:
        """Where the particles go next."""
        x, pull = self._asked, _PHI * _CHI
        best = self.population[np.argmin(self.costs)]
        velocity = (
            _CHI * self._velocity
            + pull * self._rng.random(x.shape) * (self.population - x)
            + pull * self._rng.random(x.shape) * (best - x)
        )
        velocity = np.clip(velocity, -_FASTEST, _FASTEST)
        free = x + velocity
        moved = np.clip(free, 0.0, 1.0)
        self._velocity = np.where(moved == free, velocity, 0.0)
        return moved
