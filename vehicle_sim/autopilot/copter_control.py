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
from typing import Final, NamedTuple, final

from vehicle_sim.autopilot.estimator import Estimator
from vehicle_sim.autopilot.values import Place
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
Order = tuple[complex, float]
"""A velocity or an acceleration (of the thrust): level, north + east j, and up."""
STILL: Final[Order] = (0j, 0.0)
Speeds = tuple[float, float, float]
"""Level, up and down, in m/s."""


@final
class Tuning(NamedTuple):
    """What the parameters say, in SI units."""

    speeds_m_s: Speeds
    acceleration_m_s2: float
    acceleration_up_m_s2: float
    jerk_m_s3: float
    lean_m_s2: float
    """Horizontal acceleration at the steepest lean."""


def rate_for(error: float, gain: float, limit: float, dt_s: float) -> float:
    """Rate that corrects an error: linear when it is small, then as its slowing down permits."""
    size, linear = abs(error), limit / (gain * gain)
    rate = size * gain if size <= linear else math.sqrt(2.0 * limit * (size - 0.5 * linear))
    return math.copysign(min(rate, size / dt_s), error)


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
class PositionControl:
    """Desired place, velocity and acceleration, and the PID behind them.  Mutable."""

    tuning: Tuning

    def __init__(self, estimate: Estimator) -> None:
        self._estimate = estimate
        self._lean = self._asked = 0j
        self.start()

    def rest(self) -> None:
        """Start from the ground, where nothing leans."""
        self._lean = self._asked = 0j
        self.start()

    def start(self) -> None:
        """From what the vehicle does now: the integrator takes over all of the present lean."""
        lean = self._lean
        self.follow(0j)
        self._lean, self._integral = lean, self._asked
        self.start_climb()

    def start_climb(self) -> None:
        """The same for the height alone."""
        self._altitude_amsl_m = self._estimate.altitude_amsl_m
        self.climb_m_s, self._acceleration_up = self._estimate.velocity_up_m_s, 0.0

    def follow(self, acceleration: complex) -> None:
        """Go on from an acceleration that something else has commanded, with nothing to unlearn."""
        e = self._estimate
        self._place_deg, self.velocity = complex(e.latitude_deg, e.longitude_deg), e.velocity_m_s
        self._acceleration = self._lean = acceleration
        self._integral, self._derivative, self._limited = 0j, 0j, 0j
        self._error: complex | None = None

    def _metres(self, from_deg: complex, to_deg: complex) -> complex:
        """From one place to another, the shorter way round the earth."""
        east_deg = degrees_east(from_deg.imag, to_deg.imag)
        return complex((to_deg.real - from_deg.real) * self._scale[0], east_deg * self._scale[1])

    def off_m(self, place: Place) -> complex:
        """From here to a place."""
        position = self._estimate
        self._scale = metres_per_degree(position.latitude_deg)
        here_deg = complex(position.latitude_deg, position.longitude_deg)
        return self._metres(here_deg, complex(place.latitude_deg, place.longitude_deg))

    # --- what is asked for --------------------------------------------------------------------

    def fly(
        self,
        moves: Order | None,
        feed: Order,
        dt_s: float,
        place: Place | None = None,
        speeds_m_s: Speeds = (math.inf,) * 3,
        *,
        paced: bool = False,
    ) -> Order:
        """One step towards this velocity (None: any); `feed`, an acceleration, comes on top.

        place: one that moves like that, and the way there no faster than at these speeds; paced:
        it does not move, and the climb and the way there are in proportion.
        """
        position = self._estimate
        self._here_deg = complex(position.latitude_deg, position.longitude_deg)
        self._scale = metres_per_degree(position.latitude_deg)
        self._move(dt_s)
        velocity, climb_m_s = moves or (self.velocity, self.climb_m_s)
        (speed_m_s, up_m_s, down_m_s), to_go, rise_m = speeds_m_s, 0j, 0.0
        if place is not None:
            to_go = self._metres(self._place_deg, complex(place.latitude_deg, place.longitude_deg))
            rise_m = place.altitude_amsl_m - self._altitude_amsl_m
        if paced:  # the slower of the two sets the pace, as kinematic_limit does
            away_m, high_m, most_up = abs(to_go), abs(rise_m), up_m_s if rise_m >= 0.0 else down_m_s
            if away_m * most_up < high_m * speed_m_s:
                speed_m_s = away_m * most_up / high_m
            elif away_m > 1e-6:
                most_up = max(high_m * speed_m_s / away_m, 1e-3)
            up_m_s, down_m_s = min(up_m_s, most_up), min(down_m_s, most_up)
        self._shape(velocity, feed[0], to_go, speed_m_s, dt_s)
        lift = self.climb(climb_m_s, dt_s, feed[1], rise_m, (up_m_s, down_m_s))
        return self._follow_desired(dt_s), lift

    def _move(self, dt_s: float) -> None:
        """The desired state one step on; where the lean is at its limit it waits."""
        pushed, limit = self._acceleration, self._limited.conjugate()
        step = self.velocity * dt_s + pushed * (0.5 * dt_s * dt_s)
        if limit:
            ahead = self._metres(self._here_deg, self._place_deg)
            if (step * limit).real > 0.0 and (ahead * limit).real > 0.0:
                step = 0j
            if (pushed * limit).real > 0.0 and ((self._error or 0j) * limit).real > 0.0:
                pushed = 0j if (self.velocity * limit).real >= 0.0 else pushed
        self._place_deg += complex(step.real / self._scale[0], step.imag / self._scale[1])
        self.velocity += pushed * dt_s

    def _shape(
        self, velocity: complex, feed: complex, to_go: complex, speed_m_s: float, dt_s: float
    ) -> None:
        """Change the acceleration so that the velocity becomes this one, and that of the way."""
        most, jerk, away = self.tuning.acceleration_m_s2, self.tuning.jerk_m_s3, abs(to_go)
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
        self._acceleration += clipped(feed - self._acceleration, jerk * dt_s)

    # --- following ----------------------------------------------------------------------------

    def _follow_desired(self, dt_s: float) -> complex:
        """The acceleration that the lean gives, one step on."""
        off = self._metres(self._here_deg, self._place_deg)
        away = abs(off)
        if away > 1e-9:
            off *= rate_for(away, POSITION_P, self.tuning.acceleration_m_s2, dt_s) / away
        error = off + self.velocity - self._estimate.velocity_m_s
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
        asked = VELOCITY_P * error + self._integral + self._acceleration
        asked += VELOCITY_D * self._derivative
        self._limited, most = 0j, self.tuning.lean_m_s2
        if abs(asked) > most:
            self._limited, asked = asked, turned_first(asked, self.velocity, most, most)
        self._asked = asked
        self._lean += dt_s / (LEAN_S + dt_s) * (asked - self._lean)
        return self._lean

    def level(self, climb_m_s: float, dt_s: float) -> Order:
        """Without a position: no lean is asked for."""
        self._lean -= dt_s / (LEAN_S + dt_s) * self._lean
        self._asked = self._lean
        return self._lean, self.climb(climb_m_s, dt_s)

    def climb(
        self,
        climb_m_s: float,
        dt_s: float,
        feed_m_s2: float = 0.0,
        rise_m: float = 0.0,
        up_down_m_s: tuple[float, float] = (math.inf, math.inf),
    ) -> float:
        """The same upwards, one step on: towards a climb, and to a height so much above."""
        most, jerk = self.tuning.acceleration_up_m_s2, JERK_UP_M_S3
        pushed, e = self._acceleration_up, self._estimate
        rate = rate_for(rise_m, _APPROACH * jerk / most, _APPROACH * most, dt_s)
        climb_m_s += min(max(rate, -up_down_m_s[1]), up_down_m_s[0])
        self._altitude_amsl_m += self.climb_m_s * dt_s + 0.5 * pushed * dt_s * dt_s
        self.climb_m_s += pushed * dt_s
        wanted = rate_for(climb_m_s - self.climb_m_s, jerk / most, jerk, dt_s)
        step = min(max(wanted, -most), most) + feed_m_s2 - pushed
        self._acceleration_up += min(max(step, -jerk * dt_s), jerk * dt_s)
        off_m = self._altitude_amsl_m - e.altitude_amsl_m
        off_m_s = off_m + self.climb_m_s - e.velocity_up_m_s
        return VELOCITY_UP_P * off_m_s + self._acceleration_up
