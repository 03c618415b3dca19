"""Position and Altitude mode of PX4's multicopters: what the sticks ask for (px4.md 6)."""

import math
from typing import Final

from vehicle_sim.autopilots import Sticks
from vehicle_sim.autopilots.px4.setpoints import NOTHING, Vector
from vehicle_sim.autopilots.px4.trajectory import Trajectory
from vehicle_sim.dynamics.copter import GRAVITY_M_S2
from vehicle_sim.parameters import Parameters

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
