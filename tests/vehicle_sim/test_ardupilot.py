"""The ArduCopter by values: commands, boot, take-off and landing, setpoints and their echo."""

import functools
import math
from typing import Any

import pytest
from harness import Rig
from pyproj import Geod
from tracking_copter import HOME_DEG, Flown

from vehicle_sim.autopilot.values import Battery
from vehicle_sim.dynamics.copter import Limits

METRES_PER_DEG_NORTH = 111_181.0  # of the meridian near 47 N: the tests stay within 1 km of it
WGS84 = Geod(ellps="WGS84")
VELOCITY_ONLY = 0xDC7


FICTIONAL = Limits(
    speed_m_s=170.0,
    acceleration_m_s2=10.0,
    speed_vertical_m_s=25.0,
    acceleration_vertical_m_s2=5.0,
)


class Pilot(Flown):
    """An ArduCopter without drag over level ground at 0 m, with the law `ideal`."""

    def __init__(self, up_m_s: float = 25.0, down_m_s: float = 25.0) -> None:
        given = {"ANGLE_MAX": 8000.0, "WPNAV_SPEED_UP": up_m_s * 100.0}
        super().__init__(0.0, FICTIONAL, drag=False, WPNAV_SPEED_DN=down_m_s * 100.0, **given)

    stream = functools.partialmethod(Rig.give, mask=2496, frame=5, is_global=True)
    """By default GLOBAL_INT above the sea, position and velocity."""

    @property
    def north_m(self) -> float:
        return (self.copter.latitude_deg - HOME_DEG[0]) * METRES_PER_DEG_NORTH

    def target(self) -> Any:
        return self.autopilot.target_echo()


ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
STABILIZE, GUIDED, RTL, LAND, BRAKE = 0, 4, 6, 9, 17
ON_GROUND, IN_AIR, TAKEOFF, LANDING = 1, 2, 3, 4


@pytest.mark.parametrize(
    ("number", "parameters", "fields", "result"),
    [
        (176, (1, STABILIZE), {}, ACCEPTED),
        (176, (0, GUIDED), {}, DENIED),
        (176, (1, 99), {}, FAILED),
        (176, (1, math.nan), {}, FAILED),
        (176, (math.nan, 4), {}, DENIED),
        (400, (7,), {}, UNSUPPORTED),
        (22, (0, 0, 0, 0, 0, 0, 30), {}, FAILED),  # disarmed
        (520, (1,), {}, ACCEPTED),
        (410, (), {}, FAILED),  # there is no home yet
        (179, (1,), {}, FAILED),
        (207, (1,), {}, ACCEPTED),
        (207, (7,), {}, FAILED),
        (246, (1,), {}, ACCEPTED),
        (246, (0,), {}, UNSUPPORTED),
        (20, (), {}, ACCEPTED),  # a mode change, which is not checked while disarmed
        (300, (), {}, FAILED),
        (178, (1, 0), {}, FAILED),
        (31000, (), {}, UNSUPPORTED),
        (192, (), {}, UNSUPPORTED),
        (400, (1,), {"target_component": 99}, UNSUPPORTED),
    ],
)
def test_every_command_is_answered_as_on_the_real_one(
    number: int, parameters: tuple[float, ...], fields: dict[str, int], result: int
) -> None:
    assert Pilot().command(number, *parameters, **fields) == result


def test_guided_is_had_without_a_position_but_armed_in_only_with_one() -> None:
    it = Pilot()
    it.run(30.0)
    assert it.command(176, 1, GUIDED) == ACCEPTED
    assert it.autopilot.status().prearm_ok
    assert it.command(400, 1) == FAILED
    assert it.texts[-1] == "Arm: Need Position Estimate"
    it.run(12.0)
    assert it.command(400, 1) == ACCEPTED
    assert it.autopilot.status().base_mode == 217  # as ArduCopter's, armed in GUIDED


def test_motors_that_idle_for_ten_seconds_are_disarmed() -> None:
    it = Pilot()
    it.run(42.0)
    it.command(176, 1, GUIDED)
    it.command(400, 1)
    assert it.run_until(lambda: not it.autopilot.armed, within_s=20) == pytest.approx(10, abs=0.1)


@pytest.mark.parametrize("mode", [2, 5, 16])  # ALT_HOLD, LOITER, POSHOLD
def test_without_a_pilot_the_hold_modes_come_down(mode: int) -> None:
    it = Pilot(2.5, 2.5).airborne(30.0)
    assert it.command(176, 1, mode) == ACCEPTED
    it.run(8.0)
    assert it.copter.velocity_up_m_s == pytest.approx(-2.5, abs=0.05)


