"""QGroundControl's .plan files, and waypoint, fence and rally lists ("QGC WPL 110").

The format is documented in QGroundControl's developer guide, "Plan File Format".  A waypoint is a
place to reach; its altitude only says between which altitudes the person meant to fly, since the
companion chooses its own within a band.
"""

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self, final

import numpy as np
from pydantic import AliasPath, BaseModel, ConfigDict, Field, ValidationError

from companion.errors import InputError
from companion.geodesy import LocalFrame
from companion.mavlink import fence
from companion.mavlink.autopilots.common import KINDS
from companion.mavlink.dialect import AMSL_FRAMES, HOME_FRAMES, TERRAIN_FRAMES, enum_word, wire
from companion.mavlink.mission_items import PLACES, not_done
from companion.planner.rules import MAX_CELLS
from companion.planner.settings import CELLS_PER_RANGE
from companion.profiles import FLIGHT
from companion.ranges import Longitude, Positive
from companion.sources.files import RawTable, json_table, merged, read_text, within
from companion.sources.tables import OriginTable, validated
from companion.sources.zones import TargetTable, Zones

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

    ground: Ground | None = None
    """What is known of it, for altitudes above terrain."""
    left_out: Counter[str] = field(default_factory=Counter)
    """How often what of an item is not done, in words."""
    ended_by: str = ""
    """The command after which nothing is flown."""
    home_moves: bool = False

    def add_zone(self, name: str, where: str, inside: bool, *corners: Any, **shape: float) -> None:
        """A polygon of these corners, or a circle of radius_m about one; InputError (where)."""
        places = [place_deg(corner, where) for corner in corners]
        zone: RawTable = {"name": name}
        zone |= places[0] | shape if shape else {"vertices_deg": [[*p.values()] for p in places]}
        self.add(zone, inside=inside)

    def take(self, items: Iterable[Labelled]) -> None:
        """Add mission items.  Raises InputError naming one that cannot be flown."""
        for where, item in items:
            if item.type != "ComplexItem":
                self._take_simple(item, where)
            elif item.complex_type.endswith("LandingPattern"):
                self.left_out[item.complex_type] += 1
            elif item.survey:
                inner = f"{where}.TransectStyleComplexItem.Items"
                self.take((f"{inner}[{k}]", each) for k, each in enumerate(item.survey))
            else:
                rule = "it holds no waypoints"
                remedy = "Save the plan again with QGroundControl, or replace it by waypoints."
                raise InputError(f"{where}.complexItemType", item.complex_type, rule, remedy)

    def with_left_out(self) -> Self:
        """The plan, with a note of what is not done of its items."""
        if self.left_out:
            counted = ", ".join(f"{count} x {what}" for what, count in self.left_out.items())
            self.notes.append(f"left out: {counted}")
        return self

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
        elif command in _TAKE_OFFS and not self.targets:
            self._altitude_amsl_m(item, where)
        elif command == wire.MAV_CMD_NAV_LAND and is_place(item.place):
            self._add_target(item, None, where)
        elif command == wire.MAV_CMD_DO_JUMP or (
            command <= wire.MAV_CMD_NAV_LAST and command not in (*_ENDS, *_NOT_FLOWN, *_TAKE_OFFS)
        ):
            rule = f"{name} cannot be flown by the companion"
            raise InputError(f"{where}.command", command, rule, "Replace it by waypoints.")
        elif command not in _ENDS:  # a take-off too, of what is in the air already
            self.home_moves |= command == wire.MAV_CMD_DO_SET_HOME
            self.left_out[name] += 1
        if command in _ENDS:
            self.end_action, self.ended_by = _ENDS[command], name

    def _add_target(self, item: Item, altitude_amsl_m: float | None, where: str) -> None:
        if self.ended_by:
            rule = "the mission ends before this item"
            remedy = "Remove what comes after it, or move it to the end."
            raise InputError(where, self.ended_by, rule, remedy)
        target = {"name": where.removeprefix("mission."), **place_deg(item.place, where)}
        if altitude_amsl_m is not None:
            target["altitude_amsl_m"] = altitude_amsl_m
        self.targets.append(target)

    def _altitude_amsl_m(self, item: Item, where: str) -> float | None:
        """How high an item was meant to be, if that can be known: remembered."""
        given, above_home = item.place[2], item.frame in HOME_FRAMES
        if item.frame in TERRAIN_FRAMES or item.altitude_mode in _TERRAIN_MODES:
            altitude = self._above_terrain(item, given, where)
        elif not (above_home or item.frame in AMSL_FRAMES) or (self.home_moves and above_home):
            why = ", as do set home comes before it" if above_home else ""
            rule = f"what its altitude is above is not known{why}"
            raise InputError(f"{where}.frame", item.frame, rule, "Give it above sea level.")
        else:
            above_m = self.home_amsl_m if above_home else 0.0
            altitude = None if given is None else above_m + given
            if altitude is None and item.command not in _TAKE_OFFS:
                self.left_out[_NO_ALTITUDE] += 1
        if altitude is not None:
            self.altitudes_amsl_m.append(altitude)
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
            return self.home_amsl_m + height_m
        latitude, longitude = place_deg(item.place, where).values()
        ground_m = None if self.ground is None else self.ground(latitude, longitude)
        if ground_m is None:
            self.unknown_altitudes.append((f"{self.name}: {where}", height_m))
            return None
        return ground_m + height_m


