"""A swarm against the equations of motion, particle by particle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.paper.swarm import ParticleSwarm

FloatArray = NDArray[np.float64]
NP, D = 6, 3
CHI = 0.7298437881283576  # the root for phi = 4.1, to all digits


@given(seed=st.integers(0, 10**6))
def test_every_particle_moves_by_the_equations_of_clerc_and_kennedy(seed: int) -> None:
    swarm = ParticleSwarm(D, 0, np.random.default_rng(seed), members=NP)
    draws = np.random.default_rng(seed)  # the same numbers, drawn by hand
    costs_of = np.random.default_rng(seed + 1)
    x = draws.random((NP, D))
    v = np.zeros((NP, D))
    own, own_costs = x.copy(), np.full(NP, np.inf)
    for generation in range(6):
        assert swarm.ask() == pytest.approx(x, abs=1e-12)
        costs = costs_of.random(NP)
        swarm.tell(costs)
        for i in range(NP):
            if costs[i] <= own_costs[i]:
                own[i], own_costs[i] = x[i], costs[i]
        assert swarm.costs == pytest.approx(own_costs)
        assert swarm.population == pytest.approx(own, abs=1e-12), generation
        best = own[own_costs.argmin()]
        u1, u2 = draws.random((NP, D)), draws.random((NP, D))
        for i in range(NP):
            for j in range(D):
                # chi (v + 2.05 u1 (own - x) + 2.05 u2 (best - x))
                pull = 2.05 * u1[i, j] * (own[i, j] - x[i, j])
                pull += 2.05 * u2[i, j] * (best[j] - x[i, j])
                speed = CHI * (v[i, j] + pull)
                v[i, j] = min(max(speed, -0.5), 0.5)
                free = x[i, j] + v[i, j]
                x[i, j] = min(max(free, 0.0), 1.0)
                if x[i, j] != free:
                    v[i, j] = 0.0
