"""The battery against what the recorded flights show, and against sums by hand."""

import math

import numpy as np
import pytest
from harness import GENTLE

from vehicle_sim.autopilot.values import Battery
from vehicle_sim.dynamics.battery import Model, PowerModule
from vehicle_sim.dynamics.copter import HOVER_THROTTLE, Copter
from vehicle_sim.faults import BatteryConditions


def fly(
    model: Model,
    seconds: float,
    *,
    throttle: float = HOVER_THROTTLE,
    armed: bool = True,
    conditions: BatteryConditions | None = None,
) -> Battery:
    copter = Copter(latitude_deg=47.0, longitude_deg=8.0, altitude_amsl_m=0.0, limits=GENTLE)
    copter.throttle = throttle
    module = PowerModule(Battery(), model)
    for _ in range(round(seconds * 100)):
        module.step(0.01, copter, armed, conditions or BatteryConditions())
    return module.battery


def test_a_hovering_copter_draws_what_the_recorded_one_draws() -> None:
    """arducopter-guided-10mps.tlog at 61 s: 12.6 V, 27 A; 2,301 mAh in 277 s of flight."""
    battery = fly("ardupilot copter", 277.0)
    assert battery.voltage_v == 12.6
    assert battery.current_a == pytest.approx(27.4, abs=0.5)
    assert battery.consumed_mah == pytest.approx(2301.0, rel=0.1)
    assert battery.remaining == pytest.approx(1.0 - battery.consumed_mah / 3300.0)


@pytest.mark.parametrize(
    ("throttle", "voltage_v", "current_a"), [(1.0, 11.9, 47.22), (0.485, 12.261, 11.4)]
)
def test_a_plane_draws_what_the_recorded_one_draws(
    throttle: float, voltage_v: float, current_a: float
) -> None:
    """arduplane-guided-reposition.tlog: full throttle at 30 s, cruise at 60 s."""
    battery = fly("ardupilot plane", 1.0, throttle=throttle)
    assert battery.voltage_v == pytest.approx(voltage_v, abs=0.01)
    assert battery.current_a == pytest.approx(current_a, rel=0.02)


def test_px4_falls_to_half_in_thirty_seconds_of_flight_and_stays_there() -> None:
    """px4-offboard-8mps.tlog: 16.2 V full, 15.3 V at 50 %, 33 s after arming; -1 A throughout."""
    ten = fly("px4", 10.0)
    assert ten.remaining == pytest.approx(1.0 - (10.0 - 0.95) / 60.0, abs=0.002)  # the gauge lags
    assert ten.voltage_v == pytest.approx(16.2 - 1.8 * 10.0 / 60.0, abs=0.01)
    long = fly("px4", 40.0)
    assert long.voltage_v == pytest.approx(15.3)
    assert math.ceil(100.0 * long.remaining) == 51  # as SYS_STATUS tells it, for ever
    assert long.remaining == pytest.approx(0.5, abs=1e-3)
    assert long.current_a == -1.0
    assert long.consumed_mah == pytest.approx(-40.0 / 3.6, abs=0.1)
    assert fly("px4", 40.0, armed=False).remaining == 1.0


def test_px4s_battery_is_full_again_when_it_disarms_and_the_gauge_follows() -> None:
    """px4-offboard-short.tlog: 16.2 V at 58.42 s, and the gauge, each 0.2 s."""
    copter = Copter(latitude_deg=47.0, longitude_deg=8.0, altitude_amsl_m=0.0, limits=GENTLE)
    module, conditions, told = PowerModule(Battery(), "px4"), BatteryConditions(), []
    for _ in range(6000):
        module.step(0.01, copter, True, conditions)
    for k in range(241):
        module.step(0.01, copter, False, conditions)
        if k % 20 == 0:
            told.append(math.ceil(100.0 * module.battery.remaining))
    assert module.battery.voltage_v == pytest.approx(16.2)
    recorded = [51, 53, 62, 69, 75, 79, 83, 86, 89, 91, 93, 94, 95]
    assert np.abs(np.array(told) - recorded).max() <= 7  # a fifth of a second is 9 at first
    assert told[-1] == pytest.approx(95, abs=2)


@pytest.mark.parametrize("model", ["ardupilot copter", "ardupilot plane"])
def test_nothing_is_drawn_on_the_ground(model: Model) -> None:
    battery = fly(model, 100.0, armed=False)
    assert (battery.consumed_mah, battery.remaining, battery.voltage_v) == (0.0, 1.0, 12.6)


def test_with_a_capacity_the_voltage_falls_as_it_empties() -> None:
    conditions = BatteryConditions(capacity_ah=3.3)
    volts = [fly("ardupilot copter", s, conditions=conditions).voltage_v for s in (1, 100, 300)]
    assert volts == sorted(volts, reverse=True)
    assert volts[2] < 12.6 * 0.93
    empty = fly("ardupilot copter", 900.0, conditions=conditions)
    assert empty.remaining == 0.0
    assert empty.voltage_v == pytest.approx(12.6 * 0.8 - 27.5 * 0.0034, abs=1e-6)


@pytest.mark.parametrize("model", ["ardupilot copter", "ardupilot plane", "px4"])
def test_no_more_is_left_than_the_fault_says(model: Model) -> None:
    battery = fly(model, 10.0, conditions=BatteryConditions(most=0.15, least=0.0))
    assert battery.remaining == pytest.approx(0.15, abs=1e-3)
    assert battery.voltage_v < fly(model, 10.0).voltage_v


def test_a_battery_is_never_below_empty() -> None:
    battery = fly("px4", 100.0, conditions=BatteryConditions(least=0.0, drain_s=10.0))
    assert battery.remaining == pytest.approx(0.0, abs=1e-6)
    assert battery.voltage_v == pytest.approx(14.4)
