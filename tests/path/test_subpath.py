"""Curves and the poses on them, against scipy's B-splines and integrals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning import parameter_of, spline
from scipy.integrate import quad

from companion.path.subpath import Subpath, cubics_of, samples_at, uniform_basis

seeds, sizes, shares = st.integers(0, 10**6), st.sampled_from([4, 5, 6]), st.floats(0.01, 0.99)


@pytest.mark.parametrize("points", range(4, 8))
@given(seed=seeds)
def test_cubics_and_basis_are_those_of_a_b_spline_with_threefold_ends_and_uniform_inner_knots(
    points: int, seed: int
) -> None:
    polygon = np.random.default_rng(seed).uniform(-1e3, 1e3, (points, 3))
    curve = spline(polygon)
    at, basis = samples_at(cubics_of(polygon), np.linspace(0.0, 1.0, 33)), uniform_basis(32, points)
    for order in range(3):
        expected = curve(np.linspace(0.0, 1.0, 33), order)
        assert at[order] == pytest.approx(expected, abs=1e-7)
        assert basis[order] @ polygon == pytest.approx(expected, abs=1e-7)
    polygon[1] = polygon[0]  # where control points coincide it stands still exactly
    assert (cubics_of(polygon)[0, 1] == 0.0).all()


def a_subpath(seed: int, points: int) -> Subpath:
    """Like those of the planner: about 20 km long, without cusps."""
    ahead = np.linspace(0.0, 18_000.0, points)
    aside = np.random.default_rng(seed).uniform(-4_000, 4_000, (2, points))
    return Subpath(control_nea_m=np.stack([ahead, *aside], axis=-1))


@settings(max_examples=25)
@given(seed=seeds, points=sizes, share=shares)
def test_the_pose_is_where_the_curve_is_after_that_length_with_its_tangent_and_curvature(
    seed: int, points: int, share: float
) -> None:
    subpath = a_subpath(seed, points)
    curve, pose = spline(subpath.control_nea_m), subpath.pose(share * subpath.length_m)
    u = parameter_of(curve, pose.position_nea_m)
    knots = [n / (points - 3) for n in range(1, points - 3) if n / (points - 3) < u]
    flown, _ = quad(lambda at: np.linalg.norm(curve(at, 1)), 0.0, u, points=knots, limit=100)
    assert flown == pytest.approx(share * subpath.length_m, rel=1e-6, abs=0.05)
    assert np.linalg.norm(curve(u) - pose.position_nea_m) <= 1e-6 * subpath.length_m
    longer = [subpath.is_longer_than(k * subpath.length_m) for k in (share, 1 - 1e-6, 1 + 1e-6, 2)]
    assert longer == [True, True, False, False]
    for beyond_m in (0.0, 1.0, 1e5):  # it is clamped to the ends
        ends = subpath.pose(-beyond_m), subpath.pose(subpath.length_m + beyond_m)
        for end, at in zip(ends, (0.0, 1.0), strict=True):
            ahead = curve(at, 1) / np.linalg.norm(curve(at, 1))
            assert end.position_nea_m == pytest.approx(curve(at))
            assert end.tangent_nea == pytest.approx(ahead)
    first, second = (curve(u, order) for order in (1, 2))
    assert pose.tangent_nea == pytest.approx(first / np.linalg.norm(first), abs=1e-9)
    assert pose.curvature_nea_1_m @ pose.tangent_nea == pytest.approx(0.0, abs=1e-12)
    bend = np.cross(pose.tangent_nea, pose.curvature_nea_1_m)
    expected = np.cross(first, second) / np.linalg.norm(first) ** 3
    assert np.linalg.norm(bend - expected) <= 1e-6 * np.linalg.norm(expected) + 1e-12


@pytest.mark.parametrize(("doubled", "east"), [((0, 0, 1, 2), 0.6), ((0, 1, 2, 2), -0.6)])
def test_the_tangent_is_a_direction_even_where_two_control_points_coincide(
    doubled: tuple[int, ...], east: float
) -> None:
    # profile `paper`: r2 may be 0, and f1 drives it there
    corners = np.array([[0.0, 0.0, 0.0], [4_000.0, 3_000.0, 0.0], [8_000.0, 0.0, 0.0]])
    subpath = Subpath(control_nea_m=corners[list(doubled)])
    with np.errstate(all="ignore"):
        tangent = subpath.pose(0.0 if east > 0.0 else subpath.length_m).tangent_nea
    assert tangent == pytest.approx([0.8, east, 0.0], abs=1e-3)


@given(seed=seeds, spacing_m=st.floats(5.0, 5_000.0))
def test_samples_are_evenly_spaced_and_have_both_ends(seed: int, spacing_m: float) -> None:
    subpath = a_subpath(seed, 4)
    samples = subpath.sampled(spacing_m)
    points, length_m = samples.value, subpath.length_m
    assert points[[0, -1]] == pytest.approx(subpath.control_nea_m[[0, -1]])
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    assert gaps.max() <= spacing_m * 1.01 or len(points) == 3
    assert gaps.max() <= length_m / (len(points) - 1) * 1.01
    assert len(points) - 1 < length_m / spacing_m + 2
    for k in range(0, len(points), 9):
        pose, first = subpath.pose(length_m * k / (len(points) - 1)), samples.first[k]
        assert pose.position_nea_m == pytest.approx(points[k])
        assert pose.tangent_nea == pytest.approx(first / np.linalg.norm(first))
