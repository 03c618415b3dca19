"""Commands, boot, take-off and landing; the figures are those of the real ArduCopter."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from vehicle_sim.autopilots import Battery, SayParameter
from vehicle_sim.autopilots.ardupilot.style import STREAMABLE
from vehicle_sim.wire.telemetry_ardupilot import MESSAGES

Make = Callable[..., Any]
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
STABILIZE, GUIDED, RTL, LAND, BRAKE = 0, 4, 6, 9, 17
ON_GROUND, IN_AIR, TAKEOFF, LANDING = 1, 2, 3, 4


def test_the_boot_takes_its_time_and_arming_waits_for_the_position(pilot: Make) -> None:
    it = pilot()
    it.run(9.9)
    assert it.autopilot.estimate.latitude_deg == 0.0
    it.run(0.2)
    assert it.autopilot.estimate.latitude_deg != 0.0
    assert it.autopilot.status().origin is None
    assert it.command(176, 1, GUIDED) == ACCEPTED  # even without a position
    it.run(10.0)
    assert it.autopilot.status().origin is not None
    assert it.command(400, 1) == FAILED
    assert it.texts[-1] == "Arm: Need Position Estimate"
    it.run(20.0)
    assert it.autopilot.status().prearm_ok
    assert (it.autopilot.estimate.position_ok, it.autopilot.estimate.flags) == (False, 0xA7)
    assert it.autopilot.status().local_ned_m is None
    assert it.command(400, 1) == FAILED
    it.run(2.0)
    assert (it.autopilot.estimate.position_ok, it.autopilot.estimate.flags) == (True, 0x33F)
    assert it.autopilot.status().local_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
    assert "EKF3 IMU0 is using GPS" in it.texts
    assert it.command(400, 1) == ACCEPTED
    assert it.autopilot.status().base_mode == 217  # as ArduCopter's, armed in GUIDED


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
        (241, (), {}, ACCEPTED),
        (246, (1,), {}, ACCEPTED),
        (246, (0,), {}, UNSUPPORTED),
        (20, (), {}, ACCEPTED),  # a mode change, which is not checked while disarmed
        (193, (7,), {}, DENIED),
        (300, (), {}, FAILED),
        (178, (1, 0), {}, FAILED),
        (31000, (), {}, UNSUPPORTED),
        (192, (), {}, UNSUPPORTED),
        (400, (1,), {"target_component": 99}, UNSUPPORTED),
    ],
)
def test_every_command_is_answered_as_on_the_real_one(
    pilot: Make, number: int, parameters: tuple[float, ...], fields: dict[str, int], result: int
) -> None:
    assert pilot().command(number, *parameters, **fields) == result


def test_what_can_be_said_can_be_asked_for_but_for_timesync() -> None:
    assert set(MESSAGES) - STREAMABLE == {111}


def test_motors_that_idle_for_ten_seconds_are_disarmed(pilot: Make) -> None:
    it = pilot()
    it.run(42.0)
    it.command(176, 1, GUIDED)
    it.command(400, 1)
    assert it.run_until(lambda: not it.autopilot.armed, within_s=20) == pytest.approx(10, abs=0.1)


@pytest.mark.parametrize("mode", [2, 5, 16])  # ALT_HOLD, LOITER, POSHOLD
def test_without_a_pilot_the_hold_modes_come_down(pilot: Make, mode: int) -> None:
    it = pilot(vertical_m_s=2.5).airborne(30.0)
    assert it.command(176, 1, mode) == ACCEPTED
    it.run(8.0)
    assert it.copter.velocity_up_m_s == pytest.approx(-2.5, abs=0.05)


def test_rtl_climbs_to_15_m_comes_home_waits_and_lands(pilot: Make) -> None:
    it = pilot(vertical_m_s=2.5, down_m_s=1.5).airborne(5.0)
    for _ in range(200):
        it.setpoint((47.001, 8.0, 5.0), mask=0xDF8)
        it.run(0.1)
    away_m = it.north_m()
    assert away_m > 80.0
    assert it.command(176, 1, RTL) == ACCEPTED
    it.run_until(lambda: it.copter.altitude_amsl_m > 14.0, within_s=20)
    assert it.north_m() == pytest.approx(away_m, abs=15.0)  # it stops first
    assert it.target() is None
    assert it.autopilot.status().waypoint.place.altitude_amsl_m == pytest.approx(15.0, abs=0.1)
    it.run_until(lambda: it.autopilot.status().landed_state == LANDING, within_s=60)
    assert abs(it.north_m()) < 2.0
    it.run_until(lambda: not it.autopilot.armed, within_s=60)
    assert abs(it.north_m()) < 0.5


def test_reposition_is_taken_as_command_int_only(pilot: Make) -> None:
    it = pilot().airborne(100.0)
    there = (-1, 1, 0, 0, 47.0005, 8.0, 120.0)
    assert it.command(192, *there) == UNSUPPORTED
    assert it.command(176, 1, BRAKE) == ACCEPTED
    assert it.command(192, -1, 0, 0, 0, 47.0005, 8.0, 120.0, frame=3) == DENIED
    assert it.command(192, *there, frame=3) == ACCEPTED
    assert it.autopilot.mode_name == "GUIDED"
    it.run(30.0)
    assert it.north_m() == pytest.approx(55.6, abs=0.5)
    assert it.copter.altitude_amsl_m == pytest.approx(120.0, abs=0.3)


def test_a_low_battery_is_told_and_acted_on_after_ten_seconds(pilot: Make) -> None:
    it = pilot().airborne(30.0)
    it.autopilot.battery = Battery(voltage_v=10.4, consumed_mah=2000.0)
    it.autopilot.parameters["BATT_LOW_VOLT"] = 10.5
    it.autopilot.parameters["BATT_FS_LOW_ACT"] = 2
    it.run(9.8)
    assert it.autopilot.mode_name == "GUIDED"
    it.run(0.5)
    assert it.autopilot.mode_name == "RTL"
    assert "Battery 1 is low 10.40V used 2000 mAh" in it.texts


def test_statistics_are_told_unasked_as_recorded(pilot: Make) -> None:
    it = pilot()
    told: list[tuple[float, float]] = []
    for _ in range(10_000):
        count = len(it.said)
        it.step()
        for at_s, reply in it.said[count:]:
            if isinstance(reply, SayParameter) and reply.name.startswith("STAT_"):
                told.append((at_s, it.autopilot.parameters[reply.name]))
    assert [value for _, value in told] == [30.0, 60.0, 91.0]
    assert [at_s for at_s, _ in told] == pytest.approx([30.44, 60.45, 91.47], abs=0.15)


def test_brake_stops_and_ignores_setpoints(pilot: Make) -> None:
    it = pilot().airborne(100.0)
    it.copter.velocity_north_m_s = 15.0
    it.command(176, 1, BRAKE)
    it.setpoint((47.1, 8.0, 500.0), (10.0, 0.0, 0.0))
    it.run(5.0)
    assert it.north_m() == pytest.approx(15.0**2 / (2 * 7.5), abs=3.0)
    at_m = it.north_m()
    it.run(5.0)
    assert it.north_m() == pytest.approx(at_m, abs=0.05)
    assert it.target() is None


def test_flying_into_the_ground_is_a_crash_and_says_so(pilot: Make) -> None:
    it = pilot().airborne(200.0)
    it.setpoint((47.0, 8.0, -500.0), mask=0xDF8)
    it.run(60.0)
    assert it.copter.altitude_amsl_m == 0.0
    assert not it.autopilot.armed
    assert any(text.startswith("Crash") for text in it.texts)


def test_disarming_in_flight_needs_force_and_is_the_end(pilot: Make) -> None:
    it = pilot().airborne(50.0)
    assert it.command(400, 0) == FAILED
    assert it.command(400, 0, 21196) == ACCEPTED
    assert it.run_until(lambda: it.autopilot.landed, within_s=10) == pytest.approx(3.2, abs=0.1)


def test_a_take_off_needs_a_height_above_it(pilot: Make) -> None:
    it = pilot()
    it.run(42.0)
    it.command(176, 1, GUIDED)
    it.command(400, 1)
    for height_m in (math.nan, math.inf, 0.0, -5.0):
        assert it.command(22, 0, 0, 0, 0, 0, 0, height_m) == FAILED
