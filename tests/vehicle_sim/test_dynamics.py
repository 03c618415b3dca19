import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_sim.dynamics import RESPONSE_S, Copter, Limits

LIMITS = Limits(
    speed_m_s=30.0,
    acceleration_m_s2=4.0,
    speed_vertical_m_s=5.0,
    acceleration_vertical_m_s2=2.0,
)


def hovering() -> Copter:
    return Copter(latitude_deg=47.0, longitude_deg=8.0, altitude_amsl_m=500.0, limits=LIMITS)


@given(orders=st.lists(st.tuples(*[st.floats(-1e3, 1e3)] * 3), min_size=1, max_size=20))
def test_no_order_exceeds_a_limit(orders: list[tuple[float, float, float]]) -> None:
    copter = hovering()
    for order in orders:
        for _ in range(50):
            before = copter.velocity_north_m_s, copter.velocity_east_m_s, copter.velocity_up_m_s
            copter.advance(*order, 0.01)
            north, east = copter.velocity_north_m_s, copter.velocity_east_m_s
            assert math.hypot(north, east) <= LIMITS.speed_m_s * (1 + 1e-12)
            assert abs(copter.velocity_up_m_s) <= LIMITS.speed_vertical_m_s
            gained = math.hypot(north - before[0], east - before[1])
            assert gained <= LIMITS.acceleration_m_s2 * 0.01 * (1 + 1e-9)
            assert abs(copter.velocity_up_m_s - before[2]) <= 2.0 * 0.01 + 1e-12


def test_a_steady_order_is_flown_as_the_closed_form_says() -> None:
    copter = hovering()
    for _ in range(500):
        copter.advance(2.0, 0.0, 1.0, 0.01)
    # v(t) = a (t - tau) and s(t) = a (t^2 / 2 - tau t + tau^2) once the lag has settled
    t, tau = 5.0, RESPONSE_S
    assert copter.velocity_north_m_s == pytest.approx(2.0 * (t - tau), abs=0.02)
    climbed_m = t * t / 2 - tau * t + tau * tau
    assert copter.altitude_amsl_m - 500.0 == pytest.approx(climbed_m, abs=0.05)


def test_the_step_is_short_enough_not_to_matter() -> None:
    fine, coarse = hovering(), hovering()
    for k in range(1000):
        angle = k * 0.01
        coarse.advance(2.0 * math.cos(angle), 2.0 * math.sin(angle), 0.0, 0.01)
        for j in range(10):
            angle = (k + j / 10) * 0.01
            fine.advance(2.0 * math.cos(angle), 2.0 * math.sin(angle), 0.0, 0.001)
    assert coarse.latitude_deg == pytest.approx(fine.latitude_deg, abs=0.2 / 111e3)
    assert coarse.longitude_deg == pytest.approx(fine.longitude_deg, abs=0.2 / 76e3)


def test_without_motors_it_falls_like_a_stone() -> None:
    copter = hovering()
    for _ in range(200):
        copter.fall(0.01)
    assert copter.altitude_amsl_m == pytest.approx(500.0 - 0.5 * 9.80665 * 4.0, abs=1e-6)
