"""Mission files: their tables, with the rules between keys, and the `Mission` that they mean.

A field of a table is called as the value that it becomes; where the file has another unit or name
for it, that is its alias.  A mission may name a .plan, a GeoJSON file and an elevation file.  The
first two are taken into the table itself (`complete`), so that a run folder holds all that was
flown.
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

from companion.errors import InputError
from companion.geodesy import FloatArray, LocalFrame, wrap_rad
from companion.mavlink.autopilots import named
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, wire
from companion.mavlink.sensors import SENSORS
from companion.mission.mission import EndAction, Fallback, Mission
from companion.optimise.registry import OPTIMISERS
from companion.path.envelope import COPTER, PLANE
from companion.path.limits import Limits, VehicleKind
from companion.planner import rules
from companion.planner.rules import Broken
from companion.planner.settings import Place, PlannerSettings, Task
from companion.profiles import PROFILES, Weights
from companion.ranges import Altitude, NotNegative, Positive
from companion.sources.elevation import KnownElevationTable
from companion.sources.files import WAYPOINTS, RawTable, begins_as, located, plain, within
from companion.sources.plan_file import (
    Ground,
    read_plan,
    read_waypoint_fence,
    read_waypoint_list,
    with_plan,
)
from companion.sources.tables import (
    AreaTable,
    FileName,
    OriginTable,
    Table,
    broken_of,
    keys_of,
    validated,
)
from companion.sources.zones import (
    NoZone,
    PlaceTable,
    RadarTable,
    TargetTable,
    Zones,
    ZoneTable,
    read_geojson,
    zones_of,
)
from companion.world.columns import distance_to_terrain_m
from companion.world.known_map import KnownMap, empty_map
from companion.world.near_map import Kind, NearSensor, cell_for_m

_MENTIONED_M = 1.0  # a smaller difference is worth no mention
_STEP_M = 5.0
_Slope = Annotated[float, Field(gt=0.0, lt=90.0), AfterValidator(math.radians)]
_Bearing = Annotated[float, Field(ge=-360.0, le=360.0), AfterValidator(math.radians)]
_LIDAR_COMPONENT: Final = wire.MAV_COMP_ID_OBSTACLE_AVOIDANCE
_RADAR: Final = "terrain_radar"


class BandTable(Table):
    """The altitudes between which to fly."""

    floor_amsl_m: Altitude
    ceiling_amsl_m: Altitude


_SPEEDS = ("speed_m_s", "acceleration_m_s2", "climb_rate_m_s", "turn_radius_m")
_ERRORS = ("tracking_error_m", "navigation_error_m", "dead_man_s")


class VehicleTable(
    keys_of(Mission, "autopilot", "system_id", "position_rate_hz", *SENSORS),  # type: ignore[misc]
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
        is_plane, loiter_m = self.kind == "plane", self.loiter_radius_m
        yield from broken_of(
            (not is_plane and loiter_m is not None, "loiter_radius_m", loiter_m,
             "a copter stops where it holds: it needs no circle", "Remove it."),
            (is_plane and loiter_m is None, "loiter_radius_m", None,
             "it is missing: a plane cannot stop, it holds on circles",
             "Add loiter_radius_m, as the autopilot has it (WP_LOITER_RAD, NAV_LOITER_RAD)."),
            (is_plane and self.yaw_rad is not None, "yaw_deg", math.degrees(self.yaw_rad or 0.0),
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
        is_radar, of_radars = self.kind == _RADAR, {"scanner_complete"}
        given = self.model_fields_set - {"kind"}
        rule = f"it is of kind {' or '.join(get_args(Kind)) if is_radar else _RADAR}"
        for name in sorted(given - of_radars if is_radar else given & of_radars):
            key, value = type(self).model_fields[name].alias or name, getattr(self, name)
            value = math.degrees(value) if key.endswith("_deg") else value
            yield key, value, rule, "Remove it, or write that kind."
        if self.component_id == COMPANION_COMPONENT:
            rule = "that is the companion itself"
            yield "component", self.component_id, rule, "Give the driver another, as 196."

    def sensor(self, range_m: float) -> NearSensor | None:
        """The sensor of near things, where that is the scanner."""
        if self.kind == _RADAR:
            return None
        usual = AUTOPILOT_COMPONENT if self.kind == "distance_sensor" else _LIDAR_COMPONENT
        return NearSensor(**{"component_id": usual, "range_m": range_m} | self.of(NearSensor))


class WeightsTable(keys_of(Weights, *(weight.name for weight in fields(Weights)))):  # type: ignore[misc]
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

    def height_m(self, *_place_deg: float) -> float:
        """The highest that it may be at a place, metres AMSL."""
        return self.highest_amsl_m

    def upper_m(self, _frame: LocalFrame, blank: KnownMap) -> FloatArray:
        """It, in each cell of a map."""
        return np.full(blank.shape, self.highest_amsl_m)


def _kind_of_terrain(table: Any) -> str:
    says_height = isinstance(table, dict) and any(key.startswith("highest") for key in table)
    return "(stated)" if says_height else "(file)"


KnownTerrain = Annotated[
    Annotated[StatedTable, Tag("(stated)")] | Annotated[KnownElevationTable, Tag("(file)")],
    Discriminator(_kind_of_terrain),
]


class _OnlyTerrain(Table):
    terrain: KnownTerrain


class MissionTable(Table):
    """A mission.toml, with what other files that it names hold."""

    schema_: Literal[1] = Field(alias="schema")
    name: str
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
        vehicle, scanner, blind = self.vehicle, self.scanner, not self.scans_ground
        near, component = scanner.kind != _RADAR, vehicle.scanner_component_id
        height_m = self.altitude.ceiling_amsl_m - self.altitude.floor_amsl_m
        if vehicle.kind == "plane" and vehicle.autopilot is not None:
            strategy = named(vehicle.autopilot, vehicle.kind)
            ends = {"end.action": self.end.end_action, "fallback.action": self.fallback.fallback}
            for key, action in ends.items():
                if action.value == "land" and not strategy.traits.lands:
                    rule = f"{strategy.name} cannot be told to land where it is"
                    yield key, action.value, rule, 'Write "hold" or "return".'
        letters = re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9 _.-]{0,63}", self.name)
        yield from broken_of(  # by a sensor of near things flies who can stop, over known ground
            (letters is None, "name", self.name,
             "it must be up to 64 of A-Z, a-z, 0-9, space and _.-, and begin with one of the first",
             "Rename it."),
            (blind and component is not None, "vehicle.scanner_component_id", component,
             "there is no terrain radar", "Remove it, or of a lidar write scanner.component."),
            (near and vehicle.kind != "copter", "scanner.kind", scanner.kind,
             "only what can stop may fly by a sensor of near things",
             "Use a terrain radar for a plane."),
            (near and scanner.speaks_for_m < height_m, "scanner.speaks_for_m", scanner.speaks_for_m,
             f"its beams are flat, and altitude's band is {height_m:g} m high",
             f"Raise it to {height_m:g} if what stands there is so tall, or narrow the band."),
            (not vehicle.scanner and scanner != ScannerTable(), "vehicle.scanner", False,
             "[scanner] says what it is", "Remove one of them."),
            (blind and self.terrain is None, "terrain", None,
             "without a terrain radar nothing is known of the ground",
             "Add [terrain] with highest_amsl_m, or with an elevation file that is trusted."),
            (blind and self.is_for_guidance, "terrain.trust", "guidance",
             "guidance proves nothing, and without a terrain radar nothing else does",
             'Write terrain.trust = "proof", or use a terrain radar.'),
            (self.from_vehicle.targets_from_vehicle is (self.targets is not None), "targets",
             self.targets and len(self.targets),
             "there are either [[targets]], or the vehicle's own (from_vehicle.targets = true)",
             "Write one of both; see docs/files.md."),
        )  # fmt: skip


# --- what other files hold that it names


def complete(given: RawTable, folder: Path, where: str) -> tuple[RawTable, tuple[str, ...]]:
    """A table with what other files hold that it names, and notes for people: what was left out.

    The same table, if it names none.  Raises InputError about them.
    """
    table, notes = located(given, folder), list[str]()
    if isinstance(given.get("plan"), str):
        table, notes = _with_plan(table, folder, where)
    if isinstance(asked := given.get("threats"), str | dict):
        threats = _threats({"file": asked} if isinstance(asked, str) else asked, folder, where)
        notes += threats.notes
        table = {key: value for key, value in table.items() if key != "threats"}
        for key, zones in (("keep_outs", threats.keep_outs), ("keep_ins", threats.keep_ins)):
            if zones and isinstance(table.get(key, []), list):
                table[key] = [*table.get(key, []), *zones]
    return table, tuple(notes)


def _threats(asked: RawTable, folder: Path, where: str) -> Zones:
    """What a GeoJSON file or a list of QGC WPL 110 holds."""
    chosen = validated(ThreatsTable, asked, where := f"{where}: threats")
    path, zones = folder / chosen.file, Zones()
    if begins_as(path, WAYPOINTS):
        zones = read_waypoint_fence(path, where)
    else:
        zones = read_geojson(path, where, chosen.leave_out)
    if not (zones.keep_outs or zones.keep_ins):
        zones.notes.append(f"{path.name}: it holds no zone")
    return zones


def _with_plan(table: RawTable, folder: Path, where: str) -> tuple[RawTable, list[str]]:
    path, field = folder / table["plan"], f"{where}: plan"
    read = read_waypoint_list if begins_as(path, WAYPOINTS) else read_plan
    plan = read(path, field, _ground(table, where))
    if plan.targets and "targets" in table:
        rule = f"{plan.name} has waypoints too"
        raise InputError(f"{where}: targets", len(plan.targets), rule, "Remove one of them.")
    stem = "".join(c if c.isascii() and (c.isalnum() or c in "_-.") else " " for c in path.stem)
    given = {key: value for key, value in table.items() if key != "plan"}
    whole, notes = with_plan(given, plan, plain(stem, "").lstrip(" _-.") or "plan")
    if "targets" in whole and not whole["targets"]:
        raise InputError(field, plan.name, "it has no waypoints", "Add a waypoint.")
    return whole, notes


def _ground(table: RawTable, where: str) -> Ground | None:
    """The ground that [terrain] knows, for altitudes above it; None: it says nothing."""
    if not isinstance(given := table.get("terrain"), dict):
        return None
    terrain = validated(_OnlyTerrain, {"terrain": given}, where).terrain

    def height_m(latitude_deg: float, longitude_deg: float) -> float | None:
        with within(where):
            return terrain.height_m(latitude_deg, longitude_deg)

    return height_m


def mission_of(model: MissionTable, profile: str | None, notes: tuple[str, ...] = ()) -> Mission:
    """The mission that a checked table means; profile overrides the table's.

    Raises InputError for the first rule about the planner, a place or another file that is broken.
    """
    targets, frame = model.targets or [], LocalFrame(**dict(model.origin))
    task, of_task = task_of(model, profile)
    places = list[Place]()
    for number, target in enumerate(targets):
        places.append(target.place(frame, _field(number, target)))
        rules.refuse(rules.of_target(task, places[-1], _field(number, target)))
    tables = "vehicle", "end", "fallback", "battery", "link", "from_vehicle"
    written = (getattr(model, name).of(Mission) for name in tables)
    as_written = {key: value for values in written for key, value in values.items()}
    if not model.scans_ground:
        as_written["scanner_component_id"] = None
    stated = ""
    if isinstance(terrain := model.terrain, StatedTable):  # told once more before it is flown by
        height = f"{terrain.highest_amsl_m:g} m AMSL"
        stated = f"the ground is taken to be nowhere higher than {height}"
    mission = Mission(
        name=model.name,
        frame=frame,
        targets_ne_m=tuple(places),
        altitudes_amsl_m=_carried_on([target.altitude_amsl_m for target in targets]),
        task=task,
        scanner_complete=model.scanner.scanner_complete,
        near=model.scanner.sensor(model.planner.scan_range_m),
        known=_known_map(model, task, frame),
        rally_ne_m=tuple(
            point.place(frame, f"rally_points[{index}]")
            for index, point in enumerate(model.rally_points)
        ),
        notes=tuple(filter(None, (*notes, *of_task, stated))),
        **as_written,
    )
    return replace(mission, notes=(*mission.notes, *_about_altitudes(mission, targets)))


def _field(number: int, target: TargetTable) -> str:
    """How a target is called in errors."""
    return f"targets[{number}]" + (f" ({target.name})" if target.name else "")


def task_of(model: MissionTable, profile: str | None) -> tuple[Task, tuple[str, str]]:
    """The task that a checked table means, and notes on it or "".  Raises as `mission_of`."""
    vehicle, planner, terrain = model.vehicle, model.planner, model.terrain
    frame = LocalFrame(**dict(model.origin))
    north_m, east_m = model.area.sides_m
    limits = Limits(
        north_m=north_m, east_m=east_m, **vehicle.of(Limits), **model.altitude.of(Limits)
    )
    settings = PlannerSettings(
        **{"overlap_m": 0.1 * planner.scan_range_m}
        | planner.of(PlannerSettings)
        | {
            "position_period_s": 1.0 / vehicle.position_rate_hz,
            "profile": PROFILES[profile or planner.profile],
            "weights": Weights(**dict(planner.weights)),
        }
    )
    if model.scanner.kind != _RADAR:
        cell_m = cell_for_m(settings.scan_range_m, north_m, east_m)
        settings = replace(settings, cell_m=cell_m)
        limits = replace(limits, overrun_m=settings.safety_distance_m)
    handling = COPTER if vehicle.kind == "copter" else PLANE  # the widest
    if vehicle.autopilot is not None:
        handling = named(vehicle.autopilot, vehicle.kind).traits.handling
    stated_m = terrain.highest_amsl_m if isinstance(terrain, StatedTable) else None
    asked = Task(
        limits=limits,
        settings=settings,
        handling=handling,
        convergence_rad=frame.convergence_rad(north_m, east_m),
        radars=tuple(
            radar.radar(frame, f"radars[{index}]") for index, radar in enumerate(model.radars)
        ),
        stated_ground_amsl_m=None if model.scans_ground else stated_m,
    )
    task, slower = rules.slowed_to_sight(asked), ""
    if (flown_m_s := task.limits.speed_m_s) < (asked_m_s := limits.speed_m_s):
        slower = f"R = {settings.scan_range_m:g} m is too short for V = {asked_m_s:g} m/s (eq. 4): "
        slower += f"it is flown at {flown_m_s:g} m/s; raise planner.scan_range_m to fly faster"
    rules.refuse(rules.of_task(task))
    zones, far = zones_of(model.keep_outs, model.keep_ins, task, frame)
    return replace(task, zones=zones), (slower, far)


def _known_map(model: MissionTable, task: Task, frame: LocalFrame) -> KnownMap | None:
    """The terrain known in advance, on the lattice of the mission's map.

    It counts as seen, so that nothing looks at it again, unless a radar may: a scan replaces it,
    downwards too.
    """
    if model.terrain is None:
        return None
    blank = empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)
    upper_m = model.terrain.upper_m(frame, blank)
    if task.settings.is_near:  # known is the ground, and nothing of what stands on it
        return replace(blank, guess_m=upper_m)
    known = np.isfinite(upper_m)
    if model.is_for_guidance:
        return replace(blank, guess_m=np.where(known, upper_m, np.nan))
    return replace(blank, upper_m=upper_m, seen=known & (not model.vehicle.scanner), given=known)


# --- the altitudes of targets, held against the ground that is known before take-off


def _carried_on(altitudes_amsl_m: list[float | None]) -> tuple[float | None, ...]:
    """Each target's altitude, of one that has none that of the target before; () if none has."""
    carried: tuple[float | None, ...] = ()
    for altitude in altitudes_amsl_m:
        carried += (altitude if altitude is not None or not carried else carried[-1],)
    return carried if carried and carried[-1] is not None else ()


