"""ArduCopter's position controller: what is wanted, shaped by jerk and acceleration, then followed.

Two halves, as in AC_PosControl.  The first moves a *desired* position, velocity and acceleration
towards what is asked for, with corrections limited by WPNAV_ACCEL and PSC_JERK_XY; velocity and
acceleration that are asked for come on top and are not limited.  The second makes the vehicle
follow the desired ones: position error to velocity, velocity error through a PID to acceleration,
which the lean angle limits.  Drag is what the PID's integrator has to learn: in a turn it is late,
and that is the error off the path of ardupilot.md 3.

Source: AP_Math/control.cpp and AC_PosControl.cpp of 4.7.0-dev, in metres.
"""

import math
from dataclasses import dataclass
from typing import final

from vehicle_sim.autopilots import Estimate
from vehicle_sim.autopilots.ardupilot.flat_earth import Vector
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.geodesy import metres_per_degree

POSITION_P, VELOCITY_P, VELOCITY_I, VELOCITY_D = 1.0, 2.0, 1.0, 0.25
"""PSC_POSXY_P, PSC_VELXY_P, _I, _D."""
INTEGRATOR_M_S2 = 10.0
"""PSC_VELXY_IMAX."""
FILTER_S = 1.0 / (math.tau * 5.0)
"""PSC_VELXY_FLTE and _FLTD, 5 Hz."""
LEAN_S = 0.12
"""Time constant from a commanded lean to a flown one."""
VELOCITY_UP_P = 5.0
CORNER_SHARE = 1.0 / math.sqrt(2.0)
_TIME_CONSTANT_SHARE = 0.5
"""Of acceleration and gain, for approaching a position: leaves some for cornering."""


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


def sqrt_controller(error: float, gain: float, limit: float, dt_s: float) -> float:
    """Rate that corrects an error: linear when it is small, then as its slowing down permits."""
    linear = limit / (gain * gain)
    if error > linear:
        rate = math.sqrt(2.0 * limit * (error - 0.5 * linear))
    elif error < -linear:
        rate = -math.sqrt(2.0 * limit * (-error - 0.5 * linear))
    else:
        rate = error * gain
    if abs(rate) * dt_s > abs(error):
        return error / dt_s
    return rate


def length(vector: complex) -> float:
    """Of a horizontal vector, north + east j."""
    north, east = vector.real, vector.imag
    return math.sqrt(north * north + east * east)


def dot(one: complex, other: complex) -> float:
    """Inner product."""
    return one.real * other.real + one.imag * other.imag


def clipped(vector: complex, most: float) -> complex:
    """The vector, no longer than this."""
    north, east = vector.real, vector.imag
    square = north * north + east * east
    return vector if square <= most * most else vector * (most / math.sqrt(square))


