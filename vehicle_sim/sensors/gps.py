"""GPS receiver model: delay, noise, errors and loss.

The receivers are those of ArduPilot's and PX4's own simulations (libraries/SITL/SIM_GPS.cpp,
SensorGpsSim.cpp), with the times and accuracies that the recorded flights show.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple, final

import numpy as np

from vehicle_sim.dynamics import Vehicle
from vehicle_sim.faults import GpsConditions, Vector
from vehicle_sim.geodesy import FloatArray, around, degrees_east, metres_per_degree

Quality = tuple[float, float, float, float, float]
"""Dilution, horizontal and vertical; accuracy of place and height in m, of speed in m/s (0: the
receiver has not said)."""
_ZERO: Final = (0.0, 0.0, 0.0)


@final
class Fix(NamedTuple):
    """One solution of the receiver: GPS_RAW_INT.  The newest one is handed to every step."""

    time_us: int = 0
    """Since boot, when it was put out; position and velocity are those of latency earlier.

    ArduPilot's stays at the last one with a fix while there is none; the position goes on."""
    fix_type: int = 0
    """GPS_FIX_TYPE: 0 no receiver, 1 no fix, 2 flat, 3 full, 4 DGPS, 5 RTK float, 6 RTK fixed."""
    latitude_deg: float = 0.0
    longitude_deg: float = 0.0
    altitude_amsl_m: float = 0.0
    velocity_north_m_s: float = 0.0
    velocity_east_m_s: float = 0.0
    velocity_up_m_s: float = 0.0
    satellites: int = 0
    quality: Quality = (99.99, 99.99, 0.0, 0.0, 0.0)

    @property
    def usable(self) -> bool:
        """A position in space."""
        return self.fix_type >= 3


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Receiver:
    """What differs between the receivers.  Standard deviations are of white noise."""

    interval_us: int
    first_us: int
    """Since boot: the first thing that the autopilot hears of it."""
    fix_type: int
    """The best it reaches."""
    fix_type_lost: int
    quality: Quality
    quality_lost: Quality
    late_lock: bool
    """Whether there is a fix is known as late as where it is, and the clock stops without one."""
    noise_m: Vector = _ZERO
    """North, east, up."""
    velocity_noise_m_s: Vector = _ZERO


ARDUCOPTER: Final = Receiver(
    interval_us=200_000,
    first_us=9_773_000,
    fix_type=6,
    fix_type_lost=1,
    quality=(1.21, 2.0, 0.3, 0.3, 0.0),
    quality_lost=(1.21, 2.0, 0.3, 0.3, 0.0),
    late_lock=True,
)
"""As in arducopter-*.tlog: fix_type 1 once, 6 from 9.973 s on."""
ARDUPLANE: Final = replace(ARDUCOPTER, first_us=9_028_000)
"""As in arduplane-guided-reposition.tlog: 6 from 9.228 s on."""
PX4: Final = Receiver(
    interval_us=125_000,
    first_us=125_000,
    fix_type=3,
    fix_type_lost=0,
    quality=(0.7, 1.1, 0.9, 1.78, 0.4),
    quality_lost=(100.0, 100.0, 100.0, 100.0, 100.0),
    late_lock=False,
    noise_m=(0.2, 0.2, 0.5),
    velocity_noise_m_s=(0.06, 0.077, 0.158),
)
"""As in px4-*.tlog; the noise is white there (no correlation from one solution to the next)."""

_HISTORY: Final = 50
"""Solutions: a latency beyond them is no longer than they reach back."""
_WANDER_S: Final = 5.0
"""Correlation time of GpsConditions.sigma_m."""
_VERTICAL: Final = 1.5
_LEAST_SATELLITES: Final = 4
_JAM_CHANGES_HZ: Final = 0.3
_JAM_RANGES: Final = ((0.0, -200.0, -200.0, *[-400.0] * 3), (11.0, 200.0, 200.0, *[400.0] * 3))
"""Satellites, metres and metres a second, as far as ArduPilot's simulated jammer goes."""


@final
class _Sample(NamedTuple):
    """Where the antenna was, with the errors that are made there."""

    time_us: int
    locked: bool
    """There was a fix."""
    state: FloatArray
    """Latitude and longitude in degrees, metres AMSL; north, east, up in m/s.  (6,)"""


