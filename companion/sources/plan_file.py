"""QGroundControl's .plan files, and waypoint, fence and rally lists ("QGC WPL 110").

The format is documented in QGroundControl's developer guide, "Plan File Format".  A waypoint is a
place to reach; its altitude only says between which altitudes the person meant to fly, since the
companion chooses its own within a band.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, Self, final

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
from companion.sources.zones import FARTHEST_M, TargetTable, Zones, place_deg

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
_NO_GROUND: Final = "altitude above terrain, where the ground is not known (give [terrain])"
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

    @property
    def size(self) -> float:
        """Corners of a polygon that it is one of, or the radius of a circle."""
        return (self.params or [None])[0] or 0.0


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
    ground: Ground | None = None
    """What is known of it, for altitudes above terrain."""
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
    left_out: Counter[str] = field(default_factory=Counter)
    """How often what of an item is not done, in words."""
    ended_by: str = ""
    """The command after which nothing is flown."""
    home_moves: bool = False

    @classmethod
    def launched(
        cls, name: str, home: list[float | None], where: str, remedy: str, ground: Ground | None
    ) -> Self:
        """An empty plan with its launch; InputError (where) if there is no such place."""
        if not is_place(home):
            raise InputError(where, home, "launch has no latitude and longitude", remedy)
        latitude, longitude = place_deg(home, where).values()
        if (amsl_m := home[2]) is None:
            rule = "the altitude of launch is missing, and altitudes are measured from it"
            raise InputError(where, home, rule, f"{remedy} Or write its metres AMSL there.")
        return cls(name=name, home_deg=(latitude, longitude), home_amsl_m=amsl_m, ground=ground)

    def take(self, items: Iterable[Labelled]) -> None:
        """Add mission items.  Raises InputError naming one that cannot be flown."""
        for where, item in items:
            if item.type != "ComplexItem":
                self._take_simple(item, where)
            elif item.complex_type.endswith("LandingPattern"):
                self.left_out[item.complex_type] += 1
            elif item.survey:
                inner = f"{where}.TransectStyleComplexItem.Items"
                self.take((f"{inner}[{k}]", inner_item) for k, inner_item in enumerate(item.survey))
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
        given, is_take_off = item.place[2], item.command in _TAKE_OFFS
        above_m: float | None = 0.0  # sea level
        if item.frame in TERRAIN_FRAMES or item.altitude_mode in _TERRAIN_MODES:
            if item.above_terrain_amsl_m is not None:  # the plan's own word of it
                given = item.above_terrain_amsl_m
            elif item.frame not in AMSL_FRAMES or given in (None, item.altitude_m):
                given = given if item.altitude_m is None else item.altitude_m
                above_m = self._ground_amsl_m(item, where)
        elif item.frame in HOME_FRAMES and not self.home_moves:
            above_m = self.home_amsl_m
        elif item.frame not in AMSL_FRAMES:
            why = ", as do set home comes before it" if item.frame in HOME_FRAMES else ""
            rule = f"what its altitude is above is not known{why}"
            raise InputError(f"{where}.frame", item.frame, rule, "Give it above sea level.")
        if given is None:
            self.left_out.update([] if is_take_off else [_NO_ALTITUDE])
            return None
        if above_m is None:
            self.unknown_altitudes.append((f"{self.name}: {where}", given))
            self.left_out[_NO_GROUND] += 1
            return None
        self.altitudes_amsl_m.append(above_m + given)
        return above_m + given

    def _ground_amsl_m(self, item: Item, where: str) -> float | None:
        """How high the ground is below an item: of a take-off as at launch, which stands on it."""
        if item.command in _TAKE_OFFS:
            return self.home_amsl_m
        return self.ground and self.ground(*place_deg(item.place, where).values())


def read_plan(path: Path, where: str, ground: Ground | None = None) -> Plan:
    """The plan in a file; ground: what is known of it, for altitudes above terrain.

    Raises InputError about the field (where) if it cannot be read as a .plan, or naming the item
    that cannot be flown: jumps, take-off or landing as a VTOL, places without a known datum.
    """
    table = json_table(path, where, _REMEDY)
    if table.get("fileType") != "Plan":
        raise InputError(where, str(path), "it is no QGroundControl plan", _REMEDY)
    with within(path.name):
        content = validated(_Plan, table)
        mission, remedy = content.mission, "Set it in QGroundControl (Mission Start)."
        home = "mission.plannedHomePosition"
        plan = Plan.launched(path.name, mission.home, home, remedy, ground)
        plan.kind = _kind(mission.vehicle_type)
        plan.speed_m_s = {"copter": mission.hover_speed_m_s, "plane": mission.cruise_speed_m_s}
        for k, circle in enumerate(content.fence.circles):
            at, inside, radius_m = f"geoFence.circles[{k}]", circle.inclusion, circle.radius
            plan.add(f"fence circle {k + 1}", at, inside, circle.center, radius_m=radius_m)
        for k, polygon in enumerate(content.fence.polygons):
            at = f"geoFence.polygons[{k}]"
            plan.add(f"fence polygon {k + 1}", at, polygon.inclusion, *polygon.polygon)
        for k, point in enumerate(content.rally.points):
            plan.rally_points.append(place_deg(point, f"rallyPoints.points[{k}]"))
        if (count := len(plan.keep_ins)) > 1:
            plan.notes.append(f"the vehicle keeps inside of all {count} inclusion fences")
        plan.take((f"mission.items[{k}]", item) for k, item in enumerate(mission.items))
    return plan.with_left_out()


def is_place(place: Sequence[float | None]) -> bool:
    """Whether it says where: many programs write two zeros where they do not."""
    return None not in place[:2] and any(place[:2])


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
_POLYGONS: Final = (fence.POLYGON_IN, fence.POLYGON_OUT)
_CIRCLES: Final = (fence.CIRCLE_IN, fence.CIRCLE_OUT)
_RALLY: Final = wire.MAV_CMD_NAV_RALLY_POINT
_OF_ZONES: Final = (*_POLYGONS, *_CIRCLES, fence.RETURN_POINT, _RALLY)


def read_waypoint_list(path: Path, where: str, ground: Ground | None = None) -> Plan:
    """The waypoints, fence and rally points of a list, as a plan; ground: as for `read_plan`.

    Raises InputError about the field (where), or naming the item that cannot be taken.
    """
    items = _items(path, where)
    remedy = "Set home before you save it. (A list of zones alone: name it as threats.)"
    if not items or items[0][1].command in _OF_ZONES:
        rule = "launch, its first item, has no latitude and longitude"
        raise InputError(where, path.name, rule, remedy)
    (label, home), *items = items
    with within(path.name):
        plan = Plan.launched(path.name, home.place, f"{label} (launch)", remedy, ground)
        if home.frame not in AMSL_FRAMES:
            reference = f"of frame {home.frame}, is taken to be above mean sea level"
            plan.notes.append(f"launch: its altitude, {plan.home_amsl_m:g} m {reference}")
        plan.rally_points = _take_zones(items, plan)
        plan.take(labelled for labelled in items if labelled[1].command not in _OF_ZONES)
    return plan.with_left_out()


def read_waypoint_fence(path: Path, where: str) -> Zones:
    """The fence in such a list, which may lack a launch; InputError as above."""
    items, zones = _items(path, where), Zones()
    with within(path.name):
        _take_zones(items, zones)
    if count := sum(item.command not in _OF_ZONES for _, item in items[1:]):
        zones.notes.append(f"{path.name}: {count} items of its mission are not flown")
    return zones


def _items(path: Path, where: str) -> list[Labelled]:
    """By pymavlink, line by line: its `load` names no line, and takes the locale's encoding."""
    from pymavlink import mavwp  # it is not needed by most missions

    head, *lines = read_text(path, where, _SAVE_AGAIN).lstrip().splitlines()
    if head.split() != [*_HEAD.split(), "110"]:
        raise InputError(where, head.strip(), f"only {_HEAD} 110 is known", _SAVE_AGAIN)
    loader, labelled = mavwp.MAVWPLoader(), list[Labelled]()
    with within(path.name):
        for number, line in enumerate(lines, start=2):
            try:
                loader._read_waypoints_v110([line])
            except (mavwp.MAVWPError, ValueError) as error:
                text, rule = line.strip()[:60], str(error)[:100]
                raise InputError(f"line {number}", text, rule, _SAVE_AGAIN) from None
        for number, item in enumerate(loader.wpoints):
            numbers = [item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z]
            given = [None if math.isnan(number) else number for number in numbers]
            table = {"command": item.command, "frame": item.frame, "params": given}
            labelled.append((f"item {number}", validated(Item, table, f"item {number}")))
    return labelled


