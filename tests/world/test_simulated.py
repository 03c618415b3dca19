"""What a radar and a sensor of near things show of a world, against points all over it."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from planning import hills

from companion.world.known_map import KnownMap, empty_map
from companion.world.near_map import Kind, NearSensor
from companion.world.simulated import SECTORS, NearScene, Thing, simulated_scan, true_map

CELL_M = 100.0


def blank() -> KnownMap:
    return empty_map(CELL_M, (0.0, 4_000.0), (0.0, 4_000.0))


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6))
def test_the_true_map_holds_the_highest_terrain_of_each_cell_in_whole_metres(seed: int) -> None:
    """And one that is made only where it is looked at is the same."""
    rng = np.random.default_rng(seed)
    low, high = (0, 0, 50, 200, 200), (4_000, 4_000, 1_200, 900, 900)
    terrain = hills(*rng.uniform(low, high, (rng.integers(1, 6), 5)).tolist(), ground_m=30.0)
    truth, south = true_map(terrain, blank()), CELL_M * np.arange(40.0)[:, None]
    highest_m = terrain.highest_in_box_m(south, south + CELL_M, south.T, south.T + CELL_M)
    assert (truth.upper_m == np.ceil(highest_m)).all()
    assert truth.seen.all()
    radar = (*rng.uniform(-500, 4_500, 2), rng.uniform(100, 1_500))
    range_m = rng.uniform(300, 2_500)
    one = simulated_scan(blank(), radar, range_m, terrain)
    other = simulated_scan(truth, radar, range_m)
    assert (one.row, one.column) == (other.row, other.column)
    assert (one.heights_m == other.heights_m).all()


@settings(max_examples=40)
@given(wall=st.integers(5, 15), top_m=st.floats(0.0, 900.0), radar_m=st.floats(50.0, 900.0),
       bend=st.floats(0.5, 5.0), offset=st.floats(-49.0, 49.0))  # fmt: skip
def test_a_wall_hides_just_what_lies_below_the_line_over_its_top_and_a_hollow_slope_nothing(
    wall: int, top_m: float, radar_m: float, bend: float, offset: float
) -> None:
    truth = true_map(hills(), blank())
    truth.upper_m[wall] = top_m
    scan = simulated_scan(truth, (0.5 * CELL_M, 20.5 * CELL_M, radar_m), 3_500.0)
    north, east = truth.middles_m(scan.window)
    out_of_range = np.hypot(north - 50.0, east - 2_050.0) > 3_500.0
    assert np.isneginf(scan.heights_m[out_of_range]).all()
    assert (scan.radar_nea_m == (50.0, 2_050.0, radar_m)).all()
    due_north = scan.heights_m[:, 20 - scan.column]
    for cell in range(wall + 2, 34):  # the march ends a cell before the one it looks at
        line = radar_m + (top_m - radar_m) / wall * cell
        line += cell * (cell - wall) * CELL_M**2 / (2.0 * 6.371e6)  # the earth is round
        if abs(line) > 0.01:
            assert np.isfinite(due_north[cell - scan.row]) == (line <= 0.0)
    truth.upper_m[:] = bend * np.arange(40.0)[:, None] ** 2  # ever more steeply
    scan = simulated_scan(truth, (50.0, 2_050.0 + offset, bend + 50.0), 3_500.0)
    assert np.isfinite(scan.heights_m[:34, 20 - scan.column]).all()


# --- near things


def outline(thing: Thing) -> NDArray[np.float64]:
    """Points of the surface, 5 mm apart, by shapely.  (M, 2)."""
    corners = thing.corners_ne_m
    kind = shapely.LinearRing if thing.closed else shapely.LineString
    line = kind(corners) if len(corners) > 1 else shapely.Point(corners[0])
    if thing.half_width_m > 0.0:
        line = line.buffer(thing.half_width_m, quad_segs=500).boundary
    return shapely.get_coordinates(line.segmentize(0.005))


def drawn(random: np.random.Generator) -> list[Thing]:
    """Trees, walls and houses, none where the sensor is."""
    things = []
    for count in random.choice([1, 1, 2, 3, 4], 6):
        away_m, turn = random.uniform(3.0, 12.0), random.uniform(0.0, math.tau)
        middle = away_m * np.array([math.cos(turn), math.sin(turn)])
        corners = (middle + random.uniform(-1.2, 1.2, (count, 2))).tolist()
        half_m = float(random.uniform(0.0, 0.4))
        things.append(Thing(corners_ne_m=corners, half_width_m=half_m, closed=bool(count == 4)))
    return things


@pytest.mark.parametrize("kind", SECTORS)
@pytest.mark.parametrize("seed", range(8))
def test_each_sector_is_clear_up_to_the_nearest_point_of_all_surfaces(
    kind: Kind, seed: int
) -> None:
    random = np.random.default_rng(seed)
    things, heading_rad = drawn(random), random.uniform(-4.0, 4.0)
    sensor = NearSensor(kind=kind, component_id=1, range_m=8.0, forward_m=0.3, yaw_rad=0.2)
    sweep = NearScene(things).sweep(sensor, 5.0, (0.1, -0.2), heading_rad)
    eye = np.array([0.1 + 0.3 * math.cos(heading_rad), -0.2 + 0.3 * math.sin(heading_rad)])
    assert sweep.sensor_ne_m == pytest.approx(eye)
    middle_rad = sweep.first_rad + 0.5 * sweep.width_rad  # of the first sector: its zero, its nose
    assert middle_rad == pytest.approx(heading_rad + sensor.yaw_rad)
    surface = np.concatenate([outline(thing) for thing in things])
    away = surface - eye
    turned = np.arctan2(away[:, 1], away[:, 0]) - sweep.first_rad
    sector = np.floor(np.remainder(turned, math.tau) / sweep.width_rad).astype(int)
    for k in range(SECTORS[kind]):
        nearest_m = np.hypot(*away[sector == k].T).min(initial=math.inf)
        assert sweep.clear_m[k] == pytest.approx(min(nearest_m, 8.0), abs=0.05)
        assert sweep.clear_m[k] <= nearest_m + 1e-9
        if abs(nearest_m - 8.0) > 0.05:
            assert math.isfinite(sweep.echo_m[k]) is bool(nearest_m < 8.0)
    met = np.isfinite(sweep.echo_m)
    assert sweep.echo_m[met].tolist() == sweep.clear_m[met].tolist()
    points = random.uniform(-14.0, 14.0, (10, 2))  # and how far anything is from a point
    nearest = np.hypot(*(surface[:, None] - points).T).min(axis=1)
    gaps_m = NearScene(things).gaps_m(points)
    inside = gaps_m == 0.0
    assert gaps_m[~inside] == pytest.approx(nearest[~inside], abs=0.01)
    assert (nearest[inside] <= 0.4).all()
    assert NearScene([]).gaps_m(points).tolist() == [math.inf] * 10
