"""Gusts against the closed forms of their spectra, and wind as a vehicle meets it."""

import functools
import math

import numpy as np
import pytest
from harness import GENTLE
from numpy.typing import NDArray
from scipy import integrate, signal

from vehicle_sim.conditions import WindConditions
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.dynamics.wind import LEVEL_M, VERTICAL_M, VERTICAL_SHARE, Gusts, Wind

FloatArray = NDArray[np.float64]


def copter_at(height_m: float) -> Copter:
    return Copter(latitude_deg=47.0, longitude_deg=8.0, altitude_amsl_m=height_m, limits=GENTLE)


def wind_of(copter: Copter) -> tuple[float, float, float]:
    return copter.wind_north_m_s, copter.wind_east_m_s, copter.wind_up_m_s


@functools.cache
def gusts(level_s: float, vertical_s: float, dt_s: float, count: int) -> FloatArray:
    """(count, 3): along, across, up."""
    made = Gusts(np.random.default_rng(5))
    made.tune(level_s, vertical_s, dt_s)
    rows = np.empty((count, 3))
    for k in range(count):
        made.step()
        rows[k] = made.along, made.across, made.up
    return rows


# --- the spectra ----------------------------------------------------------------------------------


@pytest.mark.parametrize("dt_s", [0.01, 0.5])
def test_variance_and_correlation_are_drydens_whatever_the_step(dt_s: float) -> None:
    level_s, vertical_s = 0.8, 0.4
    rows = gusts(level_s, vertical_s, dt_s, 200_000)[1000:]
    lasts_s = len(rows) * dt_s
    error = 4.0 * math.sqrt(2.0 * level_s / lasts_s)  # four sigma of an average over so long
    for column, time_s in ((0, level_s), (1, level_s), (2, vertical_s)):
        x = rows[:, column]
        assert x.mean() == pytest.approx(0.0, abs=error)
        assert x.var() == pytest.approx(1.0, abs=error)
        for lag in {max(round(share * time_s / dt_s), 1) for share in (0.3, 1.0, 2.0)}:
            tau = lag * dt_s / time_s
            expected = math.exp(-tau) * (1.0 if column == 0 else 1.0 - 0.5 * tau)
            assert (x[lag:] * x[:-lag]).mean() == pytest.approx(expected, abs=error)
    assert np.abs(np.corrcoef(rows.T) - np.eye(3)).max() < error


def spectrum(frequency_hz: FloatArray, time_s: float, *, along: bool) -> FloatArray:
    """As the standard has it, one-sided for each hertz, unit variance."""
    x2 = (2.0 * np.pi * frequency_hz * time_s) ** 2
    if along:
        return 4.0 * time_s / (1.0 + x2)
    return 2.0 * time_s * (1.0 + 3.0 * x2) / (1.0 + x2) ** 2


@pytest.mark.parametrize("along", [True, False])
def test_the_closed_forms_have_unit_variance(*, along: bool) -> None:
    def at(frequency_hz: float) -> float:
        return float(spectrum(np.array(frequency_hz), 0.7, along=along))

    total, _ = integrate.quad(at, 0.0, np.inf, limit=200)
    assert total == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("column", [0, 1, 2])
def test_the_power_lies_at_the_frequencies_of_the_standard(column: int) -> None:
    level_s, vertical_s, dt_s = 1.5, 0.5, 0.02
    rows = gusts(level_s, vertical_s, dt_s, 300_000)
    frequency, power = signal.welch(rows[:, column], fs=1.0 / dt_s, nperseg=4096)
    time_s = vertical_s if column == 2 else level_s
    expected = spectrum(frequency, time_s, along=column == 0)
    for low, high in ((0.02, 0.06), (0.06, 0.2), (0.2, 0.6), (0.6, 2.0), (2.0, 5.0)):
        band = (frequency >= low) & (frequency < high)
        error = 0.03 + 4.0 / math.sqrt(band.sum() * len(rows) / 4096)
        assert power[band].mean() == pytest.approx(expected[band].mean(), rel=error)


def test_a_gust_much_longer_than_a_step_is_still_exact() -> None:
    """T = 1000 s at 10 ms: the noise of a step is 1e-5 of the state; closed forms would cancel."""
    made = Gusts(np.random.default_rng(1))
    made.tune(1000.0, 1000.0, 0.01)
    steps = []
    last = 0.0
    for _ in range(50_000):
        made.step()
        steps.append(made.across - last)
        last = made.across
    # dy is 3 dw / sqrt 2 ... : variance a^2 q dt / (2 T) = 3 * 2 * 1e-5 / 2, a = sqrt 3
    assert np.var(steps) == pytest.approx(3.0 * 2.0 * 1e-5 / 2.0, rel=0.03)


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
