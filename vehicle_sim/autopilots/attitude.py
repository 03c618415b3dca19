"""Attitudes as SET_ATTITUDE_TARGET gives them, and what they do to a point mass."""

import math
from typing import Final, NamedTuple, final

from vehicle_sim.dynamics import GRAVITY_M_S2

IGNORE_RATES: Final = (1, 2, 4)
"""type_mask: the rate of roll, pitch, yaw is not given."""
IGNORE_THRUST: Final = 64
IGNORE_ATTITUDE: Final = 128
_UNIT_WITHIN: Final = 1e-3
_STEEPEST_RAD: Final = math.radians(89.0)


@final
class AttitudeTarget(NamedTuple):
    """A SET_ATTITUDE_TARGET, as sent: nothing is checked yet."""

    type_mask: int
    quaternion: tuple[float, float, float, float]
    """w, x, y, z: body to north, east, down."""
    rates_rad_s: tuple[float, float, float]
    thrust: float
    """0 to 1."""

    @property
    def by_attitude(self) -> bool:
        """Whether the quaternion is meant."""
        return not self.type_mask & IGNORE_ATTITUDE

    @property
    def by_rates(self) -> bool:
        """Whether all three rates are meant."""
        return not any(self.type_mask & bit for bit in IGNORE_RATES)


@final
class Attitude(NamedTuple):
    """Euler angles: of roll, pitch and heading."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float

    def turned(self, rates_rad_s: tuple[float, float, float], dt_s: float) -> "Attitude":
        """After turning at these body rates for a while (kinematics of Euler angles)."""
        roll_rate, pitch_rate, yaw_rate = rates_rad_s
        sine, cosine = math.sin(self.roll_rad), math.cos(self.roll_rad)
        across = pitch_rate * sine + yaw_rate * cosine
        pitch_rad = self.pitch_rad + (pitch_rate * cosine - yaw_rate * sine) * dt_s
        return Attitude(
            math.remainder(
                self.roll_rad + (roll_rate + across * math.tan(self.pitch_rad)) * dt_s, math.tau
            ),
            min(max(pitch_rad, -_STEEPEST_RAD), _STEEPEST_RAD),
            math.remainder(
                self.yaw_rad + across / math.cos(self.pitch_rad) * dt_s,
                math.tau,
            ),
        )

    def limited(self, lean_rad: float) -> "Attitude":
        """Leaning no more than this."""
        lean = math.acos(math.cos(self.roll_rad) * math.cos(self.pitch_rad))
        if lean <= lean_rad:
            return self
        share = lean_rad / lean
        return Attitude(self.roll_rad * share, self.pitch_rad * share, self.yaw_rad)

    def acceleration_neu_m_s2(self, thrust_m_s2: float) -> tuple[float, float, float]:
        """North, east and up, of a thrust against gravity along the body's own upward axis."""
        sine_r, cosine_r = math.sin(self.roll_rad), math.cos(self.roll_rad)
        sine_p, cosine_p = math.sin(self.pitch_rad), math.cos(self.pitch_rad)
        sine_y, cosine_y = math.sin(self.yaw_rad), math.cos(self.yaw_rad)
        return (
            -thrust_m_s2 * (cosine_r * sine_p * cosine_y + sine_r * sine_y),
            -thrust_m_s2 * (cosine_r * sine_p * sine_y - sine_r * cosine_y),
            thrust_m_s2 * cosine_r * cosine_p - GRAVITY_M_S2,
        )


def attitude_of(quaternion: tuple[float, float, float, float]) -> Attitude | None:
    """Euler angles of a quaternion; None if it is not of unit length."""
    w, x, y, z = quaternion
    size = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(size - 1.0) <= _UNIT_WITHIN:
        return None
    w, x, y, z = w / size, x / size, y / size, z / size
    return Attitude(
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0)),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def finite(target: AttitudeTarget) -> bool:
    """Whether all that is meant are numbers."""
    meant = [0.0 if target.type_mask & IGNORE_THRUST else target.thrust]
    meant += target.quaternion if target.by_attitude else ()
    meant += target.rates_rad_s if target.by_rates else ()
    return all(map(math.isfinite, meant))
