"""Drawn worlds as the files that both programs read: world.toml and mission.toml."""

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
from companion.sources.files import toml_text
from companion.sources.mission_schema import MissionVehicleTable, PlannerTable
from companion.world.radars import Radar
from companion.world.terrain import PeakTerrain
from companion.world.zones import CircleZone, Zone

FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
"""Where drawn worlds lie: with the environments."""
_USUAL_SCAN_S = 3.3  # of a scan at 10 positions a second: each lets one request go out


def write(
    drawn: DrawnWorld,
    folder: Path,
    autopilot: AutopilotName = "ardupilot",
    vehicle: Mapping[str, Any] | None = None,
) -> tuple[Path, Path]:
    """Write world.toml and mission.toml -> their paths; what is read back is the same world.

    vehicle: overrides keys of the vehicle's table of mission.toml.
    """
    folder.mkdir(parents=True, exist_ok=True)
    world, mission = folder / "world.toml", folder / "mission.toml"
    table = mission_table(mission_of(drawn, autopilot), vehicle)
    mission.write_text(toml_text(table), encoding="utf-8")
    world.write_text(toml_text(_world_table(drawn, autopilot)), encoding="utf-8")
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
    assert isinstance(terrain, PeakTerrain)  # as all families draw it
    strategy = named(autopilot, kind)
    start, target = np.array(drawn.start_nea_m[:2]), np.array(drawn.targets_ne_m[0])
    ahead = target - start if task.limits.hovers else start - target
    """A plane climbs out over ground on which nothing stands."""
    return {
        "schema": 1,
        "name": drawn.name,
        "origin": {"latitude_deg": FRAME.latitude_deg, "longitude_deg": FRAME.longitude_deg},
        "terrain": {
            "combine": "maximum",
            "ground_amsl_m": terrain.ground_amsl_m,
            "peaks": [asdict(peak) for peak in terrain.peaks],
        },
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
