"""PX4's multicopter: P on position, PID on velocity, no look-ahead; and the point of AUTO modes.

PositionControl.cpp in metres and seconds.  Horizontal vectors are north + east j, the rest points
down; NaN: not given.
"""

import math
from typing import Final, NamedTuple, final

from vehicle_sim.autopilot.copter_control import clipped
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.parameters import Parameters

_NAN: Final = math.nan
NONE: Final = complex(_NAN, _NAN)
_ATTITUDE_S: Final = 0.15  # wanted to actual tilt (1 / MC_ROLL_P), on top of Copter's own response
_ACCELERATION_UP_M_S2: Final = 4.0  # MPC_ACC_UP_MAX
_P, _P_DOWN = 0.95, 1.0
"""MPC_XY_P, MPC_Z_P."""
_GAIN, _INTEGRATES, _DAMPS = 1.8, 0.4, 0.2
"""MPC_XY_VEL_P_ACC, _I_ACC, _D_ACC."""
_GAIN_DOWN, _INTEGRATES_DOWN = 4.0, 2.0
"""MPC_Z_VEL_P_ACC, _I_ACC."""
HOVER_THROTTLE, _LEAST_THROTTLE = 0.5, 0.12
"""MPC_THR_HOVER, MPC_THR_MIN; the most is 1."""
_MOST_UP_M_S2: Final = GRAVITY_M_S2 * (1.0 / HOVER_THROTTLE - 1.0)
_MOST_DOWN_M_S2: Final = GRAVITY_M_S2 * (1.0 - _LEAST_THROTTLE / HOVER_THROTTLE)


@final
class State(NamedTuple):
    """Position, velocity and acceleration: level, and down."""

    place: complex = NONE
    down: float = _NAN
    velocity: complex = NONE
    sink: float = _NAN
    push: complex = NONE
    push_down: float = _NAN


def given(vector: complex) -> bool:
    """Whether it is there."""
    return vector == vector


@final
class Control:
    """The position controller and its integrals.  Mutable."""

    def __init__(self) -> None:
        self.velocity, self.sink, self.asked, self.asked_down = 0j, 0.0, 0j, 0.0
        """What it wants, as POSITION_TARGET_LOCAL_NED tells it."""
        self.reset()

    def read(self, parameters: Parameters) -> None:
        """Take the limits as they stand."""
        p = parameters
        self._fastest, self._fastest_down = p["MPC_XY_VEL_MAX"], p["MPC_Z_VEL_MAX_DN"]
        self.fastest_up_m_s = p["MPC_Z_VEL_MAX_UP"]
        tilt_rad = math.radians(min(max(p["MPC_TILTMAX_AIR"], 5.0), 85.0))
        self._tilt_m_s2 = GRAVITY_M_S2 * math.tan(tilt_rad)

    def reset(self, down_m_s2: float = 0.0) -> None:
        """Start afresh, with this much of a downward push left over."""
        self._lean, self.integral, self._integral_down = 0j, 0j, down_m_s2

    def run(
        self, wanted: State, flown: State, most_up_m_s: float, dt_s: float
    ) -> tuple[complex, float]:
        """Acceleration of the thrust, level and down."""
        velocity = self._wanted_velocity(wanted.place - flown.place, wanted.velocity)
        sink = (wanted.down - flown.down) * _P_DOWN
        if sink != sink:  # the one that is given, or both
            sink = wanted.sink
        elif wanted.sink == wanted.sink:
            sink += wanted.sink
        # in this order: the ramp of a take-off, which makes most_up_m_s negative, presses down
        sink = max(min(sink, self._fastest_down), -most_up_m_s)

        asked, error = 0j, velocity - flown.velocity
        if given(error):
            asked = _GAIN * error + self.integral - _DAMPS * flown.push
        else:  # no horizontal control: upright, and what held against the air is forgotten
            error = self.integral = 0j
        asked += wanted.push if given(wanted.push) else 0j
        if abs(asked) > self._tilt_m_s2:
            # anti-windup: the error less what the tilt limit does not let through
            over = asked - clipped(asked, self._tilt_m_s2)
            error, asked = error - 2.0 / _GAIN * over, asked - over
        self.integral += _INTEGRATES * dt_s * error

        drop = wanted.push_down if wanted.push_down == wanted.push_down else 0.0
        off = sink - flown.sink
        if off == off:
            drop += _GAIN_DOWN * off + self._integral_down
            if -_MOST_UP_M_S2 < drop < _MOST_DOWN_M_S2 or drop * off < 0.0:
                grown = self._integral_down + _INTEGRATES_DOWN * off * dt_s
                self._integral_down = min(max(grown, -GRAVITY_M_S2), GRAVITY_M_S2)
        drop = min(max(drop, -_MOST_UP_M_S2), _MOST_DOWN_M_S2)
        self.velocity, self.sink, self.asked, self.asked_down = velocity, sink, asked, drop
        self._lean += (asked - self._lean) * (dt_s / (_ATTITUDE_S + dt_s))
        return self._lean, drop

    def _wanted_velocity(self, off: complex, velocity: complex) -> complex:
        """The position's share first, then as much of the feed-forward as reaches the limit."""
        most, share = self._fastest, off * _P
        if not given(share):
            return clipped(velocity, most) if given(velocity) else velocity
        size = abs(share)
        if size >= most:
            return share * (most / size)
        if not given(velocity) or not velocity:
            return share
        if abs(share + velocity) <= most:
            return share + velocity
        way = velocity / abs(velocity)
        along = (way * share.conjugate()).real
        more = math.sqrt(max(along * along - size * size + most * most, 0.0)) - along
        return share + way * more


