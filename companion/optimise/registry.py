"""Every optimiser by the name under which a task asks for it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from companion.geodesy import FloatArray
from companion.optimise import differential_evolution as de
from companion.optimise import genetic, improved_de, particle_swarm, refined_de
from companion.optimise.loop import Optimiser

Maker = Callable[[int, int, np.random.Generator, FloatArray | None], Optimiser]
"""From dimensions, evaluations that will be spent, chance, and seeds (K, D) in the unit cube."""


def _improved_de(
    dimensions: int, evaluations: int, rng: np.random.Generator, seeds: FloatArray | None
) -> Optimiser:
    settings = improved_de.Settings()
    generations = evaluations // settings.population
    return improved_de.ImprovedDE(dimensions, generations, settings, rng, seeds)


def _refined_de(
    dimensions: int, evaluations: int, rng: np.random.Generator, seeds: FloatArray | None
) -> Optimiser:
    return refined_de.RefinedDE(dimensions, evaluations, refined_de.Settings(), rng, seeds)


def _classical(mutation: de.Mutation) -> Maker:
    def make(
        dimensions: int, _evaluations: int, rng: np.random.Generator, seeds: FloatArray | None
    ) -> Optimiser:
        return de.ClassicalDE(dimensions, de.Settings(mutation=mutation), rng, seeds)

    return make


def _particle_swarm(
    dimensions: int, _evaluations: int, rng: np.random.Generator, seeds: FloatArray | None
) -> Optimiser:
    return particle_swarm.ParticleSwarm(dimensions, particle_swarm.Settings(), rng, seeds)


def _genetic(
    dimensions: int, _evaluations: int, rng: np.random.Generator, seeds: FloatArray | None
) -> Optimiser:
    return genetic.Genetic(dimensions, genetic.Settings(), rng, seeds)


OPTIMISERS: dict[str, Maker] = {
    "improved-de": _improved_de,
    "refined-de": _refined_de,
    "de/rand/1/bin": _classical(de.RAND_1),
    "de/best/1": _classical(de.BEST_1),
    "de/best/2": _classical(de.BEST_2),
    "de/current-to-best/1": _classical(de.CURRENT_TO_BEST_1),
    "de/rand-to-best/1": _classical(de.RAND_TO_BEST_1),
    "pso": _particle_swarm,
    "ga": _genetic,
}


@contextmanager
def lent(make: Maker) -> Iterator[str]:
    """One more optimiser as long as it is needed: -> the name under which a task asks for it."""
    name = f"own {id(make):x}"
    OPTIMISERS[name] = make
    try:
        yield name
    finally:
        OPTIMISERS.pop(name, None)
