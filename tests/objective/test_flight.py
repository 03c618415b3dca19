"""Joins and costs of profile `flight` against scipy's splines and a scalar implementation."""

import cmath
import math
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
from companion.world.zones import polygon_at

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


@given(seed=seeds, points=st.sampled_from([5, 6]), is_final=st.booleans())
def test_the_end_lies_within_its_circle_about_p_scan_or_at_the_target_and_free_points_in_their_ring(
    seed: int, points: int, is_final: bool
) -> None:
    """From rest it leaves level in any direction, without a bend."""
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, points=points, is_final=is_final)
    start, (low, high) = scene.start[0], scene.band_amsl_m
    if is_final:
        scene = scene._replace(final_ne_m=(float(start[0] + 300.0), float(start[1] - 400.0)))
    x = cube(rng, scene, 10)
    for each, control in zip(x, control_points(x, scene), strict=True):
        offset = control[-1, :2] - scene.scan_ne_m
        away, unit = float(np.hypot(*offset)), 500.0
        if is_final:
            assert control[-1, :2] == pytest.approx(scene.final_ne_m)
            assert np.linalg.norm(control[1] - start) <= LONGEST_R2 * unit + 1e-6
        else:
            unit = min(1.1 * away, R_M)
            assert SHORTEST_END - 1e-9 <= away / scene.end_radius_m <= 1.0 + 1e-9
            assert abs(azimuth_from_tangent(control, offset)) <= SPREAD_RAD + 1e-9
        for free in control[3:-1, :2] - start[:2]:
            assert SHORTEST_R * unit - 1e-6 <= np.hypot(*free) <= unit + 1e-6
            assert abs(azimuth_from_tangent(control, free)) <= SPREAD_RAD + 1e-9
        assert low - 1e-9 <= control[3:, 2].min() <= control[3:, 2].max() <= high + 1e-9
        if scene.from_rest:
            curve = spline(control)
            assert curve(0.0) == pytest.approx(start)
            leaving = curve(0.0, 1) / np.linalg.norm(curve(0.0, 1))
            bearing = scene.guide_rad + (2.0 * each[3 * points - 9] - 1.0) * math.pi
            assert leaving == pytest.approx([math.cos(bearing), math.sin(bearing), 0.0], abs=1e-9)
            assert np.linalg.norm(curvature_1_m(curve, 0.0)) <= 1e-12


# --- every term, slowly


def terms(x: FloatArray, scene: Scene) -> dict[str, float]:
    """Those of one candidate, (D,), by the source of what is compiled."""
    objective.cost(x, math.inf, scene)
    return dict(zip(TERMS, scene.at.terms.tolist(), strict=True))


def height_m(surface: Surface, points: FloatArray) -> FloatArray:
    """Of a surface below points: world/test_columns.  (..., 3) -> (...)."""
    return surface.altitude_m(points[..., 0], points[..., 1])


def gaps_m(scene: Scene, points: FloatArray) -> FloatArray:
    """Signed distances to all zones; to polygons: world/test_zones.  (K, 3) -> (K, zones)."""
    polygons = [
        [polygon_at(scene.zones, k, n, e, math.inf, math.inf) for n, e, _ in points.tolist()]
        for k in range(len(scene.zones.polygons))
    ]
    circles = [
        sign * (np.hypot(points[:, 0] - north, points[:, 1] - east) - radius)
        for north, east, radius, sign in scene.zones.circles.tolist()
    ]
    return np.array([*polygons, *circles]).reshape(-1, len(points)).T


def over(values: FloatArray, least: float, most: float) -> FloatArray:
    return np.asarray(np.maximum(values - most, 0.0) + np.maximum(least - values, 0.0))


