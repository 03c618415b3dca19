"""Converts the tables of a mission file to a `Mission`, or reports the rule that is broken.

A mission may name a .plan, a GeoJSON file and an elevation file.  The first two are taken into the
table itself (`complete`), so that a run folder holds all that was flown.
"""

from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from companion.errors import InputError
from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import named
from companion.mission.mission import Mission
from companion.path.envelope import COPTER, PLANE
from companion.path.limits import Limits
from companion.planner import rules
from companion.planner.settings import PlannerSettings, Task
from companion.profiles import PROFILES, Weights
from companion.sources.files import WAYPOINTS, RawTable, begins_as, plain
from companion.sources.geojson import NoZone, read_geojson
from companion.sources.mission_schema import (
    KnownElevationTable,
    MissionTable,
    StatedTable,
    TargetTable,
    ThreatsTable,
)
from companion.sources.plan_defaults import with_plan
from companion.sources.plan_file import (
    Ground,
    Zones,
    read_plan,
    read_waypoint_fence,
    read_waypoint_list,
)
from companion.sources.schema import validated
from companion.sources.zones import Place, place_of, radar_of, zones_of
from companion.world.columns import distance_to_terrain_m
from companion.world.known_map import KnownMap, empty_map
from companion.world.near_map import cell_for_m

_MENTIONED_M = 1.0  # a smaller difference is worth no mention
_STEP_M = 5.0


class MissionFile(NamedTuple):
    """A mission file with what the files that it names hold."""

    table: RawTable
    notes: tuple[str, ...]
    """What was assumed and what was left out, for people."""
    is_whole: bool
    """Whether it was so from the beginning: it names no other file."""


def complete(given: RawTable, folder: Path, where: str) -> MissionFile:
    """Take into a table what other files hold that it names.  Raises InputError about them."""
    table, notes = given, list[str]()
    if isinstance(given.get("plan"), str):
        table, notes = _with_plan(given, folder, where)
    asked, terrain = given.get("threats"), given.get("terrain")
    if isinstance(asked, str | dict):
        asked = {"file": asked} if isinstance(asked, str) else asked
        chosen = validated(ThreatsTable, asked, f"{where}: threats")
        threats = _threats(folder / chosen.file, f"{where}: threats", chosen.leave_out)
        notes += threats.notes
        table = {key: value for key, value in table.items() if key != "threats"}
        for key, found in (("keep_outs", threats.keep_outs), ("keep_ins", threats.keep_ins)):
            if found and isinstance(table.get(key, []), list):
                table[key] = [*table.get(key, []), *found]
    if isinstance(terrain, dict) and isinstance(terrain.get("file"), str):
        file = str((folder / terrain["file"]).absolute())
        table = table | {"terrain": terrain | {"file": file}}
    return MissionFile(table=table, notes=tuple(notes), is_whole=table is given)


def _threats(path: Path, where: str, leave_out: Collection[NoZone]) -> Zones:
    """What a GeoJSON file or a list of QGC WPL 110 holds; leave_out: as for `read_geojson`."""
    is_list = begins_as(path, WAYPOINTS)
    threats = read_waypoint_fence(path, where) if is_list else read_geojson(path, where, leave_out)
    if not (threats.keep_outs or threats.keep_ins):
        threats.notes.append(f"{path.name}: it holds no zone")
    return threats


def _with_plan(table: RawTable, folder: Path, where: str) -> tuple[RawTable, list[str]]:
    path, field = folder / table["plan"], f"{where}: plan"
    read = read_waypoint_list if begins_as(path, WAYPOINTS) else read_plan
    plan = read(path, field, _ground(table, folder, where))
    if plan.targets and "targets" in table:
        rule = f"{plan.name} has waypoints too"
        raise InputError(f"{where}: targets", len(plan.targets), rule, "Remove one of them.")
    stem = "".join(c if c.isascii() and (c.isalnum() or c in "_-.") else " " for c in path.stem)
    given = {key: value for key, value in table.items() if key != "plan"}
    whole, notes = with_plan(given, plan, plain(stem, "").lstrip(" _-.") or "plan")
    if "targets" in whole and not whole["targets"]:
        raise InputError(field, plan.name, "it has no waypoints", "Add a waypoint.")
    return whole, notes


