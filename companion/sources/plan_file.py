"""QGroundControl's .plan files, and waypoint, fence and rally lists ("QGC WPL 110").

The format is documented in QGroundControl's developer guide, "Plan File Format".  A waypoint is a
place to reach; its altitude only says between which altitudes the person meant to fly, since the
companion chooses its own within a band.
"""

import math
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, Literal, final

from pydantic import AliasPath, BaseModel, ConfigDict, Field

from companion.errors import InputError
from companion.mavlink import fence
from companion.mavlink.autopilots.common import KINDS
from companion.mavlink.dialect import AMSL_FRAMES, HOME_FRAMES, TERRAIN_FRAMES, enum_word, wire
from companion.mavlink.mission_items import PLACES, not_done
from companion.ranges import Longitude, Positive
from companion.sources.files import RawTable, json_table, read_text
from companion.sources.schema import validated

_TERRAIN_MODES: Final = (3, 4)
"""AltitudeMode of QGroundControl: above terrain, sent as AMSL (3) or as it is (4)."""
_TAKE_OFFS: Final = (wire.MAV_CMD_NAV_TAKEOFF, wire.MAV_CMD_NAV_TAKEOFF_LOCAL)
_ENDS: Final = {
    wire.MAV_CMD_NAV_LOITER_UNLIM: "hold",
    wire.MAV_CMD_NAV_RETURN_TO_LAUNCH: "return",
    wire.MAV_CMD_NAV_LAND: "land",
}
"""Commands that end a mission, and how."""
_NO_ALTITUDE: Final = "waypoint without an altitude (that of the one before is taken)"
_NOT_FLOWN: Final = (wire.MAV_CMD_NAV_DELAY, wire.MAV_CMD_NAV_ROI)
"""Of the commands up to MAV_CMD_NAV_LAST, those that may be left out."""
_REMEDY: Final = "Give a .plan that QGroundControl has saved."

Ground = Callable[[float, float], float | None]
"""How high the ground is known to be, AMSL, at a latitude and a longitude; None: it is not."""
Labelled = tuple[str, "Item"]
"""How an item is called in errors, and the item."""


