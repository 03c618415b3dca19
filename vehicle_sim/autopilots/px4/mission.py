"""PX4's missions: the list of items as legs to fly, one after the other (px4.md 7)."""

import math
from typing import TYPE_CHECKING, Final, NamedTuple, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Say
from vehicle_sim.autopilots.px4.modes import Mode
from vehicle_sim.autopilots.px4.setpoints import height_of
from vehicle_sim.plans import PlanItem, PlanKind

if TYPE_CHECKING:
    from vehicle_sim.autopilots.px4.commander import Commander

WAYPOINT, LOITER, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 17, 18, 19, 20, 21, 22
_LEGS: Final = frozenset({WAYPOINT, LOITER, LOITER_TURNS, LOITER_TIME, LAND, TAKEOFF, 31})
_HIGHEST_M: Final = 1e5
_JUMP, _CHANGE_SPEED = 177, 178
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
    radius_m: float
    """Of a loiter; negative: counter-clockwise, 0: NAV_LOITER_RAD."""
    turns: float
    yaw_rad: float
    """NaN: along the way."""


@final
class Mission:
    """Which item is flown, and what that means.  Mutable."""

    def __init__(self, px4: "Commander") -> None:
        self._px4 = px4
        self.current = 0
        """Item number, as in MISSION_CURRENT."""
        self.leg: Leg | None = None
        """What to fly now; None: nothing (hold)."""
        self._active = self._done = False
        self._arrived_us: int | None = None
        self._jumps: dict[int, int] = {}

    @property
    def items(self) -> tuple[PlanItem, ...]:
        """As uploaded."""
        return self._px4.plans[PlanKind.MISSION]

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
        self._jumps.clear()
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
        leg, now_us = self.leg, self._px4.now_us
        if leg is None:
            return
        if self._arrived_us is None:
            self._arrived_us = now_us
            reached = mavlink.MAVLink_mission_item_reached_message(seq=self.current)
            self._px4.say(Say(message=reached))
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
        for _ in range(2 * len(items) + 2):
            if self.current >= len(items):
                break
            item = items[self.current]
            if item.command == RETURN:
                self.leg = None
                self._px4.follow_item(Mode.RTL)
                return
            if item.command in _LEGS:
                self.leg = self._leg(item)
                return
            self._obey(item)
        self.current = max(len(items) - 1, 0)
        self.leg = None
        self._done = bool(items)

    def _obey(self, item: PlanItem) -> None:
        """DO_ items; those that mean nothing here are passed over."""
        first, second = item.parameters[0], item.parameters[1]
        if item.command == _CHANGE_SPEED and second > 0.0:
            self._px4.speed_m_s = second
        if item.command == _JUMP and math.isfinite(first) and math.isfinite(second):
            done = self._jumps.get(self.current, 0)
            if (second < 0 or done < second) and 0 <= first < len(self.items):
                self._jumps[self.current] = done + 1
                self.current = int(first)
                return
        self.current += 1

    def _leg(self, item: PlanItem) -> Leg:
        first, second, third, fourth = item.parameters
        px4 = self._px4
        estimate = px4.estimate
        home = px4.home or estimate.place
        z_m = item.z_m if abs(item.z_m) <= _HIGHEST_M else math.nan
        height = height_of(item.frame, z_m, home, px4.ground_amsl_m)
        hold = first if item.command in (WAYPOINT, LOITER_TIME) and first > 0.0 else 0.0
        somewhere = bool(item.x or item.y)
        return Leg(
            command=item.command,
            latitude_deg=item.x * 1e-7 if somewhere else estimate.latitude_deg,
            longitude_deg=item.y * 1e-7 if somewhere else estimate.longitude_deg,
            altitude_amsl_m=estimate.altitude_amsl_m
            if height is None or height != height
            else height,
            hold_s=math.inf if item.command == LOITER else hold,
            acceptance_m=second if item.command == WAYPOINT and second > 0.0 else math.nan,
            radius_m=third if item.command in (LOITER, LOITER_TURNS, LOITER_TIME) else 0.0,
            turns=first if item.command == LOITER_TURNS else 0.0,
            yaw_rad=math.radians(fourth) if math.isfinite(fourth) else math.nan,
        )