def _ground(table: RawTable, folder: Path, where: str) -> Ground | None:
    """The ground that [terrain] knows, for altitudes above it; None: it says nothing."""
    if not isinstance(said := table.get("terrain"), dict):
        return None
    if "highest_amsl_m" in said:
        stated_m = validated(StatedTable, said, f"{where}: terrain").highest_amsl_m
        return lambda *_: stated_m
    terrain = validated(KnownElevationTable, said, f"{where}: terrain")
    return terrain.elevation(folder, where).height_m


def mission_of(
    model: MissionTable, profile: str | None, where: str, notes: tuple[str, ...] = ()
) -> Mission:
    """The mission that a checked table means; profile overrides the table's.

    Raises InputError for the first rule about the planner, a place or another file that is broken.
    """
    vehicle, terrain = model.vehicle, model.terrain
    frame = LocalFrame(**dict(model.origin))
    near = model.scanner.sensor(model.planner.scan_range_m)
    stated_m = terrain.highest_amsl_m if isinstance(terrain, StatedTable) else None
    limits, settings = _limits(model), _settings(model, profile)
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
        stated_ground_amsl_m=None if model.scans_ground else stated_m,
    )
    task, slower = rules.slowed_to_sight(task), ""
    asked_m_s, flown_m_s = limits.speed_m_s, task.limits.speed_m_s
    if flown_m_s < asked_m_s:
        slower = f"R = {settings.scan_range_m:g} m is too short for V = {asked_m_s:g} m/s (eq. 4): "
        slower += f"it is flown at {flown_m_s:g} m/s; raise planner.scan_range_m to fly faster"
    rules.refuse(rules.of_task(task), f"{where}: ")
    zones, far = zones_of(model, task, frame, where)
    task = replace(task, zones=zones)
    said = (vehicle, model.end, model.fallback, model.battery, model.link, model.from_vehicle)
    as_written = {key: each for table in said for key, each in table.of(Mission).items()}
    if not model.scans_ground:
        as_written["scanner_component_id"] = None
    about_ground, targets = "", model.targets or []
    if stated_m is not None:  # a person should be told once more before it is flown by
        about_ground = f"the ground is taken to be nowhere higher than {stated_m:g} m AMSL"
    mission = Mission(
        name=model.name,
        frame=frame,
        targets_ne_m=_targets(model, task, frame, where),
        altitudes_amsl_m=_carried_on([each.altitude_amsl_m for each in targets]),
        task=task,
        scanner_complete=model.scanner.scanner_complete,
        near=near,
        known=_known_map(model, task, frame, where),
        rally_ne_m=tuple(
            place_of(point, frame, f"{where}: rally_points[{index}]")
            for index, point in enumerate(model.rally_points)
        ),
        notes=tuple(filter(None, (*notes, slower, far, about_ground))),
        **as_written,
    )
    return replace(mission, notes=(*mission.notes, *_about_altitudes(mission, targets, where)))


def _targets(model: MissionTable, task: Task, frame: LocalFrame, where: str) -> tuple[Place, ...]:
    found = []
    for index, target in enumerate(model.targets or []):
        field = _field(where, index, target)
        place = place_of(target, frame, field)
        rules.refuse(rules.of_target(task, place, field))
        found.append(place)
    return tuple(found)


def _field(where: str, index: int, target: TargetTable) -> str:
    """How a target is called in errors."""
    return f"{where}: targets[{index}]" + (f" ({target.name})" if target.name else "")


def _limits(model: MissionTable) -> Limits:
    north_m, east_m = model.area.sides_m
    as_written = model.vehicle.of(Limits) | model.altitude.of(Limits)
    return Limits(north_m=north_m, east_m=east_m, **as_written)


def _settings(model: MissionTable, profile: str | None) -> PlannerSettings:
    planner = model.planner
    as_written = {"overlap_m": 0.1 * planner.scan_range_m} | planner.of(PlannerSettings)
    as_written["position_period_s"] = 1.0 / model.vehicle.position_rate_hz
    as_written["profile"] = PROFILES[profile or planner.profile]
    as_written["weights"] = Weights(**dict(planner.weights))
    return PlannerSettings(**as_written)


