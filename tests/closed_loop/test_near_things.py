"""A flight by a lidar through a wood that nobody knows: its companion is killed among the trees."""

import math

import pytest
from flights import ENVIRONMENTS, Recorded, edited, flown_here

from companion.config import load_mission
from companion.replay.reproduce import Replay

pytestmark = pytest.mark.closed_loop
FOREST = ENVIRONMENTS / "forest"
SAFE_M = 0.5  # d_s of the mission
TARGET_NE_M = (65.0, 65.0)


@pytest.fixture(scope="module")
def by_lidar(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """In this process, to a place on the way of the bundled mission."""
    folder = tmp_path_factory.mktemp("forest")
    nearer = ("north_m = 280.0\neast_m = 280.0", "north_m = {}\neast_m = {}".format(*TARGET_NE_M))
    mission = edited(FOREST / "mission.toml", folder / "mission.toml", nearer)
    killed = "at 60 s for 0.5 s: companion_off"
    return flown_here(folder / "run", FOREST / "world.toml", mission, faults=killed)


def test_a_lidar_leads_past_every_tree_to_the_target(by_lidar: Recorded) -> None:
    """Every sample of the truth keeps d_s from all that stands there."""
    assert by_lidar.outcome == "arrived"
    in_air = [row for row in by_lidar.truth if not row["landed"]]
    assert len(in_air) > 100
    assert SAFE_M <= min(row["near_m"] for row in in_air) < 4.0
    assert math.dist((in_air[-1]["north_m"], in_air[-1]["east_m"]), TARGET_NE_M) < 1.0


def test_that_flight_is_replayed_as_it_was(by_lidar: Recorded) -> None:
    path = str(by_lidar.folder.parent / "mission.toml")
    replay = Replay(by_lidar.folder, lambda start: load_mission(path, start.profile))
    for _ in replay.steps():
        pass
    assert replay.found.is_identical, replay.found
    assert replay.found.unrecorded == 0


def test_killed_between_the_trees_and_started_again_it_learns_them_anew(by_lidar: Recorded) -> None:
    """Things move: what was known of them is not kept, and no leg is planned on it."""
    assert not (by_lidar.folder / "known.npz").exists()
    journal = by_lidar.journal
    [_, again] = [number for number, row in enumerate(journal) if "schema" in row]
    assert sum(row.get("kind") == "leg" for row in journal[:again]) > 1
    seen = {row["cells_seen"] for row in journal[:again] if row.get("kind") == "scan done"}
    anew = [row["cells_seen"] for row in journal[again:] if row.get("kind") == "scan done"]
    assert anew[0] < max(seen)
    assert not any(row.get("kind") in ("arm", "take off") for row in journal[again:])
