"""Converts the tables of a mission file to a `Mission`, or reports the rule that is broken.

A mission may name a .plan, a GeoJSON file and an elevation file.  The first two are taken into the
table itself (`complete`), so that a run folder holds all that was flown.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import final, get_args

import numpy as np

from companion.errors import InputError
from companion.geodesy import LocalFrame, wrap_rad
from companion.mavlink.autopilots import named
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, wire
from companion.mission.mission import EndAction, Fallback, Mission
from companion.path.envelope import COPTER, PLANE
from companion.path.limits import Limits
from companion.planner import rules
from companion.planner.settings import PlannerSettings, Task
from companion.profiles import PROFILES, Weights
from companion.sources.altitudes import about_altitudes, carried_on
from companion.sources.elevation import height_at_m, read_known_map
from companion.sources.files import RawTable, path_of, plain, told_path
from companion.sources.geojson import NoZone, Threats, read_geojson
from companion.sources.mission_schema import (
    KnownTerrainTable,
    MissionTable,
    MissionVehicleTable,
    ScannerTable,
    ThreatsTable,
)
from companion.sources.places import Place, place_of, radar_of, zones_of
from companion.sources.plan_defaults import with_plan
from companion.sources.plan_file import Ground, read_plan
from companion.sources.recognised import GEOJSON, JSON, PLAN, WAYPOINTS, kind_of, refuse_other
from companion.sources.schema import validated
from companion.sources.waypoint_file import read_waypoint_fence, read_waypoint_list
from companion.world.known_map import KnownMap, empty_map
from companion.world.near_map import Kind, NearSensor, cell_for_m

_LIDAR_COMPONENT = wire.MAV_COMP_ID_OBSTACLE_AVOIDANCE
_OF_RADARS = {"kind", "scanner_complete"}
_DATUM_ERROR_M = 5.0
"""Of an elevation file that says nothing of it."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MissionFile:
    """A mission file with what the files that it names hold."""

    table: RawTable
    notes: tuple[str, ...]
    """What was assumed and what was left out, for people."""
    is_whole: bool
    """Whether it was so from the beginning: it names no other file."""
    assumed: frozenset[str] = frozenset()
    """Keys, with dots, that nobody wrote: what a plan lacks."""


def complete(table: RawTable, folder: Path, where: str) -> MissionFile:
    """Take into a table what other files hold that it names.  Raises InputError about them."""
    notes: list[str] = []
    given = table
    names = [key for key in ("plan", "threats") if isinstance(table.get(key), str)]
    if isinstance(table.get("threats"), dict):
        names.append("threats")
    terrain = table.get("terrain")
    if isinstance(table.get("plan"), str):
        table, notes = _with_plan(table, folder, where)
    if "threats" in names:
        asked = table["threats"]
        asked = {"file": asked} if isinstance(asked, str) else asked
        chosen = validated(ThreatsTable, asked, f"{where}: threats")
        threats = _threats(folder / chosen.file, f"{where}: threats", chosen.leave_out)
        notes += threats.notes
        table = {key: value for key, value in table.items() if key != "threats"}
        for key in ("keep_outs", "keep_ins", "radars"):
            found = getattr(threats, key)
            if found and isinstance(table.get(key, []), list):
                table[key] = [*table.get(key, []), *found]
    if isinstance(terrain, dict) and isinstance(terrain.get("file"), str):
        names.append("terrain")
        table = table | {
            "terrain": terrain | {"file": told_path(_absolute(folder / path_of(terrain["file"])))}
        }
    assumed = _keys(table) - _keys(given) if "plan" in names else frozenset[str]()
    return MissionFile(table=table, notes=tuple(notes), is_whole=not names, assumed=assumed)


def _threats(path: Path, where: str, leave_out: Collection[NoZone]) -> Threats:
    """What a GeoJSON file or a list of QGC WPL 110 holds; leave_out: as for `read_geojson`."""
    if kind_of(path) is WAYPOINTS:
        plan = read_waypoint_fence(path, where)
        notes = [f"{path.name}: its {len(plan.targets)} waypoints are not flown"]
        threats = Threats(
            keep_outs=plan.keep_outs, keep_ins=plan.keep_ins, notes=notes if plan.targets else []
        )
    else:
        refuse_other(path, where, GEOJSON, JSON)
        threats = read_geojson(path, where, leave_out)
    if not (threats.keep_outs or threats.keep_ins or threats.radars):
        threats.notes.append(f"{path.name}: it holds no zone and no radar")
    return threats


