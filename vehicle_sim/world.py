"""The world file: the truth that the simulator flies in.  Parsed once, at the door.

Every class is one table of world.toml.  Unknown keys are refused with the nearest known one named.
"""

import dataclasses
import itertools
import math
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar, dataclass_transform

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from vehicle_sim.elevation import VerticalDatum, read_grid
from vehicle_sim.errors import InputError, did_you_mean
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.parameters import Firmware
from vehicle_sim.rng import generator
from vehicle_sim.scene import Scene, Upright, drawn_wood
from vehicle_sim.terrain import Combine, PeakTerrain, Terrain

_Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Positive = Annotated[_Real, Field(gt=0)]
_Local = Annotated[_Real, Field(ge=-5e6, le=5e6)]
_Altitude = Annotated[_Real, Field(ge=-1000, le=20000)]
_Speed = Annotated[_Real, Field(gt=0, le=300)]
_Acceleration = Annotated[_Real, Field(gt=0, le=200)]
_Turn = Annotated[_Real, Field(ge=-360, le=360)]
_Share = Annotated[_Real, Field(ge=0, le=1)]
_Rate = Annotated[_Real, Field(ge=0.5, le=50)]
_Name = Annotated[str, Field(strict=True, min_length=1)]
_Component = Annotated[int, Field(strict=True, ge=2, le=255)]
_Place = tuple[_Local, _Local]
"""North and east."""
_Range = tuple[_Positive, _Positive]
"""Least and most."""
_T = TypeVar("_T")
_MISSING: Final = ("is missing", "Write it into the world file.")
_MOST_TREES: Final = 200_000


_KEYS: Final = dict[str, None]()
"""Those of all tables."""


def _must(holds: bool, key: str, value: object, rule: str, remedy: str) -> None:
    """A rule that keys of a table make together; `key` "" is the table itself."""
    if not holds:
        raise ValueError(key, value, rule, remedy)


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(field,))
def _table(kind: type[_T]) -> type[_T]:
    """A table of the file: it refuses keys that it does not know."""
    config = ConfigDict(extra="forbid")
    made: Any = dataclass(frozen=True, slots=True, kw_only=True, config=config)(kind)
    _KEYS.update(dict.fromkeys(each.name for each in dataclasses.fields(made)))
    return made


@_table
class _Placed:
    """Something at a place of the local frame."""

    north_m: _Local
    east_m: _Local


@_table
class Origin:
    """Where the local frame touches the ellipsoid."""

    latitude_deg: Annotated[_Real, Field(ge=-85, le=85)]
    longitude_deg: Annotated[_Real, Field(ge=-180, le=180)]


@_table
class Peak(_Placed):
    """One mountain (eq. 1)."""

    height_amsl_m: Annotated[_Altitude, Field(gt=0)]
    spread_north_m: _Positive
    spread_east_m: _Positive


@_table
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

    def __post_init__(self) -> None:
        peaks = {"combine": self.combine, "ground_amsl_m": self.ground_amsl_m}
        if self.file is None:
            for key, value in peaks.items():
                _must(value is not None, key, value, *_MISSING)
        else:
            rule = "an elevation file leaves no room for peaks and ground"
            none = not self.peaks and set(peaks.values()) == {None}
            _must(none, "file", self.file, rule, "Leave out one of the two.")


@_table
class AreaTable:
    """How much of an elevation file is needed."""

    north_min_m: _Local
    north_max_m: _Local
    east_min_m: _Local
    east_max_m: _Local

    def __post_init__(self) -> None:
        south, north, west, east = self.edges_m
        rule = "its least must lie below its most"
        _must(south < north and west < east, "", self.edges_m, rule, "Swap or widen them.")

    @property
    def edges_m(self) -> tuple[float, float, float, float]:
        """South, north, west, east."""
        return self.north_min_m, self.north_max_m, self.east_min_m, self.east_max_m


@_table
class Threat(_Placed):
    """A radar that looks for the vehicle (eq. 3): a sphere about the point."""

    name: _Name
    altitude_amsl_m: _Altitude
    range_m: _Positive


VehicleKind = Literal["copter", "plane"]


@_table
class Vehicle:
    """What flies, and where it stands at the start: on the terrain.

    What a file leaves out of a copter's limits is what the real autopilots' simulated quadcopters
    can do (autopilot/factory.py), and of a plane's likewise.
    """

    kind: VehicleKind
    autopilot: _Name
    """"ardupilot" or "px4"; of a copter also "ideal", a law that no autopilot has."""
    system_id: Annotated[int, Field(strict=True, ge=1, le=254)] = 1
    north_m: _Local = 0.0
    east_m: _Local = 0.0
    heading_deg: _Turn = 0.0
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

    def __post_init__(self) -> None:
        copters = (*LIMITS["copter"], "drag_1_s")
        for key in LIMITS["plane"] if self.kind == "copter" else copters:
            value, rule = getattr(self, key), f"a {self.kind} has no such limit"
            _must(value is None, key, value, rule, "Leave it out.")


