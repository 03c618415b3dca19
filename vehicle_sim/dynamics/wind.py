"""Wind: what blows steadily, and gusts about it.

Variance and length of the gusts are those of the Dryden model of MIL-F-8785C at 200 ft above the
ground, where the wind is full, at every height: along the mean wind, across it and up.  How alike
two gusts are falls with the air that passes between them, as exp(-V t / L), which is Dryden's law
along the wind.  V is the speed of the vehicle through the air.  Unlike in the standard the level
gusts' size is not a share of the wind at 6 m but what is asked for, as with ArduPilot's
SIM_WIND_TURB.  A step is exact: variance and correlation are right however long it is.
"""

import cmath
import math
from typing import Final, final

import numpy as np

from vehicle_sim.dynamics import Vehicle
from vehicle_sim.faults import WindConditions

_FULL_HEIGHT_M: Final = 60.0
"""Below this the wind falls with the root of the height: SIM_WIND_T 0, SIM_WIND_T_ALT."""
_SETTLING_S: Final = 5.0
"""Time constant with which a change sets in: SIM_WIND_TC."""
_HEIGHT_FT: Final = 200.0
_FOOT_M: Final = 0.3048
VERTICAL_M: Final = _HEIGHT_FT * _FOOT_M
"""L_w = h"""
LEVEL_M: Final = VERTICAL_M / (0.177 + 0.000823 * _HEIGHT_FT) ** 1.2
"""L_u = L_v = h / (0.177 + 0.000823 h)^1.2, h in feet."""
VERTICAL_SHARE: Final = (0.177 + 0.000823 * _HEIGHT_FT) ** 0.4
"""sigma_w / sigma_u; sigma_v = sigma_u."""
_MIN_SPEED_M_S: Final = 3.0
"""Of the air past the vehicle, for a vehicle that drifts with it still feels the gusts change."""
_BLOCK: Final = 3 * 1024
"""Random numbers drawn at once."""


@final
class Wind:
    """The air about one vehicle; sets the vehicle's wind before each of its steps."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng, self._noise = rng, list[float]()
        self._gust, self._rising = 0j, 0.0
        """Along and across, and up; of unit variance."""
        self.conditions: WindConditions | None = None
        self._target_m_s = self._mean_m_s = (0j, 0.0)
        """North + east j, and up, at full height."""
        self._along = 1.0 + 0j
        self.still = False
        """No wind, and the vehicle has been told: no step is needed until the conditions change."""

    def step(
        self, dt_s: float, vehicle: Vehicle, conditions: WindConditions, ground_amsl_m: float
    ) -> None:
        """Blow on for dt_s over ground of this height."""
        if conditions is not self.conditions:
            self._turn_to(conditions)
        if self._mean_m_s != self._target_m_s:
            self._settle(dt_s)
        (level, up), turbulence = self._mean_m_s, conditions.turbulence_m_s
        height_m = vehicle.altitude_amsl_m - ground_amsl_m
        if height_m < _FULL_HEIGHT_M:
            share = math.sqrt(max(height_m, 0.0) / _FULL_HEIGHT_M)
            level, up = level * share, up * share
        if turbulence:
            self._pass(dt_s * max(vehicle.airspeed_m_s, _MIN_SPEED_M_S))
            level += turbulence * (self._along * self._gust)
            up += turbulence * VERTICAL_SHARE * self._rising
        self.still = not turbulence and self._mean_m_s == self._target_m_s == (0j, 0.0)
        vehicle.wind_m_s, vehicle.wind_up_m_s = level, up

    def _pass(self, passed_m: float) -> None:
        """Other gusts, as so much more air has passed."""
        if not self._noise:
            self._noise = self._rng.standard_normal(_BLOCK).tolist()
        noise, level, upright = self._noise.pop, passed_m / LEVEL_M, passed_m / VERTICAL_M
        fresh = math.sqrt(-math.expm1(-2.0 * level))
        self._gust = math.exp(-level) * self._gust + fresh * complex(noise(), noise())
        fresh = math.sqrt(-math.expm1(-2.0 * upright))
        self._rising = math.exp(-upright) * self._rising + fresh * noise()

    def _turn_to(self, conditions: WindConditions) -> None:
        speed_m_s, rising_rad = conditions.speed_m_s, conditions.rising_rad
        self._along = -cmath.rect(1.0, conditions.from_rad)
        level_m_s = speed_m_s * math.cos(rising_rad) * self._along
        self._target_m_s = level_m_s, speed_m_s * math.sin(rising_rad)
        if self.conditions is None:  # it has blown since long before the first step
            self._mean_m_s = self._target_m_s
        self.conditions = conditions

    def _settle(self, dt_s: float) -> None:
        """A step closer to what is asked for; there at last when within a millimetre a second."""
        share = dt_s / (_SETTLING_S + dt_s)
        (level, up), (to_level, to_up) = self._mean_m_s, self._target_m_s
        level, up = level + (to_level - level) * share, up + (to_up - up) * share
        there = abs(to_level - level) < 1e-3 and abs(to_up - up) < 1e-3
        self._mean_m_s = self._target_m_s if there else (level, up)
