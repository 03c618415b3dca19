"""ArduCopter's position controller: what is wanted, shaped by jerk and acceleration, then followed.

Two halves, as in AC_PosControl.  The first moves a *desired* position, velocity and acceleration
towards what is asked for, with corrections limited by WPNAV_ACCEL and PSC_JERK_XY; velocity and
acceleration that are asked for come on top and are not limited.  The second makes the vehicle
follow the desired ones: position error to velocity, velocity error through a PID to acceleration,
which the lean angle limits.  Drag is what the PID's integrator has to learn: in a turn it is late,
and that is the error off the path of ardupilot.md 3.

Horizontal vectors are north + east j, places are degrees so.
Source: AP_Math/control.cpp and AC_PosControl.cpp of 4.7.0-dev, in metres.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

from vehicle_sim.autopilot.values import Estimate
from vehicle_sim.geodesy import degrees_east, metres_per_degree

POSITION_P, VELOCITY_P, VELOCITY_I, VELOCITY_D = 1.0, 2.0, 1.0, 0.25
"""PSC_POSXY_P, PSC_VELXY_P, _I, _D."""
INTEGRATOR_M_S2: Final = 10.0
"""PSC_VELXY_IMAX."""
FILTER_S: Final = 1.0 / (math.tau * 5.0)
"""PSC_VELXY_FLTE and _FLTD, 5 Hz."""
LEAN_S: Final = 0.12
"""Time constant from a commanded lean to a flown one."""
VELOCITY_UP_P: Final = 5.0
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
    jerk_up_m_s3: float
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


def bounded(value: float, least: float, most: float) -> float:
    """The value, or the limit that it is beyond."""
    return least if value < least else most if value > most else value


def dot(one: complex, other: complex) -> float:
    """The scalar product."""
    return one.real * other.real + one.imag * other.imag


def turned_first(wanted: complex, velocity: complex, most: float, across_most: float) -> complex:
    """Limit an acceleration: what turns goes before what drives or brakes."""
    speed = abs(velocity)
    if speed < 1e-3:
        return clipped(wanted, most)
    way = velocity / speed
    along = dot(wanted, way)
    across = clipped(wanted - along * way, across_most)
    room = math.sqrt(max(most * most - abs(across) ** 2, 0.0))
    return across + bounded(along, -room, room) * way


def off_deg(from_: complex, to: complex) -> complex:
    """From one place to another in degrees, the shorter way round the earth."""
    return complex(to.real - from_.real, degrees_east(from_.imag, to.imag))


@final
class Horizontal:
    """Desired place, velocity and acceleration, and the PID behind them.  Mutable."""

    tuning: Tuning

    def __init__(self, estimate: Estimate) -> None:
        self._estimate = estimate
        self.scale = (1.0, 1.0)
        """Metres of a degree, of latitude and longitude, where it flies."""
        self._lean = self._asked = 0j
        self.start()

    @property
    def here_deg(self) -> complex:
        """Where it believes to be."""
        return complex(self._estimate.latitude_deg, self._estimate.longitude_deg)

    @property
    def flown(self) -> complex:
        """Velocity over the ground."""
        return complex(self._estimate.velocity_north_m_s, self._estimate.velocity_east_m_s)

    def start(self) -> None:
        """From what the vehicle does now: the integrator takes over all of the present lean."""
        self.place_deg, self.velocity, self.acceleration = self.here_deg, self.flown, 0j
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
        """From one place to another."""
        off = off_deg(from_deg, to_deg)
        return complex(off.real * self.scale[0], off.imag * self.scale[1])

    # --- what is asked for --------------------------------------------------------------------

    def move(self, dt_s: float) -> None:
        """The desired state one step on; where the lean is at its limit it waits."""
        here_deg = self.here_deg
        self.scale = metres_per_degree(here_deg.real)
        pushed, limited = self.acceleration, self._limited
        step = self.velocity * dt_s + pushed * (0.5 * dt_s * dt_s)
        if limited:
            if dot(step, limited) > 0.0 and dot(self.metres(here_deg, self.place_deg), limited) > 0:
                step = 0j
            if dot(pushed, limited) > 0.0 and dot(self._error or 0j, limited) > 0.0:
                pushed = 0j if dot(self.velocity, limited) >= 0.0 else pushed
        self.place_deg += complex(step.real / self.scale[0], step.imag / self.scale[1])
        self.velocity += pushed * dt_s

    def towards_velocity(self, velocity: complex, feed: complex, dt_s: float) -> None:
        """Shape the acceleration so that the velocity becomes this one; `feed` comes on top."""
        most, jerk = self.tuning.acceleration_m_s2, self.tuning.jerk_m_s3
        error, wanted = velocity - self.velocity, feed
        size = abs(error)
        if size > 1e-9:
            rate = rate_for(size, jerk / most, jerk, dt_s)
            wanted += self._cornered(error * (rate / size), velocity)
        self.acceleration += clipped(wanted - self.acceleration, jerk * dt_s)

    def _cornered(self, wanted: complex, velocity: complex) -> complex:
        """Limit an acceleration so that enough is left for turning (limit_accel_corner_xy)."""
        most, speed = self.tuning.acceleration_m_s2, abs(velocity)
        along = dot(wanted, velocity) / speed if speed > 1e-6 else 0.0
        if 2.0 * along * along <= abs(wanted) ** 2:  # more across than along
            return clipped(wanted, most)
        return turned_first(wanted, velocity, most, _CORNER_SHARE * most)

    def towards_place(
        self, place_deg: complex, velocity: complex, feed: complex, speed_m_s: float, dt_s: float
    ) -> None:
        """Shape towards a place that moves like this; the way there no faster than this speed."""
        to_go = self.metres(self.place_deg, place_deg)
        away, most = abs(to_go), self.tuning.acceleration_m_s2
        if away > 1e-6:
            gain = _APPROACH * self.tuning.jerk_m_s3 / most
            rate = rate_for(away, gain, _APPROACH * most, dt_s)
            velocity += to_go * ((rate if rate < speed_m_s else speed_m_s) / away)
        self.towards_velocity(velocity, feed, dt_s)

    def push(self, acceleration: complex, dt_s: float) -> None:
        """Shape towards an acceleration alone."""
        step = acceleration - self.acceleration
        self.acceleration += clipped(step, self.tuning.jerk_m_s3 * dt_s)

    # --- following ----------------------------------------------------------------------------

    def lean(self, dt_s: float) -> complex:
        """The acceleration that the lean gives, one step on."""
        off = self.metres(self.here_deg, self.place_deg)
        away = abs(off)
        if away > 1e-9:
            off *= rate_for(away, POSITION_P, self.tuning.acceleration_m_s2, dt_s) / away
        error = off + self.velocity - self.flown
        if self._error is not None:
            blend = dt_s / (FILTER_S + dt_s)
            step = blend * (error - self._error)
            error = self._error + step
            self._derivative += blend * (step / dt_s - self._derivative)
        self._error = error
        self._integrate(VELOCITY_I * dt_s * error)
        asked = VELOCITY_P * error + self._integral + self.acceleration
        asked += VELOCITY_D * self._derivative
        self._limited = 0j
        if abs(asked) > self.tuning.lean_m_s2:
            most = self.tuning.lean_m_s2
            self._limited, asked = asked, turned_first(asked, self.velocity, most, most)
        self._asked = asked
        self._lean += dt_s / (LEAN_S + dt_s) * (asked - self._lean)
        return self._lean

    def _integrate(self, step: complex) -> None:
        grown = clipped(self._integral + step, INTEGRATOR_M_S2)
        if dot(step, self._limited) > 0.0:
            # a limited output may turn it, but not make it longer
            grown = clipped(grown, abs(self._integral))
        self._integral = grown

    def levelled(self, dt_s: float) -> complex:
        """Without a position: no lean is asked for."""
        self._lean -= dt_s / (LEAN_S + dt_s) * self._lean
        self._asked = self._lean
        return self._lean


@final
class Vertical:
    """The same upwards; heights above the sea.  Mutable."""

    tuning: Tuning

    def __init__(self, estimate: Estimate) -> None:
        self._estimate = estimate
        self.start()

    def start(self) -> None:
        """From what the vehicle does now."""
        self.altitude_amsl_m = self._estimate.altitude_amsl_m
        self.climb_m_s, self.acceleration_m_s2 = self._estimate.velocity_up_m_s, 0.0

    def towards_climb(self, climb_m_s: float, feed_m_s2: float, dt_s: float) -> None:
        """Shape towards a vertical velocity, and move the desired height."""
        most, jerk = self.tuning.acceleration_up_m_s2, self.tuning.jerk_up_m_s3
        pushed = self.acceleration_m_s2
        self.altitude_amsl_m += self.climb_m_s * dt_s + 0.5 * pushed * dt_s * dt_s
        self.climb_m_s += pushed * dt_s
        wanted = rate_for(climb_m_s - self.climb_m_s, jerk / most, jerk, dt_s)
        step = bounded(wanted, -most, most) + feed_m_s2 - pushed
        self.acceleration_m_s2 += bounded(step, -jerk * dt_s, jerk * dt_s)

    def towards_altitude(
        self,
        altitude_amsl_m: float,
        climb_m_s: float,
        feed_m_s2: float,
        speeds_m_s: Sequence[float],
        dt_s: float,
    ) -> None:
        """Shape towards a height that changes like this, no faster up and down than this."""
        most, jerk = self.tuning.acceleration_up_m_s2, self.tuning.jerk_up_m_s3
        error_m = altitude_amsl_m - self.altitude_amsl_m
        rate = rate_for(error_m, _APPROACH * jerk / most, _APPROACH * most, dt_s)
        rate = bounded(rate, -speeds_m_s[1], speeds_m_s[0])
        self.towards_climb(rate + climb_m_s, feed_m_s2, dt_s)

    def lift(self) -> float:
        """The vertical acceleration."""
        off_m = self.altitude_amsl_m - self._estimate.altitude_amsl_m
        off_m_s = off_m + self.climb_m_s - self._estimate.velocity_up_m_s
        return VELOCITY_UP_P * off_m_s + self.acceleration_m_s2
