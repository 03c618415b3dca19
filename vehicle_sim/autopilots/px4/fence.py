"""PX4's geofence: polygons and circles, noticed after crossing (px4.md 7).

Setpoints are never checked against it; the targets of DO_REPOSITION are.
"""

import math
from typing import final

from vehicle_sim.autopilots.px4.setpoints import Projection
from vehicle_sim.plans import PlanKind, Plans, Zone, forbidden, zones_of


@final
class Fence:
    """The fence as it stands, and whether the vehicle is outside of what it allows."""

    def __init__(self, plans: Plans) -> None:
        self._plans = plans
        self._version = -1
        self._projection: Projection | None = None
        self._zones: tuple[Zone, ...] = ()
        self.breached = False
        self.breaches = 0

    def note(self, *, breached: bool) -> None:
        """Whether the vehicle is outside of what is allowed now."""
        if breached and not self.breached:
            self.breaches += 1
        self.breached = breached

    def allows(self, projection: Projection, north_m: float, east_m: float) -> bool:
        """Whether a place is inside any zone that keeps in, and outside all that keep out."""
        if self._version != self._plans.version or self._projection is not projection:
            self._version, self._projection = self._plans.version, projection
            self._zones = zones_of(self._plans[PlanKind.FENCE], projection.to_local)

        def inside(zone: Zone) -> bool:
            if zone.radius_m > 0.0:
                centre_n, centre_e = zone.corners[0]
                return math.hypot(north_m - centre_n, east_m - centre_e) <= zone.radius_m
            return zone.surrounds((north_m, east_m))

        return not forbidden(self._zones, inside, union=True)
