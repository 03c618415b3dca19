"""How the compiled kernel comes to be used; `test_kernels` tests what it computes."""

import os
import pickle
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from companion import caches
from companion.path.limits import Limits
from companion.planner import kernels
from companion.planner.kernels import NUMPY, Kernel
from companion.planner.procedure import hover_pose
from companion.planner.request import Planned, PlanOutcome, PlanRequest
from companion.planner.settings import PlannerSettings, Task
from companion.runtime import compiler
from companion.runtime.compiler import Planner, load_kernel
from companion.world.known_map import empty_map

LOADED = replace(NUMPY, name="loaded")
PATIENCE_S = 30.0


@pytest.fixture(scope="module")
def request_() -> PlanRequest:
    side_m = (-2_000.0, 2_000.0)
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
        scan_range_m=1_000.0, safety_distance_m=20.0, planning_time_s=1.0, evaluations=60
    )
    task = Task(limits=limits, settings=settings)
    blank = empty_map(task.cell_m, side_m, side_m)
    return PlanRequest(
        plan_id=1,
        seed=1,
        task=task,
        known=replace(blank, upper_m=np.zeros_like(blank.upper_m)),
        scan_nea_m=(0.0, 0.0, 150.0),
        start=hover_pose((0.0, 0.0, 150.0)),
        from_rest=True,
        target_ne_m=(1_500.0, 0.0),
    )


def never() -> bool:
    return False


def kernel_of(outcome: PlanOutcome) -> str:
    assert isinstance(outcome, Planned)
    return outcome.kernel.split()[0]  # without the digest of its arithmetic


@pytest.fixture
def ready() -> Iterator[threading.Event]:
    """Set when the kernel is there; whatever happens, no thread is left waiting for it."""
    event = threading.Event()
    yield event
    event.set()


def loader(ready: threading.Event) -> Callable[[], Kernel]:
    def load() -> Kernel:
        assert ready.wait(PATIENCE_S)
        return LOADED

    return load


def test_in_flight_plans_are_made_with_numpy_until_the_kernel_is_there_and_then_with_it(
    request_: PlanRequest, ready: threading.Event
) -> None:
    planner = Planner(lockstep=False, load=loader(ready))
    for _ in range(2):
        assert kernel_of(planner(request_, never)) == "numpy"
    ready.set()
    until_s = time.monotonic() + PATIENCE_S
    while kernel_of(planner(request_, never)) != "loaded":
        assert time.monotonic() < until_s


def test_in_lockstep_the_first_plan_waits_for_the_kernel(
    request_: PlanRequest, ready: threading.Event
) -> None:
    planner, outcomes = Planner(lockstep=True, load=loader(ready)), []
    asking = threading.Thread(target=lambda: outcomes.append(planner(request_, never)))
    asking.start()
    asking.join(0.3)
    assert asking.is_alive()
    ready.set()
    asking.join(PATIENCE_S)
    assert [kernel_of(each) for each in outcomes] == ["loaded"]


def test_the_kernel_is_loaded_once_and_from_its_start_on(
    request_: PlanRequest, ready: threading.Event
) -> None:
    loads: list[str] = []

    def load() -> Kernel:
        loads.append(threading.current_thread().name)
        return loader(ready)()

    planner = Planner(lockstep=False, load=load)
    assert loads == []
    planner.start()
    planner.start()
    planner(request_, never)
    ready.set()
    planner(request_, never)
    assert loads == ["compiler"]


def test_both_kernels_of_a_flight_make_the_same_plan(request_: PlanRequest) -> None:
    lockstep = Planner(lockstep=True, load=lambda: LOADED)(request_, never)
    assert isinstance(lockstep, Planned)
    with_numpy = Planner(lockstep=True, load=lambda: NUMPY)(request_, never)
    assert isinstance(with_numpy, Planned)
    assert np.array_equal(lockstep.subpath.control_nea_m, with_numpy.subpath.control_nea_m)


def test_time_that_is_up_is_told_to_the_plan(request_: PlanRequest) -> None:
    long = replace(
        request_,
        task=replace(request_.task, settings=replace(request_.task.settings, evaluations=30_000)),
    )
    outcome = Planner(lockstep=True, load=lambda: NUMPY)(long, lambda: True)
    assert outcome.evaluations <= 600


def breaks(monkeypatch: pytest.MonkeyPatch, home: Path, *errors: type[Exception]) -> list[bool]:
    """Loading the kernel fails so often; -> whether each attempt was with a cache."""
    attempts: list[bool] = []

    def broken(*, cache: str | None) -> Kernel:
        attempts.append(cache is not None)
        if len(attempts) <= len(errors):
            raise errors[len(attempts) - 1]("made up")
        return LOADED

    monkeypatch.setattr(kernels, "compiled", broken)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(home))
    return attempts


