"""What the receiver says of a known flight, by what its parameters ask for."""

import bisect
import math
from typing import Any

import numpy as np
import pytest
from harness import GENTLE, PLANE_HOME, ZERO, placed
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
