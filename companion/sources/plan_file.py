"""QGroundControl's .plan files: waypoints, fences and rally points.

The format is documented in QGroundControl's developer guide, "Plan File Format".  A waypoint is a
place to reach; its altitude only says between which altitudes the person meant to fly, since the
companion chooses its own within a band.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, final

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from companion.errors import InputError
from companion.mavlink.dialect import wire
from companion.mavlink.mission_items import not_done
from companion.ranges import Longitude, Positive
from companion.sources.files import RawTable, json_table
from companion.sources.schema import validated

_REMEDY = "Give a .plan that QGroundControl has saved."
_MAX_TARGETS = 1000

_PLACES = (16, 82, 17, 18, 19, 31)
"""Commands that go to a place."""
_TAKE_OFFS = (22, 24)
_LAND, _RETURN, _LOITER_FOR_EVER, _DELAY, _ROI, _JUMP = 21, 20, 17, 93, 80, 177
_SET_HOME = 179
_LAST_NAV = 95
_FIXED_WING, _COPTERS = 1, (2, 3, 4, 13, 14, 15, 29, 35)  # MAV_TYPE

_AMSL, _ABOVE_HOME, _ABOVE_TERRAIN = (0, 5), (3, 6), (10, 11)  # MAV_FRAME
_TERRAIN_MODES = (3, 4)
"""AltitudeMode of QGroundControl: above terrain, sent as AMSL (3) or as it is (4)."""
_NAMED = 3
"""So many items of a kind are named, of the others only the number is said."""

Ground = Callable[[float, float], float | None]
"""How high the ground is known to be, AMSL, at a latitude and a longitude; None: it is not."""


class _Json(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


_Corner = Annotated[list[Longitude], Field(min_length=2, max_length=3)]


def _given(value: Any) -> Any:
    """MAVLink says "not given" by no number, JSON by null; some programs write it as a text."""
    return None if isinstance(value, str) and value.lower() in ("nan", "null") else value


_Number = Annotated[float | None, BeforeValidator(_given)]


class _Camera(_Json):
    distance_m: _Number = Field(default=None, alias="DistanceToSurface")
    above_launch: bool = Field(default=True, alias="DistanceToSurfaceRelative")
    mode: int | None = Field(default=None, alias="DistanceMode")

    def frame(self) -> int:
        """What the distance is above, as a MAV_FRAME."""
        by_mode = {1: _ABOVE_HOME, 2: _AMSL, 3: _ABOVE_TERRAIN, 4: _ABOVE_TERRAIN}
        return by_mode.get(self.mode or 0, _ABOVE_HOME if self.above_launch else _AMSL)[0]


class _Transects(_Json):
    items: list["Item"] = Field(default_factory=list, alias="Items")
    points: list[_Corner] = Field(default_factory=list, alias="VisualTransectPoints")
    camera: _Camera = Field(default=_Camera(), alias="CameraCalc")
    follows_terrain: bool = Field(default=False, alias="FollowTerrain")


class Item(_Json):
    """A mission item, as the file has it."""

    type: str = "SimpleItem"
    command: int | None = None
    frame: int = 0
    params: list[_Number] = Field(default_factory=list)
    coordinate: list[_Number] | None = None
    altitude_mode: int | None = Field(default=None, alias="AltitudeMode")
    altitude_m: _Number = Field(default=None, alias="Altitude")
    above_terrain_amsl_m: _Number = Field(default=None, alias="AMSLAltAboveTerrain")
    goes_on: bool = Field(default=True, alias="autoContinue")
    complex_type: str = Field(default="", alias="complexItemType")
    transects: _Transects | None = Field(default=None, alias="TransectStyleComplexItem")


class _Mission(_Json):
    version: Literal[1, 2] = 2
    hover_speed_m_s: _Number = Field(default=None, alias="hoverSpeed")
    cruise_speed_m_s: _Number = Field(default=None, alias="cruiseSpeed")
    vehicle_type: int = Field(default=0, alias="vehicleType")
    home: Annotated[list[_Number], Field(min_length=3, max_length=3)] = Field(
        alias="plannedHomePosition"
    )
    items: list[Item] = Field(default_factory=list)


class _Circle(_Json):
    center: _Corner
    radius: Positive


class _FenceCircle(_Json):
    inclusion: bool
    circle: _Circle


class _FencePolygon(_Json):
    inclusion: bool
    polygon: Annotated[list[_Corner], Field(min_length=3)]


class _Fence(_Json):
    version: Literal[1, 2] = 2
    circles: list[_FenceCircle] = Field(default_factory=list)
    polygons: list[_FencePolygon] = Field(default_factory=list)


class _Rally(_Json):
    version: Literal[1, 2] = 2
    points: list[Annotated[list[float], Field(min_length=2, max_length=3)]] = Field(
        default_factory=list
    )


class _Plan(_Json):
    file_type: Literal["Plan"] = Field(alias="fileType")
    version: Literal[1] = 1
    mission: _Mission
    fence: _Fence = Field(default=_Fence(), alias="geoFence")
    rally: _Rally = Field(default=_Rally(), alias="rallyPoints")


@final
@dataclass(slots=True, kw_only=True)
class Plan:
    """What a .plan holds, as tables of a mission file and numbers."""

    name: str
    """The file's name."""
    kind: str | None
    """ "copter" or "plane"; None: it does not say."""
    speed_m_s: dict[str, float | None]
    """What it says of the speed of each kind."""
    home_deg: tuple[float, float]
    home_amsl_m: float
    targets: list[RawTable] = field(default_factory=list)
    altitudes_amsl_m: list[float] = field(default_factory=list)
    """Of take-off and waypoints, those that are known."""
    target_amsl_m: list[float | None] = field(default_factory=list)
    """Of each target; None: as the one before it."""
    unknown_altitudes: list[tuple[str, float]] = field(default_factory=list)
    """Items at so many metres above terrain where it is not known how high that is."""
    end_action: str = "hold"
    keep_outs: list[RawTable] = field(default_factory=list)
    keep_ins: list[RawTable] = field(default_factory=list)
    rally_points: list[RawTable] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What was left out, for people."""

    @property
    def stem(self) -> str:
        """The file's name without its ending: what a mission is called that has no other name."""
        return Path(self.name).stem

    def add_zone(self, name: str, shape: RawTable, *, inside: bool) -> None:
        """A circle (latitude_deg, longitude_deg, radius_m) or a polygon (vertices_deg)."""
        (self.keep_ins if inside else self.keep_outs).append({"name": name, **shape})

    def add_rally_point(self, latitude_deg: float, longitude_deg: float) -> None:
        """A place to return to."""
        self.rally_points.append({"latitude_deg": latitude_deg, "longitude_deg": longitude_deg})