def read_plan(path: Path, where: str, ground: Ground | None = None) -> Plan:
    """The plan in a file; ground: what is known of it, for altitudes above terrain.

    Raises InputError about the field (where) if it cannot be read as a .plan, or naming the item
    that cannot be flown: jumps, take-off or landing as a VTOL, places without a known datum.
    """
    found = json_table(path, where, _REMEDY)
    if found.get("fileType") != "Plan":
        raise InputError(where, str(path), "it is no QGroundControl plan", _REMEDY)
    with within(path.name):
        content = validated(_Plan, found)
        mission, remedy = content.mission, "Set it in QGroundControl (Mission Start)."
        plan = launched(path.name, mission.home, "mission.plannedHomePosition", remedy)
        plan.kind, plan.ground = _kind(mission.vehicle_type), ground
        plan.speed_m_s = {"copter": mission.hover_speed_m_s, "plane": mission.cruise_speed_m_s}
        for k, circle in enumerate(content.fence.circles):
            at, inside, radius_m = f"geoFence.circles[{k}]", circle.inclusion, circle.radius
            plan.add_zone(f"fence circle {k + 1}", at, inside, circle.center, radius_m=radius_m)
        for k, polygon in enumerate(content.fence.polygons):
            at = f"geoFence.polygons[{k}]"
            plan.add_zone(f"fence polygon {k + 1}", at, polygon.inclusion, *polygon.polygon)
        for k, point in enumerate(content.rally.points):
            plan.rally_points.append(place_deg(point, f"rallyPoints.points[{k}]"))
        if (count := len(plan.keep_ins)) > 1:
            plan.notes.append(f"the vehicle keeps inside of all {count} inclusion fences")
        plan.take((f"mission.items[{k}]", item) for k, item in enumerate(mission.items))
    return plan.with_left_out()


def launched(name: str, home: list[float | None], where: str, remedy: str) -> Plan:
    """An empty plan with its launch; InputError (where) if there is no such place."""
    if not is_place(home):
        raise InputError(where, home, "launch has no latitude and longitude", remedy)
    latitude, longitude = place_deg(home, where).values()
    if home[2] is None:
        rule = "the altitude of launch is missing, and the plan's altitudes are measured from it"
        raise InputError(where, home, rule, f"{remedy} Or write its metres AMSL there.")
    return Plan(name=name, home_deg=(latitude, longitude), home_amsl_m=home[2])


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


def _kind(vehicle_type: int) -> str | None:
    if vehicle_type == 0 or vehicle_type in KINDS:
        return KINDS.get(vehicle_type)  # 0: it does not say
    what = _word("MAV_TYPE", vehicle_type)
    rule = f"it is for {what}, and only multicopters and planes are flown"
    remedy = "Plan for one of these in QGroundControl."
    raise InputError("mission.vehicleType", vehicle_type, rule, remedy)


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
    with within(path.name):
        plan = launched(path.name, home.place, f"{label} (launch)", remedy)
        if home.frame not in AMSL_FRAMES:
            said = f"of frame {home.frame}, is taken to be above mean sea level"
            plan.notes.append(f"launch: its altitude, {plan.home_amsl_m:g} m {said}")
        plan.ground = ground
        plan.take(_without_zones(items, plan))
    return plan.with_left_out()


def read_waypoint_fence(path: Path, where: str) -> Zones:
    """The fence in such a list, which may lack a launch; InputError as above."""
    items = _items(path, where)
    if items and not _is_of_zones(items[0][1]):
        items.popleft()
    plan = Plan(name=path.name, home_deg=(math.nan, math.nan), home_amsl_m=math.nan)
    with within(path.name):
        plan.take(_without_zones(items, plan))
    if count := len(plan.targets):
        plan.notes.append(f"{path.name}: its {count} waypoints are not flown")
    return plan