LIMITS: Final[dict[VehicleKind, tuple[str, ...]]] = {
    "copter": (
        *("speed_max_m_s", "acceleration_max_m_s2"),
        *("speed_vertical_max_m_s", "acceleration_vertical_max_m_s2"),
    ),
    "plane": (
        *("airspeed_min_m_s", "airspeed_max_m_s", "bank_max_deg"),
        *("climb_max_m_s", "sink_max_m_s"),
    ),
}
"""The keys of a kind's own limits."""


@_table
class Scanner:
    """The terrain radar on board: a MAVLink component of its own."""

    component_id: _Component
    range_m: _Positive


@_table
class Tree(_Placed):
    """A cylinder on the ground."""

    radius_m: _Positive
    height_m: _Positive
    """Above the ground, as those of buildings, walls and wires."""


@_table
class Building:
    """A prism with a flat roof; its height is above the highest ground at a corner."""

    corners_ne_m: Annotated[tuple[_Place, ...], Field(min_length=3)]
    height_m: _Positive


@_table
class Wall:
    """Upright along a line of points; its ends are round."""

    points_ne_m: Annotated[tuple[_Place, ...], Field(min_length=2)]
    thickness_m: _Positive
    height_m: _Positive


@_table
class Wire:
    """Level between two ends: it can be touched, and no lidar sees it."""

    ends_ne_m: tuple[_Place, _Place]
    height_m: _Positive
    thickness_m: _Positive = 0.02


@_table
class Clearing(_Placed):
    """Where no tree of a wood stands."""

    radius_m: _Positive


@_table
class Wood(AreaTable):
    """Trees that are drawn when the world is read: the same ones for the same seed."""

    seed: Annotated[int, Field(strict=True, ge=0)]
    spacing_m: _Range
    """Between two trees, from middle to middle: it varies from place to place."""
    radius_m: _Range
    height_m: _Range
    clearing_share: Annotated[_Real, Field(ge=0, le=0.9)] = 0.0
    """Of the area: clearings that are drawn too."""
    clearings: tuple[Clearing, ...] = ()
    """These are always there."""

    def __post_init__(self) -> None:
        AreaTable.__post_init__(self)
        for key in ("spacing_m", "radius_m", "height_m"):
            least, most = getattr(self, key)
            _must(least <= most, key, (least, most), "gives the least first", "Swap them.")
        south, north, west, east = self.edges_m
        few = (north - south) * (east - west) <= _MOST_TREES * self.spacing_m[0] ** 2
        rule = f"would have more than {_MOST_TREES} trees"
        _must(few, "spacing_m", self.spacing_m, rule, "Widen it.")

    def trees(self) -> Iterator[Tree]:
        """As drawn."""
        rng = generator(self.seed, "wood")
        places = drawn_wood(rng, self.edges_m, self.spacing_m, self.clearing_share)
        (thin, thick), (low, high) = self.radius_m, self.height_m
        draws = rng.random((len(places), 2)) * [thick - thin, high - low] + [thin, low]
        for at, (radius_m, height_m) in zip(places.tolist(), draws.tolist(), strict=True):
            if all(
                math.dist(at, (c.north_m, c.east_m)) >= c.radius_m + radius_m
                for c in self.clearings
            ):
                yield Tree(north_m=at[0], east_m=at[1], radius_m=radius_m, height_m=height_m)


@_table
class LidarTable:
    """The lidar on board; the second one is an RPLidar on ArduPilot, beside a driver's."""

    range_m: Annotated[_Real, Field(gt=0, le=600)]
    min_m: _Positive = 0.2
    """Nearer than this it measures nothing."""
    kind: Literal["spinning", "sectors"] = "spinning"
    """One beam that turns, or all beams at once."""
    output: Literal["driver", "autopilot"] = "driver"
    """OBSTACLE_DISTANCE of a component, or an RPLidar on ArduPilot (PRX1_TYPE 5)."""
    component_id: _Component = 196
    rate_hz: _Rate = 10.0
    """Of the driver's messages."""
    turns_1_s: _Rate = 10.0
    """Sweeps a second."""
    step_deg: Annotated[_Real, Field(ge=0.2, le=45)] = 3.6
    """Between two beams."""
    noise_m: Annotated[_Real, Field(ge=0)] = 0.0
    """Standard deviation of a distance."""
    lost_share: _Share = 0.0
    """Of the echoes: they do not come back, as if nothing were there."""
    latency_s: Annotated[_Real, Field(ge=0, le=5)] = 0.0
    """From the middle of a sweep to its message; half a sweep at least."""

    def __post_init__(self) -> None:
        rule = f"must be less than range_m, which is {self.range_m:g}"
        _must(self.min_m < self.range_m, "min_m", self.min_m, rule, "Lessen it.")


