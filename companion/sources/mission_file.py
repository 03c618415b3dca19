"""Converts the tables of a mission file to a `Mission`, or reports the rule that is broken.

A mission may name a .plan, a GeoJSON file and an elevation file.  The first two are taken into the
table itself (`complete`), so that a run folder holds all that was flown.
"""

from collections.abc import Iterator
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
from companion.planner.settings import Place, PlannerSettings, Task
from companion.profiles import PROFILES, Weights
from companion.sources.files import WAYPOINTS, RawTable, begins_as, plain, within
from companion.sources.mission_tables import (
    MissionTable,
    StatedTable,
    TargetTable,
    ThreatsTable,
    known_terrain,
)
from companion.sources.plan_file import (
    Ground,
    read_plan,
    read_waypoint_fence,
    read_waypoint_list,
    with_plan,
)
from companion.sources.tables import validated
from companion.sources.zones import Zones, read_geojson, zones_of
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
        threats = _threats(asked, folder, f"{where}: threats")
        notes += threats.notes
        table = {key: value for key, value in table.items() if key != "threats"}
        for key, found in (("keep_outs", threats.keep_outs), ("keep_ins", threats.keep_ins)):
            if found and isinstance(table.get(key, []), list):
                table[key] = [*table.get(key, []), *found]
    if isinstance(terrain, dict) and isinstance(terrain.get("file"), str):
        file = str((folder / terrain["file"]).absolute())
        table = table | {"terrain": terrain | {"file": file}}
    return MissionFile(table=table, notes=tuple(notes), is_whole=table is given)


def _threats(asked: str | RawTable, folder: Path, where: str) -> Zones:
    """What a GeoJSON file or a list of QGC WPL 110 holds."""
    table = {"file": asked} if isinstance(asked, str) else asked
    chosen = validated(ThreatsTable, table, where)
    path = folder / chosen.file
    zones: Zones
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
    terrain = known_terrain(said, where)

    def height_m(latitude_deg: float, longitude_deg: float) -> float | None:
        with within(where):
            return terrain.height_m(folder, latitude_deg, longitude_deg)

    return height_m


def mission_of(model: MissionTable, profile: str | None, notes: tuple[str, ...] = ()) -> Mission:
    """The mission that a checked table means; profile overrides the table's.

    Raises InputError for the first rule about the planner, a place or another file that is broken.
    """
    vehicle, terrain, targets = model.vehicle, model.terrain, model.targets or []
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
            radar.radar(frame, f"radars[{index}]") for index, radar in enumerate(model.radars)
        ),
        stated_ground_amsl_m=None if model.scans_ground else stated_m,
    )
    task, slower = rules.slowed_to_sight(task), ""
    asked_m_s, flown_m_s = limits.speed_m_s, task.limits.speed_m_s
    if flown_m_s < asked_m_s:
        slower = f"R = {settings.scan_range_m:g} m is too short for V = {asked_m_s:g} m/s (eq. 4): "
        slower += f"it is flown at {flown_m_s:g} m/s; raise planner.scan_range_m to fly faster"
    rules.refuse(rules.of_task(task))
    zones, far = zones_of(model.keep_outs, model.keep_ins, task, frame)
    task = replace(task, zones=zones)
    places = list[Place]()
    for number, target in enumerate(targets):
        places.append(target.place(frame, _field(number, target)))
        rules.refuse(rules.of_target(task, places[-1], _field(number, target)))
    said = (vehicle, model.end, model.fallback, model.battery, model.link, model.from_vehicle)
    as_written = {key: each for table in said for key, each in table.of(Mission).items()}
    if not model.scans_ground:
        as_written["scanner_component_id"] = None
    about_ground = ""
    if stated_m is not None:  # a person should be told once more before it is flown by
        about_ground = f"the ground is taken to be nowhere higher than {stated_m:g} m AMSL"
    mission = Mission(
        name=model.name,
        frame=frame,
        targets_ne_m=tuple(places),
        altitudes_amsl_m=_carried_on([each.altitude_amsl_m for each in targets]),
        task=task,
        scanner_complete=model.scanner.scanner_complete,
        near=near,
        known=_known_map(model, task, frame),
        rally_ne_m=tuple(
            point.place(frame, f"rally_points[{index}]")
            for index, point in enumerate(model.rally_points)
        ),
        notes=tuple(filter(None, (*notes, slower, far, about_ground))),
        **as_written,
    )
    return replace(mission, notes=(*mission.notes, *_about_altitudes(mission, targets)))


def _field(number: int, target: TargetTable) -> str:
    """How a target is called in errors."""
    return f"targets[{number}]" + (f" ({target.name})" if target.name else "")


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


def _known_map(model: MissionTable, task: Task, frame: LocalFrame) -> KnownMap | None:
    """The terrain known in advance, on the lattice of the mission's map."""
    if model.terrain is None:
        return None
    blank = empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)
    told = model.terrain.known_map(frame, blank, may_be_scanned=model.vehicle.scanner)
    if task.settings.is_near:  # known is the ground, and nothing of what stands on it
        return replace(blank, guess_m=told.upper_m)
    if model.is_for_guidance:
        return replace(blank, guess_m=np.where(told.surveyed, told.upper_m, np.nan))
    return told


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
    for number, table in enumerate(targets):
        if table.altitude_amsl_m is not None and table.altitude_amsl_m >= top_m:
            rule = f"no path lies higher than {top_m:g} m, the ceiling less the vehicle's errors"
            remedy = "Lower it, or raise altitude.ceiling_amsl_m."
            field = f"targets[{number}].altitude_amsl_m"
            raise InputError(field, table.altitude_amsl_m, rule, remedy)
    may_scan = mission.near is not None or mission.scanner_component_id is not None
    if mission.known is None or may_scan:
        return
    altitudes = mission.altitudes_amsl_m or (None,) * len(targets)
    places = zip(mission.targets_ne_m, altitudes, targets, strict=False)
    for number, (place, wanted_m, table) in enumerate(places):
        least_m = lowest_m if wanted_m is None else max(wanted_m, lowest_m)
        flown_m = _clear_from_m(mission.known, mission.task, place, least_m)
        if flown_m is None:
            top_m = mission.task.limits.ceiling_amsl_m
            rule = f"the ground there is not known, or too high for the ceiling, {top_m:g} m AMSL"
            remedy = "Move it, or correct [terrain] or altitude.ceiling_amsl_m."
            raise InputError(_field(number, table), list(place), rule, remedy)
        if wanted_m is not None and flown_m - wanted_m > _MENTIONED_M:
            yield (
                f"{table.name or f'target {number + 1}'} is planned at {wanted_m:g} m AMSL and "
                f"flown at {flown_m:.0f} m: below that d_s and the vehicle's errors are not kept"
            )


def _clear_from_m(known: KnownMap, task: Task, place: Place, least_m: float) -> float | None:
    """The lowest altitude from this one on that is clear of the ground; None: none in the band."""
    top_m, required_m = task.band_amsl_m[1], task.required_clearance_m
    for up_m in np.arange(min(least_m, top_m), top_m, _STEP_M):
        if distance_to_terrain_m(known, np.array([*place, up_m]), required_m) >= required_m - 1e-6:
            return float(up_m)
    return None
