"""Battery model, as in each firmware's own simulation.

ArduPilot's copter (libraries/SITL/SIM_Battery): a resting voltage by what is left of
SIM_BATT_CAP_AH, less the current times a resistance; with no capacity, as by default, the voltage
stays.  Its plane: voltage less 0.7 V, and 50 A, at full throttle.  What is left is what the
autopilot makes of the current: BATT_CAPACITY less what was drawn.  PX4 (battery_simulator): 60 s
from full to empty while armed, stopping at SIM_BAT_MIN_PCT, full again once disarmed; no current
sensor.
"""

from dataclasses import dataclass, field
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
POWER_STEP_S: Final = 0.1


@final
@dataclass(slots=True, kw_only=True)
class Battery:
    """What the autopilot sees of it.  Mutable: every POWER_STEP_S `step` drains it."""

    model: Model = "ardupilot copter"
    voltage_v: float = 12.6
    current_a: float = 0.0
    remaining: float = 1.0
    """1 full, 0 empty."""
    consumed_mah: float = 0.0
    _left: float = field(init=False, default=1.0)
    """PX4's, before what the conditions cap."""

    def step(
        self, dt_s: float, vehicle: Vehicle, armed: bool, conditions: BatteryConditions
    ) -> None:
        """Fly on for dt_s."""
        if self.model == "px4":
            drained = self._left - dt_s / conditions.drain_s if armed else 1.0
            self._left = max(drained, conditions.least, 0.0)
            self.remaining = min(self._left, conditions.most)
            self.voltage_v = _PX4_EMPTY_V + self.remaining * (_PX4_FULL_V - _PX4_EMPTY_V)
            self.current_a = _PX4_NO_SENSOR_A
            self.consumed_mah += self.current_a * dt_s / 3.6
        else:
            self._draw(dt_s, vehicle.throttle if armed else 0.0, conditions)

    def _draw(self, dt_s: float, throttle: float, conditions: BatteryConditions) -> None:
        """An ArduPilot's current, and what it does to the voltage."""
        capacity_mah, resting_v = conditions.capacity_ah * 1e3, conditions.voltage_v
        if self.model == "ardupilot plane":
            sag_v = _PLANE_SAG_V * throttle
            kept = max(1.0 - sag_v / max(resting_v, 0.1), 0.0)
            self.current_a = kept * _PLANE_FULL_A * throttle * throttle
        else:
            self.current_a = HOVER_A * throttle / _HOVER_THROTTLE
            sag_v = self.current_a * _RESISTANCE_OHM if capacity_mah else 0.0
        self.consumed_mah += self.current_a * dt_s / 3.6
        left = max(1.0 - self.consumed_mah / capacity_mah, 0.0) if capacity_mah else 1.0
        left = min(left, conditions.most)
        if left < 1.0:
            resting_v *= float(np.interp(left, _LEFT, _RESTING))
        self.voltage_v = max(resting_v - sag_v, 0.0)
        gauge = 1.0 - self.consumed_mah / max(conditions.gauge_mah, 1.0)
        self.remaining = min(max(gauge, 0.0), conditions.most)
