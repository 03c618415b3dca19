"""PX4's multicopter position controller: P on position, PID on velocity, no look-ahead.

PositionControl.cpp in metres and seconds, north, east, down; NaN: not given.  Velocity feed-forward
is cut, position first, at MPC_XY_VEL_MAX; the wanted acceleration at the tilt limit.
"""

import math
from typing import Final, final

from vehicle_sim.autopilots.px4.setpoints import Vector
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.parameters import Parameters

_ATTITUDE_S: Final = 0.15
"""Wanted to actual tilt (1 / MC_ROLL_P), on top of Copter's own response."""


@final
class Gains:
    """The parameters that the controller reads, as they stand."""

    def __init__(self, parameters: Parameters) -> None:
        self.position = parameters["MPC_XY_P"]
        self.position_down = parameters["MPC_Z_P"]
        self.proportional = max(parameters["MPC_XY_VEL_P_ACC"], 0.1)
        self.integral = parameters["MPC_XY_VEL_I_ACC"]
        self.derivative = parameters["MPC_XY_VEL_D_ACC"]
        self.proportional_down = max(parameters["MPC_Z_VEL_P_ACC"], 0.1)
        self.integral_down = parameters["MPC_Z_VEL_I_ACC"]
        self.horizontal_m_s = parameters["MPC_XY_VEL_MAX"]
        self.vertical_up_m_s = parameters["MPC_Z_VEL_MAX_UP"]
        self.vertical_down_m_s = parameters["MPC_Z_VEL_MAX_DN"]
        tilt_deg = min(max(parameters["MPC_TILTMAX_AIR"], 5.0), 85.0)
        self.tilt_m_s2 = GRAVITY_M_S2 * math.tan(math.radians(tilt_deg))
        hover = min(max(parameters["MPC_THR_HOVER"], 0.1), 0.8)
        self.most_up_m_s2 = GRAVITY_M_S2 * (parameters["MPC_THR_MAX"] / hover - 1.0)
        self.most_down_m_s2 = GRAVITY_M_S2 * (1.0 - parameters["MPC_THR_MIN"] / hover)


