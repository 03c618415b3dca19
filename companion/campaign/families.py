"""Families of random worlds to measure missions in, each world from (family, seed, index) alone.

The default seed draws the worlds of docs/results/benchmarks.md; another seed draws fresh ones.
Every world has a way through at the floor of the band, outside all radars and keep-outs, which a
flood fill that shares no code with the planner proves, and its straight line is barred; a world
without is drawn again.
"""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from companion.campaign import drawn_world
from companion.campaign.drawn_world import DrawnWorld
from companion.geodesy import FloatArray
from companion.path.limits import Limits
from companion.planner.settings import PlannerSettings, Task
from companion.world.known_map import KnownMap, empty_map
from companion.world.radars import Radar
from companion.world.terrain import Peak, PeakTerrain
from companion.world.zones import CircleZone

SPREAD = "spread"
"""A family whose index is how many obstacles there are, always as densely."""
_SPARE = 0.0375  # of R: half the width of the way through, beside the clearance
_MOST_DRAWS = 2_000
_DENSITY_1_KM2 = 0.004
_SPREAD_STREAM = 3
_MOST_EDGE_M = 620_000.0
_Ring = tuple[float, float, float]
"""Least and greatest north and east, and half the side of the hollow square about the origin."""
_SQUARE: _Ring = (0.0, 100_000.0, 0.0)


@functools.cache
def world(family: str, seed: int, index: int) -> DrawnWorld:
    """One world, always the same for the same three."""
    if family == SPREAD:
        return _spread_out(index, seed)
    stream, draw = _FAMILIES[family]
    key: tuple[int, ...] = (stream, seed, index)
    name = f"{family}-{seed}-{index}"
    if family in ("dense", "sparse"):  # as they were drawn before there were seeds
        key = (stream, index, seed)
        if seed == 0:
            key, name = key[:2], f"{family}-{index}"
    rng = np.random.default_rng(key)
    for _ in range(_MOST_DRAWS):
        drawn = draw(rng, name)
        if has_way(drawn) and not drawn_world.is_straight_line_free(drawn):
            return drawn
    raise AssertionError(f"{family}: no world {index} of seed {seed} in {_MOST_DRAWS} draws")


def has_way(drawn: DrawnWorld) -> bool:
    """Whether there is a way through with some room."""
    return drawn_world.has_way_through(drawn, _SPARE * drawn.task.settings.scan_range_m)


def unseen(world: DrawnWorld) -> KnownMap:
    """The map of a world of which nothing is known."""
    limits = world.task.limits
    return empty_map(world.task.cell_m, limits.north_m, limits.east_m)


# --- 100 km x 100 km, the mission of environment-2


def _dense(rng: np.random.Generator, name: str) -> DrawnWorld:
    """12 to 28 mountains and 10 to 14 radars, in the manner of environment-2."""
    return _anywhere(rng, name, (12, 28), (10, 14), (6_000.0, 11_000.0))


def _sparse(rng: np.random.Generator, name: str) -> DrawnWorld:
    """4 to 8 mountains and 3 to 5 radars, in the manner of environment-1."""
    return _anywhere(rng, name, (4, 8), (3, 5), (9_000.0, 15_000.0))


def _anywhere(
    rng: np.random.Generator,
    name: str,
    mountains: tuple[int, int],
    radars: tuple[int, int],
    range_m: tuple[float, float],
) -> DrawnWorld:
    base = drawn_world.bundled("environment-2")
    ends = [(*base.start_nea_m[:2], 6_000.0), (*base.targets_ne_m[0], 6_000.0)]
    peaks = _peaks_in(_SQUARE, rng, int(rng.integers(*mountains, endpoint=True)), ends)
    count = int(rng.integers(*radars, endpoint=True))
    return _with_obstacles(base, name, peaks, _radars_in(_SQUARE, rng, count, range_m, ends))


