from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning import limits


def test_limits_cannot_change_in_flight() -> None:
    copter = limits()
    with pytest.raises(FrozenInstanceError):
        copter.speed_m_s = 30.0  # type: ignore[misc]


@given(speed=st.floats(0.0, 300.0), braking=st.floats(0.5, 20.0), flies_on_s=st.floats(0.0, 10.0))
def test_the_dead_man_reach_is_what_a_vehicle_covers_that_flies_on_and_then_brakes(
    speed: float, braking: float, flies_on_s: float
) -> None:
    copter, steps = limits(acceleration_m_s2=braking, dead_man_s=flies_on_s), 4_000
    time_s = (np.arange(steps) + 0.5) * (speed / braking) / steps
    braked_m = (speed - braking * time_s).mean() * speed / braking
    covered_m = speed * flies_on_s + braked_m
    assert copter.reach_m(speed) == pytest.approx(covered_m, rel=1e-5, abs=1e-9)


def test_the_reach_covers_the_54_m_that_arducopter_flew_on_at_10_m_s() -> None:
    # ardupilot.md 3: WPNAV_ACCEL 2.5 m/s2, GUID_TIMEOUT 3 s
    assert 54.0 <= limits(acceleration_m_s2=2.5).reach_m(10.0) <= 60.0