def _keys(table: RawTable, above: str = "") -> frozenset[str]:
    """With dots, those of tables in it too; lists say by themselves where they are from."""
    found = set[str]()
    for key, value in table.items():
        if isinstance(value, dict):
            found |= _keys(value, f"{above}{key}.")
        if not isinstance(value, list):
            found.add(f"{above}{key}")
    return frozenset(found)


def explained(error: InputError, assumed: frozenset[str], where: str) -> InputError:
    """The error, where it is about a key that nobody wrote, with the word that it was assumed."""
    if error.field.removeprefix(f"{where}: ") not in assumed:
        return error
    remedy = (
        f"It was assumed for the plan: name the plan in a mission.toml to say it. {error.remedy}"
    )
    return InputError(error.field, error.value, error.rule, remedy)


def _with_plan(table: RawTable, folder: Path, where: str) -> tuple[RawTable, list[str]]:
    path = folder / table["plan"]
    refuse_other(path, f"{where}: plan", PLAN, WAYPOINTS)
    read = read_waypoint_list if kind_of(path) is WAYPOINTS else read_plan
    plan = read(path, f"{where}: plan", _ground(table, folder, where))
    if plan.targets and "targets" in table:
        rule = f"{plan.name} has waypoints too"
        raise InputError(f"{where}: targets", len(plan.targets), rule, "Remove one of them.")
    stem = "".join(c if c.isascii() and (c.isalnum() or c in "_-.") else " " for c in path.stem)
    given = {key: value for key, value in table.items() if key != "plan"}
    name = plain(stem, "").lstrip(" _-.") or "plan"
    complete_table, notes = with_plan(given, plan, name)
    from_vehicle = given.get("from_vehicle")
    elsewhere = isinstance(from_vehicle, dict) and from_vehicle.get("targets") is True
    if not complete_table.get("targets") and not elsewhere:
        rule = "it has no waypoints"
        raise InputError(f"{where}: plan", plan.name, rule, "Add a waypoint.")
    return complete_table, notes


def _ground(table: RawTable, folder: Path, where: str) -> Ground | None:
    """The ground that [terrain] knows, for altitudes above it; None: it says nothing."""
    if not isinstance(table.get("terrain"), dict):
        return None

    def at(latitude_deg: float, longitude_deg: float) -> float | None:
        terrain = validated(KnownTerrainTable, table["terrain"], f"{where}: terrain")
        _check_terrain(terrain, where)
        if terrain.highest_amsl_m is not None:
            return terrain.highest_amsl_m
        assert terrain.file is not None
        assert terrain.vertical_datum is not None
        return height_at_m(
            folder / path_of(terrain.file),
            (latitude_deg, longitude_deg),
            vertical_datum=terrain.vertical_datum,
            nodata=terrain.nodata,
            field=f"{where}: terrain.file",
        )

    return at


def _absolute(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):  # refused when it is opened
        return path