def _known_map(model: MissionTable, task: Task, frame: LocalFrame, where: str) -> KnownMap | None:
    """The terrain known in advance, on the lattice of the mission's map."""
    table = model.terrain
    if table is None:
        return None
    blank = empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)
    may_be_scanned, shape = model.vehicle.scanner, blank.upper_m.shape
    if isinstance(table, KnownElevationTable):
        told = table.elevation(Path(), where).known_map(
            frame, blank, datum_error_m=table.datum_error_m, may_be_scanned=may_be_scanned
        )
    else:  # a radar, if there is one, may see it lower
        told = replace(
            blank,
            upper_m=np.full(shape, table.highest_amsl_m),
            seen=np.full(shape, not may_be_scanned),
            given=np.ones(shape, dtype=bool),
        )
    if task.settings.is_near:  # known is the ground, and nothing of what stands on it
        return replace(blank, guess_m=told.upper_m)
    if isinstance(table, KnownElevationTable) and table.trust == "guidance":
        return replace(blank, guess_m=np.where(told.surveyed, told.upper_m, np.nan))
    return told


# --- the altitudes of targets, held against the ground that is known before take-off


def _carried_on(altitudes_amsl_m: list[float | None]) -> tuple[float | None, ...]:
    """Each target's altitude, of one that has none that of the target before; () if none has."""
    carried: tuple[float | None, ...] = ()
    for altitude in altitudes_amsl_m:
        carried += (altitude if altitude is not None or not carried else carried[-1],)
    return carried if carried and carried[-1] is not None else ()


def _about_altitudes(mission: Mission, targets: list[TargetTable], where: str) -> Iterator[str]:
    """Where the targets' own altitudes are not flown, for a vehicle without a terrain radar.

    Raises InputError about a target that nothing of the band is high enough for, or whose ground
    is not known.
    """
    lowest_m, top_m = mission.task.band_amsl_m
    for number, table in enumerate(targets):
        if table.altitude_amsl_m is not None and table.altitude_amsl_m >= top_m:
            rule = f"no path lies higher than {top_m:g} m, the ceiling less the vehicle's errors"
            remedy = "Lower it, or raise altitude.ceiling_amsl_m."
            field = f"{where}: targets[{number}].altitude_amsl_m"
            raise InputError(field, table.altitude_amsl_m, rule, remedy)
    may_scan = mission.near is not None or mission.scanner_component_id is not None
    if mission.known is None or may_scan:
        return
    altitudes = mission.altitudes_amsl_m or (None,) * len(targets)
    places = zip(mission.targets_ne_m, altitudes, targets, strict=False)
    for number, (place, wanted_m, table) in enumerate(places):
        field = _field(where, number, table)
        least_m = lowest_m if wanted_m is None else max(wanted_m, lowest_m)
        flown_m = _clear_from_m(mission, place, least_m)
        if flown_m is None:
            top_m = mission.task.limits.ceiling_amsl_m
            rule = f"the ground there is not known, or too high for the ceiling, {top_m:g} m AMSL"
            remedy = "Move it, or correct [terrain] or altitude.ceiling_amsl_m."
            raise InputError(field, list(place), rule, remedy)
        if wanted_m is not None and flown_m - wanted_m > _MENTIONED_M:
            yield (
                f"{table.name or f'target {number + 1}'} is planned at {wanted_m:g} m AMSL and "
                f"flown at {flown_m:.0f} m: below that d_s and the vehicle's errors are not kept"
            )


def _clear_from_m(mission: Mission, place: tuple[float, float], least_m: float) -> float | None:
    """The lowest altitude from this one on that is clear of the ground; None: none in the band."""
    assert mission.known is not None
    top_m, required_m = mission.task.band_amsl_m[1], mission.task.required_clearance_m
    for up_m in np.arange(min(least_m, top_m), top_m, _STEP_M):
        at = np.array([*place, up_m])
        if distance_to_terrain_m(mission.known, at, required_m) >= required_m - 1e-6:
            return float(up_m)
    return None