@final
class PositionControl:
    """Desired state and the controllers behind it.  Horizontal vectors are north + east j."""

    def __init__(self, copter: Copter, estimate: Estimate, tuning: Tuning) -> None:
        self.copter = copter
        self.estimate = estimate
        self.tuning = tuning
        self._metres_north = self._metres_east = 1.0
        self._lean = self._target = 0j
        self.start()

    def start(self) -> None:
        """Begin from what the vehicle does now, with the parameters' speeds."""
        tuning = self.tuning
        self.speed_m_s = tuning.speed_m_s
        self.speed_up_m_s, self.speed_down_m_s = tuning.speed_up_m_s, tuning.speed_down_m_s
        self.start_level()
        self.start_vertical()

    def start_level(self) -> None:
        """The horizontal half: the integrator takes over all of the present lean."""
        e = self.estimate
        self.latitude_deg, self.longitude_deg = e.latitude_deg, e.longitude_deg
        self.velocity = complex(e.velocity_north_m_s, e.velocity_east_m_s)
        self.acceleration = 0j
        self._integral = self._target
        self._derivative = self._error = self._limited = 0j
        self._resets = True

    def start_vertical(self) -> None:
        """The vertical half."""
        self.altitude_amsl_m = self.estimate.altitude_amsl_m
        self.velocity_up = self.estimate.velocity_up_m_s
        self.acceleration_up = 0.0

    def follow(self, acceleration: complex) -> None:
        """Go on from an acceleration that something else has commanded, with nothing to unlearn."""
        self.start_level()
        self.acceleration = self._lean = acceleration
        self._integral = 0j

    def rest(self) -> None:
        """On the ground: nothing leans, nothing is remembered."""
        self._lean = self._target = 0j
        self.start_level()
        self.start_vertical()

    # --- what is asked for -------------------------------------------------------------------

    def away_m(self, latitude_deg: float, longitude_deg: float) -> complex:
        """From the desired position to there."""
        return complex(
            (latitude_deg - self.latitude_deg) * self._metres_north,
            (longitude_deg - self.longitude_deg) * self._metres_east,
        )

    def _ahead_m(self) -> complex:
        """From the vehicle to the desired position."""
        e = self.estimate
        return complex(
            (self.latitude_deg - e.latitude_deg) * self._metres_north,
            (self.longitude_deg - e.longitude_deg) * self._metres_east,
        )

    def moved(self, dt_s: float) -> None:
        """The desired state one step on."""
        metres_north, metres_east = metres_per_degree(self.estimate.latitude_deg)
        self._metres_north, self._metres_east = metres_north, metres_east
        acceleration, limited = self.acceleration, self._limited
        move = self.velocity * dt_s + acceleration * (0.5 * dt_s * dt_s)
        if limited:
            if dot(move, limited) > 0.0 and dot(self._ahead_m(), limited) > 0.0:
                move = 0j
            if (
                dot(acceleration, limited) > 0.0
                and dot(self._error, limited) > 0.0
                and dot(self.velocity, limited) >= 0.0
            ):
                acceleration = 0j
        self.latitude_deg += move.real / metres_north
        self.longitude_deg += move.imag / metres_east
        self.velocity += acceleration * dt_s

    def towards_velocity(self, velocity: complex, acceleration: complex, dt_s: float) -> None:
        """Shape the desired acceleration so that the desired velocity becomes this one."""
        most, jerk = self.tuning.acceleration_m_s2, self.tuning.jerk_m_s3
        error, wanted = velocity - self.velocity, 0j
        size = length(error)
        if size > 1e-9:
            share = sqrt_controller(size, jerk / most, jerk, dt_s) / size
            wanted = _cornered(error * share, velocity, most)
        self.acceleration += clipped(wanted + acceleration - self.acceleration, jerk * dt_s)

    def towards_place(
        self,
        latitude_deg: float,
        longitude_deg: float,
        velocity: complex,
        acceleration: complex,
        speed_m_s: float,
        dt_s: float,
    ) -> None:
        """Shape towards a place that moves like this; the way there no faster than this speed."""
        tuning = self.tuning
        way_m = self.away_m(latitude_deg, longitude_deg)
        distance_m = length(way_m)
        if distance_m > 1e-6:
            most = tuning.acceleration_m_s2
            gain = _TIME_CONSTANT_SHARE * tuning.jerk_m_s3 / most
            speed = sqrt_controller(distance_m, gain, _TIME_CONSTANT_SHARE * most, dt_s)
            velocity += way_m * (min(speed, speed_m_s) / distance_m)
        self.towards_velocity(velocity, acceleration, dt_s)

    def towards_climb(self, up_m_s: float, a_up: float, dt_s: float) -> None:
        """Shape towards a vertical velocity, and move the desired height."""
        tuning = self.tuning
        most, jerk = tuning.acceleration_up_m_s2, tuning.jerk_up_m_s3
        self.altitude_amsl_m += self.velocity_up * dt_s + 0.5 * self.acceleration_up * dt_s * dt_s
        self.velocity_up += self.acceleration_up * dt_s
        wanted = sqrt_controller(up_m_s - self.velocity_up, jerk / most, jerk, dt_s)
        step = min(max(wanted, -most), most) + a_up - self.acceleration_up
        self.acceleration_up += min(max(step, -jerk * dt_s), jerk * dt_s)

    def towards_altitude(
        self, altitude_amsl_m: float, up_m_s: float, a_up: float, dt_s: float
    ) -> None:
        """Shape towards a height that changes like this."""
        most, jerk = self.tuning.acceleration_up_m_s2, self.tuning.jerk_up_m_s3
        error_m = altitude_amsl_m - self.altitude_amsl_m
        share = _TIME_CONSTANT_SHARE
        rate = sqrt_controller(error_m, share * jerk / most, share * most, dt_s)
        rate = min(max(rate, -self.speed_down_m_s), self.speed_up_m_s)
        self.towards_climb(rate + up_m_s, a_up, dt_s)

    # --- following ----------------------------------------------------------------------------

    def wanted(self, dt_s: float) -> Vector:
        """Acceleration north, east and up that lean and thrust give, one step on."""
        e, most = self.estimate, self.tuning.lean_m_s2
        error = self._ahead_m()
        size = length(error)
        if size > 1e-9:
            accel = self.tuning.acceleration_m_s2
            error *= sqrt_controller(size, POSITION_P, accel, dt_s) / size
        error += self.velocity - complex(e.velocity_north_m_s, e.velocity_east_m_s)
        if self._resets:
            self._resets = False
            self._error = error
        else:
            blend = dt_s / (FILTER_S + dt_s)
            step = blend * (error - self._error)
            self._error = error = self._error + step
            self._derivative += blend * (step / dt_s - self._derivative)
        step = VELOCITY_I * dt_s * error
        integral = clipped(self._integral + step, INTEGRATOR_M_S2)
        if self._limited and dot(step, self._limited) > 0.0:
            # a limited output may turn it, but not make it longer
            integral = clipped(integral, length(self._integral))
        self._integral = integral
        target = VELOCITY_P * error + integral + self.acceleration + VELOCITY_D * self._derivative
        self._limited = 0j
        if target.real * target.real + target.imag * target.imag > most * most:
            self._limited = target
            target = self._leaned(target, most)
        self._target = target
        self._lean += dt_s / (LEAN_S + dt_s) * (target - self._lean)
        return self._lean.real, self._lean.imag, self.wanted_up()

    def _leaned(self, acceleration: complex, most: float) -> complex:
        """Limit an acceleration by the lean: what turns goes before what drives or brakes."""
        speed = length(self.velocity)
        if speed < 1e-3:
            return clipped(acceleration, most)
        way = self.velocity / speed
        along = dot(acceleration, way)
        across = acceleration - along * way
        square = dot(across, across)
        if square >= most * most:
            return across * (most / math.sqrt(square))
        room = math.sqrt(most * most - square)
        return across + min(max(along, -room), room) * way

    def levelled(self, dt_s: float) -> Vector:
        """Without a position: no lean is asked for."""
        self._lean -= dt_s / (LEAN_S + dt_s) * self._lean
        self._target = self._lean
        return self._lean.real, self._lean.imag, self.wanted_up()

    def wanted_up(self) -> float:
        """Vertical acceleration."""
        e = self.estimate
        error_m = self.altitude_amsl_m - e.altitude_amsl_m
        error_m_s = error_m + self.velocity_up - e.velocity_up_m_s
        return VELOCITY_UP_P * error_m_s + self.acceleration_up


def _cornered(acceleration: complex, way: complex, most: float) -> complex:
    """Limit an acceleration so that enough is left for turning (limit_accel_corner_xy)."""
    speed = length(way)
    if speed < 1e-6:
        return clipped(acceleration, most)
    way /= speed
    along = dot(acceleration, way)
    across = acceleration - along * way
    if along * along <= dot(across, across):
        return clipped(acceleration, most)
    across = clipped(across, CORNER_SHARE * most)
    room = math.sqrt(max(most * most - dot(across, across), 0.0))
    return across + min(max(along, -room), room) * way
