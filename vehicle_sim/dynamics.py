"""A copter as a point mass that accelerates as it is told, within its limits.

Mutable, with plain floats, on purpose: this is the inner loop, a hundred steps for each second of
flight, and no arrays are involved.  Position is geographic (geodesy.py says why).
"""

import math
from dataclasses import dataclass
from typing import final

from vehicle_sim.geodesy import metres_per_degree

GRAVITY_M_S2 = 9.80665
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
class Copter:
    """Where the vehicle is and how it moves: true north, true east, up."""

    __slots__ = (
        "acceleration_east_m_s2",
        "acceleration_north_m_s2",
        "acceleration_up_m_s2",
        "altitude_amsl_m",
        "latitude_deg",
        "limits",
        "longitude_deg",
        "velocity_east_m_s",
        "velocity_north_m_s",
        "velocity_up_m_s",
    )

    def __init__(
        self, *, latitude_deg: float, longitude_deg: float, altitude_amsl_m: float, limits: Limits
    ) -> None:
        self.limits = limits
        self.latitude_deg = latitude_deg
        self.longitude_deg = longitude_deg
        self.altitude_amsl_m = altitude_amsl_m
        self.stand(altitude_amsl_m)

    def stand(self, altitude_amsl_m: float) -> None:
        """Come to rest at this height."""
        self.altitude_amsl_m = altitude_amsl_m
        self.velocity_north_m_s = self.velocity_east_m_s = self.velocity_up_m_s = 0.0
        self.acceleration_north_m_s2 = self.acceleration_east_m_s2 = 0.0
        self.acceleration_up_m_s2 = 0.0

    def advance(self, north_m_s2: float, east_m_s2: float, up_m_s2: float, dt_s: float) -> None:
        """One step under a commanded acceleration."""
        limits = self.limits
        response = dt_s / (RESPONSE_S + dt_s)
        before_n, before_e = self.velocity_north_m_s, self.velocity_east_m_s
        before_u = self.velocity_up_m_s

        a_n = self.acceleration_north_m_s2
        a_e = self.acceleration_east_m_s2
        a_n += (north_m_s2 - a_n) * response
        a_e += (east_m_s2 - a_e) * response
        size = math.hypot(a_n, a_e)
        if size > limits.acceleration_m_s2:
            a_n *= limits.acceleration_m_s2 / size
            a_e *= limits.acceleration_m_s2 / size
        v_n, v_e = before_n + a_n * dt_s, before_e + a_e * dt_s
        speed = math.hypot(v_n, v_e)
        if speed > limits.speed_m_s:
            v_n *= limits.speed_m_s / speed
            v_e *= limits.speed_m_s / speed

        a_u = self.acceleration_up_m_s2
        a_u += (up_m_s2 - a_u) * response
        most = limits.acceleration_vertical_m_s2
        a_u = min(max(a_u, -most), most)
        fastest = limits.speed_vertical_m_s
        v_u = min(max(before_u + a_u * dt_s, -fastest), fastest)

        self._move(before_n + v_n, before_e + v_e, before_u + v_u, 0.5 * dt_s)
        self.velocity_north_m_s, self.velocity_east_m_s, self.velocity_up_m_s = v_n, v_e, v_u
        self.acceleration_north_m_s2, self.acceleration_east_m_s2 = a_n, a_e
        self.acceleration_up_m_s2 = a_u

    def fall(self, dt_s: float) -> None:
        """One step without motors."""
        before_u = self.velocity_up_m_s
        self.velocity_up_m_s = before_u - GRAVITY_M_S2 * dt_s
        self._move(
            2.0 * self.velocity_north_m_s,
            2.0 * self.velocity_east_m_s,
            before_u + self.velocity_up_m_s,
            0.5 * dt_s,
        )

    def _move(self, north: float, east: float, up: float, half_dt_s: float) -> None:
        """Advance the position; north, east, up: velocity before plus velocity after, in m/s."""
        metres_north, metres_east = metres_per_degree(self.latitude_deg)
        self.latitude_deg += north * half_dt_s / metres_north
        longitude_deg = self.longitude_deg + east * half_dt_s / metres_east
        if not -180.0 <= longitude_deg < 180.0:
            longitude_deg = (longitude_deg + 180.0) % 360.0 - 180.0
        self.longitude_deg = longitude_deg
        self.altitude_amsl_m += up * half_dt_s
