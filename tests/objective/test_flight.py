"""Joins and costs of profile `flight` against scipy's splines and a scalar implementation."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from planning import parameter_of, spline
from scenes import LIMITS, R_M, RADAR_MARGIN_M, cube, random_scene

from companion import objective
from companion.geodesy import FloatArray
from companion.objective import (
    LONGEST_R2,
    SHORTEST_END,
    SHORTEST_R,
    SPREAD_RAD,
    TERMS,
    Scene,
    radar_table,
    rows_of,
    weights_of,
)
from companion.path.subpath import Subpath
from companion.profiles import Weights
from companion.world.columns import Surface
from companion.world.radars import Radar
from companion.world.zones import ZoneTable, polygon_at

seeds = st.integers(0, 10**6)


def control_points(x: FloatArray, scene: Scene) -> FloatArray:
    """(P, D) -> (P, points, 3)."""
    return np.array([scene.control_points(each) for each in x])


def curvature_1_m(curve: Any, u: float) -> FloatArray:
    """The curvature vector: |r' x r''| / |r'|^3, across r' in the plane of r' and r''."""
    first, second = curve(u, 1), curve(u, 2)
    cross = np.cross(first, second)
    normal = np.cross(cross, first)
    size = np.linalg.norm(cross) / np.linalg.norm(first) ** 3
    return np.asarray(size * normal / max(np.linalg.norm(normal), 1e-300))


# --- joins


@settings(max_examples=150)
@given(
    seed=seeds,
    before=st.sampled_from([4, 5, 6]),
    after=st.sampled_from([5, 6]),
    is_final=st.booleans(),
)
def test_position_tangent_and_curvature_go_on_across_a_join(
    seed: int, before: int, after: int, is_final: bool
) -> None:
    rng = np.random.default_rng(seed)
    ahead = np.linspace(0.0, 1_800.0, before)
    control = np.stack([ahead, *rng.uniform(-500.0, 500.0, (2, before))], axis=-1)
    control += np.array([3_000.0, 3_000.0, 500.0])
    previous = Subpath(control_nea_m=control)
    start = previous.pose(rng.uniform(0.05, 0.95) * previous.length_m)
    scene = random_scene(rng, points=after, from_rest=False, is_final=is_final)
    scene = scene._replace(start=rows_of(start))
    old = spline(control)
    u = parameter_of(old, start.position_nea_m)
    tangent = old(u, 1) / np.linalg.norm(old(u, 1))
    bend = curvature_1_m(old, u)
    for points in control_points(cube(rng, scene, 4), scene):
        new = spline(points)
        assert np.linalg.norm(new(0.0) - old(u)) <= 1e-6 * R_M
        assert np.linalg.norm(new(0.0, 1) / np.linalg.norm(new(0.0, 1)) - tangent) <= 1e-6
        assert np.linalg.norm(curvature_1_m(new, 0.0) - bend) <= 1e-6 * np.linalg.norm(bend) + 1e-12


# --- where control points may lie


def azimuth_from_tangent(control: FloatArray, offset: FloatArray) -> float:
    t = control[1] - control[0]
    turned = complex(offset[0], offset[1]) / complex(t[0], t[1])
    return math.atan2(turned.imag, turned.real)


@given(seed=seeds, points=st.sampled_from([5, 6]))
def test_the_end_lies_within_its_circle_about_p_scan_and_free_points_in_their_ring(
    seed: int, points: int
) -> None:
    """From rest it leaves level in any direction, without a bend."""
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, points=points, is_final=False)
    (low, high), x = scene.band_amsl_m, cube(rng, scene, 10)
    for each, control in zip(x, control_points(x, scene), strict=True):
        offset = control[-1, :2] - scene.scan_ne_m
        away = float(np.hypot(*offset))
        assert SHORTEST_END - 1e-9 <= away / scene.end_radius_m <= 1.0 + 1e-9
        assert abs(azimuth_from_tangent(control, offset)) <= SPREAD_RAD + 1e-9
        unit = min(1.1 * away, R_M)
        for k in range(3, points - 1):
            offset = control[k, :2] - control[0, :2]
            assert SHORTEST_R * unit - 1e-6 <= np.hypot(*offset) <= unit + 1e-6
            assert abs(azimuth_from_tangent(control, offset)) <= SPREAD_RAD + 1e-9
        assert low - 1e-9 <= control[3:, 2].min() <= control[3:, 2].max() <= high + 1e-9
        if scene.from_rest:
            curve = spline(control)
            assert curve(0.0) == pytest.approx(scene.start[0])
            leaving = curve(0.0, 1) / np.linalg.norm(curve(0.0, 1))
            bearing = scene.guide_rad + (2.0 * each[3 * points - 9] - 1.0) * math.pi
            assert leaving == pytest.approx([math.cos(bearing), math.sin(bearing), 0.0], abs=1e-9)
            assert np.linalg.norm(curvature_1_m(curve, 0.0)) <= 1e-12


@given(seed=seeds, points=st.sampled_from([5, 6]))
def test_the_last_subpath_ends_at_the_target_and_is_no_larger_than_the_way_there(
    seed: int, points: int
) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, points=points, is_final=True)
    start = scene.start[0]
    scene = scene._replace(final_ne_m=(float(start[0] + 300.0), float(start[1] - 400.0)))
    for control in control_points(cube(rng, scene, 10), scene):
        assert control[-1, :2] == pytest.approx(scene.final_ne_m)
        assert np.linalg.norm(control[1] - start) <= LONGEST_R2 * 500.0 + 1e-6
        assert np.hypot(*(control[3:-1, :2] - start[:2]).T).max() <= 500.0 + 1e-6


# --- every term, slowly


def terms(x: FloatArray, scene: Scene) -> dict[str, float]:
    """Those of one candidate, (D,), by the source of what is compiled."""
    objective.cost(x, math.inf, scene)
    return dict(zip(TERMS, scene.at.terms.tolist(), strict=True))


def height_m(surface: Surface, north: float, east: float) -> float:
    """Of a surface there: world/test_columns."""
    return float(surface.altitude_m(np.array([north]), np.array([east]))[0])


def gaps_m(zones: ZoneTable, north: float, east: float) -> list[float]:
    """Signed distances to all zones; to polygons: world/test_zones."""
    polygons = [
        polygon_at(zones, k, north, east, math.inf, math.inf) for k in range(len(zones.polygons))
    ]
    return polygons + [
        sign * (math.dist((north, east), middle) - radius)
        for *middle, radius, sign in zones.circles.tolist()
    ]


def expected(control: FloatArray, scene: Scene) -> dict[str, float]:
    """The terms of one candidate, of those that are told twice."""
    curve, count = spline(control), len(scene.at.flown_m) - 1
    u = [j / count for j in range(count + 1)]
    points = [curve(at) for at in u]
    each = 10.0 / count
    chords = [math.dist(a, b) for a, b in pairwise(points)]
    per_metre = 100.0 / (2.4 * scene.scan_range_m)
    low, high = scene.band_amsl_m
    heights = [max(float(p[2]) - low, 0.0) for p in points[1:]]
    return {
        "length": (sum(chords) + expected_slowed_m(curve, u, chords, scene)) * per_metre,
        "height": 100.0 * sum(heights) / count / (high - low),
        "guide": expected_guide(control, scene),
        "crash": each * expected_crash(curve, u, points, chords, scene),
        "radar": each * 30.0 * sum(expected_detection(p, scene) for p in points[1:]),
        "constraints": each
        * (expected_steering(curve, u[1:], scene) + expected_outside(points, scene))
        + 1_000.0 * max(1.06 * scene.shortest_m - sum(chords), 0.0) / R_M,
        "to_go": expected_to_go_m(control, scene) * per_metre,
    }


def expected_guide(control: FloatArray, scene: Scene) -> float:
    if scene.is_final:
        return 0.0
    offset = complex(*(control[-1, :2] - scene.scan_ne_m))
    turned = offset / complex(math.cos(scene.guide_rad), math.sin(scene.guide_rad))
    return 100.0 * abs(math.atan2(turned.imag, turned.real)) / math.pi * 0.2


def expected_to_go_m(control: FloatArray, scene: Scene) -> float:
    if scene.is_final:
        return 0.0
    heading = math.atan2(*(control[-1, :2] - control[-2, :2])[::-1])
    ahead = LIMITS.turn_radius_m
    there = control[-1, 0] + ahead * math.cos(heading), control[-1, 1] + ahead * math.sin(heading)
    low, high = scene.band_amsl_m
    altitude, needed = control[-1, 2], height_m(scene.needed, control[-1, 0], control[-1, 1])
    above, asked = (max((z - low) / (high - low), 0.0) for z in (altitude, needed))
    down = scene.descent_m * max(above**2 - asked**2, 0.0)
    up = max(needed - altitude, 0.0) / math.tan(LIMITS.climb_angle_rad)
    here_m = height_m(scene.to_go, control[-1, 0], control[-1, 1])
    short = scene.end_radius_m - math.dist(control[-1, :2], scene.scan_ne_m)
    return float(max(ahead + height_m(scene.to_go, *there), here_m) + down + up + 0.25 * short)


def expected_crash(
    curve: Any, u: list[float], points: list[FloatArray], chords: list[float], scene: Scene
) -> float:
    total = 0.0
    for a, b in pairwise(points):
        for share in (1 / 3, 2 / 3, 1.0):
            n, e, z = a + share * (b - a)
            total += max(height_m(scene.surface, n, e) - z, 0.0) / 3.0
    for j in range(1, len(points), 2):
        if scene.motion.loiter_m:
            break  # it circles: the surface knows
        left, flown = sum(chords[j:]), sum(chords[:j])
        it = scene.motion  # v settling + v^2 / 2 a = what is left
        settles = it.braking_m_s2 * it.settling_s
        speed = math.sqrt(settles**2 + 2.0 * it.braking_m_s2 * left) - settles
        rising = math.sqrt(2.0 * it.gaining_m_s2 * flown) if scene.from_rest else math.inf
        speed = min(LIMITS.speed_m_s, speed, rising)
        reach = speed * scene.motion.dead_man_s + speed**2 / 2.0 / LIMITS.acceleration_m_s2
        tangent = curve(u[j], 1) / np.linalg.norm(curve(u[j], 1))
        tangent[2] = min(tangent[2], 0.0)  # no higher than level
        for share in (0.5, 1.0):
            n, e, z = points[j] + share * reach * tangent
            total += 2.0 * max(height_m(scene.contact, n, e) - z, 0.0)
    return 100.0 * total / scene.safety_distance_m


def expected_detection(point: FloatArray, scene: Scene) -> float:
    """Eq. 3."""
    total = 0.0
    for *centre, range_m, _ in scene.radars.tolist():
        d = math.dist(point, centre)
        if d <= range_m + RADAR_MARGIN_M:
            total += range_m**4 / (range_m**4 + d**4)
    return total


def expected_steering(curve: Any, u: list[float], scene: Scene) -> float:
    climb, dive = (
        angle / scene.margin for angle in (LIMITS.climb_angle_rad, LIMITS.dive_angle_rad)
    )
    total = 0.0
    for k, at in enumerate(u):
        v, a = curve(at, 1), curve(at, 2)
        ground = math.hypot(v[0], v[1])
        bend = abs(v[0] * a[1] - v[1] * a[0]) / ground**3 * LIMITS.turn_radius_m
        total += 100.0 * min(max(bend * scene.margin - 1.0, 0.0), 10.0)
        slope = math.atan(v[2] / ground)
        total += 100.0 * (max(slope - climb, 0.0) + max(-slope - dive, 0.0))
        if k >= len(u) - round(len(u) / 4):
            total += 2.0 * min(bend, 1.0) ** 2
    return total


def expected_slowed_m(curve: Any, u: list[float], chords: list[float], scene: Scene) -> float:
    """As a copter is slow in bends: v^2 bend = a, no slower than a quarter of V."""
    motion, lost_m = scene.motion, 0.0
    if motion.loiter_m > 0.0:
        return 0.0  # a plane flies its circles at V
    for at, chord_m in zip(u[1:], chords, strict=True):
        v, a = curve(at, 1), curve(at, 2)
        bend = abs(v[0] * a[1] - v[1] * a[0]) / math.hypot(v[0], v[1]) ** 3
        speed = math.sqrt(motion.lateral_m_s2 / bend)
        speed = min(max(speed, 0.25 * motion.speed_m_s), motion.speed_m_s)
        lost_m += chord_m * motion.speed_m_s / speed - chord_m
    return lost_m


def expected_outside(points: list[FloatArray], scene: Scene) -> float:
    low, high = scene.band_amsl_m
    beyond = near = 0.0
    for n, e, z in points[1:]:
        beyond += max(low - z, 0.0, z - high)
        beyond += max(1_500.0 - n, 0.0, n - 5_500.0) + max(1_500.0 - e, 0.0, e - 5_500.0)
    for a, b in pairwise(points):
        for share in (1 / 3, 2 / 3, 1.0):
            n, e, _ = a + share * (b - a)
            gaps = gaps_m(scene.zones, n, e)
            near += sum(max(scene.clearance_m - gap, 0.0) for gap in gaps) / 3.0
    return 100.0 * (beyond / (R_M / 20.0) + near / scene.clearance_m)


@example(seed=44_200)
@settings(max_examples=40)
@given(seed=seeds)
def test_each_term_is_what_a_scalar_implementation_makes_of_the_curve(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, samples=12)
    for each in cube(rng, scene, 20):
        assert all(0.0 <= value < math.inf for value in terms(each, scene).values())
    x = cube(rng, scene, 2)
    for each, control in zip(x, control_points(x, scene), strict=True):
        table, slowly = terms(each, scene), expected(control, scene)
        for name, value in slowly.items():
            assert table[name] == pytest.approx(value, rel=1e-6, abs=1e-5), name
        both = table | slowly
        by_hand = sum(a * both[name] for name, a in zip(TERMS, scene.weights, strict=True))
        cost = objective.cost(each, math.inf, scene)
        assert cost == pytest.approx(by_hand, rel=1e-6)


def test_the_weights_are_those_of_equation_5_and_what_is_left_to_fly_counts_as_length() -> None:
    weights = dict(zip(TERMS, weights_of(Weights()), strict=True))
    paper = {"length": 0.1, "height": 0.15, "guide": 0.15, "crash": 0.3, "radar": 0.3}
    assert weights.items() >= (paper | {"constraints": 1.0, "to_go": 0.1}).items()


# --- how a candidate is looked at


@given(seed=seeds, margins=st.sampled_from([-0.01, 0.01, 0.5, 0.99, 1.01, 1.5]))
def test_a_radar_ends_at_its_range_and_margin(seed: int, margins: float) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, samples=12)
    x = cube(rng, scene, 1)
    objective.cost(x[0], math.inf, scene)
    centre, margin_m = (2_000.0, 2_000.0, 0.0), 2.5
    nearest_m = float(np.linalg.norm(scene.at.curve[0, 1:] - centre, axis=-1).min())
    radar = Radar(name="r", centre_nea_m=centre, range_m=nearest_m - margins * margin_m)
    expected = 1.0 / (1.0 + (nearest_m / radar.range_m) ** 4) if margins < 1.0 else 0.0
    found = objective.detection(scene._replace(radars=radar_table((radar,), margin_m)))
    assert found >= expected * (1.0 - 1e-12)
    assert (found > 0.0) == (margins < 1.0)


@settings(max_examples=60)
@given(seed=seeds, share=st.sampled_from([0.0, 0.1, 0.4, 0.8, 0.97, 0.999999, 1.000001, 1.5]))
def test_beyond_a_bound_the_cost_is_infinite_and_below_it_the_cost(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, samples=12)
    x = cube(rng, scene, 1)[0]
    cost = objective.cost(x, math.inf, scene)
    assert objective.cost(x, share * cost, scene) == (math.inf if share < 1.0 else cost)
    assert objective.cost(x, cost, scene) == cost
