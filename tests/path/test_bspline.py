import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from companion.path.bspline import cubics_of, samples_at, uniform_basis

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