def _about_altitudes(mission: Mission, targets: list[TargetTable]) -> Iterator[str]:
    """Where the targets' own altitudes are not flown, for a vehicle without a terrain radar.

    Raises InputError about a target that nothing of the band is high enough for, or whose ground
    is not known.
    """
    lowest_m, top_m = mission.task.band_amsl_m
    known, may_scan = mission.known, mission.near or mission.scanner_component_id is not None
    wanted = mission.altitudes_amsl_m or (None,) * len(targets)
    for number, (place, wanted_m) in enumerate(zip(mission.targets_ne_m, wanted, strict=True)):
        name, field = targets[number].name, f"targets[{number}]"
        if wanted_m is not None and wanted_m >= top_m:
            rule = f"no path lies higher than {top_m:g} m, the ceiling less the vehicle's errors"
            remedy = "Lower it, or raise altitude.ceiling_amsl_m."
            raise InputError(f"{field}.altitude_amsl_m", wanted_m, rule, remedy)
        if known is None or may_scan:
            continue
        least_m = lowest_m if wanted_m is None else max(wanted_m, lowest_m)
        if (flown_m := _clear_from_m(known, mission.task, place, least_m)) is None:
            ceiling_m = mission.task.limits.ceiling_amsl_m
            rule = f"the ground there is not known, or too high for the ceiling, {ceiling_m:g} m"
            remedy = "Move it, or correct [terrain] or altitude.ceiling_amsl_m."
            raise InputError(_field(number, targets[number]), list(place), rule, remedy)
        if wanted_m is not None and flown_m - wanted_m > _MENTIONED_M:
            yield (
                f"{name or f'target {number + 1}'} is planned at {wanted_m:g} m AMSL and "
                f"flown at {flown_m:.0f} m: below that d_s and the vehicle's errors are not kept"
            )


def _clear_from_m(known: KnownMap, task: Task, place: Place, least_m: float) -> float | None:
    """The lowest altitude from this one on that is clear of the ground; None: none in the band."""
    top_m, required_m = task.band_amsl_m[1], task.required_clearance_m
    for up_m in np.arange(min(least_m, top_m), top_m, _STEP_M):
        if distance_to_terrain_m(known, np.array([*place, up_m]), required_m) >= required_m - 1e-6:
            return float(up_m)
    return None