def _spread_out(count: int, variant: int) -> DrawnWorld:
    """Obstacles at equal density (0.004 per km2, 60 % mountains) on an area that grows.

    Worlds of one variant lie in each other: that of 100 holds that of 10 in its middle, so that
    what is in sight there is the same and only the world's size differs. Start and target are
    57 km apart about the middle; the task's map covers everything, or as much as a mission may
    have (2.5e7 cells).  No way through is promised.
    """
    base, half = drawn_world.bundled("environment-2"), 20_000.0
    room = [(-half, -half, 6_000.0), (half, half, 6_000.0)]
    peaks: list[Peak] = []
    radars: list[Radar] = []
    inner_m, size = 0.0, 10
    while len(peaks) + len(radars) < count:
        size = min(size, count)
        more = size - len(peaks) - len(radars)
        rng = np.random.default_rng((_SPREAD_STREAM, variant, size))
        outer_m = 500.0 * math.sqrt(size / _DENSITY_1_KM2)
        ring = (-outer_m, outer_m, inner_m)
        mountains = round(0.6 * more)
        peaks += _peaks_in(ring, rng, mountains, room)
        radars += _radars_in(ring, rng, more - mountains, (6_000.0, 11_000.0), room)
        inner_m, size = outer_m, 10 * size
    edge_m = min(max(inner_m + 5_000.0, 60_000.0), _MOST_EDGE_M)
    limits = replace(base.task.limits, north_m=(-edge_m, edge_m), east_m=(-edge_m, edge_m))
    return replace(
        _with_obstacles(base, f"growth-{count}", peaks, radars, limits),
        start_nea_m=(-half, -half, base.start_nea_m[2]),
        targets_ne_m=((half, half),),
    )


def _peaks_in(
    ring: _Ring, rng: np.random.Generator, count: int, ends: list[tuple[float, float, float]]
) -> list[Peak]:
    """Mountains of 3,600 to 6,000 m, none of which stands over a start or a target."""
    result: list[Peak] = []
    while len(result) < count:
        north, east = _somewhere(rng, ring)
        height = float(np.round(rng.uniform(3_600.0, 6_000.0), -1))
        spreads = [float(v) for v in np.round(rng.uniform(3_000.0, 5_500.0, 2), -1)]
        if all(math.hypot(north - n, east - e) >= far + max(spreads) for n, e, far in ends):
            result.append(mountain(north, east, height, (spreads[0], spreads[1])))
    return result


def _radars_in(
    ring: _Ring,
    rng: np.random.Generator,
    count: int,
    range_m: tuple[float, float],
    ends: list[tuple[float, float, float]],
) -> list[Radar]:
    """Radars on the plain, none of which sees a start or a target."""
    result: list[Radar] = []
    while len(result) < count:
        north, east = _somewhere(rng, ring)
        reach = float(np.round(rng.uniform(*range_m), -1))
        if all(math.hypot(north - n, east - e) >= reach + 0.5 * far for n, e, far in ends):
            name = f"radar {len(result) + 1}"
            result.append(Radar(name=name, centre_nea_m=(north, east, 0.0), range_m=reach))
    return result


def _somewhere(rng: np.random.Generator, ring: _Ring) -> tuple[float, float]:
    while True:
        north, east = (float(v) for v in np.round(rng.uniform(*ring[:2], 2), -1))
        if max(abs(north), abs(east)) >= ring[2]:
            return north, east


def _gathered(rng: np.random.Generator, name: str) -> DrawnWorld:
    """12 mountains and 10 radars gathered about the straight line, where the mission must pass."""
    base = drawn_world.bundled("environment-2")
    peaks: list[Peak] = []
    while len(peaks) < 12:
        north, east = _beside_the_line(rng, base, 18_000.0)
        height = float(rng.uniform(3_400.0, 6_000.0))
        spreads = rng.uniform(4_000.0, 8_000.0, 2).tolist()
        if _leaves_ends(base, (north, east), max(spreads) * math.sqrt(math.log(height / 2_400.0))):
            peaks.append(mountain(north, east, height, (spreads[0], spreads[1])))
    radars = _radars(rng, base, 10, (6_000.0, 11_000.0), 20_000.0)
    return _with_obstacles(base, name, peaks, radars)


