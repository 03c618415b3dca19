"""World and mission files: read, checked, and turned into values that need no checks any more.

The tables are in `schema`; here are the rules that hold between fields.
"""

import math
import tomllib
from collections.abc import Callable
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np

from companion.elevation import read_terrain
from companion.errors import InputError
from companion.geodesy import LocalFrame
from companion.mission.mission import EndAction, Mission
from companion.objective.scene import PROFILES, Weights
from companion.path.limits import Limits
from companion.planner.settings import PlannerSettings, Task
from companion.schema import FileWorldTable, KeepOutTable, MissionTable, WorldTable, validated
from companion.world.terrain import Peak, PeakTerrain, Terrain
from companion.world.threats import CircleKeepOut, KeepOut, PolygonKeepOut, Radar

_MOST_CELLS = 2.5e7
_MOST_LATERAL_M_S2 = 20.0


@final
class World(NamedTuple):
    """A world as `companion plan` needs it."""

    name: str
    terrain: Terrain
    start_ne_m: tuple[float, float]
    origin_deg: tuple[float, float]
    """Latitude and longitude."""


def bundled() -> list[str]:
    """The names of the worlds and missions that come with the package."""
    folder = resources.files("companion") / "environments"
    return sorted(entry.name for entry in folder.iterdir() if (entry / "mission.toml").is_file())


def mission_text(name_or_path: str) -> str:
    """The mission file as it stands."""
    return _read(name_or_path, "mission")


def load_mission(name_or_path: str, profile: str | None = None) -> Mission:
    """A bundled mission or a file; profile overrides the file's."""
    table = _parse(mission_text(name_or_path), name_or_path)
    if "terrain" in table and "targets" not in table:
        raise InputError(
            "MISSION", name_or_path, "this is a world, not a mission", "Give its mission.toml."
        )
    model = validated(MissionTable, table, name_or_path)
    mission = _mission(model, profile, name_or_path)
    _check_mission(mission, name_or_path)
    return mission


def load_world(name_or_path: str) -> World:
    """A bundled world or a file."""
    table = _parse(_read(name_or_path, "world"), name_or_path)
    if "targets" in table and "terrain" not in table:
        raise InputError(
            "WORLD", name_or_path, "this is a mission, not a world", "Give its world.toml."
        )
    of_file = isinstance(table.get("terrain"), dict) and "file" in table["terrain"]
    model = validated(FileWorldTable if of_file else WorldTable, table, name_or_path)
    return World(
        name=model.name,
        terrain=_terrain(model, name_or_path),
        start_ne_m=(model.vehicle.north_m, model.vehicle.east_m),
        origin_deg=(model.origin.latitude_deg, model.origin.longitude_deg),
    )


def _terrain(model: WorldTable | FileWorldTable, name_or_path: str) -> Terrain:
    if not isinstance(model, FileWorldTable):
        return PeakTerrain(
            peaks=tuple(Peak(**dict(peak)) for peak in model.terrain.peaks),
            ground_amsl_m=model.terrain.ground_amsl_m,
            sum_of_peaks=model.terrain.combine == "sum",
        )
    origin, area = model.origin, model.area
    _check_area(area.north_min_m, area.north_max_m, "north", name_or_path)
    _check_area(area.east_min_m, area.east_max_m, "east", name_or_path)
    return read_terrain(
        _folder(name_or_path) / model.terrain.file,
        LocalFrame(latitude_deg=origin.latitude_deg, longitude_deg=origin.longitude_deg),
        ((area.north_min_m, area.north_max_m), (area.east_min_m, area.east_max_m)),
        vertical_datum=model.terrain.vertical_datum,
        nodata=model.terrain.nodata,
        field=f"{name_or_path}: terrain.file",
    )


def _check_area(low_m: float, high_m: float, axis: str, where: str) -> None:
    if low_m >= high_m:
        rule = f"it must be more than area.{axis}_min_m = {low_m:g}"
        raise InputError(f"{where}: area.{axis}_max_m", high_m, rule, "Swap or widen them.")


# --- files


def _folder(name_or_path: str) -> Path:
    """Where a world's other files are."""
    if name_or_path in bundled():
        return Path(str(resources.files("companion"))) / "environments" / name_or_path
    return Path(name_or_path).parent


