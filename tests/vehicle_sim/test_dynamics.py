"""Copter, plane, wind, battery and receiver against closed forms and what recordings show."""

import cmath
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from harness import ZERO, placed
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.dynamics.battery import Battery, Model
from vehicle_sim.dynamics.copter import HOVER_THROTTLE, RESPONSE_S, Copter, Limits
from vehicle_sim.dynamics.plane import Plane, PlaneLimits
from vehicle_sim.dynamics.wind import LEVEL_M, VERTICAL_M, VERTICAL_SHARE, Wind
from vehicle_sim.faults import BatteryConditions, GpsConditions, WindConditions
from vehicle_sim.geodesy import FloatArray, LocalFrame
from vehicle_sim.sensors.gps import ARDUCOPTER, Fix, Gps

approx = pytest.approx
DT_S, PLACE = 0.01, (47.0, 8.0, 500.0)
GENTLE = Limits(
    speed_m_s=50.0, acceleration_m_s2=9.0, speed_vertical_m_s=5.0, acceleration_vertical_m_s2=5.0
)
LIMITS = replace(GENTLE, speed_m_s=30.0, acceleration_m_s2=4.0, acceleration_vertical_m_s2=2.0)

# --- copter: accelerations are ordered north, east, up --------------------------------------------

DRAG_1_S = 0.6


def copter(airframe: Limits = LIMITS, drag_1_s: float = 0.0) -> Copter:
    return Copter(**placed(PLACE), limits=airframe, drag_1_s=drag_1_s)


def flown(it: Copter, seconds: float, *order: float) -> Copter:
    for _ in range(round(seconds / DT_S)):
        it.advance(*order, DT_S)
    return it


@given(orders=st.lists(st.tuples(*[st.floats(-1e3, 1e3)] * 3), min_size=1, max_size=20))
def test_no_order_exceeds_a_limit(orders: list[tuple[float, float, float]]) -> None:
    it = copter()
    for order in orders:
        for _ in range(50):
            before = it.velocity_neu_m_s
            it.advance(*order, DT_S)
            north, east, up = it.velocity_neu_m_s
            assert math.hypot(north, east) <= LIMITS.speed_m_s * (1 + 1e-12)
            assert abs(up) <= LIMITS.speed_vertical_m_s
            gained = math.hypot(north - before[0], east - before[1])
            assert gained <= LIMITS.acceleration_m_s2 * DT_S * (1 + 1e-9)
            assert abs(up - before[2]) <= LIMITS.acceleration_vertical_m_s2 * DT_S + 1e-12


def test_a_steady_order_is_flown_as_the_closed_form_says_up_to_the_fastest_speed() -> None:
    it, t, tau = flown(copter(), 5.0, 2.0, 0.0, 1.0), 5.0, RESPONSE_S
    # v(t) = a (t - tau) and s(t) = a (t^2 / 2 - tau t + tau^2) once the lag has settled
    assert it.velocity_m_s.real == approx(2.0 * (t - tau), abs=0.02)
    assert it.altitude_amsl_m - 500.0 == approx(t * t / 2 - tau * t + tau * tau, abs=0.05)
    it = flown(copter(), 20.0, 60.0, 80.0, -50.0)
    assert it.velocity_neu_m_s == approx((18.0, 24.0, -5.0), abs=1e-6)
    it.stand(470.0)
    assert it.roll_rad == it.pitch_rad == it.throttle == it.airspeed_m_s == 0.0
    assert (it.altitude_amsl_m, it.velocity_neu_m_s) == (470.0, (0.0, 0.0, 0.0))


def test_left_alone_it_drifts_with_the_wind_and_to_stand_still_it_leans_into_it() -> None:
    it = copter(GENTLE, DRAG_1_S)
    it.wind_m_s = -8.0 + 4.0j
    flown(it, 20.0, 0.0, 0.0, 0.0)
    assert it.velocity_neu_m_s == approx((-8.0, 4.0, 0.0), abs=1e-3)
    assert it.airspeed_m_s == approx(0.0, abs=2e-3)
    it.wind_m_s = complex(it.wind_m_s.real)
    flown(it, 20.0, DRAG_1_S * 8.0, 0.0, 0.0)
    assert it.velocity_neu_m_s == approx((0.0, 0.0, 0.0), abs=0.01)
    assert it.pitch_rad == approx(-math.atan(DRAG_1_S * 8.0 / GRAVITY_M_S2), abs=0.002)
    assert it.airspeed_m_s == approx(8.0, abs=0.01)


