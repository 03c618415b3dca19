"""Drawn worlds as the files that both programs read: world.toml, mission.toml, terrain.tif."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from companion.campaign.drawn_world import DrawnWorld
from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import named
from companion.mission.mission import AutopilotName, EndAction, Mission
from companion.sources.elevation import write_elevation
from companion.sources.files import toml_text
from companion.sources.mission_schema import MissionVehicleTable, PlannerTable
from companion.world.radars import Radar
from companion.world.terrain import ArrayTerrain
from companion.world.zones import CircleZone, Zone

FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
"""Where drawn worlds lie: with the environments."""
_USUAL_SCAN_S = 3.3  # of a scan at 10 positions a second: each lets one request go out
_PER_NODE = 4  # cells of terrain.tif to a cell of the heights that it is made of, each way
_BEYOND_M = 1_000.0  # how much more of the ground is written than the map needs
_DEG_M = 111_320.0


def write(
    drawn: DrawnWorld,
    folder: Path,
    autopilot: AutopilotName = "ardupilot",
    vehicle: Mapping[str, Any] | None = None,
) -> tuple[Path, Path]:
    """Write world.toml, mission.toml and, of heights, terrain.tif -> (world, mission) paths.

    vehicle: overrides keys of the vehicle's table of mission.toml.
    What is read back is the same world; heights that lie on a lattice in metres differ by as much
    as they bend within a quarter of its cells, since elevation files are in degrees.
    """
    folder.mkdir(parents=True, exist_ok=True)
    world, mission = folder / "world.toml", folder / "mission.toml"
    of_file = {}
    if isinstance(drawn.terrain, ArrayTerrain):
        of_file = _write_heights(drawn, folder / "terrain.tif")
    table = mission_table(mission_of(drawn, autopilot), vehicle)
    mission.write_text(toml_text(table), encoding="utf-8")
    world.write_text(toml_text(_world_table(drawn, autopilot) | of_file), encoding="utf-8")
    return world, mission


def mission_of(drawn: DrawnWorld, autopilot: AutopilotName = "ardupilot") -> Mission:
    """The mission of a drawn world, for a vehicle of one of the autopilots."""
    often = drawn.task.settings.scan_time_s < _USUAL_SCAN_S
    return Mission(
        name=drawn.name,
        frame=FRAME,
        targets_ne_m=drawn.targets_ne_m,
        task=drawn.task,
        end_action=EndAction.HOLD,
        autopilot=autopilot,
        position_rate_hz=20.0 if often else 10.0,
    )


def mission_table(mission: Mission, vehicle: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """A mission as its file has it; `vehicle` overrides keys of the vehicle's table."""
    task = mission.task
    limits, settings, frame = task.limits, task.settings, mission.frame
    of_vehicle = _keys(MissionVehicleTable, mission, limits) | {
        "climb_angle_deg": math.degrees(limits.climb_angle_rad),
        "dive_angle_deg": math.degrees(limits.dive_angle_rad),
        "loiter_radius_m": limits.loiter_radius_m or None,
        **(vehicle or {}),
    }
    return {
        "schema": 1,
        "name": mission.name,
        "origin": {"latitude_deg": frame.latitude_deg, "longitude_deg": frame.longitude_deg},
        "area": _area(limits.north_m, limits.east_m),
        "altitude": {"floor_amsl_m": limits.floor_amsl_m, "ceiling_amsl_m": limits.ceiling_amsl_m},
        "targets": [{"north_m": n, "east_m": e} for n, e in mission.targets_ne_m],
        "vehicle": of_vehicle,
        "planner": _keys(PlannerTable, settings)
        | {"profile": settings.profile.name, "weights": asdict(settings.weights)},
        "end": {"action": mission.end_action.value},
        "radars": [_radar(radar) for radar in task.radars],
        "keep_outs": [_zone(zone) for zone in task.zones if not zone.keep_in],
        "keep_ins": [_zone(zone) for zone in task.zones if zone.keep_in],
    }


def _keys(table: type[BaseModel], *holders: Any) -> dict[str, Any]:
    """Of a table of mission.toml, what these have under the same name."""
    return {
        name: getattr(holder, name)
        for holder in holders
        for name, key in table.model_fields.items()
        if hasattr(holder, name) and key.alias is None
    }


def _area(north_m: tuple[float, float], east_m: tuple[float, float]) -> dict[str, float]:
    return {
        "north_min_m": north_m[0],
        "north_max_m": north_m[1],
        "east_min_m": east_m[0],
        "east_max_m": east_m[1],
    }


