"""The tables of mission files, with the rules between their keys.

What they mean together with other files is `mission_file`'s part.  A field is called as the value
that it becomes; where the file has another unit or name for it, that is its alias.
"""

import math
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from companion.geodesy import wrap_rad
from companion.mavlink.autopilots import named
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, wire
from companion.mission.mission import EndAction, Fallback, Mission
from companion.optimise.registry import OPTIMISERS
from companion.path.limits import Limits, VehicleKind
from companion.planner.settings import PlannerSettings
from companion.profiles import Weights
from companion.ranges import Latitude, Longitude, NotNegative, Positive
from companion.sources.elevation import ElevationFile, VerticalDatum
from companion.sources.files import path_of
from companion.sources.geojson import NoZone
from companion.sources.schema import (
    NAME,
    SENDER,
    Altitude,
    AreaTable,
    Broken,
    FileName,
    Horizontal,
    Nodata,
    OriginTable,
    Table,
    keys_of,
)
from companion.world.near_map import Kind, NearSensor

Name = Annotated[str, Field(min_length=1, max_length=100)]
Sender = Annotated[str, Field(pattern=SENDER)]
_Slope = Annotated[float, Field(gt=0.0, lt=90.0), AfterValidator(math.radians)]
_Bearing = Annotated[float, Field(ge=-360.0, le=360.0), AfterValidator(math.radians)]
_REMOVE_ONE: Final = "Remove one of them."
_LIDAR_COMPONENT: Final = wire.MAV_COMP_ID_OBSTACLE_AVOIDANCE
_RADAR: Final = "terrain_radar"


class BandTable(Table):
    """The altitudes between which to fly."""

    floor_amsl_m: Altitude
    ceiling_amsl_m: Altitude


class PlaceTable(Table):
    """A place: north and east of the origin, or latitude and longitude."""

    north_m: Horizontal | None = None
    east_m: Horizontal | None = None
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None

    @property
    def degrees(self) -> tuple[float, float] | None:
        """Latitude and longitude, if it is given by these."""
        if self.latitude_deg is None or self.longitude_deg is None:
            return None
        return self.latitude_deg, self.longitude_deg

    @property
    def is_placed(self) -> bool:
        """Whether any of them is given."""
        return any(getattr(self, key) is not None for key in PlaceTable.model_fields)

    def broken(self) -> Iterator[Broken]:
        """It is given by one of the pairs, and by all of that."""
        metres = {"north_m": self.north_m, "east_m": self.east_m}
        degrees = {"latitude_deg": self.latitude_deg, "longitude_deg": self.longitude_deg}
        given = [pair for pair in (metres, degrees) if set(pair.values()) != {None}]
        if len(given) == 2:
            rule = "a place is given by north_m and east_m, or by latitude_deg and longitude_deg"
            yield "", [*metres.values(), *degrees.values()], rule, "Remove one pair."
        for key, value in (given or [metres])[0].items():
            if value is None:
                yield key, None, "it is missing", f"Add {key}; see docs/files.md."


class TargetTable(PlaceTable):
    """A place to reach, at its altitude, or at any of the band."""

    name: Name | None = None
    altitude_amsl_m: Altitude | None = None


class MissionRadarTable(PlaceTable):
    """A known radar."""

    name: str
    altitude_amsl_m: Altitude
    range_m: Positive


class ZoneTable(PlaceTable):
    """A zone that is never entered, or never left: a circle or a polygon."""

    name: str
    radius_m: Positive | None = None
    vertices_m: list[Annotated[list[Horizontal], Field(min_length=2, max_length=2)]] | None = None
    vertices_deg: list[Annotated[list[Longitude], Field(min_length=2, max_length=2)]] | None = None
    """Latitude, longitude of each corner."""

    def broken(self) -> Iterator[Broken]:
        """It is a circle about a place, or a polygon."""
        shapes = [self.radius_m, self.vertices_m, self.vertices_deg]
        if shapes.count(None) != 2 or self.is_placed != (self.radius_m is not None):
            remedy = (
                "Give a place (north_m and east_m, or latitude_deg and longitude_deg) and "
                "radius_m, or three or more corners: vertices_m [north, east] or vertices_deg "
                "[latitude, longitude]."
            )
            yield "", self.name, "a zone is a circle or a polygon", remedy
        elif self.is_placed:
            yield from super().broken()
        for number, (latitude, longitude) in enumerate(self.vertices_deg or []):
            if abs(latitude) > 90.0:
                rule = "out of range: latitude comes first, -90 to 90"
                yield f"vertices_deg[{number}]", [latitude, longitude], rule, "Swap them."


