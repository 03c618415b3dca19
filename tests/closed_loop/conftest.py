"""No program outlives the test that began it, and the flight over the hills is flown once."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from flights import FAULTS, HILLS, HILLS_MISSION, RUNNING, SEED, SOON, Recorded, flown_here


@pytest.fixture(autouse=True)
def _none_is_left_running() -> Iterator[None]:
    yield
    while RUNNING:
        RUNNING.pop().end()


@pytest.fixture(scope="session")
def hills(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """The flight over the hills, in this process; who looks at it is of the group `hills`."""
    folder, text = tmp_path_factory.mktemp("hills"), Path(HILLS_MISSION).read_text("utf-8")
    for was, now in (
        *(("north_m = 26000.0", "north_m = 18000.0"), ("24000.0", "20000.0")),  # past the mountain
        ("[planner]", f"[planner]\nevaluations = {SOON}"),
    ):
        assert was in text
        text = text.replace(was, now, 1)
    (folder / "mission.toml").write_text(text, encoding="utf-8")
    return flown_here(folder / "run", HILLS, folder / "mission.toml", FAULTS, SEED)
