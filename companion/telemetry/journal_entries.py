"""Entries of the journal of every other kind, and all kinds together (docs/journal.md).

The models are the schema: the reader checks lines against them, and the page is made from them.
"""

from typing import Annotated, Literal, final

from pydantic import Field

from companion.telemetry.journal_lines import Line, NorthEast, TimedLine
from companion.telemetry.journal_plans import (
    PlanAsked,
    PlanLate,
    PlanReady,
    PlanRefused,
    ScanAsked,
    ScanDone,
)

# --- the mission


@final
class Phase(TimedLine):
    """The mission has moved on, or has another reason to be where it is."""

    kind: Literal["phase"]
    phase: str
    """Where it stands now (docs/mission-states.md)."""
    was: str
    """And before."""
    reason: str | None
    """Why it holds or ends, in words; null: no reason is needed."""
    code: str | None
    """The reason's name: words may be put better, names stay.  Since version 2."""


@final
class LegBegun(TimedLine):
    """The vehicle flies the next subpath: the one that was ready last."""

    kind: Literal["leg"]
    number: int
    """Counted from 1."""


@final
class Resumed(TimedLine):
    """A companion was started again, and goes on."""

    kind: Literal["resumed"]
    phase: str | None
    """Where the mission stood, as the one before has kept it (its name in capitals)."""
    lost: str | None = None
    """Why nothing of that could be read; left out if it could."""
    map_lost: str | None = None
    """Why the known map could not be read; left out if it could."""


@final
class End(TimedLine):
    """The mission is over."""

    kind: Literal["end"]
    outcome: Literal["arrived", "failed", "stopped"]
    """How it has ended."""
    reason: str
    """Why."""


@final
class StopAsked(TimedLine):
    """A person wants the end."""

    kind: Literal["stop asked"]


# --- what others want


@final
class CircleGiven(Line):
    """A zone that is a circle."""

    name: str
    """For people."""
    north_m: float
    """Of its centre."""
    east_m: float
    """Of its centre."""
    radius_m: float
    """Of the circle."""
    keep_in: bool
    """Whether to stay inside, instead of outside."""


@final
class PolygonGiven(Line):
    """A zone that is a polygon."""

    name: str
    """For people."""
    vertices_ne_m: tuple[NorthEast, ...]
    """Its corners."""
    keep_in: bool
    """Whether to stay inside, instead of outside."""


@final
class Fence(TimedLine):
    """The vehicle's own fence, all of it, as it is from now on."""

    kind: Literal["fence"]
    zones: tuple[CircleGiven | PolygonGiven, ...]
    """Circles and polygons."""
    floor_amsl_m: float | None
    """Altitude below which it must not fly; null: it says nothing of that."""
    ceiling_amsl_m: float | None
    """Altitude above which it must not fly; null: it says nothing of that."""


@final
class Targets(TimedLine):
    """The targets, as they are from now on: the vehicle's own mission."""

    kind: Literal["targets"]
    targets_ne_m: tuple[NorthEast, ...]
    """In the order in which they are flown to."""


@final
class Setting(TimedLine):
    """Somebody set a parameter of the planner."""

    kind: Literal["setting"]
    what: str
    """Name = value."""


@final
class OrderGiven(TimedLine):
    """A command for the companion that was accepted, and is obeyed."""

    kind: Literal["order"]
    order: Literal["START", "PAUSE", "CONTINUE", "REPOSITION", "SPEED", "RETURN"]
    """What to do."""
    sender: str
    """System and component id of whoever gave it: "255/190"."""
    target_ne_m: NorthEast | None
    """Where to go (REPOSITION)."""
    speed_m_s: float | None
    """How fast (SPEED)."""


