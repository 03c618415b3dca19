import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from companion.path.bspline import (
    climb_angle_rad,
    cubics_of,
    horizontal_curvature_1_m,
    samples_at,
    uniform_basis,
)

FloatArray = NDArray[np.float64]

EXPLICIT_KNOTS = {
    4: [0, 0, 0, 0, 1, 1, 1, 1],
    5: [0, 0, 0, 0, 1 / 2, 1, 1, 1, 1],
    6: [0, 0, 0, 0, 1 / 3, 2 / 3, 1, 1, 1, 1],
    7: [0, 0, 0, 0, 1 / 4, 1 / 2, 3 / 4, 1, 1, 1, 1],
}
every_size = pytest.mark.parametrize("points", EXPLICIT_KNOTS)
seeds = st.integers(0, 10**6)


def control(seed: int, points: int) -> FloatArray:
    return np.random.default_rng(seed).uniform(-1e3, 1e3, (points, 3))


@every_size
@given(seed=seeds)
def test_cubics_and_basis_are_those_of_a_b_spline_with_threefold_ends_and_uniform_inner_knots(
    points: int, seed: int
) -> None:
    polygon = control(seed, points)
    spline = BSpline(np.array(EXPLICIT_KNOTS[points], dtype=float), polygon, 3)
    at, basis = samples_at(cubics_of(polygon), np.linspace(0.0, 1.0, 33)), uniform_basis(32, points)
    for order in range(3):
        expected = spline(np.linspace(0.0, 1.0, 33), order)
        assert at[order] == pytest.approx(expected, abs=1e-7)
        assert basis[order] @ polygon == pytest.approx(expected, abs=1e-7)


@every_size
def test_where_control_points_coincide_the_curve_stands_still_exactly(points: int) -> None:
    polygon = control(1, points)
    polygon[1] = polygon[0]
    assert (cubics_of(polygon)[0, 1] == 0.0).all()


@given(
    radius_m=st.floats(5, 5_000),
    pace=st.floats(0.1, 10),
    climb=st.floats(-3.0, 3.0),
    way=st.sampled_from([-1, 1]),
)
def test_a_helix_turns_at_its_radius_and_climbs_at_its_pitch_at_any_pace(
    radius_m: float, pace: float, climb: float, way: int
) -> None:
    u = pace * np.linspace(0.0, 2.0, 50)
    zero = np.zeros_like(u)
    first = pace * radius_m * np.stack([-np.sin(u), way * np.cos(u), zero + climb], axis=-1)
    second = pace**2 * radius_m * np.stack([-np.cos(u), -way * np.sin(u), zero], axis=-1)
    curvature = horizontal_curvature_1_m(first, second)
    np.testing.assert_allclose(curvature, 1.0 / radius_m, rtol=1e-9)
    np.testing.assert_allclose(climb_angle_rad(first), math.atan(climb), rtol=1e-9)


def test_a_vertical_climb_is_a_right_angle_and_no_turn() -> None:
    up = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0]])
    assert climb_angle_rad(up) == pytest.approx([math.pi / 2, -math.pi / 2])
    assert horizontal_curvature_1_m(up, up) == pytest.approx([0.0, 0.0])
