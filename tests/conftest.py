"""Hypothesis profiles: `dev` by default; `night`, with `--all`, searches longer.

`--all`, and the seed of a nudge: what tests of decisions are also flown under.  A test that is
marked `nightly` states a law that others state with fewer draws: it runs with `--all` alone, as do
all but each nth of the cases of a test that is marked `sample(n)`.
"""

import copyreg
import gc
import os
import shutil
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from nudge import SEEDS, nudged_positions

copyreg.pickle(struct.Struct, lambda made: (struct.Struct, (made.format,)))  # pymavlink's codecs
gc.disable()  # until all is collected: what tests are made of stays
settings.register_profile("dev", max_examples=30, derandomize=True, database=None, deadline=None)
settings.register_profile("night", max_examples=200, derandomize=True, database=None, deadline=None)
settings.load_profile("dev")


FIRST = ("interop", "closed_loop", "test_release.py", "campaign", "test_tracking.py", "planner")
"""Folders and files whose tests take longest."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--all",
        action="store_true",
        help="fly tests of decisions under all ten nudges, and more of them in other arithmetic; "
        "and what is marked nightly; properties are searched longer",
    )


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--all"):
        settings.load_profile("night")
    config.addinivalue_line("markers", "sample(n): each nth case, with --all every one")
    if not config.pluginmanager.hasplugin("xdist"):
        config.addinivalue_line("markers", "xdist_group(name): without xdist there is one worker")


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Without --all nothing nightly runs; what a file makes once is made by one worker.

    What takes long comes first: whoever begins it late keeps the other workers waiting.  And before
    all what waits for other people's programs: meanwhile the checks have the processor.
    """
    if not config.getoption("--all"):
        nightly = set(_nightly(items))
        config.hook.pytest_deselected(items=[item for item in items if item in nightly])
        items[:] = [item for item in items if item not in nightly]
    items.sort(key=_rank)
    for item in items if config.pluginmanager.hasplugin("xdist") else ():
        if not item.get_closest_marker("xdist_group"):
            file = item.path.relative_to(config.rootpath).with_suffix("")
            item.add_marker(pytest.mark.xdist_group(".".join(file.parts[1:])))


def _rank(item: pytest.Item) -> int:
    """Its place in the order; all that is not known to take long is last."""
    names = item.path.parent.name, item.path.name
    return next((k for k, name in enumerate(FIRST) if name in names), len(FIRST))


def pytest_collection_finish() -> None:
    """What has been collected stays: no garbage collection looks through it again."""
    gc.freeze()
    gc.enable()


def _nightly(items: list[pytest.Item]) -> Iterator[pytest.Item]:
    cases: Counter[tuple[str, int]] = Counter()
    for item in items:
        sample = item.get_closest_marker("sample")
        where = item.location[0], item.location[1] or 0
        if item.get_closest_marker("nightly") or (sample and cases[where] % sample.args[0]):
            yield item
        cases[where] += 1


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """With --all a test that is flown under a nudge is flown under each."""
    if "nudge" in metafunc.fixturenames and metafunc.config.getoption("--all"):
        metafunc.parametrize("nudge", SEEDS, indirect=True, ids=lambda seed: f"nudge {seed}")


@pytest.fixture(scope="session")
def chromium() -> Path:
    """Debian's browser; without it a test is skipped, but not in CI."""
    if found := shutil.which("chromium"):
        return Path(found)
    reason = "there is no chromium: on Debian, apt-get install chromium"
    if os.environ.get("WITH_BROWSER"):
        pytest.fail(reason)
    pytest.skip(reason)


@pytest.fixture(scope="session")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a short flight, paused once; only to be read."""
    from recorded import run_folder  # what few tests need

    return run_folder(tmp_path_factory.mktemp("recorded"))


@pytest.fixture
def copy(run_dir: Path, tmp_path: Path) -> Path:
    """That run folder, to be spoiled."""
    return Path(shutil.copytree(run_dir, tmp_path / "run"))


@pytest.fixture
def nudge(request: pytest.FixtureRequest) -> int:
    """The seed of the nudge that a test is flown under: each test has its own."""
    name = request.node.nodeid
    for group in request.node.iter_markers("xdist_group"):
        name = name.removesuffix(f"@{group.args[0]}")  # as it is without xdist
    seed: int = getattr(request, "param", zlib.crc32(name.encode()) % len(SEEDS))
    return seed


@pytest.fixture
def nudged(nudge: int) -> Iterator[None]:
    """Positions are off by up to a micrometre, as far as the mission machine can tell."""
    with nudged_positions(nudge):
        yield
