"""Where an autopilot believes to be: the truth plus an error, from boot to GPS loss and back.

An inertial filter follows the truth closely for seconds whatever GPS does.  What is modelled is the
error on top: almost none while GPS is good; a glitch is refused, then believed; without GPS the
error drifts, the position is given up, and jumps when GPS is back.  How long each takes, and the
flags that tell of it, are the firmware's `Timing`.
"""

import cmath
import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from vehicle_sim.autopilot.values import Place
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.geodesy import around, degrees_east, metres_per_degree
from vehicle_sim.sensors.gps import Fix

_OUTAGE_S: Final = 1.0
"""After a gap of this length the first fix is believed, wherever it is (both firmwares have wide
gates by then)."""
_DRIFTS_S: Final = 0.5  # fixes come every 0.125 or 0.2 s: so long after the last one, they do not
_GIVES_UP_S: Final = 0.69
"""EKF3's flags drop the position for so long before it yields to GPS (arducopter-gps-loss.tlog)."""
_KEEPS, _KEEPS_UP = math.exp(-0.125 / 0.8), math.exp(-0.125 / 1.5)
"""Of the velocity's error, from one fix of PX4 to the next: it wanders within 0.8 s, upwards 1.5 s
(hover of px4-offboard-8mps.tlog)."""
_NOISE_ON_GROUND: Final = 0.15
_BLOCK: Final = 256  # random numbers are drawn so many at a time


State = enum.Enum("State", "START GOOD GLITCH YIELDS LOST STOPPED")
"""What the estimator is up to: it has not had a position yet; has one; refuses GPS, or did until a
moment ago; is about to believe GPS that it has refused; is without GPS for too long to fly by its
position; and for so long that it has none."""


_FLYING: Final = frozenset({State.GOOD, State.GLITCH, State.YIELDS})


def state_flags(
    good: int, glitch: int, yields: int, lost: int, stopped: int
) -> Mapping[State, int]:
    """Flags of these states."""
    return dict(zip(list(State)[1:], (good, glitch, yields, lost, stopped), strict=True))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Of one firmware's estimator; times in seconds."""

    stages: tuple[tuple[float, int], ...]
    """Flags from these times since boot on, until there is a position."""
    flags: Mapping[State, int]
    """From then on: `state_flags`."""
    origin_s: float
    good_s: float
    """From the first fix to the origin, and to a position."""
    gate_m: float
    gate_growth_m_s: float = 0.0
    """A fix that is farther off is refused; the gate grows meanwhile."""
    glitch_s: float = math.inf
    yields_s: float
    calm_s: float = 0.0
    """Refused for so long, a glitch is told, and GPS is believed; for so long, it is over."""
    lost_s: float
    stopped_s: float
    """Without GPS for so long."""
    back_s: float
    """From the first fix after that to its use."""
    trusted_s: float = 0.0
    precise_s: float = 0.0
    """From there to a position that suffices to land by, and to one that suffices for all."""
    lag_s: float = 0.0
    """Latency that it takes the receiver to have."""
    follows: float
    """Share of a fix's error that is taken over."""
    drift_m_s: float = 0.0
    drift_m_s2: float = 0.0
    sink_m_s: float = 0.0
    """Without GPS the horizontal error begins with this velocity and acceleration, and that of the
    height with this one upwards."""
    jump_s: float = 0.0
    """Time constant with which the output follows a jump of the state."""
    noise_m_s: float = 0.0
    """Standard deviation of the velocity's error on each axis; with it the height errs as well."""
    velocity_ratio: float
    """The least test ratio of velocities that is told."""
    freezes: bool = True
    """Without GPS the position stands still, and at first there is none; a reset that a fault
    brings about stays: GPS counts as off by it."""


