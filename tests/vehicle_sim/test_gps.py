"""What the receiver says of a known flight, and what the estimators believe of it, and when:
ArduPilot's EKF3 (ardupilot.md 5), PX4's EKF2 (px4.md 8).

That a vehicle does without GPS what the real one did is seen by conformance/test_recordings.py.
"""

import bisect
import math
from typing import Any

import numpy as np
import pytest
from harness import GENTLE, PLANE_HOME, STEP_S, ZERO, Rig, hover, hovering, placed, setpoint
from pyproj import Geod

from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.faults import GpsConditions
from vehicle_sim.geodesy import FloatArray
from vehicle_sim.sensors.gps import ARDUCOPTER, Fix, Gps

WGS84 = Geod(ellps="WGS84")
FINE = GpsConditions()
STEP_US, S = 10_000, 1_000_000
Changes = list[tuple[float, GpsConditions]]
"""From these seconds on."""
approx = pytest.approx

# --- the receiver ---------------------------------------------------------------------------------


def told(
    changes: Changes, until_s: float, *, copter: Copter | None = None, step_us: int = STEP_US
) -> list[Fix]:
    """What it says after each step, of a vehicle that keeps its velocity."""
    vehicle = copter or Copter(**placed(PLANE_HOME), limits=GENTLE)
    gps, starts, found = Gps(ARDUCOPTER, np.random.default_rng(1)), [at for at, _ in changes], []
    for now_us in range(0, round(until_s * S) + 1, step_us):
        conditions = changes[bisect.bisect_right(starts, now_us / S) - 1][1]
        vehicle.advance(0.0, 0.0, 0.0, step_us * 1e-6 if now_us else 0.0)
        found.append(gps.step(now_us, vehicle, conditions))
    return found


def solutions(until_s: float, conditions: Any, **how: Any) -> list[Fix]:
    """Each new one."""
    found = told([(0.0, conditions)], until_s, **how)
    return [fix for k, fix in enumerate(found) if k and fix is not found[k - 1]]


def offsets_m(found: list[Fix], latitude_deg: float = PLANE_HOME[0]) -> FloatArray:
    """North, east, up of home.  -> (K, 3)."""
    rows = []
    for fix in found:
        place = (PLANE_HOME[1], latitude_deg, fix.longitude_deg, fix.latitude_deg)
        azimuth, _, away = WGS84.inv(*place)
        north, east = math.cos(math.radians(azimuth)), math.sin(math.radians(azimuth))
        rows.append((away * north, away * east, fix.altitude_amsl_m - PLANE_HOME[2]))
    return np.array(rows)


@pytest.mark.parametrize("lag_s", [0.0, 0.25])
def test_the_position_is_as_old_as_the_lag_says(lag_s: float) -> None:
    copter = Copter(**placed(PLANE_HOME), limits=GENTLE)
    copter.velocity_m_s = 10.0 + 0j
    found = solutions(30.0, GpsConditions(lag_s=lag_s), copter=copter)[15:]
    expected = [10.0 * (fix.time_us * 1e-6 - lag_s) for fix in found]
    assert offsets_m(found)[:, 0] == approx(np.array(expected), abs=0.005)
    assert {round(fix.velocity_north_m_s, 6) for fix in found} == {10.0}


@pytest.mark.parametrize("latitude_deg", [-35.4, 60.0])
@pytest.mark.parametrize(
    ("glitch", "moved_m"),
    [
        (GpsConditions(glitch_m=(50.0, -30.0, -7.0)), (50.0, -30.0, -7.0)),
        (GpsConditions(glitch_latitude_deg=0.00045, glitch_up_m=9.0), (49.9, 0.0, 9.0)),
    ],
)
def test_a_glitch_moves_the_position_at_once_and_back(
    latitude_deg: float, glitch: GpsConditions, moved_m: tuple[float, float, float]
) -> None:
    copter = Copter(**placed((latitude_deg, *PLANE_HOME[1:])), limits=GENTLE)
    found = told([(0.0, FINE), (12.0, glitch), (15.0, FINE)], 20.0, copter=copter)
    for step, expected_m in ((1199, ZERO), (1218, moved_m)):
        assert offsets_m([found[step]], latitude_deg)[0] == approx(expected_m, abs=0.3)
        assert found[step].fix_type == 6
    assert found[1518][2:5] == found[1199][2:5]


def test_a_drift_goes_on_at_its_speed_and_is_forgotten() -> None:
    drift = GpsConditions(drift_m_s=(0.0, 0.5, 0.1))
    found = solutions(60.0, drift)[3:]
    away, lasted_s = offsets_m(found), (found[-1].time_us - found[0].time_us) * 1e-6
    expected = [0, 0.5 * lasted_s, 0.1 * lasted_s]
    assert away[-1] - away[0] == approx(expected, rel=2e-3, abs=1e-3)
    assert found[-1].velocity_east_m_s == approx(0.5)
    found = told([(0.0, drift), (20.0, FINE)], 30.0)
    assert offsets_m(found[-1:])[0] == approx(ZERO, abs=1e-6)


