"""The receiver against the recorded flights and against what its parameters say."""

import bisect
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from conformance.flights import decoded, heard, records
from harness import GENTLE
from numpy.typing import NDArray
from pyproj import Geod
from recordings import recording

from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.faults import GpsConditions
from vehicle_sim.sensors.gps import ARDUCOPTER, PX4, Fix, Gps, Receiver

FloatArray = NDArray[np.float64]
WGS84 = Geod(ellps="WGS84")
HOME = (-35.3632621, 149.1652374, 584.09)
FINE = GpsConditions()
PROMPT = GpsConditions(lag_s=0.0)
STEP_US = 10_000
S = 1_000_000


def standing() -> Copter:
    return Copter(
        latitude_deg=HOME[0], longitude_deg=HOME[1], altitude_amsl_m=HOME[2], limits=GENTLE
    )


def fixes(
    receiver: Receiver,
    until_s: float,
    conditions: GpsConditions = FINE,
    *,
    copter: Copter | None = None,
    seed: int = 1,
    step_us: int = STEP_US,
) -> list[Fix]:
    """Every solution up to then, of a vehicle that keeps its velocity."""
    gps, vehicle = Gps(receiver, np.random.default_rng(seed)), copter or standing()
    found, last = [], None
    for now_us in range(step_us, round(until_s * S) + 1, step_us):
        vehicle.advance(0.0, 0.0, 0.0, step_us * 1e-6)
        fix = gps.step(now_us, vehicle, conditions)
        if fix is not last:
            found.append(fix)
        last = fix
    return found


def offsets_m(found: list[Fix]) -> FloatArray:
    """North, east, up of home.  -> (K, 3)."""
    rows = []
    for fix in found:
        azimuth, _, away = WGS84.inv(HOME[1], HOME[0], fix.longitude_deg, fix.latitude_deg)
        angle = math.radians(azimuth)
        rows.append((away * math.cos(angle), away * math.sin(angle), fix.altitude_amsl_m - HOME[2]))
    return np.array(rows)


# --- the recorded flights -------------------------------------------------------------------------


def recorded(name: str, numbers: set[int]) -> Iterator[tuple[float, Any]]:
    """Seconds of the log and message, of these numbers only."""
    begin_us = None
    for time_us, frame in records(recording(name).read_bytes()):
        begin_us = time_us if begin_us is None else begin_us
        one = heard((time_us - begin_us) * 1e-6, frame)
        if one.number in numbers:
            yield one.time_s, decoded(one)


def replayed(
    receiver: Receiver, changes: list[tuple[float, GpsConditions]], asked_s: list[float]
) -> list[Fix]:
    """The newest solution at each of these times; conditions from their times on."""
    gps, copter, told, now_us = Gps(receiver, np.random.default_rng(1)), standing(), [], 0
    starts = [start for start, _ in changes]
    for time_s in asked_s:
        fix = Fix()
        while now_us <= time_s * S:
            conditions = changes[bisect.bisect_right(starts, now_us / S) - 1][1]
            fix = gps.step(now_us, copter, conditions)
            now_us += STEP_US
        told.append(fix)
    return told


