"""Waypoint, fence and rally lists as Mission Planner, MAVProxy and QGroundControl save them.

"QGC WPL 110" has one item a line, which pymavlink reads; line 0 of a mission is launch
(mavlink.io, "File Formats").
"""

import math
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Final

from companion.errors import InputError
from companion.sources.files import answer, read_text
from companion.sources.plan_file import Ground, Item, Items, Plan, check_place, launch_of

_HEAD: Final = "QGC WPL"
_REMEDY: Final = "Save it again with Mission Planner, MAVProxy or QGroundControl."
_AMSL: Final = (0, 5)  # MAV_FRAME
_RETURN_POINT, _RALLY = 5000, 5100
_CORNERS: Final = {5001: True, 5002: False}
_CIRCLES: Final = {5003: True, 5004: False}
"""MAV_CMD_NAV_FENCE_*: whether the vehicle stays inside."""
_MOST_CORNERS: Final = 100_000
_Labelled = tuple[str, Item]
"""How an item is called in errors, and the item."""


def is_waypoint_list(path: Path) -> bool:
    """Whether the file says of itself that it is one, whatever its name is."""

    def begins() -> bool:
        with path.open("rb") as file:
            return file.read(64).removeprefix(b"\xef\xbb\xbf").lstrip().startswith(_HEAD.encode())

    return answer(path.is_file) and answer(begins)


def read_waypoint_list(path: Path, where: str, ground: Ground | None = None) -> Plan:
    """The waypoints, fence and rally points of a list, as a plan; ground: as for `read_plan`.

    Raises InputError about the field (where), or naming the item that cannot be taken.
    """
    items = _items(path, where)
    remedy = "Set home before you save it. (A list of zones alone: name it as threats.)"
    if not items or _is_of_zones(items[0][1]):
        rule = "launch, its first item, has no latitude and longitude"
        raise InputError(where, path.name, rule, remedy)
    label, home = items.pop(0)
    latitude, longitude, altitude = launch_of(home.params[4:], f"{label} (launch)", remedy)
    plan = _plan(path.name, (latitude, longitude), altitude)
    if home.frame not in _AMSL:
        said = f"of frame {home.frame}, is taken to be above mean sea level"
        plan.notes.append(f"launch: its altitude, {altitude:g} m {said}")
    return _filled(plan, items, ground)


def read_waypoint_fence(path: Path, where: str) -> Plan:
    """The fence in such a list, which may lack a launch; InputError as above."""
    items = _items(path, where)
    if items and not _is_of_zones(items[0][1]):
        items.pop(0)
    return _filled(_plan(path.name, (math.nan, math.nan), math.nan), items, None)


def _plan(name: str, home_deg: tuple[float, float], home_amsl_m: float) -> Plan:
    return Plan(
        name=name,
        kind=None,
        speed_m_s={"copter": None, "plane": None},
        home_deg=home_deg,
        home_amsl_m=home_amsl_m,
    )


def _filled(plan: Plan, items: list[_Labelled], ground: Ground | None) -> Plan:
    reader = Items(plan, ground)
    for label, item in _not_of_zones(plan, items):
        reader.take(item, label)
    reader.finish()
    return plan


def _items(path: Path, where: str) -> list[_Labelled]:
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
    found = []
    for number, item in enumerate(loader.wpoints):
        label = f"{path.name}: item {number}"
        numbers = item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z
        if any(map(math.isinf, numbers)):
            raise InputError(label, [*numbers], "it is made of finite numbers", _REMEDY)
        table = {
            "command": item.command,
            "frame": item.frame,
            "params": [None if math.isnan(number) else number for number in numbers],
            "autoContinue": item.autocontinue != 0,
        }
        found.append((label, Item.model_validate(table)))
    return found


def _is_of_zones(item: Item) -> bool:
    """Whether it is of a fence or a rally point, and not of a mission."""
    return _RETURN_POINT <= (item.command or 0) <= _RALLY


def _not_of_zones(plan: Plan, items: list[_Labelled]) -> Iterator[_Labelled]:
    """Add circles, polygons, whose corners follow one another, and rally points; other items."""
    rest = iter(items)
    for label, item in rest:
        command, size = item.command or 0, item.params[0] or 0.0
        number = len(plan.keep_ins) + len(plan.keep_outs) + 1
        if command in _CORNERS:
            if not 3.0 <= size <= _MOST_CORNERS:
                raise InputError(label, size, "a polygon has 3 corners", _REMEDY)
            corners = [item, *(corner for _, corner in islice(rest, math.ceil(size) - 1))]
            same = [c for c in corners if (c.command, c.params[0]) == (command, size)]
            if len(same) != size:
                rule = f"its polygon has {len(same)} of {size:g} corners"
                raise InputError(label, size, rule, _REMEDY)
            shape = {"vertices_deg": [_place_deg(corner, label) for corner in corners]}
            plan.add_zone(f"fence polygon {number}", shape, inside=_CORNERS[command])
        elif command in _CIRCLES:
            latitude, longitude = _place_deg(item, label)
            if not size > 0.0:
                raise InputError(label, size, "a circle has a radius above 0", _REMEDY)
            circle = {"latitude_deg": latitude, "longitude_deg": longitude, "radius_m": size}
            plan.add_zone(f"fence circle {number}", circle, inside=_CIRCLES[command])
        elif command == _RALLY:
            plan.add_rally_point(*_place_deg(item, label))
        elif command != _RETURN_POINT:
            yield label, item


def _place_deg(item: Item, label: str) -> list[float]:
    """Latitude and longitude; InputError naming the item if they are out of range."""
    latitude, longitude = item.params[4:6]
    check_place(latitude, longitude, label)
    assert latitude is not None
    assert longitude is not None
    return [latitude, longitude]
