"""PX4's fixed-wing guidance law against closed forms, flown on a point that turns without delay."""

import cmath
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_sim.autopilots.px4 import course as guidance
from vehicle_sim.autopilots.px4.course import Gains, Path
from vehicle_sim.dynamics import GRAVITY_M_S2

GAINS = guidance.gains_of(10.0, 0.7, 0.5)
SPEED_M_S = 13.9
STEP_S = 0.01
ANGLES = st.floats(-math.pi, math.pi)
METRES = st.floats(-500.0, 500.0)
WINDS = st.floats(-8.0, 8.0)


def unit(angle_rad: float) -> complex:
    return cmath.rect(1.0, angle_rad)


def turn(path: Path, here_m: complex, heading_rad: float, wind: complex = 0j) -> float:
    """Lateral acceleration that the law asks for."""
    heading = unit(heading_rad)
    course, along = guidance.bearing(path, here_m, SPEED_M_S * heading + wind, wind, GAINS)
    wanted = guidance.heading_for(course, wind, SPEED_M_S)
    return along + guidance.turn_m_s2(heading, wanted, SPEED_M_S, GAINS.turn_1_s)


class Point:
    """A plane that turns at once, up to 50 degrees of bank."""

    def __init__(self, north_m: float, east_m: float, heading_rad: float) -> None:
        self.at_m, self.heading_rad = complex(north_m, east_m), heading_rad

    def fly(self, path: Path, wind: complex = 0j) -> None:
        """One step along this path."""
        lateral = turn(path, self.at_m, self.heading_rad, wind)
        bank_rad = guidance.bank_rad(lateral, math.radians(50.0))
        self.heading_rad += GRAVITY_M_S2 * math.tan(bank_rad) / SPEED_M_S * STEP_S
        self.at_m += (self.velocity + wind) * STEP_S

    @property
    def velocity(self) -> complex:
        """Through the air."""
        return SPEED_M_S * unit(self.heading_rad)


def test_offset_from_a_line_is_a_damped_oscillator_of_the_period_and_damping() -> None:
    point = Point(0.0, 2.0, 0.0)
    omega, damping = math.tau / 10.0, 0.7
    free = omega * math.sqrt(1.0 - damping**2)
    worst_m = 0.0
    for i in range(1, 801):
        point.fly(Path(point.at_m.real + 0j, 1.0 + 0j))
        t = i * STEP_S
        shape = math.cos(free * t) + damping * omega / free * math.sin(free * t)
        worst_m = max(worst_m, abs(point.at_m.imag - 2.0 * math.exp(-damping * omega * t) * shape))
    assert worst_m < 0.08


@pytest.mark.parametrize("radius_m", [100.0, -150.0])
def test_a_curve_told_as_straight_is_flown_outside_by_the_closed_form(radius_m: float) -> None:
    point = Point(abs(radius_m), 0.0, math.copysign(0.5 * math.pi, radius_m))
    for _ in range(6000):
        circle = guidance.circle(point.at_m, 0j, radius_m, point.velocity)
        point.fly(circle._replace(curvature_1_m=0.0))
    outside_m = abs(point.at_m) - abs(radius_m)
    # a little less: the wider circle is also less curved
    wanted_m = SPEED_M_S**2 / abs(radius_m) * (10.0 / math.tau) ** 2
    assert outside_m == pytest.approx(wanted_m, rel=0.05)


@pytest.mark.parametrize("radius_m", [80.0, -80.0])
def test_a_circle_is_joined_from_outside_and_held(radius_m: float) -> None:
    point = Point(-400.0, 35.0, 0.0)
    for i in range(12000):
        point.fly(guidance.circle(point.at_m, 0j, radius_m, point.velocity))
        if i > 8000:
            assert abs(point.at_m) == pytest.approx(80.0, abs=0.1)
    turning = guidance.cross(point.at_m, point.velocity)
    assert math.copysign(1.0, turning) == math.copysign(1.0, radius_m)


