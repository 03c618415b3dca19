"""What the estimator says and believes, and when: against the recorded flight with GPS losses."""

from collections.abc import Callable

import pytest
from flown import Flown as OnGround
from tracking_copter import (
    GROUND_M,
    STEP_S,
    Flown,
    fix_of,
)

from vehicle_sim.geodesy import metres_per_degree
from vehicle_sim.sensors.gps import Fix

LAND, CRITICAL, ACTIVE = 9, 5, 4


class Recorded(Flown):
    """With a receiver that jumps or falls silent as it is told."""

    step_north_m = 0.0
    silent = False

    def receive(self) -> Fix:
        if self.now_us % 200_000 != 0:
            return self.fix
        if self.silent:
            return Fix(time_us=self.now_us, fix_type=1)
        fix = fix_of(self.copter, self.now_us)
        shift_deg = self.step_north_m / metres_per_degree(self.copter.latitude_deg)[0]
        return Fix(
            time_us=fix.time_us,
            fix_type=fix.fix_type,
            latitude_deg=fix.latitude_deg + shift_deg,
            longitude_deg=fix.longitude_deg,
            altitude_amsl_m=fix.altitude_amsl_m,
        )

    def fly_on(self, seconds: float, seen: Callable[[], None] | None = None) -> None:
        for k in range(round(seconds / STEP_S)):
            if k % 10 == 0:
                self.setpoint((0.0, 0.0, -30.0), kind="pos+vel")
            self.step()
            if seen is not None:
                seen()


@pytest.fixture
def hovering() -> Recorded:
    it = Recorded(ANGLE_MAX=4500.0)
    it.airborne(30.0)
    it.said.clear()
    return it


def test_it_follows_the_truth_within_centimetres_while_gps_is_good() -> None:
    it = Recorded(ANGLE_MAX=4500.0)
    it.airborne(30.0)
    scale = metres_per_degree(it.copter.latitude_deg)[0]
    north_m, worst_m = 0.0, 0.0
    for k in range(4000):
        v = min(k * STEP_S, 10.0)
        if k % 10 == 0:
            it.setpoint((north_m, 0.0, -30.0), (v, 0.0, 0.0), kind="pos+vel+acc")
        it.step()
        north_m += v * STEP_S
        error_deg = it.autopilot.estimate.latitude_deg - it.copter.latitude_deg
        worst_m = max(worst_m, abs(error_deg) * scale)
    assert worst_m < 0.02


def test_a_jump_of_gps_is_resisted_for_ten_seconds_and_then_believed(hovering: Recorded) -> None:
    it, flags, norths = hovering, list[int](), list[float]()
    start_s = it.now_s
    it.step_north_m = 50.0

    def look() -> None:
        flags.append(it.autopilot.estimate.flags)
        norths.append(it.local_m()[0])

    it.fly_on(11.0, look)
    jumps = [k * STEP_S for k in range(1, len(norths)) if abs(norths[k] - norths[k - 1]) > 5.0]
    assert jumps == pytest.approx([10.3], abs=0.4)
    size_m = max(abs(norths[k] - norths[k - 1]) for k in range(1, len(norths)))
    assert size_m == pytest.approx(50.0, abs=1.0)
    assert 0x833F in flags
    assert 0x8027 in flags
    assert it.when("GPS Glitch or Compass error") == pytest.approx([start_s + 1.2], abs=0.25)
    assert it.autopilot.mode_name == "GUIDED"
    it.fly_on(12.0)
    (cleared_s,) = it.when("Glitch cleared")
    assert cleared_s - start_s == pytest.approx(20.2, abs=0.5)
    truth_m = (it.copter.latitude_deg - 47.0) * metres_per_degree(47.0)[0]
    assert truth_m == pytest.approx(-50.0, abs=1.0)  # 50 m off in truth


def test_the_variance_of_a_jump_is_that_of_the_recording(hovering: Recorded) -> None:
    hovering.step_north_m = 50.0
    ratios = []
    for seconds in (0.5, 8.5):
        hovering.fly_on(seconds)
        ratios.append(hovering.autopilot.estimate.horizontal_variance)
    assert ratios == pytest.approx([13.3, 10.8], rel=0.02)


