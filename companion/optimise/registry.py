"""Every optimiser by the name under which a task asks for it.

Other distributions add theirs by an entry point `companion.optimisers`.
"""

from collections.abc import Callable

import numpy as np

from companion.entry_points import Parts
from companion.geodesy import FloatArray
from companion.optimise.loop import Optimiser

Maker = Callable[[int, int, np.random.Generator, FloatArray | None], Optimiser]
"""From dimensions, evaluation budget, random generator, and seeds (K, D) in the unit cube."""


def _wrong_with(make: Maker) -> str | None:
    """What is not as an `Optimiser` must be; None: nothing."""
    if not callable(make):
        return "it cannot be called"
    made, dimensions = make(3, 60, np.random.default_rng(0), None), 3
    for name in ("ask", "tell", "population", "costs"):
        if not hasattr(made, name):
            return f"what it makes has no {name}"
    asked = np.asarray(made.ask())
    if asked.ndim != 2 or asked.shape[1] != dimensions:
        return f"ask() gives the shape {asked.shape}, not (P, {dimensions})"
    return None


OPTIMISERS = Parts[Maker](
    "companion.optimisers",
    {
        "improved-de": "companion.paper.optimisers:ImprovedDE",
        "refined-de": "companion.optimise.refined_de:RefinedDE",
        "de/rand/1/bin": "companion.paper.optimisers:ClassicalDE",
        "pso": "companion.paper.optimisers:ParticleSwarm",
        "ga": "companion.paper.optimisers:Genetic",
    },
    what="optimiser",
    check=_wrong_with,
)
"""Each is loaded when it is asked for: who flies never meets the paper's."""