def test_rtl_climbs_to_15_m_comes_home_waits_and_lands() -> None:
    it = Pilot(2.5, 1.5).airborne(5.0)
    for _ in range(200):
        it.stream((47.001, 8.0, 5.0), mask=0xDF8)
        it.run(0.1)
    away_m = it.north_m
    assert away_m > 80.0
    assert it.command(176, 1, RTL) == ACCEPTED
    it.run_until(lambda: it.copter.altitude_amsl_m > 14.0, within_s=20)
    assert it.north_m == pytest.approx(away_m, abs=15.0)  # it stops first
    assert it.target() is None
    assert it.autopilot.status().waypoint.place.altitude_amsl_m == pytest.approx(15.0, abs=0.1)
    it.run_until(lambda: it.autopilot.status().landed_state == LANDING, within_s=60)
    assert abs(it.north_m) < 2.0
    it.run_until(lambda: not it.autopilot.armed, within_s=60)
    assert abs(it.north_m) < 0.5


def test_reposition_is_taken_as_command_int_only() -> None:
    it = Pilot().airborne(100.0)
    there = (-1, 1, 0, 0, 47.0005, 8.0, 120.0)
    assert it.command(192, *there) == UNSUPPORTED
    assert it.command(176, 1, BRAKE) == ACCEPTED
    assert it.command(192, -1, 0, 0, 0, 47.0005, 8.0, 120.0, frame=3) == DENIED
    assert it.command(192, *there, frame=3) == ACCEPTED
    assert it.autopilot.mode_name == "GUIDED"
    it.run(30.0)
    assert it.north_m == pytest.approx(55.6, abs=0.5)
    assert it.copter.altitude_amsl_m == pytest.approx(120.0, abs=0.3)


def test_a_low_battery_is_told_and_acted_on_after_ten_seconds() -> None:
    it = Pilot().airborne(30.0)
    it.autopilot.battery = Battery(voltage_v=10.4, consumed_mah=2000.0)
    it.autopilot.parameters["BATT_LOW_VOLT"] = 10.5
    it.autopilot.parameters["BATT_FS_LOW_ACT"] = 2
    it.run(9.8)
    assert it.autopilot.mode_name == "GUIDED"
    it.run(0.5)
    assert it.autopilot.mode_name == "RTL"
    assert "Battery 1 is low 10.40V used 2000 mAh" in it.texts


def test_brake_stops_and_ignores_setpoints() -> None:
    it = Pilot().airborne(100.0)
    it.copter.velocity_north_m_s = 15.0
    it.command(176, 1, BRAKE)
    it.stream((47.1, 8.0, 500.0), (10.0, 0.0, 0.0))
    it.run(8.0)
    assert it.north_m == pytest.approx(15.0**2 / (2 * 7.5), abs=3.0)
    at_m = it.north_m
    it.run(5.0)
    assert it.north_m == pytest.approx(at_m, abs=0.05)
    assert it.target() is None


def test_a_crash_on_the_ground_is_said_and_the_end() -> None:
    it = Pilot().airborne(20.0)  # test_contact.py says what is one
    it.stream((47.0, 8.0, -500.0), mask=0xDF8)
    it.run_until(lambda: it.copter.altitude_amsl_m == 0.0)
    it.take(it.autopilot.crash())
    assert it.autopilot.landed
    assert not it.autopilot.armed
    assert any(text.startswith("Crash") for text in it.texts)


def test_disarming_in_flight_needs_force_and_is_the_end() -> None:
    it = Pilot().airborne(50.0)
    assert it.command(400, 0) == FAILED
    assert it.command(400, 0, 21196) == ACCEPTED
    fell_s = it.run_until(lambda: it.copter.altitude_amsl_m == 0.0, within_s=10)
    assert fell_s == pytest.approx(3.2, abs=0.1)


def test_a_take_off_needs_a_height_above_it() -> None:
    it = Pilot()
    it.run(42.0)
    it.command(176, 1, GUIDED)
    it.command(400, 1)
    for height_m in (math.nan, math.inf, 0.0, -5.0):
        assert it.command(22, 0, 0, 0, 0, 0, 0, height_m) == FAILED


# --- streams of setpoints -------------------------------------------------------------------------


