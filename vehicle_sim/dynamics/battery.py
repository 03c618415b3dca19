"""Battery model, as in each firmware's own simulation.

ArduPilot's copter (libraries/SITL/SIM_Battery): a resting voltage by what is left of
SIM_BATT_CAP_AH, less the current times a resistance; with no capacity, as by default, the voltage
stays.  Its plane: voltage less 0.7 V, and 50 A, at full throttle.  What is left is what the
autopilot makes of the current: BATT_CAPACITY less what was drawn.  PX4 (battery_simulator): 60 s
from full to empty while armed, stopping at SIM_BAT_MIN_PCT, full again once disarmed; the gauge
follows the voltage within a second or two; no current sensor.
"""

import math
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from vehicle_sim.dynamics import Vehicle
from vehicle_sim.faults import BatteryConditions

Model = Literal["ardupilot copter", "ardupilot plane", "px4"]

HOVER_A: Final = 27.5
"""At hovering throttle; the recorded copters draw 28 A hovering and 30 to 41 A at 10 to 15 m/s."""
_HOVER_THROTTLE: Final = 0.39
_RESISTANCE_OHM: Final = 0.0034
_LEFT: Final = (0.0, 0.05, 0.1, 0.2, 0.5, 0.8, 1.0)
_RESTING: Final = (0.80, 0.87, 0.89, 0.9, 0.92, 0.96, 1.0)
"""Share of the full voltage by the share left: a lithium polymer cell from 3.35 to 4.2 V."""
_PLANE_SAG_V, _PLANE_FULL_A = 0.7, 50.0
_PX4_EMPTY_V, _PX4_FULL_V = 4 * 3.6, 4 * 4.05
"""Of its four cells."""
_PX4_NO_SENSOR_A: Final = -1.0
_PX4_GAUGE_S: Final = 0.95
"""Time constant of the gauge: px4-offboard-short.tlog from 58.4 s on."""
_PX4_GAUGE_REST: Final = 3e-7
"""Where its filter in single precision stops short: 50 % are told as 51 in SYS_STATUS for ever."""
POWER_STEP_S: Final = 0.1


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
class PowerModule:
    """Drains the battery that the autopilot sees: every POWER_STEP_S is often enough."""

    def __init__(self, battery: Battery, model: Model) -> None:
        self.battery = battery
        self._model = model
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
        battery, capacity_mah = self.battery, conditions.capacity_ah * 1e3
        is_plane = self._model == "ardupilot plane"
        sag_v = _PLANE_SAG_V * throttle
        battery.current_a = HOVER_A * throttle / _HOVER_THROTTLE
        if is_plane:
            kept = max(1.0 - sag_v / max(conditions.voltage_v, 0.1), 0.0)
            battery.current_a = kept * _PLANE_FULL_A * throttle * throttle
        battery.consumed_mah += battery.current_a * dt_s / 3.6
        left = max(1.0 - battery.consumed_mah / capacity_mah, 0.0) if capacity_mah else 1.0
        if not is_plane:
            sag_v = battery.current_a * _RESISTANCE_OHM if capacity_mah else 0.0
        left, resting_v = min(left, conditions.most), conditions.voltage_v
        if left < 1.0:
            resting_v *= float(np.interp(left, _LEFT, _RESTING))
        battery.voltage_v = max(resting_v - sag_v, 0.0)
        told = 1.0 - battery.consumed_mah / max(conditions.gauge_mah, 1.0)
        battery.remaining = min(max(told, 0.0), conditions.most)

    def _px4(self, dt_s: float, armed: bool, conditions: BatteryConditions) -> None:
        battery = self.battery
        drained = self._left - dt_s / conditions.drain_s if armed else 1.0
        self._left = max(drained, conditions.least, 0.0)
        left = min(self._left, conditions.most)
        self._gauge += (left - self._gauge) * -math.expm1(-dt_s / _PX4_GAUGE_S)
        if self._gauge > left:
            self._gauge = max(self._gauge, left + _PX4_GAUGE_REST)
        battery.voltage_v = _PX4_EMPTY_V + left * (_PX4_FULL_V - _PX4_EMPTY_V)
        battery.current_a = _PX4_NO_SENSOR_A
        battery.consumed_mah += _PX4_NO_SENSOR_A * dt_s / 3.6
        battery.remaining = min(self._gauge, 1.0)
