"""Distances and beams among near things against shapely, and woods against their law."""

import math
from typing import Any

import harness
import numpy as np
import pytest
import shapely
from scipy.spatial import cKDTree

from vehicle_sim.geodesy import FloatArray
from vehicle_sim.world import Tree, World, parse_world

GROUND_M = 100.0
Solid = tuple[Any, float]
"""A shapely geometry in north and east, from the ground up to a height."""


def world(**near: Any) -> World:
    return parse_world(harness.world(place=(47.0, 8.0, GROUND_M), **near))


def drawn(seed: int, *peaks: Any) -> tuple[World, list[Solid]]:
    """Random things, and the same as shapely has them."""
    rng, solids = np.random.default_rng(seed), list[Solid]()
    trees, walls, buildings = [], [], []

    def height(shape: Any) -> dict[str, float]:
        """Of a thing of this shape."""
        height_m = float(rng.uniform(3.0, 20.0))
        solids.append((shape, GROUND_M + height_m))
        return {"height_m": height_m}

    for _ in range(30):
        (n, e), radius_m = rng.uniform(-30, 30, 2).tolist(), float(rng.uniform(0.1, 2.0))
        round_m = shapely.Point(n, e).buffer(radius_m, quad_segs=128)
        trees.append({"north_m": n, "east_m": e, "radius_m": radius_m} | height(round_m))
    for _ in range(4):
        points, thick_m = rng.uniform(-30, 30, (3, 2)).tolist(), float(rng.uniform(0.2, 2))
        line = shapely.LineString(points).buffer(thick_m / 2, quad_segs=128)
        walls.append({"points_ne_m": points, "thickness_m": thick_m} | height(line))
    for _ in range(4):
        angles = np.sort(rng.uniform(0, math.tau, 6))
        rays = rng.uniform(2, 12, (6, 1)) * np.stack([np.cos(angles), np.sin(angles)], -1)
        corners = (rng.uniform(-30, 30, 2) + rays).tolist()
        if (shape := shapely.Polygon(corners)).is_valid:
            buildings.append({"corners_ne_m": corners} | height(shape))
    return world(peaks=peaks, trees=trees, walls=walls, buildings=buildings), solids


def away_m(solids: list[Solid], points: FloatArray) -> FloatArray:
    flat = shapely.points(points[:, :2])
    each = [
        np.hypot(shapely.distance(shape, flat), np.maximum(points[:, 2] - top, 0.0))
        for shape, top in solids
    ]
    return np.min(each, axis=0)


@pytest.mark.parametrize("seed", range(4))
def test_distances_are_shapelys(seed: int) -> None:
    made, solids = drawn(seed)
    rng = np.random.default_rng(seed + 100)
    points = rng.uniform([-60, -60, GROUND_M], [60, 60, GROUND_M + 40], (100, 3))
    assert made.scene().distance_m(points) == pytest.approx(away_m(solids, points), abs=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_tilted_beams_end_where_small_steps_first_are_inside_or_in_a_hill(seed: int) -> None:
    hill = {"north_m": 40.0, "east_m": 0.0, "height_amsl_m": GROUND_M + 30.0}
    hill |= {"spread_north_m": 15.0, "spread_east_m": 20.0}
    made, solids = drawn(seed, hill)
    ways = np.random.default_rng(seed + 300).normal(size=(12, 3)) * [1.0, 1.0, 0.4]
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    eye = np.array([0.0, 0.0, GROUND_M + 22.0])  # above all roofs: beams come down on them
    found, steps = made.scene().ray_lengths_m(eye, ways, 60.0), np.arange(0.0, 60.0, 0.02)
    shapely.prepare([shape for shape, _ in solids])
    for way, length in zip(ways, found, strict=True):
        points = eye + steps[:, None] * way
        inside = points[:, 2] < made.truth().height_amsl_m(points[:, 0], points[:, 1])
        for shape, top in solids:
            inside |= (points[:, 2] <= top) & shapely.contains_xy(shape, *points[:, :2].T)
        first = steps[inside.argmax()] if inside.any() else math.inf
        assert length == pytest.approx(first, abs=0.05) or length > 59.9


def test_a_wire_is_touched_and_not_seen() -> None:
    made = world(wires=[{"ends_ne_m": [[10.0, -5.0], [10.0, 5.0]], "height_m": 8.0}]).scene()
    at = np.array([0.0, 0.0, GROUND_M + 8.0])
    assert made.distance_m(at) == pytest.approx(9.99)
    assert made.distance_m(at + np.array([10.0, 0.0, 0.005])) == 0.0
    assert np.isinf(made.ray_lengths_m(at, np.array([[1.0, 0.0, 0.0]]), 40.0)).all()
    assert np.isinf(world().scene().distance_m(at)).all()  # without things nothing is near


# --- woods ----------------------------------------------------------------------------------------

WOOD: dict[str, Any] = {
    "seed": 7,
    "clearing_share": 0.1,
    "clearings": [{"north_m": 50.0, "east_m": 60.0, "radius_m": 15.0}],
}
WOOD |= {"north_min_m": -20.0, "north_max_m": 180.0, "east_min_m": 0.0, "east_max_m": 150.0}
WOOD |= {"spacing_m": [4.0, 8.0], "radius_m": [0.2, 0.5], "height_m": [10.0, 20.0]}


def trees_of(made: World | None = None, **changes: Any) -> list[Tree]:
    (wood,) = (made or world(woods=[WOOD | changes])).woods
    return list(wood.trees())


@pytest.mark.parametrize("seed", range(5))
def test_a_wood_is_its_seeds_keeps_its_spacing_and_its_clearings_and_all_are_in_the_scene(
    seed: int,
) -> None:
    made, trees = world(woods=[WOOD]).with_woods_of(seed), trees_of(seed=seed)
    assert trees_of(made) == trees != trees_of(seed=seed + 1)
    places = np.array([(t.north_m, t.east_m) for t in trees])
    assert (places >= [-20.0, 0.0]).all()
    assert (places <= [180.0, 150.0]).all()
    next_m = cKDTree(places).query(places, k=2)[0][:, 1]
    assert next_m.min() >= 4.0
    assert np.quantile(next_m, 0.1) < 5.5  # clumps
    assert np.quantile(next_m, 0.9) > 6.0
    assert np.hypot(*(places - [50.0, 60.0]).T).min() >= 15.0 + 0.2
    assert all(0.2 <= t.radius_m <= 0.5 and 10.0 <= t.height_m <= 20.0 for t in trees)
    counts = [len(trees_of(seed=seed, clearing_share=s, clearings=[])) for s in (0.0, 0.3, 0.6)]
    assert counts == sorted(counts, reverse=True)
    assert counts[2] < 0.6 * counts[0]
    beside = [[t.north_m + t.radius_m + 1.0, t.east_m, GROUND_M + 5.0] for t in trees[::40]]
    assert (made.scene().distance_m(np.array(beside)) <= 1.0 + 1e-9).all()
