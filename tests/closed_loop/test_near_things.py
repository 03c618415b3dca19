"""Flights by a lidar through a garden that nobody knows: trees, and a wall with a gap.

All are flown in this process.
"""

import math
from pathlib import Path
from typing import Any

import pytest
import shapely
from flights import ENVIRONMENTS, Recorded, edited, flown_here

from companion.config import load_mission
from companion.mission.state import Reason
from companion.replay.reproduce import Replay

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


def flown_through(folder: Path, world: Path, faults: str = "") -> Recorded:
    return flown_here(folder / "run", world, folder / "mission.toml", faults=faults)


def arrived_clear(flight: Recorded) -> None:
    """Every sample of the truth keeps d_s from all that stands there, and it is at the target."""
    assert flight.outcome == "arrived"
    in_air = [row for row in flight.truth if not row["landed"]]
    assert len(in_air) > 100
    points = shapely.points([(row["north_m"], row["east_m"]) for row in in_air])
    trees, walls = shapely.points(TREES_NE_M), shapely.linestrings(WALLS_NE_M)
    things = [(thing, TREE_M) for thing in trees] + [(thing, WALL_M) for thing in walls]
    least_m = min(float(shapely.distance(points, thing).min()) - half for thing, half in things)
    assert least_m >= SAFE_M
    assert math.dist((in_air[-1]["north_m"], in_air[-1]["east_m"]), TARGET_NE_M) < 1.0


@pytest.fixture(scope="module")
def by_lidar(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Its companion is killed between the trees, and started again."""
    folder = tmp_path_factory.mktemp("garden")
    killed = "at 60 s for 0.5 s: companion_off"
    return flown_here(folder / "run", garden(folder), mission(folder), faults=killed)


def test_a_lidar_with_noise_and_lost_echoes_leads_through_the_gap(by_lidar: Recorded) -> None:
    arrived_clear(by_lidar)


def test_that_flight_is_replayed_as_it_was(by_lidar: Recorded) -> None:
    path = str(by_lidar.folder.parent / "mission.toml")
    replay = Replay(by_lidar.folder, lambda start: load_mission(path, start.profile))
    for _ in replay.steps():
        pass
    assert replay.found.is_identical, replay.found
    assert replay.found.unrecorded == 0


@pytest.mark.nightly  # without a flight: `tests/mission/test_near_things.py`
def test_a_lidar_that_is_dead_for_a_while_is_waited_for_in_a_hold(tmp_path: Path) -> None:
    mission(tmp_path)
    flight = flown_through(tmp_path, garden(tmp_path), "at 58 s for 8 s: lidar_dead")
    arrived_clear(flight)
    [silent] = [row["t_s"] for row in flight.journal if is_hold(row, Reason.SENSOR_SILENT)]
    assert 58.5 < silent < 62.0
    stands = [row for row in flight.truth if silent + 3.0 < row["t_s"] < 66.0]
    assert all(math.hypot(*velocity_m_s(row)) < 0.3 for row in stands)
    assert flight.says.count(Reason.SENSOR_SILENT.text) == 1


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


def is_hold(row: dict[str, Any], reason: Reason) -> bool:
    return row.get("phase") == "holding" and row.get("reason") == reason.text


def velocity_m_s(row: dict[str, Any]) -> tuple[float, float]:
    return row["velocity_north_m_s"], row["velocity_east_m_s"]


OF_DRIVER = ("component = 196\n", "")
TREE = "[[trees]]\nnorth_m = 30.0\neast_m = 1.0\nradius_m = 0.3\nheight_m = 15.0\n"


@pytest.mark.nightly  # without a flight: `tests/mavlink/test_near_sensing.py`
def test_eight_wide_sectors_of_an_autopilot_that_is_silent_in_the_open_lead_past_a_tree(
    tmp_path: Path,
) -> None:
    """While nothing is in its reach nothing is said: its health tells that from a dead sensor."""
    mission(tmp_path, ('kind = "obstacle_distance"', 'kind = "distance_sensor"'), OF_DRIVER)
    world = tmp_path / "world.toml"
    world.write_text(f'{WORLD}output = "autopilot"\n{TREE}', encoding="utf-8")
    flight = flown_through(tmp_path, world)
    assert flight.outcome == "arrived"
    assert min(row["near_m"] for row in flight.truth if not row["landed"]) >= SAFE_M
    assert not any(Reason.SENSOR_SILENT.text in text for text in flight.says)


HILL = """
[[terrain.peaks]]
north_m = 28.0
east_m = 0.0
height_amsl_m = 402.4
spread_north_m = 250.0
spread_east_m = 2000.0
[vehicle.parameters]
RNGFND1_TYPE = 100
RNGFND1_MAX = 12.0
"""
LOOKS_DOWN = ('kind = "copter"', 'kind = "copter"\nrangefinder_error_m = 1.0')


@pytest.mark.nightly  # without a flight: `tests/mission/test_near_things.py`
def test_ground_that_is_higher_than_stated_stops_it_until_it_is_given_up(tmp_path: Path) -> None:
    """2.2 m below its path, where the mission states 4 and its lidar looks over it."""
    mission(tmp_path, LOOKS_DOWN)
    world = tmp_path / "world.toml"
    world.write_text(f"{WORLD}{TREE}{HILL}", encoding="utf-8")
    flight = flown_through(tmp_path, world)
    [held] = [row["t_s"] for row in flight.journal if is_hold(row, Reason.GROUND_NEARER)]
    stands = [row for row in flight.truth if held + 5.0 < row["t_s"] < held + 59.0]
    assert len(stands) > 500
    assert all(row["altitude_amsl_m"] - 402.4 > 1.0 for row in stands)
    assert all(math.hypot(*velocity_m_s(row)) < 0.3 for row in stands)
    assert flight.outcome == "failed"
    assert Reason.GROUND_NEARER.text in flight.end["reason"]