def _take_zones(items: Iterable[Labelled], zones: Zones) -> list[RawTable]:
    """Add circles and polygons, whose corners follow one another; the rally points."""
    rally_points = list[RawTable]()
    for (command, size), group in groupby(items, lambda one: (one[1].command, one[1].size)):
        members, step = list(group), 1
        if command in _POLYGONS:
            if short := len(members) if size < 3 or size % 1 else len(members) % size:
                rule = f"its polygon has {short:g} of {size:g} corners"
                raise InputError(members[0][0], size, rule, _SAVE_AGAIN)
            step = int(size)
        for first in range(0, len(members), step):
            (label, item), number = members[first], len(zones.keep_ins + zones.keep_outs) + 1
            if command in _POLYGONS:
                corners = [corner.place for _, corner in members[first : first + step]]
                inside = command == fence.POLYGON_IN
                zones.add(f"fence polygon {number}", label, inside, *corners)
            elif command in _CIRCLES:
                if not size > 0.0:
                    raise InputError(label, size, "a circle has a radius above 0", _SAVE_AGAIN)
                inside = command == fence.CIRCLE_IN
                zones.add(f"fence circle {number}", label, inside, item.place, radius_m=size)
            elif command == _RALLY:
                rally_points.append(place_deg(item.place, label))
    return rally_points


