"""What automatic modes fly: legs, one after the other.

A return is some of them; a mission gives them item by item, and does what is no leg on the way.
"""

import enum
import math
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple, final

from vehicle_sim.autopilot import values
from vehicle_sim.autopilot.values import Place
from vehicle_sim.plans import PlanItem

WAYPOINT, LOITER_UNLIM, _, LOITER_TIME, RETURN, LAND, TAKEOFF = range(16, 23)
_JUMP, _CHANGE_SPEED = 177, 178
_WALKS_MOST: Final = 1000  # items at once, so that a mission of jumps alone ends

Does = enum.Enum("Does", "CLIMB GO LAND RETURN")
"""What there is to do at a leg's place: come to its height without going there, pass or stay,
land, or whatever the vehicle does to come home."""
_DOES: Final = dict.fromkeys((WAYPOINT, LOITER_UNLIM, LOITER_TIME), Does.GO) | dict(
    zip((TAKEOFF, LAND, RETURN), (Does.CLIMB, Does.LAND, Does.RETURN), strict=True)
)


@final
class Leg(NamedTuple):
    """A place to fly to, and what to do there."""

    does: Does
    place: Place
    hold_s: float = 0.0
    """To stay; infinite: for good."""
    command: int = WAYPOINT
    """Of the item that it is made of; RETURN or 0: it is of none."""
    acceptance_m: float = math.nan
    """How near is there; NaN: by the vehicle's own parameter."""
    yaw_rad: float = math.nan
    """NaN: along the way."""


def back(place: Place, home: Place, altitude_amsl_m: float, hold_s: float) -> list[Leg]:
    """Up to this height, over home, wait there and land."""
    above, climb = home.at(altitude_amsl_m), place.at(altitude_amsl_m)
    legs = ((Does.CLIMB, climb, 0.0), (Does.GO, above, 0.0), (Does.GO, above, hold_s))
    return [Leg(*leg, command=RETURN) for leg in (*legs, (Does.LAND, home, 0.0))]


def leg_of(item: PlanItem, here: Place, home: Place, ground_amsl_m: float) -> Leg | None:
    """What an item is to fly; None: nothing.  Without coordinates it is here.

    A take-off goes straight up, and to the place of a landing at the present height.
    """
    command, (first, second, _, yaw_deg) = item.command, item.parameters
    if command not in _DOES:
        return None
    height_m = values.height_amsl_m(item.frame, item.z_m, home.altitude_amsl_m, ground_amsl_m)
    if height_m is None or not abs(item.z_m) <= values.HIGHEST_M:  # nor is NaN
        height_m = here.altitude_amsl_m
    place = Place(item.x * 1e-7, item.y * 1e-7, height_m) if item.x or item.y else here.at(height_m)
    if command == TAKEOFF:
        place = here.at(max(height_m, here.altitude_amsl_m))
    elif command == LAND:
        place = place.at(here.altitude_amsl_m)
    first = max(0.0, first)  # nor is it NaN
    hold_s = {WAYPOINT: first, LOITER_TIME: first, LOITER_UNLIM: math.inf}.get(command, 0.0)
    acceptance_m = second if command == WAYPOINT and second > 0.0 else math.nan
    yaw_rad = math.radians(yaw_deg) if math.isfinite(yaw_deg) else math.nan
    return Leg(_DOES[command], place, hold_s, command, acceptance_m, yaw_rad)


@final
class Route:
    """The legs that are flown now.  Mutable."""

    def __init__(self, first_item: int) -> None:
        self.leg: Leg | None = None
        """None: nothing; hold."""
        self.current = 0
        """Item of the mission that is flown, or would be."""
        self.complete = False
        self.began_s = 0.0
        """When the leg did."""
        self.arrived_s: float | None = None
        self._next: list[Leg] = []
        self._first_item = first_item
        self._jumps: dict[int, int] = {}  # how often each item has been jumped from

    def fly(self, legs: Iterable[Leg], now_s: float) -> None:
        """These, and no mission."""
        self._next = list(legs)
        self.go_on(now_s)

    def stop(self) -> None:
        """Nothing any more."""
        self.leg, self._next = None, []

    @property
    def lands(self) -> bool:
        """It comes down: at the end of a return, and where a mission has come to a landing."""
        leg = self.leg
        if leg is None or leg.does is not Does.LAND:
            return False
        return leg.command == RETURN or self.arrived_s is not None

    def go_on(self, now_s: float) -> None:
        """The next leg of those begins."""
        self.leg = self._next.pop(0) if self._next else None
        self.began_s, self.arrived_s = now_s, None

    # --- a mission ----------------------------------------------------------------------------

    def rewind(self, number: int = 0) -> None:
        """Make this the current item; jumps count from 0 again."""
        self.current, self.complete = number, False
        self._jumps.clear()

    def seek(
        self,
        items: tuple[PlanItem, ...],
        number: int,
        about: tuple[Place, Place, float],
        now_s: float,
    ) -> float | None:
        """Fly the mission from this item on; returns the speed that was asked for on the way.

        about: where the vehicle is, home, and how high the ground is.
        """
        speed_m_s: float | None = None
        self.stop()
        self.began_s, self.arrived_s, self.complete = now_s, None, False
        for at, item in self._walk(items, number):
            if item.command == _CHANGE_SPEED and 0.0 < item.parameters[1] < math.inf:
                speed_m_s = item.parameters[1]
            self.leg = leg_of(item, *about)
            if self.leg is not None:
                self.current = at
                return speed_m_s
        self.current, self.complete = max(len(items) - 1, 0), bool(items)
        return speed_m_s

    def _walk(self, items: tuple[PlanItem, ...], number: int) -> Iterator[tuple[int, PlanItem]]:
        """Items from this one on, with their numbers: one after the other, but for jumps."""
        for _ in range(_WALKS_MOST):
            if number >= len(items):
                return
            item = items[number]
            yield number, item
            target, times = item.parameters[:2]
            taken = self._jumps.get(number, 0)
            leads = item.command == _JUMP and self._first_item <= target < len(items)
            if leads and (times < 0.0 or taken < times < math.inf):
                self._jumps[number], number = taken + 1, int(target)
            else:
                number += 1
