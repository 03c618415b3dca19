"""Entry types of journal.jsonl: these declarations are its schema (docs/reference/journal.md).

Some events and commands are entries as they are.  The writer takes its fields from these classes
(`of_event` and its like), the reader checks lines against them (`telemetry.journal`), and the page
is generated from them, with the attribute docstrings.  JSON has no infinite numbers: where one may
come up, it is null.
"""

import math
from collections.abc import Iterator
from typing import Annotated, Any, Final, Literal, TypeVar, final

import msgspec
import numpy as np
from msgspec import Meta, Struct

from companion.mission import events
from companion.mission.events import Command, Event
from companion.mission.events import Entry as Entry
from companion.mission.state import State
from companion.path.certificate import Certificate
from companion.path.subpath import Subpath
from companion.planner.request import NotPlanned, Planned, PlanRequest, Rest
from companion.world.zones import CircleZone, PolygonZone, Zone

SCHEMA: Final = "companion-journal"
VERSION: Final = 3
"""The only one that is read; 1 and 2 were written by companions before 0.2.0."""

Value = TypeVar("Value", bound=Struct)
Told = dict[str, Any]
"""An entry as plain values."""
NorthEast = tuple[float, float]
NorthEastAltitude = tuple[float, float, float]


@final
class Header(Struct, frozen=True, kw_only=True):
    """The first line; another one each time the companion was restarted in flight."""

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


UNTOLD: Final = ("misread", "remedy", "altitude_amsl_m", "about")
"""Fields of events and commands that are entries as they are: these are not written."""


# --- the mission


class Phase(Entry, frozen=True, kw_only=True, tag="phase"):
    """The mission is in another phase, or in the same for another reason."""

    phase: str
    """The phase now (docs/reference/mission-states.md)."""
    was: str
    """The phase before."""
    reason: str | None
    """Why it holds or ends, as text; null if there is no reason."""
    code: str | None
    """The reason's name, which stays the same if its text is improved."""


class LegBegun(Entry, frozen=True, kw_only=True, tag="leg"):
    """The vehicle begins the next subpath: the newest one that was ready."""

    number: int
    """Counted from 1."""


class PathLeft(Entry, frozen=True, kw_only=True, tag="path_left"):
    """The vehicle has left the tube about its path that was proven."""

    left_path_m: float
    """How far it was outside then: beyond its tracking error."""


class StopsOnPath(Entry, frozen=True, kw_only=True, tag="stops on path"):
    """It is to stop before the end of its leg; once it stands it holds for that (`phase`)."""

    reason: str
    """Why, as text."""
    code: str
    """The reason's name."""
    at_m: float
    """Where: so far along the leg."""


class Resumed(Entry, frozen=True, kw_only=True, tag="resumed"):
    """The companion was restarted, and resumes the flight."""

    phase: str | None
    """The phase stored by the previous companion (its name in capitals)."""
    lost: str | None = None
    """Why the checkpoint could not be read; omitted if it could."""
    map_lost: str | None = None
    """Why the known map could not be read; omitted if it could."""


# --- scans and subpaths


class ScanAsked(Entry, frozen=True, kw_only=True, tag="scan"):
    """A scan was requested from the radar."""

    centre_nea_m: NorthEastAltitude
    """From where."""
    blocks: int
    """Of 4 x 4 cells, asked for."""


class ScanDone(Entry, frozen=True, kw_only=True, tag="scan done"):
    """The scan is complete, or as complete as it gets."""

    blocks_asked: int
    """Of 4 x 4 cells."""
    blocks_answered: int
    """The others stay unknown."""
    registration_m: float
    """How far cells may be displaced."""
    cells_seen: int
    """Of the known map, so far."""


class PlanAsked(Entry, frozen=True, kw_only=True, tag="plan asked"):
    """A plan for the next subpath was requested."""

    plan_id: int
    """Number of the request, repeated in the answer."""
    due_s: float
    """Vehicle time at which the answer takes effect, never earlier."""
    attempt: int
    """Number of failed attempts before."""
    rest: Rest | None = None
    """The alternative: fly the rest of the leg, stop, and continue from there; null at rest."""
    from_rest: bool
    """Whether it starts from a hover, in any direction."""
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


