"""Joins and costs of profile `flight` against scipy's splines and a scalar implementation."""

import cmath
import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning import ARDUCOPTER, BENT, drawn_zones, over, spline, zone_distance_m

from companion import jit, objective
from companion.geodesy import FloatArray
from companion.objective import TERMS, Scene, Workspace, radar_table, rows_of, weights_of
from companion.path.envelope import envelope_of
from companion.path.subpath import Pose
from companion.planner import kernels
from companion.planner.procedure import hover_pose
from companion.profiles import Weights
from companion.world.columns import Surface
from companion.world.radars import Radar
from companion.world.zones import PolygonZone, Zone, near_cells, packed

seeds = st.integers(0, 10**6)

# --- scenes, with everything in them that the objective knows

R_M = 2_000.0
RADAR_MARGIN_M = 250.0
LIMITS = replace(BENT, speed_m_s=60.0)


def random_pose(rng: np.random.Generator) -> Pose:
    """In the middle of the map, in any bend and climb that is not too steep."""
    heading, climb = rng.uniform(-math.pi, math.pi), rng.uniform(-0.2, 0.2)
    tangent = np.array([math.cos(heading), math.sin(heading), climb]) / math.hypot(1.0, climb)
    bend = rng.normal(0.0, 1.0 / 900.0, 3)
    return Pose(
        position_nea_m=np.append(rng.uniform(3_000.0, 4_000.0, 2), rng.uniform(400.0, 600.0)),
        tangent_nea=tangent,
        curvature_nea_1_m=bend - (bend @ tangent) * tangent,
    )


def random_scene(rng: np.random.Generator) -> tuple[Scene, tuple[Zone, ...]]:
    """A scene in which random candidates break every bound now and then, and its zones."""
    from_rest, start = bool(rng.random() < 0.5), random_pose(rng)
    if from_rest:
        start = hover_pose(start.position_nea_m, rng.uniform(-math.pi, math.pi))
    north, east, _ = start.point_nea_m
    weights = rng.uniform(0.05, 1.0, len(fields(Weights))).tolist()
    zones = drawn_zones(rng, int(rng.integers(0, 5)), 3_500.0, 1_500.0, 500.0, 0.3)
    polygons = tuple(zone for zone in zones if isinstance(zone, PolygonZone))
    near = near_cells(polygons, LIMITS.north_m, LIMITS.east_m, 75.0)
    drawn = Weights(**dict(zip(TERMS, weights, strict=False)))
    radars = tuple(
        Radar(name="r", centre_nea_m=(*rng.uniform(2e3, 5e3, 2), 100.0), range_m=1_200.0)
        for _ in range(rng.integers(0, 4))
    )
    flies = LIMITS if rng.random() < 0.8 else replace(LIMITS, loiter_radius_m=80.0)
    motion = envelope_of(flies, ARDUCOPTER)
    if flies.hovers:  # bends that its turn radius allows are slow, too
        motion = motion._replace(lateral_m_s2=2.0)
    scene = Scene(
        weights=weights_of(drawn),
        margin=1.06,
        motion=motion,
        start=rows_of(start),
        from_rest=from_rest,
        shortest_m=0.0 if from_rest else float(rng.choice([200.0, 1_500.0])),
        scan_ne_m=(north + rng.uniform(-300.0, 300.0), east + rng.uniform(-300.0, 300.0)),
        scan_range_m=R_M,
        end_radius_m=1_700.0,
        is_final=bool(rng.random() < 0.3),
        final_ne_m=(north + rng.uniform(-1e3, 1e3), east + 400.0),
        guide_rad=rng.uniform(-math.pi, math.pi),
        to_go=lattice(rng, 100.0, 4_000.0),
        needed=lattice(rng, 90.0, 900.0),
        descent_m=900.0,
        safety_distance_m=60.0,
        clearance_m=75.0,
        surface=lattice(rng, 40.0, 500.0),
        contact=lattice(rng, 40.0, 450.0),
        band_amsl_m=(315.0, 785.0),
        north_m=LIMITS.north_m,
        east_m=LIMITS.east_m,
        radars=radar_table(radars, RADAR_MARGIN_M),
        zones=packed(zones),
        near_polygons=near if rng.random() < 0.5 else near._replace(near=near.near[:0, :0]),
        at=Workspace.of(int(rng.integers(5, 7)), int(rng.choice([12, 13, 40])), len(polygons)),
    )
    return scene, zones


def lattice(rng: np.random.Generator, cell_m: float, most_m: float) -> Surface:
    """A rough surface over most of where candidates come."""
    count = math.ceil(6_000.0 / cell_m)
    south, west = rng.uniform(-100.0, 1_500.0, 2)
    return Surface(
        north_min_m=float(south),
        east_min_m=float(west),
        cell_m=cell_m,
        vertex_m=rng.uniform(0.0, most_m, (count, count + 3)),
    )