def test_fixes_come_and_go_as_arducopters_did() -> None:
    """Type, satellites, dilution and time of each GPS_RAW_INT of arducopter-gps-loss.tlog."""
    asked: list[tuple[float, Any]] = []
    changes: list[tuple[float, GpsConditions]] = [(0.0, FINE)]
    late_s = 0.0
    for time_s, message in recorded("arducopter-gps-loss.tlog", {2, 23, 24}):
        kind = message.get_type()
        if kind == "SYSTEM_TIME":
            late_s = time_s - message.time_boot_ms * 1e-3  # of the log behind the vehicle
        elif kind == "GPS_RAW_INT":
            asked.append((time_s - late_s, message))
        elif message.param_id == "SIM_GPS1_ENABLE":
            now = FINE._replace(enabled=message.param_value != 0.0)
            changes.append((time_s - late_s, now))
    assert [round(time_s) for time_s, _ in changes] == [0, 163, 188]
    told = replayed(ARDUCOPTER, changes, [time_s for time_s, _ in asked])
    wrong = [
        (time_s, fix.fix_type, real.fix_type, fix.time_us, real.time_usec)
        for (time_s, real), fix in zip(asked, told, strict=True)
        if (fix.fix_type, fix.satellites, fix.time_us)
        != (real.fix_type, real.satellites_visible, real.time_usec)
        or (fix.fix_type and fix.horizontal_dilution != real.eph / 100.0)
        or fix.horizontal_accuracy_m != pytest.approx(real.h_acc * 1e-3)
    ]
    assert len(asked) == 1626
    assert len(wrong) <= 3, wrong[:10]  # that came within a step of a new solution


def test_fixes_come_and_go_as_px4s_did() -> None:
    """px4-gps-loss.tlog, from 76.3 to 106.6 s; time stamps there are those of the vehicle."""
    asked = [message for _, message in recorded("px4-gps-loss.tlog", {24})]
    lost = [real.time_usec / S for real in asked if real.fix_type == 0]
    off = PROMPT._replace(enabled=False, satellites=0)
    changes = [(0.0, PROMPT), (lost[0] - 0.1, off), (lost[-1] + 0.03, PROMPT)]
    told = replayed(PX4, changes, [real.time_usec / S + 0.02 for real in asked])
    for real, fix in zip(asked, told, strict=True):
        assert fix.fix_type == real.fix_type
        assert fix.satellites == real.satellites_visible
        assert fix.horizontal_dilution == real.eph / 100.0
        assert fix.vertical_accuracy_m == pytest.approx(real.v_acc * 1e-3)
    times_us = [fix.time_us for fix in told]
    assert np.diff(times_us).min() > 0  # also without a fix


def test_px4s_noise_is_that_of_the_recorded_receiver() -> None:
    """px4-gps-loss.tlog against LOCAL_POSITION_NED of the same moment, 20 to 75 s."""
    local, real = [], []
    for _, message in recorded("px4-gps-loss.tlog", {24, 32}):
        if message.get_type() == "LOCAL_POSITION_NED":
            local.append((message.time_boot_ms * 1e-3, message.x, message.y))
        elif 25.0 < message.time_usec / S < 80.0:
            real.append((message.time_usec / S, message.lat / 1e7, message.lon / 1e7))
    track, seen = np.array(local), np.array(real)
    north = np.interp(seen[:, 0], track[:, 0], track[:, 1])
    measured = seen[:, 1] * 111_200.0 - north
    step_real = np.diff(measured)  # the difference of two solutions: slow errors cancel
    found = offsets_m(fixes(PX4, 200.0, PROMPT)[1:])
    step_own = np.diff(found[:, 0])
    assert step_own.std() == pytest.approx(step_real.std(), rel=0.15)
    white = (
        np.corrcoef(step_own[1:], step_own[:-1])[0, 1],
        np.corrcoef(step_real[1:], step_real[:-1])[0, 1],
    )
    assert white == pytest.approx((-0.5, -0.5), abs=0.1)  # what differences of white noise have


# --- what the receiver does -----------------------------------------------------------------------


@pytest.mark.parametrize("lag_s", [0.0, 0.1, 0.25, 1.0])
def test_the_position_is_as_old_as_the_lag_says(lag_s: float) -> None:
    copter = standing()
    copter.velocity_north_m_s = 10.0
    found = fixes(ARDUCOPTER, 30.0, GpsConditions(lag_s=lag_s), copter=copter)[15:]
    north_m = offsets_m(found)[:, 0]
    expected = [10.0 * (fix.time_us * 1e-6 - lag_s) for fix in found]
    assert north_m == pytest.approx(np.array(expected), abs=0.005)
    assert {round(fix.velocity_north_m_s, 6) for fix in found} == {10.0}


