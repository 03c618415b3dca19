"""A world to measure missions in, with its mission: as files, and the proof of a way through it.

The proof is a flood fill that knows nothing of planners: at the floor of the band, clear of all
terrain and outside all radars and keep-outs.
"""

import functools
import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel
from scipy.ndimage import distance_transform_edt, grey_dilation, label

from companion.campaign.truth import height_m
from companion.config import load_mission, load_world
from companion.geodesy import BoolArray, FloatArray, LocalFrame
from companion.mavlink.autopilots import named
from companion.mission.mission import AutopilotName, EndAction
from companion.path.limits import Limits
from companion.planner.settings import Task
from companion.sources.files import RawTable, toml_text
from companion.sources.mission_file import PlannerTable, VehicleTable
from companion.sources.tables import OriginTable
from companion.sources.zones import ZoneTable
from companion.world.terrain import ArrayTerrain, GridTerrain, PeakTerrain, Terrain

FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
"""Where drawn worlds lie: with the environments."""
_USUAL_SCAN_S = 3.3  # of a scan at 10 positions a second: each lets one request go out

_CELLS_PER_RANGE = 80
_SPARE = 0.0375  # of R: half the width of the way through, beside the clearance
_MOST_CELLS = 5_000
"""A side of the lattice that elevation files are judged on."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnWorld:
    """A world and the mission in it."""

    name: str
    terrain: PeakTerrain | ArrayTerrain
    task: Task
    start_nea_m: tuple[float, float, float]
    targets_ne_m: tuple[tuple[float, float], ...]

    @property
    def fingerprint(self) -> str:
        """A hash of the world and of what is to be flown in it, whatever it is called."""
        heights, terrain = b"", self.terrain
        if isinstance(terrain, ArrayTerrain):  # whose own text leaves most of them out
            heights = np.ascontiguousarray(terrain.heights_m).tobytes()
        facts = repr((terrain, self.task, self.start_nea_m, self.targets_ne_m)).encode()
        return hashlib.sha256(facts + heights).hexdigest()[:16]


def of_files(world: str, mission: str) -> DrawnWorld:
    """World and mission of files or of bundled names, as the judge takes them."""
    place, read = load_world(world), load_mission(mission)
    return DrawnWorld(
        name=place.name,
        terrain=judgeable(place.terrain, read.task.limits),
        task=read.task,
        start_nea_m=(*place.start_ne_m, read.task.take_off_amsl_m),
        targets_ne_m=read.targets_ne_m,
    )


@functools.cache
def bundled(name: str) -> DrawnWorld:
    """One of the environments that come with the package."""
    return of_files(name, name)


def judgeable(terrain: Terrain, limits: Limits) -> Any:
    """The judge has its own mathematics: of peaks the highest, of heights the bilinear surface.

    Heights of a file are taken anew in metres of the local frame, twice as close.
    """
    if isinstance(terrain, PeakTerrain) and terrain.sum_of_peaks:
        raise ValueError("a world whose peaks are added up cannot be judged: combine the maximum")
    if not isinstance(terrain, GridTerrain):
        assert isinstance(terrain, PeakTerrain | ArrayTerrain)  # there are three kinds
        return terrain
    (south, north), (west, east) = limits.north_m, limits.east_m
    step_m = max(0.5 * terrain.cell_m, max(north - south, east - west) / _MOST_CELLS)
    rows, columns = np.arange(south, north + step_m, step_m), np.arange(west, east + step_m, step_m)
    heights_m = terrain.height_m(rows[:, None], columns[None, :])
    return ArrayTerrain(heights_m=heights_m, spacing_m=step_m, south_m=south, west_m=west)


# --- the proof that there is a way


def axes_m(world: DrawnWorld, cell_m: float) -> tuple[FloatArray, FloatArray]:
    """North and east of lattice points over the map, edges included where they fit."""
    limits = world.task.limits
    return (
        np.arange(limits.north_m[0], limits.north_m[1] + 1.0, cell_m),
        np.arange(limits.east_m[0], limits.east_m[1] + 1.0, cell_m),
    )


def lowest_safe_m(
    world: DrawnWorld, cell_m: float, clearance_m: float, aside_m: float = 0.0
) -> FloatArray:
    """Lowest altitude at lattice points that is clearance_m from the terrain, to metres.

    The terrain of a lattice, dilated by a disc of aside_m and a ball; too low by at most about
    cell^2 / (8 clearance), so a metre or two at cells of 100 m.  -> (rows, columns).
    """
    north, east = axes_m(world, cell_m)
    reach = math.ceil((clearance_m + aside_m) / cell_m)
    outer_n = north[0] + cell_m * np.arange(-reach, len(north) + reach)
    outer_e = east[0] + cell_m * np.arange(-reach, len(east) + reach)
    height = height_m(world.terrain, outer_n[:, None], outer_e[None, :])
    steps = cell_m * np.arange(-reach, reach + 1)
    away = np.maximum(np.hypot(steps[:, None], steps[None, :]) - aside_m, 0.0)
    ball = np.sqrt(np.maximum(clearance_m**2 - away**2, 0.0))
    grown = grey_dilation(height, footprint=away <= clearance_m, structure=ball)
    return np.asarray(grown[reach:-reach, reach:-reach])


@functools.lru_cache(maxsize=4)
def free_at_floor(world: DrawnWorld) -> BoolArray:
    """Lattice points that are clear of terrain, radars and keep-outs at the floor of the band."""
    cell, (floor_amsl_m, _) = _cell_m(world), world.task.band_amsl_m
    north, east = np.meshgrid(*axes_m(world, cell), indexing="ij")
    clearance, aside = world.task.required_clearance_m, world.task.limits.loiter_radius_m
    free = lowest_safe_m(world, cell, clearance + 0.5 * cell, aside) <= floor_amsl_m
    for radar in world.task.radars:
        n, e, altitude = radar.centre_nea_m
        squared = (north - n) ** 2 + (east - e) ** 2 + (floor_amsl_m - altitude) ** 2
        free &= squared > radar.range_m**2
    for zone in world.task.zones:
        free &= zone.distance_m(north, east) > clearance + aside
    return free


def _cell_m(world: DrawnWorld) -> float:
    return world.task.settings.scan_range_m / _CELLS_PER_RANGE


def _points_at(world: DrawnWorld, places_ne_m: ArrayLike) -> tuple[NDArray[np.intp], ...]:
    """Rows and columns of the lattice points next to places, (N, 2)."""
    corner = world.task.limits.north_m[0], world.task.limits.east_m[0]
    index = np.round((np.asarray(places_ne_m) - corner) / _cell_m(world)).astype(np.intp)
    return tuple(index.T)


def has_way_through(world: DrawnWorld) -> bool:
    """Whether a disc with some room can be moved from start to target at the floor."""
    free, cell = free_at_floor(world), _cell_m(world)
    spare_m = _SPARE * world.task.settings.scan_range_m
    wide = distance_transform_edt(np.pad(free, 1), sampling=cell)[1:-1, 1:-1] > spare_m
    pools, _ = label(wide, structure=np.ones((3, 3)))
    first, *others = pools[_points_at(world, [world.start_nea_m[:2], *world.targets_ne_m])]
    return first > 0 and all(other == first for other in others)


def is_straight_line_free(world: DrawnWorld) -> bool:
    """Whether the line from start to target is free at the floor."""
    line = np.linspace(world.start_nea_m[:2], world.targets_ne_m[0], 2_000)
    return bool(free_at_floor(world)[_points_at(world, line)].all())


# --- as the files that both programs read: world.toml and mission.toml


def write(
    drawn: DrawnWorld,
    folder: Path,
    autopilot: AutopilotName = "ardupilot",
    vehicle: Mapping[str, Any] | None = None,
) -> tuple[Path, Path]:
    """Write world.toml and mission.toml -> their paths; what is read back is the same world.

    Of a drawn one: of peaks, with circles to stay out of.  vehicle: overrides keys of the vehicle's
    table of mission.toml.
    """
    folder.mkdir(parents=True, exist_ok=True)
    world, mission = tables_of(drawn, autopilot)
    mission["vehicle"] |= vehicle or {}
    paths = folder / "world.toml", folder / "mission.toml"
    for path, table in zip(paths, (world, mission), strict=True):
        path.write_text(toml_text(table), encoding="utf-8")
    return paths


def tables_of(drawn: DrawnWorld, autopilot: AutopilotName) -> tuple[RawTable, RawTable]:
    """World and mission as their files have them."""
    head = {"schema": 1, "name": drawn.name, "origin": _keys(OriginTable, FRAME)}
    axes = ("north_m", "east_m", "altitude_amsl_m")
    radars = [
        {"name": radar.name, **dict(zip(axes, radar.centre_nea_m, strict=True)),
         "range_m": radar.range_m}
        for radar in drawn.task.radars
    ]  # fmt: skip
    world, mission = _world_table(drawn, autopilot), _mission_table(drawn, autopilot)
    return head | world | {"radars": radars}, head | mission | {"radars": radars}


def _keys(table: type[BaseModel], of: Any) -> RawTable:
    """Of a table of a file, what a value has under the same name."""
    names = (name for name, key in table.model_fields.items() if key.alias is None)
    return {name: getattr(of, name) for name in names if hasattr(of, name)}


def _mission_table(drawn: DrawnWorld, autopilot: AutopilotName) -> RawTable:
    limits, settings = drawn.task.limits, drawn.task.settings
    (south, north), (west, east) = limits.north_m, limits.east_m
    return {
        "area": {
            "north_min_m": south, "north_max_m": north, "east_min_m": west, "east_max_m": east,
        },
        "altitude": {"floor_amsl_m": limits.floor_amsl_m, "ceiling_amsl_m": limits.ceiling_amsl_m},
        "targets": [{"north_m": n, "east_m": e} for n, e in drawn.targets_ne_m],
        "vehicle": {
            "autopilot": autopilot,
            "position_rate_hz": 20.0 if settings.scan_time_s < _USUAL_SCAN_S else 10.0,
            **_keys(VehicleTable, limits),
            "climb_angle_deg": math.degrees(limits.climb_angle_rad),
            "dive_angle_deg": math.degrees(limits.dive_angle_rad),
            "loiter_radius_m": limits.loiter_radius_m or None,
        },
        "planner": _keys(PlannerTable, settings)
        | {"profile": settings.profile.name, "weights": asdict(settings.weights)},
        "end": {"action": EndAction.HOLD.value},
        "keep_outs": [_keys(ZoneTable, zone) for zone in drawn.task.zones],
        "keep_ins": [],
    }  # fmt: skip


def _world_table(drawn: DrawnWorld, autopilot: AutopilotName) -> RawTable:
    """The truth, and a vehicle that can do what the mission asks of it."""
    terrain, limits = drawn.terrain, drawn.task.limits
    assert isinstance(terrain, PeakTerrain)  # as all families draw it
    strategy = named(autopilot, limits.kind)
    (north_m, east_m, _), (to_north_m, to_east_m) = drawn.start_nea_m, drawn.targets_ne_m[0]
    ahead = 1.0 if limits.hovers else -1.0  # a plane climbs out where nothing stands: away from it
    heading_rad = math.atan2(ahead * (to_east_m - east_m), ahead * (to_north_m - north_m))
    vehicle = {
        "kind": limits.kind,
        "autopilot": "ideal" if (autopilot, limits.kind) == ("ardupilot", "copter") else autopilot,
        "north_m": north_m,
        "east_m": east_m,
        "heading_deg": math.degrees(heading_rad),
        "parameters": {**strategy.firmware.lasting_battery, **strategy.parameters_for(limits)},
    }
    if limits.hovers:  # it can do more than is asked for, by about what the environments' can
        vehicle |= {
            "speed_max_m_s": 1.15 * limits.speed_m_s + 1.0,
            "acceleration_max_m_s2": 2.0 * limits.acceleration_m_s2,
            "speed_vertical_max_m_s": 1.5 * limits.climb_rate_m_s,
            "acceleration_vertical_max_m_s2": max(2.5, limits.acceleration_m_s2),
        }
    return {
        "terrain": {
            "combine": "maximum",
            "ground_amsl_m": terrain.ground_amsl_m,
            "peaks": [asdict(peak) for peak in terrain.peaks],
        },
        "vehicle": vehicle,
        "scanner": {"component_id": 100, "range_m": drawn.task.settings.scan_range_m},
    }