def _walls(rng: np.random.Generator, name: str) -> DrawnWorld:
    """Ridges across the way, each with a gap and a saddle, and pockets that open to the start."""
    base = drawn_world.bundled("environment-2")
    peaks: list[Peak] = []
    for middle in (37_000.0, 74_000.0, 108_000.0):
        if rng.uniform() < 0.8:
            slant = rng.uniform(-0.45, 0.45)
            gap, saddle = rng.uniform(-45_000.0, 45_000.0, 2)
            along = np.arange(-75_000.0, 75_000.0, 2_000.0)
            along = along[np.abs(along - gap) > rng.uniform(5_200.0, 8_000.0)]
            low = np.abs(along - saddle) < 5_000.0
            top = np.where(low, rng.uniform(3_300.0, 4_300.0), rng.uniform(5_400.0, 6_400.0))
            line = np.stack([middle + slant * along, along], axis=-1)
            peaks += _ridge(base, line, top * rng.uniform(0.98, 1.02, len(top)))
    for _ in range(rng.integers(1, 3)):
        end, side = rng.uniform(30_000.0, 115_000.0), rng.uniform(-10_000.0, 10_000.0)
        half, deep = rng.uniform(7_000.0, 14_000.0), rng.uniform(8_000.0, 18_000.0)
        across = np.arange(-half, half + 1.0, 2_000.0)
        back = np.arange(0.0, deep, 2_000.0)
        line = np.concatenate([
            np.stack([np.full_like(across, end), side + across], axis=-1),
            *(np.stack([end - back, np.full_like(back, side + s * half)], -1) for s in (-1, 1)),
        ])  # fmt: skip
        peaks += _ridge(base, line, np.full(len(line), rng.uniform(5_400.0, 6_400.0)))
    radars = _radars(rng, base, 3, (5_000.0, 9_000.0), 35_000.0)
    return _with_obstacles(base, name, peaks, radars)


def _ridge(base: DrawnWorld, line_m: FloatArray, top_m: FloatArray) -> list[Peak]:
    """Mountains in a row: (N, 2) metres along the straight line and aside of it."""
    found = []
    for (along, aside), top in zip(line_m.tolist(), top_m.tolist(), strict=True):
        north, east = _at(base, along, aside)
        if _leaves_ends(base, (north, east), 6_000.0):
            found.append(mountain(north, east, top, (3_000.0, 3_000.0)))
    return found


# --- small vehicles


def _copter(rng: np.random.Generator, name: str) -> DrawnWorld:
    """Hills, towers and keep-outs for a copter of 8 to 12 m/s that sees 300 to 1,500 m."""
    range_m = float(rng.uniform(300.0, 1_500.0))
    limits = _limits(
        speed_m_s=float(rng.uniform(8.0, 12.0)), turn_radius_m=float(rng.uniform(20.0, 40.0)),
        climb_deg=12.0, acceleration_m_s2=2.5, climb_rate_m_s=2.0, tracking_error_m=1.5,
        navigation_error_m=2.0,
    )  # fmt: skip
    away_m = min(float(rng.uniform(4_000.0, 10_000.0)), 14.0 * range_m)
    return _small(rng, name, limits, range_m, away_m, band_m=(40.0, 110.0),
                  tops_m=(50.0, 190.0), towers=(12.0, 25.0), safety_m=float(rng.uniform(5.0, 10.0)),
                  times_s=(1.0, 2.0))  # fmt: skip


def _plane(rng: np.random.Generator, name: str) -> DrawnWorld:
    """Hills, masts and keep-outs for a plane of 22 m/s that sees 3 to 5 km."""
    range_m = float(rng.uniform(3_000.0, 5_000.0))
    limits = _limits(
        speed_m_s=22.0, turn_radius_m=float(rng.uniform(110.0, 150.0)), climb_deg=7.0,
        climb_rate_m_s=2.5, dive_angle_rad=math.radians(5.0), loiter_radius_m=100.0,
    )  # fmt: skip
    return _small(rng, name, limits, range_m, float(rng.uniform(15_000.0, 30_000.0)),
                  band_m=(120.0, 350.0), tops_m=(150.0, 700.0), towers=(60.0, 120.0),
                  safety_m=float(rng.uniform(30.0, 50.0)), times_s=(3.0, 4.0))  # fmt: skip


def _short_copter(rng: np.random.Generator, name: str) -> DrawnWorld:
    """A flight of one to two minutes for a copter of 8 m/s that sees 280 m."""
    limits = _limits(
        speed_m_s=8.0, turn_radius_m=25.0, climb_deg=12.0, acceleration_m_s2=2.0,
        climb_rate_m_s=1.5, dive_angle_rad=math.radians(10.0), tracking_error_m=4.0,
        navigation_error_m=3.0,
    )  # fmt: skip
    drawn = _small(rng, name, limits, 280.0, 560.0, band_m=(16.0, 75.0), tops_m=(30.0, 120.0),
                   towers=(5.0, 15.0), safety_m=12.0, times_s=(1.0, 4.0))  # fmt: skip
    return _of_the_map(drawn)


