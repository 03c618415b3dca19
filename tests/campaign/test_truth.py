import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from planning import LARGE
from scipy.spatial import cKDTree

from companion.campaign import drawn_world, judge, truth
from companion.world.radars import Radar
from companion.world.terrain import ArrayTerrain, Peak, PeakTerrain
from companion.world.zones import CircleZone, PolygonZone

FloatArray = NDArray[np.float64]

TERRAIN = PeakTerrain(
    peaks=(
        Peak(north_m=0.0, east_m=0.0, height_amsl_m=5_000.0, spread_north_m=4e3, spread_east_m=3e3),
        Peak(north_m=7e3, east_m=2e3, height_amsl_m=3_800.0, spread_north_m=3e3, spread_east_m=5e3),
    ),
    ground_amsl_m=0.0,
)
TASK = drawn_world.bundled("environment-2").task
LIMITS = replace(LARGE, north_m=(-20e3, 20e3), east_m=(-20e3, 20e3),
                 tracking_error_m=15.0, navigation_error_m=0.0)  # fmt: skip


def surface_samples(terrain: PeakTerrain, spacing_m: float) -> FloatArray:
    axis = np.arange(-12e3, 12e3, spacing_m)
    north, east = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    height = np.full(north.shape, terrain.ground_amsl_m)
    for p in terrain.peaks:
        bell = ((north - p.north_m) / p.spread_north_m) ** 2
        bell += ((east - p.east_m) / p.spread_east_m) ** 2
        height = np.maximum(height, p.height_amsl_m * np.exp(-bell))
    return np.stack([north, east, height], axis=-1)


def test_distance_to_the_terrain_is_that_to_the_nearest_of_many_surface_points() -> None:
    spacing_m = 50.0
    samples = surface_samples(TERRAIN, spacing_m)
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-8e3, 10e3, (1_500, 2)), rng.uniform(3e3, 5e3, 1_500)])
    points = points[points[:, 2] > truth.height_m(TERRAIN, points[:, 0], points[:, 1])]
    found = truth.terrain_distance_m(points, TERRAIN, 1_500.0)
    brute = np.minimum(cKDTree(samples).query(points)[0], 1_500.0)
    assert np.all(found <= brute + 1e-3)  # every surface sample is at least as far as the nearest
    too_far = np.sqrt(found**2 + spacing_m**2)  # a sample lies within half a diagonal of the foot
    assert np.all(brute <= too_far + 3.0)
    assert np.sum(found < 1_000.0) > 100


@pytest.mark.parametrize(
    ("height_m", "spread_m", "up_to_m"), [(5_000.0, 4e3, 1_000.0), (150.0, 8.0, 30.0)]
)
def test_the_distance_to_a_round_mountain_or_tower_is_that_in_the_plane_through_its_axis(
    height_m: float, spread_m: float, up_to_m: float
) -> None:
    peak = Peak(north_m=30.0, east_m=-40.0, height_amsl_m=height_m, spread_north_m=spread_m,
                spread_east_m=spread_m)  # fmt: skip
    terrain, rng = PeakTerrain(peaks=(peak,), ground_amsl_m=0.0), np.random.default_rng(2)
    away_m = rng.uniform(0.0, 3.0 * spread_m, 300)
    up_m = height_m * np.exp(-((away_m / spread_m) ** 2)) + rng.uniform(0.0, 2.0 * up_to_m, 300)
    bearing = rng.uniform(0.0, 2.0 * np.pi, 300)
    points = np.stack([30.0 + away_m * np.cos(bearing), away_m * np.sin(bearing) - 40.0, up_m], -1)
    found = truth.terrain_distance_m(points, terrain, up_to_m)
    radius_m = np.linspace(0.0, 4.0 * spread_m, 400_001)
    surface_m = height_m * np.exp(-((radius_m / spread_m) ** 2))
    expected = [
        np.sqrt(np.min((radius_m - r) ** 2 + np.maximum(z - surface_m, 0.0) ** 2))
        for r, z in zip(away_m, up_m, strict=True)
    ]
    np.testing.assert_allclose(found, np.minimum(np.minimum(expected, up_m), up_to_m), atol=2e-3)
    assert np.sum(found < up_to_m) > 50
    under = points - [0.0, 0.0, 2.1 * up_to_m]
    assert (truth.terrain_distance_m(under, terrain, up_to_m) < 0.0).all()


