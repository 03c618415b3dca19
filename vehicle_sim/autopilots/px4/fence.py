"""PX4's geofence: polygons and circles, noticed after crossing (px4.md 7).

Setpoints are never checked against it; the targets of DO_REPOSITION are.
"""

import math
from typing import Final, NamedTuple, final

from vehicle_sim.autopilots.px4.projection import Projection
from vehicle_sim.plans import PlanItem, PlanKind, Plans

_POLYGON_IN, _POLYGON_OUT, _CIRCLE_IN, _CIRCLE_OUT = 5001, 5002, 5003, 5004
_POLYGONS: Final = (_POLYGON_IN, _POLYGON_OUT)


@final
class _Zone(NamedTuple):
    """In the local frame; a polygon has no radius, a circle one corner."""

    keeps_in: bool
    corners: tuple[tuple[float, float], ...]
    radius_m: float


def inside_polygon(north_m: float, east_m: float, corners: tuple[tuple[float, float], ...]) -> bool:
    """Even-odd rule."""
    inside = False
    before_n, before_e = corners[-1]
    for corner_n, corner_e in corners:
        if (corner_e > east_m) != (before_e > east_m):
            share = (east_m - corner_e) / (before_e - corner_e)
            if north_m < corner_n + share * (before_n - corner_n):
                inside = not inside
        before_n, before_e = corner_n, corner_e
    return inside


@final
class Fence:
    """The fence as it stands, and whether the vehicle is outside of what it allows."""

    def __init__(self, plans: Plans) -> None:
        self._plans = plans
        self._version = -1
        self._projection: Projection | None = None
        self._zones: tuple[_Zone, ...] = ()
        self.breached = False
        self.breaches = 0

    def check(
        self,
        projection: Projection,
        north_m: float,
        east_m: float,
        *,
        home: tuple[float, float],
        limits: tuple[float, float],
    ) -> bool:
        """Look once; home: distance and height from there; limits: GF_MAX_HOR_DIST, _VER_DIST."""
        allowed = self.allows(projection, north_m, east_m)
        away_m, above_m = home
        most_away_m, most_above_m = limits
        if 0.0 < most_away_m < away_m or 0.0 < most_above_m < above_m:
            allowed = False
        if not allowed and not self.breached:
            self.breaches += 1
        self.breached = not allowed
        return self.breached

    def allows(self, projection: Projection, north_m: float, east_m: float) -> bool:
        """Whether a place is inside any zone that keeps in, and outside all that keep out."""
        self._refresh(projection)
        if not self._zones:
            return True
        kept = keeps = False
        for zone in self._zones:
            within = self._within(zone, north_m, east_m)
            if zone.keeps_in:
                keeps = True
                kept = kept or within
            elif within:
                return False
        return kept or not keeps

    @staticmethod
    def _within(zone: _Zone, north_m: float, east_m: float) -> bool:
        if zone.radius_m > 0.0:
            centre_n, centre_e = zone.corners[0]
            return math.hypot(north_m - centre_n, east_m - centre_e) <= zone.radius_m
        return inside_polygon(north_m, east_m, zone.corners)

    def _refresh(self, projection: Projection) -> None:
        if self._version == self._plans.version and self._projection is projection:
            return
        self._version, self._projection = self._plans.version, projection
        zones: list[_Zone] = []
        items = self._plans[PlanKind.FENCE]
        index = 0
        while index < len(items):
            item = items[index]
            count = 1
            if item.command in _POLYGONS and math.isfinite(item.parameters[0]):
                count = max(int(item.parameters[0]), 1)
                corners = tuple(_corner(projection, one) for one in items[index : index + count])
                if len(corners) >= 3:
                    zones.append(_Zone(item.command == _POLYGON_IN, corners, 0.0))
            elif item.command in (_CIRCLE_IN, _CIRCLE_OUT) and item.parameters[0] > 0.0:
                corner = (_corner(projection, item),)
                zones.append(_Zone(item.command == _CIRCLE_IN, corner, item.parameters[0]))
            index += count
        self._zones = tuple(zones)


def _corner(projection: Projection, item: PlanItem) -> tuple[float, float]:
    return projection.to_local(item.x * 1e-7, item.y * 1e-7)