# --- what a mission lacks that is a plan alone: assumed, and each assumption is said

_GRAVITY_M_S2: Final = 9.81
_LOITER_BANK_RAD: Final = math.radians(35.0)
_MIN_LOITER_M: Final = 100.0  # both autopilots ask for 80, ArduPlane flies 17 more
_SEARCH_ERRORS: Final = 1.1  # of the vehicle's errors: kept besides d_s (`Task.band_amsl_m`)
_BAND_ERRORS: Final = 8.0
_MAX_M_S: Final = 500.0
_GIVE_GROUND: Final = (
    "Give [terrain] with highest_amsl_m or an elevation file that has the place, or an altitude "
    "above launch or above mean sea level."
)


class _Usual(NamedTuple):
    """What is assumed of a kind of vehicle."""

    speed_m_s: float  # QGroundControl's own
    climb_m_s: float
    sink_m_s: float  # PX4's copters sink no faster, its planes at 2
    lateral_m_s2: float  # ArduCopter keeps to a path up to this; ArduPlane is then 10 m off it
    max_slope_deg: float
    min_radius_m: float
    tracking_m: float
    sight_m: float
    distance_m: float
    min_distance_m: float


_USUAL: Final = {
    "copter": _Usual(
        speed_m_s=5.0, climb_m_s=1.5, sink_m_s=1.5, lateral_m_s2=1.5, max_slope_deg=30.0,
        min_radius_m=10.0, tracking_m=5.0, sight_m=2000.0, distance_m=30.0, min_distance_m=10.0,
    ),
    "plane": _Usual(
        speed_m_s=15.0, climb_m_s=2.5, sink_m_s=1.8, lateral_m_s2=2.0, max_slope_deg=7.0,
        min_radius_m=60.0, tracking_m=15.0, sight_m=3000.0, distance_m=50.0, min_distance_m=20.0,
    ),
}  # fmt: skip


