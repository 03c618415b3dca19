"""Whether who touches the ground has landed or crashed: by its speed in all axes.

The one place that judges it, for all vehicles and autopilots, and in the air without one.
"""

import math
from typing import Final, NamedTuple, final

CRASH_M_S: Final = 3.0
"""No faster into the ground: landing gear need not stand more than 3.05 m/s, 10 ft/s (CS 23.473,
STANAG 4671 USAR.473).  A copter has no wheels: sideways as fast, it tips over."""
RUNWAY_SLOPE: Final = 0.1
"""Where a plane may land faster than CRASH_M_S: five times the slope that a runway may have (2 %,
ICAO Annex 14, 3.1.13).  What is steeper is a hillside."""


@final
class Crash(NamedTuple):
    """Where, when, how fast and into what: the local frame, metres AMSL, vehicle time."""

    t_s: float
    north_m: float
    east_m: float
    altitude_amsl_m: float
    speed_m_s: float
    """In all axes, when it touched."""
    into: str
    """"the ground", or "a tree, wall, building or wire"."""


def speed_m_s(velocity_neu_m_s: tuple[float, float, float]) -> float:
    """In all axes."""
    return math.hypot(*velocity_neu_m_s)


def is_crash(
    velocity_neu_m_s: tuple[float, float, float],
    slope_ne: tuple[float, float],
    *,
    rolls: bool,
    lands: bool = True,
) -> bool:
    """Whether nobody survives this contact with ground that rises so much to the north and east.

    Slopes are metres a metre.  `rolls`: a plane on its wheels may be fast along a runway.  Without
    `lands` it is on them already, or has not really left the ground.
    """
    if speed_m_s(velocity_neu_m_s) <= CRASH_M_S:
        return False
    if not rolls:
        return True
    north_m_s, east_m_s, up_m_s = velocity_neu_m_s
    steepness = math.hypot(*slope_ne)
    closing_m_s = north_m_s * slope_ne[0] + east_m_s * slope_ne[1] - up_m_s
    into_m_s = closing_m_s / math.hypot(1.0, steepness)  # along the ground's normal
    return into_m_s > CRASH_M_S or (lands and steepness > RUNWAY_SLOPE)