def _items(path: Path, where: str) -> deque[Labelled]:
    """By pymavlink, line by line: its `load` names no line, and takes the locale's encoding."""
    from pymavlink import mavwp  # it is not needed by most missions

    head, *lines = read_text(path, where, _SAVE_AGAIN).lstrip().splitlines()
    if head.split() != [*_HEAD.split(), "110"]:
        raise InputError(where, head.strip(), f"only {_HEAD} 110 is known", _SAVE_AGAIN)
    loader, found = mavwp.MAVWPLoader(), deque[Labelled]()
    with within(path.name):
        for number, line in enumerate(lines, start=2):
            try:
                loader._read_waypoints_v110([line])
            except (mavwp.MAVWPError, ValueError) as error:
                said, rule = line.strip()[:60], str(error)[:100]
                raise InputError(f"line {number}", said, rule, _SAVE_AGAIN) from None
        for number, item in enumerate(loader.wpoints):
            numbers = [item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z]
            if any(map(math.isinf, numbers)):
                rule = "it is made of finite numbers"
                raise InputError(f"item {number}", numbers, rule, _SAVE_AGAIN)
            given = [None if math.isnan(each) else each for each in numbers]
            table = {"command": item.command, "frame": item.frame, "params": given}
            found.append((f"item {number}", Item.model_validate(table)))
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


# --- what a mission lacks that is a plan alone: assumed, and each assumption is said

_GRAVITY_M_S2: Final = 9.81
_LOITER_BANK_RAD: Final = math.radians(35.0)
_MIN_LOITER_M: Final = 100.0  # both autopilots ask for 80, ArduPlane flies 17 more
_SEARCH_ERRORS: Final = 1.1  # of the vehicle's errors: kept besides d_s (`Task.band_amsl_m`)
_BAND_ERRORS: Final = 8.0
_MAX_M_S: Final = 500.0
_FARTHEST_M: Final = 1e6  # from the origin, as for any place (`sources.zones`)

# of each kind of vehicle:
_SPEED_M_S: Final = {"copter": 5.0, "plane": 15.0}  # QGroundControl's own
_CLIMB_M_S: Final = {"copter": 1.5, "plane": 2.5}
_SINK_M_S: Final = {"copter": 1.5, "plane": 1.8}  # PX4's copters sink no faster, its planes at 2
_LATERAL_M_S2: Final = {"copter": 1.5, "plane": 2.0}
"""ArduCopter keeps to a path up to this; ArduPlane is then 10 m off it."""
_MAX_SLOPE_DEG: Final = {"copter": 30.0, "plane": 7.0}
_MIN_RADIUS_M: Final = {"copter": 10.0, "plane": 60.0}
_TRACKING_M: Final = {"copter": 5.0, "plane": 15.0}
_SIGHT_M: Final = {"copter": 2000.0, "plane": 3000.0}
_DISTANCE_M: Final = {"copter": 30.0, "plane": 50.0}
_MIN_DISTANCE_M: Final = {"copter": 10.0, "plane": 20.0}


