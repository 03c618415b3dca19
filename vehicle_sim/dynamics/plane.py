"""A plane as a point mass in coordinated flight through air that moves.

It is told a bank angle, a climb rate and an airspeed, and follows each within its limits.  The
air carries it: ground velocity is air velocity plus wind.  A climb costs no airspeed.
"""

import math
from dataclasses import dataclass, field
from typing import final

from vehicle_sim.dynamics import GRAVITY_M_S2, Vehicle

ROLL_RESPONSE_S = 0.1
"""Time constant from commanded to actual bank; fits the ground track of the recorded ArduPlane
flight best, together with the limit on the roll rate."""
CLIMB_RESPONSE_S = 0.6
AIRSPEED_RESPONSE_S = 1.3
"""Both of the same flight: height after a step of 10 m, speed after lift-off."""
SLIP_S = 0.5
"""Time constant with which the sideways flow of a take-off in cross wind dies away."""
CRUISE_THROTTLE = 0.48
"""In level flight at cruise (VFR_HUD of the recorded ArduPlane flight)."""
PITCH_AT_CRUISE_RAD = math.radians(-3.4)
"""Nose below the path: the recorded airframe's, level at cruise."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneLimits:
    """What the airframe can do.  Airspeeds are true airspeeds."""

    airspeed_min_m_s: float = 12.0
    airspeed_max_m_s: float = 33.0
    bank_max_rad: float = math.radians(65.0)
    roll_rate_rad_s: float = math.radians(75.0)
    climb_max_m_s: float = 10.0
    sink_max_m_s: float = 5.0
    acceleration_m_s2: float = 4.0
    """Along the path, up or down in airspeed."""


@final
@dataclass(slots=True, kw_only=True, eq=False)
class Plane(Vehicle):
    """Where the vehicle is and how it moves."""

    limits: PlaneLimits = PlaneLimits()
    turn_efficiency: float = field(init=False, default=1.0)
    """Lateral acceleration over g tan(bank); less than 1 of an airframe that slips in turns."""
    _climb_m_s: float = field(init=False, default=0.0)
    _slip_north_m_s: float = field(init=False, default=0.0)
    _slip_east_m_s: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        self.heading_rad %= math.tau

    def stand(self, altitude_amsl_m: float) -> None:
        """Come to rest at this height."""
        Vehicle.stand(self, altitude_amsl_m)
        self._climb_m_s = self._slip_north_m_s = self._slip_east_m_s = 0.0
        self.airspeed_m_s = self._flow_along_the_nose_m_s()

    def _flow_along_the_nose_m_s(self) -> float:
        """What a pitot tube would measure on the ground."""
        north = self.velocity_north_m_s - self.wind_north_m_s
        east = self.velocity_east_m_s - self.wind_east_m_s
        along = north * math.cos(self.heading_rad) + east * math.sin(self.heading_rad)
        return along if along > 0.0 else 0.0

    def fall(self, dt_s: float) -> None:
        """One step without motor and control: it glides straight ahead, if it can."""
        if self.broken:
            Vehicle.fall(self, dt_s)
            return
        self.advance(0.0, -self.limits.sink_max_m_s, self.limits.airspeed_min_m_s, dt_s)
        self.throttle = 0.0

    def advance(self, bank_rad: float, climb_m_s: float, airspeed_m_s: float, dt_s: float) -> None:
        """One step in the air under a commanded bank (right positive), climb and airspeed."""
        limits = self.limits
        most = limits.bank_max_rad
        bank_rad = -most if bank_rad < -most else most if bank_rad > most else bank_rad
        step = (bank_rad - self.roll_rad) * dt_s / (ROLL_RESPONSE_S + dt_s)
        most = limits.roll_rate_rad_s * dt_s
        before_rad = self.roll_rad
        self.roll_rad += -most if step < -most else most if step > most else step

        before_m_s = self.airspeed_m_s
        most = limits.airspeed_max_m_s
        least = limits.airspeed_min_m_s
        wanted = most if airspeed_m_s > most else least if airspeed_m_s < least else airspeed_m_s
        step = (wanted - before_m_s) * dt_s / (AIRSPEED_RESPONSE_S + dt_s)
        most = limits.acceleration_m_s2 * dt_s
        step = -most if step < -most else most if step > most else step
        airspeed = self.airspeed_m_s = before_m_s + step

        climb = self._climb_m_s
        most = limits.climb_max_m_s
        least = -limits.sink_max_m_s
        wanted = most if climb_m_s > most else least if climb_m_s < least else climb_m_s
        climb += (wanted - climb) * dt_s / (CLIMB_RESPONSE_S + dt_s)
        if abs(climb) > 0.7 * airspeed:  # no steeper than 45 degrees
            climb = math.copysign(0.7 * airspeed, climb)
        self._climb_m_s = climb

        mean_m_s = 0.5 * (before_m_s + airspeed)
        lateral = GRAVITY_M_S2 * math.tan(0.5 * (before_rad + self.roll_rad))
        turn = self.turn_efficiency * lateral / max(mean_m_s, 1.0)
        self.heading_rad = (self.heading_rad + turn * dt_s) % math.tau
        steepness = climb / airspeed if airspeed > 0.0 else 0.0
        self.pitch_rad = math.asin(steepness) + PITCH_AT_CRUISE_RAD
        effort = climb / limits.climb_max_m_s + step / (limits.acceleration_m_s2 * dt_s)
        effort = CRUISE_THROTTLE + (1.0 - CRUISE_THROTTLE) * effort
        self.throttle = 0.0 if effort < 0.0 else 1.0 if effort > 1.0 else effort
        fading = SLIP_S / (SLIP_S + dt_s)
        self._slip_north_m_s *= fading
        self._slip_east_m_s *= fading
        flat_m_s = airspeed * math.sqrt(1.0 - steepness * steepness)
        self._accelerate(
            flat_m_s * math.cos(self.heading_rad) + self.wind_north_m_s + self._slip_north_m_s,
            flat_m_s * math.sin(self.heading_rad) + self.wind_east_m_s + self._slip_east_m_s,
            climb + self.wind_up_m_s,
            dt_s,
        )

    def roll_on_ground(self, acceleration_m_s2: float, dt_s: float) -> None:
        """One step on the wheels, where the nose points; negative acceleration: to a halt."""
        cosine, sine = math.cos(self.heading_rad), math.sin(self.heading_rad)
        speed = self.velocity_north_m_s * cosine + self.velocity_east_m_s * sine
        speed = max(speed + acceleration_m_s2 * dt_s, 0.0)
        self._accelerate(speed * cosine, speed * sine, 0.0, dt_s)
        self.velocity_up_m_s = self.acceleration_up_m_s2 = 0.0
        self.roll_rad = self.pitch_rad = self._climb_m_s = 0.0
        self.airspeed_m_s = self._flow_along_the_nose_m_s()
        # what the air does not carry along the nose stays as slip when the wheels leave the ground
        self._slip_north_m_s = (speed - self.airspeed_m_s) * cosine - self.wind_north_m_s
        self._slip_east_m_s = (speed - self.airspeed_m_s) * sine - self.wind_east_m_s

    def touch_down(self, altitude_amsl_m: float) -> None:
        """Put the wheels on the ground: the nose turns into the direction of travel."""
        self.altitude_amsl_m = altitude_amsl_m
        if self.velocity_north_m_s != 0.0 or self.velocity_east_m_s != 0.0:
            course = math.atan2(self.velocity_east_m_s, self.velocity_north_m_s)
            self.heading_rad = course % math.tau
        self.stands = True
        self.throttle = self.velocity_up_m_s = 0.0

    def _accelerate(self, north_m_s: float, east_m_s: float, up_m_s: float, dt_s: float) -> None:
        """One step to this velocity."""
        self.acceleration_north_m_s2 = (north_m_s - self.velocity_north_m_s) / dt_s
        self.acceleration_east_m_s2 = (east_m_s - self.velocity_east_m_s) / dt_s
        self.acceleration_up_m_s2 = (up_m_s - self.velocity_up_m_s) / dt_s
        self._move(north_m_s, east_m_s, up_m_s, dt_s)
