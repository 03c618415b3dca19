"""A world to measure missions in, with its mission, and the proof that there is a way through it.

The proof is a flood fill that knows nothing of planners: at the floor of the band, clear of all
terrain and outside all radars and keep-outs.
"""

import functools
import hashlib
import math
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, final

import numpy as np
from scipy.ndimage import distance_transform_edt, grey_dilation, label

from companion.campaign.truth import height_m
from companion.config import load_mission, load_world
from companion.geodesy import BoolArray, FloatArray
from companion.path.limits import Limits
from companion.planner.settings import Task
from companion.world.terrain import ArrayTerrain, GridTerrain, PeakTerrain, Terrain

BAND_INSET = 1.1
"""How far inside the band plans keep, in tracking and navigation errors (`Task.band_amsl_m`)."""
_CELLS_PER_RANGE = 80
_SPARE = 0.0375  # of R: half the width of the way through, beside the clearance
_HALF_DEG_M, _MOST_CELLS = 55_597.0, 5_000
"""Of elevation files: half of what a degree is; of the lattice that they are judged on, a side."""


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
    def floor_amsl_m(self) -> float:
        """Lowest altitude to plan for in profile `flight`."""
        return self.task.limits.floor_amsl_m + BAND_INSET * self.task.error_m

    @property
    def ceiling_amsl_m(self) -> float:
        """Highest altitude to plan for in profile `flight`."""
        return self.task.limits.ceiling_amsl_m - BAND_INSET * self.task.error_m

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

    Heights of a file, in degrees, are taken anew in metres, twice as close.
    """
    if isinstance(terrain, PeakTerrain) and terrain.sum_of_peaks:
        raise ValueError("a world whose peaks are added up cannot be judged: combine the maximum")
    if not isinstance(terrain, GridTerrain):
        assert isinstance(terrain, PeakTerrain | ArrayTerrain)  # there are three kinds
        return terrain
    (south, north), (west, east) = limits.north_m, limits.east_m
    step_m = max(
        _HALF_DEG_M * terrain.step_north_deg, max(north - south, east - west) / _MOST_CELLS
    )
    rows, columns = np.arange(south, north + step_m, step_m), np.arange(west, east + step_m, step_m)
    heights_m = terrain.height_m(rows[:, None], columns[None, :])
    return ArrayTerrain(heights_m=heights_m, spacing_m=step_m, south_m=south, west_m=west)


def scaled(world: DrawnWorld, by: float) -> DrawnWorld:
    """The same world at another size: lengths and speeds times a factor.  J stays what it is."""
    return _scaled(world, by, "")


def _scaled(value: Any, by: float, name: str) -> Any:
    """A value with all that it holds; names say what a length or a speed is."""
    if is_dataclass(value) and not isinstance(value, type):
        parts = {each.name: getattr(value, each.name) for each in fields(value) if each.init}
        return replace(value, **{name: _scaled(part, by, name) for name, part in parts.items()})
    if isinstance(value, tuple):
        return tuple(_scaled(each, by, name) for each in value)
    is_length = isinstance(value, (float, np.ndarray)) and name.endswith(("_m", "_m_s", "_m_s2"))
    return value * by if is_length else value


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
    cell = _cell_m(world)
    north, east = (axis.reshape(shape) for axis, shape in
                   zip(axes_m(world, cell), ((-1, 1), (1, -1)), strict=True))  # fmt: skip
    clearance, aside = world.task.required_clearance_m, world.task.limits.loiter_radius_m
    need = lowest_safe_m(world, cell, clearance + 0.5 * cell, aside)
    free = need <= world.floor_amsl_m
    for radar in world.task.radars:
        n, e, altitude = radar.centre_nea_m
        squared = (north - n) ** 2 + (east - e) ** 2 + (world.floor_amsl_m - altitude) ** 2
        free &= squared > radar.range_m**2
    for zone in world.task.zones:
        free &= zone.distance_m(*np.broadcast_arrays(north, east)) > clearance + aside
    return free


def _cell_m(world: DrawnWorld) -> float:
    return world.task.settings.scan_range_m / _CELLS_PER_RANGE


def has_way_through(world: DrawnWorld) -> bool:
    """Whether a disc with some room can be moved from start to target at the floor."""
    free, cell = free_at_floor(world), _cell_m(world)
    spare_m = _SPARE * world.task.settings.scan_range_m
    wide = distance_transform_edt(np.pad(free, 1), sampling=cell)[1:-1, 1:-1] > spare_m
    pools, _ = label(wide, structure=np.ones((3, 3)))
    ends = [world.start_nea_m[:2], *world.targets_ne_m]
    corner = (world.task.limits.north_m[0], world.task.limits.east_m[0])
    found = {
        int(pools[tuple(round((p - c) / cell) for p, c in zip(end, corner, strict=True))])
        for end in ends
    }
    return len(found) == 1 and found != {0}


def is_straight_line_free(world: DrawnWorld) -> bool:
    """Whether the line from start to target is free at the floor."""
    corner = (world.task.limits.north_m[0], world.task.limits.east_m[0])
    line = np.linspace(world.start_nea_m[:2], world.targets_ne_m[0], 2_000)
    rows, columns = np.round((line - corner) / _cell_m(world)).astype(np.intp).T
    return bool(free_at_floor(world)[rows, columns].all())