def with_plan(given: RawTable, plan: Plan, name: str) -> tuple[RawTable, list[str]]:
    """A mission table with the plan in it, and what was assumed, for people.

    What is given, itself not yet checked, goes before the plan; zones and rally points of both
    count.  name: of the mission, if nothing is given.  Raises InputError about a waypoint that is
    too far from launch for any map, or whose altitude without a radar is not known.
    """
    given_kind, is_blind = _at(given, "vehicle.kind"), _at(given, "vehicle.scanner") is False
    kind = given_kind if given_kind in ("copter", "plane") else plan.kind or "copter"
    own_targets = not _at(given, "from_vehicle.targets")
    if is_blind and own_targets and plan.unknown_altitudes:  # which would be flown as planned
        where, height_m = plan.unknown_altitudes[0]
        rule = "it is above terrain, and how high the ground is there is not known"
        raise InputError(f"{where}: altitude", height_m, rule, _GIVE_GROUND)
    usual, speed, source = _USUAL[kind], plan.speed_m_s.get(kind) or 0.0, "speed of the plan"
    if not 0.0 < speed < _MAX_M_S:
        speed, source = usual.speed_m_s, "assumed"
    vehicle = _vehicle(kind, _number(given, "vehicle.speed_m_s", speed, above=0.0))
    range_m = _number(given, "planner.scan_range_m", usual.sight_m, above=0.0)
    band, distance_m = _band(given, plan, vehicle, usual, is_blind=is_blind)
    planner = {"scan_range_m": range_m, "safety_distance_m": distance_m, "planning_time_s": 3.0}
    assumed: RawTable = {
        "schema": 1,
        "name": name,
        "origin": {"latitude_deg": plan.home_deg[0], "longitude_deg": plan.home_deg[1]},
        "altitude": band,
        "vehicle": vehicle,
        "planner": planner,
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
    table = merged(assumed, given, ("keep_outs", "keep_ins", "rally_points"))
    if "area" not in given and (area := _area(table, plan, range_m)):
        table["area"] = area
    sight = "looking ahead" if is_blind else "a terrain radar that sees"
    notes = {
        "vehicle.speed_m_s": f"a {kind} at {speed:g} m/s ({source})",
        "altitude": _about_altitude(plan, band, is_blind=is_blind),
        "area": f"map assumed: {range_m:g} m around launch and targets",
        "planner.scan_range_m": f"assumed: {sight} {range_m:g} m (R), d_s = {distance_m:g} m",
    }
    return table, [*(note for path, note in notes.items() if _at(given, path) is None), *plan.notes]


def _vehicle(kind: str, speed_m_s: float) -> RawTable:
    """What is assumed of a vehicle of this speed."""
    usual = _USUAL[kind]
    table: RawTable = {
        "kind": kind,
        "speed_m_s": speed_m_s,
        "acceleration_m_s2": 2.0,
        "climb_rate_m_s": usual.climb_m_s,
        "tracking_error_m": usual.tracking_m,
        "navigation_error_m": 5.0,
        "turn_radius_m": max(_round_up(speed_m_s**2 / usual.lateral_m_s2), usual.min_radius_m),
    }
    for key, rate_m_s in (("climb", usual.climb_m_s), ("dive", usual.sink_m_s)):
        slope_deg = min(math.degrees(math.atan(rate_m_s / speed_m_s)), usual.max_slope_deg)
        table[f"{key}_angle_deg"] = math.floor(slope_deg * 10.0) / 10.0
    if kind == "plane":
        tightest_m = speed_m_s**2 / (_GRAVITY_M_S2 * math.tan(_LOITER_BANK_RAD))
        table["loiter_radius_m"] = max(_round_up(tightest_m), _MIN_LOITER_M)
    return table


def _round_up(value_m: float) -> float:
    return math.ceil(value_m / 5.0) * 5.0


def _band(
    given: RawTable, plan: Plan, vehicle: RawTable, usual: _Usual, *, is_blind: bool
) -> tuple[RawTable, float]:
    """A band around the altitudes of the waypoints, high enough above launch to begin in it; d_s.

    Without a radar d_s is what the lowest waypoint leaves, and the band begins where paths just
    keep d_s and the errors from the ground, and no higher: what is flown in it are the waypoints'
    own altitudes.
    """
    error_m = sum(
        _number(given, f"vehicle.{key}", vehicle[key], above=0.0)
        for key in ("tracking_error_m", "navigation_error_m")
    )
    ground_m = max(_number(given, "terrain.highest_amsl_m", plan.home_amsl_m), plan.home_amsl_m)
    heights_m, inset_m = plan.altitudes_amsl_m or [plan.home_amsl_m], _SEARCH_ERRORS * error_m
    distance_m = usual.distance_m
    if is_blind:
        targets_m = [t["altitude_amsl_m"] for t in plan.targets if "altitude_amsl_m" in t]
        room_m = min(targets_m, default=math.inf) - ground_m - inset_m
        if room_m < distance_m:
            distance_m = max(float(math.floor(room_m + 1e-6)), usual.min_distance_m)
    distance_m = _number(given, "planner.safety_distance_m", distance_m, above=0.0)
    if is_blind:
        least_m = ground_m + max(distance_m * FLIGHT.margin, distance_m + inset_m) - inset_m
        floor_m = math.ceil(10.0 * max(min(heights_m) - inset_m, least_m) + 1e-6) / 10.0
    else:
        above_ground_m = ground_m + distance_m + 2.0 * error_m
        floor_m = float(math.ceil(max(min(heights_m) - 2.0 * error_m, above_ground_m)))
    ceiling_m = math.ceil(max(max(heights_m) + 2.0 * error_m, floor_m + _BAND_ERRORS * error_m))
    return {"floor_amsl_m": floor_m, "ceiling_amsl_m": float(ceiling_m)}, distance_m


def _area(table: RawTable, plan: Plan, sight_m: float) -> RawTable | None:
    """The box around launch and targets, as far beyond them as the radar sees.

    None: the schema refuses what it would be drawn about.  InputError about the waypoint that makes
    it too large for a map.
    """
    try:
        frame = LocalFrame(**dict(OriginTable.model_validate(table["origin"])))
        targets = [TargetTable.model_validate(target) for target in table.get("targets", ())]
    except (TypeError, ValidationError):
        return None
    local_m = [frame.to_local_m(*plan.home_deg), *(target.local_m(frame) for target in targets)]
    places_m = np.array(local_m, dtype=np.float64)
    if not np.isfinite(places_m).all():
        return None
    low = np.floor(places_m.min(axis=0) - sight_m)
    high = np.ceil(places_m.max(axis=0) + sight_m)
    cells = np.prod(high - low) / max(round(sight_m / CELLS_PER_RANGE), 1) ** 2
    by_radar = _at(table, "scanner.kind") in (None, "terrain_radar")
    if np.abs([low, high]).max() >= FARTHEST_M or (by_radar and cells > MAX_CELLS):
        far_m = np.hypot(*(places_m[1:] - places_m[0]).T)
        farthest = targets[index := int(far_m.argmax())] if targets else None
        if farthest is not None and farthest.degrees is not None:
            far = f"{far_m[index] / 1000.0:,.0f} km from launch {plan.home_deg}"
            remedy = "Correct it or launch, or raise planner.scan_range_m in a mission.toml."
            rule = f"it lies {far}, too far for one map"
            raise InputError(f"{plan.name}: {farthest.name}", [*farthest.degrees], rule, remedy)
    (south, west), (north, east) = low.tolist(), high.tolist()
    return {"north_min_m": south, "north_max_m": north, "east_min_m": west, "east_max_m": east}


def _about_altitude(plan: Plan, band: RawTable, *, is_blind: bool) -> str:
    band_m = f"{band['floor_amsl_m']:g} to {band['ceiling_amsl_m']:g} m AMSL"
    launch, heights_m = f"launch at {plan.home_amsl_m:g} m", plan.altitudes_amsl_m
    if not heights_m:
        return f"altitude: anywhere from {band_m} (assumed; {launch})"
    low, high = f"{min(heights_m):g}", f"{max(heights_m):g}"
    planned = low if low == high else f"{low} to {high}"
    if is_blind:
        return f"altitude: the plan's own, {planned} m AMSL ({launch}), in a band of {band_m}"
    return (
        f"altitude: anywhere from {band_m} (assumed from the plan's {planned} m, {launch} AMSL); "
        "waypoints are passed at any altitude of this band"
    )


def _at(table: RawTable, path: str) -> Any:
    """What stands at a path ("vehicle.kind"); None: nothing."""
    above, _, key = path.rpartition(".")
    inner = _at(table, above) if above else table
    return inner.get(key) if isinstance(inner, dict) else None


def _number(table: RawTable, path: str, default: float, above: float = -1e9) -> float:
    """A number, if that is what is there; what is there otherwise, the schema refuses."""
    value = _at(table, path)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number and above < value < 1e9 else default
