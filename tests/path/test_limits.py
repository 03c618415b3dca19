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


@given(
    left=st.floats(0.0, 500.0),
    braking=st.floats(0.5, 20.0),
    flies_on_s=st.floats(0.0, 10.0),
    overrun=st.floats(0.0, 100.0),
)
def test_the_braked_speed_is_the_highest_that_keeps_both_the_end_and_the_overrun(
    left: float, braking: float, flies_on_s: float, overrun: float
) -> None:
    copter = limits(acceleration_m_s2=braking, dead_man_s=flies_on_s)

    def keeps(speed: float) -> bool:
        stops_m = speed**2 / (2.0 * braking)
        return stops_m <= left and speed * flies_on_s + stops_m <= left + overrun

    speed = copter.braked_m_s(left, overrun)
    assert keeps(max(speed * (1.0 - 1e-6) - 1e-9, 0.0))
    assert not keeps(speed * (1.0 + 1e-6) + 1e-6)


def test_the_reach_covers_the_54_m_that_arducopter_flew_on_at_10_m_s() -> None:
    # ardupilot.md 3: WPNAV_ACCEL 2.5 m/s2, GUID_TIMEOUT 3 s
    assert 54.0 <= limits(acceleration_m_s2=2.5).reach_m(10.0) <= 60.0