def _read(name_or_path: str, kind: str) -> str:
    if name_or_path in bundled():
        file = resources.files("companion") / "environments" / name_or_path / f"{kind}.toml"
        return file.read_text(encoding="utf-8")
    path = Path(name_or_path)
    names = ", ".join(bundled())
    if not _is(path.is_file):
        rule = "it is a folder" if _is(path.is_dir) else "no such file, and no bundled name"
        remedy = f"Give a {kind}.toml, or one of: {names}."
        raise InputError(kind.upper(), name_or_path, rule, remedy)
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        remedy = f"Give a readable {kind}.toml, or one of: {names}."
        raise InputError(
            kind.upper(), name_or_path, f"it cannot be read ({error})", remedy
        ) from error


def _is(question: Callable[[], bool]) -> bool:
    """The answer, no for a name that the file system does not take."""
    try:
        return question()
    except (OSError, ValueError):
        return False


def _parse(text: str, where: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        rule = f"not TOML: {error}"
        raise InputError("file", where, rule, "Mend that place; see docs/files.md.") from error


# --- what the tables mean


def _mission(model: MissionTable, profile: str | None, where: str) -> Mission:
    vehicle, planner, area, band = model.vehicle, model.planner, model.area, model.altitude
    limits = Limits(
        speed_m_s=vehicle.speed_m_s,
        acceleration_m_s2=vehicle.acceleration_m_s2,
        climb_rate_m_s=vehicle.climb_rate_m_s,
        turn_radius_m=vehicle.turn_radius_m,
        climb_angle_rad=math.radians(vehicle.climb_angle_deg),
        dive_angle_rad=math.radians(vehicle.dive_angle_deg),
        floor_amsl_m=band.floor_amsl_m,
        ceiling_amsl_m=band.ceiling_amsl_m,
        north_m=(area.north_min_m, area.north_max_m),
        east_m=(area.east_min_m, area.east_max_m),
        tracking_error_m=vehicle.tracking_error_m,
        navigation_error_m=vehicle.navigation_error_m,
        dead_man_s=vehicle.dead_man_s,
    )
    settings = PlannerSettings(
        scan_range_m=planner.scan_range_m,
        safety_distance_m=planner.safety_distance_m,
        planning_time_s=planner.planning_time_s,
        scan_time_s=planner.scan_time_s,
        scan_distance_m=planner.scan_distance_m,
        position_period_s=1.0 / vehicle.position_rate_hz,
        overlap_m=0.1 * planner.scan_range_m if planner.overlap_m is None else planner.overlap_m,
        evaluations=planner.evaluations,
        profile=PROFILES[profile or planner.profile],
        optimiser=planner.optimiser,
        weights=replace(Weights(), **dict(planner.weights)),
    )
    radars = tuple(
        Radar(
            name=radar.name,
            centre_nea_m=(radar.north_m, radar.east_m, radar.altitude_amsl_m),
            range_m=radar.range_m,
        )
        for radar in model.radars
    )
    keep_outs = tuple(
        _keep_out(zone, f"{where}: keep_outs[{index}]")
        for index, zone in enumerate(model.keep_outs)
    )
    return Mission(
        name=model.name,
        frame=LocalFrame(
            latitude_deg=model.origin.latitude_deg, longitude_deg=model.origin.longitude_deg
        ),
        targets_ne_m=tuple((target.north_m, target.east_m) for target in model.targets),
        task=Task(limits=limits, settings=settings, radars=radars, keep_outs=keep_outs),
        end_action=EndAction(model.end.action),
        system_id=vehicle.system_id,
        scanner_component_id=vehicle.scanner_component_id,
        position_rate_hz=vehicle.position_rate_hz,
    )


def _keep_out(zone: KeepOutTable, field: str) -> KeepOut:
    if zone.vertices_m is not None and zone.radius_m is None:
        if len(zone.vertices_m) >= 3:
            vertices = tuple((north, east) for north, east in zone.vertices_m)
            return PolygonKeepOut(name=zone.name, vertices_ne_m=vertices)
    elif zone.vertices_m is None and None not in (zone.north_m, zone.east_m, zone.radius_m):
        assert zone.north_m is not None
        assert zone.east_m is not None
        assert zone.radius_m is not None
        return CircleKeepOut(
            name=zone.name, north_m=zone.north_m, east_m=zone.east_m, radius_m=zone.radius_m
        )
    raise InputError(
        field,
        zone.name,
        "a keep-out is a circle or a polygon",
        "Give north_m, east_m and radius_m, or vertices_m with three or more [north, east].",
    )


def _check_mission(mission: Mission, where: str) -> None:
    """The rules that hold between fields."""
    limits = mission.task.limits
    _check_area(*limits.north_m, "north", where)
    _check_area(*limits.east_m, "east", where)
    floor, ceiling = limits.floor_amsl_m, limits.ceiling_amsl_m
    if ceiling - floor <= 4.0 * mission.task.error_m:
        rule = (
            f"it must lie above altitude.floor_amsl_m = {floor:g} by more than 4 times "
            "vehicle.tracking_error_m + navigation_error_m"
        )
        raise InputError(f"{where}: altitude.ceiling_amsl_m", ceiling, rule, "Widen the band.")
    cells = np.prod([high - low for low, high in (limits.north_m, limits.east_m)])
    if cells / mission.task.cell_m**2 > _MOST_CELLS:
        rule = f"the map has more than {_MOST_CELLS:.0e} cells of R / 80"
        remedy = "Raise it, or make [area] smaller."
        given = mission.task.settings.scan_range_m
        raise InputError(f"{where}: planner.scan_range_m", given, rule, remedy)
    _check_distances(mission.task, where)
    for index, target in enumerate(mission.targets_ne_m):
        _check_target(mission, f"{where}: targets[{index}]", target)


def _check_target(mission: Mission, field: str, target: tuple[float, float]) -> None:
    task, limits = mission.task, mission.task.limits
    for value, (low, high), axis in zip(
        target, (limits.north_m, limits.east_m), ("north", "east"), strict=True
    ):
        inset = task.search_clearance_m if task.settings.profile.verified else 0.0
        if not low + inset <= value <= high - inset:
            rule = f"it lies outside the map, {low:g} to {high:g} m"
            if low <= value <= high:
                rule = f"it lies nearer than {inset:g} m (d_s and errors) to the edge of the map"
            raise InputError(f"{field}.{axis}_m", value, rule, "Move it, or widen [area].")
    for zone in task.keep_outs:
        gap = float(zone.distance_m(*_as_arrays(target)))
        if gap < task.search_clearance_m:
            least = f"{task.search_clearance_m:g} m (d_s and the vehicle's errors)"
            inside = "inside" if gap < 0.0 else f"nearer than {least} to"
            rule = f"it lies {inside} keep-out {zone.name!r}"
            raise InputError(field, list(target), rule, "Move the target, or remove the zone.")


def _check_distances(task: Task, where: str) -> None:
    """Eq. 4 and what it needs: L >= V T + d_s, and room for L within sight."""
    settings, speed = task.settings, task.limits.speed_m_s
    least = task.shortest_scan_distance_m
    given = settings.scan_distance_m
    if given is not None and given < least:
        rule = f"eq. 4: L must be at least V (T + scan time) + tail = {least:g} m"
        remedy = "Leave scan_distance_m out, or lower planning_time_s or speed_m_s."
        raise InputError(f"{where}: planner.scan_distance_m", given, rule, remedy)
    room = 0.6 * task.end_radius_m
    if task.scan_distance_m > room:
        rule = (
            f"eq. 4: with V = {speed:g} m/s and d_s = {settings.safety_distance_m:g} m it needs "
            f"L = {task.scan_distance_m:g} m, too much for R = {settings.scan_range_m:g} m "
            f"(at most {room:g} m)"
        )
        remedy = "Lower planning_time_s, speed_m_s or safety_distance_m, or raise scan_range_m."
        raise InputError(
            f"{where}: planner.planning_time_s", settings.planning_time_s, rule, remedy
        )
    requests, period_s = 33, settings.position_period_s
    if settings.scan_time_s < requests * period_s:
        rule = f"a scan takes {requests} requests, one a position ({period_s:g} s)"
        remedy = f"Raise it to {requests * period_s:g}, or raise vehicle.position_rate_hz."
        raise InputError(f"{where}: planner.scan_time_s", settings.scan_time_s, rule, remedy)
    lateral = speed**2 / task.limits.turn_radius_m
    if lateral > _MOST_LATERAL_M_S2:
        rule = f"at V = {speed:g} m/s it asks for {lateral:.3g} m/s2 sideways, over 2 g"
        remedy = "Raise it, or lower vehicle.speed_m_s."
        raise InputError(f"{where}: vehicle.turn_radius_m", task.limits.turn_radius_m, rule, remedy)
    if task.limits.turn_radius_m > 0.5 * settings.scan_range_m:
        rule = f"a turn must fit into the scan range R = {settings.scan_range_m:g} m twice"
        remedy = "Lower it, or raise planner.scan_range_m."
        raise InputError(f"{where}: vehicle.turn_radius_m", task.limits.turn_radius_m, rule, remedy)


def _as_arrays(point: tuple[float, float]) -> Any:
    return np.asarray(point[0]), np.asarray(point[1])
