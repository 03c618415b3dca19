"""Every term against the paper's equations for one candidate, with Python's math only."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from planning import limits

from companion.paper.terms import (
    TERMS,
    VARIABLES,
    Scene,
    candidates,
    control_points,
    cost,
    cost_table,
)
from companion.path.subpath import Pose
from companion.profiles import Weights
from companion.world.clearance import Surface
from companion.world.radars import Radar
from companion.world.zones import CircleZone, PolygonZone

FloatArray = NDArray[np.float64]
Point = tuple[float, float, float]

R_M = 2_000.0
D_S_M = 60.0
SAMPLES = 10
LIMITS = limits(
    turn_radius_m=400.0,
    climb_angle_rad=0.1,
    dive_angle_rad=0.15,
    ceiling_amsl_m=800.0,
    north_m=(1_500.0, 5_500.0),
    east_m=(1_500.0, 5_500.0),
)
RADARS = (
    Radar(name="a", centre_nea_m=(4_500.0, 3_500.0, 0.0), range_m=1_200.0),
    Radar(name="b", centre_nea_m=(3_000.0, 5_000.0, 100.0), range_m=1_500.0),
)
CIRCLE = CircleZone(name="c", north_m=4_800.0, east_m=4_800.0, radius_m=500.0)
SQUARE = PolygonZone(
    name="s", vertices_ne_m=((2e3, 2e3), (2e3, 2.6e3), (2.6e3, 2.6e3), (2.6e3, 2e3))
)
#: A plane: the height and the slope of the terrain are known in closed form.
RISE_N, RISE_E, BASE_M = 0.05, -0.03, 350.0

seeds = st.integers(0, 10**6)


def plane_m(north: float, east: float) -> float:
    return BASE_M + RISE_N * north + RISE_E * east


def plane() -> Surface:
    axis = -10_000.0 + 100.0 * np.arange(301)
    return Surface(
        north_min_m=-10_000.0,
        east_min_m=-10_000.0,
        cell_m=100.0,
        vertex_m=BASE_M + RISE_N * axis[:, None] + RISE_E * axis[None, :],
    )


SURFACE = plane()


def a_scene(seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    heading, climb = rng.uniform(-math.pi, math.pi), rng.uniform(-0.15, 0.15)
    tangent = np.array([math.cos(heading), math.sin(heading), math.tan(climb)])
    return Scene(
        samples=SAMPLES,
        weights=Weights(),
        limits=LIMITS,
        start=Pose(
            position_nea_m=np.append(rng.uniform(3_000, 4_500, 2), 500.0),
            tangent_nea=tangent / np.linalg.norm(tangent),
        ),
        scan_ne_m=(3_600.0, 3_700.0),
        scan_range_m=R_M,
        guide_rad=float(rng.uniform(-math.pi, math.pi)),
        final_ne_m=None,
        safety_distance_m=D_S_M,
        surface=SURFACE,
        radars=RADARS,
        zones=(CIRCLE, SQUARE),
    )


# --- the paper's equations for one candidate


def bezier(control: list[Point], u: float) -> Point:
    """Point of a cubic Bezier curve, by its Bernstein form."""
    shares = [(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u * u * (1 - u), u**3]
    n, e, z = (sum(s * p[k] for s, p in zip(shares, control, strict=True)) for k in range(3))
    return n, e, z


def samples(control: list[Point]) -> list[Point]:
    return [bezier(control, j / SAMPLES) for j in range(1, SAMPLES + 1)]


def expected_length(control: list[Point]) -> float:
    return 100.0 * sum(math.dist(control[i], control[i + 1]) for i in range(3)) / (2.4 * R_M)


def expected_height(control: list[Point]) -> float:
    mean = sum(z for _, _, z in samples(control)) / SAMPLES
    return 100.0 * (mean - 300.0) / (800.0 - 300.0)


def expected_guide(control: list[Point], scene: Scene) -> float:
    alpha = (control[3][0] - scene.scan_ne_m[0], control[3][1] - scene.scan_ne_m[1])
    beta = (math.cos(scene.guide_rad), math.sin(scene.guide_rad))
    dot = alpha[0] * beta[0] + alpha[1] * beta[1]
    cross = alpha[0] * beta[1] - alpha[1] * beta[0]
    return 100.0 * abs(math.atan2(cross, dot)) / math.pi


def expected_crash(control: list[Point]) -> float:
    total = 0.0
    for n, e, z in samples(control):
        d = (z - plane_m(n, e)) / math.sqrt(1.0 + RISE_N**2 + RISE_E**2)
        total += (D_S_M - d) / D_S_M if d <= D_S_M else 0.0  # eq. 2
    return 100.0 * total * 10.0 / SAMPLES


def expected_radar(control: list[Point]) -> float:
    total = 0.0
    for radar in RADARS:
        for point in samples(control):
            d = math.dist(point, radar.centre_nea_m)
            if d <= radar.range_m:
                total += radar.range_m**4 / (radar.range_m**4 + d**4)
    return 30.0 * total * 10.0 / SAMPLES


def expected_turning(control: list[Point]) -> float:
    """Eq. 11 without f_v: k1 alpha + k2 beta."""
    points = [bezier(control, j / 10) for j in range(11)]
    chords = [tuple(b[k] - a[k] for k in range(3)) for a, b in pairwise(points)]
    alpha = 0.0
    for a, b in pairwise(chords):
        turn = complex(b[0], b[1]) / complex(a[0], a[1])
        alpha += max(abs(math.atan2(turn.imag, turn.real)) - math.radians(30.0), 0.0)
    slopes = [math.atan2(c[2], math.hypot(c[0], c[1])) for c in chords]
    return 100.0 * (alpha + sum(over(s, 0.1, 0.15) for s in slopes))


def over(angle: float, climb: float, dive: float) -> float:
    return max(angle - climb, 0.0) + max(-angle - dive, 0.0)


def expected_outside(control: list[Point]) -> float:
    total = 0.0
    for n, e, z in samples(control):
        total += max(300.0 - z, 0.0, z - 800.0)
        total += max(1_500.0 - n, 0.0, n - 5_500.0) + max(1_500.0 - e, 0.0, e - 5_500.0)
    return 100.0 * total / (R_M / 20.0) * 10.0 / SAMPLES


def expected_keep_out(control: list[Point]) -> float:
    wanted, total = D_S_M, 0.0
    for n, e, _ in samples(control):
        total += max(wanted - (math.hypot(n - 4.8e3, e - 4.8e3) - 500.0), 0.0)
        aside = max(abs(n - 2.3e3), abs(e - 2.3e3)) - 300.0  # of the square: its inside
        if aside > 0.0:
            aside = math.hypot(max(abs(n - 2.3e3) - 300, 0.0), max(abs(e - 2.3e3) - 300, 0.0))
        total += max(wanted - aside, 0.0)
    return 100.0 * total / wanted * 10.0 / SAMPLES


def expected(control: list[Point], scene: Scene) -> dict[str, float]:
    return {
        "length": expected_length(control),
        "height": expected_height(control),
        "guide": expected_guide(control, scene),
        "crash": expected_crash(control),
        "radar": expected_radar(control),
        "constraints": expected_turning(control)
        + expected_outside(control)
        + expected_keep_out(control),
    }


def as_points(control: FloatArray) -> list[Point]:
    return [(float(n), float(e), float(z)) for n, e, z in control]


# --- the laws


@settings(max_examples=30)
@given(seed=seeds)
def test_each_term_is_the_papers_equation_and_their_weighted_sum_the_cost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    weights = dict(zip(TERMS, rng.random(6).tolist(), strict=True))
    scene, x = replace(a_scene(seed), weights=Weights(**weights)), rng.random((8, 6))
    table, costs = cost_table(x, scene), cost(x, scene)
    assert table.keys() == TERMS.keys()
    for row, control in enumerate(control_points(x, scene)):
        by_hand = expected(as_points(control), scene)
        for name, value in by_hand.items():
            assert table[name][row] == pytest.approx(value, rel=1e-6, abs=1e-6), name
        total = sum(weights[name] * value for name, value in by_hand.items())
        assert costs[row] == pytest.approx(total, rel=1e-6, abs=1e-6)


@given(seed=seeds)
def test_denser_samples_leave_the_scale_of_sums_as_it_is(seed: int) -> None:
    scene = a_scene(seed)
    control = control_points(np.random.default_rng(seed).random((1, 6)), scene)
    coarse, fine = candidates(control, 400), candidates(control, 800)
    for name in ("height", "crash"):
        a, b = float(TERMS[name](coarse, scene)[0]), float(TERMS[name](fine, scene)[0])
        assert a == pytest.approx(b, rel=0.02, abs=2.0)


# --- from six variables to four control points (2.4, 2.5)


def cube(seed: int, count: int = 20) -> FloatArray:
    """Candidates, some of them on faces and corners of the cube."""
    rng = np.random.default_rng(seed)
    return np.clip(rng.uniform(-0.3, 1.3, (count, VARIABLES)), 0.0, 1.0)


def azimuth_from_tangent(scene: Scene, offset: FloatArray) -> float:
    t = scene.start.tangent_nea
    turned = complex(offset[0], offset[1]) / complex(t[0], t[1])
    return math.atan2(turned.imag, turned.real)


@given(seed=seeds)
def test_a_subpath_begins_along_the_tangent_and_ends_on_the_circle_about_p_scan(
    seed: int,
) -> None:
    scene = a_scene(seed)
    for points in control_points(cube(seed), scene):
        assert points[0] == pytest.approx(scene.start.position_nea_m)
        leg = points[1] - points[0]
        along = leg @ scene.start.tangent_nea
        assert leg == pytest.approx(along * scene.start.tangent_nea, abs=1e-6)
        assert -1e-6 <= along <= 0.4 * R_M + 1e-6
        for offset, nearest_m, farthest_m in (
            ((points[2] - points[0])[:2], 0.4 * R_M, 0.8 * R_M),  # a ring ahead of p_prog
            (points[3, :2] - scene.scan_ne_m, R_M, R_M),  # the circle about p_scan
        ):
            assert nearest_m - 1e-6 <= np.hypot(*offset) <= farthest_m + 1e-6
            assert abs(azimuth_from_tangent(scene, offset)) <= math.pi / 2 + 1e-9
        assert 300.0 - 1e-9 <= points[2:, 2].min() <= points[2:, 2].max() <= 800.0 + 1e-9


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_variables_at_0_and_1_are_the_limits_of_section_2_5(end: float) -> None:
    scene = a_scene(0)
    points = control_points(np.full((1, VARIABLES), end), scene)[0]
    r2, r3 = (0.4, 0.8) if end else (0.0, 0.4)
    altitude = 800.0 if end else 300.0
    quarter = math.pi / 2 if end else -math.pi / 2
    assert np.linalg.norm(points[1] - points[0]) == pytest.approx(r2 * R_M)
    assert np.hypot(*(points[2] - points[0])[:2]) == pytest.approx(r3 * R_M)
    assert azimuth_from_tangent(scene, points[2] - points[0]) == pytest.approx(quarter)
    assert azimuth_from_tangent(scene, points[3, :2] - scene.scan_ne_m) == pytest.approx(quarter)
    assert points[2:, 2] == pytest.approx([altitude, altitude])


@given(seed=seeds)
def test_the_last_subpath_ends_at_the_target_and_is_no_larger_than_the_way_there(seed: int) -> None:
    scene = a_scene(seed)
    start = scene.start.position_nea_m
    target = (float(start[0] + 300.0), float(start[1] - 400.0))
    scene = replace(scene, final_ne_m=target)
    for points in control_points(cube(seed), scene):
        assert points[3, :2] == pytest.approx(target)
        assert np.linalg.norm(points[1] - points[0]) <= 0.4 * 500.0 + 1e-6
        assert 0.4 * 500.0 - 1e-6 <= np.hypot(*(points[2] - start)[:2]) <= 0.8 * 500.0 + 1e-6


def test_the_last_subpath_is_never_larger_than_the_scan_range() -> None:
    near = a_scene(0)
    far = replace(near, final_ne_m=(50_000.0, 50_000.0))
    x = cube(1)
    assert control_points(x, far)[:, :3] == pytest.approx(control_points(x, near)[:, :3])
