"""What a campaign takes for true of a curve: against closed forms, shapely and winding numbers."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from planning import LARGE, hills, spline, zone_distance_m
from scipy.optimize import minimize

from companion.campaign import drawn_world, judge, truth
from companion.world.terrain import ArrayTerrain
from companion.world.zones import CircleZone, PolygonZone

FloatArray = NDArray[np.float64]
H_M, R2_M = 700.0, 2_000.0
BEND_1_M = 2.0 / 3.0 * H_M / R2_M**2
"""The curvature that a control polygon begins with: planner-numbers E."""
MOUNTAINS = ((0.0, 0.0, 5_000.0, 4e3, 3e3), (7e3, 2e3, 3_800.0, 3e3, 5e3))
TOWER = ((3.0, -4.0, 150.0, 8.0, 8.0),)
TERRAIN = hills(*MOUNTAINS)
WORLD = drawn_world.bundled("environment-2")
LIMITS = replace(LARGE, north_m=(-20e3, 20e3), east_m=(-20e3, 20e3),
                 tracking_error_m=15.0, navigation_error_m=0.0)  # fmt: skip
COUNTY = CircleZone(name="in", north_m=0.0, east_m=0.0, radius_m=24e3, keep_in=True)
TASK = replace(WORLD.task, limits=LIMITS, zones=(COUNTY,))


def height_m(peaks: FloatArray, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    """Eq. 1: the highest of the mountains, and of the plain."""
    apart = [((north_m - n) / a) ** 2 + ((east_m - e) / b) ** 2 for n, e, _, a, b in peaks]
    heights = [h * np.exp(-far) for (_, _, h, *_), far in zip(peaks, apart, strict=True)]
    return np.asarray(np.maximum.reduce([*heights, 0.0 * north_m]))


def clearance_m(point_nea_m: FloatArray, peaks: FloatArray) -> float:
    """By a grid as wide as the point is above the ground, and a simplex from its nearest place."""
    north_m, east_m, up_m = point_nea_m
    above_m = abs(up_m - float(height_m(peaks, north_m, east_m)))
    if above_m != up_m - height_m(peaks, north_m, east_m):
        return -above_m
    ne = np.array(np.meshgrid(*2 * [np.linspace(-above_m, above_m, 61)])).reshape(2, -1)
    ne += [[north_m], [east_m]]

    def squared_m2(at: FloatArray) -> FloatArray:
        up = height_m(peaks, at[0], at[1]) - up_m
        return np.asarray((at[0] - north_m) ** 2 + (at[1] - east_m) ** 2 + up**2)

    start = ne[:, int(np.argmin(squared_m2(ne)))]
    found = minimize(squared_m2, start, method="Nelder-Mead", options={"xatol": 1e-4 * above_m})
    return math.sqrt(found.fun)


@pytest.mark.parametrize(
    ("peaks", "wide_m", "up_to_m"), [(MOUNTAINS, 12e3, 1e3), (TOWER, 25.0, 30.0)]
)
def test_the_distance_to_mountains_and_towers_is_the_least_to_their_surface(
    peaks: tuple[tuple[float, ...], ...], wide_m: float, up_to_m: float
) -> None:
    rng, table = np.random.default_rng(2), np.array(peaks)
    north_m, east_m = rng.uniform(-wide_m, wide_m, (2, 200))
    up_m = height_m(table, north_m, east_m) + rng.uniform(-0.2, 1.5, 200) * up_to_m
    points = np.stack([north_m, east_m, up_m], axis=-1)
    found = truth.terrain_distance_m(points, hills(*peaks), up_to_m)
    expected = np.minimum([clearance_m(point, table) for point in points], up_to_m)
    under = expected < 0.0
    np.testing.assert_allclose(found[~under], expected[~under], atol=2e-2)
    assert (found[under] < 0.0).all()
    assert np.sum(found < up_to_m) > 50


def test_the_distance_to_an_array_of_heights_is_that_to_its_plane() -> None:
    """A slope of 0.5: the distance is the height over it times cos(atan 0.5)."""
    nodes = 50.0 * np.arange(60.0)
    terrain = ArrayTerrain(heights_m=np.add.outer(0.5 * nodes, 0.0 * nodes), spacing_m=50.0)
    rng = np.random.default_rng(1)
    at = rng.uniform(1_000.0, 2_000.0, (50, 2))
    above = rng.uniform(20.0, 150.0, 50) * np.where(np.arange(50) % 3, 1.0, -1.0)
    points = np.column_stack([at, 0.5 * at[:, 0] + above])
    found = truth.terrain_distance_m(points, terrain, 200.0)
    expected = np.where(above > 0.0, above / math.hypot(1.0, 0.5), above)
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=0.2)
    assert (found >= expected - 1e-6).all()


def test_distances_to_zones_are_those_of_shapely_and_winding_numbers() -> None:
    corners = ((0.0, 0.0), (4e3, 0.0), (4e3, 3e3), (2e3, 1e3), (0.0, 3e3))
    circle = CircleZone(name="c", north_m=0.0, east_m=0.0, radius_m=500.0)
    points = np.random.default_rng(4).uniform(-2e3, 18e3, (500, 3))
    for zone in (PolygonZone(name="p", vertices_ne_m=corners), circle, COUNTY):
        expected = zone_distance_m(zone, points[:, 0], points[:, 1])
        assert truth.zone_clearance_m(points, zone) == pytest.approx(expected, abs=1e-6)
        assert (expected < 0.0).any()


def test_a_sampled_curve_is_its_spline_evenly_spaced_with_its_curvature() -> None:
    p = np.random.default_rng(3).normal(size=(7, 3))
    u = np.linspace(0.0, 1.0, 9)
    np.testing.assert_allclose(truth.spline(p)(u), spline(p)(u), rtol=1e-9, atol=1e-12)
    line = np.array([[0.0, 0, 0], [100, 0, 0], [2_000, 0, 0], [2_100, 0, 0], [9_000, 0, 0]])
    curve = truth.sampled(line, 1.0)
    assert curve.length_m[-1] == pytest.approx(9_000.0, rel=1e-9)
    steps = np.linalg.norm(np.diff(curve.points_nea_m, axis=0), axis=-1)
    np.testing.assert_allclose(steps, 1.0, atol=0.01)
    bent = np.array([[0.0, 0, 0], [R2_M, 0, 0], [5_000, H_M, 0], [9_000, 4_000, 0]])
    curvature_1_m = truth.sampled(bent, 10.0).curvature_1_m[0]
    assert curvature_1_m == pytest.approx(BEND_1_M, rel=1e-9)
    twice = np.array([[0.0, 0, 0], [R2_M, 0, 0], [9_000, 0, 0], [9_000, 1e-13, 0]])
    assert np.abs(truth.sampled(twice, 10.0).curvature_1_m).max() < 1e-9


def level(up_m: float, *, bend_m: float = 0.0, climb_m: float = 0.0) -> FloatArray:
    """A path to the north in the south-west of the map."""
    bent = [-9e3, -12e3 + bend_m, up_m + climb_m]
    return np.array([[-15e3, -12e3, up_m], [-12e3, -12e3, up_m], bent, [-6e3, -12e3, up_m]])


BROKEN: dict[str, FloatArray] = {
    "": level(3_100.0),
    "floor of the band": level(3_010.0),
    "ceiling of the band": level(4_990.0),
    "turn radius": level(3_500.0, bend_m=9_000.0),
    "climb angle, dive angle": level(3_500.0, climb_m=2_000.0),
    "keep-out zone, edge of the map": level(3_100.0) - [0.0, 9e3, 0.0],
    "terrain clearance": np.add(level(3_100.0), (10e3, 9_800.0, 0.0)),
}


@pytest.mark.parametrize("names", BROKEN)
def test_each_broken_bound_is_named(names: str) -> None:
    assert TASK.required_clearance_m == 515.0
    measures = truth.measure(truth.sampled(BROKEN[names], 1.0), TERRAIN, TASK)
    assert ", ".join(measures.violations(TASK)) == names


CURVE = np.array([[0.0, 0, 3_100], [6e3, 0, 3_100], [9e3, 4e3, 3_400], [12e3, 11e3, 3_300]])
LINE = np.array([[n, 0.0, 3_100.0] for n in (0.0, 3e3, 6e3, 9e3)])


def rest_of(control: FloatArray, at: float, *, turned_rad: float = 0.0) -> FloatArray:
    """De Casteljau: a cubic Bezier curve from there on, turned about the vertical there."""
    rows = [control]
    while len(rows[-1]) > 1:
        rows.append((1 - at) * rows[-1][:-1] + at * rows[-1][1:])
    rest = np.array([row[-1] for row in rows[::-1]])
    cos, sin = math.cos(turned_rad), math.sin(turned_rad)
    return rest[0] + (rest - rest[0]) @ [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]


AWAY, ACROSS = np.array([7e3, 0.0, 0.0]), (LINE - LINE[0])[:, [1, 0, 2]]
BENT = np.array([[8e3, 0, 3_100], [8e3 + R2_M, 0, 3_100], [14e3, H_M, 3_100], [18e3, 4e3, 3_100]])
JOINS: dict[str, tuple[FloatArray, Any, bool]] = {
    # the least that jumps is 1e-6: of R, of a radian, of the tightest bend
    "its own rest": (CURVE, rest_of(CURVE, 0.6), True),
    "turned": (CURVE, rest_of(CURVE, 0.6, turned_rad=2e-6), False),
    "turned by nothing much": (CURVE, rest_of(CURVE, 0.6, turned_rad=5e-7), True),
    "bent": (LINE, BENT, False),
    "bent by nothing much": (LINE, BENT * [1.0, 1e-6, 1.0], True),
    "beside": (LINE, LINE + AWAY + [0.0, 0.04, 0.0], False),  # 2e-6 of 20 km
    "beside by nothing much": (LINE, LINE + AWAY + [0.0, 0.01, 0.0], True),
    # a right angle, where the first ends: from rest
    "a stop": (LINE, LINE[-1] + ACROSS, True),
    "a right angle before the end": (LINE, LINE[-1] - AWAY + ACROSS, False),
}


@pytest.mark.parametrize("join", JOINS)
def test_a_curve_goes_over_into_one_that_leaves_it_in_place_direction_and_bend_as_they_are(
    join: str,
) -> None:
    first, second, goes_over = JOINS[join]
    assert truth.goes_over(first, second, WORLD.task) is goes_over


def test_only_subpaths_that_follow_each_other_have_to_join() -> None:
    there = np.array([8e3, 20e3, 3_100.0])
    subpaths = [(LINE + there, None), (LINE + there + [7e3, 300.0, 0.0], None)]
    for joined in (False, True):
        found = judge.checked(subpaths, WORLD, joined=joined)
        assert ("leg 2: join" in str(found["violated"])) is joined


def test_a_leg_may_bend_as_much_as_the_speed_that_it_is_proven_for_allows() -> None:
    """At half of V a copter turns with a quarter of its radius."""
    turn = np.linspace(0.0, 1.0, 40)
    arc = np.column_stack([np.sin(turn), 1.0 - np.cos(turn), 0.0 * turn])
    arc = 0.5 * WORLD.task.limits.turn_radius_m * arc + [8e3, 20e3, 3_100.0]
    for speed_m_s, violated in ((None, "leg 1: turn radius"), (75.0, None)):
        assert judge.checked([(arc, speed_m_s)], WORLD)["violated"] == violated
