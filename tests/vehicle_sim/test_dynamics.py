"""The copter against closed forms, and within its limits whatever it is told."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.dynamics.copter import HOVER_THROTTLE, RESPONSE_S, Copter, Limits

LIMITS = Limits(
    speed_m_s=30.0,
    acceleration_m_s2=4.0,
    speed_vertical_m_s=5.0,
    acceleration_vertical_m_s2=2.0,
)
FREE = Limits(
    speed_m_s=1e3,
    acceleration_m_s2=1e3,
    speed_vertical_m_s=1e3,
    acceleration_vertical_m_s2=1e3,
)
DRAG_1_S = 0.6


def copter(limits: Limits = LIMITS, drag_1_s: float = 0.0, drag_1_m: float = 0.0) -> Copter:
    return Copter(
        latitude_deg=47.0,
        longitude_deg=8.0,
        altitude_amsl_m=500.0,
        limits=limits,
        drag_1_s=drag_1_s,
        drag_1_m=drag_1_m,
    )


def flown(it: Copter, seconds: float, *order: float) -> Copter:
    for _ in range(round(seconds * 100)):
        it.advance(*order, 0.01)
    return it


@given(orders=st.lists(st.tuples(*[st.floats(-1e3, 1e3)] * 3), min_size=1, max_size=20))
def test_no_order_exceeds_a_limit(orders: list[tuple[float, float, float]]) -> None:
    it = copter()
    for order in orders:
        for _ in range(50):
            before = it.velocity_neu_m_s
            it.advance(*order, 0.01)
            north, east, up = it.velocity_neu_m_s
            assert math.hypot(north, east) <= LIMITS.speed_m_s * (1 + 1e-12)
            assert abs(up) <= LIMITS.speed_vertical_m_s
            gained = math.hypot(north - before[0], east - before[1])
            assert gained <= LIMITS.acceleration_m_s2 * 0.01 * (1 + 1e-9)
            assert abs(up - before[2]) <= LIMITS.acceleration_vertical_m_s2 * 0.01 + 1e-12


def test_for_long_enough_it_is_as_fast_as_its_limits_and_no_faster() -> None:
    it = flown(copter(), 20.0, 60.0, 80.0, -50.0)
    assert it.velocity_neu_m_s == pytest.approx((18.0, 24.0, -5.0), abs=1e-6)


def test_a_steady_order_is_flown_as_the_closed_form_says() -> None:
    it, t, tau = flown(copter(), 5.0, 2.0, 0.0, 1.0), 5.0, RESPONSE_S
    # v(t) = a (t - tau) and s(t) = a (t^2 / 2 - tau t + tau^2) once the lag has settled
    assert it.velocity_north_m_s == pytest.approx(2.0 * (t - tau), abs=0.02)
    climbed_m = t * t / 2 - tau * t + tau * tau
    assert it.altitude_amsl_m - 500.0 == pytest.approx(climbed_m, abs=0.05)


def test_the_step_is_short_enough_not_to_matter() -> None:
    fine, coarse = copter(), copter()
    for k in range(1000):
        angle = k * 0.01
        coarse.advance(2.0 * math.cos(angle), 2.0 * math.sin(angle), 0.0, 0.01)
        for j in range(10):
            angle = (k + j / 10) * 0.01
            fine.advance(2.0 * math.cos(angle), 2.0 * math.sin(angle), 0.0, 0.001)
    assert coarse.latitude_deg == pytest.approx(fine.latitude_deg, abs=0.2 / 111e3)
    assert coarse.longitude_deg == pytest.approx(fine.longitude_deg, abs=0.2 / 76e3)


def test_without_motors_it_falls_like_a_stone_and_standing_it_is_upright_and_idle() -> None:
    it = copter()
    for _ in range(200):
        it.fall(0.01)
    assert it.altitude_amsl_m == pytest.approx(500.0 - 0.5 * 9.80665 * 4.0, abs=1e-6)
    flown(it, 1.0, 5.0, 0.0, 1.0).stand(470.0)
    assert it.roll_rad == it.pitch_rad == it.throttle == it.airspeed_m_s == 0.0
    assert (it.altitude_amsl_m, it.velocity_neu_m_s) == (470.0, (0.0, 0.0, 0.0))


# --- drag, tilt, wind -----------------------------------------------------------------------------


@given(orders=st.lists(st.tuples(*[st.floats(-20, 20)] * 3), min_size=1, max_size=20))
def test_without_drag_wind_is_not_felt(orders: list[tuple[float, float, float]]) -> None:
    plain, blown = copter(), copter()
    blown.wind_north_m_s, blown.wind_east_m_s, blown.wind_up_m_s = 7.0, -5.0, 2.0
    blown.heading_rad = 2.0
    for order in orders:
        for each in (plain, blown):
            each.advance(*order, 0.01)
        assert plain.latitude_deg == blown.latitude_deg
        assert plain.altitude_amsl_m == blown.altitude_amsl_m
        assert plain.velocity_neu_m_s == blown.velocity_neu_m_s


@pytest.mark.parametrize(
    ("drag", "tilt_deg", "speed_m_s", "within"),
    [
        ((DRAG_1_S, 0.0), 30.0, 10.2, 0.08),  # ardupilot.md 3: linear drag meets both within 8 %
        ((DRAG_1_S, 0.0), 45.0, 15.5, 0.08),
        ((0.340, 0.0193), 28.7, 10.05, 0.01),  # steady in arducopter-*.tlog
        ((0.340, 0.0193), 45.0, 15.39, 0.01),
    ],
)
def test_drag_and_tilt_hold_the_speeds_that_were_measured(
    drag: tuple[float, float], tilt_deg: float, speed_m_s: float, within: float
) -> None:
    most = GRAVITY_M_S2 * math.tan(math.radians(tilt_deg))  # no more holds the height
    it = flown(copter(dataclasses.replace(FREE, acceleration_m_s2=most), *drag), 30.0, 100.0, 0, 0)
    assert it.velocity_north_m_s == pytest.approx(speed_m_s, rel=within)
    drag_m_s2 = it.velocity_north_m_s * (drag[0] + drag[1] * it.velocity_north_m_s)
    assert drag_m_s2 == pytest.approx(most, rel=1e-6)
    assert it.pitch_rad == pytest.approx(-math.radians(tilt_deg), rel=1e-6)


def test_left_alone_it_drifts_with_the_wind_and_to_stand_still_it_leans_into_it() -> None:
    it = copter(FREE, DRAG_1_S)
    it.wind_north_m_s, it.wind_east_m_s = -8.0, 4.0
    flown(it, 20.0, 0.0, 0.0, 0.0)
    assert it.velocity_neu_m_s == pytest.approx((-8.0, 4.0, 0.0), abs=1e-3)
    assert it.airspeed_m_s == pytest.approx(0.0, abs=2e-3)
    it.wind_east_m_s = 0.0
    flown(it, 20.0, DRAG_1_S * 8.0, 0.0, 0.0)
    assert it.velocity_neu_m_s == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    assert it.pitch_rad == pytest.approx(-math.atan(DRAG_1_S * 8.0 / GRAVITY_M_S2), abs=0.002)
    assert it.airspeed_m_s == pytest.approx(8.0, abs=0.01)


@given(
    order=st.tuples(st.floats(-8, 8), st.floats(-8, 8), st.floats(-5, 5)),
    heading_rad=st.floats(-3.2, 3.2),
)
def test_attitude_points_the_thrust_where_the_acceleration_comes_from(
    order: tuple[float, float, float], heading_rad: float
) -> None:
    it = copter(FREE)
    it.heading_rad = heading_rad
    flown(it, 2.0, *order)
    # Body z of the rotation yaw, pitch, roll, in north east down; the thrust pulls against it.
    phi, theta, psi = it.roll_rad, it.pitch_rad, it.heading_rad
    body_z = (
        math.cos(psi) * math.sin(theta) * math.cos(phi) + math.sin(psi) * math.sin(phi),
        math.sin(psi) * math.sin(theta) * math.cos(phi) - math.cos(psi) * math.sin(phi),
        math.cos(theta) * math.cos(phi),
    )
    thrust = (order[0], order[1], -(GRAVITY_M_S2 + order[2]))
    size = math.sqrt(sum(x * x for x in thrust))
    assert [-z for z in body_z] == pytest.approx([t / size for t in thrust], abs=1e-6)
    throttle = min(HOVER_THROTTLE * size / GRAVITY_M_S2, 1.0)
    assert it.throttle == pytest.approx(throttle, abs=1e-6)