def read_plan(path: Path, where: str, ground: Ground | None = None) -> Plan:
    """The plan in a file; ground: what is known of it, for altitudes above terrain.

    Raises InputError about the field (where) if it cannot be read as a .plan, or naming the item
    that cannot be flown: jumps, take-off or landing as a VTOL, places without a known datum.
    """
    found = json_table(path, where, _REMEDY, nan_is_null=True)
    if found.get("fileType") != "Plan":
        raise InputError(where, str(path), "it is no QGroundControl plan", _REMEDY)
    content = validated(_Plan, found, path.name)
    mission = content.mission
    launch = f"{path.name}: mission.plannedHomePosition"
    remedy = "Set it in QGroundControl (Mission Start)."
    latitude, longitude, altitude = launch_of(mission.home, launch, remedy)
    plan = Plan(
        name=path.name,
        kind=_kind(mission.vehicle_type, path.name),
        speed_m_s={"copter": mission.hover_speed_m_s, "plane": mission.cruise_speed_m_s},
        home_deg=(latitude, longitude),
        home_amsl_m=altitude,
    )
    _add_fences(plan, content)
    reader = Items(plan, ground)
    for number, item in enumerate(mission.items):
        reader.take(item, f"{path.name}: mission.items[{number}]")
    reader.finish()
    return plan


def _kind(vehicle_type: int, name: str) -> str | None:
    if vehicle_type in (0, _FIXED_WING, *_COPTERS):
        return {0: None, _FIXED_WING: "plane"}.get(vehicle_type, "copter")
    label = _enum_name("MAV_TYPE", vehicle_type)
    rule = f"it is for {label}, and only multicopters and planes are flown"
    remedy = "Plan for one of these in QGroundControl."
    raise InputError(f"{name}: mission.vehicleType", vehicle_type, rule, remedy)


def _add_fences(plan: Plan, content: _Plan) -> None:
    for number, circle in enumerate(content.fence.circles):
        latitude, longitude = circle.circle.center[:2]
        check_place(latitude, longitude, f"{plan.name}: geoFence.circles[{number}]")
        place = {"latitude_deg": latitude, "longitude_deg": longitude}
        shape = place | {"radius_m": circle.circle.radius}
        plan.add_zone(f"fence circle {number + 1}", shape, inside=circle.inclusion)
    for number, polygon in enumerate(content.fence.polygons):
        for corner in polygon.polygon:
            check_place(corner[0], corner[1], f"{plan.name}: geoFence.polygons[{number}]")
        corners = [corner[:2] for corner in polygon.polygon]
        outline = {"vertices_deg": corners}
        plan.add_zone(f"fence polygon {number + 1}", outline, inside=polygon.inclusion)
    if len(plan.keep_ins) > 1:
        plan.notes.append(f"the vehicle keeps inside of all {len(plan.keep_ins)} inclusion fences")
    for number, point in enumerate(content.rally.points):
        check_place(point[0], point[1], f"{plan.name}: rallyPoints.points[{number}]")
        plan.add_rally_point(point[0], point[1])


