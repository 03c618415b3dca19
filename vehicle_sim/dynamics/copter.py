"""A copter as a point mass whose thrust accelerates it as it is told, within its limits.

Commanded is what the thrust does: drag and wind come on top, and the autopilot has to make up for
them as a real one does.  Without drag, and with no limit on the tilt, the vehicle does what it is
told.
"""

import cmath
import math
from dataclasses import dataclass, field
from typing import final

from vehicle_sim.dynamics import GRAVITY_M_S2, Vehicle

HOVER_THROTTLE = 0.39
"""MOT_THST_HOVER, as ArduCopter learns it in the recorded flights."""
RESPONSE_S = 0.04
"""Time constant from commanded to actual acceleration: a copter has to tilt first."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What the airframe can do."""

    speed_m_s: float
    """Horizontal, as the next one."""
    acceleration_m_s2: float
    speed_vertical_m_s: float
    acceleration_vertical_m_s2: float


@final
@dataclass(slots=True, kw_only=True, eq=False)
class Copter(Vehicle):
    """Where the vehicle is and how it moves.

    The autopilot turns its heading, at once: it has no part in how a point mass moves.
    """

    limits: Limits
    drag_1_s: float = 0.0
    """Deceleration for each m/s through the air, linear as PX4's SIH has it (SIH_KDV)."""
    drag_1_m: float = 0.0
    """The same for each square of m/s, which ArduPilot's simulation has besides."""
    hover_throttle: float = HOVER_THROTTLE
    response_s: float = field(init=False, default=RESPONSE_S)
    """Time constant from commanded to actual acceleration."""
    _thrust_m_s2: complex = field(init=False, default=0j)
    """North + east j."""

    def stand(self, altitude_amsl_m: float) -> None:
        """Come to rest at this height."""
        Vehicle.stand(self, altitude_amsl_m)
        self._thrust_m_s2 = 0j

    def advance(self, north_m_s2: float, east_m_s2: float, up_m_s2: float, dt_s: float) -> None:
        """One step under a commanded acceleration of the thrust, gravity made up for.

        Attitude and throttle are those that this thrust takes.
        """
        limits, velocity, wind = self.limits, self.velocity_m_s, self.wind_m_s
        response = dt_s / (self.response_s + dt_s)
        thrust = self._thrust_m_s2
        thrust += (complex(north_m_s2, east_m_s2) - thrust) * response
        if (size := math.hypot(thrust.real, thrust.imag)) > limits.acceleration_m_s2:
            thrust *= limits.acceleration_m_s2 / size
        self._thrust_m_s2 = thrust
        most, up = limits.acceleration_vertical_m_s2, self.acceleration_up_m_s2
        up = min(max(up + (up_m_s2 - up) * response, -most), most)

        ahead = thrust * cmath.rect(1.0, -self.heading_rad)
        lift = GRAVITY_M_S2 + up
        self.pitch_rad = -math.atan2(ahead.real, lift)
        self.roll_rad = math.atan2(ahead.imag, math.hypot(ahead.real, lift))
        whole = math.sqrt(ahead.real * ahead.real + ahead.imag * ahead.imag + lift * lift)
        self.throttle = min(self.hover_throttle * whole / GRAVITY_M_S2, 1.0)

        level, rising = thrust, up
        if self.drag_1_s or self.drag_1_m:
            past = velocity - wind
            level -= (self.drag_1_s + self.drag_1_m * math.hypot(past.real, past.imag)) * past
            # Going up and down the thrust has enough in hand; only moving air is felt.
            rising += self.drag_1_s * self.wind_up_m_s
        velocity += level * dt_s
        if (size := math.hypot(velocity.real, velocity.imag)) > limits.speed_m_s:
            velocity *= limits.speed_m_s / size
        most = limits.speed_vertical_m_s
        up_m_s = min(max(self.velocity_up_m_s + rising * dt_s, -most), most)
        self._move(velocity, up_m_s, dt_s)
        self.acceleration_m_s2, self.acceleration_up_m_s2 = level, up
        self.airspeed_m_s = math.hypot((velocity - wind).real, (velocity - wind).imag)