def test_four_control_points_are_a_bezier_curve() -> None:
    p = np.random.default_rng(3).normal(size=(4, 3))
    u = 0.3
    bernstein = [math.comb(3, k) * u**k * (1 - u) ** (3 - k) for k in range(4)]
    np.testing.assert_allclose(truth.spline(p)(u), bernstein @ p, rtol=1e-12)


def test_samples_are_evenly_spaced_and_give_the_length_of_a_straight_line() -> None:
    control = np.array([[0.0, 0, 0], [100, 0, 0], [2_000, 0, 0], [2_100, 0, 0], [9_000, 0, 0]])
    curve = truth.sampled(control, 1.0)
    assert curve.length_m[-1] == pytest.approx(9_000.0, rel=1e-9)
    steps = np.linalg.norm(np.diff(curve.points_nea_m, axis=0), axis=-1)
    np.testing.assert_allclose(steps, 1.0, atol=0.01)


def test_curvature_at_the_start_is_that_of_the_control_polygon() -> None:
    h, r2 = 700.0, 2_000.0  # (2 / 3) h / r2^2: planner-numbers E
    control = np.array([[0.0, 0, 0], [r2, 0, 0], [5_000, h, 0], [9_000, 4_000, 0]])
    curve = truth.sampled(control, 10.0)
    assert curve.curvature_1_m[0] == pytest.approx(2.0 / 3.0 * h / r2**2, rel=1e-9)


def test_keep_out_distances_are_those_to_many_points_of_the_edge() -> None:
    corners = ((0.0, 0.0), (4e3, 0.0), (4e3, 3e3), (2e3, 1e3), (0.0, 3e3))
    zone = PolygonZone(name="p", vertices_ne_m=corners)
    edge = np.concatenate(
        [
            np.linspace(a, b, 2_000)
            for a, b in zip(np.array(corners), np.roll(np.array(corners), -1, axis=0), strict=True)
        ]
    )
    points = np.column_stack([np.random.default_rng(4).uniform(-2e3, 6e3, (500, 2)), np.zeros(500)])
    found = truth.keep_out_distance_m(points, zone)
    np.testing.assert_allclose(np.abs(found), cKDTree(edge).query(points[:, :2])[0], atol=3.0)
    assert truth.keep_out_distance_m(np.array([[2e3, 500.0, 0.0]]), zone)[0] < 0.0
    assert truth.keep_out_distance_m(np.array([[2e3, 2.5e3, 0.0]]), zone)[0] > 0.0
    circle = CircleZone(name="c", north_m=0.0, east_m=0.0, radius_m=5.0)
    assert truth.keep_out_distance_m(np.array([[3.0, 4.0, 99.0]]), circle)[0] == 0.0


def test_radar_metres_are_the_chord_through_the_sphere() -> None:
    control = np.array([[x, 600.0, 800.0] for x in np.linspace(-5_000.0, 5_000.0, 4)])
    curve = truth.sampled(control, 1.0)
    radar = Radar(name="r", centre_nea_m=(0.0, 0.0, 0.0), range_m=2_000.0)
    chord = 2.0 * math.sqrt(2_000.0**2 - 1_000.0**2)
    assert truth.radar_m(curve.points_nea_m, (radar,), 10_000.0) == pytest.approx(chord, abs=3.0)


def level(altitude_m: float, *, bend_m: float = 0.0, climb_m: float = 0.0) -> FloatArray:
    return np.array(
        [
            [-15e3, -12e3, altitude_m],
            [-12e3, -12e3, altitude_m],
            [-9e3, -12e3 + bend_m, altitude_m + climb_m],
            [-6e3, -12e3, altitude_m],
        ]
    )


