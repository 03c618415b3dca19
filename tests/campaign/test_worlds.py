"""Laws of drawn worlds: what they follow from, that there is a way, that files tell the same."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, label

from companion.campaign import drawn_world, families, truth
from companion.campaign.drawn_world import write
from companion.config import load_mission, load_world
from companion.world.radars import Radar
from companion.world.terrain import Peak
from vehicle_sim.world import read_world

BASE = families.world("dense", 0, 0)
EACH = pytest.mark.parametrize("family", families.FAMILIES)


@EACH
def test_a_world_follows_from_family_seed_and_index_alone(family: str) -> None:
    def fingerprints(*pairs: tuple[int, int]) -> list[str]:
        families.world.cache_clear()
        return [families.world(family, *pair).fingerprint for pair in pairs]

    first, last, *others = fingerprints((5, 0), (5, 1), (5, 2), (6, 0))
    assert fingerprints((5, 1), (5, 0)) == [last, first]
    assert len({first, last, *others}) == 4


@EACH
def test_every_world_has_a_way_by_an_independent_search(family: str) -> None:
    world = families.world(family, 5, 0)
    task, away_m = world.task, world.task.required_clearance_m
    floor_m, _ = task.band_amsl_m
    step = task.settings.scan_range_m / 60.0
    axes = [np.arange(low, high, step) for low, high in (task.limits.north_m, task.limits.east_m)]
    north, east = np.meshgrid(*axes, indexing="ij")
    height = world.terrain.height_m(north, east)  # not what the proof of the way uses
    free = height < floor_m - away_m
    free &= distance_transform_edt(height < floor_m) * step > away_m
    for radar in task.radars:
        n, e, z = radar.centre_nea_m
        free &= np.hypot(np.hypot(north - n, east - e), floor_m - z) > radar.range_m
    places = np.stack([north.ravel(), east.ravel(), 0.0 * north.ravel()], axis=-1)
    for zone in task.zones:
        free &= truth.zone_clearance_m(places, zone).reshape(free.shape) > away_m
    pools, _ = label(free)
    start, target = (
        pools[tuple(int(np.argmin(np.abs(a - p))) for a, p in zip(axes, end, strict=True))]
        for end in (world.start_nea_m[:2], world.targets_ne_m[0])
    )
    assert start == target > 0
    assert not drawn_world.is_straight_line_free(world)


def ridge(gap_m: float) -> tuple[Peak, ...]:
    """A wall across the map, open over about gap_m in the middle."""
    away = 0.5 * gap_m + 4_000.0 * math.sqrt(math.log(6_000.0 / 2_500.0)) + 515.0
    return tuple(
        Peak(50_000.0, 50_000.0 + side * (away + step), 6_000.0, 4e3, 4e3)
        for side in (-1, 1)
        for step in np.arange(0.0, 60_000.0, 2_000.0)
    )


@pytest.mark.parametrize(("gap_m", "open_"), [(-3_000.0, False), (800.0, False), (4_000.0, True)])
def test_there_is_a_way_through_a_wall_when_its_gap_is_wide_enough(
    gap_m: float, open_: bool
) -> None:
    terrain = replace(BASE.terrain, peaks=ridge(gap_m))
    watched = Radar(name="r", centre_nea_m=(50_000.0, 50_000.0, 0.0), range_m=9_000.0)
    for radars in ((), (watched,)):
        world = replace(BASE, terrain=terrain, task=replace(BASE.task, radars=radars))
        assert drawn_world.has_way_through(world) is (open_ and not radars)


@EACH
def test_what_is_read_back_is_what_was_drawn(family: str, tmp_path: Path) -> None:
    drawn = families.world(family, 5, 0)
    world_path, mission_path = write(drawn, tmp_path)
    mission, world = load_mission(str(mission_path)), load_world(str(world_path))
    task, limits = mission.task, drawn.task.limits
    assert (task.radars, task.zones) == (drawn.task.radars, drawn.task.zones)
    assert replace(task.settings, position_period_s=0.1) == drawn.task.settings
    assert task.settings.position_period_s in (0.05, 0.1)
    assert mission.targets_ne_m == drawn.targets_ne_m
    assert world.start_ne_m == drawn.start_nea_m[:2]
    for name in limits.__slots__:
        assert getattr(task.limits, name) == pytest.approx(getattr(limits, name), rel=1e-12), name
    rng = np.random.default_rng(1)
    north, east = rng.uniform(*limits.north_m, 3_000), rng.uniform(*limits.east_m, 3_000)
    theirs = read_world(world_path).truth().height_amsl_m(north, east)
    for heights in (world.terrain.height_m(north, east), theirs):
        np.testing.assert_allclose(heights, truth.height_m(drawn.terrain, north, east), atol=1e-3)