# --- plane ----------------------------------------------------------------------------------------


def cruised(it: Plane, seconds: float, bank_deg: float, speed: float) -> Plane:
    for _ in range(round(seconds / DT_S)):
        it.advance(math.radians(bank_deg), 0.0, speed, DT_S)
    return it


@pytest.mark.parametrize(("bank_deg", "speed"), [(-55.0, 15.0), (45.0, 25.0)])
def test_a_turn_is_coordinated_and_one_that_slips_wider(bank_deg: float, speed: float) -> None:
    it = cruised(Plane(**placed(PLACE), limits=PlaneLimits()), 30.0, bank_deg, speed)
    lateral = GRAVITY_M_S2 * math.tan(math.radians(bank_deg))
    it.latitude_deg, it.longitude_deg, _ = PLACE
    radius_m, frame = speed**2 / lateral, LocalFrame(**placed(PLACE, height=False))
    centre_m = (-radius_m * math.sin(it.heading_rad), radius_m * math.cos(it.heading_rad))
    for _ in range(20):
        cruised(it, 0.5, bank_deg, speed)
        here_m = frame.to_local(it.latitude_deg, it.longitude_deg)
        assert math.dist(here_m, centre_m) == approx(abs(radius_m), rel=1e-3)
    assert abs(it.acceleration_m_s2) == approx(abs(lateral), rel=1e-3)
    it.turn_efficiency = 0.75
    before_rad = cruised(it, 30.0, bank_deg, speed).heading_rad
    turned_rad = cruised(it, 1.0, bank_deg, speed).heading_rad - before_rad
    assert math.remainder(turned_rad, math.tau) == approx(0.75 * lateral / speed, rel=1e-3)


def test_nothing_of_a_plane_exceeds_its_limit() -> None:
    able = PlaneLimits(airspeed_min_m_s=14.0, airspeed_max_m_s=24.0, bank_max_rad=0.7)
    it = Plane(**placed(PLACE), limits=able)
    for sign in (1.0, -1.0, 1.0):
        for _ in range(3000):
            roll_rad, airspeed = it.roll_rad, it.airspeed_m_s
            it.advance(sign * 9.0, sign * 99.0, 20.0 + sign * 99.0, DT_S)
            assert abs(it.roll_rad) <= able.bank_max_rad + 1e-12
            assert abs(it.roll_rad - roll_rad) <= able.roll_rate_rad_s * DT_S + 1e-12
            assert abs(it.airspeed_m_s - airspeed) <= able.acceleration_m_s2 * DT_S + 1e-12
            assert -able.sink_max_m_s - 1e-9 <= it.velocity_up_m_s <= able.climb_max_m_s + 1e-9
            assert 0.0 <= it.throttle <= 1.0
    assert it.airspeed_m_s == approx(able.airspeed_max_m_s, abs=0.01)
    assert cruised(it, 60.0, 0.0, 0.0).airspeed_m_s == approx(able.airspeed_min_m_s, abs=0.01)


# --- wind: gusts against the closed form of their correlation, and as a vehicle meets it ----------


def blown(
    *changes: tuple[int, WindConditions], airspeed_m_s: float = 0.0, dt_s: float = DT_S
) -> FloatArray:
    """North, east and up after each of so many steps under these conditions, 100 m up."""
    wind, it, rows = Wind(np.random.default_rng(5)), copter(GENTLE), []
    it.altitude_amsl_m, it.airspeed_m_s = 100.0, airspeed_m_s
    for steps, conditions in changes:
        for _ in range(steps):
            wind.step(dt_s, it, conditions, 0.0)
            rows.append((it.wind_m_s.real, it.wind_m_s.imag, it.wind_up_m_s))
    return np.array(rows)


