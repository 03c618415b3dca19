import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning import limits

from companion.path.subpath import Pose
from companion.planner.join import Offset, begin, step

LIMITS = limits(speed_m_s=10.0, acceleration_m_s2=2.5)
POSE = Pose(position_nea_m=np.array([10.0, 20.0, 30.0]), tangent_nea=np.array([0.6, 0.8, 0.0]))
vectors = st.tuples(*[st.floats(-15.0, 15.0)] * 3)


def test_it_begins_where_the_vehicle_is_and_as_fast() -> None:
    offset = begin((12.0, 21.0, 29.0), (1.0, 2.0, 0.5), POSE, 5.0)
    assert offset.position_nea_m == pytest.approx([2.0, 1.0, -1.0])
    assert offset.velocity_nea_m_s == pytest.approx([-2.0, -2.0, 0.5])
    assert not offset.is_gone
    assert begin(POSE.point_nea_m, (3.0, 4.0, 0.0), POSE, 5.0).is_gone


@settings(max_examples=15)
@given(position=vectors, velocity=vectors, tick_s=st.sampled_from([0.02, 0.05, 0.1, 0.2]))
def test_it_fades_smoothly_within_half_of_the_acceleration(
    position: tuple[float, ...], velocity: tuple[float, ...], tick_s: float
) -> None:
    offset = Offset(position_nea_m=np.array(position), velocity_nea_m_s=np.array(velocity))
    for _ in range(math.ceil(120.0 / tick_s)):
        after = step(offset, tick_s, LIMITS)
        change = np.linalg.norm(after.velocity_nea_m_s - offset.velocity_nea_m_s)
        assert change <= 0.5 * LIMITS.acceleration_m_s2 * tick_s * 1.001
        mean = 0.5 * (after.velocity_nea_m_s + offset.velocity_nea_m_s)
        moved = after.position_nea_m - offset.position_nea_m
        assert np.linalg.norm(moved - tick_s * mean) <= LIMITS.acceleration_m_s2 * tick_s**2
        offset = after
    assert offset.is_gone


def test_at_one_rate_it_is_the_critically_damped_spring() -> None:
    # So near that the fastest rate holds all along: x'' = -2 x' - x from x = 0.2.
    offset = Offset(position_nea_m=np.array([0.2, 0.0, 0.0]))
    for k in range(1, 31):
        offset = step(offset, 0.1, LIMITS)
        t = 0.1 * k
        assert offset.position_nea_m[0] == pytest.approx(0.2 * (1.0 + t) * math.exp(-t))
        assert offset.velocity_nea_m_s[0] == pytest.approx(-0.2 * t * math.exp(-t))


def test_a_vehicle_that_may_accelerate_harder_is_back_sooner() -> None:
    far = Offset(position_nea_m=np.array([40.0, 0.0, 0.0]))
    left = []
    for acceleration in (1.0, 4.0):
        limits, offset = replace(LIMITS, acceleration_m_s2=acceleration), far
        for _ in range(50):
            offset = step(offset, 0.1, limits)
        left.append(float(offset.position_nea_m[0]))
    assert 0.0 <= left[1] < left[0] < 40.0
