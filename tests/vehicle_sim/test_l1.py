import math

import pytest

from vehicle_sim.autopilots.ardupilot.plane_navigation import L1, bank_rad, scaled_radius_m

GRAVITY_M_S2 = 9.80665
SPEED_M_S = 20.0
DT_S = 0.02


def guidance(period_s: float = 15.0) -> L1:
    return L1(period_s=period_s, damping=0.75, integral_gain=0.0)


class Point:
    """Turns exactly as it is told: an independent, ideal vehicle."""

    def __init__(self, north_m: float, east_m: float, course_deg: float) -> None:
        self.north_m, self.east_m = north_m, east_m
        self.course_rad = math.radians(course_deg)

    @property
    def velocity(self) -> tuple[float, float]:
        return SPEED_M_S * math.cos(self.course_rad), SPEED_M_S * math.sin(self.course_rad)

    def move(self, lateral_m_s2: float) -> None:
        self.course_rad += lateral_m_s2 / SPEED_M_S * DT_S
        north, east = self.velocity
        self.north_m += north * DT_S
        self.east_m += east * DT_S

    def circle(self, l1: L1, radius_m: float, direction: float, seconds: float) -> None:
        for _ in range(round(seconds / DT_S)):
            here = self.north_m, self.east_m
            self.move(l1.around(here, radius_m, direction, self.velocity, self.course_rad))

    def follow(self, l1: L1, leg: tuple[float, float], seconds: float) -> None:
        for _ in range(round(seconds / DT_S)):
            here = self.north_m, self.east_m
            self.move(l1.along_leg(here, leg, self.velocity, self.course_rad, DT_S))


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("start", [(-500.0, 30.0, 0.0), (10.0, 0.0, 90.0), (300.0, 300.0, 200.0)])
def test_an_ideal_vehicle_settles_on_the_circle_and_goes_round_it_the_right_way(
    direction: float, start: tuple[float, float, float]
) -> None:
    l1, point = guidance(), Point(*start)
    point.circle(l1, 100.0, direction, 100.0)
    assert l1.circling
    bearing_rad = math.atan2(point.east_m, point.north_m)
    for _ in range(20):
        point.circle(l1, 100.0, direction, 0.5)
        assert math.hypot(point.north_m, point.east_m) == pytest.approx(100.0, abs=0.5)
        after_rad = math.atan2(point.east_m, point.north_m)
        assert math.remainder(after_rad - bearing_rad, math.tau) * direction > 0.0
        bearing_rad = after_rad


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_on_the_circle_it_asks_for_the_centripetal_acceleration(direction: float) -> None:
    lateral = guidance().around((0.0, -150.0), 150.0, direction, (direction * SPEED_M_S, 0.0), 0.0)
    assert lateral == pytest.approx(direction * SPEED_M_S**2 / 150.0)


def test_left_and_right_are_mirror_images() -> None:
    right, left = guidance(), guidance()
    one, other = Point(-200.0, 40.0, 10.0), Point(-200.0, -40.0, -10.0)
    one.circle(right, 80.0, 1.0, 60.0)
    other.circle(left, 80.0, -1.0, 60.0)
    assert one.north_m == pytest.approx(other.north_m)
    assert one.east_m == pytest.approx(-other.east_m)


@pytest.mark.parametrize("off_m", [-60.0, 15.0, 120.0])
def test_a_leg_is_joined_and_kept(off_m: float) -> None:
    l1, point = guidance(), Point(0.0, off_m, 0.0)
    point.follow(l1, (5000.0, 0.0), 60.0)
    assert point.east_m == pytest.approx(0.0, abs=0.5)
    assert math.sin(point.course_rad) == pytest.approx(0.0, abs=0.02)
    assert l1.cross_track_m == pytest.approx(-point.east_m, abs=0.5)