@final
class CommandHeard(TimedLine):
    """A MAVLink command that was addressed to the companion, and what was answered."""

    kind: Literal["command"]
    sender: str
    """System and component id: "255/190"."""
    command: int
    """MAV_CMD."""
    order: str | None = None
    """The order that it means; left out if it means none."""
    result: str | None = None
    """MAV_RESULT of the answer, in words; left out for an order, which is judged later."""
    why: str | None = None
    """Why it was refused; empty if there is nothing to say; left out for an order."""


# --- the vehicle


@final
class VehicleFound(TimedLine):
    """The first heartbeat of the autopilot."""

    kind: Literal["vehicle found"]
    system_id: int
    """MAVLink system id."""
    name: str
    """What it says that it is."""


@final
class Prepared(TimedLine):
    """One of the things that must be looked at before a flight has been."""

    kind: Literal["prepared"]
    item: str
    """What."""
    refusal: str
    """Why the vehicle must not fly as it is; empty if it may."""


@final
class VehicleRebooted(TimedLine):
    """The autopilot's clock has begun again, and with it `t_s`."""

    kind: Literal["vehicle rebooted"]


@final
class VehicleSays(TimedLine):
    """A STATUSTEXT of the autopilot."""

    kind: Literal["vehicle says"]
    text: str
    """As it was sent."""


@final
class Acknowledged(TimedLine):
    """A COMMAND_ACK of the autopilot."""

    kind: Literal["acknowledged"]
    command: int
    """MAV_CMD."""
    result: int
    """MAV_RESULT."""


@final
class LinkDelay(TimedLine):
    """The link has become slower or faster."""

    kind: Literal["link delay"]
    round_trip_s: float
    """To the vehicle and back."""


@final
class LinkLost(TimedLine):
    """Nothing was heard of the vehicle for a while."""

    kind: Literal["link lost"]
    silent_s: float
    """For how long."""


@final
class AnotherCompanion(TimedLine):
    """Somebody else speaks with the companion's own system and component id."""

    kind: Literal["another companion"]


@final
class MessagesDropped(TimedLine):
    """More has arrived than could be handled."""

    kind: Literal["messages dropped"]
    count: int
    """Messages, the oldest ones."""


# --- what the companion does


@final
class ModeAsked(TimedLine):
    """The autopilot is told to change its mode."""

    kind: Literal["set mode"]
    mode: str
    """The companion's word for it: guided, hold, land, return, take off."""


@final
class ArmAsked(TimedLine):
    """The autopilot is told to arm."""

    kind: Literal["arm"]


@final
class TakeOffAsked(TimedLine):
    """The autopilot is told to take off."""

    kind: Literal["take off"]
    above_home_m: float
    """To this height."""


@final
class SetpointRefused(TimedLine):
    """A setpoint was out of range, and was not sent."""

    kind: Literal["setpoint refused"]
    setpoint: str
    """All of it, as Python prints it."""


@final
class Said(TimedLine):
    """What people at ground stations and at the terminal were told."""

    kind: Literal["say"]
    text: str
    """In words."""
    warning: bool
    """Whether something is wrong."""


@final
class PartDied(TimedLine):
    """A part of the companion has died; noted by whoever notices, so perhaps twice."""

    kind: Literal["part died"]
    error: str
    """What it died of."""
    part: str | None = None
    """Which one; noted by the watchdog only."""
    hold_frames: int | None = None
    """How many frames the vehicle was told to hold with; noted by the watchdog only."""


Entry = Annotated[
    Phase
    | LegBegun
    | Resumed
    | End
    | StopAsked
    | Fence
    | Targets
    | Setting
    | OrderGiven
    | CommandHeard
    | VehicleFound
    | Prepared
    | VehicleRebooted
    | VehicleSays
    | Acknowledged
    | LinkDelay
    | LinkLost
    | AnotherCompanion
    | MessagesDropped
    | ScanAsked
    | ScanDone
    | PlanAsked
    | PlanReady
    | PlanRefused
    | PlanLate
    | ModeAsked
    | ArmAsked
    | TakeOffAsked
    | SetpointRefused
    | Said
    | PartDied,
    Field(discriminator="kind"),
]
