"""What a plan calls compiled (`companion.jit`), and the name of the arithmetic that it gets."""

import hashlib
import math
from functools import cache

import numpy as np

from companion import objective
from companion.geodesy import FloatArray, LocalFrame
from companion.objective import Scene
from companion.optimise import refined_de
from companion.optimise.refined_de import State


@cache
def signature() -> str:
    """Names numba and the platform's arithmetic: equal names give equal plans to the last digit.

    The arithmetic is named by a digest of results of libm, numpy, OpenBLAS and PROJ.
    """
    x = np.linspace(0.1, 3.0, 1600)
    frame = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
    square = x.reshape(40, 40)
    results = [
        *(function(x) for function in (np.sin, np.cos, np.exp, np.log, np.arctan, np.hypot.reduce)),
        *(np.linalg.norm(square, axis=-1), square @ square, square @ x[:40], x**0.7),
        *([math.sin(v), math.exp(v), math.atan2(v, 0.7), v**0.7] for v in x[::16].tolist()),
        *(frame.to_local_m(47.0 + 0.1 * v, 8.0 - 0.1 * v) for v in x[::160].tolist()),
    ]
    data = b"".join(np.asarray(result, dtype=np.float64).tobytes() for result in results)
    return f"numba {hashlib.sha256(data).hexdigest()[:8]}"


def search(state: State, scene: Scene, until: int) -> None:
    """Go on with a search, one candidate after the other, until so many evaluations are spent."""
    while refined_de.spent(state) < until:
        n = refined_de.ask(state)
        for i in range(n):
            state.trial_costs[i] = objective.cost(state.trial[i], state.trial_bounds[i], scene)
        refined_de.tell(state, n)


def costs(x: FloatArray, scene: Scene) -> FloatArray:
    """Costs of a population, (P, D) -> (P,): for optimisers that ask and tell.

    The terms of the last one stay in `scene.at.terms`.
    """
    return np.array([objective.cost(candidate, np.inf, scene) for candidate in x])
