"""A copter as a point mass whose thrust accelerates it as it is told, within its limits.

Commanded is what the thrust does: drag and wind come on top, and the autopilot has to make up for
them as a real one does.  Without drag, and with no limit on the tilt, the vehicle does what it is
told.
"""

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
    _thrust_north_m_s2: float = field(init=False, default=0.0)
    _thrust_east_m_s2: float = field(init=False, default=0.0)

    def stand(self, altitude_amsl_m: float) -> None:
        """Come to rest at this height."""
        Vehicle.stand(self, altitude_amsl_m)
        self._thrust_north_m_s2 = self._thrust_east_m_s2 = 0.0

    def advance(self, north_m_s2: float, east_m_s2: float, up_m_s2: float, dt_s: float) -> None:
        """One step under a commanded acceleration of the thrust, gravity made up for.

        Attitude and throttle are those that this thrust takes.
        """
        limits = self.limits
        response = dt_s / (self.response_s + dt_s)
        before_n, before_e = self.velocity_north_m_s, self.velocity_east_m_s
        before_u = self.velocity_up_m_s

        a_n = self._thrust_north_m_s2
        a_e = self._thrust_east_m_s2
        a_n += (north_m_s2 - a_n) * response
        a_e += (east_m_s2 - a_e) * response
        size = math.hypot(a_n, a_e)
        most = limits.acceleration_m_s2
        if size > most:
            a_n *= most / size
            a_e *= most / size
        self._thrust_north_m_s2, self._thrust_east_m_s2 = a_n, a_e

        a_u = self.acceleration_up_m_s2
        a_u += (up_m_s2 - a_u) * response
        most = limits.acceleration_vertical_m_s2
        a_u = -most if a_u < -most else most if a_u > most else a_u
        cosine, sine = math.cos(self.heading_rad), math.sin(self.heading_rad)
        forward = a_n * cosine + a_e * sine
        right = a_e * cosine - a_n * sine
        lift = GRAVITY_M_S2 + a_u
        self.pitch_rad = -math.atan2(forward, lift)
        self.roll_rad = math.atan2(right, math.hypot(forward, lift))
        thrust = math.sqrt(forward * forward + right * right + lift * lift)
        throttle = self.hover_throttle * thrust / GRAVITY_M_S2
        self.throttle = throttle if throttle < 1.0 else 1.0

        lift_m_s2 = a_u
        if self.drag_1_s or self.drag_1_m:
            past_n, past_e = before_n - self.wind_north_m_s, before_e - self.wind_east_m_s
            drag_1_s = self.drag_1_s + self.drag_1_m * math.hypot(past_n, past_e)
            a_n -= drag_1_s * past_n
            a_e -= drag_1_s * past_e
            # Going up and down the thrust has enough in hand; only moving air is felt.
            lift_m_s2 += self.drag_1_s * self.wind_up_m_s
        v_n, v_e = before_n + a_n * dt_s, before_e + a_e * dt_s
        speed = math.hypot(v_n, v_e)
        if speed > limits.speed_m_s:
            v_n *= limits.speed_m_s / speed
            v_e *= limits.speed_m_s / speed

        fastest = limits.speed_vertical_m_s
        v_u = before_u + lift_m_s2 * dt_s
        v_u = -fastest if v_u < -fastest else fastest if v_u > fastest else v_u

        self._move(v_n, v_e, v_u, dt_s)
        self.acceleration_north_m_s2, self.acceleration_east_m_s2 = a_n, a_e
        self.acceleration_up_m_s2 = a_u
        self.airspeed_m_s = math.hypot(v_n - self.wind_north_m_s, v_e - self.wind_east_m_s)
