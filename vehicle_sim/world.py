"""The world file: the truth that the simulator flies in.  Parsed once, at the door.

Every class is one table of world.toml.  Unknown keys are refused with the nearest known one named.
"""

import math
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from scipy.spatial import cKDTree

from vehicle_sim.elevation import read_grid
from vehicle_sim.errors import InputError, did_you_mean
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.parameters import Firmware
from vehicle_sim.rng import generator
from vehicle_sim.scene import Scene, Upright
from vehicle_sim.terrain import Combine, PeakTerrain, Terrain


def _must(holds: bool, key: str, value: object, rule: str, remedy: str) -> None:
    """A rule that no single value can break; `key` "" is the table itself."""
    if not holds:
        raise ValueError(key, value, rule, remedy)


_Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Positive = Annotated[_Real, Field(gt=0)]
_Spread = Annotated[_Real, Field(ge=0.01)]
"""Places are divided by it and squared: less would make them infinite."""
_Local = Annotated[_Real, Field(ge=-5e6, le=5e6)]
_Altitude = Annotated[_Real, Field(ge=-1000, le=20000)]
_Speed = Annotated[_Real, Field(gt=0, le=300)]
_Acceleration = Annotated[_Real, Field(gt=0, le=200)]
_Turn = Annotated[_Real, Field(ge=-360, le=360)]
_Share = Annotated[_Real, Field(ge=0, le=1)]
_Rate = Annotated[_Real, Field(ge=0.5, le=50)]
_Component = Annotated[int, Field(strict=True, ge=2, le=255)]
_Place = tuple[_Local, _Local]
"""North and east."""


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    _must(pair[0] <= pair[1], "", pair, "gives the least first", "Swap them.")
    return pair


def _printable(name: str) -> str:
    _must(name.isprintable(), "", name, "is not printable in a line", "Write another name.")
    return name


_Name = Annotated[str, Field(strict=True, min_length=1), AfterValidator(_printable)]
_Size = Annotated[_Positive, Field(le=1e5)]
_Range = Annotated[tuple[_Size, _Size], AfterValidator(_rising)]
"""Least and most."""
_MISSING: Final = ("is missing", "Write it into the world file.")


class _Table(BaseModel):
    """A table of the file: it refuses keys that it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class _Placed(_Table):
    """Something at a place of the local frame."""

    north_m: _Local
    east_m: _Local


class Origin(_Table):
    """Where the local frame touches the ellipsoid."""

    latitude_deg: Annotated[_Real, Field(ge=-85, le=85)]
    longitude_deg: Annotated[_Real, Field(ge=-180, le=180)]


class Peak(_Placed):
    """One mountain (eq. 1)."""

    height_amsl_m: Annotated[_Altitude, Field(gt=0)]
    spread_north_m: _Spread
    spread_east_m: _Spread


class TerrainTable(_Table):
    """What the ground looks like: peaks over a plain at `ground_amsl_m`, or an elevation file."""

    combine: Combine = "maximum"
    ground_amsl_m: _Altitude | None = None
    peaks: tuple[Peak, ...] = ()
    file: Annotated[_Name, Field(max_length=255)] | None = None
    """Beside the world file."""
    vertical_datum: _Name | None = None
    """Of the file, for readers: its heights are taken as they are."""
    nodata: Literal["sea"] | _Altitude | None = None
    """What is where the file has no height."""

    def model_post_init(self, _: object) -> None:
        """Check what goes together."""
        flat = self.ground_amsl_m is not None
        well = flat if self.file is None else not (flat or self.peaks)
        rule = "is needed, or else ground_amsl_m (and peaks), not both"
        _must(well, "file", self.file, rule, "Give one of the two.")


class AreaTable(_Table):
    """How much of an elevation file is needed."""

    north_min_m: _Local
    north_max_m: _Local
    east_min_m: _Local
    east_max_m: _Local

    def model_post_init(self, _: object) -> None:
        """Check what goes together."""
        south, north, west, east = self.edges_m
        rule = "its least must lie below its most"
        _must(south < north and west < east, "", self.edges_m, rule, "Swap or widen them.")

    @property
    def edges_m(self) -> tuple[float, float, float, float]:
        """South, north, west, east."""
        return self.north_min_m, self.north_max_m, self.east_min_m, self.east_max_m


VehicleKind = Literal["copter", "plane"]
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


class Vehicle(_Table):
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
    parameters: dict[str, _Real] = Field(default_factory=dict)
    """The autopilot's own, by their names and in their units."""

    def model_post_init(self, _: object) -> None:
        """Check what goes together."""
        copters = (*LIMITS["copter"], "drag_1_s")
        for key in LIMITS["plane"] if self.kind == "copter" else copters:
            value, rule = getattr(self, key), f"a {self.kind} has no such limit"
            _must(value is None, key, value, rule, "Leave it out.")


