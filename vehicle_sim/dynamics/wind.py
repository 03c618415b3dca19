"""Wind: what blows steadily, and gusts about it.

Gusts have the Dryden spectra of MIL-F-8785C at low altitude: u along the mean wind, v across, w up,

    T = L / V,  L_w = h,  L_u = L_v = h / (0.177 + 0.000823 h)^1.2
    u:       sigma_u^2 4 T / (1 + (2 pi f T)^2)                            for each Hz, one-sided
    v and w: sigma^2 2 T (1 + 3 (2 pi f T)^2) / (1 + (2 pi f T)^2)^2       likewise
    sigma_v = sigma_u,  sigma_w = sigma_u (0.177 + 0.000823 h)^0.4

with h above the ground in feet, held from 10 to 1000 ft (there everything is 1000 ft and equal, and
stays so above).  V is the speed of the air that passes the vehicle, at least 3 m/s.  Unlike in the
standard the level gusts' size is not a share of the wind at 6 m but what is asked for, as with
ArduPilot's SIM_WIND_TURB.  The filters are discretised exactly: variance and correlation are right
whatever the step is.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from vehicle_sim.dynamics import Vehicle

FOOT_M = 0.3048
_LOWEST_FT, _HIGHEST_FT = 10.0, 1000.0
_MIN_SPEED_M_S = 3.0
"""Of the air past the vehicle, for a vehicle that drifts with it still feels the gusts change."""
_RETUNE_S = 0.25
_BLOCK = 5 * 512
_ROOT_3 = math.sqrt(3.0)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class WindConditions:
    """The wind that is asked for, in ArduPilot's terms."""

    speed_m_s: float = 0.0
    from_rad: float = 0.0
    """True direction that it comes from, as weather reports have it."""
    rising_rad: float = 0.0
    """Above the horizontal, positive upwards."""
    turbulence_m_s: float = 0.0
    """Standard deviation of the horizontal gusts."""
    profile: int = 0
    """0: below full_height_m with the square root of the height; 1: the same at every height."""
    full_height_m: float = 60.0
    settling_s: float = 5.0
    """Time constant with which a change sets in."""


def lengths_m(height_m: float) -> tuple[float, float]:
    """Scale of the level and of the vertical gusts at this height above the ground."""
    height_ft = min(max(height_m / FOOT_M, _LOWEST_FT), _HIGHEST_FT)
    return height_ft / (0.177 + 0.000823 * height_ft) ** 1.2 * FOOT_M, height_ft * FOOT_M


def vertical_share(height_m: float) -> float:
    """Vertical gusts over level ones at this height above the ground."""
    height_ft = min(max(height_m / FOOT_M, _LOWEST_FT), _HIGHEST_FT)
    return (0.177 + 0.000823 * height_ft) ** 0.4


@final
class Gusts:
    """Three Dryden filters of unit variance; plain floats, five random numbers a step."""

    __slots__ = ("_at", "_block", "_rng", "_u", "_v", "_w", "across", "along", "up")

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._block: list[float] = []
        self._at = 0
        self._u = _First()
        self._v, self._w = _Second(), _Second()
        self.along = self.across = self.up = 0.0
        """Unit variance each."""

    def tune(self, level_s: float, vertical_s: float, dt_s: float) -> None:
        """Time constants L / V of level and vertical gusts, for steps of this length."""
        self._u.tune(level_s, dt_s)
        self._v.tune(level_s, dt_s)
        self._w.tune(vertical_s, dt_s)

    def step(self) -> None:
        """One step on."""
        at = self._at
        if at >= len(self._block):
            self._block = self._rng.standard_normal(_BLOCK).tolist()
            at = 0
        block = self._block
        self._at = at + 5
        self.along = self._u.step(block[at])
        self.across = self._v.step(block[at + 1], block[at + 2])
        self.up = self._w.step(block[at + 3], block[at + 4])


@final
class _First:
    """1 / (1 + T s) driven by white noise: x(t + dt) = exp(-dt / T) x(t) + noise."""

    __slots__ = ("_fresh", "_keep", "_x")

    def __init__(self) -> None:
        self._x = self._keep = self._fresh = 0.0

    def tune(self, time_s: float, dt_s: float) -> None:
        self._keep = math.exp(-dt_s / time_s)
        self._fresh = math.sqrt(1.0 - self._keep * self._keep)

    def step(self, noise: float) -> float:
        self._x = x = self._keep * self._x + self._fresh * noise
        return x