@final
class PositionControl:
    """The controller and its integrals.  Mutable."""

    def __init__(self, gains: Gains) -> None:
        self.gains = gains
        self._lean_n = self._lean_e = 0.0
        self.integral = [0.0, 0.0, 0.0]
        self.velocity: Vector = (0.0, 0.0, 0.0)
        """What it wants, as POSITION_TARGET_LOCAL_NED tells it."""
        self.acceleration: Vector = (0.0, 0.0, 0.0)

    def reset(self, down_m_s2: float = 0.0) -> None:
        """Start afresh, with this much of a downward push left over."""
        self._lean_n = self._lean_e = 0.0
        self.integral = [0.0, 0.0, down_m_s2]

    def level(self) -> None:
        """Forget what held against the air: on the ground."""
        self.integral[0] = self.integral[1] = 0.0

    def run(
        self,
        wanted: tuple[Vector, Vector, Vector],
        state: tuple[Vector, Vector, Vector],
        most_up_m_s: float,
        dt_s: float,
    ) -> Vector:
        """Acceleration of the thrust north, east and down: wanted and actual state (p, v, a)."""
        gains, integral = self.gains, self.integral
        (p_n, p_e, p_d), (v_n, v_e, v_d), (f_n, f_e, f_d) = wanted
        (x_n, x_e, x_d), (u_n, u_e, u_d), (a_n, a_e, _) = state
        s_n, s_e = self._velocity(p_n - x_n, p_e - x_e, v_n, v_e)
        s_d = (p_d - x_d) * gains.position_down
        if s_d != s_d:  # the one that is given, or both
            s_d = v_d
        elif v_d == v_d:
            s_d += v_d
        s_d = min(max(s_d, -most_up_m_s), gains.vertical_down_m_s)

        w_n = w_e = 0.0
        e_n = s_n - u_n
        e_e = s_e - u_e
        gain, damping = gains.proportional, gains.derivative
        if e_n == e_n and e_e == e_e:
            w_n = gain * e_n + integral[0] - damping * a_n
            w_e = gain * e_e + integral[1] - damping * a_e
        else:  # no horizontal control: upright, and what held against the air is forgotten
            e_n = e_e = integral[0] = integral[1] = 0.0
        w_n += f_n if f_n == f_n else 0.0
        w_e += f_e if f_e == f_e else 0.0
        size = math.hypot(w_n, w_e)
        if size > gains.tilt_m_s2:
            # Anti-windup: the error less what the tilt limit does not let through.
            share = gains.tilt_m_s2 / size
            windup = 2.0 / gain
            e_n -= windup * w_n * (1.0 - share)
            e_e -= windup * w_e * (1.0 - share)
            w_n *= share
            w_e *= share
        integral[0] += gains.integral * e_n * dt_s
        integral[1] += gains.integral * e_e * dt_s

        w_d = f_d if f_d == f_d else 0.0
        e_d = s_d - u_d
        if e_d == e_d:
            w_d += gains.proportional_down * e_d + integral[2]
            if -gains.most_up_m_s2 < w_d < gains.most_down_m_s2 or w_d * e_d < 0.0:
                down = integral[2] + gains.integral_down * e_d * dt_s
                integral[2] = min(max(down, -GRAVITY_M_S2), GRAVITY_M_S2)
        w_d = min(max(w_d, -gains.most_up_m_s2), gains.most_down_m_s2)

        self.velocity = (s_n, s_e, s_d)
        self.acceleration = (w_n, w_e, w_d)
        share = dt_s / (_ATTITUDE_S + dt_s)
        self._lean_n += (w_n - self._lean_n) * share
        self._lean_e += (w_e - self._lean_e) * share
        return self._lean_n, self._lean_e, w_d

    def _velocity(self, off_n: float, off_e: float, v_n: float, v_e: float) -> tuple[float, float]:
        """Wanted horizontal velocity: the position's share first, then the feed-forward."""
        gains = self.gains
        c_n, c_e = off_n * gains.position, off_e * gains.position
        most = gains.horizontal_m_s
        if c_n != c_n:
            size = math.hypot(v_n, v_e)
            return (v_n, v_e) if not size > most else (v_n * most / size, v_e * most / size)
        size = math.hypot(c_n, c_e)
        if size >= most:
            return c_n * most / size, c_e * most / size
        if v_n != v_n or v_n == v_e == 0.0:
            return c_n, c_e
        s_n, s_e = c_n + v_n, c_e + v_e
        if math.hypot(s_n, s_e) <= most:
            return s_n, s_e
        # As much of the feed-forward as reaches the limit: |c + k v| = most.
        speed = math.hypot(v_n, v_e)
        d_n, d_e = v_n / speed, v_e / speed
        along = d_n * c_n + d_e * c_e
        reach = math.sqrt(max(along * along - (size * size - most * most), 0.0)) - along
        return c_n + d_n * reach, c_e + d_e * reach


# --- The smooth motion of PX4's multicopters: a point that runs ahead within acceleration and jerk
# The position controller follows it.  MPC_ACC_HOR 3 and MPC_JERK_AUTO 4 stop 12 m/s in 31 m
# (px4.md 4).  In the manual modes it comes to rest (px4.md 6).

_STANDS_M_S: Final = 0.05


def braking_speed_m_s(distance_m: float, acceleration_m_s2: float, jerk_m_s3: float) -> float:
    """Speed from which this distance suffices to stop (PX4's computeMaxSpeedFromDistance)."""
    lost = 4.0 * acceleration_m_s2 * acceleration_m_s2 / jerk_m_s3
    return 0.5 * (math.sqrt(lost * lost + 8.0 * acceleration_m_s2 * distance_m) - lost)