def _short_plane(rng: np.random.Generator, name: str) -> DrawnWorld:
    """A flight of two to three minutes for a plane of 15 m/s that sees 1,400 m."""
    limits = _limits(
        speed_m_s=15.0, turn_radius_m=100.0, climb_deg=6.0, acceleration_m_s2=2.0,
        climb_rate_m_s=3.0, tracking_error_m=15.0, navigation_error_m=4.0, loiter_radius_m=100.0,
    )  # fmt: skip
    drawn = _small(rng, name, limits, 1_400.0, 2_400.0, band_m=(70.0, 190.0),
                   tops_m=(100.0, 260.0), towers=(30.0, 60.0), safety_m=30.0,
                   times_s=(1.0, 4.0))  # fmt: skip
    return _of_the_map(drawn)


def _limits(*, speed_m_s: float, turn_radius_m: float, climb_deg: float, **others: Any) -> Limits:
    """Of a vehicle in a map and a band that are still to be drawn."""
    angle_rad = math.radians(climb_deg)
    return replace(
        Limits(
            speed_m_s=speed_m_s, turn_radius_m=turn_radius_m, acceleration_m_s2=3.0,
            climb_rate_m_s=speed_m_s * math.sin(angle_rad), climb_angle_rad=angle_rad,
            dive_angle_rad=angle_rad, floor_amsl_m=0.0, ceiling_amsl_m=1.0, north_m=(0.0, 1.0),
            east_m=(0.0, 1.0),
        ), **others,
    )  # fmt: skip


def _of_the_map(drawn: DrawnWorld) -> DrawnWorld:
    """Without keep-outs that lie off the map: a mission file drops them."""
    sides_m = drawn.task.limits.north_m, drawn.task.limits.east_m
    zones = tuple(
        zone
        for zone in drawn.task.zones
        if isinstance(zone, CircleZone)
        and all(
            low - zone.radius_m < at < high + zone.radius_m
            for at, (low, high) in zip((zone.north_m, zone.east_m), sides_m, strict=True)
        )
    )
    return replace(drawn, task=replace(drawn.task, zones=zones))


def _small(
    rng: np.random.Generator,
    name: str,
    limits: Limits,
    range_m: float,
    away_m: float,
    *,
    band_m: tuple[float, float],
    tops_m: tuple[float, float],
    towers: tuple[float, float],
    safety_m: float,
    times_s: tuple[float, float],
) -> DrawnWorld:
    """Hills and towers (radius at the ground) about a straight line of any bearing.

    band_m, tops_m: above the ground.  times_s: of planning, and of a scan.
    """
    bearing, ground = rng.uniform(0.0, 2.0 * math.pi), float(rng.uniform(100.0, 700.0))
    margin = 1.5 * range_m
    north, east = (away_m * np.array([abs(math.cos(bearing)), abs(math.sin(bearing))])).tolist()
    limits = replace(
        limits,
        north_m=(0.0, 2.0 * margin + north),
        east_m=(0.0, 2.0 * margin + east),
        floor_amsl_m=ground + band_m[0],
        ceiling_amsl_m=ground + band_m[1],
    )
    settings = PlannerSettings(
        scan_range_m=range_m,
        safety_distance_m=safety_m,
        planning_time_s=times_s[0],
        scan_time_s=times_s[1],
        overlap_m=0.1 * range_m,
    )
    base = DrawnWorld(
        name=name,
        terrain=PeakTerrain(peaks=(), ground_amsl_m=ground),
        task=Task(limits=limits, settings=settings),
        start_nea_m=(margin, margin, 0.0),
        targets_ne_m=((margin + north, margin + east),),
    )
    # a little above the lowest altitude
    base = replace(base, start_nea_m=(margin, margin, base.floor_amsl_m + 0.1 * base.task.error_m))
    count = round(rng.uniform(2.0, 4.0) * away_m / range_m) + 4
    hills = rng.uniform(0.12, 0.45, count) * range_m
    feet = np.concatenate([hills, rng.uniform(*towers, count)]).tolist()
    peaks: list[Peak] = []
    while len(peaks) < len(feet):
        at, foot = _beside_the_line(rng, base, range_m), feet[len(peaks)]
        if _leaves_ends(base, at, foot):
            high = ground + float(rng.uniform(*tops_m))
            spread = foot / math.sqrt(math.log(high / ground))
            peaks.append(mountain(*at, high, (spread, spread)))
    zones: list[CircleZone] = []
    while len(zones) < 3:
        at, radius = _beside_the_line(rng, base, range_m), float(rng.uniform(0.1, 0.3) * range_m)
        if _leaves_ends(base, at, radius):
            zones.append(CircleZone(name=f"zone {len(zones) + 1}", north_m=at[0], east_m=at[1],
                                    radius_m=radius))  # fmt: skip
    radars = _radars(rng, base, 2, (0.2 * range_m, 0.5 * range_m), range_m)
    return replace(
        base,
        terrain=PeakTerrain(peaks=tuple(peaks), ground_amsl_m=ground),
        task=replace(base.task, zones=tuple(zones), radars=radars),
    )