@final
class _Second:
    """(1 + sqrt(3) T s) / (1 + T s)^2 driven by white noise.

    In units of T: p' = -p + q, q' = -q + noise of intensity 2, y = (1 - sqrt 3) p + sqrt 3 q.  Over
    a step of r = dt / T: q keeps e = exp(-r), p keeps e and takes r e of q; the noise added has the
    covariance below, by integrating the impulse responses exp(-t) and t exp(-t).
    """

    __slots__ = ("_from_q", "_keep", "_mix", "_p", "_pp", "_q", "_qq")

    # Stationary: var q = 1, var p = cov p q = 1/2, so var y = (1 + a^2) / 2 = 2 with a = sqrt 3.
    _SCALE = 1.0 / math.sqrt(2.0)

    def __init__(self) -> None:
        self._p = self._q = 0.0
        self._keep = self._from_q = self._pp = self._qq = self._mix = 0.0

    def tune(self, time_s: float, dt_s: float) -> None:
        r = dt_s / time_s
        e2 = math.exp(-2.0 * r)
        self._keep = math.exp(-r)
        self._from_q = r * self._keep
        var_q = -math.expm1(-2.0 * r)
        if r < 1e-3:  # the closed forms cancel; the error of these is below 1e-3 of themselves
            covariance = r * r * (1.0 - 4.0 / 3.0 * r)
            var_p = 2.0 / 3.0 * r * r * r * (1.0 - 1.5 * r)
        else:
            covariance = 0.5 * (1.0 - e2 * (1.0 + 2.0 * r))
            var_p = 0.5 * (1.0 - e2 * (1.0 + 2.0 * r + 2.0 * r * r))
        self._qq = math.sqrt(var_q)
        self._mix = covariance / self._qq
        self._pp = math.sqrt(max(var_p - self._mix * self._mix, 0.0))

    def step(self, first: float, second: float) -> float:
        keep, q = self._keep, self._q
        self._p = p = keep * self._p + self._from_q * q + self._mix * first + self._pp * second
        self._q = q = keep * q + self._qq * first
        return ((1.0 - _ROOT_3) * p + _ROOT_3 * q) * self._SCALE


@final
class Wind:
    """The air about one vehicle; sets the vehicle's wind before each of its steps."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._gusts = Gusts(rng)
        self.conditions: WindConditions | None = None
        self._target_m_s = (0.0, 0.0, 0.0)
        self._mean_m_s = (0.0, 0.0, 0.0)
        """North, east, up, at full height."""
        self._settled = True
        self.still = False
        """No wind, and the vehicle has been told: until the conditions change there is none."""
        self._retune_s = 0.0
        self._vertical = 1.0
        self._along = (1.0, 0.0)

    def step(
        self, dt_s: float, vehicle: Vehicle, conditions: WindConditions, ground_amsl_m: float
    ) -> None:
        """Blow on for dt_s over ground of this height."""
        if conditions is not self.conditions:
            self._turn_to(conditions)
        elif self.still:
            return
        if not self._settled:
            self._settle(dt_s, conditions)
        height_m = vehicle.altitude_amsl_m - ground_amsl_m
        north, east, up = self._mean_m_s
        if conditions.profile == 0 and height_m < conditions.full_height_m:
            share = math.sqrt(height_m / conditions.full_height_m) if height_m > 0.0 else 0.0
            north, east, up = north * share, east * share, up * share
        turbulence = conditions.turbulence_m_s
        if turbulence:
            self._retune_s -= dt_s
            if self._retune_s <= 0.0:
                self._retune(dt_s, vehicle, height_m)
            gusts = self._gusts
            gusts.step()
            along, across = turbulence * gusts.along, turbulence * gusts.across
            cosine, sine = self._along
            north += cosine * along - sine * across
            east += sine * along + cosine * across
            up += turbulence * self._vertical * gusts.up
        else:
            self.still = self._settled and not any(self._mean_m_s)
        vehicle.wind_north_m_s, vehicle.wind_east_m_s, vehicle.wind_up_m_s = north, east, up

    def _turn_to(self, conditions: WindConditions) -> None:
        level = conditions.speed_m_s * math.cos(conditions.rising_rad)
        cosine, sine = -math.cos(conditions.from_rad), -math.sin(conditions.from_rad)
        up = conditions.speed_m_s * math.sin(conditions.rising_rad)
        self._target_m_s = (level * cosine, level * sine, up)
        self._along = (cosine, sine)
        if self.conditions is None:  # it has blown since long before the first step
            self._mean_m_s = self._target_m_s
        self._settled = self._mean_m_s == self._target_m_s
        self.still = False
        self.conditions = conditions
        self._retune_s = 0.0

    def _settle(self, dt_s: float, conditions: WindConditions) -> None:
        """A step closer to what is asked for; there at last when within a millimetre a second."""
        share = dt_s / (conditions.settling_s + dt_s)
        moved = [m + (t - m) * share for m, t in zip(self._mean_m_s, self._target_m_s, strict=True)]
        self._mean_m_s = (moved[0], moved[1], moved[2])
        left = max(abs(t - m) for m, t in zip(moved, self._target_m_s, strict=True))
        if left < 1e-3:
            self._mean_m_s = self._target_m_s
            self._settled = True

    def _retune(self, dt_s: float, vehicle: Vehicle, height_m: float) -> None:
        """Gusts as they are at this height and speed."""
        self._retune_s = _RETUNE_S
        self._vertical = vertical_share(height_m)
        past_m_s = max(
            math.hypot(
                vehicle.velocity_north_m_s - self._mean_m_s[0],
                vehicle.velocity_east_m_s - self._mean_m_s[1],
            ),
            _MIN_SPEED_M_S,
        )
        level_m, vertical_m = lengths_m(height_m)
        self._gusts.tune(level_m / past_m_s, vertical_m / past_m_s, dt_s)
