"""How a stream of setpoints is flown, and what happens when it stops."""

import math
from collections.abc import Callable
from typing import Any

import pytest
from pyproj import Geod

Make = Callable[..., Any]
WGS84 = Geod(ellps="WGS84")
VELOCITY_ONLY = 0xDC7


def at(north_m: float, east_m: float) -> tuple[float, float, float]:
    longitude_deg, latitude_deg, _ = WGS84.fwd(
        8.0, 47.0, math.degrees(math.atan2(east_m, north_m)), math.hypot(north_m, east_m)
    )
    return latitude_deg, longitude_deg, 1000.0


def local_m(it: Any) -> tuple[float, float]:
    azimuth_deg, _, distance_m = WGS84.inv(
        8.0, 47.0, it.copter.longitude_deg, it.copter.latitude_deg
    )
    azimuth_rad = math.radians(azimuth_deg)
    return distance_m * math.cos(azimuth_rad), distance_m * math.sin(azimuth_rad)


@pytest.mark.parametrize("rate_hz", [5, 10])
@pytest.mark.parametrize(
    ("timeout_s", "furthest_m", "ends_m", "brakes_s", "still_s"),
    [
        (3.0, 53.7, 30.0, 3.7, 7.1),
        (1.0, 33.6, 10.0, 1.7, 5.0),
        (0.3, 26.8, 3.0, 1.0, 4.3),
    ],
)
def test_when_the_stream_stops_it_flies_on_and_comes_back_as_measured(
    pilot: Make,
    rate_hz: int,
    timeout_s: float,
    furthest_m: float,
    ends_m: float,
    brakes_s: float,
    still_s: float,
) -> None:
    it = pilot(timeout_s=timeout_s).airborne(1000.0)
    start_us, last_m, x_m = it.now_us, 0.0, 0.0
    while it.now_us - start_us < 15e6:
        t = (it.now_us - start_us) * 1e-6
        x_m, speed = (0.5 * t * t, t) if t < 10 else (50 + 10 * (t - 10), 10.0)
        if (it.now_us - start_us) % (1_000_000 // rate_hz) == 0:
            it.setpoint(at(x_m, 0.0), (speed, 0.0, 0.0))
            last_us, last_m = it.now_us, x_m
        it.step()
    beyond = lambda: it.north_m() - last_m  # noqa: E731
    it.run_until(lambda: it.copter.velocity_north_m_s < 9.5, within_s=10)
    assert (it.now_us - last_us) * 1e-6 == pytest.approx(brakes_s, abs=0.4)
    it.run_until(lambda: it.copter.velocity_north_m_s < 0.1, within_s=10)
    assert (it.now_us - last_us) * 1e-6 == pytest.approx(still_s, abs=1.0)
    assert beyond() == pytest.approx(furthest_m, rel=0.06)  # without drag
    it.run(60)
    assert beyond() == pytest.approx(ends_m, abs=0.2)
    assert it.autopilot.mode_name == "GUIDED"


def test_a_weaving_path_at_10_m_s_is_followed_as_measured(
    pilot: Make, rms: Callable[[list[float]], float]
) -> None:
    it = pilot().airborne(1000.0)
    period_s, speed, lateral_m_s2 = 35.0, 10.0, 1.5
    w = 2 * math.pi / period_s
    swing_rad = lateral_m_s2 / (speed * w)
    north = east = 0.0
    off_m, along_m = [], []
    for k in range(10_000):
        t = k * 0.01
        v, course = min(t, speed), swing_rad * min(1, t / 20) * math.sin(w * t)
        dn, de = math.cos(course), math.sin(course)
        if k % 10 == 0:
            it.setpoint(at(north, east), (v * dn, v * de, 0.0))
        it.step()
        north, east = north + v * dn * 0.01, east + v * de * 0.01
        if t > 30:
            is_n, is_e = local_m(it)
            along_m.append((is_n - north) * dn + (is_e - east) * de)
            off_m.append((is_e - east) * dn - (is_n - north) * de)
    assert rms(off_m) == pytest.approx(0.96, abs=0.2)
    assert max(map(abs, off_m)) == pytest.approx(1.4, abs=0.3)
    assert -0.5 < sum(along_m) / len(along_m) < 0.0


@pytest.mark.parametrize("every_steps", [5, 10])
def test_a_turn_of_9_m_s2_at_150_m_s_is_entered_without_overshoot_and_followed(
    pilot: Make, every_steps: int
) -> None:
    it = pilot().airborne(1000.0)
    speed, radius_m = 150.0, 2500.0
    ramp_s = 40.0  # to full speed, then straight on for a while, then the turn
    straight_m = speed * ramp_s / 2 + speed * 20.0
    most_m_s2, worst_m = 0.0, 0.0
    for k in range(12_000):
        t = k * 0.01
        flown_m, v = (
            (speed * t * t / (2 * ramp_s), speed * t / ramp_s)
            if t < ramp_s
            else (speed * ramp_s / 2 + speed * (t - ramp_s), speed)
        )
        turn_rad = max(flown_m - straight_m, 0.0) / radius_m
        north = min(flown_m, straight_m) + radius_m * math.sin(turn_rad)
        east = radius_m * (1 - math.cos(turn_rad))
        if t > ramp_s + 10:
            is_n, is_e = local_m(it)
            worst_m = max(worst_m, math.hypot(is_n - north, is_e - east))
            copter = it.copter
            lateral = (
                copter.acceleration_east_m_s2 * copter.velocity_north_m_s
                - copter.acceleration_north_m_s2 * copter.velocity_east_m_s
            ) / math.hypot(copter.velocity_north_m_s, copter.velocity_east_m_s)
            most_m_s2 = max(most_m_s2, lateral)
        if k % every_steps == 0:
            it.setpoint(at(north, east), (v * math.cos(turn_rad), v * math.sin(turn_rad), 0.0))
        it.step()
    assert most_m_s2 <= 9.0 * 1.05
    assert 5.0 < worst_m <= 15.0


def test_a_stream_with_climb_is_followed_in_height_too(pilot: Make) -> None:
    it = pilot().airborne(1000.0)
    for k in range(3000):
        t = k * 0.01
        height = 1000.0 + (t * t / 2 if t < 10 else 50 + 10 * (t - 10))
        if k % 10 == 0:
            latitude_deg, longitude_deg, _ = at(0.0, 0.0)
            it.setpoint((latitude_deg, longitude_deg, height), (0.0, 0.0, -min(t, 10.0)))
        it.step()
    assert it.copter.altitude_amsl_m == pytest.approx(1250.0, abs=0.3)


def test_explicit_zero_velocity_holds_the_point(pilot: Make) -> None:
    it = pilot().airborne(1000.0)
    for k in range(3000):
        if k % 10 == 0:
            t = k * 0.01
            x_m, v = (5 * t, 5.0) if t < 10 else (50.0, 0.0)
            it.setpoint(at(x_m, 0.0), (v, 0.0, 0.0))
        it.step()
    assert it.north_m() == pytest.approx(50.0, abs=0.1)
    it.run(30.0)  # and the time-out changes nothing
    assert it.north_m() == pytest.approx(50.0, abs=0.05)


def test_a_position_alone_is_reached_without_overshoot(pilot: Make) -> None:
    it = pilot().airborne(1000.0)
    it.setpoint(at(200.0, 0.0), mask=0xDF8)
    furthest_m, fastest = 0.0, 0.0
    for _ in range(6000):
        it.step()
        furthest_m = max(furthest_m, it.north_m())
        fastest = max(fastest, it.copter.velocity_north_m_s)
    assert it.north_m() == pytest.approx(200.0, abs=0.3)
    assert furthest_m < 201.0
    assert fastest == pytest.approx(10.0, abs=0.5)  # WPNAV_SPEED


def test_a_position_alone_streamed_at_10_m_s_is_trailed_by_35_m(pilot: Make) -> None:
    it = pilot().airborne(1000.0)
    for k in range(6000):
        if k % 10 == 0:
            it.setpoint(at(9.2 * k * 0.01, 0.0), mask=0xDF8)  # it flew 9.2 m/s
        it.step()
    assert it.north_m() - 9.2 * 60.0 == pytest.approx(-35.0, abs=6.0)


def test_the_nose_follows_the_commanded_yaw_or_else_the_way(pilot: Make) -> None:
    it = pilot().airborne(1000.0)
    it.setpoint(at(0.0, 0.0), yaw_rad=-2.0)
    it.run(6.0)
    assert math.remainder(it.copter.heading_rad + 2.0, math.tau) == pytest.approx(0.0, abs=1e-6)
    for _ in range(100):
        it.setpoint((0.0, 0.0, 0.0), (0.0, 5.0, 0.0), mask=VELOCITY_ONLY)
        it.run(0.1)
    assert it.copter.heading_rad == pytest.approx(math.pi / 2, abs=0.01)


def test_a_far_jump_of_the_target_is_flown_within_the_limits_without_wild_overshoot(
    pilot: Make,
) -> None:
    it = pilot().airborne(1000.0)
    most_m = 0.0
    for k in range(6000):
        if k % 10 == 0:
            it.setpoint(at(300.0, 0.0))
        it.step()
        most_m = max(most_m, it.north_m())
    assert it.north_m() == pytest.approx(300.0, abs=0.5)
    assert most_m < 303.0