def test_without_numba_the_flight_is_planned_with_numpy(
    request_: PlanRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    attempts = breaks(monkeypatch, tmp_path, ImportError)
    assert load_kernel() is NUMPY
    assert attempts == [True]
    breaks(monkeypatch, tmp_path, ImportError)
    assert kernel_of(Planner(lockstep=True)(request_, never)) == "numpy"


def test_a_compiler_that_fails_leaves_numpy_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    breaks(monkeypatch, tmp_path, RuntimeError, RuntimeError)
    with pytest.warns(RuntimeWarning, match="RuntimeError: made up"):
        assert load_kernel() is NUMPY


def test_a_cache_that_cannot_be_read_is_thrown_away_and_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = folder_of_cache(tmp_path, monkeypatch)
    (folder / "torn.nbi").write_bytes(b"x")
    attempts = breaks(monkeypatch, tmp_path, pickle.UnpicklingError)
    with pytest.warns(RuntimeWarning, match="UnpicklingError"):
        assert load_kernel() is LOADED
    assert attempts == [True, True]
    assert not (folder / "torn.nbi").exists()


# --- the cache on disk


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


def folder_of_cache(home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(home))
    assert compiler._prepare_cache()
    return Path(os.environ["NUMBA_CACHE_DIR"])


def test_the_same_code_has_the_same_folder_under_the_one_that_is_given(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = folder_of_cache(home, monkeypatch)
    assert folder.parent == home
    assert folder.is_dir()
    assert list(folder.iterdir()) == []
    assert folder_of_cache(home, monkeypatch) == folder


def test_a_process_that_inherits_the_folder_uses_it_as_it_is(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = folder_of_cache(home, monkeypatch)
    assert compiler._prepare_cache()
    assert Path(os.environ["NUMBA_CACHE_DIR"]) == folder


@pytest.mark.parametrize("index", range(len(kernels.SOURCES)))
def test_a_change_in_any_source_has_another_folder(
    index: int, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = folder_of_cache(home, monkeypatch)
    changed = ModuleType("changed")
    changed.__file__ = str(home / "changed.py")
    shutil.copy(str(kernels.SOURCES[index].__file__), changed.__file__)
    sources = list(kernels.SOURCES)
    sources[index] = changed
    monkeypatch.setattr(kernels, "SOURCES", tuple(sources))
    assert folder_of_cache(home, monkeypatch) == before  # the same text elsewhere
    with (home / "changed.py").open("a", encoding="utf-8") as file:
        file.write("# another comment\n")
    assert folder_of_cache(home, monkeypatch) != before


def test_without_a_given_folder_the_users_own_cache_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(caches, "user_cache_dir", lambda name: str(tmp_path / name))
    assert compiler._prepare_cache()
    assert Path(os.environ["NUMBA_CACHE_DIR"]).parent == tmp_path / "companion"


def test_where_nothing_can_be_written_there_is_no_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("not a folder")  # not even root can write below it
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "cache"))
    assert compiler._prepare_cache() is None


UNCACHED = """
import tempfile
tempfile.tempdir = "{nowhere}"
from companion.planner import kernels
from companion.runtime import compiler
whole = {whole}
if whole:
    print(compiler.load_kernel().name)
else:
    assert compiler._prepare_cache() is None
    print(kernels.compiled(cache=None).name)
"""


@pytest.mark.xdist_group("compiled")
def test_on_a_read_only_system_the_kernel_is_compiled_without_a_cache(tmp_path: Path) -> None:
    """With COMPANION_DEEP_TESTS it is compiled to the end (some 30 s), else only begun."""
    pytest.importorskip("numba")
    (tmp_path / "file").write_text("not a folder")
    nowhere = str(tmp_path / "file" / "home")
    environment = {**os.environ, "HOME": nowhere, "XDG_CACHE_HOME": nowhere, "NUMBA_OPT": "0"}
    environment.pop("NUMBA_CACHE_DIR", None)
    whole = "COMPANION_DEEP_TESTS" in os.environ
    done = subprocess.run(
        [sys.executable, "-c", UNCACHED.format(nowhere=nowhere, whole=whole)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.stdout.strip() == "numba", done.stderr
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


BESIDE = """
from numba.core import event
from companion.runtime.compiler import load_beside_plans
with event.install_recorder("numba:compile") as compiled_here:
    print(load_beside_plans().name, len(compiled_here.buffer))
"""


@pytest.mark.nightly
@pytest.mark.usefixtures("home")
def test_what_plans_meanwhile_compiles_nothing_itself() -> None:
    pytest.importorskip("numba")
    command = [sys.executable, "-c", BESIDE]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout.split() == ["numba", "0"], done.stderr


def test_a_compiler_does_not_outlive_what_wants_its_code(home: Path) -> None:
    command = [sys.executable, "-m", "companion.runtime.compiler"]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as child:
        assert child.stdin is not None
        child.stdin.close()
        assert child.wait(PATIENCE_S) == 0
    assert not any(home.rglob("complete"))