class _Json(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


_Number = float | None
"""JSON's null for what MAVLink says by no number: it is not given."""
_Corner = Annotated[list[Longitude], Field(min_length=2, max_length=3)]
_Version = Literal[2]


class Item(_Json):
    """A mission item, as the file has it."""

    type: str = "SimpleItem"
    command: int | None = None
    frame: int = 0
    params: list[_Number] = []
    altitude_mode: int | None = Field(None, alias="AltitudeMode")
    altitude_m: _Number = Field(None, alias="Altitude")
    above_terrain_amsl_m: _Number = Field(None, alias="AMSLAltAboveTerrain")
    complex_type: str = Field("", alias="complexItemType")
    survey: list["Item"] = Field(
        default_factory=list, validation_alias=AliasPath("TransectStyleComplexItem", "Items")
    )

    @property
    def place(self) -> list[float | None]:
        """Latitude, longitude, altitude; None for what is not given."""
        return [*self.params[4:7], None, None, None][:3]

    def is_with(self, other: "Item") -> bool:
        """Whether they are corners of one polygon."""
        return (self.command, self.params[:1]) == (other.command, other.params[:1])


class _Mission(_Json):
    version: _Version = 2
    hover_speed_m_s: _Number = Field(None, alias="hoverSpeed")
    cruise_speed_m_s: _Number = Field(None, alias="cruiseSpeed")
    vehicle_type: int = Field(0, alias="vehicleType")
    home: list[_Number] = Field(min_length=3, max_length=3, alias="plannedHomePosition")
    items: list[Item] = []


class _FenceCircle(_Json):
    inclusion: bool
    center: _Corner = Field(validation_alias=AliasPath("circle", "center"))
    radius: Positive = Field(validation_alias=AliasPath("circle", "radius"))


class _FencePolygon(_Json):
    inclusion: bool
    polygon: list[_Corner] = Field(min_length=3)


class _Fence(_Json):
    version: _Version = 2
    circles: list[_FenceCircle] = []
    polygons: list[_FencePolygon] = []


class _Rally(_Json):
    version: _Version = 2
    points: list[Annotated[list[float], Field(min_length=2, max_length=3)]] = []


class _Plan(_Json):
    file_type: Literal["Plan"] = Field(alias="fileType")
    version: Literal[1] = 1
    mission: _Mission
    fence: _Fence = Field(_Fence(), alias="geoFence")
    rally: _Rally = Field(_Rally(), alias="rallyPoints")


@dataclass(slots=True, kw_only=True)
class Zones:
    """The zones that a file holds, as tables of a mission file."""

    keep_outs: list[RawTable] = field(default_factory=list)
    keep_ins: list[RawTable] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What was left out or taken otherwise than it is written, for people."""

    def add(self, zone: RawTable, *, inside: bool) -> None:
        """A zone; inside: that the vehicle stays inside of."""
        (self.keep_ins if inside else self.keep_outs).append(zone)


@final
@dataclass(slots=True, kw_only=True)
class Plan(Zones):
    """What a .plan or a waypoint list holds, as tables of a mission file and numbers."""

    name: str
    """The file's name."""
    home_deg: tuple[float, float]
    home_amsl_m: float
    kind: str | None = None
    """ "copter" or "plane"; None: it does not say."""
    speed_m_s: dict[str, float | None] = field(default_factory=dict)
    """What it says of the speed of each kind."""
    targets: list[RawTable] = field(default_factory=list)
    """With their own altitude, if it is known; else it is that of the one before."""
    altitudes_amsl_m: list[float] = field(default_factory=list)
    """Of take-off and waypoints, those that are known."""
    unknown_altitudes: list[tuple[str, float]] = field(default_factory=list)
    """Items at so many metres above terrain where it is not known how high that is."""
    end_action: str = "hold"
    rally_points: list[RawTable] = field(default_factory=list)

    def add_zone(self, name: str, where: str, inside: bool, *corners: Any, **shape: float) -> None:
        """A polygon of these corners, or a circle of radius_m about one; InputError (where)."""
        places = [place_deg(corner, where) for corner in corners]
        zone: RawTable = {"name": name}
        zone |= places[0] | shape if shape else {"vertices_deg": [[*p.values()] for p in places]}
        self.add(zone, inside=inside)

    def add_items(self, items: Iterator[Labelled], ground: Ground | None) -> None:
        """Add items; ground: as for `read_plan`."""
        reader = _Items(self, ground)
        for where, item in items:
            reader.take(item, where)
        if left_out := reader.left_out.items():
            self.notes.append("left out: " + ", ".join(f"{n} x {what}" for what, n in left_out))


def read_plan(path: Path, where: str, ground: Ground | None = None) -> Plan:
    """The plan in a file; ground: what is known of it, for altitudes above terrain.

    Raises InputError about the field (where) if it cannot be read as a .plan, or naming the item
    that cannot be flown: jumps, take-off or landing as a VTOL, places without a known datum.
    """
    found = json_table(path, where, _REMEDY)
    if found.get("fileType") != "Plan":
        raise InputError(where, str(path), "it is no QGroundControl plan", _REMEDY)
    content, name = validated(_Plan, found, path.name), path.name
    mission, remedy = content.mission, "Set it in QGroundControl (Mission Start)."
    plan = launched(name, mission.home, f"{name}: mission.plannedHomePosition", remedy)
    plan.kind = _kind(mission.vehicle_type, name)
    plan.speed_m_s = {"copter": mission.hover_speed_m_s, "plane": mission.cruise_speed_m_s}
    for k, circle in enumerate(content.fence.circles):
        at, inside, radius_m = f"{name}: geoFence.circles[{k}]", circle.inclusion, circle.radius
        plan.add_zone(f"fence circle {k + 1}", at, inside, circle.center, radius_m=radius_m)
    for k, polygon in enumerate(content.fence.polygons):
        at = f"{name}: geoFence.polygons[{k}]"
        plan.add_zone(f"fence polygon {k + 1}", at, polygon.inclusion, *polygon.polygon)
    if len(plan.keep_ins) > 1:
        plan.notes.append(f"the vehicle keeps inside of all {len(plan.keep_ins)} inclusion fences")
    for k, point in enumerate(content.rally.points):
        plan.rally_points.append(place_deg(point, f"{name}: rallyPoints.points[{k}]"))
    items = ((f"{name}: mission.items[{k}]", item) for k, item in enumerate(mission.items))
    plan.add_items(items, ground)
    return plan


def launched(name: str, home: list[float | None], where: str, remedy: str) -> Plan:
    """An empty plan with its launch; InputError (where) if there is no such place."""
    if not is_place(home):
        raise InputError(where, home, "launch has no latitude and longitude", remedy)
    place, altitude = place_deg(home, where), home[2]
    if altitude is None:
        rule = "the altitude of launch is missing, and the plan's altitudes are measured from it"
        raise InputError(where, home, rule, f"{remedy} Or write its metres AMSL there.")
    home_deg = place["latitude_deg"], place["longitude_deg"]
    return Plan(name=name, home_deg=home_deg, home_amsl_m=altitude)


def is_place(place: Sequence[float | None]) -> bool:
    """Whether it says where: many programs write two zeros where they do not."""
    return None not in place[:2] and any(place[:2])


def place_deg(place: Sequence[float | None], where: str) -> RawTable:
    """A place, latitude first, as a table; InputError (where) if there is none, in degrees."""
    latitude, longitude = place[:2]
    if not (abs(latitude or 0.0) <= 90.0 and abs(longitude or 0.0) <= 180.0):
        rule = "out of range: latitude, -90 to 90, then longitude, -180 to 180"
        raise InputError(where, [latitude, longitude], rule, "Correct it.")
    return {"latitude_deg": latitude, "longitude_deg": longitude}


@final
class _Items:
    """Takes the mission items of a plan, one after the other."""

    def __init__(self, plan: Plan, ground: Ground | None) -> None:
        self._plan, self._ground = plan, ground
        self._ended_by, self._home_moves = "", False
        self.left_out = Counter[str]()
        """How often what of an item is not done, in words."""

    def take(self, item: Item, where: str) -> None:
        """Add an item to the plan.  Raises InputError naming it if it cannot be flown."""
        if item.type != "ComplexItem":
            self._take_simple(item, where)
        elif item.complex_type.endswith("LandingPattern"):
            self.left_out[item.complex_type] += 1
        elif item.survey:
            for number, inner in enumerate(item.survey):
                self.take(inner, f"{where}.TransectStyleComplexItem.Items[{number}]")
        else:
            rule = "it holds no waypoints"
            remedy = "Save the plan again with QGroundControl, or replace it by waypoints."
            raise InputError(f"{where}.complexItemType", item.complex_type, rule, remedy)

    def _take_simple(self, item: Item, where: str) -> None:
        command, name = item.command, _word("MAV_CMD", item.command)
        if command is None:
            raise InputError(f"{where}.command", None, "it is missing", _REMEDY)
        if command in PLACES:
            if not is_place(item.place):
                rule = "it has no latitude and longitude"
                raise InputError(f"{where}.params", item.place[:2], rule, "Put it on the map.")
            self._add_target(item, self._altitude_amsl_m(item, where), where)
            self.left_out.update(not_done(command, item.params[:4]))
        elif command in _TAKE_OFFS and not self._plan.targets:
            self._altitude_amsl_m(item, where)
        elif command == wire.MAV_CMD_NAV_LAND and is_place(item.place):
            self._add_target(item, None, where)
        elif command == wire.MAV_CMD_DO_JUMP or (
            command <= wire.MAV_CMD_NAV_LAST and command not in (*_ENDS, *_NOT_FLOWN, *_TAKE_OFFS)
        ):
            rule = f"{name} cannot be flown by the companion"
            raise InputError(f"{where}.command", command, rule, "Replace it by waypoints.")
        elif command not in _ENDS:  # a take-off too, of what is in the air already
            self._home_moves |= command == wire.MAV_CMD_DO_SET_HOME
            self.left_out[name] += 1
        if command in _ENDS:
            self._plan.end_action, self._ended_by = _ENDS[command], name

    def _add_target(self, item: Item, altitude_amsl_m: float | None, where: str) -> None:
        if self._ended_by:
            rule = "the mission ends before this item"
            remedy = "Remove what comes after it, or move it to the end."
            raise InputError(where, self._ended_by, rule, remedy)
        name = where.removeprefix(f"{self._plan.name}: ").removeprefix("mission.")
        target = {"name": name, **place_deg(item.place, where)}
        if altitude_amsl_m is not None:
            target["altitude_amsl_m"] = altitude_amsl_m
        self._plan.targets.append(target)

    def _altitude_amsl_m(self, item: Item, where: str) -> float | None:
        """How high an item was meant to be, if that can be known: remembered."""
        given, above_home = item.place[2], item.frame in HOME_FRAMES
        if item.frame in TERRAIN_FRAMES or item.altitude_mode in _TERRAIN_MODES:
            altitude = self._above_terrain(item, given, where)
        elif not (above_home or item.frame in AMSL_FRAMES) or (self._home_moves and above_home):
            why = ", as do set home comes before it" if above_home else ""
            rule, remedy = (
                f"what its altitude is above is not known{why}",
                "Give it above sea level.",
            )
            raise InputError(f"{where}.frame", item.frame, rule, remedy)
        else:
            above_m = self._plan.home_amsl_m if above_home else 0.0
            altitude = None if given is None else above_m + given
            if altitude is None and item.command not in _TAKE_OFFS:
                self.left_out[_NO_ALTITUDE] += 1
        if altitude is not None:
            self._plan.altitudes_amsl_m.append(altitude)
        return altitude

    def _above_terrain(self, item: Item, given: float | None, where: str) -> float | None:
        """By the plan's own word of it, else by the ground that is known there."""
        if item.above_terrain_amsl_m is not None:
            return item.above_terrain_amsl_m
        if item.frame in AMSL_FRAMES and given not in (None, item.altitude_m):
            return given  # AltitudeMode 3: this is what is sent
        height_m = given if item.altitude_m is None else item.altitude_m
        if height_m is None:
            self.left_out[_NO_ALTITUDE] += 1
            return None
        if item.command in _TAKE_OFFS:  # at launch, which stands on the ground
            return self._plan.home_amsl_m + height_m
        latitude, longitude, _ = item.place
        assert latitude is not None
        assert longitude is not None
        ground_m = None if self._ground is None else self._ground(latitude, longitude)
        if ground_m is None:
            self._plan.unknown_altitudes.append((where, height_m))
            return None
        return ground_m + height_m


def _kind(vehicle_type: int, name: str) -> str | None:
    if vehicle_type == 0 or vehicle_type in KINDS:
        return KINDS.get(vehicle_type)  # 0: it does not say
    what = _word("MAV_TYPE", vehicle_type)
    rule = f"it is for {what}, and only multicopters and planes are flown"
    remedy = "Plan for one of these in QGroundControl."
    raise InputError(f"{name}: mission.vehicleType", vehicle_type, rule, remedy)


def _word(enum: str, number: int | None) -> str:
    return (enum_word(enum, number) or f"{enum} {number}").lower().replace("_", " ")


# --- lists of Mission Planner, MAVProxy and QGroundControl: one item a line (mavlink.io, "File
# Formats"), line 0 of a mission is launch

_HEAD: Final = "QGC WPL"
_SAVE_AGAIN: Final = "Save it again with Mission Planner, MAVProxy or QGroundControl."
_RALLY = wire.MAV_CMD_NAV_RALLY_POINT


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
    if home.frame not in AMSL_FRAMES:
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


def _items(path: Path, where: str) -> deque[Labelled]:
    """By pymavlink, line by line: its `load` names no line, and takes the locale's encoding."""
    from pymavlink import mavwp  # it is not needed by most missions

    head, *lines = read_text(path, where, _SAVE_AGAIN).lstrip().splitlines()
    if head.split() != [*_HEAD.split(), "110"]:
        raise InputError(where, head.strip(), f"only {_HEAD} 110 is known", _SAVE_AGAIN)
    loader = mavwp.MAVWPLoader()
    for number, line in enumerate(lines, start=2):
        try:
            loader._read_waypoints_v110([line])
        except (mavwp.MAVWPError, ValueError) as error:
            label = f"{path.name}: line {number}"
            raise InputError(label, line.strip()[:60], str(error)[:100], _SAVE_AGAIN) from None
    found = deque[Labelled]()
    for number, item in enumerate(loader.wpoints):
        label = f"{path.name}: item {number}"
        numbers = [item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z]
        if any(map(math.isinf, numbers)):
            raise InputError(label, numbers, "it is made of finite numbers", _SAVE_AGAIN)
        given = [None if math.isnan(each) else each for each in numbers]
        table = {"command": item.command, "frame": item.frame, "params": given}
        found.append((label, Item.model_validate(table)))
    return found


def _is_of_zones(item: Item) -> bool:
    """Whether it is of a fence or a rally point, and not of a mission."""
    return fence.RETURN_POINT <= (item.command or 0) <= _RALLY


def _without_zones(items: deque[Labelled], plan: Plan) -> Iterator[Labelled]:
    """Add circles, polygons, whose corners follow one another, and rally points; other items."""
    while items:
        label, item = items.popleft()
        command, size = item.command or 0, item.params[0] or 0.0
        number = len(plan.keep_ins) + len(plan.keep_outs) + 1
        inside = command in (fence.POLYGON_IN, fence.CIRCLE_IN)
        if command in (fence.POLYGON_IN, fence.POLYGON_OUT):
            corners = [item.place]
            while items and len(corners) < size and items[0][1].is_with(item):
                corners.append(items.popleft()[1].place)
            if len(corners) != size or size < 3:
                rule = f"its polygon has {len(corners)} of {size:g} corners"
                raise InputError(label, size, rule, _SAVE_AGAIN)
            plan.add_zone(f"fence polygon {number}", label, inside, *corners)
        elif command in (fence.CIRCLE_IN, fence.CIRCLE_OUT):
            if not size > 0.0:
                raise InputError(label, size, "a circle has a radius above 0", _SAVE_AGAIN)
            plan.add_zone(f"fence circle {number}", label, inside, item.place, radius_m=size)
        elif command == _RALLY:
            plan.rally_points.append(place_deg(item.place, label))
        elif command != fence.RETURN_POINT:
            yield label, item
