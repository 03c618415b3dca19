"""The paper's terms and guide for one candidate, with scipy's curve, sampling and graphs."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning import BENT, over, radar, spline, zone_distance_m
from scipy.sparse.csgraph import connected_components

from companion.geodesy import FloatArray
from companion.paper.guide import tangent_guide_rad
from companion.paper.terms import VARIABLES, Scene, control_points, cost, cost_table
from companion.path.subpath import Pose
from companion.planner.settings import PlannerSettings, Task
from companion.profiles import Weights
from companion.world.columns import Surface
from companion.world.radars import Radar
from companion.world.zones import CircleZone, PolygonZone

Place = tuple[float, float]

R_M, D_S_M = 2_000.0, 60.0
RADARS = (
    Radar(name="a", centre_nea_m=(4_500.0, 3_500.0, 0.0), range_m=1_200.0),
    Radar(name="b", centre_nea_m=(3_000.0, 5_000.0, 100.0), range_m=1_500.0),
)
ZONES = (
    CircleZone(name="c", north_m=4_800.0, east_m=4_800.0, radius_m=500.0),
    PolygonZone(name="s", vertices_ne_m=((2e3, 2e3), (2e3, 2.6e3), (2.6e3, 2.6e3), (2.6e3, 2e3))),
)
TASK = Task(
    limits=BENT,
    settings=PlannerSettings(scan_range_m=R_M, safety_distance_m=D_S_M, planning_time_s=1.0),
    radars=RADARS,
    zones=ZONES,
)
RISE_N, RISE_E, BASE_M = 0.05, -0.03, 350.0  # the ground is a plane
_AXIS = -10_000.0 + 100.0 * np.arange(301)
SURFACE = Surface(
    north_min_m=-10_000.0,
    east_min_m=-10_000.0,
    cell_m=100.0,
    vertex_m=BASE_M + RISE_N * _AXIS[:, None] + RISE_E * _AXIS[None, :],
)
seeds = st.integers(0, 10**6)


def a_scene(seed: int, weights: Weights | None = None) -> Scene:
    rng = np.random.default_rng(seed)
    heading, climb = rng.uniform(-math.pi, math.pi), rng.uniform(-0.15, 0.15)
    tangent = np.array([math.cos(heading), math.sin(heading), math.tan(climb)])
    return Scene(
        task=replace(TASK, settings=replace(TASK.settings, weights=weights or Weights())),
        start=Pose(
            position_nea_m=np.append(rng.uniform(3_000, 4_500, 2), 500.0),
            tangent_nea=tangent / np.linalg.norm(tangent),
        ),
        scan_ne_m=(3_600.0, 3_700.0),
        guide_rad=float(rng.uniform(-math.pi, math.pi)),
        final_ne_m=None,
        surface=SURFACE,
    )


# --- the paper's equations for one candidate


def expected(control: FloatArray, scene: Scene) -> dict[str, float]:
    """Every term, for ten samples of the cubic."""
    points = spline(control)(np.linspace(0.0, 1.0, 11))
    north, east, up = points[1:].T
    normal_m = (up - BASE_M - RISE_N * north - RISE_E * east) / math.hypot(1.0, RISE_N, RISE_E)
    radar = 0.0
    for each in RADARS:  # eq. 3
        d = np.linalg.norm(points[1:] - each.centre_nea_m, axis=1)
        detected = each.range_m**4 / (each.range_m**4 + d**4)
        radar += detected[d <= each.range_m].sum()
    outside = over(up, 300.0, 800.0) + over(north, 1_500.0, 5_500.0) + over(east, 1_500.0, 5_500.0)
    gaps_m = np.array([zone_distance_m(zone, north, east) for zone in TASK.zones])
    chords = np.diff(points, axis=0)
    level = chords @ [1.0, 1j, 0.0]
    alpha = np.maximum(np.abs(np.angle(level[1:] / level[:-1])) - math.radians(30.0), 0.0)
    beta = over(np.arctan2(chords[:, 2], np.abs(level)), -0.15, 0.1)
    off = (control[3] - (*scene.scan_ne_m, 0.0)) @ [1.0, 1j, 0.0] / cmath.rect(1.0, scene.guide_rad)
    steering = alpha.sum() + beta.sum() + outside.sum() / (R_M / 20.0)
    return {
        "length": 100.0 * np.linalg.norm(np.diff(control, axis=0), axis=1).sum() / (2.4 * R_M),
        "height": 100.0 * (up.mean() - 300.0) / (800.0 - 300.0),
        "guide": 100.0 * abs(cmath.phase(off)) / math.pi,
        "crash": 100.0 * over(normal_m, D_S_M, math.inf).sum() / D_S_M,  # eq. 2
        "radar": 30.0 * radar,
        "constraints": 100.0 * (steering + over(gaps_m, D_S_M, math.inf).sum() / D_S_M),
    }


@settings(max_examples=30)
@given(seed=seeds)
def test_each_term_is_the_papers_equation_and_their_weighted_sum_the_cost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = ("length", "height", "guide", "crash", "radar", "constraints")
    weights = dict(zip(names, rng.random(6).tolist(), strict=True))
    scene, x = a_scene(seed, Weights(**weights)), rng.random((8, VARIABLES))
    table, costs = cost_table(x, scene), cost(x, scene)
    for row, control in enumerate(control_points(x, scene)):
        by_hand = expected(control, scene)
        assert {name: column[row] for name, column in table.items()} == pytest.approx(
            by_hand, rel=1e-6, abs=1e-6
        )
        total = sum(weights[name] * value for name, value in by_hand.items())
        assert costs[row] == pytest.approx(total, rel=1e-6, abs=1e-6)


@given(seed=seeds, ahead_m=st.sampled_from([None, (300.0, -400.0), (50e3, 50e3)]))
def test_six_variables_are_the_control_points_of_sections_2_4_and_2_5(
    seed: int, ahead_m: tuple[float, float] | None
) -> None:
    scene, target, unit = a_scene(seed), None, R_M
    start, tangent = scene.start.position_nea_m, scene.start.tangent_nea
    if ahead_m is not None:  # the last subpath: no larger than the way that is left
        target, unit = complex(*(start[:2] + ahead_m)), min(R_M, math.hypot(*ahead_m))
        scene = replace(scene, final_ne_m=(target.real, target.imag))
    along = complex(*tangent[:2]) / abs(complex(*tangent[:2]))
    cube = np.random.default_rng(seed).uniform(-0.3, 1.3, (20, VARIABLES)).clip(0.0, 1.0)
    for (r2, r3, phi3, z3, phi4, z4), points in zip(
        cube.tolist(), control_points(cube, scene), strict=True
    ):
        third = complex(*start[:2]) + along * cmath.rect(
            (0.4 + 0.4 * r3) * unit,
            (phi3 - 0.5) * math.pi,  # a ring ahead of p_prog
        )
        on_circle = complex(*scene.scan_ne_m) + along * cmath.rect(R_M, (phi4 - 0.5) * math.pi)
        last = on_circle if target is None else target
        assert points[:2] == pytest.approx(np.array([start, start + 0.4 * r2 * unit * tangent]))
        assert points[2].tolist() == pytest.approx([third.real, third.imag, 300.0 + 500.0 * z3])
        assert points[3].tolist() == pytest.approx([last.real, last.imag, 300.0 + 500.0 * z4])


# --- the guide of section 2.6


def tangent_bearings(s: Place, r: Radar) -> list[float]:
    """Bearings of the two tangent points: where the circle meets Thales' circle over S and O."""
    s_, o = complex(*s), complex(*r.centre_nea_m[:2])
    towards_s, along = (s_ - o) / abs(s_ - o), r.range_m / abs(s_ - o)
    aside = math.sqrt(1.0 - along**2)
    points = [o + r.range_m * towards_s * complex(along, side * aside) for side in (1, -1)]
    return [cmath.phase(p - s_) for p in points]


