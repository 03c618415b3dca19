"""The lines of journal.jsonl: these declarations are its schema (docs/reference/journal.md).

What is written takes its fields from them (`entries`), the reader checks lines against them
(`telemetry.journal`), and the page is made from them, attribute docstrings included.

Names carry units; `_nea_m` is north, east (of the mission's local frame) and altitude AMSL, metres;
times are the vehicle's clock.  JSON has no infinite numbers: where one may come up, it is null.
"""

import math
from abc import ABC
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, final

import msgspec
import numpy as np
from msgspec import Meta, Struct

from companion.path.certificate import Certificate
from companion.planner.request import Rest
from companion.world.threats import CircleZone, PolygonZone, Zone

SCHEMA: Final = "companion-journal"
VERSION: Final = 3
"""The newest.  What has changed: `telemetry.journal._TO_NEXT`."""

if TYPE_CHECKING:
    AnyZone = Zone
else:

    class AnyZone(ABC):  # noqa: B024 - asked for nothing but whose instance a zone is
        """Both of them: `msgspec` cannot tell two dataclasses apart, `_zone` does."""

    AnyZone.register(CircleZone)
    AnyZone.register(PolygonZone)

NorthEast = tuple[float, float]
NorthEastAltitude = tuple[float, float, float]


@final
class Header(Struct, frozen=True, kw_only=True):
    """The first line; one more each time that the companion was started again in the flight."""

    schema: Literal["companion-journal"]
    """Says that this is a journal of the companion."""
    version: int
    """Of this schema."""
    mission: str
    """The mission's name."""
    seed: int
    """Of the search."""
    profile: Literal["flight", "paper"]
    """How the planner takes the paper."""
    lockstep: bool
    """Whether vehicle and companion waited for each other."""
    resumed: int | None = None
    """How often it had been started again; left out of the first header."""


class Entry(Struct, frozen=True, tag_field="kind"):
    """What happened, or was decided."""

    t_s: float
    """Vehicle time: seconds since its boot (until its clock is known, since the start)."""

    @property
    def kind(self) -> str:
        """The name of its kind in the file."""
        return str(self.__struct_config__.tag)


# --- the mission


@final
class Phase(Entry, frozen=True, tag="phase"):
    """The mission has moved on, or has another reason to be where it is."""

    phase: str
    """Where it stands now (docs/reference/mission-states.md)."""
    was: str
    """And before."""
    reason: str | None
    """Why it holds or ends, in words; null: no reason is needed."""
    code: str | None
    """The reason's name: words may be put better, names stay.  Since version 2."""


@final
class LegBegun(Entry, frozen=True, tag="leg"):
    """The vehicle flies the next subpath: the one that was ready last."""

    number: int
    """Counted from 1."""


@final
class Resumed(Entry, frozen=True, tag="resumed"):
    """A companion was started again, and goes on."""

    phase: str | None
    """Where the mission stood, as the one before has kept it (its name in capitals)."""
    lost: str | None = None
    """Why nothing of that could be read; left out if it could."""
    map_lost: str | None = None
    """Why the known map could not be read; left out if it could."""


@final
class StopAsked(Entry, frozen=True, tag="stop asked"):
    """A person wants the end."""


@final
class End(Entry, frozen=True, tag="end"):
    """The mission is over."""

    outcome: Literal["arrived", "failed", "stopped"]
    """How it has ended."""
    reason: str
    """Why."""


# --- scans and subpaths


@final
class ScanAsked(Entry, frozen=True, tag="scan"):
    """The radar is asked what it sees."""

    centre_nea_m: NorthEastAltitude
    """From where."""
    blocks: int
    """Of 4 x 4 cells, asked for."""


@final
class ScanDone(Entry, frozen=True, tag="scan done"):
    """The radar has answered as far as it will."""

    blocks_asked: int
    """Of 4 x 4 cells."""
    blocks_answered: int
    """The others stay unknown."""
    registration_m: float
    """By how much the cells may lie beside where they belong."""
    cells_seen: int
    """Of the known map, so far."""


