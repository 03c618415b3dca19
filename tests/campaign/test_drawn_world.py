import math
from dataclasses import replace

import numpy as np
import pytest

from companion.campaign import drawn_world, families
from companion.campaign.truth import height_m
from companion.config import bundled, load_world
from companion.world.radars import Radar
from companion.world.terrain import Peak


def test_the_fingerprint_follows_what_the_optimum_depends_on() -> None:
    world = families.world("dense", 0, 0)
    limits = replace(world.task.limits, turn_radius_m=2_600.0)
    changed = replace(world, task=replace(world.task, limits=limits))
    assert changed.fingerprint != world.fingerprint


@pytest.mark.parametrize("number", range(20))
def test_dense_worlds_have_the_promised_obstacles_and_free_ends(number: int) -> None:
    world = families.world("dense", 0, number)
    assert 12 <= len(world.terrain.peaks) <= 28
    assert 10 <= len(world.task.radars) <= 14
    for end in (world.start_nea_m, (*world.targets_ne_m[0], world.floor_amsl_m)):
        height = world.terrain.height_m(np.array([end[0]]), np.array([end[1]]))[0]
        assert height < world.floor_amsl_m - 2.0 * world.task.required_clearance_m
        for radar in world.task.radars:
            assert math.dist(end, radar.centre_nea_m) > radar.range_m
    line = np.linspace(world.start_nea_m, (*world.targets_ne_m[0], world.floor_amsl_m), 3_000)
    over = line[:, 2] - world.terrain.height_m(line[:, 0], line[:, 1])
    seen = [np.linalg.norm(line - r.centre_nea_m, axis=-1) < r.range_m for r in world.task.radars]
    assert np.any(over < 1.5 * world.task.required_clearance_m) or np.any(seen)


def ridge(gap_m: float) -> tuple[Peak, ...]:
    """A wall across the map, open over about gap_m in the middle."""
    away = 0.5 * gap_m + 4_000.0 * math.sqrt(math.log(6_000.0 / 2_500.0)) + 515.0
    return tuple(
        Peak(
            north_m=50_000.0,
            east_m=50_000.0 + side * (away + step),
            height_amsl_m=6_000.0,
            spread_north_m=4_000.0,
            spread_east_m=4_000.0,
        )
        for side in (-1, 1)
        for step in np.arange(0.0, 60_000.0, 2_000.0)
    )


@pytest.mark.parametrize(("gap_m", "open_"), [(-3_000.0, False), (800.0, False), (4_000.0, True)])
def test_there_is_a_way_through_a_wall_when_its_gap_is_wide_enough(
    gap_m: float, open_: bool
) -> None:
    base = families.world("dense", 0, 0)
    terrain = replace(base.terrain, peaks=ridge(gap_m))
    world = replace(base, terrain=terrain, task=replace(base.task, radars=()))
    assert families.has_way(world) is open_
    watched = Radar(name="r", centre_nea_m=(50_000.0, 50_000.0, 0.0), range_m=9_000.0)
    closed = replace(world, task=replace(world.task, radars=(watched,)))
    assert not families.has_way(closed)


def test_the_lowest_safe_altitude_over_a_summit_is_the_clearance_above_it() -> None:
    base = families.world("dense", 0, 0)
    summit = Peak(
        north_m=50_000.0,
        east_m=50_000.0,
        height_amsl_m=4_000.0,
        spread_north_m=5e3,
        spread_east_m=5e3,
    )
    world = replace(base, terrain=replace(base.terrain, peaks=(summit,)))
    need = drawn_world.lowest_safe_m(world, 250.0, 500.0)
    assert need[220, 220] == 4_500.0  # -5 km + 220 cells: the summit, the centre of curvature below
    assert need[0, 0] == pytest.approx(500.0, abs=0.1)


@pytest.mark.parametrize("count", [10, 100, 1_000, 10_000])
def test_growing_worlds_keep_their_density_and_the_length_of_the_way(count: int) -> None:
    world = families.world("spread", 0, count)
    obstacles = np.array(places(world))
    assert len(obstacles) == count
    assert np.abs(obstacles).max() <= 500.0 * math.sqrt(count / 0.004) + 5.0
    inner = np.sum(np.abs(obstacles).max(axis=1) <= 500.0 * math.sqrt(0.1 * count / 0.004) + 5.0)
    assert inner == pytest.approx(0.1 * count, abs=1 + 0.002 * count)
    way_m = math.dist(world.start_nea_m[:2], world.targets_ne_m[0])
    assert way_m == pytest.approx(40_000.0 * math.sqrt(2.0))


def places(world: drawn_world.DrawnWorld) -> list[tuple[float, float]]:
    found = [(p.north_m, p.east_m) for p in world.terrain.peaks]
    return found + [r.centre_nea_m[:2] for r in world.task.radars]


def test_a_growing_world_holds_the_smaller_one_unchanged() -> None:
    small, large = families.world("spread", 0, 10), families.world("spread", 0, 1_000)
    assert set(places(small)) <= set(places(large))
    near = [place for place in places(large) if max(map(abs, place)) < 24_990.0]
    assert sorted(near) == sorted(places(small))
    assert set(places(families.world("spread", 1, 10))).isdisjoint(places(small))


@pytest.mark.parametrize("name", bundled())
def test_every_bundled_world_can_be_drawn_and_has_its_own_heights(name: str) -> None:
    drawn, terrain = drawn_world.bundled(name), load_world(name).terrain
    (south, north), (west, east) = drawn.task.limits.north_m, drawn.task.limits.east_m
    for share in (0.2, 0.5, 0.7):
        place = south + share * (north - south), west + share * (east - west)
        north_m, east_m = (np.array([value]) for value in place)
        [found], [expected] = (
            height_m(drawn.terrain, north_m, east_m),
            terrain.height_m(north_m, east_m),
        )
        assert found == pytest.approx(expected, abs=3.0)


def test_no_map_has_more_cells_than_a_mission_may_have() -> None:
    task = families.world("spread", 0, 10_000).task
    cells = (task.limits.north_m[1] - task.limits.north_m[0]) / task.cell_m
    assert 4_900 < cells <= 5_000
