"""Wind: what blows steadily, and gusts about it.

Variance and length of the gusts are those of the Dryden model of MIL-F-8785C at 200 ft above the
ground, where the wind is full, at every height: along the mean wind, across it and up.  How alike
two gusts are falls with the air that passes between them, as exp(-V t / L), which is Dryden's law
along the wind.  V is the speed of the vehicle through the air.  Unlike in the standard the level
gusts' size is not a share of the wind at 6 m but what is asked for, as with ArduPilot's
SIM_WIND_TURB.  A step is exact: variance and correlation are right however long it is.
"""

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
        self._gusts = (0.0, 0.0, 0.0)
        """Along, across, up; of unit variance."""
        self.conditions: WindConditions | None = None
        self._target_m_s = self._mean_m_s = (0.0, 0.0, 0.0)
        """North, east, up, at full height."""
        self._along = (1.0, 0.0)
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
        north, east, up = self._mean_m_s
        height_m = vehicle.altitude_amsl_m - ground_amsl_m
        if height_m < _FULL_HEIGHT_M:
            share = math.sqrt(max(height_m, 0.0) / _FULL_HEIGHT_M)
            north, east, up = north * share, east * share, up * share
        if turbulence := conditions.turbulence_m_s:
            along, across, rising = self._gust(dt_s * max(vehicle.airspeed_m_s, _MIN_SPEED_M_S))
            cosine, sine = self._along
            north += turbulence * (cosine * along - sine * across)
            east += turbulence * (sine * along + cosine * across)
            up += turbulence * VERTICAL_SHARE * rising
        else:
            self.still = self._mean_m_s == self._target_m_s == (0.0, 0.0, 0.0)
        vehicle.wind_m_s, vehicle.wind_up_m_s = complex(north, east), up

    def _gust(self, passed_m: float) -> tuple[float, float, float]:
        """What blows when so much more air has passed."""
        if not self._noise:
            self._noise = self._rng.standard_normal(_BLOCK).tolist()
        noise, (along, across, up) = self._noise.pop, self._gusts
        keep, fresh = math.exp(-passed_m / LEVEL_M), math.sqrt(-math.expm1(-2 * passed_m / LEVEL_M))
        along, across = keep * along + fresh * noise(), keep * across + fresh * noise()
        fresh = math.sqrt(-math.expm1(-2.0 * passed_m / VERTICAL_M))
        self._gusts = along, across, math.exp(-passed_m / VERTICAL_M) * up + fresh * noise()
        return self._gusts

    def _turn_to(self, conditions: WindConditions) -> None:
        level = conditions.speed_m_s * math.cos(conditions.rising_rad)
        cosine, sine = -math.cos(conditions.from_rad), -math.sin(conditions.from_rad)
        up = conditions.speed_m_s * math.sin(conditions.rising_rad)
        self._target_m_s, self._along = (level * cosine, level * sine, up), (cosine, sine)
        if self.conditions is None:  # it has blown since long before the first step
            self._mean_m_s = self._target_m_s
        self.still, self.conditions = False, conditions

    def _settle(self, dt_s: float) -> None:
        """A step closer to what is asked for; there at last when within a millimetre a second."""
        share = dt_s / (_SETTLING_S + dt_s)
        (n, e, u), (to_n, to_e, to_u) = self._mean_m_s, self._target_m_s
        n, e, u = n + (to_n - n) * share, e + (to_e - e) * share, u + (to_u - u) * share
        there = max(abs(to_n - n), abs(to_e - e), abs(to_u - u)) < 1e-3
        self._mean_m_s = self._target_m_s if there else (n, e, u)