# --- what they are made of


def mountain(north: float, east: float, top: float, spreads: tuple[float, float]) -> Peak:
    """A mountain of eq. 1: its place, its height AMSL, and how wide it is to the north and east."""
    return Peak(
        north_m=north,
        east_m=east,
        height_amsl_m=top,
        spread_north_m=spreads[0],
        spread_east_m=spreads[1],
    )


def _with_obstacles(
    base: DrawnWorld,
    name: str,
    peaks: Sequence[Peak],
    radars: Sequence[Radar],
    limits: Limits | None = None,
) -> DrawnWorld:
    """On a plain at sea level; limits: others than those of the base."""
    task = replace(base.task, radars=tuple(radars), zones=(), limits=limits or base.task.limits)
    terrain = PeakTerrain(peaks=tuple(peaks), ground_amsl_m=0.0)
    return replace(base, name=name, terrain=terrain, task=task)


def _radars(
    rng: np.random.Generator,
    base: DrawnWorld,
    count: int,
    range_m: tuple[float, float],
    aside_m: float,
) -> tuple[Radar, ...]:
    """Radars about the straight line that see neither end, on the plain."""
    radars: list[Radar] = []
    plain_m = base.terrain.ground_amsl_m if isinstance(base.terrain, PeakTerrain) else 0.0
    while len(radars) < count:
        north, east = _beside_the_line(rng, base, aside_m)
        reach = float(rng.uniform(*range_m))
        if _leaves_ends(base, (north, east), reach):
            radars.append(Radar(name=f"radar {len(radars) + 1}",
                                centre_nea_m=(north, east, plain_m), range_m=reach))  # fmt: skip
    return tuple(radars)


def _at(base: DrawnWorld, along_m: float, aside_m: float) -> tuple[float, float]:
    """A place so far along the straight line from the start, and so far to the right of it."""
    start, target = np.array(base.start_nea_m[:2]), np.array(base.targets_ne_m[0])
    ahead = (target - start) / np.linalg.norm(target - start)
    at = start + along_m * ahead + aside_m * np.array([-ahead[1], ahead[0]])
    return float(at[0]), float(at[1])


def _beside_the_line(
    rng: np.random.Generator, base: DrawnWorld, aside_m: float
) -> tuple[float, float]:
    """A place about the middle three quarters of the straight line, normally so far aside."""
    way = math.dist(base.start_nea_m[:2], base.targets_ne_m[0])
    return _at(base, float(rng.uniform(0.125, 0.875)) * way, float(rng.normal(0.0, aside_m)))


def _leaves_ends(base: DrawnWorld, at_ne_m: tuple[float, float], reach_m: float) -> bool:
    """Whether something so large leaves 0.15 R about the start and the target."""
    room = 0.15 * base.task.settings.scan_range_m + base.task.limits.loiter_radius_m
    ends = (base.start_nea_m[:2], base.targets_ne_m[0])
    return all(math.dist(at_ne_m, end) >= reach_m + room for end in ends)


_Draw = Callable[[np.random.Generator, str], DrawnWorld]
_FAMILIES: dict[str, tuple[int, _Draw]] = {
    "dense": (1, _dense),
    "sparse": (2, _sparse),
    "gathered": (11, _gathered),
    "walls": (12, _walls),
    "copter": (14, _copter),
    "plane": (15, _plane),
    "short-copter": (16, _short_copter),
    "short-plane": (17, _short_plane),
}
FAMILIES = tuple(_FAMILIES)
