"""A mission: what is known in advance, as the mission machine needs it."""

import enum
from dataclasses import dataclass
from typing import final

from companion.geodesy import LocalFrame
from companion.planner.settings import Task


class EndAction(enum.Enum):
    """What the vehicle does at the last target."""

    HOLD = "hold"
    LAND = "land"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Mission:
    """Targets, and the task of getting there."""

    name: str
    frame: LocalFrame
    targets_ne_m: tuple[tuple[float, float], ...]
    task: Task
    end_action: EndAction
    system_id: int
    """MAVLink system id of the vehicle."""
    scanner_component_id: int
    """MAVLink component id of its terrain radar."""
    position_rate_hz: float
    """Rate at which the vehicle's position is asked for; one setpoint answers each position."""

    @property
    def take_off_amsl_m(self) -> float:
        """Where the climb-out ends: the floor of the band, plus what the vehicle may sink below.

        Never lower than paths are planned: the first begins here.
        """
        limits = self.task.limits
        lowest_m, _ = self.task.band_amsl_m
        return max(limits.floor_amsl_m + 2.0 * limits.tracking_error_m, lowest_m)
