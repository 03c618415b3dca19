"""What a certificate is about, as plain numbers and arrays, for the proof (see `path.proof`)."""

import math
from typing import NamedTuple

from companion.geodesy import FloatArray
from companion.world.columns import Columns
from companion.world.zones import ZoneTable


class Surroundings(NamedTuple):
    """What a certificate is about: terrain, zones, radars and bounds, as plain arrays."""

    columns: Columns
    zones: ZoneTable
    loiter_m: float
    """Radius of the circle about each point of the curve that has to be as clear as the point; its
    terrain is dealt with in `registration_m`."""
    radars: FloatArray  # (N, 4): north, east, altitude, range
    clearance_m: float
    contact_m: float
    dead_man_s: float
    overrun_m: float
    speed_m_s: float
    acceleration_m_s2: float
    stops: bool
    """Whether the vehicle stops at the end of the curve; if not, it may be at full speed there."""
    curvature_1_m: float
    climb: float
    """Tangent of the largest climb angle; `dive` likewise."""
    dive: float
    floor_m: float
    ceiling_m: float
    map_south_m: float
    map_north_m: float
    map_west_m: float
    map_east_m: float


def braked_m_s(left: float, acceleration: float, dead_man_s: float, overrun: float) -> float:
    """The highest speed that can be braked within `left`, and within `overrun` more after a time.

    v^2 = 2 a left, but v dead_man_s + v^2 / 2a <= left + overrun.
    """
    speed = math.sqrt(2.0 * acceleration * left)
    if speed * dead_man_s > overrun:
        within = 2.0 * (left + overrun) / acceleration
        speed = acceleration * (math.sqrt(dead_man_s * dead_man_s + within) - dead_man_s)
    return speed