@final
class Point:
    """The point that the controller follows in AUTO modes, within acceleration and jerk.  Mutable.

    MPC_ACC_HOR 3 and MPC_JERK_AUTO 4 stop 12 m/s in 31 m (px4.md 4).
    """

    def __init__(self) -> None:
        self.at = State()

    def read(self, parameters: Parameters) -> None:
        """Take the limits as they stand."""
        self._most = max(parameters["MPC_ACC_HOR"], 0.5)
        self._jerk = max(parameters["MPC_JERK_AUTO"], 0.5)

    def start(self, flown: State) -> None:
        """From what the vehicle does."""
        self.at = flown._replace(push=0j, push_down=0.0)

    def stopping_m(self, velocity: complex) -> complex:
        """How far on it stops, as the navigator reckons it (preproject_stop_point)."""
        return velocity * (abs(velocity) / (2.0 * self._most) + self._most / self._jerk)

    def _braking_m_s(self, distance_m: float) -> float:
        """Speed from which this distance suffices to stop (PX4's computeMaxSpeedFromDistance)."""
        most = 0.7 * self._most
        lost = 4.0 * most * most / self._jerk
        return 0.5 * (math.sqrt(lost * lost + 8.0 * most * distance_m) - lost)

    def towards(
        self,
        goal: complex,
        down: float,
        speeds_m_s: tuple[float, float, float],
        dt_s: float,
        sink_m_s: float | None = None,
    ) -> State:
        """One step towards a place; speeds: cruise, up and down.  Returns where it is then.

        sink_m_s: descend at this speed, regardless of the height.
        """
        at, velocity, off, off_down = self.at, 0j, goal - self.at.place, down - self.at.down
        cruise_m_s, up_m_s, down_m_s = speeds_m_s
        if (away_m := abs(off)) > 1e-6:
            velocity = off * (min(cruise_m_s, self._braking_m_s(away_m)) / away_m)
        if sink_m_s is None:
            sink_m_s = math.copysign(self._braking_m_s(abs(off_down)), off_down)
            sink_m_s = min(max(sink_m_s, -up_m_s), down_m_s)
        most, step, gain = self._most, self._jerk * dt_s, 1.2 * self._jerk / self._most
        push = at.push + clipped(clipped(gain * (velocity - at.velocity), most) - at.push, step)
        wanted = min(max(gain * (sink_m_s - at.sink), -_ACCELERATION_UP_M_S2), most)
        push_down = at.push_down + min(max(wanted - at.push_down, -step), step)
        velocity, sink_m_s = at.velocity + push * dt_s, at.sink + push_down * dt_s
        place, down = at.place + velocity * dt_s, at.down + sink_m_s * dt_s
        self.at = State(place, down, velocity, sink_m_s, push, push_down)
        return self.at
