"""What a simulated near sensor shows, against points all over the surfaces of things."""

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.world.near_map import Kind, NearSensor
from companion.world.simulated_sweep import SECTORS, NearScene, Thing

_STEP_M = 0.005


def outline(thing: Thing) -> NDArray[np.float64]:
    """Points of the surface, and some inside of it, 5 mm apart.  (M, 2)."""
    corners = [*thing.corners_ne_m, *thing.corners_ne_m[: 1 if thing.closed else 0]]
    lines = [np.array(corners[:1])]
    for a, b in pairwise(corners):
        share = np.linspace(0.0, 1.0, math.ceil(math.dist(a, b) / _STEP_M) + 2)[:, None]
        along = np.subtract(b, a) / max(math.dist(a, b), 1e-9)
        left = thing.half_width_m * np.array([-along[1], along[0]])
        middle = np.array(a) * (1.0 - share) + np.array(b) * share
        lines += [middle + left, middle - left]
    turn = np.linspace(0.0, math.tau, math.ceil(math.tau * thing.half_width_m / _STEP_M) + 2)
    rim = thing.half_width_m * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return np.concatenate([*lines, *(np.array(corner) + rim for corner in corners)])


def drawn(random: np.random.Generator) -> list[Thing]:
    """Trees, walls and houses, none where the sensor is."""
    things = []
    for count in random.choice([1, 1, 2, 3, 4], 6):
        away_m, turn = random.uniform(3.0, 12.0), random.uniform(0.0, math.tau)
        middle = away_m * np.array([math.cos(turn), math.sin(turn)])
        corners = middle + random.uniform(-1.2, 1.2, (count, 2))
        half_width_m, closed = float(random.uniform(0.0, 0.4)), bool(count == 4)
        things.append(
            Thing(corners_ne_m=corners.tolist(), half_width_m=half_width_m, closed=closed)
        )
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
    away = np.concatenate([outline(thing) for thing in things]) - eye
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


def test_the_first_sector_has_the_nose_in_its_middle() -> None:
    post = NearScene([Thing(corners_ne_m=[(0.0, 5.0)], half_width_m=0.1)])  # east
    sensor = NearSensor(kind="distance_sensor", component_id=1, range_m=8.0)
    sweep = post.sweep(sensor, 0.0, (0.0, 0.0), 0.5 * math.pi)
    assert np.flatnonzero(np.isfinite(sweep.echo_m)).tolist() == [0]
    assert sweep.echo_m[0] == pytest.approx(4.9)


@pytest.mark.parametrize("seed", range(4))
def test_gaps_are_those_to_the_nearest_point_of_all_surfaces(seed: int) -> None:
    random = np.random.default_rng(seed)
    things, points = drawn(random), random.uniform(-14.0, 14.0, (40, 2))
    surface = np.concatenate([outline(thing) for thing in things])
    nearest_m = np.hypot(*(surface[:, None] - points).T).min(axis=1)
    gaps_m = NearScene(things).gaps_m(points)
    inside = gaps_m == 0.0
    assert gaps_m[~inside] == pytest.approx(nearest_m[~inside], abs=0.01)
    assert (nearest_m[inside] <= 0.4).all()
    assert NearScene([]).gaps_m(points).tolist() == [math.inf] * 40