_SPEEDS = ("speed_m_s", "acceleration_m_s2", "climb_rate_m_s", "turn_radius_m")
_ERRORS = ("tracking_error_m", "navigation_error_m", "dead_man_s")


class MissionVehicleTable(
    keys_of(Mission, "autopilot", "system_id", "position_rate_hz", "rangefinder_error_m"),  # type: ignore[misc]
    keys_of(Limits, *_SPEEDS, *_ERRORS),  # type: ignore[misc]
):
    """What the vehicle can fly, and how it is to be flown."""

    kind: VehicleKind
    scanner: bool = True
    scanner_component_id: Annotated[int, Field(ge=2, le=250)] | None = None
    loiter_radius_m: Positive | None = None
    climb_angle_rad: _Slope = Field(alias="climb_angle_deg")
    dive_angle_rad: _Slope = Field(alias="dive_angle_deg")
    yaw_rad: Annotated[_Bearing, AfterValidator(wrap_rad)] | None = Field(None, alias="yaw_deg")

    def broken(self) -> Iterator[Broken]:
        """It has what its kind needs, and nothing of another kind."""
        component, loiter_m = self.scanner_component_id, self.loiter_radius_m
        if not self.scanner and component is not None:
            rule = "scanner = false says that there is no terrain radar"
            yield "scanner_component_id", component, rule, _REMOVE_ONE
        if self.kind == "copter" and loiter_m is not None:
            rule = "a copter stops where it holds: it needs no circle"
            yield "loiter_radius_m", loiter_m, rule, "Remove it."
        if self.kind == "plane" and loiter_m is None:
            rule = "it is missing: a plane cannot stop, it holds on circles"
            remedy = "Add loiter_radius_m, as the autopilot has it (WP_LOITER_RAD, NAV_LOITER_RAD)."
            yield "loiter_radius_m", None, rule, remedy
        if self.kind == "plane" and self.yaw_rad is not None:
            rule, value = "a plane's nose points where it flies", math.degrees(self.yaw_rad)
            yield "yaw_deg", value, rule, "Remove it."


_MOUNTING = ("forward_m", "right_m", "blind_m", "latency_s", "latency_error_s")
_PROMISES = ("range_error_m", "position_error_m", "drift_m_s", "speaks_for_m")


class ScannerTable(
    keys_of(Mission, scanner_complete="complete"),  # type: ignore[misc]
    keys_of(NearSensor, *_MOUNTING, *_PROMISES),  # type: ignore[misc]
):
    """What the scanner is, how it is mounted and what it promises.

    The first is of the terrain radar, all others of lidars and the like.
    """

    kind: Literal["terrain_radar", Kind] = "terrain_radar"
    component_id: Annotated[int, Field(ge=1, le=250)] | None = Field(None, alias="component")
    """MAVLink component that sends them; left out: the autopilot for its sectors, else 196"""
    yaw_rad: _Bearing = Field(0.0, alias="yaw_deg")
    bearing_error_rad: Annotated[
        float, Field(ge=0.0, le=45.0, validate_default=True), AfterValidator(math.radians)
    ] = Field(1.0, alias="bearing_error_deg")

    def broken(self) -> Iterator[Broken]:
        """It says what its kind has."""
        said = {
            (type(self).model_fields[each].alias or each): each for each in self.model_fields_set
        }
        if self.kind == _RADAR:
            for key in sorted(said.keys() - {"kind", "complete"}):
                rule = "a terrain radar has no such key: it is of the other kinds"
                remedy = f"Remove it, or write one of these kinds: {', '.join(get_args(Kind))}."
                yield key, getattr(self, said[key]), rule, remedy
        elif "complete" in said:
            remedy = 'Remove it, or write kind = "terrain_radar".'
            yield "complete", self.scanner_complete, "it is a radar's", remedy
        if self.component_id == COMPANION_COMPONENT:
            rule, remedy = "that is the companion itself", "Give the driver another, as 196."
            yield "component", self.component_id, rule, remedy

    def sensor(self, range_m: float) -> NearSensor | None:
        """The sensor of near things, where that is the scanner."""
        if self.kind == _RADAR:
            return None
        usual = AUTOPILOT_COMPONENT if self.kind == "distance_sensor" else _LIDAR_COMPONENT
        return NearSensor(**{"component_id": usual, "range_m": range_m} | self.of(NearSensor))


class WeightsTable(keys_of(Weights, *(each.name for each in fields(Weights)))):  # type: ignore[misc]
    """a_1 .. a_6 of eq. 5."""


