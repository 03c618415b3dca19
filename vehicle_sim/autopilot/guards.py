"""What both firmwares keep an eye on: the zones of a fence; and ArduPilot's fence as a whole."""

import math
from typing import Final, final

from vehicle_sim.autopilot.earth import Frame, way_m
from vehicle_sim.autopilot.values import Place
from vehicle_sim.parameters import Readable
from vehicle_sim.plans import PlanKind, Plans, Zone, forbidden, zones_of


@final
class Zones:
    """Polygons and circles of the uploaded fence, in the metres of a frame."""

    def __init__(self, plans: Plans) -> None:
        self._plans, self._version = plans, -1
        self._frame: Frame | None = None
        self._zones: tuple[Zone, ...] = ()

    def forbid(self, frame: Frame, place: Place, *, union: bool) -> bool:
        """Whether it is in a zone to keep out of, or not in those to keep in; union: in none."""
        if self._version != self._plans.version or self._frame is not frame:
            self._version, self._frame = self._plans.version, frame
            self._zones = zones_of(
                self._plans[PlanKind.FENCE], lambda lat, lon: frame.ned_m(Place(lat, lon, 0.0))[:2]
            )
        if not self._zones:
            return False
        here_m = frame.ned_m(place)[:2]

        def inside(zone: Zone) -> bool:
            if zone.radius_m > 0.0:
                return math.dist(here_m, zone.corners[0]) <= zone.radius_m
            return zone.surrounds(here_m)

        return forbidden(self._zones, inside, union=union)


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
        self._breaches = self._breach_type = 0
        """FENCE_BREACH: 1 too low, 2 too high, 3 over the edge."""
        self._breach_s = 0.0
        self.has_floor = False
        """FENCE_ALT_MIN counts: it has been above it by the margin since it took off, and does not
        land (AC_Fence::auto_enable_fence_floor, get_auto_disable_fences)."""

    @property
    def enabled(self) -> bool:
        """Whether it is switched on."""
        return bool(self._parameters["FENCE_ENABLE"])

    @property
    def told(self) -> tuple[int, ...] | None:
        """FENCE_STATUS, if there is a fence: breached, how often, the last FENCE_BREACH, when."""
        if not (self.enabled or self._plans[PlanKind.FENCE]):
            return None
        last = (self._breaches, self._breach_type, round(self._breach_s * 1e3))
        return (int(bool(self.breached)), *last)

    def outside(self, place: Place, home: Place | None, frame: Frame) -> int:
        """Which kinds of fence this place would breach: bits of FENCE_TYPE."""
        if not self.enabled or home is None:
            return 0
        p, above_m, found = self._parameters, place.altitude_amsl_m - home.altitude_amsl_m, 0
        kinds, union = int(p["FENCE_TYPE"]), bool(int(p["FENCE_OPTIONS"]) & 2)
        if kinds & ALTITUDE_MAX and above_m >= p["FENCE_ALT_MAX"]:
            found |= ALTITUDE_MAX
        if kinds & ALTITUDE_MIN and self.has_floor and above_m <= p["FENCE_ALT_MIN"]:
            found |= ALTITUDE_MIN
        if kinds & CIRCLE and abs(way_m(home, place)) >= p["FENCE_RADIUS"]:
            found |= CIRCLE
        if kinds & POLYGON and self._zones.forbid(frame, place, union=union):
            found |= POLYGON
        return found

    def check(self, place: Place, home: Place, frame: Frame, now_s: float, *, lands: bool) -> int:
        """Look where the vehicle is; returns the kinds that are breached since just now."""
        p, above_m = self._parameters, place.altitude_amsl_m - home.altitude_amsl_m
        is_safe = above_m >= p["FENCE_ALT_MIN"] + p["FENCE_MARGIN"]
        self.has_floor = not lands and (self.has_floor or is_safe)
        found = self.outside(place, home, frame)
        new = found & ~self.breached
        if new:
            self._breaches += not self.breached
            over_the_edge = new & (CIRCLE | POLYGON)
            self._breach_type = 3 if over_the_edge else 2 if new & ALTITUDE_MAX else 1
            self._breach_s = now_s
        self.breached = found
        return new
