"""Hypothesis profiles: `dev` by default, `--hypothesis-profile=ci` searches longer.

`--all`, and the seed of a nudge: what tests of decisions are also flown under.  A test that is
marked `nightly` states a law that others state with fewer draws: it runs with `--all` alone.
"""

import zlib
from collections.abc import Iterator

import pytest
from hypothesis import settings
from nudge import SEEDS, nudged_positions

settings.register_profile("dev", max_examples=50, derandomize=True, database=None, deadline=None)
settings.register_profile("ci", max_examples=200, derandomize=True, database=None, deadline=None)
settings.load_profile("dev")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--all",
        action="store_true",
        help="fly tests of decisions under all ten nudges, and more of them in other arithmetic; "
        "and what is marked nightly",
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Without --all nothing nightly runs."""
    if config.getoption("--all"):
        return
    nightly = [item for item in items if item.get_closest_marker("nightly")]
    config.hook.pytest_deselected(items=nightly)
    items[:] = [item for item in items if not item.get_closest_marker("nightly")]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """With --all a test that is flown under a nudge is flown under each."""
    if "nudge" in metafunc.fixturenames and metafunc.config.getoption("--all"):
        metafunc.parametrize("nudge", SEEDS, indirect=True, ids=lambda seed: f"nudge {seed}")


@pytest.fixture
def nudge(request: pytest.FixtureRequest) -> int:
    """The seed of the nudge that a test is flown under: each test has its own."""
    seed: int = getattr(request, "param", zlib.crc32(request.node.nodeid.encode()) % len(SEEDS))
    return seed


@pytest.fixture
def nudged(nudge: int) -> Iterator[None]:
    """Positions are off by up to a micrometre, as far as the mission machine can tell."""
    with nudged_positions(nudge):
        yield
