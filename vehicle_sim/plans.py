"""Mission, fence and rally points as they are stored: what the mission protocol moves."""

import enum
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, final


class PlanKind(enum.IntEnum):
    """MAV_MISSION_TYPE."""

    MISSION = 0
    FENCE = 1
    RALLY = 2


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlanItem:
    """One MISSION_ITEM_INT; x and y as they were sent, so that they come back exactly."""

    frame: int
    command: int
    parameters: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    x: int = 0
    """Latitude in 1e-7 degrees (of items that have a place)."""
    y: int = 0
    z_m: float = 0.0
    """Measured from what the frame says."""
    autocontinue: bool = True


@final
class Plans:
    """The three lists that an autopilot keeps, also over a reboot."""

    def __init__(self) -> None:
        self._items: dict[PlanKind, tuple[PlanItem, ...]] = dict.fromkeys(PlanKind, ())
        self.version = 0
        """Rises with every change."""

    def __getitem__(self, kind: PlanKind) -> tuple[PlanItem, ...]:
        return self._items[kind]

    def __setitem__(self, kind: PlanKind, items: tuple[PlanItem, ...]) -> None:
        self._items[kind] = items
        self.version += 1


# --- the order of a mission's items: one after the other, but for its jumps -----------------------

DO_JUMP = 177


@final
class Jumps:
    """How often each DO_JUMP has been taken.  Mutable."""

    def __init__(self, first: int) -> None:
        self._first = first
        """Number of the first item that may be jumped to."""
        self._taken: dict[int, int] = {}

    def forget(self) -> None:
        """They count from 0 again."""
        self._taken.clear()

    def walk(
        self, items: Sequence[PlanItem], number: int, most: int
    ) -> Iterator[tuple[int, PlanItem]]:
        """So many items at most, from this one on, with their numbers."""
        for _ in range(most):
            if number >= len(items):
                return
            yield number, items[number]
            number = self._after(items, number)

    def _after(self, items: Sequence[PlanItem], number: int) -> int:
        target, times = items[number].parameters[:2]
        if items[number].command != DO_JUMP or not math.isfinite(target + times):
            return number + 1
        taken = self._taken.get(number, 0)
        if not self._first <= target < len(items) or 0.0 <= times <= taken:
            return number + 1
        self._taken[number] = taken + 1
        return int(target)


# --- the zones that a fence list draws ------------------------------------------------------------

POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT = 5001, 5002, 5003, 5004
FENCE_COMMANDS = frozenset({5000, POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT})
"""With that of a return point, which draws no zone."""
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


def _parts(items: Sequence[PlanItem]) -> Iterator[Sequence[PlanItem]]:
    """Zone by zone: a circle is one item, a polygon as many as its first one says."""
    at = 0
    while at < len(items):
        size = items[at].parameters[0] if items[at].command in (POLYGON_IN, POLYGON_OUT) else 1.0
        count = max(int(size), 1) if math.isfinite(size) else 1
        yield items[at : at + count]
        at += count


def is_whole_fence(items: Sequence[PlanItem]) -> bool:
    """Whether each polygon has all its corners, and each circle a radius."""
    for part in _parts(items):
        command, size = part[0].command, part[0].parameters[0]
        if command in (CIRCLE_IN, CIRCLE_OUT) and not size > 0.0:
            return False
        if command in (POLYGON_IN, POLYGON_OUT) and (
            not 3.0 <= size < len(part) + 1.0 or any(each.command != command for each in part)
        ):
            return False
    return True


def zones_of(
    items: Sequence[PlanItem], point: Callable[[float, float], Point] = lambda *degrees: degrees
) -> tuple[Zone, ...]:
    """The zones, their corners put where `point` does (by latitude and longitude in degrees)."""
    zones: list[Zone] = []
    for part in _parts(items):
        command, radius_m = part[0].command, part[0].parameters[0]
        corners = tuple(point(item.x * 1e-7, item.y * 1e-7) for item in part)
        if command in (POLYGON_IN, POLYGON_OUT) and len(corners) >= 3:
            zones.append(Zone(command == POLYGON_IN, corners))
        elif command in (CIRCLE_IN, CIRCLE_OUT) and radius_m > 0.0:
            zones.append(Zone(command == CIRCLE_IN, corners, radius_m))
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