class Scanner(_Table):
    """The terrain radar on board: a MAVLink component of its own."""

    component_id: _Component
    range_m: Annotated[_Positive, Field(le=1e6)]


class Tree(_Placed):
    """A cylinder on the ground."""

    radius_m: _Positive
    height_m: _Positive
    """Above the ground, as those of buildings, walls and wires."""


class Building(_Table):
    """A prism with a flat roof; its height is above the highest ground at a corner."""

    corners_ne_m: Annotated[tuple[_Place, ...], Field(min_length=3)]
    height_m: _Positive


class Wall(_Table):
    """Upright along a line of points, of one height; its ends are round."""

    points_ne_m: Annotated[tuple[_Place, ...], Field(min_length=2)]
    thickness_m: _Positive
    height_m: _Positive


class Wire(_Table):
    """Level between two ends: it can be touched, and no lidar sees it."""

    ends_ne_m: tuple[_Place, _Place]
    height_m: _Positive
    thickness_m: _Positive = 0.02


class Clearing(_Placed):
    """Where no tree of a wood stands."""

    radius_m: _Positive


_MOST_TREES: Final = 200_000
_CANDIDATES: Final = 4.0
"""For each square of the least spacing."""
_CLUMP: Final = 10.0
"""From one clump to the next, in least spacings."""
_WAVES: Final = 12
"""Whose sum says where clumps are."""


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

    def model_post_init(self, _: object) -> None:
        """Check what goes together."""
        AreaTable.model_post_init(self, None)
        south, north, west, east = self.edges_m
        few = (north - south) * (east - west) <= _MOST_TREES * self.spacing_m[0] ** 2
        rule = f"would have more than {_MOST_TREES} trees"
        _must(few, "spacing_m", self.spacing_m, rule, "Widen it.")

    def trees(self) -> Iterator[Tree]:
        """As drawn: no two are nearer to each other than a spacing that varies with the place.

        There are clumps, and clearings where it would be widest.
        """
        rng, (south, north, west, east) = generator(self.seed, "wood"), self.edges_m
        (least_m, most_m), share = self.spacing_m, 1.0 - self.clearing_share
        count = math.ceil(_CANDIDATES * (north - south) * (east - west) / least_m**2)
        places = np.array([south, west]) + rng.random((count, 2)) * [north - south, east - west]
        wave_1_m = rng.normal(size=(2, _WAVES)) * (math.tau / (_CLUMP * least_m))
        level = np.cos(places @ wave_1_m + rng.random(_WAVES) * math.tau).sum(axis=1)
        rank = np.empty(count)
        rank[np.argsort(level, kind="stable")] = (np.arange(count) + 0.5) / count
        apart_m = least_m + (most_m - least_m) * np.minimum(rank / (share + 1e-12), 1.0)
        free, index, kept = rank <= share, cKDTree(places), list[int]()
        for k in np.flatnonzero(free).tolist():
            if free[k]:
                kept.append(k)
                near = np.array(index.query_ball_point(places[k], most_m))
                away_m = np.hypot(*(places[near] - places[k]).T)
                free[near[away_m < np.maximum(apart_m[near], apart_m[k])]] = False
        (thin, thick), (low, high) = self.radius_m, self.height_m
        sizes_m = rng.random((len(kept), 2)) * [thick - thin, high - low] + [thin, low]
        for at, (radius_m, height_m) in zip(places[kept].tolist(), sizes_m.tolist(), strict=True):
            if all(
                math.dist(at, (c.north_m, c.east_m)) >= c.radius_m + radius_m
                for c in self.clearings
            ):
                yield Tree(north_m=at[0], east_m=at[1], radius_m=radius_m, height_m=height_m)


class LidarTable(_Table):
    """A lidar on board, with a driver of its own or read by the autopilot: one of those at most."""

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
    noise_m: Annotated[_Real, Field(ge=0, le=1e5)] = 0.0
    """Standard deviation of a distance."""
    lost_share: _Share = 0.0
    """Of the echoes: they do not come back, as if nothing were there."""
    latency_s: Annotated[_Real, Field(ge=0, le=5)] = 0.0
    """From the middle of a sweep to its message; half a sweep at least."""

    def model_post_init(self, _: object) -> None:
        """Check what goes together."""
        rule = f"must be less than range_m, which is {self.range_m:g}"
        _must(self.min_m < self.range_m, "min_m", self.min_m, rule, "Lessen it.")


