"""A plane as a point mass in coordinated flight through air that moves.

It is told a bank angle, a climb rate and an airspeed, and follows each within its limits.  The
air carries it: ground velocity is air velocity plus wind.  A climb costs no airspeed.
"""

import cmath
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
    _slip_m_s: complex = field(init=False, default=0j)
    """North + east j."""

    def fall(self, dt_s: float) -> None:
        """One step without motor and control: it glides straight ahead, if it can."""
        if self.broken:
            Vehicle.fall(self, dt_s)
            return
        self.advance(0.0, -self.limits.sink_max_m_s, self.limits.airspeed_min_m_s, dt_s)
        self.throttle = 0.0

    def advance(self, bank_rad: float, climb_m_s: float, airspeed_m_s: float, dt_s: float) -> None:
        """One step in the air under a commanded bank (right positive), climb and airspeed."""
        limits, before_rad, before_m_s = self.limits, self.roll_rad, self.airspeed_m_s
        bank_rad = min(max(bank_rad, -limits.bank_max_rad), limits.bank_max_rad)
        step = (bank_rad - before_rad) * dt_s / (ROLL_RESPONSE_S + dt_s)
        most = limits.roll_rate_rad_s * dt_s
        self.roll_rad += min(max(step, -most), most)

        wanted = min(max(airspeed_m_s, limits.airspeed_min_m_s), limits.airspeed_max_m_s)
        step = (wanted - before_m_s) * dt_s / (AIRSPEED_RESPONSE_S + dt_s)
        most = limits.acceleration_m_s2 * dt_s
        step = min(max(step, -most), most)
        airspeed = self.airspeed_m_s = before_m_s + step

        climb = self._climb_m_s
        wanted = min(max(climb_m_s, -limits.sink_max_m_s), limits.climb_max_m_s)
        climb += (wanted - climb) * dt_s / (CLIMB_RESPONSE_S + dt_s)
        most = 0.7 * airspeed  # no steeper than 45 degrees
        climb = self._climb_m_s = min(max(climb, -most), most)

        mean_m_s = 0.5 * (before_m_s + airspeed)
        lateral = GRAVITY_M_S2 * math.tan(0.5 * (before_rad + self.roll_rad))
        turn = self.turn_efficiency * lateral / max(mean_m_s, 1.0)
        self.heading_rad = (self.heading_rad + turn * dt_s) % math.tau
        steepness = climb / airspeed if airspeed > 0.0 else 0.0
        self.pitch_rad = math.asin(steepness) + PITCH_AT_CRUISE_RAD
        effort = climb / limits.climb_max_m_s + step / (limits.acceleration_m_s2 * dt_s)
        self.throttle = min(max(CRUISE_THROTTLE + (1.0 - CRUISE_THROTTLE) * effort, 0.0), 1.0)
        slip = self._slip_m_s = self._slip_m_s * (SLIP_S / (SLIP_S + dt_s))
        flat_m_s = airspeed * math.sqrt(1.0 - steepness * steepness)
        flown = cmath.rect(flat_m_s, self.heading_rad) + self.wind_m_s + slip
        self._accelerate(flown, climb + self.wind_up_m_s, dt_s)

    def roll_on_ground(self, acceleration_m_s2: float, dt_s: float) -> None:
        """One step on the wheels, where the nose points; negative acceleration: to a halt."""
        nose = cmath.rect(1.0, self.heading_rad)
        speed = (self.velocity_m_s * nose.conjugate()).real
        speed = max(speed + acceleration_m_s2 * dt_s, 0.0)
        self._accelerate(cmath.rect(speed, self.heading_rad), 0.0, dt_s)
        self.velocity_up_m_s = self.acceleration_up_m_s2 = 0.0
        self.roll_rad = self.pitch_rad = self._climb_m_s = 0.0
        flow = (self.velocity_m_s - self.wind_m_s) * nose.conjugate()
        self.airspeed_m_s = max(flow.real, 0.0)  # of a pitot tube
        # what the air does not carry along the nose stays as slip when the wheels leave the ground
        self._slip_m_s = (speed - self.airspeed_m_s) * nose - self.wind_m_s

    def touch_down(self, altitude_amsl_m: float) -> None:
        """Put the wheels on the ground: the nose turns into the direction of travel."""
        self.altitude_amsl_m = altitude_amsl_m
        if self.velocity_m_s:
            self.heading_rad = cmath.phase(self.velocity_m_s) % math.tau
        self.stands = True
        self.throttle = self.velocity_up_m_s = 0.0

    def _accelerate(self, level_m_s: complex, up_m_s: float, dt_s: float) -> None:
        """One step to this velocity."""
        self.acceleration_m_s2 = (level_m_s - self.velocity_m_s) / dt_s
        self.acceleration_up_m_s2 = (up_m_s - self.velocity_up_m_s) / dt_s
        self._move(level_m_s, up_m_s, dt_s)