@pytest.mark.parametrize(
    ("control", "names"),
    [
        (level(3_100.0), ()),
        (level(3_010.0), ("floor of the band",)),
        (level(4_990.0), ("ceiling of the band",)),
        (level(3_500.0, bend_m=9_000.0), ("turn radius",)),
        (level(3_500.0, climb_m=2_000.0), ("climb angle", "dive angle")),
        (level(3_100.0) - np.array([0.0, 9e3, 0.0]), ("edge of the map",)),
        (level(3_100.0) + np.array([10e3, 9_800.0, 0.0]), ("terrain clearance",)),
    ],
)
def test_each_broken_bound_is_named(control: FloatArray, names: tuple[str, ...]) -> None:
    task = replace(TASK, limits=LIMITS, zones=())
    assert task.required_clearance_m == 515.0
    assert truth.measure(truth.sampled(control, 1.0), TERRAIN, task).violations(task) == names


CURVE = np.array([[0.0, 0, 3_100], [6e3, 0, 3_100], [9e3, 4e3, 3_400], [12e3, 11e3, 3_300]])
LINE = np.array([[n, 0.0, 3_100.0] for n in (0.0, 3e3, 6e3, 9e3)])


def rest_of(control: FloatArray, at: float) -> FloatArray:
    """De Casteljau: a cubic Bezier curve from there on."""
    rows = [control]
    while len(rows[-1]) > 1:
        rows.append((1 - at) * rows[-1][:-1] + at * rows[-1][1:])
    return np.array([row[-1] for row in rows[::-1]])


def test_a_curve_goes_over_into_its_own_rest_without_a_jump() -> None:
    found = truth.jumps(CURVE, rest_of(CURVE, 0.6), TASK)
    assert found is not None
    assert max(found) < 1e-9
    assert truth.goes_over(CURVE, rest_of(CURVE, 0.6), TASK)


def test_a_join_that_turns_jumps_by_the_angle() -> None:
    rest, angle = rest_of(CURVE, 0.6), 0.01
    turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0]])
    turned = rest[0] + (rest - rest[0]) @ np.vstack([turn, [0.0, 0.0, 1.0]]).T
    position, tangent, _ = truth.jumps(CURVE, turned, TASK) or (1.0, 1.0, 1.0)
    assert position < 1e-12
    along = rest[1] - rest[0]
    level = np.linalg.norm(along[:2]) / np.linalg.norm(along)
    assert tangent == pytest.approx(2.0 * math.sin(0.5 * angle) * level, rel=1e-6)
    assert not truth.goes_over(CURVE, turned, TASK)


def test_a_join_from_a_straight_line_jumps_by_the_curvature_of_the_next() -> None:
    h, r2 = 700.0, 2_000.0
    bent = np.array([[8e3, 0, 3_100], [8e3 + r2, 0, 3_100], [14e3, h, 3_100], [18e3, 4e3, 3_100]])
    position, tangent, curvature = truth.jumps(LINE, bent, TASK) or (1.0, 1.0, 1.0)
    assert max(position, tangent) < 1e-12
    assert curvature == pytest.approx(2_500.0 * 2.0 / 3.0 * h / r2**2, rel=1e-9)


def test_a_join_beside_the_curve_jumps_in_position_and_a_stop_does_not() -> None:
    beside = LINE + np.array([7e3, 2.0, 0.0])
    assert truth.jumps(LINE, beside, TASK)[0] == pytest.approx(2.0 / 20_000.0)
    from_rest = LINE[-1] + (LINE - LINE[0])[:, [1, 0, 2]]  # a right angle, where the first ends
    assert truth.jumps(LINE, from_rest, TASK) is None
    assert truth.goes_over(LINE, from_rest, TASK)


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


def test_only_subpaths_that_follow_each_other_have_to_join() -> None:
    world = drawn_world.bundled("environment-2")
    there = np.array([8e3, 20e3, 3_100.0])
    first, aside = LINE + there, LINE + there + [7e3, 300.0, 0.0]
    alone = judge.checked([first, aside], world)
    joined = judge.checked([first, aside], world, joined=True)
    assert "join" not in str(alone["violated"])
    assert "leg 2: join" in str(joined["violated"])
    assert joined["violations"] == alone["violations"] + (
        str(alone["violated"]).count("leg 2") == 0
    )
