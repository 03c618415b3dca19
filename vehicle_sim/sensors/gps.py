"""GPS receiver model: delay, noise, errors and loss.

The receivers are those of ArduPilot's and PX4's own simulations (libraries/SITL/SIM_GPS.cpp,
SensorGpsSim.cpp), with the times and accuracies that the recorded flights show.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np

from vehicle_sim.dynamics import Vehicle
from vehicle_sim.geodesy import ARDUPILOT_M_PER_DEG, around, metres_per_degree
from vehicle_sim.sensors.antenna import Jamming, Sample, between


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
    horizontal_dilution: float = 99.99
    vertical_dilution: float = 99.99
    horizontal_accuracy_m: float = 0.0
    """0: the receiver has not said."""
    vertical_accuracy_m: float = 0.0
    speed_accuracy_m_s: float = 0.0

    @property
    def usable(self) -> bool:
        """A position in space."""
        return self.fix_type >= 3


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GpsConditions:
    """What is wrong with the receiver or the sky.  North, east and up, true."""

    enabled: bool = True
    satellites: int = 10
    fix_type: int = 6
    """The best that it reaches."""
    lock_s: float = 0.0
    """Since boot: no fix before."""
    lag_s: float = 0.1
    jammed: bool = False
    glitch_latitude_deg: float = 0.0
    glitch_longitude_deg: float = 0.0
    glitch_up_m: float = 0.0
    drift_north_m_s: float = 0.0
    """The position moves away at this speed, and the velocity says so, until all three are 0."""
    drift_east_m_s: float = 0.0
    drift_up_m_s: float = 0.0
    circle_m: float = 0.0
    """Radius of a slow horizontal circle about the truth."""
    wave_m: float = 0.0
    """Amplitude of a wave of 12.6 s in height."""
    swell_m: float = 0.0
    """Amplitude of a wave of 314 s in height."""
    offset_up_m: float = 0.0
    accuracy_m: float = 0.3
    """What ArduPilot's receiver says of itself, horizontally and vertically."""
    sigma_m: float = 0.0
    """Standard deviation of a random error of each horizontal axis; 1.5 times that in height."""
    velocity_error_north_m_s: float = 0.0
    """Half width of an even random error of each solution."""
    velocity_error_east_m_s: float = 0.0
    velocity_error_up_m_s: float = 0.0


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
    satellites_lost: int | None
    """What it says without a fix; None: as many as are asked for."""
    dilutions: tuple[float, float]
    """Horizontal, vertical."""
    accuracies: tuple[float, float, float] | None
    """Horizontal and vertical in m, speed in m/s; None: what is asked for, lost fix or not."""
    lost_dilutions: tuple[float, float]
    lost_accuracies: tuple[float, float, float] | None
    late_lock: bool
    """Whether there is a fix is known as late as where it is, and the clock stops without one."""
    blank_first: bool = False
    """The first thing that is heard has nothing in it."""
    noise_m: tuple[float, float] = (0.0, 0.0)
    """Of each horizontal axis, of the height."""
    velocity_noise_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """North, east, up."""


ARDUCOPTER = Receiver(
    interval_us=200_000,
    first_us=9_773_000,
    fix_type=6,
    fix_type_lost=1,
    satellites_lost=3,
    dilutions=(1.21, 2.0),
    accuracies=None,
    lost_dilutions=(1.21, 2.0),
    lost_accuracies=None,
    late_lock=True,
)
"""As in arducopter-*.tlog: fix_type 1 once, 6 from 9.973 s on."""
ARDUPLANE = replace(ARDUCOPTER, first_us=9_028_000, blank_first=True)
"""As in arduplane-guided-reposition.tlog: 6 from 9.228 s on."""
PX4 = Receiver(
    interval_us=125_000,
    first_us=125_000,
    fix_type=3,
    fix_type_lost=0,
    satellites_lost=None,
    dilutions=(0.7, 1.1),
    accuracies=(0.9, 1.78, 0.4),
    lost_dilutions=(100.0, 100.0),
    lost_accuracies=(100.0, 100.0, 100.0),
    late_lock=False,
    noise_m=(0.2, 0.5),
    velocity_noise_m_s=(0.06, 0.077, 0.158),
)
"""As in px4-*.tlog; the noise is white there (no correlation from one solution to the next)."""

