"""Drawn worlds as files: what both programs read is what was drawn, and is flown."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from companion.campaign import drawn_world, families, truth
from companion.campaign.drawn_files import write
from companion.campaign.drawn_world import DrawnWorld
from companion.config import load_mission, load_world
from companion.mission.mission import AutopilotName
from companion.planner.plan import plan
from companion.runtime.in_process import fly_in_process
from companion.session import Session
from companion.world.terrain import ArrayTerrain
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world


def places_m(world: DrawnWorld) -> tuple[np.ndarray, np.ndarray]:
    rng, limits = np.random.default_rng(1), world.task.limits
    return rng.uniform(*limits.north_m, 3_000), rng.uniform(*limits.east_m, 3_000)


@pytest.mark.parametrize("family", families.FAMILIES)
def test_what_is_read_back_is_what_was_drawn(family: str, tmp_path: Path) -> None:
    drawn = families.world(family, 5, 0)
    world_path, mission_path = write(drawn, tmp_path)
    mission, world = load_mission(str(mission_path)), load_world(str(world_path))
    task, limits = mission.task, drawn.task.limits
    assert task.radars == drawn.task.radars
    assert task.zones == drawn.task.zones
    period_s = task.settings.position_period_s
    assert replace(task.settings, position_period_s=0.1) == drawn.task.settings
    assert period_s in (0.05, 0.1)
    assert mission.targets_ne_m == drawn.targets_ne_m
    assert world.start_ne_m == drawn.start_nea_m[:2]
    for name in limits.__slots__:
        assert getattr(task.limits, name) == pytest.approx(getattr(limits, name), rel=1e-12), name
    north, east = places_m(drawn)
    expected = truth.height_m(drawn.terrain, north, east)
    off_m = 0.0
    if isinstance(drawn.terrain, ArrayTerrain):  # in degrees it bends elsewhere
        bends = np.abs(np.diff(drawn.terrain.heights_m, 2, axis=0)).max()
        off_m = 0.25 * float(bends)
    theirs = read_world(world_path).truth().height_amsl_m(north, east)
    judged = truth.height_m(
        drawn_world.of_files(str(world_path), str(mission_path)).terrain, north, east
    )
    for heights in (world.terrain.height_m(north, east), theirs, judged):
        np.testing.assert_allclose(heights, expected, atol=off_m + 1e-3)
        assert abs(float(np.mean(heights - expected))) < 0.05


@pytest.mark.closed_loop
@pytest.mark.nightly  # what is read is what was drawn: above; such missions are flown by others
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_drawn_world_is_flown_from_its_files_to_its_target(
    autopilot: AutopilotName, tmp_path: Path
) -> None:
    drawn = families.world("copter", 5, 0)
    world_path, mission_path = write(drawn, tmp_path, autopilot)
    simulation = Simulation(read_world(world_path), seed=1)
    session = Session(load_mission(str(mission_path)), seed=1, lockstep=True)
    flown = fly_in_process(session, simulation, planner=plan)
    assert flown.end is not None
    assert flown.end.outcome.value == "arrived", flown.end
    north_m, east_m, _ = simulation.place_nea_m()
    assert math.dist((north_m, east_m), drawn.targets_ne_m[0]) < 10.0
