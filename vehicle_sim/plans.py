"""Mission, fence and rally points as they are stored: what the mission protocol moves."""

import enum
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
