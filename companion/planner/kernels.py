"""What a plan spends its time in, compiled by numba: search, costs and proof.

All of it is plain Python that runs as it is, too: the same search with the same random numbers,
and the same proof; costs agree to 1e-9.  Tests take that form as their oracle.
"""

import hashlib
import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from inspect import isfunction
from pathlib import Path
from types import SimpleNamespace
from typing import Any, final

import numpy as np

from companion.caches import cache_folder, is_writable
from companion.geodesy import BoolArray, FloatArray, LocalFrame
from companion.objective import kernel as objective
from companion.objective.scene import TERMS, Scene
from companion.optimise import refined_de
from companion.optimise.refined_de import State
from companion.path import envelope, proof, proof_shape
from companion.path.certificate import Prover
from companion.planner import cheapest_ways, cost_samples
from companion.world import clearance, columns, zones


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Kernel:
    """The time-consuming parts of a plan."""

    search: Callable[[State, Scene, int], None]
    """Goes on with a search until so many evaluations are spent."""
    costs: Callable[[FloatArray, Scene], FloatArray]
    """Costs of a population, (P, D) -> (P,): for optimisers that ask and tell."""
    terms: Callable[[FloatArray, Scene], dict[str, float]]
    """The terms of a candidate, (D,), by name, unweighted."""
    prove: Prover
    dilated_m: Callable[..., FloatArray]
    """Of `world.clearance`."""
    guidance: Any
    """What guidance calls of `cheapest_ways` and `cost_samples`, by name."""
    near_zones: Callable[..., BoolArray]
    """Of `world.zones`."""


@cache
def signature() -> str:
    """Names numba and the platform's arithmetic: equal names give equal plans to the last digit.

    The arithmetic is named by a digest of results of libm, numpy, OpenBLAS and PROJ.
    """
    x = np.linspace(0.1, 3.0, 1600)
    frame = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
    square = x.reshape(40, 40)
    found = [
        *(function(x) for function in (np.sin, np.cos, np.exp, np.log, np.arctan, np.hypot.reduce)),
        *(np.linalg.norm(square, axis=-1), square @ square, square @ x[:40], x**0.7),
        *([math.sin(v), math.exp(v), math.atan2(v, 0.7), v**0.7] for v in x[::16].tolist()),
        *(frame.to_local_m(47.0 + 0.1 * v, 8.0 - 0.1 * v) for v in x[::160].tolist()),
    ]
    told = b"".join(np.asarray(each, dtype=np.float64).tobytes() for each in found)
    return f"numba {hashlib.sha256(told).hexdigest()[:8]}"


@cache
def compiled() -> Kernel:
    """The kernel, each part compiled, or loaded from numba's cache on disk, when first called.

    `runtime.compiler.load_kernel` calls them all.
    """
    import numba  # half a second
    from numba.extending import register_jitable

    folder = cache_on_disk()
    if folder is not None:
        numba.config.CACHE_DIR = str(folder)  # it may have been imported with another one
    for module in SOURCES:
        for each in list(vars(module).values()):
            if isfunction(each) and each.__module__ == module.__name__:
                register_jitable(each)
    return kernel_by(numba.njit(cache=folder is not None, nogil=True))


def kernel_by(jit: Callable[[Callable[..., Any]], Callable[..., Any]]) -> Kernel:
    """The kernel whose parts are compiled by this; tests leave them as they are."""
    costs = jit(_costs)

    def terms_of(x: FloatArray, scene: Scene) -> dict[str, float]:
        costs(x[None], scene)
        return dict(zip(TERMS, scene.at.terms.tolist(), strict=True))

    return Kernel(
        search=jit(_run),
        costs=costs,
        terms=terms_of,
        prove=jit(proof.prove),
        dilated_m=jit(clearance.dilated_m),
        guidance=SimpleNamespace(
            **{each.__name__: jit(each) for each in cheapest_ways.ENTRIES + cost_samples.ENTRIES}
        ),
        near_zones=jit(zones.near_on_lattice),
    )


SOURCES = (
    *(objective, refined_de, envelope, proof, proof_shape),
    *(columns, zones, cheapest_ways, cost_samples, clearance),
)
"""The modules whose code is compiled: a cache made from others is stale."""


def cache_on_disk() -> Path | None:
    """Point numba at a folder of this very code's own; None if that cannot be written to.

    numba looks at the entry function's file alone to see whether its cache is stale, so the
    folder's name holds a digest of all that is compiled.  The environment's NUMBA_CACHE_DIR wins.
    """
    try:
        paths = (*(str(module.__file__) for module in SOURCES), __file__)
        code = b"".join(Path(path).read_bytes() for path in paths)
    except OSError:
        return None  # installed without sources
    name = f"kernel-{hashlib.sha256(code).hexdigest()[:16]}"
    chosen = os.environ.get("NUMBA_CACHE_DIR") or cache_folder()
    if chosen is None:
        return None
    folder = Path(chosen)
    if folder.name != name:  # it is when this process, or the one that started it, has been here
        folder /= name
    if is_writable(folder):
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        return folder
    return None


def _run(state: State, scene: Scene, until: int) -> None:
    """Go on with a search, one candidate after the other."""
    while refined_de.spent(state) < until:
        n = refined_de.ask(state)
        for i in range(n):
            state.trial_costs[i] = objective.cost(state.trial[i], state.trial_bounds[i], scene)
        refined_de.tell(state, n)


def _costs(x: FloatArray, scene: Scene) -> FloatArray:
    return np.array([objective.cost(each, np.inf, scene) for each in x])