@pytest.mark.parametrize("dt_s", [0.01, 0.5])
@pytest.mark.parametrize(("airspeed_m_s", "past_m_s"), [(100.0, 100.0), (0.0, 3.0)])
def test_gusts_are_as_stated_at_any_step(dt_s: float, airspeed_m_s: float, past_m_s: float) -> None:
    conditions = WindConditions(speed_m_s=10.0, from_rad=0.5, turbulence_m_s=2.0)
    rows = blown((100_000, conditions), airspeed_m_s=airspeed_m_s, dt_s=dt_s)[2000:]
    mean = (-10.0 * math.cos(0.5), -10.0 * math.sin(0.5), 0.0)
    gusts, error = (rows - mean) / [2.0, 2.0, 2.0 * VERTICAL_SHARE], 0.0
    for column, length_m in enumerate((LEVEL_M, LEVEL_M, VERTICAL_M)):
        x, time_s = gusts[:, column], length_m / past_m_s
        error = 4.0 * math.sqrt(2.0 * time_s / (len(x) * dt_s))  # four sigma of such an average
        assert x.mean() == approx(0.0, abs=error)
        assert x.var() == approx(1.0, abs=error)
        for lag in {max(round(share * time_s / dt_s), 1) for share in (0.3, 1.0, 2.0)}:
            expected = math.exp(-lag * dt_s / time_s)
            assert (x[lag:] * x[:-lag]).mean() == approx(expected, abs=error)
    assert np.abs(np.corrcoef(gusts.T) - np.eye(3)).max() < error * 2.0
    # L_w, L_u and sigma_w / sigma_u of MIL-F-8785C at 200 feet, worked out by hand
    assert approx((VERTICAL_M, LEVEL_M, VERTICAL_SHARE), rel=1e-3) == (60.96, 221.2, 0.6507)


def test_below_sixty_metres_a_wind_goes_with_the_root_of_the_height() -> None:
    east = WindConditions(speed_m_s=8.0, from_rad=math.pi / 2)
    for above_m, share in ((100.0, 1.0), (15.0, 0.5), (0.0, 0.0), (-9.0, 0.0), (1e5, 1.0)):
        wind, it = Wind(np.random.default_rng(5)), copter()
        wind.step(DT_S, it, east, 500.0 - above_m)
        seen = it.wind_m_s.real, it.wind_m_s.imag, it.wind_up_m_s
        assert seen == approx((0.0, -8.0 * share, 0.0), abs=1e-12)


def test_a_change_sets_in_slowly_keeps_the_speed_of_what_rises_and_goes_without_a_trace() -> None:
    calm, windy = WindConditions(), WindConditions(speed_m_s=10.0, rising_rad=math.asin(0.6))
    rows = blown((1, calm), (10_000, windy), (10_000, calm))
    full, set_in = np.array([8.0, 0.0, 6.0]), 1.0 - math.exp(-1.0)
    for step, share, within in ((0, 0, 0), (500, set_in, 0.02), (10_000, 1, 1e-9), (-1, 0, 0)):
        assert rows[step] == approx(share * full, abs=within)


# --- battery: against what the recorded flights show, and sums by hand ----------------------------

COPTER, PLANE, PX4 = "ardupilot copter", "ardupilot plane", "px4"
EMPTY, SMALL = {"least": 0.0, "drain_s": 10.0}, {"capacity_ah": 3.3}

BATTERIES: list[tuple[Model, int, Any, float, Any, float]] = [
    # seconds, conditions (None: it is not armed), volts, amperes, what is left
    # px4-offboard-8mps.tlog: 16.2 V full, 15.3 V at 50 % for ever, 33 s after arming
    (PX4, 10, {}, 16.2 - 1.8 / 6.0, -1.0, 1.0 - 10.0 / 60.0),
    (PX4, 40, {}, 15.3, -1.0, 0.5),
    # with a capacity it empties: to 76.85 %, at 0.9558 of its voltage at rest, and to nothing
    (COPTER, 100, SMALL, 11.9496, 27.5, 1 - 2750 / 11_880),
    (COPTER, 900, SMALL, 12.6 * 0.8 - 27.5 * 0.0034, 27.5, 0.0),
    (PX4, 100, EMPTY, 14.4, None, 0.0),
    # no more is left than a fault says
    (COPTER, 10, {"most": 0.15}, 12.6 * 0.895, 27.5, 0.15),
    (PX4, 10, {"most": 0.15, "least": 0.0}, 14.67, None, 0.15),
    (PLANE, 100, None, 12.6, 0.0, 1.0),  # and nothing is drawn on the ground
]


