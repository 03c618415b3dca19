"""Wind: what blows steadily, and gusts about it.

Gusts have the Dryden spectra of MIL-F-8785C at low altitude: u along the mean wind, v across, w up,

    T = L / V
    u:       sigma_u^2 4 T / (1 + (2 pi f T)^2)                            for each Hz, one-sided
    v and w: sigma^2 2 T (1 + 3 (2 pi f T)^2) / (1 + (2 pi f T)^2)^2       likewise

with the lengths of 200 ft above the ground, where the wind is full, at every height.  V is the
speed of the air that passes the vehicle, at least 3 m/s.  Unlike in the standard the level gusts'
size is not a share of the wind at 6 m but what is asked for, as with ArduPilot's SIM_WIND_TURB.
The filters are discretised exactly: variance and correlation are right whatever the step is.
"""

import math
from typing import Final, NamedTuple, final

import numpy as np

from vehicle_sim.conditions import WindConditions
from vehicle_sim.dynamics import Vehicle

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
_RETUNE_S: Final = 0.25
_BLOCK: Final = 5 * 512
_ROOT_3: Final = math.sqrt(3.0)


@final
class _Filter(NamedTuple):
    """Coefficients of one step of a gust.

    Along: 1 / (1 + T s) driven by white noise: x keeps `keep` and gets `fresh`.  Across and up:
    (1 + sqrt(3) T s) / (1 + T s)^2.  In units of T: p' = -p + q, q' = -q + noise of intensity 2,
    y = (1 - sqrt 3) p + sqrt 3 q.  Over a step of r = dt / T, q keeps e = exp(-r), p keeps e and
    takes r e of q; the noise added has the covariance below, by integrating the impulse responses
    exp(-t) and t exp(-t).
    """

    keep: float
    from_q: float
    fresh: float
    mixed: float
    own: float

    @classmethod
    def of(cls, time_s: float, dt_s: float) -> "_Filter":
        """Of a gust with this time constant."""
        r = dt_s / time_s
        e2 = math.exp(-2.0 * r)
        fresh = math.sqrt(-math.expm1(-2.0 * r))
        if r < 1e-3:  # the closed forms cancel; the error of these is below 1e-3 of themselves
            covariance = r * r * (1.0 - 4.0 / 3.0 * r)
            var_p = 2.0 / 3.0 * r * r * r * (1.0 - 1.5 * r)
        else:
            covariance = 0.5 * (1.0 - e2 * (1.0 + 2.0 * r))
            var_p = 0.5 * (1.0 - e2 * (1.0 + 2.0 * r + 2.0 * r * r))
        mixed = covariance / fresh
        own = math.sqrt(max(var_p - mixed * mixed, 0.0))
        return cls(math.exp(-r), r * math.exp(-r), fresh, mixed, own)


