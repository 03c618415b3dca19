"""What the estimators believe, and when: ArduPilot's EKF3 (ardupilot.md 5), PX4's EKF2 (px4.md 8).

That a vehicle does without GPS what the real one did is seen by conformance/test_recordings.py.
"""

import math
from typing import Any

import numpy as np
import pytest
from conformance.flights import read_recording
from harness import STEP_S, ZERO, Rig, hover, hovering, setpoint
from recordings import recording

# --- ArduPilot ------------------------------------------------------------------------------------


def test_a_jump_of_gps_is_resisted_for_ten_seconds_and_then_believed() -> None:
    it, flags, norths, ratios = hovering(), list[int](), list[float](), list[float]()
    start_s, it.streamed = it.now_s, setpoint((0.0, 0.0, -30.0), ZERO)
    it.fault("gps_glitch 50 m north")

    def look() -> None:
        flags.append(it.autopilot.estimate.flags)
        norths.append(it.ned_m[0])
        ratios.append(it.autopilot.estimate.horizontal_variance)

    it.run(11.0, look)
    assert [ratios[50], ratios[900]] == pytest.approx([13.3, 10.8], rel=0.02)
    steps = np.abs(np.diff(norths))
    assert (np.flatnonzero(steps > 5.0) + 1) * STEP_S == pytest.approx([10.3], abs=0.4)
    assert steps.max() == pytest.approx(50.0, abs=1.0)
    assert flags.index(0x833F) < flags.index(0x8027)
    assert it.when("GPS Glitch or Compass error") == pytest.approx([start_s + 1.2], abs=0.25)
    assert it.mode == "GUIDED"
    it.run(12.0)
    assert it.when("Glitch cleared") == pytest.approx([start_s + 20.2], abs=0.5)
    assert it.simulation.contact.local_m[0] == pytest.approx(-50.0, abs=1.0)


@pytest.mark.parametrize("kind", ["copter", "plane"])
def test_an_outage_of_ten_seconds_leaves_it_armable_again(kind: Any) -> None:
    it = Rig("ardupilot", kind).armable()  # between 7 s, "timed out", and 15 s, "stopped aiding"
    it.fault("for 10 s: gps_off")
    it.until(lambda: not it.simulation.armable, 10.0)
    it.until(lambda: it.simulation.armable, 5.0)


# --- PX4 ------------------------------------------------------------------------------------------

HERE = (0.0, 0.0, -10.0)


def test_accuracy_grows_as_recorded_and_the_estimate_drifts_and_jumps_back() -> None:
    """ESTIMATOR_STATUS of the log, without GPS from 80.97 s on for 30 s: within 0.35 m and 15 %.

    The two seconds of the jump apart; of the drift 31 m, from one accelerometer's error: 20 to 45 m
    with others.
    """
    rig, accuracy_m, off_m = hover(40.0, seed=1), list[float](), list[float]()
    rig.fault("for 30 s: gps_off")
    rig.streamed = setpoint((0.0, 0.0, -40.0))

    def look() -> None:
        estimate, copter = rig.autopilot.estimate, rig.vehicle
        north_m = (estimate.latitude_deg - copter.latitude_deg) * 111_200.0
        east_m = (estimate.longitude_deg - copter.longitude_deg) * 75_300.0
        accuracy_m.append(estimate.horizontal_accuracy_m)
        off_m.append(math.hypot(north_m, east_m))

    rig.run(35.0, look)
    told = read_recording(recording("px4-gps-loss.tlog")).side.of(230)
    recorded = ((m.time_usec * 1e-6 - 80.97, m.pos_horiz_accuracy) for _, m in told)
    real_m = {s: m for s, m in recorded if 0.2 < s < 30.0 and not 5.0 < s < 7.0}
    assert len(real_m) > 25
    seen_m = [accuracy_m[round(s / STEP_S)] for s in real_m]
    assert seen_m == pytest.approx([*real_m.values()], rel=0.15, abs=0.35)
    assert 20.0 < off_m[3110] < 45.0
    assert off_m[3400] < 2.0


def test_a_short_loss_is_not_noticed_and_a_glitch_is_believed_after_seven_seconds() -> None:
    """Source: reset_timeout_max 7 s."""
    rig, moved_m = hover(10.0), list[float]()
    rig.fault("for 4 s: gps_off")
    rig.stream(8.0, HERE)
    assert (rig.mode, rig.autopilot.estimate.flags) == ("Offboard", 0x37F)
    rig = hover(10.0)
    rig.fault("gps_glitch 50 m north")
    for seconds in (6.0, 15.0):
        moved_m.append(rig.stream(seconds, HERE).simulation.contact.local_m[0])
    assert moved_m == [pytest.approx(0.0, abs=3.0), pytest.approx(-50.0, abs=3.0)]
