"""The kernels of a plan: compiled by numba, or plain Python and numpy.

Both make the same search with the same random numbers and the same proof; costs agree to 1e-9.
numba is imported by `compiled()` only: that takes half a second, and flight can begin before.
"""

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from inspect import isfunction
from types import ModuleType
from typing import Any, cast, final

import numpy as np

from companion import extras
from companion.geodesy import FloatArray, LocalFrame
from companion.objective import kernel
from companion.objective import scene as numpy_form
from companion.objective.scene import FlightScene
from companion.optimise import refined_de
from companion.optimise.refined_de import State
from companion.path import proof, proof_distance, proof_shape
from companion.path.certificate import Prover


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Kernel:
    """The time-consuming parts of a plan."""

    name: str
    """numba, or numpy."""
    search: Callable[[State, FlightScene, int], None]
    """Goes on with a search until so many evaluations are spent."""
    costs: Callable[[FloatArray, FlightScene], FloatArray]
    """Costs of a population, (P, D) -> (P,): for optimisers that ask and tell."""
    prove: Prover
    """Proves a subpath (`path.certificate`)."""

    @property
    def signature(self) -> str:
        """Its name in the journal: equal names give equal results to the last digit."""
        return f"{self.name} {_arithmetic()}"


@lru_cache(maxsize=1)
def _arithmetic() -> str:
    """Digest of the platform's arithmetic: results of libm, numpy, OpenBLAS and PROJ."""
    x = np.linspace(0.1, 3.0, 1600)
    frame = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
    square = x.reshape(40, 40)
    found = [
        *(function(x) for function in (np.sin, np.cos, np.exp, np.log, np.arctan, np.hypot.reduce)),
        *(np.linalg.norm(square, axis=-1), square @ square, square @ x[:40], x**0.7),
        *([math.sin(v), math.exp(v), math.atan2(v, 0.7), v**0.7] for v in x[::16].tolist()),
        *(frame.to_local_m(47.0 + 0.1 * v, 8.0 - 0.1 * v) for v in x[::160].tolist()),
    ]
    digest = hashlib.sha256()
    for each in found:
        digest.update(np.asarray(each, dtype=np.float64).tobytes())
    return digest.hexdigest()[:8]


def _search(state: State, scene: FlightScene, until: int) -> None:
    while refined_de.spent(state) < until:
        n = refined_de.ask(state)
        state.trial_costs[:n] = numpy_form.cost(state.trial[:n], scene)
        refined_de.tell(state, n)


NUMPY = Kernel(name="numpy", search=_search, costs=numpy_form.cost, prove=proof.prove)


def compiled(*, cache: str | None) -> Kernel:
    """The numba kernel, compiled, or loaded from numba's cache on disk.

    cache: the folder of that cache; None: there is none.  Raises ImportError where numba is not
    installed.
    """
    import numba
    from numba.extending import register_jitable

    if cache is not None:
        numba.config.CACHE_DIR = cache  # it may have been imported with another one

    for module in SOURCES:
        for function in functions_of(module):
            register_jitable(function)
    jit: Any = numba.njit(cache=cache is not None, nogil=True)
    search, costs, prove = jit(_run), jit(_costs), jit(proof.prove)
    pack = lru_cache(maxsize=1)(kernel.pack)  # a search comes in portions

    def search_scene(state: State, scene: FlightScene, until: int) -> None:
        search(state, pack(scene), until)

    def costs_of(x: FloatArray, scene: FlightScene) -> FloatArray:
        return np.asarray(costs(x, pack(scene)))

    return Kernel(name="numba", search=search_scene, costs=costs_of, prove=prove)


@cache
def compiled_alone(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that is not of the planner's kernel, compiled where numba is installed."""
    if extras.missing("fast"):
        return function
    import numba

    return cast("Callable[..., Any]", numba.njit(function))


SOURCES = (numpy_form, kernel, refined_de, proof, proof_distance, proof_shape)
"""The modules whose code is compiled: a cache made from others is stale."""


def functions_of(module: ModuleType) -> list[Callable[..., Any]]:
    """The functions that a module defines."""
    every = vars(module).values()
    return [each for each in every if isfunction(each) and each.__module__ == module.__name__]


def _run(state: State, pack: kernel.Pack, until: int) -> None:
    """`_search`, one candidate after the other."""
    while refined_de.spent(state) < until:
        n = refined_de.ask(state)
        for i in range(n):
            state.trial_costs[i] = kernel.cost(state.trial[i], state.trial_bounds[i], pack)
        refined_de.tell(state, n)


def _costs(x: FloatArray, pack: kernel.Pack) -> FloatArray:
    result = np.empty(len(x))
    for i in range(len(x)):
        result[i] = kernel.cost(x[i], np.inf, pack)
    return result