class PlanReady(Entry, frozen=True, kw_only=True, tag="plan ready", omit_defaults=True):
    """A subpath was found: the answer to `plan asked`, when it takes effect."""

    plan_id: int
    """Of the request."""
    kernel: str
    """`numba` and a digest of this processor's arithmetic; `numpy` in profile `paper`."""
    evaluations: int
    """Candidates evaluated."""
    tries: int
    """Searches, each wider than the one before."""
    rank: int
    """Its rank by cost; more than 0: cheaper candidates could not be proven."""
    cost: float | None
    """Eq. 5."""
    to_go: float | None
    """Cost-to-go from its end, in the same unit."""
    terms: dict[str, float | None]
    """The cost terms by name, 0 to 100; empty for an escape path, which has no cost."""
    guide_rad: float
    """Guide direction: from the local frame's north, clockwise."""
    reaches_target: bool
    """Whether it ends at the target."""
    length_m: float
    """Of the curve."""
    control_nea_m: Annotated[tuple[NorthEastAltitude, ...], Meta(min_length=4)]
    """Control points of a clamped cubic B-spline with evenly spaced inner knots."""
    certificate: Certificate
    """Its certificate."""
    speed_m_s: float | None = None
    """The highest speed that it is proven for; left out: V."""
    out_of_time: bool = False
    """Whether time was up before the search was done (real time only)."""

    @property
    def subpath(self) -> Subpath:
        """The curve."""
        return Subpath(control_nea_m=np.array(self.control_nea_m, dtype=np.float64))


class PlanRefused(Entry, frozen=True, kw_only=True, tag="plan refused", omit_defaults=True):
    """No subpath was found: the answer to `plan asked`."""

    plan_id: int
    """Of the request."""
    reason: str
    """Name of the refusal: NOTHING_SAFE, ..."""
    broken: tuple[str, ...]
    """Bounds that the best candidate breaks."""
    evaluations: int
    """Candidates evaluated."""
    place_ne_m: tuple[float, float] | None = None
    """North and east of where all routes are blocked; with NO_WAY only."""
    out_of_time: bool = False
    """Whether time was up before the search was done (real time only)."""


# --- what others want


class CommandHeard(Entry, frozen=True, kw_only=True, tag="command"):
    """A MAVLink command to the companion, and the answer."""

    sender: str
    """System and component id: "255/190"; "terminal": a yes that was typed."""
    command: int
    """MAV_CMD."""
    order: str | None = None
    """Its order; omitted if it is none."""
    result: str | None = None
    """MAV_RESULT of the answer, as text; omitted for an order, which is decided later."""
    why: str | None = None
    """Why it was refused; may be empty; omitted for an order."""


class OrderGiven(Entry, frozen=True, kw_only=True, tag="order"):
    """An order to the companion that was accepted."""

    order: Literal["START", "PAUSE", "CONTINUE", "REPOSITION", "RETURN", "LAND"]
    """The order."""
    sender: str
    """System and component id of the sender: "255/190"; or "terminal"."""
    target_ne_m: NorthEast | None
    """Where to go (REPOSITION)."""


# --- the vehicle


class VehicleFound(Entry, frozen=True, kw_only=True, tag="vehicle found"):
    """The first heartbeat of the autopilot."""

    system_id: int
    """MAVLink system id."""
    name: str
    """Autopilot and vehicle type."""


class VehicleSays(Entry, frozen=True, kw_only=True, tag="vehicle says"):
    """A STATUSTEXT of the autopilot."""

    text: str
    """As it was sent."""


class Acknowledged(Entry, frozen=True, kw_only=True, tag="acknowledged"):
    """A COMMAND_ACK of the autopilot."""

    command: int
    """MAV_CMD."""
    result: int
    """MAV_RESULT."""


class AnotherCompanion(Entry, frozen=True, kw_only=True, tag="another companion"):
    """Another sender uses the companion's system and component id."""


# --- what the companion does


class SetpointRefused(Entry, frozen=True, kw_only=True, tag="setpoint refused"):
    """A setpoint was out of range and not sent."""

    setpoint: str
    """All of it, as Python prints it."""