_DISTANCES = ("scan_range_m", "safety_distance_m", "scan_distance_m")
_TIMES = ("planning_time_s", "scan_time_s")


def _known_optimiser(name: str) -> str:
    """One of ours, or of another distribution's, which is loaded here to be sure of it."""
    if name not in OPTIMISERS:
        known = " or ".join(repr(each) for each in OPTIMISERS)
        raise PydanticCustomError("optimiser", "Input should be {known}", {"known": known})
    OPTIMISERS[name]
    return name


class PlannerTable(keys_of(PlannerSettings, *_DISTANCES, *_TIMES, "evaluations")):  # type: ignore[misc]
    """Distances and times of the online procedure, and the budget of the search."""

    overlap_m: NotNegative | None = None
    profile: Literal["flight", "paper"] = "flight"
    optimiser: Annotated[str, AfterValidator(_known_optimiser)] | None = None
    weights: WeightsTable = WeightsTable()


def _action(kind: type[EndAction | Fallback], **default: Any) -> Any:
    """The key that chooses one of them."""
    names = Literal[tuple(each.value for each in kind)]  # type: ignore[valid-type]
    return Annotated[names, AfterValidator(kind), Field(alias="action", **default)]


class EndTable(Table):
    """What to do at the last target."""

    end_action: _action(EndAction)  # type: ignore[valid-type]


class FallbackTable(keys_of(Mission, "attempts")):  # type: ignore[misc]
    """What to do when no way on is found, or the battery will not last."""

    fallback: _action(Fallback, default="return", validate_default=True)  # type: ignore[valid-type]


class BatteryTable(keys_of(Mission, "endurance_s")):  # type: ignore[misc]
    """What must be left, and how long a full one lasts."""

    reserve: Annotated[
        float, Field(ge=0.0, lt=100.0), AfterValidator(lambda all_of: all_of / 100.0)
    ] = Field(20.0, alias="reserve_percent", validate_default=True)


def _identified(sender: str) -> tuple[int, int]:
    """System and component of "SYSTEM/COMPONENT"."""
    system, component = (int(part) for part in sender.split("/"))
    if not 1 <= system <= 255 or component > 255:
        rule = 'it must be "SYSTEM/COMPONENT", 1 to 255 and 0 (any) to 255'
        raise PydanticCustomError("sender", rule)
    return system, component


class LinkTable(keys_of(Mission, "sets_parameters")):  # type: ignore[misc]
    """Who may command the companion, and what it may say to the autopilot."""

    commanders: (
        Annotated[list[Annotated[Sender, AfterValidator(_identified)]], AfterValidator(tuple)]
        | None
    ) = None


class FromVehicleTable(
    keys_of(  # type: ignore[misc]
        Mission,
        "goes_on_while_reading",
        targets_from_vehicle="targets",
        fence_from_vehicle="fence",
    )
):
    """What is taken from the vehicle's own mission and fence."""


class ThreatsTable(Table):
    """A file of zones, and what of it is none."""

    file: FileName
    leave_out: list[NoZone] = Field(default_factory=list)


class KnownTerrainTable(Table):
    """Terrain known in advance: from an elevation file, or one statement about all of the map."""

    highest_amsl_m: Altitude | None = None
    """The ground is nowhere higher than this."""
    file: FileName | None = None
    """Relative to the mission's folder."""
    vertical_datum: VerticalDatum | None = None
    nodata: Nodata | None = None
    """What lies where the file has no height.  Left out: unknown until it has been scanned."""
    datum_error_m: NotNegative | None = None
    trust: Literal["proof", "guidance"] | None = None
    """What reads the file: certificates too, or only the choice of the way; left out: proof."""

    def elevation(self, folder: Path, where: str) -> ElevationFile | None:
        """The file of it, named from a folder; None: it is a statement."""
        if self.file is None or self.vertical_datum is None:
            return None
        return ElevationFile(
            path=folder / path_of(self.file),
            vertical_datum=self.vertical_datum,
            nodata=self.nodata,
            field=f"{where}: terrain.file",
        )

    def broken(self) -> Iterator[Broken]:
        """It is a file and what its heights mean, or one height and nothing else."""
        of_files = {key: value for key, value in self if key != "highest_amsl_m"}
        if self.highest_amsl_m is None:
            for key in ("file", "vertical_datum"):
                if of_files[key] is None:
                    remedy = f"Add {key}, or give highest_amsl_m alone; see docs/files.md."
                    yield key, None, "it is missing", remedy
        else:
            for key, value in of_files.items():
                if value is not None:
                    rule = "highest_amsl_m speaks of all of the map, and of no file"
                    yield key, value, rule, _REMOVE_ONE