def test_a_lag_beyond_its_memory_is_as_long_as_that() -> None:
    found = fixes(ARDUCOPTER, 60.0, GpsConditions(lag_s=10_000.0))
    assert all(math.isfinite(fix.latitude_deg) for fix in found)


@pytest.mark.parametrize("latitude_deg", [-35.4, 0.0, 60.0])
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
    gps, copter, told = Gps(ARDUCOPTER, np.random.default_rng(1)), standing(), {}
    copter.latitude_deg = latitude_deg
    for now_us in range(0, 20 * S, STEP_US):
        told[now_us] = gps.step(now_us, copter, glitch if 12 * S <= now_us < 15 * S else FINE)
    for at_us, expected_m in ((11_990_000, (0.0, 0.0, 0.0)), (12_180_000, moved_m)):
        fix = told[at_us]
        azimuth, _, away = WGS84.inv(HOME[1], latitude_deg, fix.longitude_deg, fix.latitude_deg)
        angle = math.radians(azimuth)
        found_m = (away * math.cos(angle), away * math.sin(angle), fix.altitude_amsl_m - HOME[2])
        assert found_m == pytest.approx(expected_m, abs=0.3)
        assert fix.fix_type == 6
    assert told[15_180_000][2:5] == told[11_990_000][2:5]


def test_a_drift_goes_on_at_its_speed_and_is_forgotten() -> None:
    drift = GpsConditions(drift_m_s=(0.0, 0.5, 0.1))
    found = fixes(ARDUCOPTER, 60.0, drift)[3:]
    away = offsets_m(found)
    lasted_s = (found[-1].time_us - found[0].time_us) * 1e-6
    assert away[-1] - away[0] == pytest.approx(
        [0, 0.5 * lasted_s, 0.1 * lasted_s], rel=2e-3, abs=1e-3
    )
    assert found[-1].velocity_east_m_s == pytest.approx(0.5)
    gps, copter = Gps(ARDUCOPTER, np.random.default_rng(1)), standing()
    for now_us in range(0, 30 * S, STEP_US):
        fix = gps.step(now_us, copter, drift if now_us < 20 * S else FINE)
    assert offsets_m([fix])[0] == pytest.approx([0, 0, 0], abs=1e-6)


def test_noise_has_the_standard_deviation_that_is_asked_for() -> None:
    found = fixes(ARDUCOPTER, 4000.0, GpsConditions(sigma_m=3.0), step_us=100_000)[3:]
    away = offsets_m(found)
    assert away.std(axis=0) == pytest.approx([3.0, 3.0, 4.5], rel=0.15)
    lag = round(5.0 / 0.2)
    for axis in range(3):
        x = away[:, axis]
        assert np.corrcoef(x[lag:], x[:-lag])[0, 1] == pytest.approx(math.exp(-1.0), abs=0.12)


def test_a_jammed_receiver_first_loses_its_fix_and_then_says_wild_things() -> None:
    jammed = GpsConditions(jammed=True)
    gps, copter, found = Gps(ARDUCOPTER, np.random.default_rng(3)), standing(), list[Fix]()
    for now_us in range(0, 140 * S, 200_000):
        found.append(gps.step(now_us, copter, jammed if now_us >= 20 * S else FINE))
    lost, wild = found[102:107], found[140:]
    assert found[99].fix_type == 6
    assert {(fix.fix_type, fix.satellites) for fix in lost} == {(1, 3)}
    assert {fix.fix_type for fix in wild} == {1, 6}
    away = np.hypot(*offsets_m(wild)[:, :2].T)
    assert 20.0 < away.max() < 20_000.0
    assert 50.0 < max(abs(fix.velocity_north_m_s) for fix in wild) <= 400.0
    assert len({fix.satellites for fix in wild}) > 5
