"""ArduPlane's take-off from a runway, and its landing: down the slope, a flare, what it says.

Source of the take-off: arduplane-guided-reposition.tlog, 26 to 35 s.  The landing was not measured
(ardupilot.md 8): the numbers are ArduPilot's defaults, the texts its sources'.
"""

import enum
import math
from collections.abc import Callable
from typing import final

from vehicle_sim.autopilots import Estimate
from vehicle_sim.autopilots.ardupilot.flat_earth import distance_m
from vehicle_sim.autopilots.ardupilot.plane_navigation import Navigation
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.parameters import Parameters

FULL_THRUST_M_S2, DRAG_1_S = 14.5, 0.55
"""Acceleration on the runway at full throttle, and what it loses with each metre a second."""
LIFT_OFF_SHARE = 0.86
"""Of the cruising airspeed."""
FLYING_M_S = 2.5
"""Ground speed that counts as flying."""
AIMED_M_S = 5.0
"""Ground speed at which TAKEOFF settles where it goes, and says so; then where it would land."""
DIRECTED_M_S = 6.8
CLIMB_AIRSPEED = 1.225
"""At full throttle and nose up, over cruising airspeed."""
CLIMB_M_S = 9.9
APPROACH_SPEED, FLARE_SPEED = 0.8, 0.64
"""Of the cruising airspeed."""
FLARE_SINK_M_S = 0.5
ERROR_S = 3.0
"""Time constant with which it gets back onto the slope."""
ROLL_LEVEL_TO_FREE = 3.0
"""Wings are held level below TKOFF_LVL_ALT; above so many times that the bank is free."""


class Stage(enum.Enum):
    """Where a take-off is."""

    IDLE = enum.auto()
    WAITING = enum.auto()
    RUNNING = enum.auto()
    CLIMBING = enum.auto()


@final
class Takeoff:
    """One take-off after another; says what the real one says."""

    def __init__(self, parameters: Parameters, say: Callable[[int, str], None]) -> None:
        self._parameters = parameters
        self._say = say
        self.stage = Stage.IDLE
        self._since_s = 0.0
        self._throttle = 0.0
        self._levelling = False
        self._directed = False

    def abandon(self) -> None:
        """Whatever comes next is no take-off."""
        self.stage = Stage.IDLE

    @property
    def suppressed(self) -> bool:
        """The motor is not yet allowed to run."""
        return self.stage in (Stage.IDLE, Stage.WAITING)

    def run(self, plane: Plane, cruise_m_s: float, dt_s: float) -> bool:
        """One step on the runway; True when it lifts off."""
        parameters = self._parameters
        if self.stage is Stage.IDLE:
            self.stage, self._since_s = Stage.WAITING, 0.0
            self._levelling = self._directed = False
            delay_s = parameters["TKOFF_THR_DELAY"] * 0.1
            self._say(6, f"Armed AUTO, xaccel = 0.0 m/s/s, waiting {delay_s:.1f} sec")
        self._since_s += dt_s
        speed = math.hypot(plane.velocity_north_m_s, plane.velocity_east_m_s)
        if self.stage is Stage.WAITING:
            if self._since_s < parameters["TKOFF_THR_DELAY"] * 0.1:
                plane.roll_on_ground(-3.0, dt_s)
                return False
            self.stage, self._throttle = Stage.RUNNING, 0.0
            self._say(6, f"Triggered AUTO. GPS speed = {speed:.1f}")
        slew = parameters["THR_SLEWRATE"] * 0.01 or 100.0
        self._throttle = min(self._throttle + slew * dt_s, parameters["THR_MAX"] * 0.01)
        thrust = FULL_THRUST_M_S2 * self._throttle**1.5
        plane.roll_on_ground(thrust - DRAG_1_S * plane.airspeed_m_s, dt_s)
        plane.throttle = self._throttle
        lift_off = max(parameters["TKOFF_ROTATE_SPD"], LIFT_OFF_SHARE * cruise_m_s)
        if plane.airspeed_m_s >= lift_off:
            self.stage = Stage.CLIMBING
            return True
        return False

    def tell_direction(self, plane: Plane, speed_m_s: float) -> None:
        """Once, fast enough on the runway."""
        if not self._directed and speed_m_s >= DIRECTED_M_S:
            self._directed = True
            course = math.atan2(plane.velocity_east_m_s, plane.velocity_north_m_s)
            whole_deg = math.floor(math.degrees(course) - 1e-3) % 360
            self._say(6, f"Autoland direction= {whole_deg}")

    def tell_level_off(self, to_go_m: float) -> None:
        """Once, TKOFF_PLIM_SEC before the height is reached."""
        if not self._levelling and to_go_m <= CLIMB_M_S * self._parameters["TKOFF_PLIM_SEC"]:
            self._levelling = True
            self._say(6, f"Takeoff level-off starting at {int(to_go_m)}m")

    def bank_limit_rad(self, climbed_m: float) -> float:
        """How far it may bank at this height above the runway."""
        parameters = self._parameters
        low_m = max(parameters["TKOFF_LVL_ALT"], 0.0)
        free_m = min(low_m * ROLL_LEVEL_TO_FREE, parameters["TKOFF_ALT"])
        share = 1.0 if free_m <= low_m else (climbed_m - low_m) / (free_m - low_m)
        level, free = parameters["LEVEL_ROLL_LIMIT"], parameters["ROLL_LIMIT_DEG"]
        return math.radians(level + min(max(share, 0.0), 1.0) * (free - level))


@final
class Landing:
    """One landing after another."""

    def __init__(self, parameters: Parameters, say: Callable[[int, str], None]) -> None:
        self._parameters = parameters
        self._say = say
        self.flaring = False
        """From the flare until it disarms by itself."""

    def step(
        self,
        plane: Plane,
        navigation: Navigation,
        estimate: Estimate,
        *,
        height_m: float,
        bank_rad: float,
        cruise_m_s: float,
        dt_s: float,
    ) -> None:
        """One step in the air; the height is that above the ground."""
        speed = math.hypot(estimate.velocity_north_m_s, estimate.velocity_east_m_s)
        if not self.flaring and height_m <= self._parameters["LAND_FLARE_ALT"]:
            self.flaring = True
            self._say(
                6,
                f"Flare {height_m:.1f}m sink={-estimate.velocity_up_m_s:.2f} "
                f"speed={plane.airspeed_m_s:.1f} dist={navigation.distance_m:.1f}",
            )
        if self.flaring:
            plane.advance(0.0, -FLARE_SINK_M_S, cruise_m_s * FLARE_SPEED, dt_s)
            plane.throttle = 0.0
            return
        slope = 0.0
        before, following = navigation.before, navigation.next
        if before is not None and following is not None:
            length_m = max(distance_m(before, following), 1.0)
            slope = (following.altitude_amsl_m - before.altitude_amsl_m) / length_m
        error_m = navigation.target_amsl_m - estimate.altitude_amsl_m
        climb = slope * speed + error_m / ERROR_S
        plane.advance(bank_rad, climb, cruise_m_s * APPROACH_SPEED, dt_s)
