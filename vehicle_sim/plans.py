"""Mission, fence and rally points as they are stored: what the mission protocol moves."""

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final


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


def zones_of(items: Sequence[PlanItem]) -> list[Sequence[PlanItem]]:
    """The items of each zone.

    A circle is one item and has a radius, a polygon has as many as its first one says, at least
    three; what is not whole draws nothing.
    """
    zones, at = list[Sequence[PlanItem]](), 0
    while at < len(items):
        command, size = items[at].command, items[at].parameters[0]
        is_circle = command in (CIRCLE_IN, CIRCLE_OUT) and size > 0.0
        is_polygon = command in (POLYGON_IN, POLYGON_OUT) and 3.0 <= size < len(items) - at + 1.0
        zone = items[at : at + (int(size) if is_polygon else 1)]
        if is_circle or (is_polygon and all(item.command == command for item in zone)):
            zones.append(zone)
            at += len(zone)
        else:
            at += 1
    return zones


def is_whole_fence(items: Sequence[PlanItem]) -> bool:
    """Whether every item is part of a zone, but for return points."""
    drawn = sum(map(len, zones_of(items)))
    return drawn == sum(item.command != RETURN_POINT for item in items)
