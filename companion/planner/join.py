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
_SLOWEST_1_S, _FASTEST_1_S = 0.02, 1.0  # gone within minutes, and as fast as a vehicle follows
_GONE = 0.05  # m and m/s


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Offset:
    """What is added to the reference point's position and velocity."""

    position_nea_m: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,)
    velocity_nea_m_s: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,)

    @property
    def is_gone(self) -> bool:
        """Whether it has decayed to almost nothing."""
        parts = self.position_nea_m, self.velocity_nea_m_s
        return all(float(np.linalg.norm(part)) < _GONE for part in parts)


def begin(
    position_nea_m: FloatArray, velocity_nea_m_s: FloatArray, pose: Pose, speed_m_s: float
) -> Offset:
    """The offset of a setpoint from a reference point that moves at a pose with a speed."""
    return Offset(
        position_nea_m=position_nea_m - pose.position_nea_m,
        velocity_nea_m_s=velocity_nea_m_s - speed_m_s * pose.tangent_nea,
    )


def step(offset: Offset, elapsed_s: float, limits: Limits) -> Offset:
    """Advance the offset by one step, at the fastest decay rate w whose acceleration is allowed.

    x = (x0 + c t) e^(-wt) with c = v0 + w x0 has |x''| <= w (|c| + |v0|) <= w^2 |x0| + 2 w |v0|.
    """
    far = float(np.linalg.norm(offset.position_nea_m))
    fast = float(np.linalg.norm(offset.velocity_nea_m_s))
    most = _SHARE * limits.acceleration_m_s2
    rate = most / (fast + math.sqrt(fast * fast + most * far) + 1e-12)
    rate = min(max(rate, _SLOWEST_1_S), _FASTEST_1_S)
    slope = offset.velocity_nea_m_s + rate * offset.position_nea_m
    left = math.exp(-rate * elapsed_s)
    return Offset(
        position_nea_m=left * (offset.position_nea_m + elapsed_s * slope),
        velocity_nea_m_s=left * (offset.velocity_nea_m_s - rate * elapsed_s * slope),
    )