def _radar(radar: Radar) -> dict[str, Any]:
    north_m, east_m, altitude_amsl_m = radar.centre_nea_m
    place = {"north_m": north_m, "east_m": east_m, "altitude_amsl_m": altitude_amsl_m}
    return {"name": radar.name, **place, "range_m": radar.range_m}


def _zone(zone: Zone) -> dict[str, Any]:
    if isinstance(zone, CircleZone):
        place = {"north_m": zone.north_m, "east_m": zone.east_m, "radius_m": zone.radius_m}
        return {"name": zone.name, **place}
    return {"name": zone.name, "vertices_m": [list(corner) for corner in zone.vertices_ne_m]}


def _world_table(drawn: DrawnWorld, autopilot: AutopilotName) -> dict[str, Any]:
    """The truth, and a vehicle that can do what the mission asks of it."""
    task, terrain, kind = drawn.task, drawn.terrain, drawn.task.limits.kind
    strategy = named(autopilot, kind)
    start, target = np.array(drawn.start_nea_m[:2]), np.array(drawn.targets_ne_m[0])
    ahead = target - start if task.limits.hovers else start - target
    """A plane climbs out over ground on which nothing stands."""
    ground: dict[str, Any] = {}
    if not isinstance(terrain, ArrayTerrain):
        ground = {
            "combine": "sum" if terrain.sum_of_peaks else "maximum",
            "ground_amsl_m": terrain.ground_amsl_m,
            "peaks": [asdict(peak) for peak in terrain.peaks],
        }
    return {
        "schema": 1,
        "name": drawn.name,
        "origin": {"latitude_deg": FRAME.latitude_deg, "longitude_deg": FRAME.longitude_deg},
        "terrain": ground,
        "vehicle": {
            "kind": kind,
            "autopilot": "ideal" if (autopilot, kind) == ("ardupilot", "copter") else autopilot,
            "north_m": float(start[0]),
            "east_m": float(start[1]),
            "heading_deg": math.degrees(math.atan2(ahead[1], ahead[0])),
            **_abilities(drawn),
            "parameters": {
                **strategy.firmware.lasting_battery,
                **strategy.parameters_for(task.limits),
            },
        },
        "radars": [_radar(radar) for radar in task.radars],
        "scanner": {"component_id": 100, "range_m": task.settings.scan_range_m},
    }


def _abilities(drawn: DrawnWorld) -> dict[str, float]:
    """Of a copter: more than the mission asks for by about what the environments' have."""
    limits = drawn.task.limits
    if not limits.hovers:
        return {}
    return {
        "speed_max_m_s": 1.15 * limits.speed_m_s + 1.0,
        "acceleration_max_m_s2": 2.0 * limits.acceleration_m_s2,
        "speed_vertical_max_m_s": 1.5 * limits.climb_rate_m_s,
        "acceleration_vertical_max_m_s2": max(2.5, limits.acceleration_m_s2),
    }


def _write_heights(drawn: DrawnWorld, path: Path) -> dict[str, Any]:
    """The ground of the map as a GeoTIFF in degrees -> the tables of world.toml that name it."""
    terrain, limits = drawn.terrain, drawn.task.limits
    assert isinstance(terrain, ArrayTerrain)
    north_m, east_m = (
        np.array([low - _BEYOND_M, high + _BEYOND_M])
        for low, high in (limits.north_m, limits.east_m)
    )
    sides = np.linspace(0.0, 1.0, 65)
    outline = np.meshgrid(
        north_m[0] + sides * (north_m[1] - north_m[0]),
        east_m[0] + sides * (east_m[1] - east_m[0]),
        indexing="ij",
    )
    latitude, longitude = FRAME.to_geodetic_deg(*outline)
    step_n = terrain.spacing_m / _PER_NODE / _DEG_M
    step_e = step_n / math.cos(math.radians(FRAME.latitude_deg))
    rows = np.arange(latitude.max() + step_n, latitude.min() - step_n, -step_n)
    columns = np.arange(longitude.min() - step_e, longitude.max() + step_e, step_e)
    heights = terrain.height_m(*FRAME.to_local_m(*np.meshgrid(rows, columns, indexing="ij")))
    write_elevation(path, heights, (rows[0], columns[0]), (step_n, step_e))
    return {
        "terrain": {"file": path.name, "vertical_datum": "AMSL"},
        "area": _area(limits.north_m, limits.east_m),
    }
