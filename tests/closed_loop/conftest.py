"""No program outlives the test that began it, and the flight over the hills is flown once."""

from collections.abc import Iterator

import pytest
from flights import FAULTS, HILLS, HILLS_MISSION, RUNNING, SEED, Recorded, flown_here


@pytest.fixture(autouse=True)
def _none_is_left_running() -> Iterator[None]:
    yield
    while RUNNING:
        RUNNING.pop().end()


@pytest.fixture(scope="session")
def hills(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """The flight over the hills, in this process; who looks at it is of the group `hills`."""
    folder = tmp_path_factory.mktemp("hills") / "run"
    return flown_here(folder, HILLS, HILLS_MISSION, FAULTS, SEED)