def test_without_gps_it_lands_and_stops_aiding_as_recorded(hovering: Recorded) -> None:
    it, at_flags = hovering, dict[int, float]()
    start_s = it.now_s
    it.silent = True

    def look() -> None:
        at_flags.setdefault(it.autopilot.estimate.flags, it.now_s - start_s)

    it.fly_on(18.0, look)
    assert at_flags[0x25] == pytest.approx(7.2, abs=0.3)
    assert at_flags[0xA7] == pytest.approx(15.1, abs=0.2)
    for text in ("EKF variance", "EKF Failsafe: changed to LAND Mode"):
        assert it.when(text) == pytest.approx([start_s + 8.0], abs=0.3)
    status = it.autopilot.status()
    assert (status.mode, status.system_status) == (LAND, CRITICAL)
    assert it.autopilot.local_ned_m() is None
    before = (it.autopilot.estimate.latitude_deg, it.autopilot.estimate.longitude_deg)
    it.fly_on(7.0)
    assert (it.autopilot.estimate.latitude_deg, it.autopilot.estimate.longitude_deg) == before
    it.silent = False
    back_s = it.now_s
    it.fly_on(2.0)
    assert it.when("EKF Failsafe Cleared") == pytest.approx([back_s + 1.2], abs=0.2)
    status = it.autopilot.status()
    assert (status.mode, status.system_status) == (LAND, ACTIVE)  # until somebody commands it
    assert it.autopilot.local_ned_m() is not None


def test_a_failsafe_landing_waits_four_seconds_before_it_goes_down(hovering: Recorded) -> None:
    it = hovering
    it.silent = True
    it.fly_on(11.0)
    assert it.copter.altitude_amsl_m - GROUND_M == pytest.approx(30.0, abs=0.3)
    it.fly_on(6.0)
    assert it.copter.velocity_up_m_s == pytest.approx(-1.5, abs=0.05)


def test_a_reset_moves_the_position_and_stays(hovering: Recorded) -> None:
    it = hovering
    before_m = it.local_m()[0]
    it.autopilot.reset_estimate(20.0, 0.0)
    it.step()
    assert it.local_m()[0] - before_m == pytest.approx(20.0, abs=0.1)
    it.fly_on(30.0)
    assert it.when("GPS Glitch or Compass error") == []
    truth_m = (it.copter.latitude_deg - 47.0) * metres_per_degree(47.0)[0]
    assert truth_m == pytest.approx(-20.0, abs=0.5)


def test_a_moved_origin_changes_local_positions_only(hovering: Recorded) -> None:
    it = hovering
    place, local = it.autopilot.estimate.place, it.local_m()
    it.autopilot.move_origin(10.0, 5.0, 1.0)
    assert it.autopilot.estimate.place == place
    moved = [after - before for after, before in zip(it.local_m(), local, strict=True)]
    assert moved == pytest.approx([-10.0, -5.0, -1.0], abs=0.01)


def test_a_receiver_that_is_late_makes_everything_late() -> None:
    it = Recorded()
    it.silent = True
    it.run(30.0)
    assert it.autopilot.estimator.origin is None
    it.silent = False
    it.run(9.5)
    assert it.autopilot.estimator.origin is None
    it.run(1.0)
    assert it.autopilot.estimator.origin is not None
    it.run(21.0)
    assert not it.autopilot.estimator.aiding
    it.run(1.0)
    assert it.autopilot.estimator.aiding


@pytest.mark.parametrize("kind", ["copter", "plane"])
def test_an_outage_of_ten_seconds_leaves_it_armable_again(kind: str) -> None:
    it = OnGround(kind, "ardupilot")  # between 7 s, "timed out", and 15 s, "stopped aiding"
    it.simulation.add_fault("for 10 s: gps_off")
    it.until(lambda: not it.simulation.armable, 10.0)
    it.until(lambda: it.simulation.armable, 5.0)