@final
class PlanAsked(Entry, frozen=True, tag="plan asked", kw_only=True):
    """The next subpath is asked for."""

    plan_id: int
    """Numbers the questions; the answer names it."""
    due_s: float
    """Vehicle time at which the answer counts, never before."""
    attempt: int
    """How often this was asked in vain."""
    rest: Rest | None = None
    """The other choice: to fly that, to stop, and to leave from there; null: it stands."""
    from_rest: bool
    """Whether it hovers at the start, and may leave in any direction."""
    scan_nea_m: NorthEastAltitude
    """p_scan, where the vehicle is."""
    start_nea_m: NorthEastAltitude
    """p_prog, where the subpath begins."""
    tangent_nea: NorthEastAltitude
    """Direction of the subpath at its start, unit length."""
    curvature_nea_1_m: NorthEastAltitude
    """How it bends there: derivative of the tangent by the length flown, 1/m."""
    target_ne_m: NorthEast
    """Where to."""
    route_ne_m: tuple[NorthEast, ...]
    """The way to the target that the last plan had in mind."""


@final
class PlanReady(Entry, frozen=True, tag="plan ready"):
    """A subpath was found: the answer to `plan asked`, at the time when it counts."""

    plan_id: int
    """Of the question."""
    kernel: str
    """What computed it: `numba` or `numpy`, and a digest of the arithmetic of this processor."""
    evaluations: int
    """Candidates that were looked at."""
    tries: int
    """Searches, each wider than the one before."""
    rank: int
    """Its place among the candidates by cost; more than 0: better ones could not be proven."""
    cost: float | None
    """Eq. 5."""
    to_go: float | None
    """What is left to fly from its end, in the same currency."""
    terms: dict[str, float | None]
    """The cost's terms, by name, 0 to 100; empty: a way out of trouble, not searched for."""
    guide_rad: float
    """Guide direction: from the local frame's north, clockwise."""
    reaches_target: bool
    """Whether it ends at the target."""
    length_m: float
    """Of the curve."""
    control_nea_m: Annotated[tuple[NorthEastAltitude, ...], Meta(min_length=4)]
    """Control points of a clamped cubic B-spline with evenly spaced inner knots."""
    certificate: Certificate
    """What is proven of it."""


@final
class PlanRefused(Entry, frozen=True, tag="plan refused", omit_defaults=True):
    """There is no subpath: the answer to `plan asked`."""

    plan_id: int
    """Of the question."""
    reason: str
    """Name of the refusal: NOTHING_SAFE, ..."""
    broken: tuple[str, ...]
    """Bounds that the best candidate breaks."""
    evaluations: int
    """Candidates that were looked at."""
    place_ne_m: tuple[float, float] | None = None
    """North and east of where the way is closed; with NO_WAY only."""


@final
class PlanLate(Entry, frozen=True, tag="plan late"):
    """A plan was due and not there (in real time)."""

    plan_id: int
    """Of the question."""


# --- what others want


@final
class Fence(Entry, frozen=True, tag="fence"):
    """The vehicle's own fence, all of it, as it is from now on."""

    zones: tuple[AnyZone, ...]
    """Circles and polygons."""
    floor_amsl_m: float | None
    """Altitude below which it must not fly; null: it says nothing of that."""
    ceiling_amsl_m: float | None
    """Altitude above which it must not fly; null: it says nothing of that."""


@final
class Targets(Entry, frozen=True, tag="targets"):
    """The targets, as they are from now on: the vehicle's own mission."""

    targets_ne_m: tuple[NorthEast, ...]
    """In the order in which they are flown to."""


@final
class Setting(Entry, frozen=True, tag="setting"):
    """Somebody set a parameter of the planner."""

    what: str
    """Name = value."""


@final
class CommandHeard(Entry, frozen=True, tag="command"):
    """A MAVLink command that was addressed to the companion, and what was answered."""

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


@final
class OrderGiven(Entry, frozen=True, tag="order"):
    """A command for the companion that was accepted, and is obeyed."""

    order: Literal["START", "PAUSE", "CONTINUE", "REPOSITION", "SPEED", "RETURN"]
    """What to do."""
    sender: str
    """System and component id of whoever gave it: "255/190"."""
    target_ne_m: NorthEast | None
    """Where to go (REPOSITION)."""
    speed_m_s: float | None
    """How fast (SPEED)."""


