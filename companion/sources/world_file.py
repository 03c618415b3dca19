"""A world.toml, as far as planning without a vehicle needs it; vehicle-sim reads all of it."""

from collections.abc import Iterator
from dataclasses import fields
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import ConfigDict, Discriminator, Field, Tag

from companion.geodesy import LocalFrame
from companion.planner import rules
from companion.planner.rules import Broken
from companion.ranges import Altitude, Horizontal
from companion.sources.elevation import ElevationTable
from companion.sources.files import RawTable
from companion.sources.tables import AreaTable, OriginTable, Table, keys_of, validated
from companion.world.terrain import Peak, PeakTerrain, Terrain


class World(NamedTuple):
    """A world as `companion plan` needs it."""

    name: str
    terrain: Terrain
    start_ne_m: tuple[float, float]
    origin_deg: tuple[float, float]
    """Latitude and longitude."""


class PeakTable(keys_of(Peak, *(field.name for field in fields(Peak)))):  # type: ignore[misc]
    """A mountain of eq. 1."""


class PeaksTable(Table):
    """The true terrain of a world."""

    combine: Literal["maximum", "sum"] = "maximum"
    ground_amsl_m: Altitude
    peaks: list[PeakTable] = Field(default=[])


class WorldVehicleTable(Table):
    """Where the simulator's vehicle stands."""

    model_config = ConfigDict(extra="ignore")
    north_m: Horizontal = 0.0
    east_m: Horizontal = 0.0


def _kind_of_terrain(table: Any) -> str:
    return "(file)" if isinstance(table, dict) and "file" in table else "(peaks)"


class WorldTable(Table):
    """Of a world.toml what concerns the companion."""

    model_config = ConfigDict(extra="ignore")
    schema_: Literal[1] = Field(alias="schema")
    name: str
    origin: OriginTable
    terrain: Annotated[
        Annotated[PeaksTable, Tag("(peaks)")] | Annotated[ElevationTable, Tag("(file)")],
        Discriminator(_kind_of_terrain),
    ]
    vehicle: WorldVehicleTable
    area: AreaTable | None = None
    """How much of an elevation file is needed."""

    def broken(self) -> Iterator[Broken]:
        """Of an elevation file it says how much is needed."""
        if self.area is None and isinstance(self.terrain, ElevationTable):
            yield "area", None, "it is missing", "Add area; see docs/files.md."


def world_of(table: RawTable) -> World:
    """The world that a table means.  Raises InputError for the first rule that is broken."""
    world = validated(WorldTable, table)
    origin_deg = world.origin.latitude_deg, world.origin.longitude_deg
    if isinstance(world.terrain, ElevationTable):
        assert world.area is not None
        rules.refuse(rules.of_area(*world.area.sides_m))
        frame = LocalFrame(latitude_deg=origin_deg[0], longitude_deg=origin_deg[1])
        terrain: Terrain = world.terrain.terrain(frame, world.area.sides_m)
    else:
        terrain = PeakTerrain(
            peaks=tuple(Peak(**dict(peak)) for peak in world.terrain.peaks),
            ground_amsl_m=world.terrain.ground_amsl_m,
            sum_of_peaks=world.terrain.combine == "sum",
        )
    start_ne_m = world.vehicle.north_m, world.vehicle.east_m
    return World(world.name, terrain, start_ne_m, origin_deg)