def mission_of(
    model: MissionTable, profile: str | None, where: str, notes: tuple[str, ...] = ()
) -> Mission:
    """The mission that a checked table means; profile overrides the table's.

    Raises InputError for the first rule between fields that is broken.
    """
    _check_kind(model, where)
    vehicle, link, origin = model.vehicle, model.link, model.origin
    frame = LocalFrame(latitude_deg=origin.latitude_deg, longitude_deg=origin.longitude_deg)
    near, limits, settings = _near_sensor(model, where), _limits(model), _settings(model, profile)
    if near is not None:
        settings = replace(settings, cell_m=cell_for_m(near.range_m, limits.north_m, limits.east_m))
        limits = replace(limits, overrun_m=settings.safety_distance_m)
    handling = COPTER if vehicle.kind == "copter" else PLANE  # the widest
    if vehicle.autopilot is not None:
        handling = named(vehicle.autopilot, vehicle.kind).traits.handling
    task = Task(
        limits=limits,
        settings=settings,
        handling=handling,
        convergence_rad=frame.convergence_rad(limits.north_m, limits.east_m),
        radars=tuple(
            radar_of(radar, frame, f"{where}: radars[{index}]")
            for index, radar in enumerate(model.radars)
        ),
        stated_ground_amsl_m=_stated_ground(model),
    )
    rules.refuse(rules.of_task(task), f"{where}: ")
    zones, far = zones_of(model, task, frame, where)
    task = replace(task, zones=zones)
    said = (model.scanner, vehicle, model.fallback, model.battery, link, model.from_vehicle)
    as_written = {
        key: value
        for table in said
        for key, value in table.of(Mission).items()
        if key not in ("commanders", "scanner_component_id")
    }
    if link.commanders is not None:
        as_written["commanders"] = _commanders(link.commanders, where)
    tables = model.targets or []
    mission = Mission(
        name=model.name,
        frame=frame,
        targets_ne_m=_targets(model, task, frame, where),
        altitudes_amsl_m=carried_on([table.altitude_amsl_m for table in tables]),
        task=task,
        end_action=EndAction(model.end.action),
        scanner_component_id=None if near is not None else _scanner_id(vehicle),
        near=near,
        yaw_rad=None if vehicle.yaw_deg is None else wrap_rad(math.radians(vehicle.yaw_deg)),
        fallback=Fallback(model.fallback.action),
        known=_known_map(model, task, frame, where),
        reserve=model.battery.reserve_percent / 100.0,
        rally_ne_m=tuple(
            place_of(point, frame, f"{where}: rally_points[{index}]")
            for index, point in enumerate(model.rally_points)
        ),
        notes=tuple(note for note in (*notes, far, _about_terrain(model)) if note),
        **as_written,
    )
    return replace(mission, notes=(*mission.notes, *about_altitudes(mission, tables, where)))


# --- rules between fields


def _check_kind(model: MissionTable, where: str) -> None:
    """What only copters, or only planes, can do, and what a vehicle has."""
    vehicle, field = model.vehicle, f"{where}: vehicle"
    if not vehicle.scanner and vehicle.scanner_component_id is not None:
        rule = "scanner = false says that there is no terrain radar"
        value = vehicle.scanner_component_id
        raise InputError(f"{field}.scanner_component_id", value, rule, "Remove one of them.")
    if not vehicle.scanner and model.scanner != ScannerTable():
        rule = "vehicle.scanner = false says that there is no terrain radar"
        promised = model.scanner.model_dump(by_alias=True)
        raise InputError(f"{where}: scanner", promised, rule, "Remove one of them.")
    if vehicle.kind == "copter":
        if vehicle.loiter_radius_m is not None:
            rule = "a copter stops where it holds: it needs no circle"
            raise InputError(
                f"{field}.loiter_radius_m", vehicle.loiter_radius_m, rule, "Remove it."
            )
        return
    if vehicle.loiter_radius_m is None:
        rule = "it is missing: a plane cannot stop, it holds on circles"
        remedy = "Add loiter_radius_m, as the autopilot has it (WP_LOITER_RAD, NAV_LOITER_RAD)."
        raise InputError(f"{field}.loiter_radius_m", None, rule, remedy)
    if vehicle.yaw_deg is not None:
        rule = "a plane's nose points where it flies"
        raise InputError(f"{field}.yaw_deg", vehicle.yaw_deg, rule, "Remove it.")
    ends = {"end.action": model.end.action, "fallback.action": model.fallback.action}
    strategy = None if vehicle.autopilot is None else named(vehicle.autopilot, vehicle.kind)
    for key, action in ends.items():
        if action == "land" and strategy is not None and not strategy.traits.lands:
            rule = f"{strategy.name} cannot be told to land where it is"
            raise InputError(f"{where}: {key}", action, rule, 'Write "hold" or "return".')