@final
class Gusts:
    """Three Dryden filters of unit variance; plain floats, five random numbers a step."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng, self._noise = rng, list[float]()
        self._level = self._vertical = _Filter(0.0, 0.0, 0.0, 0.0, 0.0)
        self._v, self._w = (0.0, 0.0), (0.0, 0.0)
        self.along = self.across = self.up = 0.0
        """Unit variance each."""

    def tune(self, level_s: float, vertical_s: float, dt_s: float) -> None:
        """Time constants L / V of level and vertical gusts, for steps of this length."""
        self._level, self._vertical = _Filter.of(level_s, dt_s), _Filter.of(vertical_s, dt_s)

    def step(self) -> None:
        """One step on."""
        if not self._noise:
            self._noise = self._rng.standard_normal(_BLOCK).tolist()
        noise = self._noise.pop
        self.along = self._level.keep * self.along + self._level.fresh * noise()
        self._v = p, q = _second(self._level, self._v, noise(), noise())
        # stationary: var q = 1, var p = cov p q = 1/2, so var y = (1 + a^2) / 2 = 2, a = sqrt 3
        self.across = ((1.0 - _ROOT_3) * p + _ROOT_3 * q) / math.sqrt(2.0)
        self._w = p, q = _second(self._vertical, self._w, noise(), noise())
        self.up = ((1.0 - _ROOT_3) * p + _ROOT_3 * q) / math.sqrt(2.0)


def _second(
    by: _Filter, pq: tuple[float, float], first: float, second: float
) -> tuple[float, float]:
    p, q = pq
    return (
        by.keep * p + by.from_q * q + by.mixed * first + by.own * second,
        by.keep * q + by.fresh * first,
    )


@final
class Wind:
    """The air about one vehicle; sets the vehicle's wind before each of its steps."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._gusts = Gusts(rng)
        self.conditions: WindConditions | None = None
        self._target_m_s = self._mean_m_s = (0.0, 0.0, 0.0)
        """North, east, up, at full height."""
        self.still = False
        """No wind, and the vehicle has been told: until the conditions change there is none."""
        self._retune_s = 0.0
        self._along = (1.0, 0.0)

    def step(
        self, dt_s: float, vehicle: Vehicle, conditions: WindConditions, ground_amsl_m: float
    ) -> None:
        """Blow on for dt_s over ground of this height."""
        if conditions is not self.conditions:
            self._turn_to(conditions)
        elif self.still:
            return
        if self._mean_m_s != self._target_m_s:
            self._settle(dt_s)
        north, east, up = self._mean_m_s
        height_m = vehicle.altitude_amsl_m - ground_amsl_m
        if height_m < _FULL_HEIGHT_M:
            share = math.sqrt(max(height_m, 0.0) / _FULL_HEIGHT_M)
            north, east, up = north * share, east * share, up * share
        if turbulence := conditions.turbulence_m_s:
            self._retune_s -= dt_s
            if self._retune_s <= 0.0:
                self._retune(dt_s, vehicle)
            gusts = self._gusts
            gusts.step()
            along, across = turbulence * gusts.along, turbulence * gusts.across
            cosine, sine = self._along
            north += cosine * along - sine * across
            east += sine * along + cosine * across
            up += turbulence * VERTICAL_SHARE * gusts.up
        else:
            self.still = self._mean_m_s == self._target_m_s == (0.0, 0.0, 0.0)
        vehicle.wind_north_m_s, vehicle.wind_east_m_s, vehicle.wind_up_m_s = north, east, up

    def _turn_to(self, conditions: WindConditions) -> None:
        level = conditions.speed_m_s * math.cos(conditions.rising_rad)
        cosine, sine = -math.cos(conditions.from_rad), -math.sin(conditions.from_rad)
        up = conditions.speed_m_s * math.sin(conditions.rising_rad)
        self._target_m_s, self._along = (level * cosine, level * sine, up), (cosine, sine)
        if self.conditions is None:  # it has blown since long before the first step
            self._mean_m_s = self._target_m_s
        self.still, self.conditions, self._retune_s = False, conditions, 0.0

    def _settle(self, dt_s: float) -> None:
        """A step closer to what is asked for; there at last when within a millimetre a second."""
        share = dt_s / (_SETTLING_S + dt_s)
        (n, e, u), (to_n, to_e, to_u) = self._mean_m_s, self._target_m_s
        n, e, u = n + (to_n - n) * share, e + (to_e - e) * share, u + (to_u - u) * share
        there = max(abs(to_n - n), abs(to_e - e), abs(to_u - u)) < 1e-3
        self._mean_m_s = self._target_m_s if there else (n, e, u)

    def _retune(self, dt_s: float, vehicle: Vehicle) -> None:
        """Gusts as they are at this speed."""
        self._retune_s = _RETUNE_S
        north = vehicle.velocity_north_m_s - self._mean_m_s[0]
        east = vehicle.velocity_east_m_s - self._mean_m_s[1]
        past_m_s = max(math.hypot(north, east), _MIN_SPEED_M_S)
        self._gusts.tune(LEVEL_M / past_m_s, VERTICAL_M / past_m_s, dt_s)
