"""The world file: the truth that the simulator flies in.  Parsed once, at the door.

Every class is one table of world.toml.  Unknown keys are refused with the nearest known one named,
and so is an altitude whose key does not say what it is measured from.
"""

import dataclasses
import difflib
import itertools
import math
import tomllib
import types
import typing
from collections.abc import Sequence
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Literal, final

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from vehicle_sim.elevation import VerticalDatum, read_grid
from vehicle_sim.errors import InputError, did_you_mean
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.parameters import Firmware
from vehicle_sim.rng import generator
from vehicle_sim.scene import Scene, Upright, drawn_wood
from vehicle_sim.sensors.lidar import LidarTable
from vehicle_sim.terrain import Combine, PeakTerrain, Terrain

_REFUSE_UNKNOWN = ConfigDict(extra="forbid")
_Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Positive = Annotated[_Real, Field(gt=0)]
_Local = Annotated[_Real, Field(ge=-5e6, le=5e6)]
_Altitude = Annotated[_Real, Field(ge=-1000, le=20000)]
_Speed = Annotated[_Real, Field(gt=0, le=300)]
_Acceleration = Annotated[_Real, Field(gt=0, le=200)]
_Name = Annotated[str, Field(strict=True, min_length=1)]


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class Origin:
    """Where the local frame touches the ellipsoid."""

    latitude_deg: Annotated[_Real, Field(ge=-85, le=85)]
    longitude_deg: Annotated[_Real, Field(ge=-180, le=180)]


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class Peak:
    """One mountain (eq. 1)."""

    north_m: _Local
    east_m: _Local
    height_amsl_m: Annotated[_Altitude, Field(gt=0)]
    spread_north_m: _Positive
    spread_east_m: _Positive


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class TerrainTable:
    """What the ground looks like: peaks over a plain, or an elevation file."""

    combine: Combine | None = None
    ground_amsl_m: _Altitude | None = None
    peaks: tuple[Peak, ...] = ()
    file: _Name | None = None
    """Beside the world file."""
    vertical_datum: VerticalDatum | None = None
    nodata: Literal["sea"] | _Altitude | None = None
    """What is where the file has no height."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class AreaTable:
    """How much of an elevation file is needed."""

    north_min_m: _Local
    north_max_m: _Local
    east_min_m: _Local
    east_max_m: _Local


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class Threat:
    """A radar that looks for the vehicle (eq. 3): a sphere about the point."""

    name: _Name
    north_m: _Local
    east_m: _Local
    altitude_amsl_m: _Altitude
    range_m: _Positive


VehicleKind = Literal["copter", "plane"]


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class Vehicle:
    """What flies, and where it stands at the start: on the terrain.

    What a file leaves out of a copter's limits is what the real autopilots' simulated quadcopters
    can do (autopilots/factory.py), and of a plane's likewise.
    """

    kind: VehicleKind
    autopilot: Firmware
    system_id: Annotated[int, Field(strict=True, ge=1, le=255)] = 1
    north_m: _Local = 0.0
    east_m: _Local = 0.0
    heading_deg: Annotated[_Real, Field(ge=-360, le=360)] = 0.0
    speed_max_m_s: _Speed | None = None
    """Of copters, horizontal, as the next one."""
    acceleration_max_m_s2: _Acceleration | None = None
    speed_vertical_max_m_s: _Speed | None = None
    acceleration_vertical_max_m_s2: _Acceleration | None = None
    drag_1_s: Annotated[_Real, Field(ge=0, le=10)] | None = None
    """Of copters: deceleration for each metre a second through the air."""
    airspeed_min_m_s: _Speed | None = None
    """Of planes, as the next four; the cruising speed is a parameter of the autopilot."""
    airspeed_max_m_s: _Speed | None = None
    bank_max_deg: Annotated[_Real, Field(gt=0, le=80)] | None = None
    climb_max_m_s: _Speed | None = None
    sink_max_m_s: _Speed | None = None
    parameters: dict[str, Annotated[_Real, Field()]] = field(default_factory=dict)
    """The autopilot's own, by their names and in their units."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class Scanner:
    """The terrain radar on board: a MAVLink component of its own."""

    component_id: Annotated[int, Field(strict=True, ge=2, le=255)]
    range_m: _Positive


