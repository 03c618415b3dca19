"""Waypoint, fence and rally lists as Mission Planner, MAVProxy and QGroundControl save them.

"QGC WPL 110" has one item a line: index, current, frame, command, four parameters, latitude,
longitude, altitude, autocontinue; line 0 of a mission is launch (mavlink.io, "File Formats").
"""

import math
import re
from pathlib import Path
from typing import Final, NamedTuple, final

from companion.errors import InputError
from companion.sources.files import answer, read_text
from companion.sources.plan_file import Ground, Item, Items, Plan, check_place, launch_of

_HEAD: Final = "QGC WPL"
_VERSION: Final = "110"
_REMEDY: Final = "Save it again with Mission Planner, MAVProxy or QGroundControl."
_NOT_GIVEN: Final = re.compile(r"[-+]?nan(\(.*\))?|null|[-+]?1\.#(qnan|snan|ind)\d*", re.IGNORECASE)
"""How programs, those of Windows too, write what is no number: MAVLink's "not given"."""
_AMSL: Final = (0, 5)  # MAV_FRAME
_RETURN_POINT, _CORNER_IN, _CORNER_OUT, _CIRCLE_IN, _CIRCLE_OUT, _RALLY = (
    5000,
    5001,
    5002,
    5003,
    5004,
    5100,
)  # MAV_CMD_NAV_FENCE_*, MAV_CMD_NAV_RALLY_POINT


@final
class _Row(NamedTuple):
    """One line, as numbers."""

    label: str
    frame: int
    command: int
    parameters: tuple[float, ...]
    """Seven of them: four, then latitude, longitude and altitude; nan: not given."""
    goes_on: bool

    @property
    def is_of_zones(self) -> bool:
        """Whether it is of a fence or a rally point, and not of a mission."""
        return _RETURN_POINT <= self.command <= _RALLY

    @property
    def given(self) -> list[float | None]:
        """The parameters as plans have them."""
        return [None if math.isnan(value) else value for value in self.parameters]

    @property
    def place_deg(self) -> tuple[float, float]:
        """Latitude and longitude; InputError naming the line if they are out of range."""
        check_place(self.parameters[4], self.parameters[5], self.label)
        return self.parameters[4], self.parameters[5]


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
    rows = _rows(read_text(path, where, _REMEDY), path.name, where)
    remedy = "Set home before you save it. (A list of zones alone: name it as threats.)"
    if not rows or rows[0].is_of_zones:
        rule = "launch, its first item, has no latitude and longitude"
        raise InputError(where, path.name, rule, remedy)
    home = rows.pop(0)
    latitude, longitude, altitude = launch_of(home.given[4:], f"{home.label} (launch)", remedy)
    plan = _plan(path.name, (latitude, longitude), altitude)
    if home.frame not in _AMSL:
        said = f"of frame {home.frame}, is taken to be above mean sea level"
        plan.notes.append(f"launch: its altitude, {altitude:g} m {said}")
    return _filled(plan, rows, ground)


def read_waypoint_fence(path: Path, where: str) -> Plan:
    """The fence in such a list, which may lack a launch; InputError as above."""
    rows = _rows(read_text(path, where, _REMEDY), path.name, where)
    if rows and not rows[0].is_of_zones:
        rows.pop(0)
    return _filled(_plan(path.name, (math.nan, math.nan), math.nan), rows, None)


def _plan(name: str, home_deg: tuple[float, float], home_amsl_m: float) -> Plan:
    return Plan(
        name=name,
        kind=None,
        speed_m_s={"copter": None, "plane": None},
        home_deg=home_deg,
        home_amsl_m=home_amsl_m,
    )


def _filled(plan: Plan, rows: list[_Row], ground: Ground | None) -> Plan:
    reader, fence = Items(plan, ground), _Fence(plan)
    for row in rows:
        if not fence.take(row):
            item = Item(command=row.command, frame=row.frame, params=row.given)
            reader.take(item.model_copy(update={"goes_on": row.goes_on}), row.label)
    fence.finish()
    reader.finish()
    return plan


