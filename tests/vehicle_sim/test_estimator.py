"""What the estimators say and believe, and when: against the recorded flights with GPS losses.

ArduPilot's EKF3 (arducopter-gps-loss.tlog, ardupilot.md 5) and PX4's EKF2 (px4-gps-loss.tlog,
px4.md 8), in flight.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
from conformance.flights import Side, read_recording
from harness import STEP_S
from harness import Flown as OnGround
from recordings import recording
from tracked import PX4_GPS, ArduCopter, Curve, Px4Copter, fix_of

from vehicle_sim.faults import GpsConditions
from vehicle_sim.geodesy import metres_per_degree
from vehicle_sim.sensors.gps import Fix

LAND, CRITICAL, ACTIVE = 9, 5, 4


# --- ArduPilot ------------------------------------------------------------------------------------


class Ardu(ArduCopter):
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
        return fix._replace(latitude_deg=fix.latitude_deg + shift_deg)

    def fly_on(self, seconds: float, seen: Callable[[], None] | None = None) -> None:
        for k in range(round(seconds / STEP_S)):
            if k % 10 == 0:
                self.setpoint((0.0, 0.0, -30.0), kind="pos+vel")
            self.step()
            if seen is not None:
                seen()

    @property
    def north_m(self) -> float:
        """In truth."""
        return (self.copter.latitude_deg - 47.0) * metres_per_degree(47.0)[0]


@pytest.fixture
def hovering() -> Ardu:
    it = Ardu(ANGLE_MAX=4500.0)
    it.airborne(30.0)
    it.said.clear()
    return it


def test_it_follows_the_truth_within_centimetres_while_gps_is_good(hovering: Ardu) -> None:
    it, scale, worst_m, north_m = hovering, metres_per_degree(47.0)[0], 0.0, 0.0
    for k in range(4000):
        v = min(k * STEP_S, 10.0)
        if k % 10 == 0:
            it.setpoint((north_m, 0.0, -30.0), (v, 0.0, 0.0), kind="pos+vel+acc")
        it.step()
        north_m += v * STEP_S
        error_deg = it.autopilot.estimate.latitude_deg - it.copter.latitude_deg
        worst_m = max(worst_m, abs(error_deg) * scale)
    assert worst_m < 0.02


def test_a_jump_of_gps_is_resisted_for_ten_seconds_and_then_believed(hovering: Ardu) -> None:
    it, flags, norths, ratios = hovering, list[int](), list[float](), list[float]()
    start_s, it.step_north_m = it.now_s, 50.0

    def look() -> None:
        flags.append(it.autopilot.estimate.flags)
        norths.append(it.local_m()[0])
        ratios.append(it.autopilot.estimate.horizontal_variance)

    it.fly_on(11.0, look)
    assert [ratios[50], ratios[900]] == pytest.approx([13.3, 10.8], rel=0.02)
    steps = np.abs(np.diff(norths))
    assert (np.flatnonzero(steps > 5.0) + 1) * STEP_S == pytest.approx([10.3], abs=0.4)
    assert steps.max() == pytest.approx(50.0, abs=1.0)
    assert flags.index(0x833F) < flags.index(0x8027)
    assert it.when("GPS Glitch or Compass error") == pytest.approx([start_s + 1.2], abs=0.25)
    assert it.autopilot.mode_name == "GUIDED"
    it.fly_on(12.0)
    assert it.when("Glitch cleared") == pytest.approx([start_s + 20.2], abs=0.5)
    assert it.north_m == pytest.approx(-50.0, abs=1.0)


def test_without_gps_it_lands_and_stops_aiding_as_recorded(hovering: Ardu) -> None:
    it, at_flags = hovering, dict[int, float]()
    start_s, it.silent = it.now_s, True

    def look() -> None:
        at_flags.setdefault(it.autopilot.estimate.flags, it.now_s - start_s)

    def tells() -> tuple[int, int, bool]:
        status = it.autopilot.status()
        return status.mode, status.system_status, it.autopilot.local_ned_m() is not None

    it.fly_on(11.0, look)  # a failsafe's landing waits four seconds before it goes down
    assert it.height_m == pytest.approx(30.0, abs=0.3)
    it.fly_on(7.0, look)
    assert it.copter.velocity_up_m_s == pytest.approx(-1.5, abs=0.05)
    assert at_flags[0x25] == pytest.approx(7.2, abs=0.3)
    assert at_flags[0xA7] == pytest.approx(15.1, abs=0.2)
    for text in ("EKF variance", "EKF Failsafe: changed to LAND Mode"):
        assert it.when(text) == pytest.approx([start_s + 8.0], abs=0.3)
    assert tells() == (LAND, CRITICAL, False)
    before = it.autopilot.estimate.place[:2]
    it.fly_on(7.0)
    assert it.autopilot.estimate.place[:2] == before
    it.silent, back_s = False, it.now_s
    it.fly_on(2.0)
    assert it.when("EKF Failsafe Cleared") == pytest.approx([back_s + 1.2], abs=0.2)
    assert tells() == (LAND, ACTIVE, True)  # until somebody commands another mode


def test_a_reset_moves_the_position_and_stays(hovering: Ardu) -> None:
    before_m = hovering.local_m()[0]
    hovering.autopilot.reset_estimate(20.0, 0.0)
    hovering.step()
    assert hovering.local_m()[0] - before_m == pytest.approx(20.0, abs=0.1)
    hovering.fly_on(30.0)
    assert hovering.when("GPS Glitch or Compass error") == []
    assert hovering.north_m == pytest.approx(-20.0, abs=0.5)


def test_a_moved_origin_changes_local_positions_only(hovering: Ardu) -> None:
    place, local = hovering.autopilot.estimate.place, hovering.local_m()
    hovering.autopilot.move_origin(10.0, 5.0, 1.0)
    assert hovering.autopilot.estimate.place == place
    moved = np.subtract(hovering.local_m(), local)
    assert moved == pytest.approx([-10.0, -5.0, -1.0], abs=0.01)


def test_a_receiver_that_is_late_makes_everything_late() -> None:
    it = Ardu()
    it.silent = True
    it.run(30.0)
    it.silent = False
    there = list[tuple[bool, bool]]()
    for seconds in (9.5, 1.0, 21.0, 1.0):
        it.run(seconds)
        estimator = it.autopilot.estimator
        there.append((estimator.origin is not None, estimator.aiding))
    assert there == [(False, False), (True, False), (True, False), (True, True)]


@pytest.mark.parametrize("kind", ["copter", "plane"])
def test_an_outage_of_ten_seconds_leaves_it_armable_again(kind: str) -> None:
    it = OnGround(kind, "ardupilot")  # between 7 s, "timed out", and 15 s, "stopped aiding"
    it.simulation.add_fault("for 10 s: gps_off")
    it.fly_until(lambda: not it.simulation.armable, 10.0)
    it.fly_until(lambda: it.simulation.armable, 5.0)


# --- PX4 ------------------------------------------------------------------------------------------

_LOG = "px4-gps-loss.tlog"
_NO_FIX = GpsConditions(lag_s=0.0, enabled=False, satellites=0)
_FIX = PX4_GPS
_LOST_S = 30.0
"""80.97 to 110.97 s of the log."""
_SPEED_M_S = 6.0
_HERE = (0.0, 0.0, -10.0)


class Loss:
    """A flight along the curve that loses its GPS after 30 s for as long, the stream going on."""

    def __init__(self, seed: int = 1) -> None:
        self.rig = rig = Px4Copter(seed)
        self.samples = list[tuple[float, float, str, float]]()
        """Time since the loss, accuracy, mode, and how far the estimate is off."""
        curve = Curve()
        rig.take_off(20.0)
        self.lost_s = rig.now_s + 30.0
        for k in range(9000):
            lost = 0.0 <= rig.now_s - self.lost_s < _LOST_S
            rig.gps_conditions = _NO_FIX if lost else _FIX
            if k % 5 == 0:
                position, velocity, _, yaw_rad = curve.at(_SPEED_M_S * k * STEP_S, _SPEED_M_S)
                rig.send(position, velocity, None, yaw_rad)
            rig.step()
            estimate, copter = rig.px4.estimate, rig.copter
            off_m = math.hypot(
                (estimate.latitude_deg - copter.latitude_deg) * 111_200.0,
                (estimate.longitude_deg - copter.longitude_deg) * 75_300.0,
            )
            sample = (estimate.horizontal_accuracy_m, rig.px4.mode_name, off_m)
            self.samples.append((rig.now_s - self.lost_s, *sample))

    def at(self, since_s: float) -> tuple[float, float, str, float]:
        """The sample of this time since the loss."""
        return next(sample for sample in self.samples if sample[0] >= since_s)

    def when(self, mode: str, after_s: float) -> float:
        """Seconds since the loss until this mode."""
        return next(each[0] for each in self.samples if each[0] >= after_s and each[2] == mode)


@pytest.fixture(scope="module")
def loss() -> Loss:
    return Loss()


def test_it_comes_back_and_flies_on_by_itself(loss: Loss) -> None:
    """px4.md 8: fusion after 1.2 s, OFFBOARD after 2.4 s, by way of Land."""
    used_s = loss.rig.px4.estimator.returned_s
    assert used_s is not None
    assert used_s - loss.lost_s == pytest.approx(_LOST_S + 1.3, abs=0.3)
    assert loss.when("Offboard", 6.0) == pytest.approx(_LOST_S + 2.5, abs=0.3)
    assert loss.when("Land", 0.0) == pytest.approx(_LOST_S + 2.3, abs=0.3)
    assert loss.samples[-1][2] == "Offboard"
    assert loss.rig.height_m > 10.0


def test_accuracy_grows_as_recorded(loss: Loss) -> None:
    """ESTIMATOR_STATUS of the log: within 0.35 m and 15 %, the two seconds of the jump apart."""
    told = Side(read_recording(recording(_LOG)).said).of(230)
    recorded = [(m.time_usec * 1e-6 - 80.97, m.pos_horiz_accuracy) for _, m in told]
    compared = [(s, m) for s, m in recorded if 0.2 < s < 30.0 and not 5.0 < s < 7.0]
    assert len(compared) > 25
    for since_s, accuracy_m in compared:
        assert loss.at(since_s)[1] == pytest.approx(accuracy_m, rel=0.15, abs=0.35)


def test_the_estimate_drifts_and_jumps_back(loss: Loss) -> None:
    """31 m in the log, from one accelerometer's error: 20 to 45 m with others."""
    for one in (loss, Loss(seed=2)):
        assert 20.0 < one.at(_LOST_S + 1.1)[3] < 45.0
        assert one.at(_LOST_S + 4.0)[3] < 2.0


