"""No program outlives the test that began it, and the flight over the hills is flown once."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from flights import FAULTS, HILLS, RUNNING, SEED, Recorded, flown_here, mission_file


@pytest.fixture(autouse=True)
def _none_is_left_running() -> Iterator[None]:
    yield
    while RUNNING:
        RUNNING.pop().end()


@pytest.fixture(scope="session")
def hills(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """The flight over the hills, in this process; who looks at it is of the group `hills`."""
    folder = tmp_path_factory.mktemp("hills")
    targets = [{"north_m": 18_000.0, "east_m": 20_000.0}]  # past the mountain
    mission = mission_file(Path(HILLS).parent, folder / "mission.toml", targets=targets)
    return flown_here(folder / "run", HILLS, mission, FAULTS, SEED)
