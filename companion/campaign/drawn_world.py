"""The worlds that missions are measured in: random ones, and the bundled environments.

Random worlds are drawn in the manner of environment-2 (dense) and environment-1 (sparse): 100 km x
100 km, from (0, 0) to the far corner, with that mission's limits and settings. World k is always
the same. Every one has a way through: at the floor of the band, clear of all terrain and outside
all radars, wide enough for a disc of `SPARE_M` beside the clearance; a flood fill that knows
nothing of planners proves it, and a world without one is drawn again. So is a world in which the
straight line to the target is free.
"""

import functools
import hashlib
import json
import math
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

from companion.campaign.truth import height_m, mountain
from companion.config import load_mission, load_world
from companion.planner.settings import Task
from companion.world.terrain import ArrayTerrain, Peak, PeakTerrain
from companion.world.threats import Radar

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SPARE_M = 750.0
"""Half the width of the way through, beside the required clearance."""
BAND_INSET = 1.1
"""How far inside the band plans keep, in tracking and navigation errors (`Task.band_amsl_m`)."""
_CELLS_PER_RANGE = 80
_Ring = tuple[float, float, float]
"""Least and greatest north and east, and half the side of the hollow square about the origin."""
_SQUARE: _Ring = (0.0, 100_000.0, 0.0)
_DENSITY_1_KM2 = 0.004
_MOST_EDGE_M = 620_000.0
_STREAMS = {"dense": 1, "sparse": 2, "growth": 3}


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
        """A hash of all that the optimum depends on."""
        task, limits, weights = self.task, self.task.limits, self.task.settings.weights
        facts = (
            *_terrain_facts(self.terrain),
            [(r.centre_nea_m, r.range_m) for r in task.radars],
            [repr(zone) for zone in task.zones],
            (limits.turn_radius_m, limits.climb_angle_rad, limits.dive_angle_rad),
            (self.floor_amsl_m, self.ceiling_amsl_m, limits.north_m, limits.east_m),
            (task.required_clearance_m, task.settings.scan_range_m),
            (weights.length, weights.height, weights.radar),
            (self.start_nea_m, self.targets_ne_m),
        )  # fmt: skip
        return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:16]


def _terrain_facts(terrain: PeakTerrain | ArrayTerrain) -> tuple[Any, ...]:
    if isinstance(terrain, ArrayTerrain):
        heights = hashlib.sha256(np.ascontiguousarray(terrain.heights_m).tobytes()).hexdigest()
        return heights, (terrain.spacing_m, terrain.south_m, terrain.west_m)
    rows = [
        (p.north_m, p.east_m, p.height_amsl_m, p.spread_north_m, p.spread_east_m)
        for p in terrain.peaks
    ]
    return rows, terrain.ground_amsl_m


@functools.cache
def bundled(name: str) -> DrawnWorld:
    """One of the environments that come with the package."""
    mission, world = load_mission(name), load_world(name)
    assert isinstance(world.terrain, PeakTerrain | ArrayTerrain)  # all of them are
    return DrawnWorld(
        name=name,
        terrain=world.terrain,
        task=mission.task,
        start_nea_m=(*world.start_ne_m, mission.task.take_off_amsl_m),
        targets_ne_m=mission.targets_ne_m,
    )


def dense(number: int, seed: int = 0) -> DrawnWorld:
    """12 to 28 mountains and 10 to 14 radars."""
    return _drawn("dense", number, seed, (12, 28), (10, 14), (6_000.0, 11_000.0))


def sparse(number: int, seed: int = 0) -> DrawnWorld:
    """4 to 8 mountains and 3 to 5 radars."""
    return _drawn("sparse", number, seed, (4, 8), (3, 5), (9_000.0, 15_000.0))


def by_name(name: str) -> DrawnWorld:
    """`dense-7`, `sparse-2`, or a bundled name."""
    kind, _, number = name.rpartition("-")
    if kind in ("dense", "sparse"):
        return dense(int(number)) if kind == "dense" else sparse(int(number))
    return bundled(name)


