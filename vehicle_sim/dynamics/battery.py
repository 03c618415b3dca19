"""Battery model, as in each firmware's own simulation.

ArduPilot's copter (libraries/SITL/SIM_Battery): a resting voltage by what is left of
SIM_BATT_CAP_AH, less the current times a resistance; with no capacity, as by default, the voltage
stays.  Its plane: voltage less 0.7 V, and 50 A, at full throttle.  What is left is what the
autopilot makes of the current: BATT_CAPACITY less what was drawn.  PX4 (battery_simulator): 60 s
from full to empty while armed, stopping at SIM_BAT_MIN_PCT, full again once disarmed; the gauge
follows the voltage within a second or two; no current sensor.
"""

import itertools
import math
from dataclasses import dataclass
from typing import Literal, final

from vehicle_sim.dynamics import Vehicle

Model = Literal["ardupilot copter", "ardupilot plane", "px4"]

HOVER_A = 27.5
"""At hovering throttle; the recorded copters draw 28 A hovering and 30 to 41 A at 10 to 15 m/s."""
_HOVER_THROTTLE = 0.39
_RESISTANCE_OHM = 0.0034
_RESTING = (
    (0.0, 0.80),
    (0.05, 0.87),
    (0.1, 0.89),
    (0.2, 0.9),
    (0.5, 0.92),
    (0.8, 0.96),
    (1.0, 1.0),
)
"""Share left to share of the full voltage: a lithium polymer cell from 3.35 to 4.2 V."""
_PLANE_SAG_V = 0.7
_PLANE_FULL_A = 50.0
_PX4_CELLS = 4
_PX4_EMPTY_V, _PX4_FULL_V = 3.6, 4.05
_PX4_NO_SENSOR_A = -1.0
_PX4_GAUGE_S = 0.95
"""Time constant of the gauge: px4-offboard-short.tlog from 58.4 s on."""
_PX4_GAUGE_REST = 3e-7
"""Where its filter in single precision stops short: 50 % are told as 51 in SYS_STATUS for ever."""
POWER_STEP_S = 0.1


@final
@dataclass(slots=True, kw_only=True)
class Battery:
    """What the power module measures.  Mutable: the simulation drains it."""

    voltage_v: float = 12.6
    current_a: float = 0.0
    remaining: float = 1.0
    """1 full, 0 empty."""
    consumed_mah: float = 0.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BatteryConditions:
    """What is asked of the battery."""

    voltage_v: float = 12.6
    """Full, at rest (ArduPilot)."""
    capacity_ah: float = 0.0
    """Of which the voltage knows (ArduPilot); 0: it never falls by use."""
    gauge_mah: float = 3300.0
    """Which the autopilot believes it has (BATT_CAPACITY)."""
    drain_s: float = 60.0
    """From full to empty, armed (PX4)."""
    least: float = 0.5
    """Where that ends, 0 to 1 (PX4)."""
    most: float = 1.0
    """Upper limit of the reported charge, 0 to 1."""


@final
class PowerModule:
    """Drains the battery that the autopilot sees: every POWER_STEP_S is often enough."""

    def __init__(self, battery: Battery, model: Model) -> None:
        self.battery = battery
        self._model = model
        self._drawn_mah = 0.0
        self._left = 1.0
        """PX4's, before what the conditions cap."""
        self._gauge = 1.0

    def step(
        self, dt_s: float, vehicle: Vehicle, armed: bool, conditions: BatteryConditions
    ) -> None:
        """Fly on for dt_s."""
        if self._model == "px4":
            self._px4(dt_s, armed, conditions)
        else:
            self._ardupilot(dt_s, vehicle.throttle if armed else 0.0, conditions)

    def _ardupilot(self, dt_s: float, throttle: float, conditions: BatteryConditions) -> None:
        battery = self.battery
        if self._model == "ardupilot plane":
            sagged = 1.0 - _PLANE_SAG_V * throttle / max(conditions.voltage_v, 0.1)
            current_a = max(sagged, 0.0) * _PLANE_FULL_A * throttle * throttle
        else:
            current_a = HOVER_A * throttle / _HOVER_THROTTLE
        self._drawn_mah += current_a * dt_s / 3.6
        left = 1.0
        if conditions.capacity_ah > 0.0:
            left = max(1.0 - self._drawn_mah / (conditions.capacity_ah * 1e3), 0.0)
        resting_v = conditions.voltage_v * _resting(min(left, conditions.most))
        if self._model == "ardupilot plane":
            voltage_v = resting_v - _PLANE_SAG_V * throttle
        elif conditions.capacity_ah > 0.0:
            voltage_v = resting_v - current_a * _RESISTANCE_OHM
        else:
            voltage_v = resting_v
        told = 1.0 - self._drawn_mah / max(conditions.gauge_mah, 1.0)
        battery.voltage_v = max(voltage_v, 0.0)
        battery.current_a = current_a
        battery.consumed_mah = self._drawn_mah
        battery.remaining = min(max(told, 0.0), conditions.most)

    def _px4(self, dt_s: float, armed: bool, conditions: BatteryConditions) -> None:
        self._left = self._left - dt_s / conditions.drain_s if armed else 1.0
        self._left = max(self._left, conditions.least, 0.0)
        self._drawn_mah += _PX4_NO_SENSOR_A * dt_s / 3.6
        left = min(self._left, conditions.most)
        self._gauge += (left - self._gauge) * -math.expm1(-dt_s / _PX4_GAUGE_S)
        if self._gauge > left:
            self._gauge = max(self._gauge, left + _PX4_GAUGE_REST)
        battery = self.battery
        battery.voltage_v = _PX4_CELLS * (_PX4_EMPTY_V + left * (_PX4_FULL_V - _PX4_EMPTY_V))
        battery.current_a = _PX4_NO_SENSOR_A
        battery.consumed_mah = self._drawn_mah
        battery.remaining = min(self._gauge, 1.0)


def _resting(left: float) -> float:
    """Share of the full voltage at rest with this share left."""
    if left >= 1.0:
        return 1.0
    for (below, low), (above, high) in itertools.pairwise(_RESTING):
        if left <= above:
            return low + (high - low) * max(left - below, 0.0) / (above - below)
    return math.nan  # not reached: the table ends at 1
