"""Gusts against the closed form of their correlation, and wind as a vehicle meets it."""

import math

import numpy as np
import pytest
from harness import GENTLE
from numpy.typing import NDArray

from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.dynamics.wind import LEVEL_M, VERTICAL_M, VERTICAL_SHARE, Wind
from vehicle_sim.faults import WindConditions

FloatArray = NDArray[np.float64]


def copter_at(height_m: float) -> Copter:
    return Copter(latitude_deg=47.0, longitude_deg=8.0, altitude_amsl_m=height_m, limits=GENTLE)


def wind_of(copter: Copter) -> tuple[float, float, float]:
    return copter.wind_north_m_s, copter.wind_east_m_s, copter.wind_up_m_s


# --- the gusts ------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt_s", [0.01, 0.5])
@pytest.mark.parametrize(("airspeed_m_s", "past_m_s"), [(100.0, 100.0), (0.0, 3.0)])
def test_variance_and_correlation_are_as_the_docstring_says_whatever_the_step(
    dt_s: float, airspeed_m_s: float, past_m_s: float
) -> None:
    wind, copter = Wind(np.random.default_rng(5)), copter_at(100.0)
    copter.airspeed_m_s = airspeed_m_s
    conditions, rows = WindConditions(turbulence_m_s=1.0, from_rad=0.5), []
    for _ in range(100_000):
        wind.step(dt_s, copter, conditions, 0.0)
        rows.append(wind_of(copter))
    gusts = np.array(rows)[2000:] / [1.0, 1.0, VERTICAL_SHARE]
    for column, length_m in enumerate((LEVEL_M, LEVEL_M, VERTICAL_M)):
        x, time_s = gusts[:, column], length_m / past_m_s
        error = 4.0 * math.sqrt(2.0 * time_s / (len(x) * dt_s))  # four sigma of such an average
        assert x.mean() == pytest.approx(0.0, abs=error)
        assert x.var() == pytest.approx(1.0, abs=error)
        for lag in {max(round(share * time_s / dt_s), 1) for share in (0.3, 1.0, 2.0)}:
            expected = math.exp(-lag * dt_s / time_s)
            assert (x[lag:] * x[:-lag]).mean() == pytest.approx(expected, abs=error)
    assert np.abs(np.corrcoef(gusts.T) - np.eye(3)).max() < error * 2.0


def test_scales_are_those_of_the_standard_at_200_feet() -> None:
    """L_w, L_u and sigma_w / sigma_u of MIL-F-8785C, worked out by hand."""
    assert pytest.approx((VERTICAL_M, LEVEL_M, VERTICAL_SHARE), rel=1e-3) == (60.96, 221.2, 0.6507)


# --- the wind -------------------------------------------------------------------------------------


def blow(conditions: WindConditions, height_m: float, seconds: float, seed: int = 1) -> FloatArray:
    wind, copter = Wind(np.random.default_rng(seed)), copter_at(height_m)
    rows = []
    for _ in range(round(seconds * 100)):
        wind.step(0.01, copter, conditions, 0.0)
        rows.append(wind_of(copter))
    return np.array(rows)


@pytest.mark.parametrize(
    ("from_deg", "north", "east"), [(0, -8, 0), (90, 0, -8), (180, 8, 0), (270, 0, 8)]
)
def test_a_wind_blows_away_from_where_it_comes_from(
    from_deg: float, north: float, east: float
) -> None:
    conditions = WindConditions(speed_m_s=8.0, from_rad=math.radians(from_deg))
    assert blow(conditions, 100.0, 0.01)[-1] == pytest.approx([north, east, 0.0], abs=1e-12)


def test_a_rising_wind_keeps_its_speed() -> None:
    conditions = WindConditions(speed_m_s=8.0, rising_rad=math.radians(30.0))
    north, east, up = blow(conditions, 100.0, 0.01)[-1]
    assert up == pytest.approx(4.0)
    assert math.hypot(north, east) == pytest.approx(8.0 * math.cos(math.radians(30.0)))


@pytest.mark.parametrize(("height_m", "share"), [(0, 0.0), (15, 0.5), (60, 1.0), (500, 1.0)])
def test_below_sixty_metres_it_falls_with_the_root_of_the_height(
    height_m: float, share: float
) -> None:
    conditions = WindConditions(speed_m_s=8.0, from_rad=0.0)
    assert blow(conditions, height_m, 0.01)[-1][0] == pytest.approx(-8.0 * share)


def test_a_change_sets_in_slowly_and_goes_again_without_a_trace() -> None:
    wind, copter = Wind(np.random.default_rng(1)), copter_at(100.0)
    rising = math.asin(0.6)
    calm, windy = WindConditions(), WindConditions(speed_m_s=10.0, rising_rad=rising)
    wind.step(0.01, copter, calm, 0.0)
    assert wind_of(copter) == (0.0, 0.0, 0.0)
    for _ in range(500):
        wind.step(0.01, copter, windy, 0.0)
    set_in = 1.0 - math.exp(-1.0)
    assert copter.wind_north_m_s == pytest.approx(8.0 * set_in, abs=0.02)
    assert copter.wind_up_m_s == pytest.approx(6.0 * set_in, abs=0.02)
    for _ in range(10_000):
        wind.step(0.01, copter, windy, 0.0)
    assert wind_of(copter) == pytest.approx((8.0, 0.0, 6.0), abs=1e-9)
    for _ in range(10_000):
        wind.step(0.01, copter, calm, 0.0)
    assert wind_of(copter) == (0.0, 0.0, 0.0)


def test_gusts_have_the_size_that_is_asked_for() -> None:
    conditions = WindConditions(speed_m_s=10.0, from_rad=0.0, turbulence_m_s=2.0)
    rows = blow(conditions, 60.0, 4000.0)
    assert rows.mean(axis=0) == pytest.approx([-10.0, 0.0, 0.0], abs=0.5)
    assert rows.std(axis=0) == pytest.approx([2.0, 2.0, 2.0 * VERTICAL_SHARE], rel=0.12)
    again = blow(conditions, 60.0, 10.0)
    assert np.array_equal(again, rows[:1000])
    assert not np.array_equal(again, blow(conditions, 60.0, 10.0, seed=2))


def test_no_height_is_too_low_or_too_high() -> None:
    conditions = WindConditions(speed_m_s=8.0, turbulence_m_s=2.0)
    for height_m in (-100.0, 0.0, 1e5):
        assert np.all(np.isfinite(blow(conditions, height_m, 0.1)))