@final
class Gps:
    """One receiver from one boot to the next.  Seeded; draws only with each solution."""

    def __init__(self, receiver: Receiver, rng: np.random.Generator) -> None:
        self._receiver, self._rng = receiver, rng
        self.due_us = receiver.first_us
        """Nothing new is put out before."""
        self.fix = Fix()
        """The newest one."""
        self._history = deque([_Sample(0, False, np.zeros(6))], maxlen=_HISTORY)
        self._locked_us = 0
        self._wander, self._drift_m = rng.standard_normal(3), np.zeros(3)
        self._jam: FloatArray | None = None
        """While a jammer is near: satellites, and what is wrong with place and velocity."""

    def step(self, now_us: int, vehicle: Vehicle, conditions: GpsConditions) -> Fix:
        """The newest solution at now_us (since boot); the same object until there is another."""
        if now_us >= self.due_us:
            interval_us = self._receiver.interval_us
            due_us = now_us - (now_us - self.due_us) % interval_us
            self.due_us = due_us + interval_us
            self._history.append(self._sample(due_us, now_us, vehicle, conditions))
            self.fix = self._solution(due_us, conditions)
        return self.fix

    def _sample(
        self, due_us: int, now_us: int, vehicle: Vehicle, conditions: GpsConditions
    ) -> _Sample:
        """What the antenna sees: the truth at due_us, with the errors that are made there."""
        receiver, error_m = self._receiver, self._noise(self._receiver.noise_m)
        if conditions.sigma_m:
            keep = math.exp(-receiver.interval_us * 1e-6 / _WANDER_S)
            fresh = self._noise(3 * (math.sqrt(1.0 - keep * keep),))
            self._wander = keep * self._wander + fresh
            error_m += np.array([1.0, 1.0, _VERTICAL]) * conditions.sigma_m * self._wander
        place = (vehicle.latitude_deg, vehicle.longitude_deg, vehicle.altitude_amsl_m)
        state = np.array([*place, *vehicle.velocity_neu_m_s])
        error_m -= state[3:] * ((now_us - due_us) * 1e-6)
        state[:3] += _degrees(error_m, vehicle.latitude_deg)
        state[2] += conditions.offset_up_m
        state[3:] += self._noise(receiver.velocity_noise_m_s)
        return _Sample(due_us, conditions.enabled, state)

    def _noise(self, sizes: Vector) -> FloatArray:
        """Draws of the normal laws with these standard deviations; none where there is no noise."""
        return self._rng.standard_normal(3) * sizes if any(sizes) else np.zeros(3)

    def _late(self, at_us: int) -> _Sample:
        """The antenna then, between two samples; whether it has a fix is that of the older one."""
        for new, old in pairwise(reversed(self._history)):
            if old.time_us <= at_us <= new.time_us:
                share = (at_us - old.time_us) / max(new.time_us - old.time_us, 1)
                way = new.state - old.state
                way[1] = degrees_east(old.state[1], new.state[1])
                return old._replace(state=old.state + share * way)
        return self._history[0]

    def _jammed(self, sample: _Sample) -> tuple[_Sample, int]:
        """Near a jammer there is no fix at first, then wild ones that come and go."""
        if self._jam is None:
            self._jam = np.zeros(6)
        elif self._rng.random() < _JAM_CHANGES_HZ * self._receiver.interval_us * 1e-6:
            self._jam = self._rng.uniform(*_JAM_RANGES)
        satellites, north_m, east_m, *velocity_m_s = self._jam
        wrong = _degrees(np.array([north_m, east_m, 0.0]), sample.state[0])
        wild = np.array([*(sample.state[:3] + wrong), *velocity_m_s])
        return sample._replace(state=wild), int(satellites)

    def _solution(self, due_us: int, conditions: GpsConditions) -> Fix:
        receiver, satellites = self._receiver, conditions.satellites
        sample = self._late(due_us - round(conditions.lag_s * 1e6))
        locked = sample.locked if receiver.late_lock else self._history[-1].locked
        if conditions.jammed:
            sample, satellites = self._jammed(sample)
            locked = satellites >= _LEAST_SATELLITES
        else:
            self._jam = None
        if locked or not receiver.late_lock:
            self._locked_us = due_us
        state, drift_m_s, glitch_m = sample.state, conditions.drift_m_s, conditions.glitch_m
        drifted_m = self._drift_m + np.array(drift_m_s) * (receiver.interval_us * 1e-6)
        self._drift_m = drifted_m if any(drift_m_s) else np.zeros(3)
        east_deg, up_m = conditions.glitch_longitude_deg, conditions.glitch_up_m
        glitch = (conditions.glitch_latitude_deg, east_deg, up_m)
        if any(drift_m_s + glitch_m + glitch):
            wrong = _degrees(self._drift_m + glitch_m, state[0]) + np.array(glitch)
            state = state + np.array([*wrong, *drift_m_s])
        latitude_deg, longitude_deg, altitude_m, north_m_s, east_m_s, up_m_s = state.tolist()
        return Fix(
            self._locked_us,
            receiver.fix_type if locked else receiver.fix_type_lost,
            min(max(latitude_deg, -90.0), 90.0),
            around(longitude_deg),
            *(altitude_m, north_m_s, east_m_s, up_m_s),
            satellites if locked else min(satellites, _LEAST_SATELLITES - 1),
            receiver.quality if locked else receiver.quality_lost,
        )


def _degrees(north_east_up_m: FloatArray, latitude_deg: float) -> FloatArray:
    """A way as degrees of latitude and longitude there, and metres."""
    return north_east_up_m / (*metres_per_degree(latitude_deg), 1.0)
