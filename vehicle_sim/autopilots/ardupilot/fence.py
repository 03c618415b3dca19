"""ArduPilot's fence: height, circle about home, polygons and circles, inclusion and exclusion.

Source: ardupilot.md 4.  Margins decide only how far the avoidance library keeps away: a breach is
being outside, whatever FENCE_MARGIN says.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

from vehicle_sim.autopilots import Place
from vehicle_sim.autopilots.ardupilot.flat_earth import (
    FLAT_EARTH_M_PER_DEG,
    distance_m,
    longitude_scale,
)
from vehicle_sim.parameters import Parameters
from vehicle_sim.plans import PlanItem, PlanKind, Plans

RETURN_POINT, POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT = 5000, 5001, 5002, 5003, 5004
ALTITUDE_MAX, CIRCLE, POLYGON, ALTITUDE_MIN = 1, 2, 4, 8
NAMES = {
    ALTITUDE_MAX: "Max Alt",
    CIRCLE: "Circle",
    POLYGON: "Polygon",
    ALTITUDE_MIN: "Min Alt",
}
"""By the bits of FENCE_TYPE, as the texts call them."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Polygon:
    """Vertices in degrees: latitude, longitude."""

    vertices_deg: tuple[tuple[float, float], ...]
    inclusion: bool

    def contains(self, latitude_deg: float, longitude_deg: float) -> bool:
        """By the even-odd rule, so that a self-crossing one has holes."""
        inside = False
        before_lat, before_lon = self.vertices_deg[-1]
        for lat, lon in self.vertices_deg:
            if (lat > latitude_deg) != (before_lat > latitude_deg):
                share = (latitude_deg - lat) / (before_lat - lat)
                if longitude_deg < lon + share * (before_lon - lon):
                    inside = not inside
            before_lat, before_lon = lat, lon
        return inside

    def edge_m(self, latitude_deg: float, longitude_deg: float) -> float:
        """Distance to the nearest edge."""
        scale = longitude_scale(latitude_deg)
        points = [
            (
                (lat - latitude_deg) * FLAT_EARTH_M_PER_DEG,
                (lon - longitude_deg) * FLAT_EARTH_M_PER_DEG * scale,
            )
            for lat, lon in self.vertices_deg
        ]
        return min(_to_segment_m(points[k - 1], points[k]) for k in range(len(points)))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Circle:
    """A circle about a place."""

    centre: Place
    radius_m: float
    inclusion: bool

    def depth_m(self, place: Place) -> float:
        """How far inside; negative outside."""
        return self.radius_m - distance_m(self.centre, place)


def _to_segment_m(one: tuple[float, float], other: tuple[float, float]) -> float:
    """From 0, 0 to the segment."""
    along_n, along_e = other[0] - one[0], other[1] - one[1]
    square = along_n * along_n + along_e * along_e
    share = 0.0 if square == 0.0 else -(one[0] * along_n + one[1] * along_e) / square
    share = min(max(share, 0.0), 1.0)
    return math.hypot(one[0] + share * along_n, one[1] + share * along_e)


def _breach_type(kinds: int) -> int:
    if kinds & (CIRCLE | POLYGON):
        return 3
    return 2 if kinds & ALTITUDE_MAX else 1


def shapes(items: Iterable[PlanItem]) -> tuple[list[Polygon], list[Circle]]:
    """What a fence list draws; its rules were checked when it was uploaded."""
    polygons, circles = list[Polygon](), list[Circle]()
    vertices: list[tuple[float, float]] = []
    for item in items:
        latitude_deg, longitude_deg = item.x * 1e-7, item.y * 1e-7
        if item.command in (CIRCLE_IN, CIRCLE_OUT):
            centre = Place(
                latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_amsl_m=0.0
            )
            circles.append(
                Circle(
                    centre=centre,
                    radius_m=item.parameters[0],
                    inclusion=item.command == CIRCLE_IN,
                )
            )
        elif item.command in (POLYGON_IN, POLYGON_OUT):
            vertices.append((latitude_deg, longitude_deg))
            if len(vertices) >= item.parameters[0]:
                polygons.append(
                    Polygon(vertices_deg=tuple(vertices), inclusion=item.command == POLYGON_IN)
                )
                vertices = []
    return polygons, circles