def with_plan(given: RawTable, plan: Plan, name: str) -> tuple[RawTable, list[str]]:
    """A mission table with the plan in it, and what was assumed, for people.

    What is given, itself not yet checked, goes before the plan; zones and rally points of both
    count.  name: of the mission, if nothing is given.  Raises InputError about a waypoint that is
    too far from launch for any map, or whose altitude without a radar is not known.
    """
    said = _at(given, "vehicle.kind")
    kind = said if said in ("copter", "plane") else plan.kind or "copter"
    is_blind = _at(given, "vehicle.scanner") is False
    ground_m = max(_number(given, "terrain.highest_amsl_m", plan.home_amsl_m), plan.home_amsl_m)
    own_targets = not _at(given, "from_vehicle.targets")
    vehicle, notes = _vehicle(given, plan, kind)
    errors_m = sum(
        _number(given, f"vehicle.{key}", vehicle[key], above=0.0)
        for key in ("tracking_error_m", "navigation_error_m")
    )
    if plan.unknown_altitudes and own_targets:
        notes.append(_about_unknown_altitudes(plan, is_blind=is_blind))
    range_m = _number(given, "planner.scan_range_m", _SIGHT_M[kind], above=0.0)
    distance_m = _DISTANCE_M[kind]
    if is_blind:
        heights_m = [t["altitude_amsl_m"] for t in plan.targets if "altitude_amsl_m" in t]
        room_m = min(heights_m, default=math.inf) - ground_m - _SEARCH_ERRORS * errors_m
        if room_m < distance_m:
            distance_m = max(float(math.floor(room_m + 1e-6)), _MIN_DISTANCE_M[kind])
    distance_m = _number(given, "planner.safety_distance_m", distance_m, above=0.0)
    band = _band(plan, errors_m, distance_m, ground_m, is_blind=is_blind)
    assumed: RawTable = {
        "schema": 1,
        "name": name,
        "origin": {"latitude_deg": plan.home_deg[0], "longitude_deg": plan.home_deg[1]},
        "altitude": band,
        "vehicle": vehicle,
        "planner": {
            "scan_range_m": range_m,
            "safety_distance_m": distance_m,
            "planning_time_s": 3.0,
        },
        "end": {"action": plan.end_action},
        "keep_outs": plan.keep_outs,
        "keep_ins": plan.keep_ins,
        "rally_points": plan.rally_points,
    }
    if own_targets and "targets" not in given:
        of_radars = () if is_blind else ("altitude_amsl_m",)  # with one, any of the band will do
        assumed["targets"] = [
            {key: value for key, value in target.items() if key not in of_radars}
            for target in plan.targets
        ]
    if "altitude" not in given:
        notes.append(_about_altitude(plan, band, is_blind=is_blind))
    table = merged(assumed, given, ("keep_outs", "keep_ins", "rally_points"))
    if "area" not in given and (area := _area(table, plan, range_m)):
        table["area"] = area
        notes.append(f"map assumed: {range_m:g} m around launch and targets")
    if _at(given, "planner.scan_range_m") is None:
        sight = "looking ahead" if is_blind else "a terrain radar that sees"
        notes.append(f"assumed: {sight} {range_m:g} m (R), d_s = {distance_m:g} m")
    return table, [*notes, *plan.notes]


def _vehicle(given: RawTable, plan: Plan, kind: str) -> tuple[RawTable, list[str]]:
    """What is assumed of the vehicle, but for what follows from a speed that is given."""
    planned = plan.speed_m_s.get(kind)
    of_plan = planned is not None and 0.0 < planned < _MAX_M_S
    speed = planned if planned is not None and of_plan else _SPEED_M_S[kind]
    notes = []
    if _at(given, "vehicle.speed_m_s") is None:
        source = f"{'hover' if kind == 'copter' else 'cruise'} speed of the plan"
        notes.append(f"a {kind} at {speed:g} m/s ({source if of_plan else 'assumed'})")
    speed = _number(given, "vehicle.speed_m_s", speed, above=0.0)
    table: RawTable = {
        "kind": kind,
        "speed_m_s": speed,
        "acceleration_m_s2": 2.0,
        "climb_rate_m_s": _CLIMB_M_S[kind],
        "tracking_error_m": _TRACKING_M[kind],
        "navigation_error_m": 5.0,
        "turn_radius_m": max(_round_up(speed**2 / _LATERAL_M_S2[kind]), _MIN_RADIUS_M[kind]),
    }
    for key, rate_m_s in (("climb", _CLIMB_M_S[kind]), ("dive", _SINK_M_S[kind])):
        slope_deg = min(math.degrees(math.atan(rate_m_s / speed)), _MAX_SLOPE_DEG[kind])
        table[f"{key}_angle_deg"] = math.floor(slope_deg * 10.0) / 10.0
    if kind == "plane":
        tightest_m = speed**2 / (_GRAVITY_M_S2 * math.tan(_LOITER_BANK_RAD))
        table["loiter_radius_m"] = max(_round_up(tightest_m), _MIN_LOITER_M)
    return table, notes


def _round_up(value_m: float) -> float:
    return math.ceil(value_m / 5.0) * 5.0


def _band(
    plan: Plan, error_m: float, distance_m: float, ground_m: float, *, is_blind: bool
) -> RawTable:
    """A band around the altitudes of the waypoints, high enough above launch to begin in it.

    ground_m: the highest of the ground, AMSL, if that is stated; otherwise as launch.  Without a
    radar it begins where paths just keep d_s and the errors from that, and no higher: what is
    flown in it are the waypoints' own altitudes.
    """
    heights = plan.altitudes_amsl_m or [plan.home_amsl_m]
    if is_blind:
        inset = _SEARCH_ERRORS * error_m
        least = ground_m + max(distance_m * FLIGHT.margin, distance_m + inset) - inset
        floor = math.ceil(10.0 * max(min(heights) - inset, least) + 1e-6) / 10.0
    else:
        above_ground = ground_m + distance_m + 2.0 * error_m
        floor = float(math.ceil(max(min(heights) - 2.0 * error_m, above_ground)))
    ceiling = math.ceil(max(max(heights) + 2.0 * error_m, floor + _BAND_ERRORS * error_m))
    return {"floor_amsl_m": floor, "ceiling_amsl_m": float(ceiling)}


