"""The tables of mission files.  What they mean together is `mission_file`'s part."""

from dataclasses import fields
from typing import Annotated, Literal

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from companion.mission.mission import EndAction, Fallback, Mission
from companion.optimise.registry import OPTIMISERS
from companion.path.limits import Limits, VehicleKind
from companion.planner.settings import PlannerSettings
from companion.profiles import Weights
from companion.ranges import Latitude, Longitude, NotNegative, Positive
from companion.sources.elevation import VerticalDatum
from companion.sources.geojson import NoZone
from companion.sources.schema import (
    NAME,
    SENDER,
    Altitude,
    AreaTable,
    Horizontal,
    Nodata,
    OriginTable,
    Table,
    keys_of,
)
from companion.world.near_map import Kind, NearSensor

Slope = Annotated[float, Field(gt=0.0, lt=90.0)]
Name = Annotated[str, Field(min_length=1, max_length=100)]
FileName = Annotated[str, Field(min_length=1, max_length=1000)]
Sender = Annotated[str, Field(pattern=SENDER)]


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
    climb_angle_deg: Slope
    dive_angle_deg: Slope
    yaw_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | None = None


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
    component: Annotated[int, Field(ge=1, le=250)] | None = None
    """MAVLink component that sends them; left out: the autopilot for its sectors, else 196"""
    yaw_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = 0.0
    bearing_error_deg: Annotated[float, Field(ge=0.0, le=45.0)] = 1.0


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


class EndTable(Table):
    """What to do at the last target."""

    action: Literal[tuple(action.value for action in EndAction)]  # type: ignore[valid-type]


class FallbackTable(keys_of(Mission, "attempts")):  # type: ignore[misc]
    """What to do when no way on is found, or the battery will not last."""

    action: Literal[tuple(action.value for action in Fallback)] = "return"  # type: ignore[valid-type]


class BatteryTable(keys_of(Mission, "endurance_s")):  # type: ignore[misc]
    """What must be left, and how long a full one lasts."""

    reserve_percent: Annotated[float, Field(ge=0.0, lt=100.0)] = 20.0


class LinkTable(keys_of(Mission, "sets_parameters")):  # type: ignore[misc]
    """Who may command the companion, and what it may say to the autopilot."""

    commanders: list[Sender] | None = None


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
    """A file of zones and radars, and what of it is none."""

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


class MissionTable(Table):
    """A mission.toml, with what other files that it names hold."""

    schema_: Annotated[Literal[1], Field(alias="schema")]
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