class MissionTable(Table):
    """A mission.toml, with what other files that it names hold."""

    schema_: Literal[1] = Field(alias="schema")
    name: Annotated[str, Field(pattern=NAME)]
    plan: FileName | None = None
    threats: FileName | None = None
    origin: OriginTable
    area: AreaTable
    altitude: BandTable
    targets: Annotated[list[TargetTable], Field(min_length=1)] | None = None
    vehicle: MissionVehicleTable
    scanner: ScannerTable = ScannerTable()
    planner: PlannerTable
    end: EndTable
    fallback: FallbackTable = FallbackTable()
    battery: BatteryTable = BatteryTable()
    link: LinkTable = LinkTable()
    from_vehicle: FromVehicleTable = FromVehicleTable()
    terrain: KnownTerrainTable | None = None
    radars: list[MissionRadarTable] = Field(default_factory=list)
    keep_outs: list[ZoneTable] = Field(default_factory=list)
    keep_ins: list[ZoneTable] = Field(default_factory=list)
    rally_points: list[PlaceTable] = Field(default_factory=list)

    @property
    def scans_ground(self) -> bool:
        """Whether the vehicle has a terrain radar."""
        return self.vehicle.scanner and self.scanner.kind == _RADAR

    def broken(self) -> Iterator[Broken]:
        """Its tables fit one another."""
        vehicle, terrain = self.vehicle, self.terrain
        if not vehicle.scanner and self.scanner != ScannerTable():
            rule = "vehicle.scanner = false says that there is no terrain radar"
            promised = self.scanner.model_dump(by_alias=True)
            yield "scanner", promised, rule, _REMOVE_ONE
        if vehicle.kind == "plane" and vehicle.autopilot is not None:
            strategy = named(vehicle.autopilot, vehicle.kind)
            ends = {"end.action": self.end.end_action, "fallback.action": self.fallback.fallback}
            for key, action in ends.items():
                if action.value == "land" and not strategy.traits.lands:
                    rule = f"{strategy.name} cannot be told to land where it is"
                    yield key, action.value, rule, 'Write "hold" or "return".'
        if self.scanner.kind != _RADAR:
            yield from self._broken_of_near_sensor()
        if terrain is None and not vehicle.scanner:
            rule = "without a terrain radar nothing is known of the ground"
            remedy = (
                "Add [terrain] with an elevation file or highest_amsl_m, or remove scanner = false."
            )
            yield "vehicle.scanner", False, rule, remedy
        if terrain is not None and terrain.trust == "guidance" and not vehicle.scanner:
            rule = "without a terrain radar nothing would be proven, as guidance proves nothing"
            remedy = 'Write terrain.trust = "proof", or remove scanner = false.'
            yield "terrain.trust", terrain.trust, rule, remedy
        if self.from_vehicle.targets_from_vehicle and self.targets is not None:
            rule = "the targets come from the vehicle (from_vehicle.targets)"
            yield "targets", len(self.targets), rule, _REMOVE_ONE
        if not self.from_vehicle.targets_from_vehicle and self.targets is None:
            remedy = "Add [[targets]], or from_vehicle.targets = true; see docs/files.md."
            yield "targets", None, "it is missing", remedy

    def _broken_of_near_sensor(self) -> Iterator[Broken]:
        """Who flies by such a sensor stops, in a band that it sees, over known ground."""
        table, band = self.scanner, self.altitude
        if (component := self.vehicle.scanner_component_id) is not None:
            rule, name = "it is the terrain radar's", "vehicle.scanner_component_id"
            yield name, component, rule, "Write scanner.component."
        if self.vehicle.kind != "copter":
            rule = "only what can stop may fly by a sensor of near things"
            yield "scanner.kind", table.kind, rule, "Use a terrain radar for a plane."
        height_m = band.ceiling_amsl_m - band.floor_amsl_m
        if table.speaks_for_m < height_m:
            rule = f"its beams are flat, and altitude's band is {height_m:g} m high"
            remedy = (
                f"Raise it to {height_m:g} if what stands there is so tall, or narrow the band."
            )
            yield "scanner.speaks_for_m", table.speaks_for_m, rule, remedy
        trust = self.terrain and self.terrain.trust
        if self.terrain is None or trust == "guidance":
            rule = "a sensor of near things does not see the ground"
            remedy = "Add [terrain] with highest_amsl_m, or with an elevation file that is trusted."
            yield "terrain.trust" if trust else "terrain", trust, rule, remedy
