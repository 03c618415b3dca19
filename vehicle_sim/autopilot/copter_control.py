"""ArduCopter's position controller: what is wanted, shaped by jerk and acceleration, then followed.

Two halves, as in AC_PosControl.  The first moves a *desired* position, velocity and acceleration
towards what is asked for, with corrections limited by WPNAV_ACCEL and PSC_JERK_XY; velocity and
acceleration that are asked for come on top and are not limited.  The second makes the vehicle
follow the desired ones: position error to velocity, velocity error through a PID to acceleration,
which the lean angle limits.  Drag is what the PID's integrator has to learn: in a turn it is late,
and that is the error off the path of ardupilot.md 3.

Horizontal vectors are north + east j, places are degrees so; `(one * other.conjugate()).real` is
their scalar product.
Source: AP_Math/control.cpp and AC_PosControl.cpp of 4.7.0-dev, in metres.
"""

import math
from dataclasses import dataclass
from typing import Final, final

from vehicle_sim.autopilot.estimator import Estimator
from vehicle_sim.geodesy import degrees_east, metres_per_degree

POSITION_P, VELOCITY_P, VELOCITY_I, VELOCITY_D = 1.0, 2.0, 1.0, 0.25
"""PSC_POSXY_P, PSC_VELXY_P, _I, _D."""
INTEGRATOR_M_S2: Final = 10.0
"""PSC_VELXY_IMAX."""
FILTER_S: Final = 1.0 / (math.tau * 5.0)
"""PSC_VELXY_FLTE and _FLTD, 5 Hz."""
LEAN_S: Final = 0.12
"""Time constant from a commanded lean to a flown one."""
VELOCITY_UP_P, JERK_UP_M_S3 = 5.0, 5.0
"""The latter is PSC_JERK_Z."""
_CORNER_SHARE: Final = 1.0 / math.sqrt(2.0)
_APPROACH: Final = 0.5
"""Share of acceleration and gain for approaching a position: leaves some for cornering."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Tuning:
    """What the parameters say, in SI units."""

    speed_m_s: float
    acceleration_m_s2: float
    jerk_m_s3: float
    speed_up_m_s: float
    speed_down_m_s: float
    acceleration_up_m_s2: float
    lean_m_s2: float
    """Horizontal acceleration at the steepest lean."""


def rate_for(error: float, gain: float, limit: float, dt_s: float) -> float:
    """Rate that corrects an error: linear when it is small, then as its slowing down permits."""
    linear = limit / (gain * gain)
    if error > linear:
        rate = math.sqrt(2.0 * limit * (error - 0.5 * linear))
    elif error < -linear:
        rate = -math.sqrt(2.0 * limit * (-error - 0.5 * linear))
    else:
        rate = error * gain
    return error / dt_s if abs(rate) * dt_s > abs(error) else rate


def clipped(vector: complex, most: float) -> complex:
    """The vector, no longer than this."""
    size = abs(vector)
    return vector if size <= most else vector * (most / size)


def turned_first(wanted: complex, velocity: complex, most: float, across_most: float) -> complex:
    """Limit an acceleration: what turns goes before what drives or brakes."""
    speed = abs(velocity)
    if speed < 1e-3:
        return clipped(wanted, most)
    way = velocity / speed
    along = (wanted * way.conjugate()).real
    across = clipped(wanted - along * way, across_most)
    room = math.sqrt(max(most * most - abs(across) ** 2, 0.0))
    return across + min(max(along, -room), room) * way


@final
class Horizontal:
    """Desired place, velocity and acceleration, and the PID behind them.  Mutable."""

    tuning: Tuning

    def __init__(self, estimate: Estimator) -> None:
        self._estimate = estimate
        self.scale = (1.0, 1.0)
        """Metres of a degree, of latitude and longitude, where it flies."""
        self._lean = self._asked = 0j
        self.start()

    @property
    def here_deg(self) -> complex:
        """Where it believes to be."""
        return complex(self._estimate.latitude_deg, self._estimate.longitude_deg)

    def start(self) -> None:
        """From what the vehicle does now: the integrator takes over all of the present lean."""
        self.place_deg, self.velocity = self.here_deg, self._estimate.velocity_m_s
        self.acceleration = 0j
        self._integral, self._derivative, self._limited = self._asked, 0j, 0j
        self._error: complex | None = None

    def follow(self, acceleration: complex) -> None:
        """Go on from an acceleration that something else has commanded, with nothing to unlearn."""
        self.start()
        self.acceleration = self._lean = acceleration
        self._integral = 0j

    def rest(self) -> None:
        """On the ground: nothing leans."""
        self._lean = self._asked = 0j

    def metres(self, from_deg: complex, to_deg: complex) -> complex:
        """From one place to another, the shorter way round the earth."""
        east_deg = degrees_east(from_deg.imag, to_deg.imag)
        return complex((to_deg.real - from_deg.real) * self.scale[0], east_deg * self.scale[1])

    # --- what is asked for --------------------------------------------------------------------

    def move(self, dt_s: float) -> None:
        """The desired state one step on; where the lean is at its limit it waits."""
        self.scale = metres_per_degree(self._estimate.latitude_deg)
        pushed, limit = self.acceleration, self._limited.conjugate()
        step = self.velocity * dt_s + pushed * (0.5 * dt_s * dt_s)
        if limit:
            ahead = self.metres(self.here_deg, self.place_deg)
            if (step * limit).real > 0.0 and (ahead * limit).real > 0.0:
                step = 0j
            if (pushed * limit).real > 0.0 and ((self._error or 0j) * limit).real > 0.0:
                pushed = 0j if (self.velocity * limit).real >= 0.0 else pushed
        self.place_deg += complex(step.real / self.scale[0], step.imag / self.scale[1])
        self.velocity += pushed * dt_s

    def towards(
        self,
        velocity: complex,
        feed: complex,
        dt_s: float,
        place_deg: complex | None = None,
        speed_m_s: float = math.inf,
    ) -> None:
        """Shape the acceleration so that the velocity becomes this one; `feed` comes on top.

        place_deg: a place that moves like that, and the way there no faster than at speed_m_s.
        """
        most, jerk = self.tuning.acceleration_m_s2, self.tuning.jerk_m_s3
        to_go = 0j if place_deg is None else self.metres(self.place_deg, place_deg)
        away = abs(to_go)
        if away > 1e-6:
            rate = rate_for(away, _APPROACH * jerk / most, _APPROACH * most, dt_s)
            velocity += to_go * (min(rate, speed_m_s) / away)
        error, speed = velocity - self.velocity, abs(velocity)
        size = abs(error)
        if size > 1e-9:
            change = error * (rate_for(size, jerk / most, jerk, dt_s) / size)
            along = (change * velocity.conjugate()).real / speed if speed > 1e-6 else 0.0
            if 2.0 * along * along <= abs(change) ** 2:  # more across than along
                feed += clipped(change, most)
            else:  # enough is left for turning (limit_accel_corner_xy)
                feed += turned_first(change, velocity, most, _CORNER_SHARE * most)
        self.acceleration += clipped(feed - self.acceleration, jerk * dt_s)

    def push(self, acceleration: complex, dt_s: float) -> None:
        """Shape towards an acceleration alone."""
        step = acceleration - self.acceleration
        self.acceleration += clipped(step, self.tuning.jerk_m_s3 * dt_s)

    # --- following ----------------------------------------------------------------------------

    def lean(self, dt_s: float) -> complex:
        """The acceleration that the lean gives, one step on."""
        e = self._estimate
        off = self.metres(complex(e.latitude_deg, e.longitude_deg), self.place_deg)
        away = abs(off)
        if away > 1e-9:
            off *= rate_for(away, POSITION_P, self.tuning.acceleration_m_s2, dt_s) / away
        error = off + self.velocity - e.velocity_m_s
        if self._error is not None:
            blend = dt_s / (FILTER_S + dt_s)
            step = blend * (error - self._error)
            error = self._error + step
            self._derivative += blend * (step / dt_s - self._derivative)
        self._error = error
        step = VELOCITY_I * dt_s * error
        grown = clipped(self._integral + step, INTEGRATOR_M_S2)
        if (step * self._limited.conjugate()).real > 0.0:
            # a limited output may turn it, but not make it longer
            grown = clipped(grown, abs(self._integral))
        self._integral = grown
        asked = VELOCITY_P * error + self._integral + self.acceleration
        asked += VELOCITY_D * self._derivative
        self._limited = 0j
        if abs(asked) > self.tuning.lean_m_s2:
            most = self.tuning.lean_m_s2
            self._limited, asked = asked, turned_first(asked, self.velocity, most, most)
        self._asked = asked
        self._lean += dt_s / (LEAN_S + dt_s) * (asked - self._lean)
        return self._lean

    def levelled(self, dt_s: float) -> complex:
        """Without a position: no lean is asked for."""
        self._lean -= dt_s / (LEAN_S + dt_s) * self._lean
        self._asked = self._lean
        return self._lean


@final
class Vertical:
    """The same upwards; heights above the sea.  Mutable."""

    tuning: Tuning

    def __init__(self, estimate: Estimator) -> None:
        self._estimate = estimate
        self.start()

    def start(self) -> None:
        """From what the vehicle does now."""
        self.altitude_amsl_m = self._estimate.altitude_amsl_m
        self.climb_m_s, self.acceleration_m_s2 = self._estimate.velocity_up_m_s, 0.0

    def towards(
        self,
        climb_m_s: float,
        feed_m_s2: float,
        dt_s: float,
        altitude_amsl_m: float | None = None,
        up_down_m_s: tuple[float, float] = (math.inf, math.inf),
    ) -> float:
        """Shape towards a vertical velocity and move the desired height; the acceleration for it.

        altitude_amsl_m: a height that changes like that, and no faster there than up_down_m_s.
        """
        most, jerk = self.tuning.acceleration_up_m_s2, JERK_UP_M_S3
        pushed, e = self.acceleration_m_s2, self._estimate
        if altitude_amsl_m is not None:
            error_m, (up_m_s, down_m_s) = altitude_amsl_m - self.altitude_amsl_m, up_down_m_s
            rate = rate_for(error_m, _APPROACH * jerk / most, _APPROACH * most, dt_s)
            climb_m_s += min(max(rate, -down_m_s), up_m_s)
        self.altitude_amsl_m += self.climb_m_s * dt_s + 0.5 * pushed * dt_s * dt_s
        self.climb_m_s += pushed * dt_s
        wanted = rate_for(climb_m_s - self.climb_m_s, jerk / most, jerk, dt_s)
        step = min(max(wanted, -most), most) + feed_m_s2 - pushed
        self.acceleration_m_s2 += min(max(step, -jerk * dt_s), jerk * dt_s)
        off_m = self.altitude_amsl_m - e.altitude_amsl_m
        off_m_s = off_m + self.climb_m_s - e.velocity_up_m_s
        return VELOCITY_UP_P * off_m_s + self.acceleration_m_s2
