"""The smooth motion of PX4's multicopters: a point that runs ahead within acceleration and jerk.

The position controller follows it.  MPC_ACC_HOR 3 and MPC_JERK_AUTO 4 stop 12 m/s in 31 m
(px4.md 4).  In Position and Altitude mode the sticks move it (px4.md 6), in DO_ORBIT a circle,
whose limits are those of FlightTaskOrbit; how it goes round was not measured.
"""

import math
from typing import Final, NamedTuple, final

from vehicle_sim.autopilots import Sticks
from vehicle_sim.autopilots.px4.setpoints import NOTHING, Vector
from vehicle_sim.dynamics.copter import GRAVITY_M_S2
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


_NAN: Final = math.nan
_DEAD: Final = 0.1
"""MPC_HOLD_DZ: share of a stick's travel that means nothing."""

Wanted = tuple[Vector, Vector, Vector]
"""Position, velocity and acceleration; NaN: not given."""


def sink(parameters: Parameters) -> Wanted:
    """Without a pilot the flight tasks of these modes cannot run: level, and down."""
    return NOTHING, (_NAN, _NAN, parameters["MPC_LAND_SPEED"]), NOTHING


def turning_rad_s(sticks: Sticks, parameters: Parameters) -> float:
    """Rate of the heading that the yaw stick asks for."""
    return beyond(sticks.yaw) * math.radians(parameters["MPC_MAN_Y_MAX"])


def by_hand(
    sticks: Sticks,
    path: Trajectory,
    parameters: Parameters,
    heading_rad: float,
    dt_s: float,
    *,
    holds_position: bool,
) -> Wanted:
    """One step of Position mode (holds_position), or of the others as if they were Altitude."""
    lift = 2.0 * sticks.throttle - 1.0
    down_m_s = -beyond(lift) * parameters["MPC_Z_VEL_MAX_UP" if lift > 0.0 else "MPC_Z_VEL_MAX_DN"]
    ahead, aside = beyond(sticks.pitch), beyond(sticks.roll)
    sine, cosine = math.sin(heading_rad), math.cos(heading_rad)
    north, east = ahead * cosine - aside * sine, ahead * sine + aside * cosine
    if holds_position:
        most = parameters["MPC_VEL_MANUAL"]
        path.towards_speed(north * most, east * most, down_m_s, dt_s)
        return path.wanted()
    path.towards_speed(0.0, 0.0, down_m_s, dt_s)
    lean = GRAVITY_M_S2 * math.tan(math.radians(parameters["MPC_MAN_TILT_MAX"]))
    return (
        (_NAN, _NAN, path.p[2]),
        (_NAN, _NAN, path.v[2]),
        (north * lean, east * lean, path.a[2]),
    )


def beyond(stick: float) -> float:
    """A stick's deflection beyond its dead zone, -1 to 1."""
    size = abs(stick)
    return 0.0 if size < _DEAD else math.copysign(min((size - _DEAD) / (1 - _DEAD), 1.0), stick)


_RADIUS_M: Final = (1.0, 1000.0)
_MOST_M_S: Final = 10.0
_MOST_M_S2: Final = 2.0
_GAIN_1_S: Final = 0.5


@final
class Orbit(NamedTuple):
    """A circle; what is not given of its centre is NaN."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    radius_m: float = _RADIUS_M[0]
    """Negative: counter-clockwise."""
    speed_m_s: float = 1.0

    @property
    def flyable(self) -> bool:
        """Whether a multicopter takes it."""
        size_m, speed_m_s = abs(self.radius_m), abs(self.speed_m_s)
        return (
            _RADIUS_M[0] <= size_m <= _RADIUS_M[1]
            and speed_m_s <= _MOST_M_S
            and speed_m_s**2 <= _MOST_M_S2 * size_m
        )

    def velocity_m_s(self, north_m: float, east_m: float, cruise_m_s: float) -> tuple[float, float]:
        """North and east, at this place from the centre: along the circle, and towards it."""
        away_m = math.hypot(north_m, east_m)
        out_n, out_e = (north_m / away_m, east_m / away_m) if away_m > 0.1 else (1.0, 0.0)
        outward = _GAIN_1_S * (abs(self.radius_m) - away_m)
        outward = min(max(outward, -cruise_m_s), cruise_m_s)
        near = max(1.0 - abs(outward) / cruise_m_s, 0.0)
        along = math.copysign(near * abs(self.speed_m_s), self.radius_m * self.speed_m_s)
        return out_n * outward - out_e * along, out_e * outward + out_n * along


HERE: Final = Orbit(math.nan, math.nan, math.nan)
