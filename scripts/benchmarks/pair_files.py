"""A scene as the two files that the programs read, mission.toml and world.toml, and flown so."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, final

from pair_processes import Seen, Tap, end, start_companion, start_vehicle
from pair_worlds import Scene
from pydantic import BaseModel

from companion.sources.files import toml_text
from companion.sources.mission_schema import MissionVehicleTable, PlannerTable
from companion.world.threats import CircleZone, Radar, Zone


def write(scene: Scene, folder: Path, **vehicle: Any) -> tuple[Path, Path]:
    """mission.toml and world.toml of a scene; `vehicle` overrides keys of the mission's table."""
    folder.mkdir(parents=True, exist_ok=True)
    mission, world = folder / "mission.toml", folder / "world.toml"
    mission.write_text(toml_text(_mission(scene, vehicle)), encoding="utf-8")
    world.write_text(toml_text(_world(scene)), encoding="utf-8")
    return mission, world


def _mission(scene: Scene, vehicle: Mapping[str, Any]) -> dict[str, Any]:
    mission, task = scene.mission, scene.mission.task
    limits, settings = task.limits, task.settings
    of_vehicle = _keys(MissionVehicleTable, mission, limits) | {
        "climb_angle_deg": math.degrees(limits.climb_angle_rad),
        "dive_angle_deg": math.degrees(limits.dive_angle_rad),
        "loiter_radius_m": limits.loiter_radius_m or None,
        **vehicle,
    }
    return {
        "schema": 1,
        "name": mission.name,
        "origin": asdict(scene.world.origin),
        "area": {
            "north_min_m": limits.north_m[0],
            "north_max_m": limits.north_m[1],
            "east_min_m": limits.east_m[0],
            "east_max_m": limits.east_m[1],
        },
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
        for name in table.model_fields
        if hasattr(holder, name)
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


def _world(scene: Scene) -> dict[str, Any]:
    """What is left out is None, or an empty list."""
    return _filled(asdict(scene.world) | {"schema": 1})


def _filled(table: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _filled(value) if isinstance(value, dict) else value
        for key, value in table.items()
        if value is not None and value not in ((), [], {})
    }


@final
class Tapped:
    """A mission flown by both programs with a tap between them; all end with the `with`."""

    def __init__(self, scene: Scene, folder: Path, seen: Seen, **vehicle: Any) -> None:
        self.mission, world = write(scene, folder, **vehicle)
        self.run, self.log = folder / "run", folder / "companion.log"
        self.tap = Tap(seen)
        self.vehicle = start_vehicle(world, self.tap.vehicle_port)
        self.start()

    def start(self, *options: str) -> None:
        """The companion, for the first time or once more."""
        self.companion = start_companion(
            self.mission, self.tap.companion_port, self.run, *options, log=self.log
        )

    def said(self) -> str:
        """The last of what the companion printed."""
        return self.log.read_text(encoding="utf-8")[-3000:]

    def __enter__(self) -> "Tapped":
        return self

    def __exit__(self, *_: object) -> None:
        end(self.companion)
        end(self.vehicle)
        self.tap.close()
