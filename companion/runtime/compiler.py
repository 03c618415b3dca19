"""Loads the planner's compiled kernel without ever waiting for the compiler in flight."""

import hashlib
import importlib
import os
import shutil
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import final

import numpy as np

from companion import extras
from companion.caches import cache_folder, is_writable
from companion.path.limits import Limits
from companion.planner import kernels
from companion.planner.kernels import NUMPY, Kernel
from companion.planner.plan import plan
from companion.planner.procedure import hover_pose
from companion.planner.request import PlanOutcome, PlanRequest
from companion.planner.settings import PlannerSettings, Task
from companion.world.known_map import KnownMap, empty_map

_COMPLETE = "complete"  # a file beside the cached code: nothing of it is missing


def load_kernel() -> Kernel:
    """The fastest kernel that there is: numba's, or numpy's where numba is absent or broken.

    The first time it takes some ten seconds to compile; then it is loaded from a cache on disk.  If
    the cache cannot be written it is compiled each time; an unreadable one (after a power cut) is
    rebuilt.
    """
    cache = _prepare_cache()
    if cache is None:
        return _compiled(None) or NUMPY
    kernel = _compiled(cache)
    if kernel is None and any(cache.iterdir()):
        shutil.rmtree(cache, ignore_errors=True)
        kernel = _compiled(cache)
    if kernel is not None:
        with suppress(OSError):
            (cache / _COMPLETE).touch()
    return kernel or NUMPY


def load_libraries() -> None:
    """What scipy loads when it is first asked for, in up to 0.5 s: before anybody waits for it."""
    for name in ("linalg", "ndimage", "sparse.csgraph"):
        importlib.import_module(f"scipy.{name}")


def load_beside_plans() -> Kernel:
    """As `load_kernel`, but compiles what the cache lacks in a separate process first.

    The compiler holds the interpreter lock for seconds: in a thread it would block the numpy plans
    made meanwhile, until the watchdog considers the planner hung.
    """
    cache = _prepare_cache()
    if cache is not None and not extras.missing("fast") and not (cache / _COMPLETE).exists():
        command = [sys.executable, "-P", "-m", "companion.runtime.compiler"]
        with subprocess.Popen(command, stdin=subprocess.PIPE) as child:
            child.wait()
    return load_kernel()


def main() -> None:
    """Fill the cache at low priority, as long as the standard input is open."""

    def ends_with_parent() -> None:
        sys.stdin.read()
        os._exit(0)

    os.nice(10)
    threading.Thread(target=ends_with_parent, daemon=True).start()
    load_kernel()


def _compiled(cache: Path | None) -> Kernel | None:
    try:
        kernel = kernels.compiled(cache=None if cache is None else str(cache))
        _warm_up(kernel)
    except ImportError:
        return None
    except Exception as error:  # noqa: BLE001 - whatever fails, numpy still works
        text = f"the compiled kernel cannot be used: {type(error).__name__}: {error}"
        warnings.warn(text, RuntimeWarning, stacklevel=2)
        return None
    return kernel


def _prepare_cache() -> Path | None:
    """Point numba at a folder of this very code's own; None if that cannot be written to.

    numba looks at the entry function's file alone to see whether its cache is stale, so the
    folder's name holds a digest of all that is compiled.  The environment's NUMBA_CACHE_DIR wins.
    """
    digest = hashlib.sha256()
    try:
        for module in (*kernels.SOURCES, kernels):
            digest.update(Path(str(module.__file__)).read_bytes())
    except OSError:
        return None  # installed without sources
    name = f"kernel-{digest.hexdigest()[:16]}"
    chosen = os.environ.get("NUMBA_CACHE_DIR") or cache_folder()
    if chosen is None:
        return None
    folder = Path(chosen)
    if folder.name != name:  # it is when this process, or the one that started it, has been here
        folder /= name
    if not is_writable(folder):
        return None
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    return folder


def _warm_up(kernel: Kernel) -> None:
    """Run one small plan over flat ground, so that everything is compiled now."""
    side_m, range_m = (-2_000.0, 2_000.0), 1_000.0
    limits = Limits(
        speed_m_s=10.0,
        acceleration_m_s2=2.0,
        climb_rate_m_s=2.0,
        turn_radius_m=50.0,
        climb_angle_rad=0.2,
        dive_angle_rad=0.2,
        floor_amsl_m=100.0,
        ceiling_amsl_m=300.0,
        north_m=side_m,
        east_m=side_m,
    )
    settings = PlannerSettings(
        scan_range_m=range_m, safety_distance_m=20.0, planning_time_s=1.0, evaluations=200
    )
    task = Task(limits=limits, settings=settings)
    blank = empty_map(task.cell_m, side_m, side_m)
    flat = replace(blank, upper_m=np.zeros_like(blank.upper_m))
    for optimiser in (None, "pso"):  # the compiled search, and compiled costs
        plan(
            _question(replace(task, settings=replace(settings, optimiser=optimiser)), flat),
            kernel=kernel,
        )


def _question(task: Task, known: KnownMap) -> PlanRequest:
    start = hover_pose((0.0, 0.0, 150.0))
    return PlanRequest(
        plan_id=1,
        seed=1,
        task=task,
        known=known,
        scan_nea_m=start.point_nea_m,
        start=start,
        from_rest=True,
        target_ne_m=(1_500.0, 0.0),
    )


@final
class Planner:
    """Plans with the compiled kernel as soon as there is one, until then with numpy.

    In lockstep vehicle time stands still meanwhile, so it waits: the same seed, the same flight.
    """

    def __init__(self, *, lockstep: bool, load: Callable[[], Kernel] = load_kernel) -> None:
        self._lockstep, self._load = lockstep, load
        self._kernel = NUMPY
        self._starting = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="compiler", daemon=True)

    def start(self) -> None:
        """Begin to load the kernel."""
        with self._starting:
            if self._thread.ident is None:
                self._thread.start()

    def wait(self) -> None:
        """Load the kernel and wait until that is done."""
        self.start()
        self._thread.join()

    def _run(self) -> None:
        self._kernel = self._load()

    def __call__(self, request: PlanRequest, stop: Callable[[], bool]) -> PlanOutcome:
        """One plan."""
        if self._lockstep:
            self.wait()
        self.start()
        return plan(request, stop, self._kernel)


if __name__ == "__main__":
    main()