_LOADING_US = 450_000
"""A fence uploaded around the vehicle is breached after half a second (ardupilot.md 4)."""


@final
class Fence:
    """What is fenced now."""

    def __init__(self, parameters: Parameters, plans: Plans) -> None:
        self._parameters = parameters
        self._plans = plans
        self._looks_us = 0
        self.polygons: list[Polygon] = []
        self.circles: list[Circle] = []
        self.enabled = bool(parameters["FENCE_ENABLE"])
        self.breached = 0
        """Bits of FENCE_TYPE."""
        self.breaches = 0
        self.breach_type = 0
        """FENCE_BREACH: 1 too low, 2 too high, 3 over the edge."""
        self.breach_us = 0
        self.load()

    def load(self, now_us: int = 0) -> None:
        """Read the list again; nobody looks at it for a moment after."""
        self._looks_us = now_us + _LOADING_US
        self.polygons, self.circles = shapes(self._plans[PlanKind.FENCE])

    @property
    def present(self) -> bool:
        """Whether there is anything that FENCE_STATUS could tell of."""
        return self.enabled or bool(self.polygons) or bool(self.circles)

    def outside(self, place: Place, home: Place | None) -> int:
        """Which kinds of fence this place would breach: bits of FENCE_TYPE."""
        if not self.enabled or home is None:
            return 0
        parameters = self._parameters
        kinds, found = int(parameters["FENCE_TYPE"]), 0
        above_m = place.altitude_amsl_m - home.altitude_amsl_m
        if kinds & ALTITUDE_MAX and above_m >= parameters["FENCE_ALT_MAX"]:
            found |= ALTITUDE_MAX
        if kinds & CIRCLE and distance_m(home, place) >= parameters["FENCE_RADIUS"]:
            found |= CIRCLE
        if kinds & POLYGON and self._outside_shapes(place):
            found |= POLYGON
        return found

    def _outside_shapes(self, place: Place) -> bool:
        """In an exclusion, or out of an inclusion (out of all of them with FENCE_OPTIONS bit 1)."""
        inside_any, outside_any = False, False
        for polygon in self.polygons:
            inside = polygon.contains(place.latitude_deg, place.longitude_deg)
            if inside and not polygon.inclusion:
                return True
            inside_any |= polygon.inclusion and inside
            outside_any |= polygon.inclusion and not inside
        for circle in self.circles:
            inside = circle.depth_m(place) > 0.0
            if inside and not circle.inclusion:
                return True
            inside_any |= circle.inclusion and inside
            outside_any |= circle.inclusion and not inside
        union = int(self._parameters["FENCE_OPTIONS"]) & 2
        return outside_any and not (union and inside_any)

    def room_m(self, place: Place, home: Place) -> float:
        """Distance to the nearest thing that is fenced, from the permitted side."""
        rooms = [math.inf]
        if int(self._parameters["FENCE_TYPE"]) & POLYGON:
            rooms += [p.edge_m(place.latitude_deg, place.longitude_deg) for p in self.polygons]
            rooms += [abs(circle.depth_m(place)) for circle in self.circles]
        if int(self._parameters["FENCE_TYPE"]) & CIRCLE:
            rooms.append(self._parameters["FENCE_RADIUS"] - distance_m(home, place))
        return min(rooms)

    def check(self, place: Place, home: Place | None, now_us: int) -> int:
        """Look where the vehicle is; returns the kinds that are breached since just now."""
        if now_us < self._looks_us:
            return 0
        found = self.outside(place, home)
        new = found & ~self.breached
        if new and not self.breached:
            self.breaches += 1
        if new:
            self.breach_us, self.breach_type = now_us, _breach_type(new)
        self.breached = found
        return new
