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
from vehicle_sim.geodesy import around, degrees_east, metres_per_degree

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


def clipped(north: float, east: float, most: float) -> tuple[float, float]:
    """The vector, no longer than this."""
    square = north * north + east * east
    if square <= most * most:
        return north, east
    share = most / math.sqrt(square)
    return north * share, east * share


@final
class PositionControl:
    """Desired state and the controllers behind it.  Mutable, plain floats: the inner loop."""

    def __init__(self, copter: Copter, estimate: Estimate, tuning: Tuning) -> None:
        self.copter = copter
        self.estimate = estimate
        self.tuning = tuning
        self._metres_north = self._metres_east = 1.0
        self._lean_north = self._lean_east = 0.0
        self._target_north = self._target_east = 0.0
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
        self.velocity_north, self.velocity_east = e.velocity_north_m_s, e.velocity_east_m_s
        self.acceleration_north = self.acceleration_east = 0.0
        self._integral_north, self._integral_east = self._target_north, self._target_east
        self._derivative_north = self._derivative_east = 0.0
        self._resets = True
        self._error_north = self._error_east = 0.0
        self._limited_north = self._limited_east = 0.0

    def start_vertical(self) -> None:
        """The vertical half."""
        self.altitude_amsl_m = self.estimate.altitude_amsl_m
        self.velocity_up = self.estimate.velocity_up_m_s
        self.acceleration_up = 0.0

    def follow(self, a_north: float, a_east: float) -> None:
        """Go on from an acceleration that something else has commanded, with nothing to unlearn."""
        self.start_level()
        self.acceleration_north, self.acceleration_east = a_north, a_east
        self._lean_north, self._lean_east = a_north, a_east
        self._integral_north = self._integral_east = 0.0

    def rest(self) -> None:
        """On the ground: nothing leans, nothing is remembered."""
        self._lean_north = self._lean_east = self._target_north = self._target_east = 0.0
        self.start_level()
        self.start_vertical()

    # --- what is asked for -------------------------------------------------------------------

    def moved(self, dt_s: float) -> None:
        """The desired state one step on."""
        estimate = self.estimate
        metres_north, metres_east = metres_per_degree(estimate.latitude_deg)
        self._metres_north, self._metres_east = metres_north, metres_east
        half = 0.5 * dt_s * dt_s
        a_n, a_e = self.acceleration_north, self.acceleration_east
        move_n = self.velocity_north * dt_s + a_n * half
        move_e = self.velocity_east * dt_s + a_e * half
        limited_n, limited_e = self._limited_north, self._limited_east
        if limited_n or limited_e:
            error_n = (self.latitude_deg - estimate.latitude_deg) * metres_north
            error_e = degrees_east(estimate.longitude_deg, self.longitude_deg) * metres_east
            if (
                move_n * limited_n + move_e * limited_e > 0.0
                and error_n * limited_n + error_e * limited_e > 0.0
            ):
                move_n = move_e = 0.0
            if (
                a_n * limited_n + a_e * limited_e > 0.0
                and self._error_north * limited_n + self._error_east * limited_e > 0.0
                and self.velocity_north * limited_n + self.velocity_east * limited_e >= 0.0
            ):
                a_n = a_e = 0.0
        self.latitude_deg += move_n / metres_north
        self.longitude_deg = around(self.longitude_deg + move_e / metres_east)
        self.velocity_north += a_n * dt_s
        self.velocity_east += a_e * dt_s

    def towards_velocity(
        self, north: float, east: float, a_north: float, a_east: float, dt_s: float
    ) -> None:
        """Shape the desired acceleration so that the desired velocity becomes this one."""
        tuning = self.tuning
        most, jerk = tuning.acceleration_m_s2, tuning.jerk_m_s3
        error_n, error_e = north - self.velocity_north, east - self.velocity_east
        size = math.sqrt(error_n * error_n + error_e * error_e)
        if size > 1e-9:
            share = sqrt_controller(size, jerk / most, jerk, dt_s) / size
            wanted_n, wanted_e = self._cornered(error_n * share, error_e * share, north, east, most)
        else:
            wanted_n = wanted_e = 0.0
        step_n = wanted_n + a_north - self.acceleration_north
        step_e = wanted_e + a_east - self.acceleration_east
        step_n, step_e = clipped(step_n, step_e, jerk * dt_s)
        self.acceleration_north += step_n
        self.acceleration_east += step_e

    def _cornered(
        self, north: float, east: float, way_n: float, way_e: float, most: float
    ) -> tuple[float, float]:
        """Limit an acceleration so that enough is left for turning (limit_accel_corner_xy)."""
        speed = math.sqrt(way_n * way_n + way_e * way_e)
        if speed < 1e-6:
            return clipped(north, east, most)
        way_n, way_e = way_n / speed, way_e / speed
        along = north * way_n + east * way_e
        across_n, across_e = north - along * way_n, east - along * way_e
        square = across_n * across_n + across_e * across_e
        if along * along <= square:
            return clipped(north, east, most)
        across_n, across_e = clipped(across_n, across_e, CORNER_SHARE * most)
        square = across_n * across_n + across_e * across_e
        room = math.sqrt(max(most * most - square, 0.0))
        along = -room if along < -room else room if along > room else along
        return across_n + along * way_n, across_e + along * way_e

    def towards_place(
        self,
        latitude_deg: float,
        longitude_deg: float,
        velocity: tuple[float, float],
        acceleration: tuple[float, float],
        speed_m_s: float,
        dt_s: float,
    ) -> None:
        """Shape towards a place that moves like this; the way there no faster than this speed."""
        tuning = self.tuning
        north_m = (latitude_deg - self.latitude_deg) * self._metres_north
        east_m = degrees_east(self.longitude_deg, longitude_deg) * self._metres_east
        distance_m = math.sqrt(north_m * north_m + east_m * east_m)
        v_n, v_e = velocity
        if distance_m > 1e-6:
            most = tuning.acceleration_m_s2
            gain = _TIME_CONSTANT_SHARE * tuning.jerk_m_s3 / most
            speed = sqrt_controller(distance_m, gain, _TIME_CONSTANT_SHARE * most, dt_s)
            share = (speed if speed < speed_m_s else speed_m_s) / distance_m
            v_n += north_m * share
            v_e += east_m * share
        self.towards_velocity(v_n, v_e, acceleration[0], acceleration[1], dt_s)

    def fly_to(
        self, latitude_deg: float, longitude_deg: float, altitude_amsl_m: float, dt_s: float
    ) -> None:
        """Steer for a place that does not move: the climb and the way there in proportion."""
        north_m = (latitude_deg - self.latitude_deg) * self._metres_north
        east_m = degrees_east(self.longitude_deg, longitude_deg) * self._metres_east
        level_m = math.sqrt(north_m * north_m + east_m * east_m)
        up_m = altitude_amsl_m - self.altitude_amsl_m
        speed_m_s, most_up = self.speed_m_s, self.speed_up_m_s
        if up_m < 0.0:
            most_up = self.speed_down_m_s
        up_m = abs(up_m)
        # the slower of the two sets the pace, as kinematic_limit does
        if level_m * most_up < up_m * speed_m_s:
            speed_m_s = level_m * most_up / up_m
        elif level_m > 1e-6:
            most_up = max(up_m * speed_m_s / level_m, 1e-3)
        self.towards_place(latitude_deg, longitude_deg, (0.0, 0.0), (0.0, 0.0), speed_m_s, dt_s)
        up, down = self.speed_up_m_s, self.speed_down_m_s
        self.speed_up_m_s, self.speed_down_m_s = min(up, most_up), min(down, most_up)
        self.towards_altitude(altitude_amsl_m, 0.0, 0.0, dt_s)
        self.speed_up_m_s, self.speed_down_m_s = up, down

    def towards_climb(self, up_m_s: float, a_up: float, dt_s: float) -> None:
        """Shape towards a vertical velocity, and move the desired height."""
        tuning = self.tuning
        most, jerk = tuning.acceleration_up_m_s2, tuning.jerk_up_m_s3
        self.altitude_amsl_m += self.velocity_up * dt_s + 0.5 * self.acceleration_up * dt_s * dt_s
        self.velocity_up += self.acceleration_up * dt_s
        wanted = sqrt_controller(up_m_s - self.velocity_up, jerk / most, jerk, dt_s)
        wanted = -most if wanted < -most else most if wanted > most else wanted
        step, most = wanted + a_up - self.acceleration_up, jerk * dt_s
        self.acceleration_up += -most if step < -most else most if step > most else step

    def towards_altitude(
        self, altitude_amsl_m: float, up_m_s: float, a_up: float, dt_s: float
    ) -> None:
        """Shape towards a height that changes like this."""
        most, jerk = self.tuning.acceleration_up_m_s2, self.tuning.jerk_up_m_s3
        error_m = altitude_amsl_m - self.altitude_amsl_m
        share = _TIME_CONSTANT_SHARE
        rate = sqrt_controller(error_m, share * jerk / most, share * most, dt_s)
        down, up = -self.speed_down_m_s, self.speed_up_m_s
        rate = down if rate < down else rate
        rate = up if rate > up else rate
        self.towards_climb(rate + up_m_s, a_up, dt_s)

    # --- following ----------------------------------------------------------------------------

    def wanted(self, dt_s: float) -> Vector:
        """Acceleration north, east and up that lean and thrust give, one step on."""
        e, most = self.estimate, self.tuning.lean_m_s2
        error_n = (self.latitude_deg - e.latitude_deg) * self._metres_north
        error_e = degrees_east(e.longitude_deg, self.longitude_deg) * self._metres_east
        size = math.sqrt(error_n * error_n + error_e * error_e)
        if size > 1e-9:
            accel = self.tuning.acceleration_m_s2
            share = sqrt_controller(size, POSITION_P, accel, dt_s) / size
            error_n, error_e = error_n * share, error_e * share
        error_n += self.velocity_north - e.velocity_north_m_s
        error_e += self.velocity_east - e.velocity_east_m_s
        if self._resets:
            self._resets = False
            self._error_north, self._error_east = error_n, error_e
        else:
            blend = dt_s / (FILTER_S + dt_s)
            step_n = blend * (error_n - self._error_north)
            step_e = blend * (error_e - self._error_east)
            self._error_north = error_n = self._error_north + step_n
            self._error_east = error_e = self._error_east + step_e
            self._derivative_north += blend * (step_n / dt_s - self._derivative_north)
            self._derivative_east += blend * (step_e / dt_s - self._derivative_east)
        self._integrate(error_n, error_e, dt_s)
        a_n = VELOCITY_P * error_n + self._integral_north + self.acceleration_north
        a_e = VELOCITY_P * error_e + self._integral_east + self.acceleration_east
        a_n += VELOCITY_D * self._derivative_north
        a_e += VELOCITY_D * self._derivative_east
        square = a_n * a_n + a_e * a_e
        if square > most * most:
            self._limited_north, self._limited_east = a_n, a_e
            a_n, a_e = self._leaned(a_n, a_e, most)
        else:
            self._limited_north = self._limited_east = 0.0
        self._target_north, self._target_east = a_n, a_e
        lean = dt_s / (LEAN_S + dt_s)
        self._lean_north += lean * (a_n - self._lean_north)
        self._lean_east += lean * (a_e - self._lean_east)
        return self._lean_north, self._lean_east, self.wanted_up()

    def _leaned(self, north: float, east: float, most: float) -> tuple[float, float]:
        """Limit an acceleration by the lean: what turns goes before what drives or brakes."""
        v_n, v_e = self.velocity_north, self.velocity_east
        speed = math.sqrt(v_n * v_n + v_e * v_e)
        if speed < 1e-3:
            return clipped(north, east, most)
        v_n, v_e = v_n / speed, v_e / speed
        along = north * v_n + east * v_e
        across_n, across_e = north - along * v_n, east - along * v_e
        square = across_n * across_n + across_e * across_e
        if square >= most * most:
            share = most / math.sqrt(square)
            return across_n * share, across_e * share
        room = math.sqrt(most * most - square)
        along = min(max(along, -room), room)
        return across_n + along * v_n, across_e + along * v_e

    def _integrate(self, error_n: float, error_e: float, dt_s: float) -> None:
        before_n, before_e = self._integral_north, self._integral_east
        step_n, step_e = VELOCITY_I * error_n * dt_s, VELOCITY_I * error_e * dt_s
        i_n, i_e = clipped(before_n + step_n, before_e + step_e, INTEGRATOR_M_S2)
        if step_n * self._limited_north + step_e * self._limited_east > 0.0:
            # a limited output may turn it, but not make it longer
            i_n, i_e = clipped(i_n, i_e, math.sqrt(before_n * before_n + before_e * before_e))
        self._integral_north, self._integral_east = i_n, i_e

    def levelled(self, dt_s: float) -> Vector:
        """Without a position: no lean is asked for."""
        lean = dt_s / (LEAN_S + dt_s)
        self._lean_north -= lean * self._lean_north
        self._lean_east -= lean * self._lean_east
        self._target_north, self._target_east = self._lean_north, self._lean_east
        return self._lean_north, self._lean_east, self.wanted_up()

    def wanted_up(self) -> float:
        """Vertical acceleration."""
        e = self.estimate
        error_m = self.altitude_amsl_m - e.altitude_amsl_m
        error_m_s = error_m + self.velocity_up - e.velocity_up_m_s
        return VELOCITY_UP_P * error_m_s + self.acceleration_up
