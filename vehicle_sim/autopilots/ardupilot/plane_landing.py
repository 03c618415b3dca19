"""ArduPlane's landing: down the slope to the point, a flare, and what it says of it.

Not measured (ardupilot.md 8): the numbers are ArduPilot's defaults, the texts its sources'.
"""

import math
from collections.abc import Callable
from typing import final

from vehicle_sim.autopilots import Estimate
from vehicle_sim.autopilots.ardupilot.flat_earth import distance_m
from vehicle_sim.autopilots.ardupilot.plane_navigation import Navigation
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.parameters import Parameters

APPROACH_SPEED, FLARE_SPEED = 0.8, 0.64
"""Of the cruising airspeed."""
FLARE_SINK_M_S = 0.5
ERROR_S = 3.0
"""Time constant with which it gets back onto the slope."""


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