def _area(table: RawTable, plan: Plan, sight_m: float) -> RawTable | None:
    """The box around launch and targets, as far beyond them as the radar sees.

    None: the schema refuses what it would be drawn about.  InputError about the waypoint that makes
    it too large for a map.
    """
    try:
        frame = LocalFrame(**dict(OriginTable.model_validate(table["origin"])))
        targets = [TargetTable.model_validate(each) for each in table.get("targets", ())]
    except (TypeError, ValidationError):
        return None
    named = [("launch", plan.home_deg), *((each.name, each.degrees) for each in targets)]
    in_degrees = [(name, place) for name, place in named if place is not None]
    own_m = [(each.north_m, each.east_m) for each in targets if each.degrees is None]
    places_m = np.array([*(frame.to_local_m(*place) for _, place in in_degrees), *own_m], float)
    if not np.isfinite(places_m).all():
        return None
    low = np.floor(places_m.min(axis=0) - sight_m)
    high = np.ceil(places_m.max(axis=0) + sight_m)
    cells = np.prod(high - low) / max(round(sight_m / CELLS_PER_RANGE), 1) ** 2
    by_radar = _at(table, "scanner.kind") in (None, "terrain_radar")
    if np.abs([low, high]).max() >= _FARTHEST_M or (by_radar and cells > MAX_CELLS):
        far_m = np.hypot(*(places_m[: len(in_degrees)] - places_m[0]).T)
        name, place = in_degrees[index := int(far_m.argmax())]
        if index > 0:
            far = f"{far_m[index] / 1000.0:,.0f} km from launch {plan.home_deg}"
            remedy = "Correct it or launch, or raise planner.scan_range_m in a mission.toml."
            rule = f"it lies {far}, too far for one map"
            raise InputError(f"{plan.name}: {name}", list(place), rule, remedy)
    (south, west), (north, east) = low.tolist(), high.tolist()
    return {"north_min_m": south, "north_max_m": north, "east_min_m": west, "east_max_m": east}


def _about_altitude(plan: Plan, band: RawTable, *, is_blind: bool) -> str:
    between = f"{band['floor_amsl_m']:g} to {band['ceiling_amsl_m']:g} m AMSL"
    launch = f"launch at {plan.home_amsl_m:g} m"
    if not plan.altitudes_amsl_m:
        return f"altitude: anywhere from {between} (assumed; {launch})"
    low, high = f"{min(plan.altitudes_amsl_m):g}", f"{max(plan.altitudes_amsl_m):g}"
    planned = low if low == high else f"{low} to {high}"
    if is_blind:
        return f"altitude: the plan's own, {planned} m AMSL ({launch}), in a band of {between}"
    return (
        f"altitude: anywhere from {between} (assumed from the plan's {planned} m, {launch} AMSL); "
        "waypoints are passed at any altitude of this band"
    )


def _about_unknown_altitudes(plan: Plan, *, is_blind: bool) -> str:
    """A note; without a radar, where altitudes are flown as they are planned, an InputError."""
    where, height_m = plan.unknown_altitudes[0]
    remedy = (
        "Give [terrain] with highest_amsl_m or an elevation file that has the place, or an "
        "altitude above launch or above mean sea level."
    )
    if is_blind:
        rule = "it is above terrain, and how high the ground is there is not known"
        raise InputError(f"{where}: altitude", height_m, rule, remedy)
    what = "altitude above terrain, where the ground is not known"
    return f"left out: {len(plan.unknown_altitudes)} x {what}. {remedy}"


def _at(table: RawTable, path: str) -> Any:
    """What stands at a path ("vehicle.kind"); None: nothing."""
    above, _, key = path.rpartition(".")
    here = _at(table, above) if above else table
    return here.get(key) if isinstance(here, dict) else None


def _number(table: RawTable, path: str, default: float, above: float = -1e9) -> float:
    """A number, if that is what is there; what is there otherwise, the schema refuses."""
    value = _at(table, path)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number and above < value < 1e9 else default
