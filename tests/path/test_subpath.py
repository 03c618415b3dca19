import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from planning import parameter_of, spline
from scipy.integrate import quad

from companion.path.subpath import Subpath

FloatArray = NDArray[np.float64]

seeds = st.integers(0, 10**6)
sizes = st.sampled_from([4, 5, 6])


def a_subpath(seed: int, points: int = 4) -> Subpath:
    """Like those of the planner: about 20 km long, without cusps."""
    rng = np.random.default_rng(seed)
    ahead = np.linspace(0.0, 18_000.0, points)
    control = np.stack([ahead, *rng.uniform(-4_000, 4_000, (2, points))], axis=-1)
    return Subpath(control_nea_m=control)


@settings(max_examples=20)
@given(seed=seeds, points=sizes, share=st.floats(0.01, 0.99))
def test_the_pose_is_where_the_curve_is_after_that_length(
    seed: int, points: int, share: float
) -> None:
    subpath = a_subpath(seed, points)
    curve = spline(subpath.control_nea_m)
    pose = subpath.pose(share * subpath.length_m)
    u = parameter_of(curve, pose.position_nea_m)
    knots = [n / (points - 3) for n in range(1, points - 3) if n / (points - 3) < u]
    flown, _ = quad(lambda at: np.linalg.norm(curve(at, 1)), 0.0, u, points=knots, limit=100)
    assert flown == pytest.approx(share * subpath.length_m, rel=1e-6, abs=0.05)
    assert np.linalg.norm(curve(u) - pose.position_nea_m) <= 1e-6 * subpath.length_m


@given(seed=seeds, points=sizes, share=st.floats(0.01, 0.99))
def test_the_curvature_is_the_change_of_the_tangent_with_the_length_flown(
    seed: int, points: int, share: float
) -> None:
    subpath = a_subpath(seed, points)
    at = share * subpath.length_m
    here = subpath.pose(at)
    curve = spline(subpath.control_nea_m)
    u = parameter_of(curve, here.position_nea_m)
    first, second = (curve(u, order) for order in (1, 2))
    cross = np.cross(first, second)
    assert here.tangent_nea == pytest.approx(first / np.linalg.norm(first), abs=1e-9)
    assert here.curvature_nea_1_m @ here.tangent_nea == pytest.approx(0.0, abs=1e-12)
    bend = np.cross(here.tangent_nea, here.curvature_nea_1_m)
    expected = cross / np.linalg.norm(first) ** 3
    assert np.linalg.norm(bend - expected) <= 1e-6 * np.linalg.norm(expected) + 1e-12


@given(seed=seeds, points=sizes, beyond=st.floats(0.0, 1e5))
def test_the_pose_is_clamped_to_the_ends(seed: int, points: int, beyond: float) -> None:
    subpath = a_subpath(seed, points)
    control = subpath.control_nea_m
    assert subpath.pose(-beyond).position_nea_m == pytest.approx(control[0])
    assert subpath.pose(subpath.length_m + beyond).position_nea_m == pytest.approx(control[-1])
    last_leg = control[-1] - control[-2]
    tangent = subpath.pose(subpath.length_m + beyond).tangent_nea
    assert tangent == pytest.approx(last_leg / np.linalg.norm(last_leg))


@pytest.mark.parametrize(
    ("doubled", "where"), [((0, 0, 1, 2), "start"), ((0, 1, 2, 2), "end")], ids=["start", "end"]
)
def test_the_tangent_is_a_direction_even_where_two_control_points_coincide(
    doubled: tuple[int, ...], where: str
) -> None:
    # profile `paper`: r2 may be 0, and f1 drives it there
    corners = np.array([[0.0, 0.0, 0.0], [4_000.0, 3_000.0, 0.0], [8_000.0, 0.0, 0.0]])
    subpath = Subpath(control_nea_m=corners[list(doubled)])
    with np.errstate(all="ignore"):
        tangent = subpath.pose(0.0 if where == "start" else subpath.length_m).tangent_nea
    assert tangent == pytest.approx([0.8, 0.6 if where == "start" else -0.6, 0.0], abs=1e-3)


@given(seed=seeds, spacing_m=st.floats(5.0, 5_000.0))
def test_samples_are_evenly_spaced_and_have_both_ends(seed: int, spacing_m: float) -> None:
    subpath = a_subpath(seed)
    samples = subpath.sampled(spacing_m)
    points = samples.value
    assert points[0] == pytest.approx(subpath.control_nea_m[0])
    assert points[-1] == pytest.approx(subpath.control_nea_m[-1])
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    assert gaps.max() <= spacing_m * 1.01 or len(points) == 3
    assert gaps.max() <= subpath.length_m / (len(points) - 1) * 1.01
    assert len(points) - 1 < subpath.length_m / spacing_m + 2
    lengths_m = np.linspace(0.0, subpath.length_m, len(points))
    for k in range(0, len(points), 9):
        pose, first = subpath.pose(float(lengths_m[k])), samples.first[k]
        assert pose.position_nea_m == pytest.approx(points[k])
        assert pose.tangent_nea == pytest.approx(first / np.linalg.norm(first))