def at(north_m: float, east_m: float) -> tuple[float, float, float]:
    longitude_deg, latitude_deg, _ = WGS84.fwd(
        8.0, 47.0, math.degrees(math.atan2(east_m, north_m)), math.hypot(north_m, east_m)
    )
    return latitude_deg, longitude_deg, 1000.0


def place_m(it: Pilot) -> tuple[float, float]:
    copter = it.copter
    azimuth_deg, _, distance_m = WGS84.inv(8.0, 47.0, copter.longitude_deg, copter.latitude_deg)
    azimuth_rad = math.radians(azimuth_deg)
    return distance_m * math.cos(azimuth_rad), distance_m * math.sin(azimuth_rad)


@pytest.mark.sample(2)
@pytest.mark.parametrize("every_steps", [10, 5])
def test_a_turn_of_9_m_s2_at_150_m_s_is_entered_without_overshoot_and_followed(
    every_steps: int,
) -> None:
    it = Pilot().airborne(1000.0)
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
            is_n, is_e = place_m(it)
            worst_m = max(worst_m, math.hypot(is_n - north, is_e - east))
            copter = it.copter
            lateral = (
                copter.acceleration_east_m_s2 * copter.velocity_north_m_s
                - copter.acceleration_north_m_s2 * copter.velocity_east_m_s
            ) / math.hypot(copter.velocity_north_m_s, copter.velocity_east_m_s)
            most_m_s2 = max(most_m_s2, lateral)
        if k % every_steps == 0:
            it.stream(at(north, east), (v * math.cos(turn_rad), v * math.sin(turn_rad), 0.0))
        it.step()
    assert most_m_s2 <= 9.0 * 1.05
    assert 5.0 < worst_m <= 15.0


def test_a_stream_with_climb_is_followed_in_height_too() -> None:
    it = Pilot().airborne(1000.0)
    for k in range(3000):
        t = k * 0.01
        height = 1000.0 + (t * t / 2 if t < 10 else 50 + 10 * (t - 10))
        if k % 10 == 0:
            latitude_deg, longitude_deg, _ = at(0.0, 0.0)
            it.stream((latitude_deg, longitude_deg, height), (0.0, 0.0, -min(t, 10.0)))
        it.step()
    assert it.copter.altitude_amsl_m == pytest.approx(1250.0, abs=0.3)


def test_the_nose_follows_the_commanded_yaw_or_else_the_way() -> None:
    it = Pilot().airborne(1000.0)
    it.stream(at(0.0, 0.0), yaw_rad=-2.0)
    it.run(6.0)
    assert math.remainder(it.copter.heading_rad + 2.0, math.tau) == pytest.approx(0.0, abs=1e-6)
    for _ in range(100):
        it.stream((0.0, 0.0, 0.0), (0.0, 5.0, 0.0), mask=VELOCITY_ONLY)
        it.run(0.1)
    assert it.copter.heading_rad == pytest.approx(math.pi / 2, abs=0.01)


# --- setpoints and their echo ---------------------------------------------------------------------


def test_an_acceleration_alone_is_flown_until_the_time_out() -> None:
    it = Pilot().airborne(100.0)
    for _ in range(30):
        it.stream(mask=0xC3F, frame=1, is_global=False, acceleration=(1.0, 0.0, 0.0))
        it.run(0.1)
    assert it.copter.velocity_north_m_s == pytest.approx(2.9, abs=0.4)
    assert it.target().type_mask == 0xC3F
    it.run(12.0)
    assert it.copter.velocity_north_m_s == pytest.approx(0.0, abs=0.1)


def test_the_echo_is_ardupilots_flat_earth_about_the_origin() -> None:
    hovering = Pilot().airborne(100.0)
    latitude_deg, longitude_deg = 47.5, 8.6
    hovering.stream((latitude_deg, longitude_deg, 150.0))
    scale = 0.011131884502145034  # metres for each 1e-7 degree, from ArduPilot's Location.cpp
    north = (latitude_deg - 47.0) * 1e7 * scale
    east = (longitude_deg - 8.0) * 1e7 * scale * math.cos(math.radians((latitude_deg + 47.0) / 2))
    assert hovering.target().position_ned_m == pytest.approx((north, east, -150.0), abs=1e-3)


def test_a_gust_that_presses_it_down_ends_no_take_off() -> None:
    it = Flown()
    it.copter.wind_up_m_s = -1.0
    assert it.airborne(10.0).local_m()[2] == pytest.approx(10.0, abs=1.0)
