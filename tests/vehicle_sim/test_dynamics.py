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


def hovering() -> Copter:
    return Copter(latitude_deg=47.0, longitude_deg=8.0, altitude_amsl_m=500.0, limits=LIMITS)


def dragged(tilt_max_deg: float | None = None) -> Copter:
    limits = FREE
    if tilt_max_deg is not None:  # no more level thrust than holds the height at this lean
        most = GRAVITY_M_S2 * math.tan(math.radians(tilt_max_deg))
        limits = dataclasses.replace(FREE, acceleration_m_s2=most)
    return Copter(
        latitude_deg=47.0,
        longitude_deg=8.0,
        altitude_amsl_m=500.0,
        limits=limits,
        drag_1_s=DRAG_1_S,
    )


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


# --- drag, tilt, wind -----------------------------------------------------------------------------


@given(orders=st.lists(st.tuples(*[st.floats(-20, 20)] * 3), min_size=1, max_size=20))
def test_without_drag_wind_is_not_felt(
    orders: list[tuple[float, float, float]],
) -> None:
    plain, blown = hovering(), hovering()
    blown.wind_north_m_s, blown.wind_east_m_s, blown.wind_up_m_s = 7.0, -5.0, 2.0
    blown.heading_rad = 2.0
    for order in orders:
        for copter in (plain, blown):
            copter.advance(*order, 0.01)
        assert plain.latitude_deg == blown.latitude_deg
        assert plain.altitude_amsl_m == blown.altitude_amsl_m
        assert plain.velocity_east_m_s == blown.velocity_east_m_s


@pytest.mark.parametrize(("tilt_deg", "speed_m_s"), [(30.0, 10.2), (45.0, 15.5)])
def test_drag_and_tilt_hold_the_speeds_that_were_measured(
    tilt_deg: float, speed_m_s: float
) -> None:
    """ardupilot.md 3: 10.2 m/s at 30 degrees, 15.5 at 45; linear drag meets both within 8 %."""
    copter = dragged(tilt_deg)
    for _ in range(3000):
        copter.advance(100.0, 0.0, 0.0, 0.01)
    terminal_m_s = GRAVITY_M_S2 * math.tan(math.radians(tilt_deg)) / DRAG_1_S
    assert copter.velocity_north_m_s == pytest.approx(terminal_m_s, rel=1e-6)
    assert copter.velocity_north_m_s == pytest.approx(speed_m_s, rel=0.08)
    assert copter.pitch_rad == pytest.approx(-math.radians(tilt_deg), rel=1e-6)


@pytest.mark.parametrize(("tilt_deg", "speed_m_s"), [(28.7, 10.05), (45.0, 15.39)])
def test_with_a_quadratic_part_drag_is_the_recorded_copters(
    tilt_deg: float, speed_m_s: float
) -> None:
    """Steady speeds and tilts of arducopter-*.tlog."""
    copter = dragged(tilt_deg)
    copter.drag_1_s, copter.drag_1_m = 0.340, 0.0193
    for _ in range(3000):
        copter.advance(0.0, 100.0, 0.0, 0.01)
    assert copter.velocity_east_m_s == pytest.approx(speed_m_s, rel=0.01)


def test_speed_dies_away_in_still_air_as_the_closed_form_says() -> None:
    copter = dragged()
    copter.velocity_east_m_s = 10.0
    for _ in range(200):
        copter.advance(0.0, 0.0, 0.0, 0.01)
    assert copter.velocity_east_m_s == pytest.approx(10.0 * math.exp(-DRAG_1_S * 2.0), rel=0.005)


def test_left_alone_it_drifts_with_the_wind() -> None:
    copter = dragged()
    copter.wind_north_m_s, copter.wind_east_m_s = -3.0, 4.0
    for _ in range(2000):
        copter.advance(0.0, 0.0, 0.0, 0.01)
    assert copter.velocity_north_m_s == pytest.approx(-3.0, abs=1e-3)
    assert copter.velocity_east_m_s == pytest.approx(4.0, abs=1e-3)
    assert copter.airspeed_m_s == pytest.approx(0.0, abs=2e-3)
    assert copter.velocity_up_m_s == 0.0


def test_to_stand_still_in_wind_it_has_to_lean_into_it() -> None:
    copter = dragged()
    copter.wind_north_m_s = -8.0  # blows to the south
    copter.heading_rad = 0.0
    for _ in range(500):
        copter.advance(DRAG_1_S * 8.0, 0.0, 0.0, 0.01)
    for _ in range(2000):
        copter.advance(DRAG_1_S * 8.0 - copter.velocity_north_m_s, 0.0, 0.0, 0.01)
    assert copter.velocity_north_m_s == pytest.approx(0.0, abs=0.01)
    assert copter.pitch_rad == pytest.approx(-math.atan(DRAG_1_S * 8.0 / GRAVITY_M_S2), abs=0.002)
    assert copter.airspeed_m_s == pytest.approx(8.0, abs=0.01)


@given(
    order=st.tuples(st.floats(-8, 8), st.floats(-8, 8), st.floats(-5, 5)),
    heading_rad=st.floats(-3.2, 3.2),
)
def test_attitude_points_the_thrust_where_the_acceleration_comes_from(
    order: tuple[float, float, float], heading_rad: float
) -> None:
    copter = Copter(latitude_deg=47.0, longitude_deg=8.0, altitude_amsl_m=0.0, limits=FREE)
    copter.heading_rad = heading_rad
    for _ in range(200):
        copter.advance(*order, 0.01)
    # Body z of the rotation yaw, pitch, roll, in north east down; the thrust pulls against it.
    phi, theta, psi = copter.roll_rad, copter.pitch_rad, copter.heading_rad
    body_z = (
        math.cos(psi) * math.sin(theta) * math.cos(phi) + math.sin(psi) * math.sin(phi),
        math.sin(psi) * math.sin(theta) * math.cos(phi) - math.cos(psi) * math.sin(phi),
        math.cos(theta) * math.cos(phi),
    )
    thrust = (order[0], order[1], -(GRAVITY_M_S2 + order[2]))
    size = math.sqrt(sum(x * x for x in thrust))
    for z, t in zip(body_z, thrust, strict=True):
        assert -z == pytest.approx(t / size, abs=1e-6)
    throttle = min(HOVER_THROTTLE * size / GRAVITY_M_S2, 1.0)
    assert copter.throttle == pytest.approx(throttle, abs=1e-6)


def test_standing_it_is_upright_and_idle() -> None:
    copter = dragged()
    for _ in range(100):
        copter.advance(5.0, 0.0, 1.0, 0.01)
    copter.stand(490.0)
    assert copter.roll_rad == copter.pitch_rad == copter.throttle == copter.airspeed_m_s == 0.0
    assert copter.altitude_amsl_m == 490.0