def expected(control: FloatArray, scene: Scene) -> dict[str, float]:
    """The terms of one candidate, from samples of scipy's curve."""
    curve, count, it = spline(control), len(scene.at.flown_m) - 1, scene.motion
    points, first, second = (curve(np.linspace(0.0, 1.0, count + 1), k) for k in range(3))
    steps = np.diff(points, axis=0)
    chords_m = np.linalg.norm(steps, axis=-1)
    thirds = points[:-1, None] + np.array([[1 / 3], [2 / 3], [1.0]]) * steps[:, None]
    thirds, (north, east, up) = thirds.reshape(-1, 3), points[1:].T
    ground = np.hypot(first[:, 0], first[:, 1])
    bend_1_m = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / ground**3
    slope_rad = np.arctan2(first[:, 2], ground)[1:]
    each, per_metre, (low, high) = 10.0 / count, 100.0 / (2.4 * R_M), scene.band_amsl_m

    # a copter is slow in bends: v^2 bend = a, no slower than a quarter of V; a plane is not
    turns_m_s = np.clip(np.sqrt(it.lateral_m_s2 / bend_1_m[1:]), 0.25 * it.speed_m_s, it.speed_m_s)
    slowed_m = 0.0 if it.loiter_m else (chords_m * (it.speed_m_s / turns_m_s - 1.0)).sum()

    crash_m = np.maximum(height_m(scene.surface, thirds) - thirds[:, 2], 0.0).sum() / 3.0
    if not it.loiter_m:  # it circles: the surface knows
        crash_m += 2.0 * dead_man_m(points, first, chords_m, scene)

    radars = np.linalg.norm(points[1:, None] - scene.radars[:, :3], axis=-1)  # eq. 3
    seen = 1.0 / (1.0 + (radars / scene.radars[:, 3]) ** 4)
    seen = np.where(radars <= scene.radars[:, 3] + RADAR_MARGIN_M, seen, 0.0)

    tight = bend_1_m[1:] * LIMITS.turn_radius_m
    climb, dive = LIMITS.climb_angle_rad / scene.margin, LIMITS.dive_angle_rad / scene.margin
    steering = 100.0 * np.clip(tight * scene.margin - 1.0, 0.0, 10.0).sum()
    steering += 100.0 * over(slope_rad, -dive, climb).sum()
    steering += 2.0 * (np.minimum(tight[count - round(count / 4) :], 1.0) ** 2).sum()
    outside = over(up, low, high) + over(north, 1_500.0, 5_500.0) + over(east, 1_500.0, 5_500.0)
    near = np.maximum(scene.clearance_m - gaps_m(scene, thirds), 0.0).sum() / 3.0
    steering += 100.0 * (outside.sum() / (R_M / 20.0) + near / scene.clearance_m)
    short_m = max(1.06 * scene.shortest_m - chords_m.sum(), 0.0)
    return {
        "length": (chords_m.sum() + slowed_m) * per_metre,
        "height": 100.0 * np.maximum(up - low, 0.0).mean() / (high - low),
        "guide": 0.0 if scene.is_final else 20.0 / math.pi * off_guide_rad(control, scene),
        "crash": 100.0 * each * crash_m / scene.safety_distance_m,
        "radar": 30.0 * each * seen.sum(),
        "constraints": each * steering + 1_000.0 * short_m / R_M,
        "to_go": 0.0 if scene.is_final else to_go_m(control, scene) * per_metre,
    }


def dead_man_m(points: FloatArray, first: FloatArray, chords_m: FloatArray, scene: Scene) -> float:
    """How deep stretches of every other sample are below what they must keep, halfway and at last.

    v settling + v^2 / 2 a = what is left; from rest v^2 / 2 a = what was flown.
    """
    it, samples = scene.motion, np.arange(1, len(points), 2)
    left = np.array([chords_m[j:].sum() for j in samples])
    settles = it.braking_m_s2 * it.settling_s
    speed = np.sqrt(settles**2 + 2.0 * it.braking_m_s2 * left) - settles
    if scene.from_rest:
        speed = np.minimum(speed, np.sqrt(2.0 * it.gaining_m_s2 * (chords_m.sum() - left)))
    speed = np.minimum(speed, LIMITS.speed_m_s)
    reach = speed * it.dead_man_s + speed**2 / 2.0 / LIMITS.acceleration_m_s2
    tangent = first[samples] / np.linalg.norm(first[samples], axis=-1)[:, None]
    tangent[:, 2] = np.minimum(tangent[:, 2], 0.0)  # no higher than level
    ends = points[samples] + np.array([0.5, 1.0])[:, None, None] * reach[:, None] * tangent
    return float(np.maximum(height_m(scene.contact, ends) - ends[..., 2], 0.0).sum())


def off_guide_rad(control: FloatArray, scene: Scene) -> float:
    offset = complex(*(control[-1, :2] - scene.scan_ne_m))
    return abs(cmath.phase(offset * cmath.exp(-1j * scene.guide_rad)))


def to_go_m(control: FloatArray, scene: Scene) -> float:
    """The cheapest way from a turn ahead, or from the end; and what is higher or lower there."""
    end, (low, high) = control[-1], scene.band_amsl_m
    ahead = (end - control[-2]) * [1.0, 1.0, 0.0]
    there = end + LIMITS.turn_radius_m * ahead / np.linalg.norm(ahead)
    needed = float(height_m(scene.needed, end))
    above, asked = (max((z - low) / (high - low), 0.0) for z in (end[2], needed))
    down = scene.descent_m * max(above**2 - asked**2, 0.0)
    up = max(needed - end[2], 0.0) / math.tan(LIMITS.climb_angle_rad)
    short = scene.end_radius_m - math.dist(end[:2], scene.scan_ne_m)
    on_m = LIMITS.turn_radius_m + height_m(scene.to_go, there), height_m(scene.to_go, end)
    return float(max(on_m) + down + up + 0.25 * short)


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
        assert table.keys() == slowly.keys()
        for name, value in slowly.items():
            assert table[name] == pytest.approx(value, rel=1e-6, abs=1e-5), name
        by_hand = sum(a * slowly[name] for name, a in zip(TERMS, scene.weights, strict=True))
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
