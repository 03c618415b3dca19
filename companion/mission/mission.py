"""A mission: targets, task and options, as the mission machine and the protocols need them."""

import enum
from dataclasses import dataclass
from typing import Annotated, Literal, final

from annotated_types import Ge, Le

from companion.geodesy import LocalFrame
from companion.path.limits import VehicleKind
from companion.planner.settings import Task
from companion.ranges import Positive
from companion.world.known_map import KnownMap
from companion.world.near_map import NearSensor

AutopilotName = Literal["ardupilot", "px4"]
_LEFT = 0.1  # of the vehicle's errors: the lowest band that a path is planned in


class EndAction(enum.Enum):
    """What the vehicle does at the last target."""

    HOLD = "hold"
    LAND = "land"
    RETURN = "return"


class Fallback(enum.Enum):
    """What to do if there is no way on, or the battery will not last (see `stopped`)."""

    HOLD = "hold"
    """Until a pilot takes over."""
    LAND = "land"
    RETURN = "return"
    """Backtrack along the flown path and land; else the autopilot's RTL."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Mission:
    """Targets, and the task of getting there."""

    name: str
    frame: LocalFrame
    targets_ne_m: tuple[tuple[float, float], ...]
    """Empty for a mission that takes them from the vehicle (`targets_from_vehicle`)."""
    altitudes_amsl_m: tuple[float | None, ...] = ()
    """The altitude at which to fly to each target, or higher where the terrain asks for it; None:
    any altitude of the band.  Empty: of none of them."""
    task: Task
    end_action: EndAction
    system_id: Annotated[int, Ge(1), Le(255)] | None = None
    """MAVLink system id of the vehicle; None: the one autopilot that is heard."""
    autopilot: AutopilotName | None = None
    """If the mission is for one of them only."""
    scanner_component_id: int | None = 100
    """MAVLink component id of its terrain radar; None: it has none."""
    scanner_complete: bool = True
    """Whether what the radar does not show is hidden (`Scan.complete`)."""
    near: NearSensor | None = None
    """What looks about horizontally, where that is the scanner, in place of a terrain radar."""
    rangefinder_error_m: Positive | None = None
    """So much nearer than the map says its downward rangefinder may see the ground; None: it is not
    looked at."""
    position_rate_hz: Annotated[float, Ge(2.0), Le(200.0)] = 10.0
    """Rate at which the vehicle's position is asked for; one setpoint answers each position."""
    yaw_rad: float | None = None
    """Fixed heading in the local frame; None: along the path."""
    fallback: Fallback = Fallback.RETURN
    attempts: Annotated[int, Ge(1), Le(100)] = 4
    """Plans in a row, from rest, that may fail before the fallback."""
    known: KnownMap | None = None
    """Terrain known in advance; None: none."""
    reserve: float = 0.2
    """Share of the battery that must be left at the target."""
    endurance_s: Positive | None = None
    """How long a full battery lasts in flight, if that is known in advance."""
    commanders: tuple[tuple[int, int], ...] = ((255, 0), (254, 0))
    """System and component ids (0: any) whose commands the companion obeys."""
    targets_from_vehicle: bool = False
    fence_from_vehicle: bool = True
    goes_on_while_reading: bool = False
    """Whether it flies on while a changed fence is being read, instead of holding."""
    sets_parameters: bool = True
    """Whether parameters of the autopilot that are not safe are set, or only refused."""
    rally_ne_m: tuple[tuple[float, float], ...] = ()
    """Places to return to that a plan names."""
    notes: tuple[str, ...] = ()
    """Assumptions and ignored parts when the mission was read, as text for the operator."""

    @property
    def kind(self) -> VehicleKind:
        """The kind of vehicle that it is for."""
        return self.task.limits.kind

    def task_to(self, target: int, task: Task) -> Task:
        """The task on the way to a target: with its altitude as the lowest to plan for.

        Lowest is cheapest, so that is where it is flown.  task: as it is now; where the vehicle's
        own fence has lowered its ceiling below the altitude, a little of the band is left.
        """
        wanted_m = self.altitudes_amsl_m[target] if target < len(self.altitudes_amsl_m) else None
        if wanted_m is None:
            return task
        return task.no_lower_than(min(wanted_m, task.band_amsl_m[1] - _LEFT * task.error_m))