def spread_out(count: int, variant: int = 0) -> DrawnWorld:
    """Obstacles at equal density (0.004 per km2, 60 % mountains) on an area that grows.

    Worlds of one variant lie in each other: that of 100 holds that of 10 in its middle, so that
    what is in sight there is the same and only the world's size differs. Start and target are
    57 km apart about the middle; the task's map covers everything, or as much as a mission may
    have (2.5e7 cells).  No way through is promised.
    """
    base, half = bundled("environment-2"), 20_000.0
    room = [(-half, -half, 6_000.0), (half, half, 6_000.0)]
    peaks: list[Peak] = []
    radars: list[Radar] = []
    inner_m, size = 0.0, 10
    while len(peaks) + len(radars) < count:
        size = min(size, count)
        more = size - len(peaks) - len(radars)
        rng = np.random.default_rng((_STREAMS["growth"], variant, size))
        outer_m = 500.0 * math.sqrt(size / _DENSITY_1_KM2)
        ring = (-outer_m, outer_m, inner_m)
        mountains = round(0.6 * more)
        peaks += _peaks(rng, mountains, ring, room)
        radars += _radars(rng, more - mountains, (6_000.0, 11_000.0), ring, room)
        inner_m, size = outer_m, 10 * size
    edge_m = min(max(inner_m + 5_000.0, 60_000.0), _MOST_EDGE_M)
    limits = replace(base.task.limits, north_m=(-edge_m, edge_m), east_m=(-edge_m, edge_m))
    return DrawnWorld(
        name=f"growth-{count}",
        terrain=PeakTerrain(peaks=tuple(peaks), ground_amsl_m=0.0),
        task=replace(base.task, limits=limits, radars=tuple(radars)),
        start_nea_m=(-half, -half, base.start_nea_m[2]),
        targets_ne_m=((half, half),),
    )


@functools.cache
def _drawn(
    kind: str,
    number: int,
    seed: int,
    mountains: tuple[int, int],
    radars: tuple[int, int],
    range_m: tuple[float, float],
) -> DrawnWorld:
    rng = np.random.default_rng(
        (_STREAMS[kind], number, seed) if seed else (_STREAMS[kind], number)
    )
    base = bundled("environment-2")
    ends = [(*base.start_nea_m[:2], 6_000.0), (*base.targets_ne_m[0], 6_000.0)]
    while True:
        peaks = _peaks(rng, int(rng.integers(*mountains, endpoint=True)), _SQUARE, ends)
        threats = _radars(rng, int(rng.integers(*radars, endpoint=True)), range_m, _SQUARE, ends)
        world = replace(
            base,
            name=f"{kind}-{seed}-{number}" if seed else f"{kind}-{number}",
            terrain=PeakTerrain(peaks=peaks, ground_amsl_m=0.0),
            task=replace(base.task, radars=threats, zones=()),
        )
        if has_way_through(world, SPARE_M) and not is_straight_line_free(world):
            return world


def _peaks(
    rng: np.random.Generator, count: int, ring: _Ring, ends: list[tuple[float, float, float]]
) -> tuple[Peak, ...]:
    """Mountains of 3,600 to 6,000 m, none of which stands over a start or a target."""
    result: list[Peak] = []
    while len(result) < count:
        north, east = _somewhere(rng, ring)
        height = float(np.round(rng.uniform(3_600.0, 6_000.0), -1))
        spreads = [float(v) for v in np.round(rng.uniform(3_000.0, 5_500.0, 2), -1)]
        if all(math.hypot(north - n, east - e) >= far + max(spreads) for n, e, far in ends):
            result.append(mountain(north, east, height, (spreads[0], spreads[1])))
    return tuple(result)


def _radars(
    rng: np.random.Generator,
    count: int,
    range_m: tuple[float, float],
    ring: _Ring,
    ends: list[tuple[float, float, float]],
) -> tuple[Radar, ...]:
    """Radars on the plain, none of which sees a start or a target."""
    result: list[Radar] = []
    while len(result) < count:
        north, east = _somewhere(rng, ring)
        reach = float(np.round(rng.uniform(*range_m), -1))
        if all(math.hypot(north - n, east - e) >= reach + 0.5 * far for n, e, far in ends):
            name = f"radar {len(result) + 1}"
            result.append(Radar(name=name, centre_nea_m=(north, east, 0.0), range_m=reach))
    return tuple(result)


def _somewhere(rng: np.random.Generator, ring: _Ring) -> tuple[float, float]:
    while True:
        north, east = (float(v) for v in np.round(rng.uniform(*ring[:2], 2), -1))
        if max(abs(north), abs(east)) >= ring[2]:
            return north, east


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
    result = np.full((len(north), len(east)), -np.inf)
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            left2 = clearance_m**2 - max(math.hypot(i, j) * cell_m - aside_m, 0.0) ** 2
            if left2 >= 0.0:
                shifted = height[reach + i :, reach + j :][: len(north), : len(east)]
                np.maximum(result, shifted + math.sqrt(left2), out=result)
    return result


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


def has_way_through(world: DrawnWorld, spare_m: float) -> bool:
    """Whether a disc of radius spare_m can be moved from start to target at the floor."""
    free, cell = free_at_floor(world), _cell_m(world)
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
