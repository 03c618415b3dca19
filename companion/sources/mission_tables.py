"""The tables of mission files, with the rules between their keys.

What they mean together with other files is `mission_file`'s part.  A field is called as the value
that it becomes; where the file has another unit or name for it, that is its alias.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag
from pydantic_core import PydanticCustomError

from companion.geodesy import LocalFrame, wrap_rad
from companion.mavlink.autopilots import named
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, wire
from companion.mission.mission import EndAction, Fallback, Mission
from companion.optimise.registry import OPTIMISERS
from companion.path.limits import Limits, VehicleKind
from companion.planner.rules import Broken
from companion.planner.settings import PlannerSettings
from companion.profiles import Weights
from companion.ranges import NotNegative, Positive
from companion.sources.elevation import KnownElevationTable
from companion.sources.files import RawTable
from companion.sources.tables import (
    Altitude,
    AreaTable,
    FileName,
    OriginTable,
    Table,
    broken_of,
    keys_of,
    validated,
)
from companion.sources.zones import NoZone, PlaceTable, RadarTable, ZoneTable
from companion.world.known_map import KnownMap
from companion.world.near_map import Kind, NearSensor

Name = Annotated[str, Field(min_length=1, max_length=100)]
_Slope = Annotated[float, Field(gt=0.0, lt=90.0), AfterValidator(math.radians)]
_Bearing = Annotated[float, Field(ge=-360.0, le=360.0), AfterValidator(math.radians)]
_REMOVE_ONE: Final = "Remove one of them."
_LIDAR_COMPONENT: Final = wire.MAV_COMP_ID_OBSTACLE_AVOIDANCE
_RADAR: Final = "terrain_radar"


class BandTable(Table):
    """The altitudes between which to fly."""

    floor_amsl_m: Altitude
    ceiling_amsl_m: Altitude


class TargetTable(PlaceTable):
    """A place to reach, at its altitude, or at any of the band."""

    name: Name | None = None
    altitude_amsl_m: Altitude | None = None


_SPEEDS = ("speed_m_s", "acceleration_m_s2", "climb_rate_m_s", "turn_radius_m")
_ERRORS = ("tracking_error_m", "navigation_error_m", "dead_man_s")


class VehicleTable(
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
        is_plane, yaw_deg = self.kind == "plane", math.degrees(self.yaw_rad or 0.0)
        yield from broken_of(
            (not self.scanner and component is not None, "scanner_component_id", component,
             "scanner = false says that there is no terrain radar", _REMOVE_ONE),
            (not is_plane and loiter_m is not None, "loiter_radius_m", loiter_m,
             "a copter stops where it holds: it needs no circle", "Remove it."),
            (is_plane and loiter_m is None, "loiter_radius_m", None,
             "it is missing: a plane cannot stop, it holds on circles",
             "Add loiter_radius_m, as the autopilot has it (WP_LOITER_RAD, NAV_LOITER_RAD)."),
            (is_plane and self.yaw_rad is not None, "yaw_deg", yaw_deg,
             "a plane's nose points where it flies", "Remove it."),
        )  # fmt: skip


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
        is_radar, component, keys = self.kind == _RADAR, self.component_id, type(self).model_fields
        of_others = self.model_fields_set - {"kind", "scanner_complete"} if is_radar else set()
        for name in sorted(of_others):
            rule = "a terrain radar has no such key: it is of the other kinds"
            remedy = f"Remove it, or write one of these kinds: {', '.join(get_args(Kind))}."
            yield keys[name].alias or name, getattr(self, name), rule, remedy
        yield from broken_of(
            (not is_radar and "scanner_complete" in self.model_fields_set, "complete",
             self.scanner_complete, "it is a radar's",
             'Remove it, or write kind = "terrain_radar".'),
            (component == COMPANION_COMPONENT, "component", component,
             "that is the companion itself", "Give the driver another, as 196."),
        )  # fmt: skip

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
    OPTIMISERS.chosen(name, "planner.optimiser")
    return name


class PlannerTable(keys_of(PlannerSettings, *_DISTANCES, *_TIMES, "evaluations")):  # type: ignore[misc]
    """Distances and times of the online procedure, and the budget of the search."""

    overlap_m: NotNegative | None = None
    profile: Literal["flight", "paper"] = "flight"
    optimiser: Annotated[str, AfterValidator(_known_optimiser)] | None = None
    weights: WeightsTable = WeightsTable()


class EndTable(Table):
    """What to do at the last target."""

    end_action: EndAction = Field(alias="action", strict=False)


class FallbackTable(keys_of(Mission, "attempts")):  # type: ignore[misc]
    """What to do when no way on is found, or the battery will not last."""

    fallback: Fallback = Field(Fallback.RETURN, alias="action", strict=False)


class BatteryTable(keys_of(Mission, "endurance_s")):  # type: ignore[misc]
    """What must be left, and how long a full one lasts."""

    reserve: Annotated[
        float, Field(ge=0.0, lt=100.0), AfterValidator(lambda all_of: all_of / 100.0)
    ] = Field(20.0, alias="reserve_percent", validate_default=True)


def _identified(sender: str) -> tuple[int, int]:
    """System and component of "SYSTEM/COMPONENT"."""
    parts = re.fullmatch(r"(\d{1,3})/(\d{1,3})", sender, re.ASCII)
    system, component = map(int, parts.groups()) if parts else (0, 0)
    if not (1 <= system <= 255 and component <= 255):
        rule = 'it must be "SYSTEM/COMPONENT", 1 to 255 and 0 (any) to 255'
        raise PydanticCustomError("sender", rule)
    return system, component


class LinkTable(keys_of(Mission, "sets_parameters")):  # type: ignore[misc]
    """Who may command the companion, and what it may say to the autopilot."""

    commanders: (
        Annotated[list[Annotated[str, AfterValidator(_identified)]], AfterValidator(tuple)] | None
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


class StatedTable(Table):
    """Terrain known in advance by one statement about all of the map."""

    highest_amsl_m: Altitude
    """The ground is nowhere higher than this."""

    def height_m(self, _folder: Path, *_place_deg: float) -> float:
        """The highest that it may be at a place, metres AMSL."""
        return self.highest_amsl_m

    def known_map(self, _frame: LocalFrame, blank: KnownMap, *, may_be_scanned: bool) -> KnownMap:
        """A blank map with it everywhere; a radar, if there is one, may see it lower."""
        return replace(
            blank,
            upper_m=np.full(blank.shape, self.highest_amsl_m),
            seen=np.full(blank.shape, not may_be_scanned),
            given=np.ones(blank.shape, dtype=bool),
        )


def _kind_of_terrain(table: Any) -> str:
    says_height = isinstance(table, dict) and any(key.startswith("highest") for key in table)
    return "(stated)" if says_height else "(file)"


KnownTerrain = Annotated[
    Annotated[StatedTable, Tag("(stated)")] | Annotated[KnownElevationTable, Tag("(file)")],
    Discriminator(_kind_of_terrain),
]


class _TerrainAloneTable(Table):
    terrain: KnownTerrain


def known_terrain(table: RawTable, where: str) -> StatedTable | KnownElevationTable:
    """The table [terrain] of a mission, checked by itself; InputError says what is wrong."""
    return validated(_TerrainAloneTable, {"terrain": table}, where).terrain


def _folder_name(name: str) -> str:
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9 _.-]{0,63}", name) is None:
        rule = (
            "it must be up to 64 of A-Z, a-z, 0-9, space and _.-, and begin with one of the first"
        )
        raise PydanticCustomError("name", rule)
    return name


class MissionTable(Table):
    """A mission.toml, with what other files that it names hold."""

    schema_: Literal[1] = Field(alias="schema")
    name: Annotated[str, AfterValidator(_folder_name)]
    plan: FileName | None = None
    threats: FileName | None = None
    origin: OriginTable
    area: AreaTable
    altitude: BandTable
    targets: Annotated[list[TargetTable], Field(min_length=1)] | None = None
    vehicle: VehicleTable
    scanner: ScannerTable = ScannerTable()
    planner: PlannerTable
    end: EndTable
    fallback: FallbackTable = FallbackTable()
    battery: BatteryTable = BatteryTable()
    link: LinkTable = LinkTable()
    from_vehicle: FromVehicleTable = FromVehicleTable()
    terrain: KnownTerrain | None = None
    radars: list[RadarTable] = Field(default_factory=list)
    keep_outs: list[ZoneTable] = Field(default_factory=list)
    keep_ins: list[ZoneTable] = Field(default_factory=list)
    rally_points: list[PlaceTable] = Field(default_factory=list)

    @property
    def scans_ground(self) -> bool:
        """Whether the vehicle has a terrain radar."""
        return self.vehicle.scanner and self.scanner.kind == _RADAR

    @property
    def is_for_guidance(self) -> bool:
        """Whether the terrain that is known in advance proves nothing."""
        return isinstance(self.terrain, KnownElevationTable) and self.terrain.trust == "guidance"

    def broken(self) -> Iterator[Broken]:
        """Its tables fit one another."""
        vehicle, terrain, targets = self.vehicle, self.terrain, self.targets
        from_vehicle = self.from_vehicle.targets_from_vehicle
        guides = self.is_for_guidance
        if vehicle.kind == "plane" and vehicle.autopilot is not None:
            strategy = named(vehicle.autopilot, vehicle.kind)
            ends = {"end.action": self.end.end_action, "fallback.action": self.fallback.fallback}
            for key, action in ends.items():
                if action.value == "land" and not strategy.traits.lands:
                    rule = f"{strategy.name} cannot be told to land where it is"
                    yield key, action.value, rule, 'Write "hold" or "return".'
        if self.scanner.kind != _RADAR:
            yield from self._broken_of_near_sensor()
        yield from broken_of(
            (not vehicle.scanner and self.scanner != ScannerTable(), "scanner",
             self.scanner.model_dump(by_alias=True),
             "vehicle.scanner = false says that there is no terrain radar", _REMOVE_ONE),
            (not vehicle.scanner and terrain is None, "vehicle.scanner", False,
             "without a terrain radar nothing is known of the ground",
             "Add [terrain] with a file or highest_amsl_m, or remove scanner = false."),
            (not vehicle.scanner and guides, "terrain.trust", "guidance",
             "without a terrain radar nothing would be proven, as guidance proves nothing",
             'Write terrain.trust = "proof", or remove scanner = false.'),
            (from_vehicle and targets is not None, "targets", len(targets or ()),
             "the targets come from the vehicle (from_vehicle.targets)", _REMOVE_ONE),
            (not from_vehicle and targets is None, "targets", None, "it is missing",
             "Add [[targets]], or from_vehicle.targets = true; see docs/files.md."),
        )  # fmt: skip

    def _broken_of_near_sensor(self) -> Iterator[Broken]:
        """Who flies by such a sensor stops, in a band that it sees, over known ground."""
        component, speaks_m = self.vehicle.scanner_component_id, self.scanner.speaks_for_m
        guides = self.is_for_guidance
        height_m = self.altitude.ceiling_amsl_m - self.altitude.floor_amsl_m
        return broken_of(
            (component is not None, "vehicle.scanner_component_id", component,
             "it is the terrain radar's", "Write scanner.component."),
            (self.vehicle.kind != "copter", "scanner.kind", self.scanner.kind,
             "only what can stop may fly by a sensor of near things",
             "Use a terrain radar for a plane."),
            (speaks_m < height_m, "scanner.speaks_for_m", speaks_m,
             f"its beams are flat, and altitude's band is {height_m:g} m high",
             f"Raise it to {height_m:g} if what stands there is so tall, or narrow the band."),
            (self.terrain is None or guides, "terrain.trust" if guides else "terrain",
             "guidance" if guides else None, "a sensor of near things does not see the ground",
             "Add [terrain] with highest_amsl_m, or with an elevation file that is trusted."),
        )  # fmt: skip
