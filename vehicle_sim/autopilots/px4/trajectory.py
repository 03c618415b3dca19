"""The smooth motion of PX4's AUTO modes: a point that runs ahead within acceleration and jerk.

The position controller follows it.  MPC_ACC_HOR 3 and MPC_JERK_AUTO 4 stop 12 m/s in 31 m
(px4.md 4).
"""

import math
from typing import Final, final

from vehicle_sim.autopilots.px4.setpoints import Vector
from vehicle_sim.parameters import Parameters

_STANDS_M_S: Final = 0.05


def braking_speed_m_s(distance_m: float, acceleration_m_s2: float, jerk_m_s3: float) -> float:
    """Speed from which this distance suffices to stop (PX4's computeMaxSpeedFromDistance)."""
    lost = 4.0 * acceleration_m_s2 * acceleration_m_s2 / jerk_m_s3
    return 0.5 * (math.sqrt(lost * lost + 8.0 * acceleration_m_s2 * distance_m) - lost)


def stopping_point(position: Vector, velocity: Vector, parameters: Parameters) -> Vector:
    """Where braking will end: the navigator holds there (preproject_stop_point)."""
    braking = max(parameters["MPC_ACC_HOR"], 0.5)
    jerk = max(parameters["MPC_JERK_AUTO"], 0.5)
    seconds = math.hypot(velocity[0], velocity[1]) / (2.0 * braking) + braking / jerk
    return position[0] + velocity[0] * seconds, position[1] + velocity[1] * seconds, position[2]


@final
class Trajectory:
    """Position, velocity and acceleration of the point: north, east, down.  Mutable."""

    def __init__(self) -> None:
        self.p = [0.0, 0.0, 0.0]
        self.v = [0.0, 0.0, 0.0]
        self.a = [0.0, 0.0, 0.0]
        self.most, self.most_up, self.jerk = 3.0, 4.0, 4.0

    def limit(self, parameters: Parameters, *, by_hand: bool) -> None:
        """Take the limits of the AUTO modes, or of the sticks."""
        self.most = max(parameters["MPC_ACC_HOR_MAX" if by_hand else "MPC_ACC_HOR"], 0.5)
        self.most_up = max(parameters["MPC_ACC_UP_MAX"], 0.5)
        self.jerk = max(parameters["MPC_JERK_MAX" if by_hand else "MPC_JERK_AUTO"], 0.5)

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

        down_m_s: go down this fast, whatever the goal's height is.
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