def test_a_battery_empties_as_its_capacity_and_its_faults_say() -> None:
    """Hovering."""
    for model, seconds, conditions, volts, amperes, left in BATTERIES:
        it, battery = copter(), Battery(model=model)
        it.throttle, told = HOVER_THROTTLE, BatteryConditions(**conditions or {})
        for _ in range(round(seconds / DT_S)):
            battery.step(DT_S, it, conditions is not None, told)
        assert (battery.voltage_v, battery.remaining) == (approx(volts, abs=1e-4), approx(left))
        assert amperes is None or battery.current_a == approx(amperes)


# --- the receiver: what it says of a known flight, by what its parameters ask for -----------------

WGS84 = Geod(ellps="WGS84")
FINE = GpsConditions()


def fixes(asked: GpsConditions, seconds: float, *, north_m_s: float = 0.0) -> list[Fix]:
    """What it says ten times a second: for 20 s of nothing wrong, of this, and for 10 s of nothing
    wrong again, of a vehicle that keeps its velocity."""
    gps, it, found = Gps(ARDUCOPTER, np.random.default_rng(1)), copter(GENTLE), list[Fix]()
    it.velocity_m_s = complex(north_m_s)
    for k in range(round(10.0 * (30.0 + seconds))):
        it.advance(0.0, 0.0, 0.0, 0.1 if k else 0.0)
        found.append(gps.step(100_000 * k, it, asked if 200 <= k < 200 + 10 * seconds else FINE))
    return found


def offsets_m(found: list[Fix]) -> FloatArray:
    """North, east, up of home.  -> (K, 3)."""
    rows = []
    for fix in found:
        azimuth, _, away_m = WGS84.inv(PLACE[1], PLACE[0], fix.longitude_deg, fix.latitude_deg)
        there = cmath.rect(away_m, math.radians(azimuth))
        rows.append((there.real, there.imag, fix.altitude_amsl_m - PLACE[2]))
    return np.array(rows)


@pytest.mark.parametrize(
    ("asked", "off_m"),
    [
        (GpsConditions(lag_s=0.0), ZERO),
        (GpsConditions(lag_s=0.25), ZERO),
        (GpsConditions(glitch_m=(50.0, -30.0, -7.0)), (50.0, -30.0, -7.0)),
        (GpsConditions(glitch_latitude_deg=0.00045, glitch_up_m=9.0), (50.03, 0.0, 9.0)),
        (GpsConditions(drift_m_s=(0.0, 0.5, 0.1)), ZERO),
    ],
)
def test_a_fix_is_as_old_and_as_far_off_as_is_asked_and_no_longer(asked: Any, off_m: Any) -> None:
    found = fixes(asked, 40.0, north_m_s=10.0)
    for k in (190, 300, 590, 650):
        told, off = (asked, off_m) if 200 < k < 600 else (FINE, ZERO)
        at_s, drift_m_s = found[k].time_us * 1e-6, np.array(told.drift_m_s)
        expected_m = off + drift_m_s * (at_s - 19.773)  # the solution before the first that drifts
        expected_m[0] += 10.0 * (at_s - told.lag_s)
        assert offsets_m([found[k]])[0] == approx(expected_m, abs=0.02)
        level_m_s = found[k].velocity_north_m_s, found[k].velocity_east_m_s
        assert level_m_s == approx((10.0 + drift_m_s[0], drift_m_s[1]), abs=1e-6)
        assert found[k].fix_type == 6


def test_noise_has_the_standard_deviation_and_correlation_that_are_asked_for() -> None:
    found = fixes(GpsConditions(sigma_m=3.0), 4000.0)[220:40_200:2]  # each solution
    away, lag = offsets_m(found), round(5.0 / 0.2)
    assert away.std(axis=0) == approx([3.0, 3.0, 4.5], rel=0.15)
    for x in away.T:
        assert np.corrcoef(x[lag:], x[:-lag])[0, 1] == approx(math.exp(-1.0), abs=0.12)


def test_a_jammed_receiver_first_loses_its_fix_and_then_says_wild_things() -> None:
    found = fixes(GpsConditions(jammed=True), 120.0)
    lost, wild = found[204:214], found[280:1400]
    assert found[199].fix_type == 6
    assert {(fix.fix_type, fix.satellites) for fix in lost} == {(1, 0)}
    assert {fix.fix_type for fix in wild} == {1, 6}
    assert 20.0 < np.hypot(*offsets_m(wild)[:, :2].T).max() < 20_000.0
    assert 50.0 < max(abs(fix.velocity_north_m_s) for fix in wild) <= 400.0
