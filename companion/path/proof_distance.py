"""What a certificate is about, as plain numbers and arrays, for the proof (see `path.proof`)."""

from typing import NamedTuple

from companion.geodesy import FloatArray
from companion.path.envelope import Envelope
from companion.world.columns import Columns
from companion.world.zones import ZoneTable


class Surroundings(NamedTuple):
    """What a certificate is about: terrain, zones, radars and bounds, as plain arrays."""

    columns: Columns
    zones: ZoneTable
    radars: FloatArray  # (N, 4): north, east, altitude, range
    clearance_m: float
    contact_m: float
    motion: Envelope
    """Of the circle that a plane holds on, the terrain is dealt with in `registration_m`."""
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