def test_noise_has_the_standard_deviation_and_correlation_that_are_asked_for() -> None:
    found = solutions(4000.0, GpsConditions(sigma_m=3.0), step_us=100_000)[3:]
    away, lag = offsets_m(found), round(5.0 / 0.2)
    assert away.std(axis=0) == approx([3.0, 3.0, 4.5], rel=0.15)
    for x in away.T:
        assert np.corrcoef(x[lag:], x[:-lag])[0, 1] == approx(math.exp(-1.0), abs=0.12)


def test_a_jammed_receiver_first_loses_its_fix_and_then_says_wild_things() -> None:
    changes = [(0.0, FINE), (20.0, GpsConditions(jammed=True))]
    found = told(changes, 139.9, step_us=200_000)
    lost, wild = found[102:107], found[140:]
    assert found[99].fix_type == 6
    assert {(fix.fix_type, fix.satellites) for fix in lost} == {(1, 0)}
    assert {fix.fix_type for fix in wild} == {1, 6}
    assert 20.0 < np.hypot(*offsets_m(wild)[:, :2].T).max() < 20_000.0
    assert 50.0 < max(abs(fix.velocity_north_m_s) for fix in wild) <= 400.0


# --- the estimators -------------------------------------------------------------------------------


def test_ardupilot_resists_a_jump_for_ten_seconds_and_then_believes_it() -> None:
    it, flags, norths = hovering(), list[int](), list[float]()
    start_s, it.streamed = it.now_s, setpoint((0.0, 0.0, -30.0), ZERO)
    it.fault("gps_glitch 50 m north")

    def look() -> None:
        flags.append(it.autopilot.estimate.flags)
        norths.append(it.ned_m[0])

    it.run(11.0, look)
    steps = np.abs(np.diff(norths))
    assert (np.flatnonzero(steps > 5.0) + 1) * STEP_S == approx([10.3], abs=0.4)
    assert steps.max() == approx(50.0, abs=1.0)
    assert flags.index(0x833F) < flags.index(0x8027)
    assert it.when("GPS Glitch or Compass error") == approx([start_s + 1.2], abs=0.25)
    it.run(12.0)
    assert it.when("Glitch cleared") == approx([start_s + 20.2], abs=0.5)
    assert (it.mode, it.simulation.contact.local_m[0]) == ("GUIDED", approx(-50.0, abs=1.0))


@pytest.mark.parametrize("kind", ["copter", "plane"])
def test_an_outage_of_ten_seconds_leaves_an_ardupilot_armable_again(kind: Any) -> None:
    it = Rig("ardupilot", kind).armable()  # between 7 s, "timed out", and 15 s, "stopped aiding"
    it.fault("for 10 s: gps_off")
    it.until(lambda: not it.simulation.armable, 10.0)
    it.until(lambda: it.simulation.armable, 5.0)


def test_px4s_accuracy_grows_as_measured_and_the_estimate_drifts_and_jumps_back() -> None:
    """px4.md 8: 0.3 to 1.2 m in 5 s, 29 m after 30 s, and a jump of 31 m: one accelerometer's."""
    rig = hover(40.0, seed=1)
    rig.fault("for 30 s: gps_off")
    rig.streamed = setpoint((0.0, 0.0, -40.0))

    def seen(seconds: float) -> tuple[float, float]:
        """Accuracy, and how far off it is."""
        off_m = math.dist(rig.run(seconds).ne_m, rig.simulation.contact.local_m)
        return rig.autopilot.estimate.horizontal_accuracy_m, off_m

    assert seen(5.0)[0] == approx(1.2, abs=0.3)
    assert seen(24.9) == (approx(29.0, rel=0.15), approx(31.0, abs=12.0))
    assert seen(4.0) == (approx(0.3, abs=0.2), approx(0.0, abs=2.0))


def test_px4_does_not_notice_a_short_loss_and_believes_a_glitch_after_seven_seconds() -> None:
    """Source: reset_timeout_max 7 s."""
    rig, moved_m, here = hover(10.0), list[float](), (0.0, 0.0, -10.0)
    rig.fault("for 4 s: gps_off")
    assert rig.stream(8.0, here).mode == "Offboard"
    assert rig.autopilot.estimate.flags == 0x37F
    rig.fault("gps_glitch 50 m north")
    for seconds in (6.0, 15.0):
        moved_m.append(rig.stream(seconds, here).simulation.contact.local_m[0])
    assert moved_m == [approx(0.0, abs=3.0), approx(-50.0, abs=3.0)]