@final
class Trajectory:
    """Position, velocity and acceleration of the point: north, east, down.  Mutable."""

    def __init__(self) -> None:
        self.p = [0.0, 0.0, 0.0]
        self.v = [0.0, 0.0, 0.0]
        self.a = [0.0, 0.0, 0.0]
        self.most, self.most_up, self.jerk = 3.0, 4.0, 4.0

    def limit(self, parameters: Parameters, *, manual: bool) -> None:
        """Take the limits of the AUTO modes, or of the manual ones."""
        self.most = max(parameters["MPC_ACC_HOR_MAX" if manual else "MPC_ACC_HOR"], 0.5)
        self.most_up = max(parameters["MPC_ACC_UP_MAX"], 0.5)
        self.jerk = max(parameters["MPC_JERK_MAX" if manual else "MPC_JERK_AUTO"], 0.5)

    def start(self, position: Vector, velocity: Vector) -> None:
        """From what the vehicle does."""
        self.p, self.v, self.a = list(position), list(velocity), [0.0, 0.0, 0.0]

    def towards_speed(
        self, north_m_s: float, east_m_s: float, down_m_s: float, dt_s: float
    ) -> None:
        """One step towards this velocity."""
        p, v, a, most, step = self.p, self.v, self.a, self.most, self.jerk * dt_s
        gain = 1.2 * self.jerk / most
        w_n, w_e = gain * (north_m_s - v[0]), gain * (east_m_s - v[1])
        size = math.hypot(w_n, w_e)
        if size > most:
            w_n *= most / size
            w_e *= most / size
        d_n, d_e = w_n - a[0], w_e - a[1]
        size = math.hypot(d_n, d_e)
        if size > step:
            d_n *= step / size
            d_e *= step / size
        a[0] += d_n
        a[1] += d_e
        w_d = min(max(gain * (down_m_s - v[2]), -self.most_up), most)
        a[2] += min(max(w_d - a[2], -step), step)
        for axis in (0, 1, 2):
            v[axis] += a[axis] * dt_s
            p[axis] += v[axis] * dt_s

    def to_goal(
        self,
        goal: Vector,
        speeds: tuple[float, float, float],
        dt_s: float,
        down_m_s: float = math.nan,
    ) -> None:
        """One step towards a place; speeds: cruise, up and down in m/s.  NaN axes: come to rest.

        down_m_s: descend at this speed, regardless of the goal's height.
        """
        p = self.p
        north_m, east_m, down_m = goal[0] - p[0], goal[1] - p[1], goal[2] - p[2]
        v_n = v_e = v_d = 0.0
        if north_m == north_m:
            away_m = math.hypot(north_m, east_m)
            speed = min(speeds[0], braking_speed_m_s(away_m, 0.7 * self.most, self.jerk))
            if away_m > 1e-6:
                v_n, v_e = north_m / away_m * speed, east_m / away_m * speed
        if down_m_s == down_m_s:
            v_d = down_m_s
        elif down_m == down_m:
            most = 0.7 * self.most
            speed = braking_speed_m_s(abs(down_m), most, self.jerk)
            v_d = min(speed, speeds[2]) if down_m > 0.0 else -min(speed, speeds[1])
        self.towards_speed(v_n, v_e, v_d, dt_s)

    def wanted(self) -> tuple[Vector, Vector, Vector]:
        """Position, velocity and acceleration, for the position controller."""
        p, v, a = self.p, self.v, self.a
        return (p[0], p[1], p[2]), (v[0], v[1], v[2]), (a[0], a[1], a[2])

    @property
    def stands(self) -> bool:
        """The point has come to rest horizontally."""
        return math.hypot(self.v[0], self.v[1]) < _STANDS_M_S


Wanted = tuple[Vector, Vector, Vector]
"""Position, velocity and acceleration; NaN: not given."""