def test_it_answers_a_small_offset_as_an_oscillator_of_its_period_and_damping() -> None:
    """The linear law of the paper: e'' + 2 D w e' + w^2 e = 0, here in closed form."""
    l1, point, offset_m = guidance(20.0), Point(0.0, 1.0, 0.0), 1.0
    omega = math.tau / 20.0 * 1.0
    damped = omega * math.sqrt(1.0 - 0.75**2)
    for k in range(1, 16):
        point.follow(l1, (1e5, 0.0), 1.0)
        fading = math.exp(-0.75 * omega * k)
        phase = math.cos(damped * k) + 0.75 * omega / damped * math.sin(damped * k)
        assert point.east_m == pytest.approx(offset_m * fading * phase, abs=0.05)


def test_far_behind_the_leg_it_heads_for_its_start_and_beyond_its_end_back() -> None:
    l1 = guidance()
    l1.along_leg((-500.0, 300.0), (1000.0, 0.0), (SPEED_M_S, 0.0), 0.0, 0.1)
    assert l1.nav_bearing_rad == pytest.approx(math.atan2(-300.0, 500.0))
    l1.along_leg((1300.0, 50.0), (1000.0, 0.0), (SPEED_M_S, 0.0), 0.0, 0.1)
    assert l1.nav_bearing_rad == pytest.approx(math.atan2(-50.0, -300.0))


def test_a_steady_cross_track_angle_is_integrated_within_bounds() -> None:
    l1 = L1(period_s=15.0, damping=0.75, integral_gain=0.02)
    first = l1.along_leg((0.0, -3.0), (1e4, 0.0), (SPEED_M_S, 0.0), 0.0, 0.1)
    for _ in range(100_000):
        last = l1.along_leg((0.0, -3.0), (1e4, 0.0), (SPEED_M_S, 0.0), 0.0, 0.1)
    gain = 4.0 * 0.75**2 * SPEED_M_S**2 / l1.length_m
    assert first < last < gain * math.sin(math.asin(3.0 / l1.length_m) + 0.1) + 1e-9
    l1.forget()
    again = l1.along_leg((0.0, -3.0), (1e4, 0.0), (SPEED_M_S, 0.0), 0.0, 0.1)
    assert again == pytest.approx(first)


def test_standing_still_or_at_the_point_is_no_trouble() -> None:
    l1 = guidance()
    for velocity in ((0.0, 0.0), (SPEED_M_S, 0.0)):
        assert math.isfinite(l1.around((0.0, 0.0), 50.0, 1.0, velocity, 1.0))
        assert math.isfinite(l1.around((0.0, 0.0), 0.0, 1.0, velocity, 1.0))
        assert math.isfinite(l1.along_leg((0.0, 0.0), (0.0, 0.0), velocity, 1.0, 0.1))


def test_with_the_target_right_behind_it_does_not_dither() -> None:
    l1 = guidance()
    turns = []
    for k in range(10):
        east_m = 0.5 if k % 2 else -0.5  # the bearing flips from side to side
        here = (300.0, east_m)
        turns.append(math.copysign(1.0, l1.around(here, 50.0, 1.0, (SPEED_M_S, 0.0), 0.0)))
    assert len(set(turns[1:])) == 1


def test_bank_is_that_of_a_coordinated_turn() -> None:
    assert bank_rad(GRAVITY_M_S2, 0.0) == pytest.approx(math.pi / 4.0)
    assert bank_rad(-3.0, 0.0) == pytest.approx(-math.atan(3.0 / GRAVITY_M_S2))
    assert bank_rad(3.0, math.radians(30.0)) > bank_rad(3.0, 0.0)


@pytest.mark.parametrize(
    ("radius_m", "bank_limit_deg", "expected_m"),
    [
        (100.0, 0.0, 121.0),  # no limit: always by the square
        (100.0, 45.0, 100.0),  # at sea level 49.4 m would do, here 59.7 m
        (50.0, 45.0, 59.7),
        (40.0, 45.0, 48.4),  # too small even at sea level
    ],
)
def test_circles_grow_where_the_air_is_thin(
    radius_m: float, bank_limit_deg: float, expected_m: float
) -> None:
    scaled_m = scaled_radius_m(
        radius_m, 1.1, bank_limit_rad=math.radians(bank_limit_deg), airspeed_m_s=22.0
    )
    assert scaled_m == pytest.approx(expected_m, abs=0.1)
