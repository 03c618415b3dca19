"""What is flown of a mission's items, and what is not, wherever the mission comes from."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, final

from companion.geodesy import LocalFrame
from companion.mavlink.dialect import enum_word, wire
from companion.mavlink.fence import Point, places_of
from companion.mavlink.plan_client import PlanItem
from companion.mission.mission import EndAction

_WAYPOINTS: Final = (wire.MAV_CMD_NAV_WAYPOINT, wire.MAV_CMD_NAV_SPLINE_WAYPOINT)
_LOITERS: Final = (
    wire.MAV_CMD_NAV_LOITER_TURNS,
    wire.MAV_CMD_NAV_LOITER_TIME,
    wire.MAV_CMD_NAV_LOITER_TO_ALT,
)
PLACES: Final = (*_WAYPOINTS, wire.MAV_CMD_NAV_LOITER_UNLIM, *_LOITERS)
"""Commands that go to a place."""
_OF_WAYPOINTS: Final = (
    "waiting at a waypoint",
    "acceptance radius of a waypoint",
    "passing beside a waypoint",
    "heading at a waypoint",
)
"""Parameters 1 to 4 of a waypoint; 0, like no number, asks for nothing (4: north, which also stands
for nothing in most files)."""


def not_done(command: int, parameters: Sequence[float | None]) -> Iterator[str]:
    """What of an item that goes to a place is left out, in words; parameters: 1 to 4."""
    if command == wire.MAV_CMD_NAV_SPLINE_WAYPOINT:
        yield "spline at a waypoint"
    if command in _LOITERS:
        yield "loiter at a waypoint"
    if command in _WAYPOINTS:
        for value, words in zip(parameters, _OF_WAYPOINTS, strict=False):
            if value is not None and abs(value) > 0.0:  # not what is no number
                yield words


# --- the vehicle's own mission


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """A vehicle's own mission, as far as the companion flies it."""

    targets_ne_m: tuple[Point, ...]
    end_action: EndAction | None = None
    """From its last item; None if that gives none."""
    notes: tuple[str, ...] = ()
    """Items that are ignored, and assumptions."""


_ENDS: Final = {
    wire.MAV_CMD_NAV_LOITER_UNLIM: EndAction.HOLD,
    wire.MAV_CMD_NAV_LAND: EndAction.LAND,
    wire.MAV_CMD_NAV_VTOL_LAND: EndAction.LAND,
    wire.MAV_CMD_NAV_RETURN_TO_LAUNCH: EndAction.RETURN,
}
_TAKE_OFF: Final = (wire.MAV_CMD_NAV_TAKEOFF, wire.MAV_CMD_NAV_VTOL_TAKEOFF)
_LANDINGS: Final = (wire.MAV_CMD_NAV_LAND, wire.MAV_CMD_NAV_VTOL_LAND)


def targets_of(items: Sequence[PlanItem], frame: LocalFrame, *, home_first: bool) -> Targets:
    """The places that a mission goes to, in order, and how it ends.

    home_first: whether item 0 is home and no target.  Heights are not taken: the
    planner chooses them within the mission's band.
    """
    targets: list[Point] = []
    notes: list[str] = []
    left_out = Counter[str]()
    end: EndAction | None = None
    for number, item in list(enumerate(items))[int(home_first) :]:
        if end is not None:
            notes.append(f"items {number} to {len(items) - 1} come after the end: left out")
            break
        if item.command in _TAKE_OFF and not targets:
            continue  # the companion takes off by itself
        name = f"item {number} ({enum_word('MAV_CMD', item.command) or item.command})"
        if item.command in (*PLACES, *_LANDINGS):
            places = places_of((item,), frame)
            if places is not None and (item.x or item.y):
                targets += places
                left_out.update(not_done(item.command, item.parameters))
            elif item.command not in _ENDS:
                notes.append(f"{name} names no place: left out")
        elif item.command not in _ENDS:
            notes.append(f"{name} is not flown: left out")
        end = _ENDS.get(item.command)
    if left_out:
        notes.append(f"left out: {', '.join(f'{n} x {what}' for what, n in left_out.items())}")
    return Targets(targets_ne_m=tuple(targets), end_action=end, notes=tuple(notes))