@final
class Items:
    """The mission items of a plan, one after the other."""

    def __init__(self, plan: Plan, ground: Ground | None = None) -> None:
        self._plan, self._ground = plan, ground
        self._ended_by, self._home_moves = "", False
        self._left_out: dict[str, int] = {}
        self._above_ground: list[str] = []
        self._without_altitude: list[str] = []

    def take(self, item: Item, where: str) -> None:
        """Add an item to the plan.  Raises InputError naming it if it cannot be flown."""
        if item.type == "ComplexItem":
            self._take_complex(item, where)
        elif item.command is None:
            raise InputError(f"{where}.command", None, "it is missing", _REMEDY)
        else:
            self._take_simple(item, item.command, where)

    def finish(self) -> None:
        """Say what was left out."""
        if self._left_out:
            listed = ", ".join(f"{n} x {name}" for name, n in self._left_out.items())
            self._plan.notes.append(f"left out: {listed}")
        if self._above_ground:
            which = listing(self._above_ground)
            self._plan.notes.append(f"above terrain, taken above the ground of [terrain]: {which}")
        if self._without_altitude:
            which = listing(self._without_altitude)
            self._plan.notes.append(f"without an altitude, so that of the one before: {which}")

    def _take_complex(self, item: Item, where: str) -> None:
        if item.complex_type.endswith("LandingPattern"):
            self._leave_out(item.complex_type)
        elif item.transects is not None and item.transects.items:
            for number, inner in enumerate(item.transects.items):
                self.take(inner, f"{where}.TransectStyleComplexItem.Items[{number}]")
        elif item.transects is not None and item.transects.points:
            camera = item.transects.camera
            frame = _ABOVE_TERRAIN[0] if item.transects.follows_terrain else camera.frame()
            for number, point in enumerate(item.transects.points):
                at = Item(frame=frame, coordinate=[*point[:2], camera.distance_m])
                label = f"{where} transect point {number + 1}"
                self._add_target(point[0], point[1], label, self._note_altitude(at, label))
        else:
            rule = "it holds no waypoints"
            remedy = "Replace it by waypoints."
            raise InputError(f"{where}.complexItemType", item.complex_type, rule, remedy)

    def _take_simple(self, item: Item, command: int, where: str) -> None:
        if command in _PLACES:
            self._take_place(item, command, where)
        elif command in _TAKE_OFFS:
            if self._plan.targets:  # once in the air it takes off no more
                self._leave_out(_enum_name("MAV_CMD", command))
            else:
                self._note_altitude(item, where)
        elif command == _RETURN:
            self._end("return", command)
        elif command == _LAND:
            latitude, longitude = _place(item)
            if latitude or longitude:
                self._add_target(latitude, longitude, where)
            self._end("land", command)
        elif command == _SET_HOME:
            self._home_moves = True
            self._leave_out(_enum_name("MAV_CMD", command))
        elif command == _JUMP or (command <= _LAST_NAV and command not in (_DELAY, _ROI)):
            rule = f"{_enum_name('MAV_CMD', command)} cannot be flown by the companion"
            remedy = "Replace it by waypoints."
            raise InputError(f"{where}.command", command, rule, remedy)
        else:
            self._leave_out(_enum_name("MAV_CMD", command))

    def _take_place(self, item: Item, command: int, where: str) -> None:
        latitude, longitude = _place(item)
        if latitude is None or longitude is None or (latitude == 0.0 and longitude == 0.0):
            rule = "it has no latitude and longitude"
            remedy = "Put it on the map."
            raise InputError(f"{where}.params", [latitude, longitude], rule, remedy)
        altitude = self._note_altitude(item, where)
        self._add_target(latitude, longitude, where, altitude)
        if command == _LOITER_FOR_EVER:
            self._end("hold", command)
        for words in not_done(command, item.params[:4]):
            self._leave_out(words)
        if not item.goes_on:
            self._leave_out("stop at a waypoint (autocontinue 0)")

    def _add_target(
        self, latitude: Any, longitude: Any, where: str, altitude_amsl_m: float | None = None
    ) -> None:
        if self._ended_by:
            remedy = "Remove what comes after it, or move it to the end."
            raise InputError(where, self._ended_by, "the mission ends before this item", remedy)
        check_place(latitude, longitude, where)
        targets = self._plan.targets
        if len(targets) >= _MAX_TARGETS:
            rule = f"it has more than {_MAX_TARGETS} waypoints"
            raise InputError(where, len(targets) + 1, rule, "Divide the plan.")
        targets.append(
            {"name": self._short(where), "latitude_deg": latitude, "longitude_deg": longitude}
        )
        self._plan.target_amsl_m.append(altitude_amsl_m)

    def _end(self, action: str, command: int) -> None:
        self._plan.end_action = action
        self._ended_by = _enum_name("MAV_CMD", command)

    def _leave_out(self, what: str) -> None:
        self._left_out[what] = self._left_out.get(what, 0) + 1

    def _note_altitude(self, item: Item, where: str) -> float | None:
        """How high an item was meant to be, AMSL, if that can be known: remembered."""
        numbers = item.params[4:] if item.coordinate is None else item.coordinate
        given = numbers[2] if len(numbers) > 2 else None
        if item.frame in _ABOVE_TERRAIN or item.altitude_mode in _TERRAIN_MODES:
            altitude = self._above_terrain(item, given, where)
        elif item.frame in (*_ABOVE_HOME, *_AMSL):
            if self._home_moves and item.frame in _ABOVE_HOME:
                rule = "do set home comes before it, so what its altitude is above is not known"
                remedy = "Remove that, or give altitudes above mean sea level."
                raise InputError(f"{where}.frame", item.frame, rule, remedy)
            above_m = self._plan.home_amsl_m if item.frame in _ABOVE_HOME else 0.0
            altitude = None if given is None else above_m + given
            if altitude is None and item.command not in _TAKE_OFFS:
                self._without_altitude.append(self._short(where))
        else:
            rule = "what its altitude is above is not known"
            remedy = "Give altitudes above launch or above mean sea level."
            raise InputError(f"{where}.frame", item.frame, rule, remedy)
        if altitude is not None:
            self._plan.altitudes_amsl_m.append(altitude)
        return altitude

    def _above_terrain(self, item: Item, given: float | None, where: str) -> float | None:
        """By the plan's own word of it, else by the ground that is known there."""
        if item.above_terrain_amsl_m is not None:
            return item.above_terrain_amsl_m
        if item.frame in _AMSL and given not in (None, item.altitude_m):
            return given  # AltitudeMode 3: this is what is sent
        height_m = given if item.altitude_m is None else item.altitude_m
        if height_m is None:
            self._without_altitude.append(self._short(where))
            return None
        if item.command in _TAKE_OFFS:  # at launch, which stands on the ground
            return self._plan.home_amsl_m + height_m
        latitude, longitude = _place(item)
        known = self._ground is not None and latitude is not None and longitude is not None
        ground_m = self._ground(latitude, longitude) if known else None  # type: ignore[misc, arg-type]
        if ground_m is None:
            self._plan.unknown_altitudes.append((where, height_m))
            return None
        self._above_ground.append(self._short(where))
        return ground_m + height_m

    def _short(self, where: str) -> str:
        return where.removeprefix(f"{self._plan.name}: ").removeprefix("mission.")