def cube(rng: np.random.Generator, scene: Scene, count: int) -> FloatArray:
    """Candidates, some of them on faces and corners of the cube."""
    return np.clip(rng.uniform(-0.15, 1.15, (count, scene.variables)), 0.0, 1.0)


def control_points(x: FloatArray, scene: Scene) -> FloatArray:
    """(P, D) -> (P, points, 3)."""
    return np.array([scene.control_points(each) for each in x])


# --- where control points lie


@settings(max_examples=150)
@given(seed=seeds)
def test_position_tangent_and_curvature_go_on_where_a_subpath_begins(seed: int) -> None:
    """From rest it leaves level in any direction, without a bend."""
    rng = np.random.default_rng(seed)
    scene, _ = random_scene(rng)
    position, ahead, bend_1_m = scene.start
    x = cube(rng, scene, 4)
    for each, control in zip(x, control_points(x, scene), strict=True):
        if scene.from_rest:
            bearing = scene.guide_rad + (2.0 * each[3 * scene.points - 9] - 1.0) * math.pi
            ahead = np.array([math.cos(bearing), math.sin(bearing), 0.0])
        at, first, second = (spline(control)(0.0, order) for order in range(3))
        tangent = first / np.linalg.norm(first)
        assert at == pytest.approx(position, abs=1e-6)
        assert tangent == pytest.approx(ahead, abs=1e-9)
        across = second - (second @ tangent) * tangent
        assert across / (first @ first) == pytest.approx(bend_1_m, abs=1e-9)


# --- every term, slowly


def height_m(surface: Surface, points: FloatArray) -> FloatArray:
    """Of a surface below points: world/test_columns.  (..., 3) -> (...)."""
    return surface.altitude_m(points[..., 0], points[..., 1])


def expected(control: FloatArray, scene: Scene, zones: tuple[Zone, ...]) -> dict[str, float]:
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
    gaps_m = np.array([zone_distance_m(zone, *thirds[:, :2].T) for zone in zones])
    near = np.maximum(scene.clearance_m - gaps_m, 0.0).sum() / 3.0
    steering += 100.0 * (outside.sum() / (R_M / 20.0) + near / scene.clearance_m)
    offset = complex(*(control[-1, :2] - scene.scan_ne_m)) * cmath.exp(-1j * scene.guide_rad)
    short_m = max(1.06 * scene.shortest_m - chords_m.sum(), 0.0)
    return {
        "length": (chords_m.sum() + slowed_m) * per_metre,
        "height": 100.0 * np.maximum(up - low, 0.0).mean() / (high - low),
        "guide": 0.0 if scene.is_final else 20.0 / math.pi * abs(cmath.phase(offset)),
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


@settings(max_examples=40)
@given(seed=seeds)
def test_each_term_is_what_a_scalar_implementation_makes_of_the_curve(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene, zones = random_scene(rng)
    for each in cube(rng, scene, 20):  # compiled, as they take long
        jit.compiled(kernels.costs)(each[None], scene)
        assert all(0.0 <= value < math.inf for value in scene.at.terms)
    x = cube(rng, scene, 2)
    for each, control in zip(x, control_points(x, scene), strict=True):
        slowly, cost = expected(control, scene, zones), objective.cost(each, math.inf, scene)
        table = dict(zip(TERMS, scene.at.terms.tolist(), strict=True))
        assert table == pytest.approx(slowly, rel=1e-6, abs=1e-5)
        by_hand = sum(a * slowly[name] for name, a in zip(TERMS, scene.weights, strict=True))
        assert cost == pytest.approx(by_hand, rel=1e-6)
        for share in (0.0, 0.1, 0.4, 0.8, 0.97, 0.999999, 1.0, 1.000001, 1.5):  # of a bound
            told = objective.cost(each, share * cost, scene)
            assert told == (math.inf if share < 1.0 else cost)


def test_compiled_costs_and_terms_are_those_of_plain_python() -> None:
    compiled = jit.compiled(kernels.costs)
    for seed in range(50):
        rng = np.random.default_rng(seed)
        scene, _ = random_scene(rng)
        x = cube(rng, scene, 10)
        np.testing.assert_allclose(compiled(x, scene), kernels.costs(x, scene), rtol=1e-9)
        terms = scene.at.terms.copy()  # of the last one
        compiled(x, scene)
        np.testing.assert_allclose(scene.at.terms, terms, rtol=1e-9)


def test_the_weights_are_those_of_equation_5_and_what_is_left_to_fly_counts_as_length() -> None:
    weights = dict(zip(TERMS, weights_of(Weights()), strict=True))
    paper = {"length": 0.1, "height": 0.15, "guide": 0.15, "crash": 0.3, "radar": 0.3}
    assert weights == pytest.approx(paper | {"constraints": 1.0, "to_go": 0.1})
