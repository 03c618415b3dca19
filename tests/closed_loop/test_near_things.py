"""Flights by a lidar through a garden that nobody knows: trees, and a wall with a gap.

All are flown in this process.
"""

import math
from pathlib import Path

import pytest
import shapely
from flights import ENVIRONMENTS, Recorded, edited, flown_here
from short_flight import replayed

pytestmark = pytest.mark.closed_loop

TREES_NE_M = (
    *((10.0, 1.5), (12.0, -6.0), (14.0, 6.0), (18.0, -1.0), (19.0, -12.0), (20.0, 10.0)),
    *((24.0, 3.0), (25.0, -14.0), (40.0, -5.0), (42.0, 6.0)),
)
TREE_M = 0.3
WALLS_NE_M = (((32.0, -30.0), (32.0, -8.0)), ((32.0, 0.0), (32.0, 30.0)))
WALL_M = 0.2  # half of its thickness
SAFE_M = 0.5  # d_s of the mission
TARGET_NE_M = (40.0, 1.0)
WORLD = """
schema = 1
name = "garden"
[origin]
latitude_deg = 47.0
longitude_deg = 8.0
[terrain]
combine = "maximum"
ground_amsl_m = 400.0
[vehicle]
kind = "copter"
autopilot = "ardupilot"
north_m = 0.0
east_m = 0.0
heading_deg = 0.0
[lidar]
range_m = 16.0
rate_hz = 10.0
step_deg = 2.5
noise_m = 0.1
lost_share = 0.05
latency_s = 0.06
"""
AREA = "north_min_m = -10.0\nnorth_max_m = {}\neast_min_m = {}\neast_max_m = {}"


def garden(folder: Path) -> Path:
    """The world."""
    parts = [WORLD]
    parts += [
        f"[[trees]]\nnorth_m = {north}\neast_m = {east}\nradius_m = {TREE_M}\nheight_m = 15.0\n"
        for north, east in TREES_NE_M
    ]
    parts += [
        f"[[walls]]\npoints_ne_m = {[list(end) for end in wall]}\n"
        f"thickness_m = {2.0 * WALL_M}\nheight_m = 15.0\n"
        for wall in WALLS_NE_M
    ]
    path = folder / "world.toml"
    path.write_text("\n".join(parts), encoding="utf-8")
    return path


def mission(folder: Path, *changes: tuple[str, str]) -> Path:
    """That of the forest, over a smaller area."""
    smaller = (AREA.format("310.0", "-10.0", "310.0"), AREA.format("70.0", "-30.0", "30.0"))
    nearer = ("north_m = 280.0\neast_m = 280.0", "north_m = {}\neast_m = {}".format(*TARGET_NE_M))
    forest = ENVIRONMENTS / "forest" / "mission.toml"
    return edited(forest, folder / "mission.toml", smaller, nearer, *changes)


@pytest.fixture(scope="module")
def by_lidar(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Its companion is killed between the trees, and started again."""
    folder = tmp_path_factory.mktemp("garden")
    killed = "at 60 s for 0.5 s: companion_off"
    return flown_here(folder / "run", garden(folder), mission(folder), faults=killed)


def test_a_lidar_with_noise_and_lost_echoes_leads_clear_of_all_through_the_gap(
    by_lidar: Recorded,
) -> None:
    """Every sample of the truth keeps d_s from all that stands there, and it is at the target."""
    assert by_lidar.outcome == "arrived"
    track = [(row["north_m"], row["east_m"]) for row in by_lidar.truth if not row["landed"]]
    assert len(track) > 100
    trees, walls = shapely.points(TREES_NE_M), shapely.linestrings(WALLS_NE_M)
    things = [(thing, TREE_M) for thing in trees] + [(thing, WALL_M) for thing in walls]
    for thing, half_m in things:
        assert shapely.distance(shapely.points(track), thing).min() - half_m >= SAFE_M
    assert math.dist(track[-1], TARGET_NE_M) < 1.0


def test_that_flight_is_replayed_as_it_was(by_lidar: Recorded) -> None:
    found = replayed(by_lidar.folder)
    assert found.is_identical, found
    assert found.unrecorded == 0


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