def listing(names: list[str]) -> str:
    """Some of them by name, and how many there are."""
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def launch_of(home: list[float | None], field: str, remedy: str) -> tuple[float, float, float]:
    """Latitude, longitude and altitude of launch.  Raises InputError if there is no such place."""
    latitude, longitude, altitude = home
    if latitude is None or longitude is None or (latitude == 0.0 and longitude == 0.0):
        raise InputError(field, home, "launch has no latitude and longitude", remedy)
    check_place(latitude, longitude, field)
    if altitude is None:
        rule = "the altitude of launch is missing, and the plan's altitudes are measured from it"
        raise InputError(field, home, rule, f"{remedy} Or write its metres AMSL there.")
    return latitude, longitude, altitude


def _place(item: Item) -> tuple[float | None, float | None]:
    """Latitude and longitude, which old files have in a list of their own."""
    numbers = item.params[4:6] if item.coordinate is None else item.coordinate[:2]
    return (numbers[0], numbers[1]) if len(numbers) == 2 else (None, None)


def check_place(latitude: Any, longitude: Any, where: str) -> None:
    """Raise InputError about the field (where) if there is no such place, in degrees."""
    in_range = latitude is not None and longitude is not None
    if not (in_range and abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        rule = "out of range: latitude, -90 to 90, then longitude, -180 to 180"
        raise InputError(where, [latitude, longitude], rule, "Correct it.")


def _enum_name(enum: str, value: int) -> str:
    entry = wire.enums[enum].get(value)
    known = str(entry.name) if entry is not None else f"{enum} {value}"
    return known.removeprefix(f"{enum}_").lower().replace("_", " ")
