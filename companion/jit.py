"""What a plan spends its time in, compiled by numba: search, costs, guidance and proof.

All of it is plain Python that runs as it is, too: the same search with the same random numbers,
and the same proof; costs agree to 1e-9.  Tests take that form as their oracle.
"""

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from inspect import isfunction
from pathlib import Path
from typing import Any

from companion.caches import cache_folder, is_writable

SOURCES = (
    *("world/columns", "world/zones", "objective", "optimise/refined_de"),
    *("path/envelope", "path/proof", "path/proof_shape"),
    *("planner/cheapest_ways", "planner/cost_samples", "planner/kernels", "planner/seeds"),
)
"""The modules whose code is compiled: a cache made from others is stale."""


@cache
def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of `SOURCES`, compiled, or loaded from numba's cache on disk, when first called.

    `runtime.compiler.load_kernel` calls all that a plan needs.
    """
    import numba  # half a second

    folder = cache_on_disk()
    if folder is not None:
        numba.config.CACHE_DIR = str(folder)  # it may have been imported with another one
    for name in SOURCES:
        module = "companion." + name.replace("/", ".")
        for value in list(vars(sys.modules.get(module, object)).values()):
            if isfunction(value) and value.__module__ == module:
                _callable(value)
    jitted: Callable[..., Any] = numba.njit(cache=folder is not None, nogil=True)(function)
    return jitted


@cache
def _callable(function: Callable[..., Any]) -> None:
    """Have it compiled where what is compiled calls it."""
    from numba.extending import register_jitable

    register_jitable(function)


def cache_on_disk() -> Path | None:
    """Point numba at a folder of this very code's own; None if that cannot be written to.

    numba looks at the entry function's file alone to see whether its cache is stale, so the
    folder's name holds a digest of all that is compiled.  The environment's NUMBA_CACHE_DIR wins.
    """
    this_file = Path(__file__)
    try:
        files = (*(this_file.parent / f"{name}.py" for name in SOURCES), this_file)
        code = b"".join(file.read_bytes() for file in files)
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
