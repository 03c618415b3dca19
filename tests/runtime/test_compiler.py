"""How the compiled kernel comes to be used; `test_kernels` tests what it computes."""

import os
import pickle
import shutil
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from companion import jit
from companion.path.proof import prove
from companion.planner import cheapest_ways, cost_samples, field, kernels, seeds
from companion.runtime import compiler
from companion.world import zones
from companion.world.columns import dilated_m


@pytest.fixture(autouse=True)
def _anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test loads for itself."""
    monkeypatch.setattr(compiler, "load_kernel", compiler.load_kernel.__wrapped__)


def test_what_is_loaded_is_all_that_a_plan_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled, called = jit.compiled, set[Any]()
    monkeypatch.setattr(field, "_idle", [])  # what an earlier plan of this process has kept
    zones.too_near.cache_clear()

    def noted(function: Any) -> Any:
        def call(*arguments: Any) -> Any:
            called.add(function)
            return compiled(function)(*arguments)

        return call

    monkeypatch.setattr(jit, "compiled", noted)
    compiler.load_kernel()
    ways, samples = cheapest_ways, cost_samples
    assert called == {
        *(kernels.search, kernels.costs, prove, dilated_m, zones.near_on_lattice),
        *(ways.repair, ways.needed_m, ways.lines_m, ways.straightened, ways.smooth_edges),
        *(ways.way_from, samples.raise_to, samples.go_on, samples.fill),
        seeds.places_along,
    }


# --- the cache on disk


def folder_of_cache(home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(home))
    assert jit.cache_on_disk()
    return Path(os.environ["NUMBA_CACHE_DIR"])


@pytest.mark.parametrize("torn", [True, False])
@pytest.mark.parametrize("errors", [(pickle.UnpicklingError,), (RuntimeError, RuntimeError)])
def test_one_that_cannot_be_read_is_made_anew_and_a_compiler_that_fails_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, torn: bool, errors: tuple[type[Exception], ...]
) -> None:
    folder, plans, left = folder_of_cache(tmp_path, monkeypatch), list[int](), list(errors)

    def broken(request: Any) -> None:
        plans.append(request.plan_id)
        if left:
            raise left.pop(0)("made up")

    monkeypatch.setattr(compiler, "plan", broken)
    if torn:
        (folder / "torn.nbi").write_bytes(b"x")
    fails = not torn or len(errors) > 1
    with pytest.raises(errors[-1], match="made up") if fails else nullcontext():
        compiler.load_kernel()
    assert len(plans) == 1 + torn  # the one that failed, and another
    assert not (folder / "torn.nbi").exists()


def test_the_same_sources_have_the_same_folder_and_a_change_in_any_has_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Under the folder that is given, or inherited by another process."""
    before, sources = folder_of_cache(tmp_path, monkeypatch), jit.SOURCES
    assert (before.parent, [*before.iterdir()]) == (tmp_path, [])
    assert jit.cache_on_disk() == before  # as a process that inherits it
    for index, source in enumerate(sources):
        changed = tmp_path / f"changed{index}"
        shutil.copy(Path(jit.__file__).parent / f"{source}.py", changed.with_suffix(".py"))
        others = (*sources[:index], str(changed), *sources[index + 1 :])
        monkeypatch.setattr(jit, "SOURCES", others)
        assert folder_of_cache(tmp_path, monkeypatch) == before  # the same text elsewhere
        with changed.with_suffix(".py").open("a", encoding="utf-8") as file:
            file.write("# another comment\n")
        assert folder_of_cache(tmp_path, monkeypatch) != before


def test_where_nothing_can_be_written_it_is_compiled_without_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()  # not even root can write below it
    monkeypatch.setattr(jit, "cache_folder", lambda: None)
    for chosen in ("", str(tmp_path / "file")):
        monkeypatch.setenv("NUMBA_CACHE_DIR", chosen)
        assert jit.cache_on_disk() is None
    assert jit.compiled.__wrapped__(lambda: 7)() == 7