def test_a_short_loss_is_not_noticed() -> None:
    rig = Px4Copter()
    rig.take_off(10.0)
    for rig.gps_conditions in (_NO_FIX, _FIX):
        rig.stream(4.0, position=_HERE)
    assert rig.px4.mode_name == "Offboard"
    assert rig.px4.estimate.flags == 0x37F


def test_a_glitch_is_refused_for_seven_seconds_and_then_believed() -> None:
    """Source: reset_timeout_max 7 s."""
    rig = Px4Copter()
    rig.take_off(10.0)
    rig.gps_conditions = GpsConditions(lag_s=0.0, glitch_latitude_deg=0.00045)
    before_deg = rig.copter.latitude_deg
    rig.stream(6.0, position=_HERE)
    assert abs(rig.copter.latitude_deg - before_deg) * 111_200.0 < 3.0
    rig.stream(15.0, position=_HERE)
    moved_m = (rig.copter.latitude_deg - before_deg) * 111_200.0
    assert moved_m == pytest.approx(-50.0, abs=3.0)


def test_hover_wanders_by_a_few_decimetres() -> None:
    """px4.md: 0.2 to 0.4 m of hover "noise"; 0.13 m standard deviation in the log."""
    rig = Px4Copter()
    rig.take_off(10.0)
    positions = []
    for _ in range(60):
        rig.stream(0.5, position=_HERE)
        positions.append(rig.px4.local_m[:2])
    assert 0.03 < float(np.array(positions).std(axis=0).mean()) < 0.3