@_table
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

    def __post_init__(self) -> None:
        _must(self.terrain.file is None or self.area is not None, "area", None, *_MISSING)
        lidar, second = self.lidar, self.second_lidar
        if second is not None:
            well = second.output == "autopilot" and lidar is not None and lidar.output == "driver"
            rule = "is an autopilot's, beside a [lidar] that is not"
            remedy = 'Write second_lidar.output = "autopilot", or leave the table out.'
            _must(well, "second_lidar.output", second.output, rule, remedy)
        reads = any(each.output == "autopilot" for each in self.lidars)
        has_driver, rule = self.vehicle.autopilot != "px4", "px4 has no driver for it"
        key = "second_lidar.output" if second else "lidar.output"
        _must(has_driver or not reads, key, "autopilot", rule, "Write driver.")
        if lidar and self.scanner:
            own, key = lidar.component_id != self.scanner.component_id, "lidar.component_id"
            _must(own, key, lidar.component_id, "is the terrain radar's too", "Choose another.")

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
            return read_grid(Path(table.file), self.frame, area.edges_m, table.nodata)
        assert table.combine is not None
        assert table.ground_amsl_m is not None
        rows = [dataclasses.astuple(peak) for peak in table.peaks]  # its fields are in this order
        return PeakTerrain(rows, combine=table.combine, ground_amsl_m=table.ground_amsl_m)

    def scene(self, terrain: Terrain | None = None) -> Scene:
        """Terrain and near things: `distance_m` of it is the true clearance of any points."""
        terrain = terrain or self.truth()
        drawn = (tree for wood in self.woods for tree in wood.trees())
        things = [
            _standing(terrain, [(t.north_m, t.east_m)], t.radius_m, t.height_m)
            for t in (*self.trees, *drawn)
        ]
        for building in self.buildings:
            prism = _standing(terrain, building.corners_ne_m, 0.0, building.height_m)
            things.append(prism._replace(closed=True))
        for wall in self.walls:
            for ends in itertools.pairwise(wall.points_ne_m):
                things.append(_standing(terrain, ends, 0.5 * wall.thickness_m, wall.height_m))
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
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        rule = f"not TOML ({error})"
        raise InputError("WORLD", str(path), rule, "Name a world.toml.") from None
    except (OSError, UnicodeDecodeError) as error:
        rule = f"cannot be read ({getattr(error, 'strerror', None) or 'not a text file'})"
        raise InputError("WORLD", str(path), rule, "Name a world file.") from None
    return parse_world(table, path.parent)


def parse_world(table: dict[str, Any], folder: Path | None = None) -> World:
    """The world that this TOML table describes; its elevation file is in the folder."""
    if not table.keys() & {"terrain", "vehicle", "scanner"} or "targets" in table:
        rule = "describes something else, not a world"
        raise InputError("WORLD", table.get("name", "file"), rule, "Name a world.toml.")
    try:
        world = _WORLD.validate_python(table)
    except ValidationError as error:
        problems = error.errors()
        # A misspelt key is both unknown and missing: the unknown one tells the user more.
        unknown = [p for p in problems if p["type"] == "unexpected_keyword_argument"]
        raise _explained((unknown or problems)[0]) from None
    if folder is None or world.terrain.file is None:
        return world
    beside = str(folder / world.terrain.file)
    return dataclasses.replace(world, terrain=dataclasses.replace(world.terrain, file=beside))


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


def _explained(problem: Any) -> InputError:
    """What pydantic found, in words."""
    kind, value = problem["type"], problem["input"]
    field = ".".join(map(str, problem["loc"]))
    if kind == "missing":
        return InputError(field, None, *_MISSING)
    if kind == "value_error":
        key, *rest = problem["ctx"]["error"].args
        return InputError(".".join(filter(None, (field, key))), *rest)
    if kind == "unexpected_keyword_argument":
        remedy = did_you_mean(field.rpartition(".")[2], _KEYS, "Leave it out.")
        return InputError(field, value, "no such key", remedy)
    rule = problem["msg"].removeprefix("Input should be ")
    return InputError(field, value, f"must be {rule}", "Correct the world file.")
