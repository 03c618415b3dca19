"""Waypoint, fence and rally lists as Mission Planner, MAVProxy and QGroundControl save them.

"QGC WPL 110" has one item a line, which pymavlink reads; line 0 of a mission is launch
(mavlink.io, "File Formats").
"""

import math
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from companion.errors import InputError
from companion.mavlink.dialect import wire
from companion.sources.files import read_text
from companion.sources.plan_file import AMSL, Ground, Item, Plan, launched, place_deg

_HEAD: Final = "QGC WPL"
_REMEDY: Final = "Save it again with Mission Planner, MAVProxy or QGroundControl."
_CORNERS: Final = {
    wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}
_CIRCLES: Final = {
    wire.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: True,
    wire.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: False,
}
"""Whether the vehicle stays inside."""
_RETURN_POINT, _RALLY = wire.MAV_CMD_NAV_FENCE_RETURN_POINT, wire.MAV_CMD_NAV_RALLY_POINT
_Labelled = tuple[str, Item]
"""How an item is called in errors, and the item."""


def read_waypoint_list(path: Path, where: str, ground: Ground | None = None) -> Plan:
    """The waypoints, fence and rally points of a list, as a plan; ground: as for `read_plan`.

    Raises InputError about the field (where), or naming the item that cannot be taken.
    """
    items = _items(path, where)
    remedy = "Set home before you save it. (A list of zones alone: name it as threats.)"
    if not items or _is_of_zones(items[0][1]):
        rule = "launch, its first item, has no latitude and longitude"
        raise InputError(where, path.name, rule, remedy)
    label, home = items.popleft()
    plan = launched(path.name, home.place, f"{label} (launch)", remedy)
    if home.frame not in AMSL:
        said = f"of frame {home.frame}, is taken to be above mean sea level"
        plan.notes.append(f"launch: its altitude, {plan.home_amsl_m:g} m {said}")
    plan.add_items(_without_zones(items, plan), ground)
    return plan


def read_waypoint_fence(path: Path, where: str) -> Plan:
    """The fence in such a list, which may lack a launch; InputError as above."""
    items = _items(path, where)
    plan = Plan(name=path.name, home_deg=(math.nan, math.nan), home_amsl_m=math.nan)
    if items and not _is_of_zones(items[0][1]):
        items.popleft()
    plan.add_items(_without_zones(items, plan), None)
    count = len(plan.targets)
    plan.notes = [f"{path.name}: its {count} waypoints are not flown"] if count else []
    return plan


def _items(path: Path, where: str) -> deque[_Labelled]:
    """By pymavlink, line by line: its `load` names no line, and takes the locale's encoding."""
    from pymavlink import mavwp  # it is not needed by most missions

    head, *lines = read_text(path, where, _REMEDY).lstrip().splitlines()
    if head.split() != [*_HEAD.split(), "110"]:
        raise InputError(where, head.strip(), f"only {_HEAD} 110 is known", _REMEDY)
    loader = mavwp.MAVWPLoader()
    for number, line in enumerate(lines, start=2):
        try:
            loader._read_waypoints_v110([line])
        except (mavwp.MAVWPError, ValueError) as error:
            label = f"{path.name}: line {number}"
            raise InputError(label, line.strip()[:60], str(error)[:100], _REMEDY) from None
    found = deque[_Labelled]()
    for number, item in enumerate(loader.wpoints):
        label = f"{path.name}: item {number}"
        numbers = [item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z]
        if any(map(math.isinf, numbers)):
            raise InputError(label, numbers, "it is made of finite numbers", _REMEDY)
        given = [None if math.isnan(each) else each for each in numbers]
        goes_on, table = item.autocontinue != 0, {"command": item.command, "frame": item.frame}
        found.append(
            (label, Item.model_validate(table | {"params": given, "autoContinue": goes_on}))
        )
    return found


def _is_of_zones(item: Item) -> bool:
    """Whether it is of a fence or a rally point, and not of a mission."""
    return _RETURN_POINT <= (item.command or 0) <= _RALLY


def _without_zones(items: deque[_Labelled], plan: Plan) -> Iterator[_Labelled]:
    """Add circles, polygons, whose corners follow one another, and rally points; other items."""
    while items:
        label, item = items.popleft()
        command, size = item.command or 0, item.params[0] or 0.0
        number = len(plan.keep_ins) + len(plan.keep_outs) + 1
        if command in _CORNERS:
            corners = [item.place]
            while (
                items
                and len(corners) < size
                and (items[0][1].command, items[0][1].params[0]) == (command, size)
            ):
                corners.append(items.popleft()[1].place)
            if len(corners) != size or size < 3:
                rule = f"its polygon has {len(corners)} of {size:g} corners"
                raise InputError(label, size, rule, _REMEDY)
            plan.add_zone(f"fence polygon {number}", label, _CORNERS[command], *corners)
        elif command in _CIRCLES:
            if not size > 0.0:
                raise InputError(label, size, "a circle has a radius above 0", _REMEDY)
            name, inside = f"fence circle {number}", _CIRCLES[command]
            plan.add_zone(name, label, inside, item.place, radius_m=size)
        elif command == _RALLY:
            plan.rally_points.append(place_deg(item.place, label))
        elif command != _RETURN_POINT:
            yield label, item
