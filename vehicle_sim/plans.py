"""Mission, fence and rally points as they are stored: what the mission protocol moves."""

import enum
from collections.abc import Callable, Iterable, Sequence
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


# --- the zones that a fence list draws ------------------------------------------------------------

RETURN_POINT, POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT = range(5000, 5005)
FENCE_COMMANDS = frozenset(range(RETURN_POINT, CIRCLE_OUT + 1))
"""A return point draws no zone."""
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
    """The zones, their corners put where `point` does (by latitude and longitude in degrees).

    A circle is one item and has a radius, a polygon has as many as its first one says, at least
    three; what is not whole draws nothing.
    """
    zones, at = list[Zone](), 0
    while at < len(items):
        command, size = items[at].command, items[at].parameters[0]
        is_circle = command in (CIRCLE_IN, CIRCLE_OUT) and size > 0.0
        is_polygon = command in (POLYGON_IN, POLYGON_OUT) and 3.0 <= size < len(items) - at + 1.0
        part = items[at : at + (int(size) if is_polygon else 1)]
        at += 1
        if is_circle or (is_polygon and all(each.command == command for each in part)):
            corners = tuple(point(each.x * 1e-7, each.y * 1e-7) for each in part)
            keeps_in = command in (POLYGON_IN, CIRCLE_IN)
            zones.append(Zone(keeps_in, corners, size if is_circle else 0.0))
            at += len(part) - 1
    return tuple(zones)


def is_whole_fence(items: Sequence[PlanItem]) -> bool:
    """Whether every item is part of a zone, but for return points."""
    drawn = sum(len(zone.corners) for zone in zones_of(items))
    return drawn == sum(item.command != RETURN_POINT for item in items)


def forbidden(zones: Iterable[Zone], inside: Callable[[Zone], bool], *, union: bool) -> bool:
    """In a zone to be kept out of, or out of one to be kept in (union: out of all of them)."""
    within = [(zone.keeps_in, inside(zone)) for zone in zones]
    kept = [is_in for keeps_in, is_in in within if keeps_in]
    is_out = bool(kept) and not (any(kept) if union else all(kept))
    return is_out or any(is_in for keeps_in, is_in in within if not keeps_in)