# --- the vehicle


@final
class VehicleFound(Entry, frozen=True, tag="vehicle found"):
    """The first heartbeat of the autopilot."""

    system_id: int
    """MAVLink system id."""
    name: str
    """What it says that it is."""


@final
class Prepared(Entry, frozen=True, tag="prepared"):
    """One of the things that must be looked at before a flight has been."""

    item: str
    """What."""
    refusal: str
    """Why the vehicle must not fly as it is; empty if it may."""


@final
class VehicleSays(Entry, frozen=True, tag="vehicle says"):
    """A STATUSTEXT of the autopilot."""

    text: str
    """As it was sent."""


@final
class Acknowledged(Entry, frozen=True, tag="acknowledged"):
    """A COMMAND_ACK of the autopilot."""

    command: int
    """MAV_CMD."""
    result: int
    """MAV_RESULT."""


@final
class VehicleRebooted(Entry, frozen=True, tag="vehicle rebooted"):
    """The autopilot's clock has begun again, and with it `t_s`."""


@final
class LinkDelay(Entry, frozen=True, tag="link delay"):
    """The link has become slower or faster."""

    round_trip_s: float
    """To the vehicle and back."""


@final
class LinkLost(Entry, frozen=True, tag="link lost"):
    """Nothing was heard of the vehicle for a while."""

    silent_s: float
    """For how long."""


@final
class AnotherCompanion(Entry, frozen=True, tag="another companion"):
    """Somebody else speaks with the companion's own system and component id."""


@final
class MessagesDropped(Entry, frozen=True, tag="messages dropped"):
    """More has arrived than could be handled."""

    count: int
    """Messages, the oldest ones."""


# --- what the companion does


@final
class ModeAsked(Entry, frozen=True, tag="set mode"):
    """The autopilot is told to change its mode."""

    mode: str
    """The companion's word for it: guided, hold, land, return, take off."""


@final
class ArmAsked(Entry, frozen=True, tag="arm"):
    """The autopilot is told to arm."""


@final
class TakeOffAsked(Entry, frozen=True, tag="take off"):
    """The autopilot is told to take off."""

    above_home_m: float
    """To this height."""


@final
class SetpointRefused(Entry, frozen=True, tag="setpoint refused"):
    """A setpoint was out of range, and was not sent."""

    setpoint: str
    """All of it, as Python prints it."""


@final
class Said(Entry, frozen=True, tag="say"):
    """What people at ground stations and at the terminal were told."""

    text: str
    """In words."""
    warning: bool
    """Whether something is wrong."""


@final
class PartDied(Entry, frozen=True, tag="part died", omit_defaults=True):
    """A part of the companion has died; noted by whoever notices, so perhaps twice."""

    error: str
    """What it died of."""
    part: str | None = None
    """Which one; noted by the watchdog only."""
    hold_frames: int | None = None
    """How many frames the vehicle was told to hold with; noted by the watchdog only."""


KINDS: Final[dict[str, type[Entry]]] = {
    str(kind.__struct_config__.tag): kind for kind in Entry.__subclasses__()
}
"""By their names in the file, in the order of docs/reference/journal.md."""


def plain(value: Any) -> Any:
    """For `msgspec`: numbers and arrays of numpy as Python's own."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__}: nothing that a file can hold")


def entry_of(values: dict[str, Any]) -> Entry:
    """The entry that such values are; KeyError: of no known kind; msgspec.ValidationError."""
    kind = KINDS[values["kind"]]
    if kind is PlanReady and isinstance(proven := values.get("certificate"), dict):
        known = {name: math.nan if each is None else each for name, each in proven.items()}
        values = {**values, "certificate": known}
    return msgspec.convert(values, kind, strict=False, dec_hook=_zone)  # an int may be 1.0


def _zone(_: type, values: Any) -> Zone:
    """A circle or a polygon, which only their fields tell apart."""
    if isinstance(values, dict) and "vertices_ne_m" in values:
        return msgspec.convert(values, PolygonZone)
    return msgspec.convert(values, CircleZone)
