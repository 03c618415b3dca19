from pathlib import Path

import numpy as np
import pair_files
import pair_worlds
import pytest
from pair import Flown, Pair

from companion.campaign import truth
from companion.config import load_mission
from companion.planner.kernels import NUMPY
from vehicle_sim.world import read_world


def fly(seed: int) -> Flown:
    return Pair(pair_worlds.scene("px4", "copter", 2), seed=seed, kernel=NUMPY).fly(limit_s=45.0)


def test_a_pair_flies_and_the_same_seed_flies_the_same_flight() -> None:
    once, again, another = fly(1), fly(1), fly(2)
    assert len(once.sent) > 100
    assert once.truth[-1]["altitude_amsl_m"] > pair_worlds.GROUND_AMSL_M + 10.0
    assert once.journal == again.journal
    assert once.truth == again.truth
    assert once.truth != another.truth


@pytest.mark.parametrize("kind", ["copter", "plane"])
def test_a_world_is_the_same_for_both_autopilots_and_another_for_another_number(kind: str) -> None:
    one, other = (pair_worlds.scene(autopilot, kind, 3) for autopilot in ("ardupilot", "px4"))  # type: ignore[arg-type]
    assert one.terrain == other.terrain
    assert one.mission.task.zones == other.mission.task.zones
    assert one.terrain != pair_worlds.scene("px4", kind, 4).terrain  # type: ignore[arg-type]


@pytest.mark.parametrize("number", range(4))
def test_start_and_target_lie_clear_of_everything(number: int) -> None:
    scene = pair_worlds.scene("px4", "plane", number)
    ends = np.array([(0.0, 0.0), scene.mission.targets_ne_m[-1]])
    for zone in (*scene.mission.task.zones, *scene.fence):
        gap = truth.keep_out_distance_m(ends, zone)
        assert (gap < 0.0).all() if zone.keep_in else (gap > scene.safety_m).all()


@pytest.mark.parametrize("number", range(3))
def test_the_files_of_a_scene_say_what_the_scene_says(number: int, tmp_path: Path) -> None:
    scene = pair_worlds.scene("ardupilot", "plane", number)
    mission, world = pair_files.write(scene, tmp_path)
    assert read_world(world) == scene.world
    loaded = load_mission(str(mission))
    assert loaded.targets_ne_m == scene.mission.targets_ne_m
    assert loaded.task.zones == scene.mission.task.zones
    assert loaded.task.radars == scene.mission.task.radars
    assert loaded.task.scan_distance_m == pytest.approx(scene.mission.task.scan_distance_m)