@final
class Estimator:
    """Where it believes to be; horizontal errors are north + east j in metres.  Mutable."""

    def __init__(self, vehicle: Vehicle, timing: Timing, rng: np.random.Generator) -> None:
        self.timing = timing
        self.state = State.START
        self.origin: Place | None = None
        self.aiding = False
        """It uses GPS, or did so not long ago."""
        self.still = False
        """Disarmed for a while: hardly any noise."""
        self.used_s = 0.0
        self.returned_s: float | None = None
        """When GPS was used last, and when again after it had been lost."""
        self._vehicle, self._rng = vehicle, rng
        knows = not timing.freezes
        self.latitude_deg = vehicle.latitude_deg * knows
        self.longitude_deg = vehicle.longitude_deg * knows
        self.altitude_amsl_m = vehicle.altitude_amsl_m * knows
        self.velocity_m_s, self.velocity_up_m_s = 0j, 0.0
        self.position_ok, self.flags = False, timing.stages[0][1]
        """Whether there is a position to fly by."""
        self.velocity_variance = self.horizontal_variance = self.horizontal_accuracy_m = 0.0
        """Of EKF_STATUS_REPORT or ESTIMATOR_STATUS, whichever the autopilot sends: test ratios."""
        self.frozen_altitude_amsl_m: float | None = None
        """Reported altitude AMSL while the position is lost; None: what it believes."""
        self._fix: Fix | None = None
        self._now_s = self._calm_s = 0.0
        self._waits_s: float | None = None
        """Since when there are fixes that are not used: not yet, or refused."""
        self._error, self._held, self._bias, self._rate = 0j, 0j, 0j, 0j
        """Of the position; what the output has still to make of a jump; by how much GPS counts as
        off; of the velocity."""
        self._up_m = self._climb_m_s = 0.0
        self._drift: complex | None = None  # without GPS: which way, and 1 or a little more or less
        self._noise: list[float] = []
        self._scale = metres_per_degree(vehicle.latitude_deg)

    @property
    def place(self) -> Place:
        """A copy of the position."""
        return Place(self.latitude_deg, self.longitude_deg, self.altitude_amsl_m)

    @property
    def precise(self) -> bool:
        """Whether it is good enough for all modes, and not for landing only."""
        return self.position_ok and self._is_back_for(self.timing.precise_s)

    def _is_back_for(self, wait_s: float) -> bool:
        """So long, if GPS had been lost."""
        return self.returned_s is None or self._now_s >= self.returned_s + wait_s

    # --- each step ----------------------------------------------------------------------------

    def step(self, now_s: float, dt_s: float, fix: Fix) -> None:
        """One step on, with the receiver's newest fix."""
        self._now_s = now_s
        if fix is not self._fix:
            self._fix = fix
            if fix.usable:
                self._take(fix)
            elif self.state not in _FLYING:
                self._waits_s = None
        silent_s = now_s - self.used_s
        if silent_s > _DRIFTS_S or self.state is not State.GOOD or self._waits_s is not None:
            self._watch(silent_s, fix)
            if now_s - self.used_s > _DRIFTS_S and self.state is not State.START:
                self._drift_away(silent_s, dt_s)
        if self._rate or self._climb_m_s:
            self._error += self._rate * dt_s
            self._up_m += self._climb_m_s * dt_s
        if self._held:
            self._held *= math.exp(-dt_s / self.timing.jump_s)
            self._held = 0j if abs(self._held) < 1e-3 else self._held
        if not self.position_ok and self.state in _FLYING:
            self.position_ok = self._is_back_for(self.timing.trusted_s)

    def follow(self) -> None:
        """The estimate once the vehicle has moved."""
        vehicle = self._vehicle
        self.altitude_amsl_m = vehicle.altitude_amsl_m + self._up_m
        self.velocity_up_m_s = vehicle.velocity_up_m_s + self._climb_m_s
        if self.aiding or not self.timing.freezes:
            off, rate = self._error + self._held, self._rate
            self.latitude_deg = vehicle.latitude_deg + off.real / self._scale[0]
            self.longitude_deg = around(vehicle.longitude_deg + off.imag / self._scale[1])
            self.velocity_m_s = vehicle.velocity_m_s + rate
        elif self.state is State.START and self._waits_s is None:
            self.altitude_amsl_m = 0.0

    # --- GPS ----------------------------------------------------------------------------------

    def _take(self, fix: Fix) -> None:
        """A new fix with a position."""
        timing, now_s = self.timing, self._now_s
        self._scale = metres_per_degree(self._vehicle.latitude_deg)
        if self.state not in _FLYING:
            self._waits_s = now_s if self._waits_s is None else self._waits_s
            if self.state is State.START and timing.freezes:
                self.latitude_deg, self.longitude_deg = fix.latitude_deg, fix.longitude_deg
            return
        gap_s, self.used_s = now_s - self.used_s, now_s
        off, gate_m = self._innovation(fix), timing.gate_m
        if self._waits_s is not None:
            gate_m += timing.gate_growth_m_s * (now_s - self._waits_s)
        self._tell(abs(off) / gate_m)
        if self._drift is not None:
            self._drift, self._rate, self._climb_m_s = None, 0j, 0.0
        if gap_s > _OUTAGE_S:
            self._jump(off)
        elif abs(off) > gate_m:
            self._waits_s = now_s if self._waits_s is None else self._waits_s
        else:
            self._accept(timing.follows * off)
            if timing.noise_m_s:
                up_m = fix.altitude_amsl_m + fix.velocity_up_m_s * self.timing.lag_s
                self._up_m += timing.follows * (up_m - self._vehicle.altitude_amsl_m - self._up_m)
        if self.position_ok:
            self._stir()

    def _innovation(self, fix: Fix) -> complex:
        """What the fix says beyond what is believed, allowing for its age."""
        vehicle, lag_s = self._vehicle, self.timing.lag_s
        north_m = (fix.latitude_deg - vehicle.latitude_deg) * self._scale[0]
        east_m = degrees_east(vehicle.longitude_deg, fix.longitude_deg) * self._scale[1]
        # half of what the velocity changed by since
        since_m = lag_s * (vehicle.velocity_m_s - 0.5 * lag_s * vehicle.acceleration_m_s2)
        return complex(north_m, east_m) + since_m + self._bias - self._error

    def _accept(self, shift: complex) -> None:
        """Believe it, and move by this much."""
        self._error += shift
        if self._waits_s is not None:
            self._waits_s, self._calm_s = None, self._now_s + self.timing.calm_s
            if self.state is State.YIELDS:
                self._be(State.GLITCH)

    def _jump(self, off: complex) -> None:
        """Believe it wholly: the state jumps, and the output after it."""
        self._accept(off)
        self._held -= off if self.timing.jump_s else 0j
        self._rate, self._climb_m_s = 0j, 0.0

    def _tell(self, ratio: float) -> None:
        """The test ratios: of the velocity's what noise makes of it."""
        errs = abs(self._rate.real) + abs(self._rate.imag)
        self.velocity_variance = self.timing.velocity_ratio + 0.5 * errs
        self.horizontal_variance = ratio

    def _stir(self) -> None:
        """The errors that are always there: velocities wander, and the position with them."""
        if not self.timing.noise_m_s:
            return
        if len(self._noise) < 3:
            self._noise = self._rng.standard_normal(3 * _BLOCK).tolist()
        draw, size = self._noise.pop, self.timing.noise_m_s
        size *= _NOISE_ON_GROUND if self.still else 1.0
        fresh, fresh_up = (size * math.sqrt(1.0 - k * k) for k in (_KEEPS, _KEEPS_UP))
        self._rate = _KEEPS * self._rate + fresh * complex(draw(), draw())
        self._climb_m_s = _KEEPS_UP * self._climb_m_s + fresh_up * draw()

    # --- what time brings ---------------------------------------------------------------------

    def _watch(self, silent_s: float, fix: Fix) -> None:
        """Starting, refusing GPS, or without it."""
        timing, state, now_s = self.timing, self.state, self._now_s
        if state is State.START:
            self.flags = next(flags for at_s, flags in reversed(timing.stages) if now_s >= at_s)
        waited_s = 0.0 if self._waits_s is None else now_s - self._waits_s
        if state not in _FLYING:
            if self._waits_s is not None:
                self._come_back(waited_s, fix)
            elif state is State.LOST and silent_s >= timing.stopped_s:
                self._be(State.STOPPED)
                self.velocity_m_s = 0j if timing.freezes else self.velocity_m_s
        elif silent_s >= timing.lost_s:
            self._be(State.LOST)
            self._waits_s = self.returned_s = None
            self.position_ok = False
        elif waited_s >= timing.yields_s:
            self._jump(self._innovation(fix))
            self._be(State.GLITCH if timing.calm_s else State.GOOD)
            self._tell(0.0)
        elif waited_s >= timing.yields_s - _GIVES_UP_S and timing.calm_s:
            self._be(State.YIELDS)
        elif waited_s >= timing.glitch_s and state is State.GOOD:
            self._be(State.GLITCH)
        elif state is State.GLITCH and self._waits_s is None and now_s >= self._calm_s:
            self._be(State.GOOD)

    def _drift_away(self, silent_s: float, dt_s: float) -> None:
        """Without GPS, some way that is drawn when it begins."""
        timing = self.timing
        if self._drift is None:
            angle_rad, size = self._rng.uniform(0.0, math.tau), self._rng.uniform(0.85, 1.15)
            self._drift, self._climb_m_s = cmath.rect(size, angle_rad), timing.sink_m_s
            self._rate = self._drift * (timing.drift_m_s + timing.drift_m_s2 * silent_s)
        self._rate += self._drift * timing.drift_m_s2 * dt_s

    def _come_back(self, since_s: float, fix: Fix) -> None:
        """There are fixes again, for so long: some are wanted before one is believed."""
        timing, now_s, first = self.timing, self._now_s, self.state is State.START
        if self.origin is None and since_s >= timing.origin_s:
            self.origin = self.place
        if self.origin is None or since_s < (timing.good_s if first else timing.back_s):
            return
        if first:
            self._error += self._innovation(fix) * (1.0 if timing.freezes else timing.follows)
            self._stir()
        else:
            self._jump(self._innovation(fix))
            self.returned_s = now_s
        self._drift, self.used_s, self._waits_s = None, now_s, None
        self._be(State.GOOD)
        self._tell(0.0)

    def _be(self, state: State) -> None:
        self.state = state
        self.flags = self.timing.flags[state]
        self.aiding = state is not State.STOPPED
        frozen = self.timing.freezes and not self.aiding
        self.frozen_altitude_amsl_m = self.altitude_amsl_m if frozen else None

    def shift(self, north_m: float, east_m: float) -> None:
        """A fault: the position jumps by this much at once."""
        self._error += complex(north_m, east_m)
        if self.timing.freezes:
            self._bias += complex(north_m, east_m)
