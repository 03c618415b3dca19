"""What the vehicle can fly and where it may: the bounds of the paper's section 2.2."""

from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Flight constraints; altitudes in metres AMSL, angles positive."""

    speed_m_s: float
    acceleration_m_s2: float
    climb_rate_m_s: float
    turn_radius_m: float
    climb_angle_rad: float
    dive_angle_rad: float
    floor_amsl_m: float
    ceiling_amsl_m: float
    north_m: tuple[float, float]
    """Southern and northern edge of the map."""
    east_m: tuple[float, float]
    """Western and eastern edge of the map."""
    tracking_error_m: float = 10.0
    """How far the vehicle may be from the point that it was told to be at."""
    navigation_error_m: float = 5.0
    """How wrong its position may be: the estimator's error, and that of the altitude datum."""
    dead_man_s: float = 3.5
    """How long it flies straight on after the last setpoint, before it brakes."""

    def reach_m(self, speed_m_s: float) -> float:
        """How far the vehicle comes when the setpoints end: it flies on, then brakes to a stop."""
        return speed_m_s * self.dead_man_s + self.stopping_m(speed_m_s)

    def stopping_m(self, speed_m_s: float) -> float:
        """Braking distance, metres."""
        return speed_m_s**2 / (2.0 * self.acceleration_m_s2)
