"""Commands, boot, take-off and landing; the figures are those of the real ArduCopter."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from vehicle_sim.autopilots.facts import STREAMABLE
from vehicle_sim.telemetry import MESSAGES

Make = Callable[..., Any]
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
STABILIZE, GUIDED, LAND, BRAKE = 0, 4, 9, 17
ON_GROUND, IN_AIR, TAKEOFF, LANDING = 1, 2, 3, 4


def test_the_boot_takes_its_time_and_arming_waits_for_the_position(pilot: Make) -> None:
    it = pilot()
    it.run(9.9)
    assert not it.autopilot.report().gps_fix
    it.run(0.2)
    assert it.autopilot.report().gps_fix
    assert it.autopilot.report().origin is None
    assert it.command(176, 1, GUIDED) == ACCEPTED  # even without a position
    it.run(10.0)
    assert it.autopilot.report().origin is not None
    assert it.command(400, 1) == FAILED
    assert it.texts[-1] == "Arm: Need Position Estimate"
    it.run(20.0)
    report = it.autopilot.report()
    assert (report.health_ok, report.position_ok, report.ekf_flags) == (True, False, 0xA7)
    assert it.command(400, 1) == FAILED
    it.run(2.0)
    report = it.autopilot.report()
    assert (report.position_ok, report.ekf_flags) == (True, 0x33F)
    assert "EKF3 IMU0 is using GPS" in it.texts
    assert it.command(400, 1) == ACCEPTED
    assert it.autopilot.report().base_mode == 217  # as ArduCopter's, armed in GUIDED


@pytest.mark.parametrize(
    ("number", "parameters", "fields", "result"),
    [
        (176, (1, STABILIZE), {}, ACCEPTED),
        (176, (0, GUIDED), {}, DENIED),
        (176, (1, 5), {}, FAILED),
        (176, (1, math.nan), {}, FAILED),
        (176, (math.nan, 4), {}, DENIED),
        (400, (7,), {}, UNSUPPORTED),
        (22, (0, 0, 0, 0, 0, 0, 30), {}, FAILED),  # disarmed
        (511, (33, 100_000), {}, ACCEPTED),
        (511, (33, -1), {}, ACCEPTED),
        (511, (33, math.nan), {}, DENIED),
        (511, (33, 100_000, 1), {}, DENIED),
        (511, (230, 100_000), {}, DENIED),  # ESTIMATOR_STATUS
        (511, (331, 100_000), {}, DENIED),
        (511, (111, 100_000), {}, DENIED),
        (511, (math.nan, 1), {}, DENIED),
        (512, (148,), {}, ACCEPTED),
        (512, (300,), {}, FAILED),
        (512, (242,), {}, FAILED),  # there is no home yet
        (192, (), {}, UNSUPPORTED),
        (400, (1,), {"target_component": 99}, UNSUPPORTED),
    ],
)
def test_every_command_is_answered_as_on_the_real_one(
    pilot: Make, number: int, parameters: tuple[float, ...], fields: dict[str, int], result: int
) -> None:
    assert pilot().command(number, *parameters, **fields) == result


def test_what_may_be_asked_for_is_what_can_be_said() -> None:
    assert set(MESSAGES) == STREAMABLE


def test_a_take_off_climbs_says_so_and_holds(pilot: Make) -> None:
    it = pilot(vertical_m_s=2.5, ground_amsl_m=120.0)
    it.run(42.0)
    it.command(176, 1, GUIDED)
    assert it.command(22, 0, 0, 0, 0, 0, 0, 30) == FAILED
    it.command(400, 1)
    assert it.command(22, 0, 0, 0, 0, 0, 0, 30, frame=0) == DENIED
    assert it.command(22, 0, 0, 0, 0, 0, 0, math.nan) == FAILED
    assert it.command(22, 0, 0, 0, 0, 0, 0, 30) == ACCEPTED
    state = lambda: it.autopilot.report().landed_state  # noqa: E731
    start_s = it.now_s
    it.run_until(lambda: state() == TAKEOFF, within_s=3)
    it.run_until(lambda: it.copter.altitude_amsl_m >= 125.0, within_s=20)
    assert it.now_s - start_s == pytest.approx(4.6, abs=0.8)
    it.run_until(lambda: it.copter.altitude_amsl_m >= 149.7, within_s=30)
    reached_s = it.now_s
    assert reached_s - start_s == pytest.approx(17.0, abs=3.0)
    it.run_until(lambda: state() == IN_AIR, within_s=5)
    assert it.now_s - reached_s == pytest.approx(1.0, abs=0.05)
    assert it.command(22, 0, 0, 0, 0, 0, 0, 60) == FAILED  # a second one in flight
    it.run(30)
    assert it.copter.altitude_amsl_m == pytest.approx(150.0, abs=0.01)
    assert it.north_m() == pytest.approx(0.0, abs=1e-6)


def test_a_setpoint_on_the_ground_is_echoed_and_lifts_nothing(pilot: Make) -> None:
    it = pilot()
    it.run(42.0)
    it.command(176, 1, GUIDED)
    it.command(400, 1)
    it.setpoint((47.0, 8.0, 50.0))
    it.run(5.0)
    assert it.target().position_ned_m == pytest.approx((0, 0, -50), abs=1e-6)
    assert it.copter.altitude_amsl_m == 0.0
    assert it.autopilot.report().landed_state == ON_GROUND


@pytest.mark.parametrize("after_s", [1.0, 6.0])
def test_a_setpoint_during_the_take_off_ends_it(pilot: Make, after_s: float) -> None:
    it = pilot(vertical_m_s=2.5)
    it.run(42.0)
    it.command(176, 1, GUIDED)
    it.command(400, 1)
    it.command(22, 0, 0, 0, 0, 0, 0, 100)
    it.run(after_s)
    height_m = it.copter.altitude_amsl_m
    it.setpoint((47.0, 8.0, height_m), mask=0xDF8)
    assert it.autopilot.report().landed_state == (ON_GROUND if after_s < 2.0 else IN_AIR)
    it.run(20.0)
    assert it.copter.altitude_amsl_m == pytest.approx(height_m, abs=0.2)


def test_land_comes_down_stands_and_disarms(pilot: Make) -> None:
    it = pilot(vertical_m_s=2.5, down_m_s=1.5).airborne(30.0)
    it.command(176, 1, LAND)
    it.step()
    assert it.autopilot.report().landed_state == LANDING
    took_s = it.run_until(lambda: it.autopilot.report().landed_state == ON_GROUND, within_s=60)
    assert took_s == pytest.approx(35.0, abs=3.0)
    assert it.copter.altitude_amsl_m == 0.0
    assert it.autopilot.armed
    assert it.run_until(lambda: not it.autopilot.armed, within_s=5) == pytest.approx(2.0, abs=0.05)
    assert it.texts[-1] == "EKF3 IMU0 is using GPS"  # no crash was reported


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


def test_guided_without_a_setpoint_holds(pilot: Make) -> None:
    it = pilot().airborne(100.0)
    it.command(176, 1, BRAKE)
    it.command(176, 1, GUIDED)
    it.run(20.0)
    assert it.north_m() == pytest.approx(0.0, abs=0.01)
    assert it.copter.altitude_amsl_m == pytest.approx(100.0, abs=0.1)


def test_flying_into_the_ground_is_a_crash_and_says_so(pilot: Make) -> None:
    it = pilot().airborne(50.0)
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