def brute_force_guide(s: Place, t: Place, radars: list[Radar], overlap_m: float) -> float:
    """Section 2.6 by sampling S-T, a graph of overlaps and Thales' tangent points."""
    straight = math.atan2(t[1] - s[1], t[0] - s[0])
    along = np.linspace(0.0, 1.0, 20_001)
    n, e = s[0] + along * (t[0] - s[0]), s[1] + along * (t[1] - s[1])
    centres = np.array([r.centre_nea_m[:2] for r in radars])
    ranges = np.array([r.range_m for r in radars])
    inside = np.hypot(n - centres[:, :1], e - centres[:, 1:]) < ranges[:, None]
    around = np.hypot(*(centres - s).T) > ranges
    inside &= around[:, None]
    if not inside.any():
        return straight
    first = np.where(inside.any(axis=1), inside.argmax(axis=1), 10**9).argmin()
    apart = np.hypot(*(centres[:, None] - centres[None]).T)
    joined = apart < ranges[:, None] + ranges[None, :] - overlap_m
    joined &= around[:, None] & around[None, :]
    _, label = connected_components(joined, directed=False)
    offsets = [
        math.remainder(bearing - straight, math.tau)
        for k in np.flatnonzero(label == label[first])
        for bearing in tangent_bearings(s, radars[k])
    ]
    left, right = np.clip([min(offsets), max(offsets)], *np.radians([-135.0, 135.0]))
    return straight + (left if abs(left) < abs(right) else right)


@given(
    seed=st.integers(0, 10**6),
    overlap_m=st.sampled_from([0.0, 2_000.0, 6_000.0]),
    turn=st.floats(-3.1, 3.1),
)
def test_the_guide_is_that_of_section_2_6_by_brute_force(
    seed: int, overlap_m: float, turn: float
) -> None:
    rng, way = np.random.default_rng(seed), complex(math.cos(turn), math.sin(turn))

    def place(north: float, east: float) -> Place:
        return (complex(north, east) * way).real, (complex(north, east) * way).imag

    # some about S, some behind it, some beyond T
    around = zip(rng.uniform(-15e3, 115e3, 5), rng.uniform(-30e3, 30e3, 5), strict=True)
    radars = [radar(*place(*at), rng.uniform(3_000, 12_000)) for at in around]
    s, t = place(0.0, rng.uniform(-5e3, 5e3)), place(100e3, rng.uniform(-5e3, 5e3))
    expected = brute_force_guide(s, t, radars, overlap_m)
    found = tangent_guide_rad(s, t, radars, overlap_m)
    assert math.remainder(found - expected, math.tau) == pytest.approx(0.0, abs=1e-9)