def _rows(text: str, name: str, where: str) -> list[_Row]:
    lines = text.splitlines()
    head = next(line for line in lines if line.strip())
    if head.split()[:3] != [*_HEAD.split(), _VERSION]:
        rule = f"only {_HEAD} {_VERSION} is known"
        raise InputError(where, head.strip(), rule, _REMEDY)
    rows = []
    for number, line in enumerate(lines[lines.index(head) + 1 :], start=lines.index(head) + 2):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        label = f"{name}: line {number}"
        numbers = _numbers(words, label)
        whole = len(numbers) == 12 and all(numbers[at].is_integer() for at in (0, 2, 3))
        if not whole:
            rule = (
                "a line has index, current, frame, command, four parameters, latitude, "
                "longitude, altitude and autocontinue"
            )
            raise InputError(label, f"{len(words)} numbers", rule, _REMEDY)
        item = f"{name}: item {int(numbers[0])}"
        goes_on = numbers[11] != 0.0
        rows.append(_Row(item, int(numbers[2]), int(numbers[3]), tuple(numbers[4:11]), goes_on))
    return rows


def _numbers(words: list[str], label: str) -> list[float]:
    """The numbers of a line; nan for those that are not given."""
    try:
        return [math.nan if _NOT_GIVEN.fullmatch(word) else _finite(word) for word in words]
    except ValueError:
        rule = "it is made of finite numbers"
        raise InputError(label, " ".join(words)[:60], rule, _REMEDY) from None


def _finite(word: str) -> float:
    number = float(word)
    if not math.isfinite(number):
        raise ValueError(word)
    return number


@final
class _Fence:
    """Gathers the corners of polygons, which follow one another, and the circles."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._corners: list[list[float]] = []
        self._first: _Row | None = None

    def take(self, row: _Row) -> bool:
        """Add the row, if it is of a fence or a rally point."""
        plan, command = self._plan, row.command
        if command in (_CORNER_IN, _CORNER_OUT):
            self._add_corner(row)
        elif command in (_CIRCLE_IN, _CIRCLE_OUT):
            latitude, longitude = row.place_deg
            radius_m = row.parameters[0]
            if not radius_m > 0.0:
                raise InputError(row.label, radius_m, "a circle has a radius above 0", _REMEDY)
            place = {"latitude_deg": latitude, "longitude_deg": longitude}
            shape = place | {"radius_m": radius_m}
            name = f"fence circle {self._number()}"
            plan.add_zone(name, shape, inside=command == _CIRCLE_IN)
        elif command == _RALLY:
            plan.add_rally_point(*row.place_deg)
        else:
            return command == _RETURN_POINT
        return True

    def finish(self) -> None:
        """Refuse a polygon that lacks corners."""
        if self._first is not None:
            wanted = self._first.parameters[0]
            rule = f"its polygon has {len(self._corners)} of {wanted:g} corners"
            raise InputError(self._first.label, wanted, rule, _REMEDY)

    def _add_corner(self, row: _Row) -> None:
        first = self._first or row
        if (row.command, row.parameters[0]) != (first.command, first.parameters[0]):
            self.finish()
        if not row.parameters[0] >= 3.0:
            raise InputError(row.label, row.parameters[0], "a polygon has 3 corners", _REMEDY)
        self._first = first
        self._corners.append(list(row.place_deg))
        if len(self._corners) == first.parameters[0]:
            name = f"fence polygon {self._number()}"
            shape = {"vertices_deg": self._corners}
            self._plan.add_zone(name, shape, inside=first.command == _CORNER_IN)
            self._corners, self._first = [], None

    def _number(self) -> int:
        return len(self._plan.keep_ins) + len(self._plan.keep_outs) + 1
