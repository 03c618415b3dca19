"""ArduPilot's fence: height, circle about home, polygons and circles, inclusion and exclusion.

Source: ardupilot.md 4.  Margins only affect the avoidance library, and when the floor is switched
on: a breach means being outside, regardless of FENCE_MARGIN.
"""

import math
from typing import final

from vehicle_sim.autopilots import Place
from vehicle_sim.autopilots.ardupilot.flat_earth import distance_m, longitude_scale
from vehicle_sim.geodesy import ARDUPILOT_M_PER_DEG, degrees_east
from vehicle_sim.parameters import Parameters
from vehicle_sim.plans import PlanKind, Plans, Point, Zone, forbidden, zones_of

ALTITUDE_MAX, CIRCLE, POLYGON, ALTITUDE_MIN = 1, 2, 4, 8
NAMES = {ALTITUDE_MAX: "Max Alt", CIRCLE: "Circle", POLYGON: "Polygon", ALTITUDE_MIN: "Min Alt"}
"""By the bits of FENCE_TYPE, as the texts call them."""
_LOADING_US = 450_000
"""A fence uploaded around the vehicle is breached after half a second (ardupilot.md 4)."""


def _depth_m(circle: Zone, place: Place) -> float:
    """How far inside; negative outside."""
    latitude_deg, longitude_deg = circle.corners[0]
    centre = Place(latitude_deg, longitude_deg, 0.0)
    return circle.radius_m - distance_m(centre, place)


def _in_one_piece(zone: Zone) -> Zone:
    """Its longitudes counted on from the first corner's, not torn apart at the date line."""
    first_deg = zone.corners[0][1]
    corners = tuple((lat, first_deg + degrees_east(first_deg, lon)) for lat, lon in zone.corners)
    return zone._replace(corners=corners)


def edge_m(zone: Zone, place: Place) -> float:
    """Distance to the nearest edge of a zone whose corners are in degrees."""
    if zone.radius_m > 0.0:
        return abs(_depth_m(zone, place))
    scale = longitude_scale(place.latitude_deg)
    points = [
        (
            (lat - place.latitude_deg) * ARDUPILOT_M_PER_DEG,
            degrees_east(place.longitude_deg, lon) * ARDUPILOT_M_PER_DEG * scale,
        )
        for lat, lon in zone.corners
    ]
    return min(_to_segment_m(points[k - 1], points[k]) for k in range(len(points)))


def _to_segment_m(one: Point, other: Point) -> float:
    """From 0, 0 to the segment."""
    along_n, along_e = other[0] - one[0], other[1] - one[1]
    square = along_n * along_n + along_e * along_e
    share = 0.0 if square == 0.0 else -(one[0] * along_n + one[1] * along_e) / square
    share = min(max(share, 0.0), 1.0)
    return math.hypot(one[0] + share * along_n, one[1] + share * along_e)


@final
class Fence:
    """What is fenced now."""

    def __init__(self, parameters: Parameters, plans: Plans) -> None:
        self._parameters = parameters
        self._plans = plans
        self._looks_us = 0
        self.zones: tuple[Zone, ...] = ()
        """Corners in degrees: latitude, longitude, over the date line beyond 180."""
        self.enabled = bool(parameters["FENCE_ENABLE"])
        self.breached = 0
        """Bits of FENCE_TYPE."""
        self.breaches = 0
        self.breach_type = 0
        """FENCE_BREACH: 1 too low, 2 too high, 3 over the edge."""
        self.has_floor = False
        """FENCE_ALT_MIN counts: it has been above it by the margin since it took off, and does not
        land (AC_Fence::auto_enable_fence_floor, get_auto_disable_fences)."""
        self.breach_us = 0
        self.load()

    def load(self, now_us: int = 0) -> None:
        """Read the list again; checks pause for a moment."""
        self._looks_us = now_us + _LOADING_US
        self.zones = tuple(_in_one_piece(zone) for zone in zones_of(self._plans[PlanKind.FENCE]))

    @property
    def present(self) -> bool:
        """Whether there is anything that FENCE_STATUS could tell of."""
        return self.enabled or bool(self.zones)

    def outside(self, place: Place, home: Place | None) -> int:
        """Which kinds of fence this place would breach: bits of FENCE_TYPE."""
        if not self.enabled or home is None:
            return 0
        parameters = self._parameters
        kinds, found = int(parameters["FENCE_TYPE"]), 0
        above_m = place.altitude_amsl_m - home.altitude_amsl_m
        if kinds & ALTITUDE_MAX and above_m >= parameters["FENCE_ALT_MAX"]:
            found |= ALTITUDE_MAX
        if kinds & ALTITUDE_MIN and self.has_floor and above_m <= parameters["FENCE_ALT_MIN"]:
            found |= ALTITUDE_MIN
        if kinds & CIRCLE and distance_m(home, place) >= parameters["FENCE_RADIUS"]:
            found |= CIRCLE
        if kinds & POLYGON and self._outside_zones(place):
            found |= POLYGON
        return found

    def _outside_zones(self, place: Place) -> bool:
        """With FENCE_OPTIONS bit 1 one inclusion is enough to be in."""

        def inside(zone: Zone) -> bool:
            if zone.radius_m > 0.0:
                return _depth_m(zone, place) > 0.0
            first_deg = zone.corners[0][1]
            longitude_deg = first_deg + degrees_east(first_deg, place.longitude_deg)
            return zone.surrounds((place.latitude_deg, longitude_deg))

        union = bool(int(self._parameters["FENCE_OPTIONS"]) & 2)
        return forbidden(self.zones, inside, union=union)

    def room_m(self, place: Place, home: Place) -> float:
        """Distance to the nearest thing that is fenced, from the permitted side."""
        rooms = [math.inf]
        if int(self._parameters["FENCE_TYPE"]) & POLYGON:
            rooms += [edge_m(zone, place) for zone in self.zones]
        if int(self._parameters["FENCE_TYPE"]) & CIRCLE:
            rooms.append(self._parameters["FENCE_RADIUS"] - distance_m(home, place))
        return min(rooms)

    def forget(self) -> None:
        """It is not in the air, or the fence is off."""
        self.breached, self.has_floor = 0, False

    def raises_floor(self, place: Place, home: Place, *, lands: bool) -> bool:
        """Whether FENCE_ALT_MIN counts from now on; of one that lands it does not."""
        parameters, had = self._parameters, self.has_floor
        above_m = place.altitude_amsl_m - home.altitude_amsl_m
        safe_m = parameters["FENCE_ALT_MIN"] + parameters["FENCE_MARGIN"]
        configured = bool(int(parameters["FENCE_TYPE"]) & ALTITUDE_MIN)
        self.has_floor = configured and not lands and (had or above_m >= safe_m)
        return self.has_floor and not had

    def check(self, place: Place, home: Place | None, now_us: int) -> int:
        """Look where the vehicle is; returns the kinds that are breached since just now."""
        if now_us < self._looks_us:
            return 0
        found = self.outside(place, home)
        new = found & ~self.breached
        if new and not self.breached:
            self.breaches += 1
        if new:
            over_the_edge = new & (CIRCLE | POLYGON)
            self.breach_type = 3 if over_the_edge else 2 if new & ALTITUDE_MAX else 1
            self.breach_us = now_us
        self.breached = found
        return new
