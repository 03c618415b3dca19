"""The law of both planes against closed forms, flown by a point that turns as it is told."""

import cmath
import math

import pytest

from vehicle_sim.autopilot.plane_control import (
    L1,
    HeightControl,
)

SPEED_M_S, STEP_S, AHEAD = 20.0, 0.02, 20 + 0j
approx = pytest.approx


def guidance(period_s: float = 15.0) -> L1:
    l1 = L1()
    l1.period_s = period_s
    return l1


class Point:
    """An independent, ideal vehicle; places are complex: north and east."""

    def __init__(self, at_m: complex, course_deg: float = 0.0, wind: complex = 0j) -> None:
        self.at_m, self.course_rad, self.wind = at_m, math.radians(course_deg), wind

    @property
    def velocity(self) -> complex:
        return cmath.rect(SPEED_M_S, self.course_rad) + self.wind

    def move(self, lateral_m_s2: float) -> None:
        self.course_rad += lateral_m_s2 / SPEED_M_S * STEP_S
        self.at_m += self.velocity * STEP_S

    def circle(self, l1: L1, radius_m: float, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.move(l1.circle(self.at_m, radius_m, self.velocity))

    def follow(self, l1: L1, seconds: float) -> None:
        """The line to the north."""
        for _ in range(round(seconds / STEP_S)):
            self.move(l1.line(self.at_m, 1 + 0j, self.velocity))


@pytest.mark.parametrize("radius_m", [100.0, -100.0])
@pytest.mark.parametrize("start", [(-500 + 30j, 0.0), (10 + 0j, 90.0)])
def test_a_circle_is_joined_from_anywhere_and_held_the_right_way_round(
    radius_m: float, start: tuple[complex, float]
) -> None:
    l1, point = guidance(), Point(*start)
    point.circle(l1, radius_m, 100.0)
    assert l1.circling
    for _ in range(20):
        before_m = point.at_m
        point.circle(l1, radius_m, 0.5)
        assert abs(point.at_m) == approx(100.0, abs=0.5)
        assert cmath.phase(point.at_m / before_m) * radius_m > 0.0
    for way in (1.0, -1.0):  # on it, it asks for the centripetal acceleration
        lateral = guidance().circle(-150j, way * 150.0, complex(way * SPEED_M_S))
        assert lateral == approx(way * SPEED_M_S**2 / 150.0)


@pytest.mark.parametrize("period_s", [10.0, 20.0])
def test_it_answers_a_small_offset_as_an_oscillator_of_its_period_and_damping(
    period_s: float,
) -> None:
    """The linear law of the paper, and of PX4's: e'' + 2 D w e' + w^2 e = 0."""
    l1, point, omega = guidance(period_s), Point(1j), math.tau / period_s
    damped = omega * math.sqrt(1.0 - 0.75**2)
    for k in range(1, 16):
        point.follow(l1, 1.0)
        fading = math.exp(-0.75 * omega * k)
        phase = math.cos(damped * k) + 0.75 * omega / damped * math.sin(damped * k)
        assert point.at_m.imag == approx(fading * phase, abs=0.05)


def test_a_height_is_reached_as_a_limited_demand_through_a_lag() -> None:
    """The demand rises at 5 m/s for a second, and is followed with a time constant of 3.5 s."""
    heights, height_m, lag_s = HeightControl(), 100.0, 3.5
    heights.begin(height_m)
    behind_m = 5.0 * lag_s * (1.0 - math.exp(-1.0 / lag_s))  # when the demand is there
    for second in range(1, 31):
        for _ in range(100):
            height_m += heights.climb_m_s(105.0, height_m, 0.01) * 0.01
        wanted_m = 105.0 - behind_m * math.exp(-(second - 1.0) / lag_s)
        assert height_m == approx(wanted_m, abs=0.02)