def _near_sensor(model: MissionTable, where: str) -> NearSensor | None:
    """The sensor of near things, where that is the scanner.  Raises InputError."""
    table, band, field = model.scanner, model.altitude, f"{where}: scanner"
    kind = table.kind
    if kind == "terrain_radar":
        for key in sorted(table.model_fields_set - _OF_RADARS):
            rule = "a terrain radar has no such key: it is of the other kinds"
            remedy = f"Remove it, or write one of these kinds: {', '.join(get_args(Kind))}."
            raise InputError(f"{field}.{key}", getattr(table, key), rule, remedy)
        return None
    if "scanner_complete" in table.model_fields_set:
        remedy = 'Remove it, or write kind = "terrain_radar".'
        raise InputError(f"{field}.complete", table.scanner_complete, "it is a radar's", remedy)
    if model.vehicle.scanner_component_id is not None:
        rule, value = "it is the terrain radar's", model.vehicle.scanner_component_id
        name = f"{where}: vehicle.scanner_component_id"
        raise InputError(name, value, rule, "Write scanner.component.")
    if table.component == COMPANION_COMPONENT:
        rule, remedy = "that is the companion itself", "Give the driver another, as 196."
        raise InputError(f"{field}.component", table.component, rule, remedy)
    if model.vehicle.kind != "copter":
        rule = "only what can stop may fly by a sensor of near things"
        raise InputError(f"{field}.kind", kind, rule, "Use a terrain radar for a plane.")
    height_m = band.ceiling_amsl_m - band.floor_amsl_m
    if table.speaks_for_m < height_m:
        rule = f"its beams are flat, and altitude's band is {height_m:g} m high"
        remedy = f"Raise it to {height_m:g} if what stands there is so tall, or narrow the band."
        raise InputError(f"{field}.speaks_for_m", table.speaks_for_m, rule, remedy)
    trust = model.terrain and model.terrain.trust
    if model.terrain is None or trust == "guidance":
        rule = "a sensor of near things does not see the ground"
        remedy = "Add [terrain] with highest_amsl_m, or with an elevation file that is trusted."
        key = "terrain.trust" if trust else "terrain"
        raise InputError(f"{where}: {key}", trust, rule, remedy)
    usual = AUTOPILOT_COMPONENT if kind == "distance_sensor" else _LIDAR_COMPONENT
    return NearSensor(
        component_id=usual if table.component is None else table.component,
        yaw_rad=math.radians(table.yaw_deg),
        bearing_error_rad=math.radians(table.bearing_error_deg),
        range_m=model.planner.scan_range_m,
        **table.of(NearSensor),
    )


def _scanner_id(vehicle: MissionVehicleTable) -> int | None:
    if not vehicle.scanner:
        return None
    return 100 if vehicle.scanner_component_id is None else vehicle.scanner_component_id


def _targets(model: MissionTable, task: Task, frame: LocalFrame, where: str) -> tuple[Place, ...]:
    if model.from_vehicle.targets_from_vehicle:
        if model.targets is not None:
            rule = "the targets come from the vehicle (from_vehicle.targets)"
            raise InputError(f"{where}: targets", len(model.targets), rule, "Remove one of them.")
        return ()
    if model.targets is None:
        remedy = "Add [[targets]], or from_vehicle.targets = true; see docs/files.md."
        raise InputError(f"{where}: targets", None, "it is missing", remedy)
    found = []
    for index, target in enumerate(model.targets):
        field = f"{where}: targets[{index}]" + (f" ({target.name})" if target.name else "")
        place = place_of(target, frame, field)
        rules.refuse(rules.of_target(task, place, field))
        found.append(place)
    return tuple(found)


def _commanders(texts: list[str], where: str) -> tuple[tuple[int, int], ...]:
    found = []
    for index, text in enumerate(texts):
        system, component = (int(part) for part in text.split("/"))
        if not 1 <= system <= 255 or component > 255:
            rule = 'it must be "SYSTEM/COMPONENT", 1 to 255 and 0 (any) to 255'
            remedy = 'Write "255/0" for the usual ground station.'
            raise InputError(f"{where}: link.commanders[{index}]", text, rule, remedy)
        found.append((system, component))
    return tuple(found)


# --- numbers


def _limits(model: MissionTable) -> Limits:
    vehicle, area, band = model.vehicle, model.area, model.altitude
    return Limits(
        climb_angle_rad=math.radians(vehicle.climb_angle_deg),
        dive_angle_rad=math.radians(vehicle.dive_angle_deg),
        floor_amsl_m=band.floor_amsl_m,
        ceiling_amsl_m=band.ceiling_amsl_m,
        north_m=(area.north_min_m, area.north_max_m),
        east_m=(area.east_min_m, area.east_max_m),
        **vehicle.of(Limits) | {"loiter_radius_m": vehicle.loiter_radius_m or 0.0},
    )