def test_a_point_is_circled_at_the_tightest_turn_once_reached() -> None:
    point = Point(-200.0, 3.0, 0.0)
    away = []
    for i in range(6000):
        path = guidance.towards(point.at_m, 0j)
        if path is not None:
            point.fly(path)
        if i > 3000:
            away.append(abs(point.at_m))
    tightest_m = SPEED_M_S**2 / (GRAVITY_M_S2 * math.tan(math.radians(50.0)))
    assert max(away) < 2.1 * tightest_m  # px4.md 10: 8-30 m off


def test_a_line_is_held_in_cross_wind_with_the_nose_into_it() -> None:
    point, wind = Point(0.0, 30.0, 0.0), 6j
    for _ in range(6000):
        point.fly(Path(point.at_m.real + 0j, 1.0 + 0j), wind)
    assert abs(point.at_m.imag) < 0.05
    assert math.sin(point.heading_rad) == pytest.approx(-6.0 / SPEED_M_S, abs=1e-3)


@given(
    north_m=METRES, east_m=METRES, heading_rad=ANGLES, way_rad=ANGLES, bend=st.floats(-0.01, 0.01)
)
def test_the_law_has_no_preferred_side(
    north_m: float, east_m: float, heading_rad: float, way_rad: float, bend: float
) -> None:
    path, at_m = Path(1.0 + 2.0j, unit(way_rad), bend), complex(north_m, east_m)
    mirrored = Path(1.0 - 2.0j, unit(-way_rad), -bend)
    here = turn(path, at_m, heading_rad)
    there = turn(mirrored, at_m.conjugate(), -heading_rad)
    across = math.sin(heading_rad - way_rad)
    if abs(across) > 1e-6 and abs(here) < 0.99 * GAINS.turn_1_s * SPEED_M_S:
        assert here == pytest.approx(-there, abs=1e-9)
    assert abs(here) <= GAINS.turn_1_s * SPEED_M_S + SPEED_M_S**2 / guidance.MIN_RADIUS_M


@given(course_rad=ANGLES, wind_n=WINDS, wind_e=WINDS, airspeed=st.floats(12.0, 20.0))
def test_wind_triangle_closes(
    course_rad: float, wind_n: float, wind_e: float, airspeed: float
) -> None:
    course, wind = unit(course_rad), complex(wind_n, wind_e)
    nose = guidance.heading_for(course, wind, airspeed)
    over_ground = (airspeed * nose + wind) / course
    assert abs(nose) == pytest.approx(1.0)
    assert over_ground.imag == pytest.approx(0.0, abs=1e-9)
    assert over_ground.real > 0.0


@given(course_rad=ANGLES, strength=st.floats(15.0, 60.0), from_rad=ANGLES)
def test_more_wind_than_airspeed_is_still_an_answer(
    course_rad: float, strength: float, from_rad: float
) -> None:
    wind = strength * unit(from_rad)
    assert abs(guidance.heading_for(unit(course_rad), wind, 14.0)) == pytest.approx(1.0)
    path = Path(0j, unit(course_rad), 0.01)
    assert all(map(cmath.isfinite, guidance.bearing(path, 20.0 + 5.0j, wind + 14.0, wind, GAINS)))


def test_legs_lead_to_the_start_along_and_back_to_the_end() -> None:
    ends = (0j, 500.0 + 0j)
    before = guidance.leg(-200.0 + 60.0j, *ends, 31.0)
    amid = guidance.leg(200.0 + 60.0j, *ends, 31.0)
    past = guidance.leg(600.0 + 60.0j, *ends, 31.0)
    assert before is not None
    assert amid is not None
    assert past is not None
    assert before.point_m == 0j
    assert (amid.point_m, amid.along) == (200.0, 1.0)
    assert (past.point_m, past.along.real < 0.0) == (500.0, True)


def test_degenerate_paths_are_none_and_short_periods_are_refused() -> None:
    assert guidance.towards(1 + 1j, 1 + 1j) is None
    assert guidance.along(1 + 1j, 0j, 0.0) is None
    assert guidance.leg(3 + 4j, 3 + 4j, 3 + 4j, 31.0) is None
    least_s = 1.5 * math.pi * 0.5 / 0.7
    assert guidance.gains_of(0.5, 0.7, 0.5) == Gains(period_s=least_s, damping=0.7)
    assert GAINS.switch_m(SPEED_M_S) == pytest.approx(31.1, abs=0.1)
