"""What both firmwares keep an eye on: the zones of a fence; and ArduPilot's fence as a whole."""

from typing import Final, NamedTuple, final

import shapely

from vehicle_sim.autopilot.earth import Frame, way_m
from vehicle_sim.autopilot.values import Place
from vehicle_sim.parameters import Readable
from vehicle_sim.plans import CIRCLE_IN, POLYGON_IN, PlanKind, Plans, zones_of


@final
class Zone(NamedTuple):
    """A polygon, or what lies no farther than its radius from a point; north and east, metres."""

    keeps_in: bool
    area: shapely.Geometry
    radius_m: float = 0.0

    def surrounds(self, point: shapely.Point) -> bool:
        """Of a polygon by the even-odd rule, so that a self-crossing one has holes."""
        return bool(shapely.distance(self.area, point) <= self.radius_m)


@final
class Zones:
    """Polygons and circles of the uploaded fence, in the metres of a frame."""

    def __init__(self, plans: Plans) -> None:
        self._plans, self._version = plans, -1
        self._frame: Frame | None = None
        self._zones: list[Zone] = []

    def forbid(self, frame: Frame, place: Place, *, union: bool) -> bool:
        """Whether it is in a zone to keep out of, or not in those to keep in; union: in none."""
        if self._version != self._plans.version or self._frame is not frame:
            self._version, self._frame, self._zones = self._plans.version, frame, []
            for items in zones_of(self._plans[PlanKind.FENCE]):
                places = (Place(item.x * 1e-7, item.y * 1e-7, 0.0) for item in items)
                corners = [frame.ned_m(place)[:2] for place in places]
                keeps_in = items[0].command in (POLYGON_IN, CIRCLE_IN)
                if len(corners) > 1:
                    zone = Zone(keeps_in, shapely.Polygon(corners))
                else:
                    zone = Zone(keeps_in, shapely.Point(corners[0]), items[0].parameters[0])
                self._zones.append(zone)
        if not self._zones:
            return False
        here_m = shapely.Point(frame.ned_m(place)[:2])
        kept = [zone.surrounds(here_m) for zone in self._zones if zone.keeps_in]
        is_out = bool(kept) and not (any(kept) if union else all(kept))
        return is_out or any(zone.surrounds(here_m) for zone in self._zones if not zone.keeps_in)


ALTITUDE_MAX, CIRCLE, POLYGON, ALTITUDE_MIN = 1, 2, 4, 8
_NAMES: Final = {1: "Max Alt", 2: "Circle", 4: "Polygon", 8: "Min Alt"}
"""By the bits of FENCE_TYPE, as the texts call them."""


def named(kinds: int) -> str:
    """The kinds of fence of these bits."""
    return " and ".join(name for bit, name in _NAMES.items() if kinds & bit)


@final
class Fence:
    """ArduPilot's fence: height, circle about home, polygons and circles (ardupilot.md 4).

    Margins only affect when the floor is switched on: a breach means being outside.
    """

    def __init__(self, parameters: Readable, plans: Plans) -> None:
        self._parameters, self._plans, self._zones = parameters, plans, Zones(plans)
        self.breached = 0
        """Bits of FENCE_TYPE."""
        self._breaches = 0
        self.has_floor = False
        """FENCE_ALT_MIN counts: it has been above it by the margin since it took off, and does not
        land (AC_Fence::auto_enable_fence_floor, get_auto_disable_fences)."""

    @property
    def enabled(self) -> bool:
        """Whether it is switched on."""
        return bool(self._parameters["FENCE_ENABLE"])

    @property
    def status(self) -> tuple[int, ...] | None:
        """FENCE_STATUS, if there is a fence: whether it is breached, and how often it was."""
        there = self.enabled or self._plans[PlanKind.FENCE]
        return (int(bool(self.breached)), self._breaches) if there else None

    def outside(self, place: Place, home: Place | None, frame: Frame) -> int:
        """Which kinds of fence this place would breach: bits of FENCE_TYPE."""
        if not self.enabled or home is None:
            return 0
        p, above_m = self._parameters, place.altitude_amsl_m - home.altitude_amsl_m
        kinds, union, breaches = int(p["FENCE_TYPE"]), bool(int(p["FENCE_OPTIONS"]) & 2), 0
        if kinds & ALTITUDE_MAX and above_m >= p["FENCE_ALT_MAX"]:
            breaches |= ALTITUDE_MAX
        if kinds & ALTITUDE_MIN and self.has_floor and above_m <= p["FENCE_ALT_MIN"]:
            breaches |= ALTITUDE_MIN
        if kinds & CIRCLE and abs(way_m(home, place)) >= p["FENCE_RADIUS"]:
            breaches |= CIRCLE
        if kinds & POLYGON and self._zones.forbid(frame, place, union=union):
            breaches |= POLYGON
        return breaches

    def check(self, place: Place, home: Place, frame: Frame, *, lands: bool) -> int:
        """Look where the vehicle is; returns the kinds that are breached since just now."""
        p, above_m = self._parameters, place.altitude_amsl_m - home.altitude_amsl_m
        is_safe = above_m >= p["FENCE_ALT_MIN"] + p["FENCE_MARGIN"]
        self.has_floor = not lands and (self.has_floor or is_safe)
        breaches = self.outside(place, home, frame)
        new = breaches & ~self.breached
        if breaches and not self.breached:
            self._breaches += 1
        self.breached = breaches
        return new
