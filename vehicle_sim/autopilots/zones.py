"""The zones that a fence list draws: polygons and circles, to be kept in or kept out of."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, final

from vehicle_sim.plans import PlanItem

POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT = 5001, 5002, 5003, 5004
Point = tuple[float, float]
"""In whichever plane a firmware looks at its fence."""


@final
class Zone(NamedTuple):
    """A polygon has no radius, a circle one corner: its centre."""

    keeps_in: bool
    corners: tuple[Point, ...]
    radius_m: float = 0.0

    def surrounds(self, point: Point) -> bool:
        """Of a polygon, by the even-odd rule, so that a self-crossing one has holes."""
        inside = False
        before_a, before_b = self.corners[-1]
        for a, b in self.corners:
            if (a > point[0]) != (before_a > point[0]):
                share = (point[0] - a) / (before_a - a)
                if point[1] < b + share * (before_b - b):
                    inside = not inside
            before_a, before_b = a, b
        return inside


def zones_of(
    items: Sequence[PlanItem], point: Callable[[float, float], Point] = lambda *degrees: degrees
) -> tuple[Zone, ...]:
    """The zones, their corners put where `point` does (by latitude and longitude in degrees)."""
    zones: list[Zone] = []
    index = 0
    while index < len(items):
        item, count = items[index], 1
        first = item.parameters[0]
        if item.command in (POLYGON_IN, POLYGON_OUT) and math.isfinite(first):
            count = max(int(first), 1)
            vertices = items[index : index + count]
            corners = tuple(point(vertex.x * 1e-7, vertex.y * 1e-7) for vertex in vertices)
            if len(corners) >= 3:
                zones.append(Zone(item.command == POLYGON_IN, corners))
        elif item.command in (CIRCLE_IN, CIRCLE_OUT) and first > 0.0:
            centre = point(item.x * 1e-7, item.y * 1e-7)
            zones.append(Zone(item.command == CIRCLE_IN, (centre,), first))
        index += count
    return tuple(zones)


def forbidden(zones: Iterable[Zone], inside: Callable[[Zone], bool], *, union: bool) -> bool:
    """In a zone to be kept out of, or out of one to be kept in (union: out of all of them)."""
    kept: list[bool] = []
    for zone in zones:
        within = inside(zone)
        if zone.keeps_in:
            kept.append(within)
        elif within:
            return True
    return bool(kept) and not (any(kept) if union else all(kept))
