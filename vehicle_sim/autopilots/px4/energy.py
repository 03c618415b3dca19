"""PX4's total energy control (TECS) of a fixed wing, as far as it can be seen from outside.

Height and speed are one account.  An aeroplane that cannot reach the airspeed that it is told
(PX4's simulated one flies 13.9 m/s at full throttle, FW_AIRSPD_TRIM is 15) stands low by what the
missing speed is worth, about 2 m; and after a climb it takes most of a minute to get to its speed,
because only an integrator finds the last of the throttle.
"""

import math
from typing import final

from vehicle_sim.dynamics.copter import GRAVITY_M_S2

CLIMB_COSTS = 0.45
"""Airspeed lost for each m/s of climb at full throttle: 12.8 m/s at 2.5 m/s of climb, 13.95 level
(px4-fixedwing-offboard.tlog, 6-25 s and 230-355 s)."""
RECOVERY_M_S2 = 0.033
"""The integrator's speed: 12.3 m/s at 175 s, 14.0 at 230 s of that log."""
RECOVERS_AT_ONCE_M_S = 1.6
"""What is further off than this is found without the integrator."""
AHEAD_M_S = 0.05
"""What is told is no more than this above what is flown."""
SLOWS_DOWN_S = 2.0
"""Time constant: 13.8 to 11.5 m/s in 4.5 s when the landing begins."""
MOST_TRADED_M = 15.0


def true_airspeed_m_s(equivalent_m_s: float, altitude_amsl_m: float) -> float:
    """Airspeed parameters are equivalent ones: in the standard atmosphere, at this height."""
    return equivalent_m_s / math.sqrt(max(1.0 - 2.25577e-5 * altitude_amsl_m, 0.1) ** 4.2559)


@final
class Energy:
    """Climb and airspeed to fly.  Mutable."""

    def __init__(self) -> None:
        self.airspeed_m_s = 0.0
        """To command."""
        self.climb_m_s = 0.0

    def speed_up(
        self,
        wanted_m_s: float,
        level_most_m_s: float,
        airspeed_m_s: float,
        dt_s: float,
        *,
        at_once: bool,
    ) -> None:
        """Airspeed towards the wanted one, with what the climb leaves of the level flight's.

        at_once: full throttle or none, not what the integrator finds.
        """
        reach = level_most_m_s - CLIMB_COSTS * max(self.climb_m_s, 0.0)
        reach = min(wanted_m_s, reach)
        if at_once:
            self.airspeed_m_s = reach
            return
        speed = min(self.airspeed_m_s, airspeed_m_s + AHEAD_M_S)
        if speed > reach:
            self.airspeed_m_s = speed + (reach - speed) * min(dt_s / SLOWS_DOWN_S, 1.0)
        else:
            speed += RECOVERY_M_S2 * dt_s
            self.airspeed_m_s = min(max(speed, reach - RECOVERS_AT_ONCE_M_S), reach)

    def climb_to(
        self,
        altitude_amsl_m: float,
        here_amsl_m: float,
        *,
        wanted_m_s: float,
        airspeed_m_s: float,
        response_s: float,
        climb_most_m_s: float,
        sink_most_m_s: float,
    ) -> None:
        """Climb or sink towards a height, less what the airspeed lacks of the wanted one."""
        lacking_m = (wanted_m_s * wanted_m_s - airspeed_m_s * airspeed_m_s) / (2.0 * GRAVITY_M_S2)
        lacking_m = min(max(lacking_m, -MOST_TRADED_M), MOST_TRADED_M)
        climb = (altitude_amsl_m - lacking_m - here_amsl_m) / response_s
        self.climb_m_s = min(max(climb, -sink_most_m_s), climb_most_m_s)
