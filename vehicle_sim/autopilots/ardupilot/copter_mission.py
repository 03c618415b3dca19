"""AUTO: the mission, item by item, each a goal for the position controller."""

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from vehicle_sim.autopilots import Place
from vehicle_sim.plans import PlanItem

WAYPOINT, LOITER_UNLIM, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF = (
    16,
    17,
    18,
    19,
    20,
    21,
    22,
)
SPLINE, DELAY = 82, 93
CONDITION_DELAY, CONDITION_YAW, DO_JUMP, DO_CHANGE_SPEED = 112, 115, 177, 178
_NAMES = {
    WAYPOINT: "WP",
    LOITER_UNLIM: "LoitUnlim",
    LOITER_TURNS: "LoitTurns",
    LOITER_TIME: "LoitTime",
    RETURN: "RTL",
    LAND: "Land",
    TAKEOFF: "Takeoff",
    SPLINE: "SplineWP",
    DELAY: "Delay",
    CONDITION_DELAY: "CondDelay",
    CONDITION_YAW: "CondYaw",
    DO_JUMP: "Jump",
    DO_CHANGE_SPEED: "ChangeSpeed",
}
_TERRAIN_FRAMES, _ABOVE_HOME_FRAMES = (10, 11), (3, 6)


class Leg(enum.Enum):
    """What kind of flying an item asks for."""

    TAKEOFF = enum.auto()
    GO = enum.auto()
    CIRCLE = enum.auto()
    LAND = enum.auto()
    RETURN = enum.auto()
    WAIT = enum.auto()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """Where to, and for how long to stay."""

    number: int
    leg: Leg
    place: Place
    hold_s: float = 0.0
    """Infinite: for ever."""
    turns: float = 0.0
    radius_m: float = 0.0


def name_of(command: int) -> str:
    """As the text "Mission: ..." calls an item."""
    return _NAMES.get(command, str(command))


def is_navigation(command: int) -> bool:
    """Whether an item is flown to, and not just done."""
    return command in (
        WAYPOINT, LOITER_UNLIM, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF, SPLINE, DELAY
    )  # fmt: skip


def _whole(value: float) -> int:
    return int(value) if math.isfinite(value) else 0


def _finite(value: float, otherwise: float = 0.0) -> float:
    return value if math.isfinite(value) else otherwise


def place_of(item: PlanItem, here: Place, home: Place) -> Place:
    """Where an item is; without coordinates it is here."""
    altitude_m = min(max(_finite(item.z_m), -1e5), 1e5)
    if item.frame in _ABOVE_HOME_FRAMES:
        altitude_m += home.altitude_amsl_m
    elif item.frame in _TERRAIN_FRAMES:
        altitude_m += 0.0  # no terrain data: the ground is at sea level
    somewhere = (item.x != 0 or item.y != 0) and abs(item.x) <= 900_000_000
    return Place(
        latitude_deg=item.x * 1e-7 if somewhere else here.latitude_deg,
        longitude_deg=item.y * 1e-7 if somewhere else here.longitude_deg,
        altitude_amsl_m=altitude_m,
    )


def goal_of(number: int, item: PlanItem, here: Place, home: Place) -> Goal:
    """What a navigation item asks for."""
    place = place_of(item, here, home)
    p1 = _finite(item.parameters[0])
    match item.command:
        case _ if item.command == TAKEOFF:
            above = Place(
                latitude_deg=here.latitude_deg,
                longitude_deg=here.longitude_deg,
                altitude_amsl_m=max(place.altitude_amsl_m, here.altitude_amsl_m),
            )
            return Goal(number=number, leg=Leg.TAKEOFF, place=above)
        case _ if item.command == LAND:
            there = Place(
                latitude_deg=place.latitude_deg,
                longitude_deg=place.longitude_deg,
                altitude_amsl_m=here.altitude_amsl_m,
            )
            return Goal(number=number, leg=Leg.LAND, place=there)
        case _ if item.command == RETURN:
            return Goal(number=number, leg=Leg.RETURN, place=home)
        case _ if item.command == LOITER_UNLIM:
            return Goal(number=number, leg=Leg.GO, place=place, hold_s=math.inf)
        case _ if item.command == LOITER_TURNS:
            radius_m = min(max(abs(_finite(item.parameters[2])) or 10.0, 1.0), 1e4)
            return Goal(number=number, leg=Leg.CIRCLE, place=place, turns=p1, radius_m=radius_m)
        case _ if item.command == DELAY:
            return Goal(number=number, leg=Leg.WAIT, place=here, hold_s=max(p1, 0.0))
        case _:
            return Goal(number=number, leg=Leg.GO, place=place, hold_s=max(p1, 0.0))


@final
class Mission:
    """Which item is flown, and which comes next; jumps are counted."""

    def __init__(self, items: Sequence[PlanItem]) -> None:
        self.items = items
        self._jumped: dict[int, int] = {}

    def following(self, number: int) -> tuple[int, list[tuple[int, PlanItem]]]:
        """The next navigation item after this one (0: none), and what is done on the way."""
        done: list[tuple[int, PlanItem]] = []
        number += 1
        for _ in range(1000):
            if number >= len(self.items):
                return 0, done
            item = self.items[number]
            if item.command == DO_JUMP:
                number = self._jump(number, item)
                continue
            if is_navigation(item.command):
                return number, done
            done.append((number, item))
            number += 1
        return 0, done

    def _jump(self, number: int, item: PlanItem) -> int:
        target, times = _whole(item.parameters[0]), _whole(item.parameters[1])
        jumped = self._jumped.get(number, 0)
        if not 1 <= target < len(self.items) or 0 <= times <= jumped:
            return number + 1
        self._jumped[number] = jumped + 1
        return target