KINDS: Final[dict[str, type[Entry]]] = {
    str(tag): kind
    for kind in (*Entry.__subclasses__(), *events.Command.__subclasses__())
    if (tag := kind.__struct_config__.tag) != kind.__name__
}
"""Those with a tag by that, their name in the file, in the order of docs/reference/journal.md."""


def plain(value: Any) -> Any:
    """For `msgspec`: numbers and arrays of numpy as Python's own."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__}: nothing that a file can hold")


def entry_of(values: dict[str, Any]) -> Entry:
    """Decode an entry; KeyError: unknown kind; msgspec.ValidationError."""
    kind = KINDS[values["kind"]]
    if kind is PlanReady and isinstance(proven := values.get("certificate"), dict):
        known = {name: math.nan if number is None else number for name, number in proven.items()}
        values = {**values, "certificate": known}
    return msgspec.convert(values, kind, strict=False, dec_hook=zone_of)  # an int may be 1.0


def zone_of(_: type, values: Any) -> Zone:
    """A circle or a polygon, which only their fields tell apart."""
    if isinstance(values, dict) and "vertices_ne_m" in values:
        return msgspec.convert(values, PolygonZone)
    return msgspec.convert(values, CircleZone)


# --- what is written: the fields of an entry, as plain values


def of_event(event: Event, state: State) -> Told | None:
    """The entry of an event, None for those only in the telemetry log; state: after the event."""
    if isinstance(event, Entry):
        return _values(event)
    match event:
        case events.ScanDone():
            return _entry(
                ScanDone,
                event.scan,
                blocks_asked=event.asked,
                blocks_answered=event.answered,
                cells_seen=int(state.flight.known.seen.sum()),
            )
        case events.PlanReady(outcome=Planned() as planned):
            late = planned.stopped_after is not None
            return _entry(PlanReady, planned, planned.subpath, out_of_time=late)
        case events.PlanReady(outcome=NotPlanned() as refused):
            late, reason = refused.stopped_after is not None, refused.refusal.name
            return _entry(PlanRefused, refused, reason=reason, out_of_time=late)
        case events.DuplicateId(certain=True, news=True):
            return _entry(AnotherCompanion)
        case events.Order():
            return _entry(OrderGiven, event, order=event.kind.name)
        case _:
            return None


def of_change(before: State, after: State) -> Iterator[Told]:
    """The entries of the mission's progress."""
    if after.phase is not before.phase or after.reason is not before.reason:
        reason = after.reason
        text, code = (None, None) if reason is None else (reason.text, reason.name)
        yield _entry(Phase, phase=after.phase, was=before.phase, reason=text, code=code)
    path, was_on = after.path, before.path
    if path is not None and path.outside_m and not (was_on is not None and was_on.outside_m):
        yield _entry(PathLeft, left_path_m=path.outside_m)
    stop, was_to = path and path.stop, was_on and was_on.stop
    if stop and not (was_to and was_to.reason is stop.reason):
        reason = stop.reason
        yield _entry(StopsOnPath, reason=reason.text, code=reason.name, at_m=stop.at_m)
    if after.flight.legs_flown != before.flight.legs_flown:
        yield _entry(LegBegun, number=after.flight.legs_flown)


def of_command(command: Command) -> Told | None:
    """The entry of a command; None for those that are only in the telemetry log."""
    return _values(command) if command.kind in KINDS else None


def of_request(request: PlanRequest, due_s: float) -> Told:
    """The entry of a plan request."""
    start, start_nea_m = request.start, request.start.position_nea_m
    return _entry(PlanAsked, request, start, due_s=due_s, start_nea_m=start_nea_m)


def filled(kind: type[Value], *sources: object, **others: Any) -> Value:
    """A value of that kind: its fields are others, or of that name in one of the sources."""
    names = kind.__struct_fields__
    values = {name: getattr(of, name) for of in sources for name in names if hasattr(of, name)}
    return kind(**{**values, **others})


def _entry(kind: type[Entry], *sources: object, **others: Any) -> Told:
    """An entry without its time, as `filled`."""
    return _values(filled(kind, *sources, **{"time_s": 0.0, **others}))


def _values(entry: Entry) -> Told:
    """Its fields, but for the time, which is added where it is noted."""
    values: Told = msgspec.to_builtins(entry, enc_hook=plain)
    for name in ("t_s", *UNTOLD):
        values.pop(name, None)
    return values
