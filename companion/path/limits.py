"""What the vehicle can fly and where it may: the bounds of the paper's section 2.2."""

import math
from dataclasses import dataclass
from typing import Literal, final

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

    def inner_band_amsl_m(self, inset_m: float) -> tuple[float, float]:
        """Floor and ceiling of a path, so that a vehicle so far from it stays in the band."""
        return self.floor_amsl_m + inset_m, self.ceiling_amsl_m - inset_m
