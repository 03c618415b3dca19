"""Rejoining the path without a setpoint jump, for a vehicle that is not quite on it.

A companion that was restarted in flight, or has taken over, begins with the setpoint at the vehicle
(or at its autopilot's target).  The offset from the reference point then decays like a critically
damped spring: as fast as half of the mission's acceleration allows.
"""

import math
from dataclasses import dataclass, field
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.limits import Limits
from companion.path.subpath import Pose

_SHARE = 0.5  # of the acceleration: the path needs the rest
_FASTEST_1_S = 1.0
_SLOWEST_1_S = 0.02
_GONE_M, _GONE_M_S = 0.05, 0.05


def _nothing() -> FloatArray:
    return np.zeros(3)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Offset:
    """What is added to the reference point's position and velocity."""

    position_nea_m: FloatArray = field(default_factory=_nothing)  # (3,)
    velocity_nea_m_s: FloatArray = field(default_factory=_nothing)  # (3,)

    @property
    def is_gone(self) -> bool:
        """Whether it has decayed to almost nothing."""
        far = float(np.linalg.norm(self.position_nea_m))
        return far < _GONE_M and float(np.linalg.norm(self.velocity_nea_m_s)) < _GONE_M_S


def begin(
    position_nea_m: tuple[float, float, float] | FloatArray,
    velocity_nea_m_s: tuple[float, float, float] | FloatArray,
    pose: Pose,
    speed_m_s: float,
) -> Offset:
    """The offset of where the setpoint is now from a reference point that moves along a path.

    pose, speed_m_s: the reference point, and how fast it moves.
    """
    return Offset(
        position_nea_m=np.asarray(position_nea_m) - pose.position_nea_m,
        velocity_nea_m_s=np.asarray(velocity_nea_m_s) - speed_m_s * pose.tangent_nea,
    )


def step(offset: Offset, elapsed_s: float, limits: Limits) -> Offset:
    """Advance the offset by one step, at a decay rate that is recomputed each time.

    As it shrinks it may decay faster.
    """
    rate = _rate_1_s(offset, _SHARE * limits.acceleration_m_s2)
    slope = offset.velocity_nea_m_s + rate * offset.position_nea_m
    left = math.exp(-rate * elapsed_s)
    return Offset(
        position_nea_m=left * (offset.position_nea_m + elapsed_s * slope),
        velocity_nea_m_s=left * (offset.velocity_nea_m_s - rate * elapsed_s * slope),
    )


def _rate_1_s(offset: Offset, acceleration_m_s2: float) -> float:
    """The fastest rate w at which the acceleration stays within bounds.

    x = (x0 + c t) e^(-wt) with c = v0 + w x0 has |x''| <= w (|c| + |v0|) <= w^2 |x0| + 2 w |v0|.
    """
    far = float(np.linalg.norm(offset.position_nea_m))
    fast = float(np.linalg.norm(offset.velocity_nea_m_s))
    rate = acceleration_m_s2 / (fast + math.sqrt(fast * fast + acceleration_m_s2 * far) + 1e-12)
    return min(max(rate, _SLOWEST_1_S), _FASTEST_1_S)