_HISTORY = 50
"""Solutions: a latency beyond them is no longer than they reach back."""
_WANDER_S = 5.0
"""Correlation time of GpsConditions.sigma_m."""
_VERTICAL = 1.5
_WAVE_RAD_S, _SWELL_RAD_S = 0.5, 0.02


@final
class Gps:
    """One receiver from one boot to the next.  Seeded; draws only with each solution."""

    def __init__(self, receiver: Receiver, rng: np.random.Generator) -> None:
        self._receiver = receiver
        self._rng = rng
        self.due_us = receiver.first_us
        """Nothing new is put out before."""
        self.fix = Fix()
        """The newest one."""
        self._history = deque([Sample(0, False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)], maxlen=_HISTORY)
        self._locked_us = 0
        self._wander = rng.standard_normal(3).tolist()
        self._drift_m = [0.0, 0.0, 0.0]
        self._jamming = Jamming(rng)

    def step(self, now_us: int, vehicle: Vehicle, conditions: GpsConditions) -> Fix:
        """The newest solution at now_us (since boot); the same object until there is another."""
        if now_us < self.due_us:
            return self.fix
        receiver = self._receiver
        due_us = now_us - (now_us - self.due_us) % receiver.interval_us
        self.due_us = due_us + receiver.interval_us
        self._history.append(self._sample(due_us, now_us, vehicle, conditions))
        if receiver.blank_first and len(self._history) == 2:
            self.fix = Fix(fix_type=receiver.fix_type_lost)
        else:
            self.fix = self._solution(due_us, conditions)
        return self.fix

    def _sample(
        self, due_us: int, now_us: int, vehicle: Vehicle, conditions: GpsConditions
    ) -> Sample:
        """What the antenna sees: the truth at due_us, with the errors that are made there."""
        ago_s, due_s = (now_us - due_us) * 1e-6, due_us * 1e-6
        per_north_m, per_east_m = metres_per_degree(vehicle.latitude_deg)
        error_n, error_e, error_u = self._errors_m(conditions)
        north_m = error_n - vehicle.velocity_north_m_s * ago_s
        east_m = error_e - vehicle.velocity_east_m_s * ago_s
        up_m = error_u - vehicle.velocity_up_m_s * ago_s + conditions.offset_up_m
        if conditions.wave_m or conditions.swell_m:
            up_m += conditions.wave_m * math.sin(_WAVE_RAD_S * due_s)
            up_m += conditions.swell_m * math.sin(_SWELL_RAD_S * due_s)
        speed_n, speed_e, speed_u = self._velocity_errors_m_s(conditions)
        return Sample(
            due_us,
            conditions.enabled and due_s >= conditions.lock_s,
            vehicle.latitude_deg + north_m / per_north_m,
            vehicle.longitude_deg + east_m / per_east_m,
            vehicle.altitude_amsl_m + up_m,
            vehicle.velocity_north_m_s + speed_n,
            vehicle.velocity_east_m_s + speed_e,
            vehicle.velocity_up_m_s + speed_u,
        )

    def _errors_m(self, conditions: GpsConditions) -> tuple[float, float, float]:
        """The receiver's own white noise, and the slow random error that was asked for."""
        level_m, height_m = self._receiver.noise_m
        north_m = east_m = up_m = 0.0
        if level_m or height_m:
            white = self._rng.standard_normal(3).tolist()
            north_m, east_m, up_m = white[0] * level_m, white[1] * level_m, white[2] * height_m
        if conditions.sigma_m:
            keep = math.exp(-self._receiver.interval_us * 1e-6 / _WANDER_S)
            fresh = math.sqrt(1.0 - keep * keep)
            draws = self._rng.standard_normal(3).tolist()
            self._wander = [
                keep * old + fresh * new for old, new in zip(self._wander, draws, strict=True)
            ]
            north_m += conditions.sigma_m * self._wander[0]
            east_m += conditions.sigma_m * self._wander[1]
            up_m += conditions.sigma_m * _VERTICAL * self._wander[2]
        return north_m, east_m, up_m

    def _velocity_errors_m_s(self, conditions: GpsConditions) -> tuple[float, float, float]:
        north, east, up = self._receiver.velocity_noise_m_s
        errors = [0.0, 0.0, 0.0]
        if north or east or up:
            white = self._rng.standard_normal(3).tolist()
            errors = [white[0] * north, white[1] * east, white[2] * up]
        asked = (
            conditions.velocity_error_north_m_s,
            conditions.velocity_error_east_m_s,
            conditions.velocity_error_up_m_s,
        )
        if any(asked):
            even = self._rng.uniform(-1.0, 1.0, 3).tolist()
            errors = [e + a * x for e, a, x in zip(errors, asked, even, strict=True)]
        return errors[0], errors[1], errors[2]

    def _late(self, due_us: int, lag_us: int) -> Sample:
        """The antenna lag_us ago, between two samples; the fix is that of the older one."""
        history = self._history
        for i in range(len(history) - 1, 0, -1):
            new, old = history[i], history[i - 1]
            if due_us - new.time_us <= lag_us <= due_us - old.time_us:
                span_us = max(new.time_us - old.time_us, 1)
                share = (due_us - old.time_us - lag_us) / span_us
                return between(old, new, share)
        return history[0]

    def _solution(self, due_us: int, conditions: GpsConditions) -> Fix:
        receiver = self._receiver
        sample = self._late(due_us, round(conditions.lag_s * 1e6))
        locked = sample.locked if receiver.late_lock else self._history[-1].locked
        satellites = conditions.satellites
        if conditions.jammed:
            sample, locked, satellites = self._jamming.spoil(due_us, sample, satellites)
        if locked or not receiver.late_lock:
            self._locked_us = due_us
        if not locked and receiver.satellites_lost is not None:
            satellites = receiver.satellites_lost
        north_m, east_m, up_m = self._wandered_m(due_us, conditions)
        cosine = max(math.cos(math.radians(sample.latitude_deg)), 0.0175)
        heard = locked or self.fix.horizontal_accuracy_m > 0.0
        dilutions = receiver.dilutions if locked else receiver.lost_dilutions
        accuracies = receiver.accuracies if locked else receiver.lost_accuracies
        if accuracies is None:
            accuracies = (conditions.accuracy_m, conditions.accuracy_m, 0.0)
        fix_type = min(conditions.fix_type, receiver.fix_type)
        north_deg = conditions.glitch_latitude_deg + north_m / ARDUPILOT_M_PER_DEG
        east_deg = conditions.glitch_longitude_deg + east_m / ARDUPILOT_M_PER_DEG / cosine
        return Fix(
            time_us=self._locked_us,
            fix_type=fix_type if locked else receiver.fix_type_lost,
            latitude_deg=min(max(sample.latitude_deg + north_deg, -90.0), 90.0),
            longitude_deg=around(sample.longitude_deg + east_deg),
            altitude_amsl_m=sample.altitude_amsl_m + conditions.glitch_up_m + up_m,
            velocity_north_m_s=sample.north_m_s + conditions.drift_north_m_s,
            velocity_east_m_s=sample.east_m_s + conditions.drift_east_m_s,
            velocity_up_m_s=sample.up_m_s + conditions.drift_up_m_s,
            satellites=satellites,
            horizontal_dilution=dilutions[0],
            vertical_dilution=dilutions[1],
            horizontal_accuracy_m=accuracies[0] if heard else 0.0,
            vertical_accuracy_m=accuracies[1] if heard else 0.0,
            speed_accuracy_m_s=accuracies[2] if heard else 0.0,
        )

    def _wandered_m(self, due_us: int, conditions: GpsConditions) -> tuple[float, float, float]:
        """How far a drift has come by now, and the circle: north, east, up."""
        drift = (conditions.drift_north_m_s, conditions.drift_east_m_s, conditions.drift_up_m_s)
        if any(drift):
            step_s = self._receiver.interval_us * 1e-6
            self._drift_m = [m + v * step_s for m, v in zip(self._drift_m, drift, strict=True)]
        else:
            self._drift_m = [0.0, 0.0, 0.0]
        north_m, east_m, up_m = self._drift_m
        if conditions.circle_m:
            angle_rad = _WAVE_RAD_S * due_us * 1e-6
            north_m += conditions.circle_m * math.sin(angle_rad)
            east_m += conditions.circle_m * math.cos(angle_rad)
        return north_m, east_m, up_m
