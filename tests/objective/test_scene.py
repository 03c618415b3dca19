import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from planning import limits

from companion.paper.terms import VARIABLES, Scene, control_points
from companion.path.subpath import Pose
from companion.profiles import FLIGHT, PAPER, PROFILES, Weights
from companion.world.clearance import Surface

FloatArray = NDArray[np.float64]

R_M = 2_000.0
LIMITS = limits(ceiling_amsl_m=800.0)
seeds = st.integers(0, 10**6)


def a_scene(seed: int = 0, final_ne_m: tuple[float, float] | None = None) -> Scene:
    rng = np.random.default_rng(seed)
    heading, climb = rng.uniform(-math.pi, math.pi), rng.uniform(-0.15, 0.15)
    tangent = np.array([math.cos(heading), math.sin(heading), math.tan(climb)])
    return Scene(
        samples=10,
        weights=Weights(),
        limits=LIMITS,
        start=Pose(
            position_nea_m=np.append(rng.uniform(3_000, 5_000, 2), 500.0),
            tangent_nea=tangent / np.linalg.norm(tangent),
        ),
        scan_ne_m=(3_900.0, 4_100.0),
        scan_range_m=R_M,
        guide_rad=0.3,
        final_ne_m=final_ne_m,
        safety_distance_m=60.0,
        surface=Surface(north_min_m=0.0, east_min_m=0.0, cell_m=100.0, vertex_m=np.zeros((9, 9))),
        radars=(),
        zones=(),
    )


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
    scene = a_scene()
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
    far = a_scene(final_ne_m=(50_000.0, 50_000.0))
    near = a_scene()
    x = cube(1)
    assert control_points(x, far)[:, :3] == pytest.approx(control_points(x, near)[:, :3])


def test_the_paper_profile_is_the_papers() -> None:
    assert PROFILES == {"paper": PAPER, "flight": FLIGHT}
    assert (PAPER.samples, PAPER.margin, PAPER.optimiser) == (10, 1.0, "improved-de")
    assert not PAPER.verified
    assert FLIGHT.verified
    figure_3a = (0.1, 0.15, 0.15, 0.3, 0.3, 1.0)
    names = ("length", "height", "guide", "crash", "radar", "constraints")
    assert tuple(getattr(Weights(), name) for name in names) == figure_3a