class World(_Table):
    """One world file."""

    schema_: Literal[1] = Field(alias="schema")
    name: _Name
    origin: Origin
    terrain: TerrainTable
    vehicle: Vehicle
    scanner: Scanner | None = None
    """Left out: the vehicle has none."""
    radars: tuple[dict[str, float | str], ...] = ()
    """Those that look for the vehicle: the companion's affair."""
    area: AreaTable | None = None
    trees: tuple[Tree, ...] = ()
    woods: tuple[Wood, ...] = ()
    buildings: tuple[Building, ...] = ()
    walls: tuple[Wall, ...] = ()
    wires: tuple[Wire, ...] = ()
    lidar: LidarTable | None = None
    second_lidar: LidarTable | None = None

    def model_post_init(self, _: object) -> None:
        """Check what goes together."""
        _must(self.terrain.file is None or self.area is not None, "area", None, *_MISSING)
        drivers = [lidar for lidar in self.lidars if lidar.output == "driver"]
        ids = [component.component_id for component in (self.scanner, *drivers) if component]
        one_each = len(ids) == len(set(ids))
        rule = "is another lidar's or the terrain radar's too"
        _must(one_each, "lidar.component_id", ids[-1:], rule, "Choose another.")
        few = len(self.lidars) - len(drivers) <= (self.vehicle.autopilot != "px4")
        rule = "ardupilot reads one lidar at most, px4 none"
        _must(few, "lidar.output", "autopilot", rule, "Write driver.")

    @property
    def lidars(self) -> tuple[LidarTable, ...]:
        """All on board."""
        return tuple(lidar for lidar in (self.lidar, self.second_lidar) if lidar is not None)

    @property
    def frame(self) -> LocalFrame:
        """The local frame that positions in the file are given in."""
        return LocalFrame(**dict(self.origin))

    def truth(self) -> Terrain:
        """The terrain itself."""
        table, area = self.terrain, self.area
        if table.file is not None:
            assert area is not None
            return read_grid(Path(table.file), self.frame, area.edges_m, table.nodata)
        assert table.ground_amsl_m is not None
        rows = [tuple(dict(peak).values()) for peak in table.peaks]  # fields are in this order
        return PeakTerrain(rows, combine=table.combine, ground_amsl_m=table.ground_amsl_m)

    def scene(self) -> Scene:
        """Terrain and near things: `distance_m` of it is the true clearance of any points."""
        drawn = (tree for wood in self.woods for tree in wood.trees())
        things = [
            Upright([(tree.north_m, tree.east_m)], tree.radius_m, tree.height_m)
            for tree in (*self.trees, *drawn)
        ]
        for building in self.buildings:
            things.append(Upright(building.corners_ne_m, 0.0, building.height_m, closed=True))
        for wall in self.walls:
            things.append(Upright(wall.points_ne_m, 0.5 * wall.thickness_m, wall.height_m))
        for wire in self.wires:
            thick_m, half_m = wire.thickness_m, 0.5 * wire.thickness_m
            things.append(Upright(wire.ends_ne_m, half_m, wire.height_m + half_m, hangs_m=thick_m))
        return Scene(self.truth(), things)

    def with_woods_of(self, seed: int) -> "World":
        """The same world with other trees in its woods: what benchmarks draw."""
        woods = [wood.model_copy(update={"seed": seed + k}) for k, wood in enumerate(self.woods)]
        return self.model_copy(update={"woods": tuple(woods)})


def read_world(path: Path) -> World:
    """The world in this file; InputError says what is wrong with it."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:  # also what is no text, or no TOML
        rule = f"cannot be read ({error})"
        raise InputError("WORLD", str(path), rule, "Name a world.toml.") from None
    world = parse_world(table)
    if world.terrain.file is None:
        return world
    beside = {"file": str(path.parent / world.terrain.file)}
    return world.model_copy(update={"terrain": world.terrain.model_copy(update=beside)})


def parse_world(table: dict[str, Any]) -> World:
    """The world that this TOML table describes."""
    try:
        return World.model_validate(table)
    except ValidationError as error:
        # A misspelt key is both unknown and missing: the unknown one tells the user more.
        problem = min(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    kind, value = problem["type"], problem["input"]
    field = ".".join(map(str, problem["loc"]))
    if kind == "missing":
        raise InputError(field, None, *_MISSING)
    if kind == "value_error":
        key, *rest = problem["ctx"]["error"].args
        raise InputError(".".join(filter(None, (field, key))), *rest)
    if kind == "extra_forbidden":
        tables = World.model_json_schema()["$defs"].values()
        known = {*World.model_fields, *(key for table in tables for key in table["properties"])}
        remedy = did_you_mean(field.rpartition(".")[2], known, "Leave it out.")
        raise InputError(field, value, "no such key", remedy)
    what, _, rule = problem["msg"].rpartition(" should ")
    rule = f"must {rule}" if what else rule
    raise InputError(field, value, rule, "Correct the world file.")


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
        terrain=TerrainTable(ground_amsl_m=altitude_amsl_m),
        vehicle=Vehicle(
            kind=kind, autopilot=autopilot, heading_deg=heading_deg, system_id=system_id
        ),
        scanner=None if scan_range_m is None else Scanner(component_id=100, range_m=scan_range_m),
    )
