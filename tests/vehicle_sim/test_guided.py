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


def test_the_nose_follows_the_commanded_yaw_or_else_the_way(pilot: Make) -> None:
    it = pilot().airborne(1000.0)
    it.setpoint(at(0.0, 0.0), yaw_rad=-2.0)
    it.run(6.0)
    assert math.remainder(it.copter.heading_rad + 2.0, math.tau) == pytest.approx(0.0, abs=1e-6)
    for _ in range(100):
        it.setpoint((0.0, 0.0, 0.0), (0.0, 5.0, 0.0), mask=VELOCITY_ONLY)
        it.run(0.1)
    assert it.copter.heading_rad == pytest.approx(math.pi / 2, abs=0.01)
