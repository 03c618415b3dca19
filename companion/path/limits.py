"""What the vehicle can fly and where it may: the bounds of the paper's section 2.2."""

import math
from dataclasses import dataclass
from typing import Literal, final

from companion.path.proof_distance import braked_m_s
from companion.ranges import NotNegative, Positive

VehicleKind = Literal["copter", "plane"]
"""The kind of vehicle: a copter hovers and stops, a plane holds on circles."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Flight constraints; altitudes in metres AMSL, angles positive."""

    speed_m_s: Positive
    acceleration_m_s2: Positive
    climb_rate_m_s: Positive
    turn_radius_m: Positive
    climb_angle_rad: float
    dive_angle_rad: float
    floor_amsl_m: float
    ceiling_amsl_m: float
    north_m: tuple[float, float]
    """Southern and northern edge of the map."""
    east_m: tuple[float, float]
    """Western and eastern edge of the map."""
    tracking_error_m: Positive = 10.0
    """How far the vehicle may be from the point that it was told to be at."""
    navigation_error_m: NotNegative = 5.0
    """How wrong its position may be: the estimator's error, and that of the altitude datum."""
    dead_man_s: NotNegative = 3.5
    """How long it flies straight on after the last setpoint, before it brakes."""
    overrun_m: float = math.inf
    """How far beyond the end of a leg, where it stops, it may come if the companion dies: it slows
    down in time.  Of use where sight is short; elsewhere the reserve beyond ends holds it all."""
    loiter_radius_m: float = 0.0
    """Of a plane, which cannot stand still: it holds on circles of at most this radius, and so
    does its autopilot if the companion dies.  0: a vehicle that can hover."""
    lead_s: float = 5.5
    """How far ahead along the path, in seconds of flight, a plane is sent to at most."""

    @property
    def kind(self) -> VehicleKind:
        """The kind of vehicle: only a plane has a circle to hold on."""
        return "copter" if self.loiter_radius_m == 0.0 else "plane"

    @property
    def hovers(self) -> bool:
        """Whether the vehicle can stand still in the air."""
        return self.kind == "copter"

    def reach_m(self, speed_m_s: float) -> float:
        """How far the vehicle comes when the setpoints end, metres.

        It flies on, then brakes to a stop; a plane flies to the last point that it was sent to.
        """
        if not self.hovers:
            return self.lead_m
        return speed_m_s * self.dead_man_s + self.stopping_m(speed_m_s)

    def stopping_m(self, speed_m_s: float) -> float:
        """Braking distance, metres; a plane stops nowhere, and holds on a circle anywhere."""
        if not self.hovers:
            return 0.0
        return speed_m_s**2 / (2.0 * self.acceleration_m_s2)

    def braked_m_s(self, left_m: float, overrun_m: float = math.inf) -> float:
        """The highest speed from which the vehicle stops within so many metres, m/s.

        overrun_m: how much farther it may come if the companion dies meanwhile.
        """
        left_m = max(left_m, 0.0)
        return braked_m_s(left_m, self.acceleration_m_s2, self.dead_man_s, overrun_m)

    def slowing_m(self, speed_m_s: float) -> float:
        """How far before the end of a leg the vehicle begins to slow down for it, metres."""
        flies_on_m = speed_m_s * self.dead_man_s if self.hovers else 0.0
        return self.stopping_m(speed_m_s) + max(flies_on_m - self.overrun_m, 0.0)

    @property
    def lead_m(self) -> float:
        """How far along the path the point lies, at most, that a plane is sent to."""
        return 0.0 if self.hovers else self.speed_m_s * self.lead_s
