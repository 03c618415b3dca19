"""Copter, plane, wind and battery against closed forms and what the recorded flights show."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from harness import GENTLE, placed
from hypothesis import given
from hypothesis import strategies as st

from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.dynamics.battery import Battery, Model
from vehicle_sim.dynamics.copter import HOVER_THROTTLE, RESPONSE_S, Copter, Limits
from vehicle_sim.dynamics.plane import Plane, PlaneLimits
from vehicle_sim.dynamics.wind import LEVEL_M, VERTICAL_M, VERTICAL_SHARE, Wind
from vehicle_sim.faults import BatteryConditions, WindConditions
from vehicle_sim.geodesy import FloatArray, LocalFrame

approx = pytest.approx
DT_S, PLACE = 0.01, (47.0, 8.0, 500.0)
LIMITS = replace(GENTLE, speed_m_s=30.0, acceleration_m_s2=4.0, acceleration_vertical_m_s2=2.0)
FREE = Limits(
    speed_m_s=1e3, acceleration_m_s2=1e3, speed_vertical_m_s=1e3, acceleration_vertical_m_s2=1e3
)

# --- copter: accelerations are ordered north, east, up --------------------------------------------

DRAG_1_S = 0.6


def copter(airframe: Limits = LIMITS, drag_1_s: float = 0.0, drag_1_m: float = 0.0) -> Copter:
    return Copter(**placed(PLACE), limits=airframe, drag_1_s=drag_1_s, drag_1_m=drag_1_m)


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


@pytest.mark.parametrize(("tilt_deg", "speed_m_s"), [(28.7, 10.05), (45.0, 15.39)])
def test_drag_and_tilt_hold_the_speeds_that_were_measured(
    tilt_deg: float, speed_m_s: float
) -> None:
    """Steady in arducopter-*.tlog."""
    most = GRAVITY_M_S2 * math.tan(math.radians(tilt_deg))  # no more holds the height
    it = flown(copter(replace(FREE, acceleration_m_s2=most), 0.340, 0.0193), 30.0, 100.0, 0, 0)
    assert it.velocity_m_s.real == approx(speed_m_s, rel=0.01)
    assert it.pitch_rad == approx(-math.radians(tilt_deg), rel=1e-6)


def test_left_alone_it_drifts_with_the_wind_and_to_stand_still_it_leans_into_it() -> None:
    it = copter(FREE, DRAG_1_S)
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
    able = PlaneLimits(
        airspeed_min_m_s=14.0,
        airspeed_max_m_s=24.0,
        bank_max_rad=math.radians(40.0),
        roll_rate_rad_s=math.radians(60.0),
        climb_max_m_s=3.0,
        sink_max_m_s=2.0,
        acceleration_m_s2=1.5,
    )
    it = Plane(**placed(PLACE), limits=able)
    for sign in (1.0, -1.0, 1.0):
        for _ in range(3000):
            roll_rad, airspeed = it.roll_rad, it.airspeed_m_s
            it.advance(sign * 9.0, sign * 99.0, 20.0 + sign * 99.0, DT_S)
            assert abs(it.roll_rad) <= able.bank_max_rad + 1e-12
            assert abs(it.roll_rad - roll_rad) <= able.roll_rate_rad_s * DT_S + 1e-12
            assert abs(it.airspeed_m_s - airspeed) <= able.acceleration_m_s2 * DT_S + 1e-12
            assert -2.0 - 1e-9 <= it.velocity_up_m_s <= 3.0 + 1e-9
            assert 0.0 <= it.throttle <= 1.0
    assert it.airspeed_m_s == approx(24.0, abs=0.01)
    assert cruised(it, 60.0, 0.0, 0.0).airspeed_m_s == approx(14.0, abs=0.01)


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
def test_mean_variance_and_correlation_of_gusts_are_as_stated_whatever_the_step(
    dt_s: float, airspeed_m_s: float, past_m_s: float
) -> None:
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


@pytest.mark.parametrize(
    ("above_m", "share"), [(100.0, 1.0), (15.0, 0.5), (0.0, 0.0), (-9.0, 0.0), (1e5, 1.0)]
)
def test_below_sixty_metres_a_wind_goes_with_the_root_of_the_height(
    above_m: float, share: float
) -> None:
    wind, it = Wind(np.random.default_rng(5)), copter()
    wind.step(DT_S, it, WindConditions(speed_m_s=8.0, from_rad=math.pi / 2), 500.0 - above_m)
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


@pytest.mark.parametrize(
    ("model", "seconds", "conditions", "volts", "amperes", "left"),
    [
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
    ],
)
def test_a_battery_empties_as_its_capacity_and_its_faults_say(
    model: Model, seconds: int, conditions: Any, volts: Any, amperes: Any, left: float
) -> None:
    """Hovering; conditions None: it is not armed."""
    it, battery = copter(), Battery(model=model)
    it.throttle, told = HOVER_THROTTLE, BatteryConditions(**conditions or {})
    for _ in range(round(seconds / DT_S)):
        battery.step(DT_S, it, conditions is not None, told)
    assert (battery.voltage_v, battery.remaining) == (approx(volts, abs=1e-4), approx(left))
    assert amperes is None or battery.current_a == approx(amperes)
