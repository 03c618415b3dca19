"""PX4's missions, as legs to fly one after the other, and its geofence (px4.md 7)."""

import math
from collections.abc import Callable
from typing import Final, NamedTuple, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Place, Reply, SendMessage, height_amsl_m
from vehicle_sim.autopilots.px4.modes import Mode
from vehicle_sim.autopilots.px4.setpoints import Projection
from vehicle_sim.plans import Jumps, PlanItem, PlanKind, Plans, Zone, forbidden, zones_of

WAYPOINT, LOITER, _, LOITER_TIME, RETURN, LAND, TAKEOFF = range(16, 23)
_LEGS: Final = frozenset({WAYPOINT, LOITER, LOITER_TIME, LAND, TAKEOFF})
_HIGHEST_M: Final = 1e5
_CHANGE_SPEED = 178
_NO_MISSION, _NOT_STARTED, _ACTIVE, _PAUSED, _COMPLETE = 1, 2, 3, 4, 5


@final
class Leg(NamedTuple):
    """A place to fly to, and what to do there."""

    command: int
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    hold_s: float
    """At a waypoint, or of LOITER_TIME; infinite: for good."""
    acceptance_m: float
    yaw_rad: float
    """NaN: along the way."""


@final
class Surroundings(NamedTuple):
    """What an item is measured from."""

    now_us: int
    here: Place
    home: Place | None
    ground_amsl_m: float


@final
class Mission:
    """Which item is flown, and what that means.  Mutable."""

    def __init__(
        self,
        plans: Plans,
        surroundings: Callable[[], Surroundings],
        say: Callable[[Reply], None],
        obey: Callable[[Mode | float], None],
    ) -> None:
        """`obey`: a mode to fly, or a speed in m/s, that an item asks for."""
        self._plans = plans
        self._surroundings = surroundings
        self._say = say
        self._obey = obey
        self.current = 0
        """Item number, as in MISSION_CURRENT."""
        self.leg: Leg | None = None
        """What to fly now; None: nothing (hold)."""
        self._active = self._done = False
        self._arrived_us: int | None = None
        self._jumps = Jumps(0)

    @property
    def items(self) -> tuple[PlanItem, ...]:
        """As uploaded."""
        return self._plans[PlanKind.MISSION]

    @property
    def total(self) -> int:
        """Of MISSION_CURRENT: 65535 while there is none."""
        return len(self.items) or 65535

    @property
    def state(self) -> int:
        """MISSION_STATE."""
        if not self.items:
            return _NO_MISSION
        if self._done:
            return _COMPLETE
        if self._active:
            return _ACTIVE
        return _PAUSED if self.current else _NOT_STARTED

    def restart(self) -> None:
        """Another list: from its beginning."""
        self.current = 0
        self._done = False
        self._jumps.forget()
        if self._active:
            self.begin()

    def jump(self, number: int) -> bool:
        """MISSION_SET_CURRENT; tells whether there is such an item."""
        if not 0 <= number < len(self.items):
            return False
        self.current, self._done = number, False
        if self._active:
            self.begin()
        return True

    def begin(self) -> None:
        """AUTO:MISSION begins, or goes on, with the current item."""
        self._active = True
        if self._done:
            self.current, self._done = 0, False
        self._arrived_us = None
        self._seek()

    def pause(self) -> None:
        """AUTO:MISSION is left."""
        self._active = False
        self.leg = None

    def arrived(self) -> None:
        """The vehicle is at the leg's place (call it in every step there): wait, then go on."""
        leg = self.leg
        if leg is None:
            return
        now_us = self._surroundings().now_us
        if self._arrived_us is None:
            self._arrived_us = now_us
            reached = mavlink.MAVLink_mission_item_reached_message(seq=self.current)
            self._say(SendMessage(message=reached))
        if now_us - self._arrived_us >= leg.hold_s * 1e6 and leg.command != LAND:
            self.next()

    def next(self) -> None:
        """On to the next item."""
        self.current += 1
        self._arrived_us = None
        self._seek()

    def _seek(self) -> None:
        """Obey items that are no legs until one is, or the end."""
        items = self.items
        for number, item in self._jumps.walk(items, self.current, 2 * len(items) + 2):
            self.current = number
            if item.command == RETURN:
                self.leg = None
                self._obey(Mode.RTL)
                return
            if item.command in _LEGS:
                self.leg = self._leg(item)
                return
            if item.command == _CHANGE_SPEED and item.parameters[1] > 0.0:
                self._obey(item.parameters[1])
        self.current = max(len(items) - 1, 0)
        self.leg = None
        self._done = bool(items)

    def _leg(self, item: PlanItem) -> Leg:
        first, second, _, fourth = item.parameters
        _, here, home, ground_amsl_m = self._surroundings()
        z_m = item.z_m if abs(item.z_m) <= _HIGHEST_M else math.nan
        height = height_amsl_m(item.frame, z_m, (home or here).altitude_amsl_m, ground_amsl_m)
        hold = first if item.command in (WAYPOINT, LOITER_TIME) and first > 0.0 else 0.0
        somewhere = bool(item.x or item.y)
        return Leg(
            command=item.command,
            latitude_deg=item.x * 1e-7 if somewhere else here.latitude_deg,
            longitude_deg=item.y * 1e-7 if somewhere else here.longitude_deg,
            altitude_amsl_m=here.altitude_amsl_m if height is None or height != height else height,
            hold_s=math.inf if item.command == LOITER else hold,
            acceptance_m=second if item.command == WAYPOINT and second > 0.0 else math.nan,
            yaw_rad=math.radians(fourth) if math.isfinite(fourth) else math.nan,
        )


@final
class Fence:
    """Polygons and circles, noticed after crossing.

    Setpoints are never checked against it; the targets of DO_REPOSITION are.
    """

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