_Place = tuple[_Local, _Local]
"""North and east."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class Tree:
    """A cylinder on the ground."""

    north_m: _Local
    east_m: _Local
    radius_m: _Positive
    height_m: _Positive
    """Above the ground, as those of buildings, walls and wires."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class Building:
    """A prism with a flat roof; its height is above the highest ground at a corner."""

    corners_ne_m: Annotated[tuple[_Place, ...], Field(min_length=3)]
    height_m: _Positive


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class Wall:
    """Upright along a line of points; its ends are round."""

    points_ne_m: Annotated[tuple[_Place, ...], Field(min_length=2)]
    thickness_m: _Positive
    height_m: _Positive


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class Wire:
    """Level between two ends: it can be touched, and no lidar sees it."""

    ends_ne_m: tuple[_Place, _Place]
    height_m: _Positive
    thickness_m: _Positive = 0.02


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class Clearing:
    """Where no tree of a wood stands."""

    north_m: _Local
    east_m: _Local
    radius_m: _Positive


_Range = tuple[_Positive, _Positive]
"""Least and most."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class Wood:
    """Trees that are drawn when the world is read: the same ones for the same seed."""

    seed: Annotated[int, Field(strict=True, ge=0)]
    north_min_m: _Local
    north_max_m: _Local
    east_min_m: _Local
    east_max_m: _Local
    spacing_m: _Range
    """Between two trees, from middle to middle: it varies from place to place."""
    radius_m: _Range
    height_m: _Range
    clearing_share: Annotated[_Real, Field(ge=0, le=0.9)] = 0.0
    """Of the area: clearings that are drawn too."""
    clearings: tuple[Clearing, ...] = ()
    """These are always there."""

    def trees(self) -> list[Tree]:
        """As drawn."""
        rng = generator(self.seed, "wood")
        edges_m = (self.north_min_m, self.north_max_m, self.east_min_m, self.east_max_m)
        places = drawn_wood(rng, edges_m, self.spacing_m, self.clearing_share)
        (thin, thick), (low, high) = self.radius_m, self.height_m
        draws = rng.random((len(places), 2)) * [thick - thin, high - low] + [thin, low]
        return [
            Tree(north_m=north, east_m=east, radius_m=radius, height_m=height)
            for (north, east), (radius, height) in zip(places.tolist(), draws.tolist(), strict=True)
            if all(
                math.hypot(north - c.north_m, east - c.east_m) >= c.radius_m + radius
                for c in self.clearings
            )
        ]


@final
@dataclass(frozen=True, slots=True, kw_only=True, config=_REFUSE_UNKNOWN)
class World:
    """One world file."""

    schema: Literal[1]
    name: _Name
    origin: Origin
    terrain: TerrainTable
    vehicle: Vehicle
    scanner: Scanner | None = None
    """Left out: the vehicle has none."""
    radars: tuple[Threat, ...] = ()
    area: AreaTable | None = None
    trees: tuple[Tree, ...] = ()
    woods: tuple[Wood, ...] = ()
    buildings: tuple[Building, ...] = ()
    walls: tuple[Wall, ...] = ()
    wires: tuple[Wire, ...] = ()
    lidar: LidarTable | None = None
    second_lidar: LidarTable | None = None
    """With `output = "autopilot"`, beside one with a driver of its own."""

    @property
    def lidars(self) -> tuple[LidarTable, ...]:
        """All on board."""
        return tuple(each for each in (self.lidar, self.second_lidar) if each is not None)

    @property
    def frame(self) -> LocalFrame:
        """The local frame that positions in the file are given in."""
        return LocalFrame(
            latitude_deg=self.origin.latitude_deg, longitude_deg=self.origin.longitude_deg
        )

    def truth(self) -> Terrain:
        """The terrain itself."""
        table, area = self.terrain, self.area
        if table.file is not None:
            assert area is not None
            edges = (area.north_min_m, area.north_max_m, area.east_min_m, area.east_max_m)
            return read_grid(Path(table.file), self.frame, edges, table.nodata)
        assert table.combine is not None
        assert table.ground_amsl_m is not None
        rows = [
            (p.north_m, p.east_m, p.height_amsl_m, p.spread_north_m, p.spread_east_m)
            for p in table.peaks
        ]
        return PeakTerrain.of(rows, combine=table.combine, ground_amsl_m=table.ground_amsl_m)

    def scene(self, terrain: Terrain | None = None) -> Scene:
        """Terrain and near things: `distance_m` of it is the true clearance of any points."""
        terrain = terrain or self.truth()
        trees = [*self.trees, *(tree for wood in self.woods for tree in wood.trees())]
        things = [
            _standing(terrain, [(t.north_m, t.east_m)], t.radius_m, t.height_m) for t in trees
        ]
        for building in self.buildings:
            prism = _standing(terrain, building.corners_ne_m, 0.0, building.height_m)
            things.append(prism._replace(closed=True))
        for wall in self.walls:
            points, half_m = wall.points_ne_m, 0.5 * wall.thickness_m
            things += [
                _standing(terrain, ends, half_m, wall.height_m)
                for ends in itertools.pairwise(points)
            ]
        for wire in self.wires:
            half_m = 0.5 * wire.thickness_m
            line = _standing(terrain, wire.ends_ne_m, half_m, wire.height_m + half_m)
            bottom_m = line.top_amsl_m - wire.thickness_m
            things.append(line._replace(bottom_amsl_m=bottom_m, visible=False))
        return Scene(terrain, things)

    def with_woods_of(self, seed: int) -> "World":
        """The same world with other trees in its woods: what benchmarks draw."""
        woods = (dataclasses.replace(wood, seed=seed + k) for k, wood in enumerate(self.woods))
        return dataclasses.replace(self, woods=tuple(woods))


def _standing(
    terrain: Terrain, corners_ne_m: Sequence[_Place], half_width_m: float, height_m: float
) -> Upright:
    """On the ground, and as high above its highest at a corner."""
    ground_amsl_m = max(terrain.height_at_amsl_m(*corner) for corner in corners_ne_m)
    return Upright(corners_ne_m, half_width_m, -math.inf, ground_amsl_m + height_m)


_WORLD = TypeAdapter(World)


def read_world(path: Path) -> World:
    """The world in this file; InputError says what is wrong with it."""
    field = str(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise InputError(
            "WORLD", field, f"cannot be read ({reason})", "Name a world file."
        ) from None
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError("WORLD", field, f"not TOML ({error})", "Name a world.toml.") from None
    return parse_world(table, path.parent)


def parse_world(table: dict[str, Any], folder: Path | None = None) -> World:
    """The world that this TOML table describes; its elevation file is in the folder."""
    is_mission = bool(table.keys() & {"targets", "planner", "area"})
    if "terrain" not in table and (is_mission or not table.keys() & {"vehicle", "scanner"}):
        what = "a mission" if is_mission else "something else"
        raise InputError(
            "WORLD",
            table.get("name", "file"),
            f"describes {what}, not a world",
            "Name a world.toml.",
        )
    try:
        world = _WORLD.validate_python(table)
    except ValidationError as error:
        problems = error.errors()
        # A misspelt key is both unknown and missing: the unknown one tells the user more.
        unknown = [p for p in problems if p["type"] == "unexpected_keyword_argument"]
        raise _explained((unknown or problems)[0]) from None
    _check_terrain(world)
    _check_vehicle(world.vehicle)
    _check_near(world)
    if folder is None or world.terrain.file is None:
        return world
    beside = str(folder / world.terrain.file)
    return dataclasses.replace(world, terrain=dataclasses.replace(world.terrain, file=beside))


def _check_terrain(world: World) -> None:
    """An elevation file with its datum and area, or peaks over a plain."""
    table, area = world.terrain, world.area
    needed: dict[str, object] = {
        "terrain.combine": table.combine,
        "terrain.ground_amsl_m": table.ground_amsl_m,
    }
    if table.file is not None:
        needed = {"terrain.vertical_datum": table.vertical_datum, "area": area}
    for key, value in needed.items():
        if value is None:
            raise InputError(key, None, "is missing", "Write it into the world file.")
    if table.file is not None and (table.combine or table.peaks or table.ground_amsl_m):
        rule = "an elevation file leaves no room for peaks and ground"
        raise InputError("terrain.file", table.file, rule, "Leave out one of the two.")
    if area and (area.north_min_m >= area.north_max_m or area.east_min_m >= area.east_max_m):
        rule = "its least must lie below its most"
        raise InputError("area", dataclasses.asdict(area), rule, "Swap or widen them.")


_OF_COPTERS = (
    "speed_max_m_s",
    "acceleration_max_m_s2",
    "speed_vertical_max_m_s",
    "acceleration_vertical_max_m_s2",
    "drag_1_s",
)
_OF_PLANES = (
    "airspeed_min_m_s",
    "airspeed_max_m_s",
    "bank_max_deg",
    "climb_max_m_s",
    "sink_max_m_s",
)


def _check_vehicle(vehicle: Vehicle) -> None:
    """No limits of another kind of vehicle."""
    others = _OF_PLANES if vehicle.kind == "copter" else _OF_COPTERS
    for key in others:
        value = getattr(vehicle, key)
        if value is not None:
            rule = f"a {vehicle.kind} has no such limit"
            raise InputError(f"vehicle.{key}", value, rule, "Leave it out.")
    slowest, fastest = vehicle.airspeed_min_m_s, vehicle.airspeed_max_m_s
    if slowest is not None and fastest is not None and slowest >= fastest:
        rule = "must be less than airspeed_max_m_s"
        raise InputError("vehicle.airspeed_min_m_s", slowest, rule, "Swap or widen them.")


_MOST_TREES = 200_000


def _check_near(world: World) -> None:
    """Ranges that are none, shapes without extent, and a lidar that nothing reads."""
    for k, wood in enumerate(world.woods):
        north_m, east_m = wood.north_max_m - wood.north_min_m, wood.east_max_m - wood.east_min_m
        if north_m <= 0.0 or east_m <= 0.0:
            rule = "its least must lie below its most"
            raise InputError(f"woods.{k}", (north_m, east_m), rule, "Swap or widen them.")
        for key in ("spacing_m", "radius_m", "height_m"):
            if getattr(wood, key)[0] > getattr(wood, key)[1]:
                rule = "gives the least first"
                raise InputError(f"woods.{k}.{key}", getattr(wood, key), rule, "Swap them.")
        if north_m * east_m > _MOST_TREES * wood.spacing_m[0] ** 2:
            rule = f"would have more than {_MOST_TREES} trees"
            raise InputError(f"woods.{k}.spacing_m", wood.spacing_m, rule, "Widen it.")
    for k, building in enumerate(world.buildings):
        if len(set(building.corners_ne_m)) < len(building.corners_ne_m):
            field, rule = f"buildings.{k}.corners_ne_m", "names a corner twice"
            raise InputError(field, building.corners_ne_m, rule, "Leave one out.")
    if (second := world.second_lidar) is not None:
        beside = world.lidar is not None and world.lidar.output != "autopilot"
        if second.output != "autopilot" or not beside:
            rule = "is an autopilot's, beside a [lidar] that is not"
            remedy = 'Write second_lidar.output = "autopilot", or leave the table out.'
            raise InputError("second_lidar.output", second.output, rule, remedy)
        _check_lidar(world, "second_lidar", second)
    if (lidar := world.lidar) is None:
        return
    _check_lidar(world, "lidar", lidar)
    if world.scanner is not None and world.scanner.component_id == lidar.component_id:
        rule = "is the terrain radar's too"
        raise InputError("lidar.component_id", lidar.component_id, rule, "Choose another.")


def _check_lidar(world: World, name: str, lidar: LidarTable) -> None:
    if lidar.min_m >= lidar.range_m:
        rule = f"must be less than range_m, which is {lidar.range_m:g}"
        raise InputError(f"{name}.min_m", lidar.min_m, rule, "Lessen it.")
    if lidar.output == "autopilot" and world.vehicle.autopilot != "ardupilot":
        rule = f"{world.vehicle.autopilot} has no driver for it"
        raise InputError(f"{name}.output", lidar.output, rule, "Write driver.")


def flat_world(
    kind: VehicleKind,
    autopilot: Firmware,
    *,
    latitude_deg: float,
    longitude_deg: float,
    altitude_amsl_m: float,
    heading_deg: float,
    system_id: int = 1,
    scan_range_m: float | None = None,
) -> World:
    """Level ground at the height of home, for as far as one can fly."""
    return World(
        schema=1,
        name="flat",
        origin=Origin(latitude_deg=latitude_deg, longitude_deg=longitude_deg),
        terrain=TerrainTable(combine="maximum", ground_amsl_m=altitude_amsl_m),
        vehicle=Vehicle(
            kind=kind, autopilot=autopilot, heading_deg=heading_deg, system_id=system_id
        ),
        scanner=None if scan_range_m is None else Scanner(component_id=100, range_m=scan_range_m),
    )


REMOVED = {
    "traffic": "Leave it out: nobody reads ADS-B any more.",
}
"""Keys and values ("table.key = value") of files for versions before, and what to do instead."""


def _explained(problem: Any) -> InputError:
    """What pydantic found, in words."""
    location: tuple[str | int, ...] = problem["loc"]
    field = ".".join(str(part) for part in location)
    key = ".".join(part for part in location if isinstance(part, str))
    if remedy := REMOVED.get(key) or REMOVED.get(f"{key} = {problem['input']}"):
        return InputError(field, problem["input"], "was removed in this version", remedy)
    if problem["type"] == "unexpected_keyword_argument":
        return _unknown_key(field, location, problem["input"])
    if problem["type"] == "missing":
        return InputError(field, None, "is missing", "Write it into the world file.")
    rule = problem["msg"].removeprefix("Input should be ")
    known = {"terrain": "a table", "float_type": "a number", "int_type": "a whole number"}
    rule = known.get(problem["type"], rule)
    return InputError(field, problem["input"], f"must be {rule}", "Correct the world file.")


def _unknown_key(field: str, location: Sequence[str | int], value: object) -> InputError:
    """An unknown key: the nearest known one, and a word about datums where one is missing."""
    key = str(location[-1])
    known = _keys_of(location[:-1])
    datums = [k for k in known if k.endswith("_amsl_m")]
    word = next((w for w in ("altitude", "height", "ground", "elevation") if w in key), None)
    if word and datums and key not in known:
        nearest = difflib.get_close_matches(key, datums, n=1, cutoff=0.0)[0]
        rule = "an altitude names its datum, and here it is above mean sea level (amsl)"
        return InputError(field, value, rule, f"Write {nearest}.")
    remedy = did_you_mean(key, known, f"Choose from: {', '.join(known)}.")
    return InputError(field, value, "no such key", remedy)


def _keys_of(location: Sequence[str | int]) -> list[str]:
    """The keys that the table at this place may have."""
    table: Any = World
    for part in location:
        if isinstance(part, str):
            table = typing.get_type_hints(table)[part]
            if isinstance(table, types.GenericAlias | types.UnionType):
                table = typing.get_args(table)[0]
    return [f.name for f in dataclasses.fields(table)]