def _settings(model: MissionTable, profile: str | None) -> PlannerSettings:
    planner = model.planner
    as_written = planner.of(PlannerSettings) | {
        "position_period_s": 1.0 / model.vehicle.position_rate_hz,
        "profile": PROFILES[profile or planner.profile],
        "weights": Weights(**planner.weights.of(Weights)),
    }
    if planner.overlap_m is None:
        as_written["overlap_m"] = 0.1 * planner.scan_range_m
    return PlannerSettings(**as_written)


def _known_map(model: MissionTable, task: Task, frame: LocalFrame, where: str) -> KnownMap | None:
    """The terrain known in advance, on the lattice of the mission's map."""
    table = model.terrain
    if table is None:
        if not model.vehicle.scanner:
            rule = "without a terrain radar nothing is known of the ground"
            remedy = (
                "Add [terrain] with an elevation file or highest_amsl_m, or remove scanner = false."
            )
            raise InputError(f"{where}: vehicle.scanner", False, rule, remedy)
        return None
    _check_terrain(table, where)
    if table.trust == "guidance" and not model.vehicle.scanner:
        rule = "without a terrain radar nothing would be proven, as guidance proves nothing"
        remedy = 'Write terrain.trust = "proof", or remove scanner = false.'
        raise InputError(f"{where}: terrain.trust", table.trust, rule, remedy)
    blank = empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)
    near = model.scanner.kind != "terrain_radar"
    if table.highest_amsl_m is not None:
        if near:
            return replace(blank, guess_m=np.full(blank.upper_m.shape, table.highest_amsl_m))
        return _level(blank, table.highest_amsl_m, may_be_scanned=model.vehicle.scanner)
    assert table.file is not None
    assert table.vertical_datum is not None
    told = read_known_map(
        path_of(table.file),
        frame,
        blank,
        vertical_datum=table.vertical_datum,
        nodata=table.nodata,
        datum_error_m=_DATUM_ERROR_M if table.datum_error_m is None else table.datum_error_m,
        may_be_scanned=model.vehicle.scanner,
        field=f"{where}: terrain.file",
    )
    if near:  # known is the ground, and nothing of what stands on it
        return replace(blank, guess_m=told.upper_m)
    if table.trust != "guidance":
        return told
    return replace(blank, guess_m=np.where(told.surveyed, told.upper_m, np.nan))


def _stated_ground(model: MissionTable) -> float | None:
    """How high the ground is, where that is stated and it will not be scanned."""
    scans_ground = model.vehicle.scanner and model.scanner.kind == "terrain_radar"
    if model.terrain is None or scans_ground:
        return None
    return model.terrain.highest_amsl_m


def _check_terrain(table: KnownTerrainTable, where: str) -> None:
    """An elevation file and what its heights mean, or one height and nothing else."""
    field = f"{where}: terrain"
    if table.highest_amsl_m is None:
        for key, needed in {"file": table.file, "vertical_datum": table.vertical_datum}.items():
            if needed is None:
                remedy = f"Add {key}, or give highest_amsl_m alone; see docs/files.md."
                raise InputError(f"{field}.{key}", None, "it is missing", remedy)
        return
    of_files = {
        "file": table.file,
        "vertical_datum": table.vertical_datum,
        "nodata": table.nodata,
        "datum_error_m": table.datum_error_m,
        "trust": table.trust,
    }
    for key, value in of_files.items():
        if value is not None:
            rule = "highest_amsl_m speaks of all of the map, and of no file"
            raise InputError(f"{field}.{key}", value, rule, "Remove one of them.")


def _about_terrain(model: MissionTable) -> str:
    """What a person should be told once more before it is flown by."""
    if model.terrain is None or model.terrain.highest_amsl_m is None:
        return ""
    return f"the ground is taken to be nowhere higher than {model.terrain.highest_amsl_m:g} m AMSL"


def _level(blank: KnownMap, highest_amsl_m: float, *, may_be_scanned: bool) -> KnownMap:
    """A map of ground that is nowhere higher; a radar, if there is one, may see it lower."""
    shape = blank.upper_m.shape
    return replace(
        blank,
        upper_m=np.full(shape, highest_amsl_m),
        seen=np.full(shape, not may_be_scanned),
        given=np.ones(shape, dtype=bool),
    )
