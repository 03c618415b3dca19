"""Families of random worlds to measure missions in, each world from (family, seed, index) alone.

The default seed draws the worlds of docs/lab/benchmarks.md; another seed draws fresh ones.
Every world has a way through at the floor of the band, outside all radars and keep-outs, which a
flood fill that shares no code with the planner proves, and its straight line is barred; a world
without is drawn again.  Whoever changes the order of draws changes the worlds.
"""

import functools
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Final, NamedTuple

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
_MOST_DRAWS = 2_000
_DENSITY_1_KM2 = 0.004
_SPREAD_STREAM, _WITHOUT_SEEDS = 3, (1, 2)
_MOST_EDGE_M = 620_000.0
Rng = np.random.Generator
_Between = tuple[float, float]
_Place = tuple[float, float]
_Ring = tuple[float, float, float]
"""Least and greatest north and east, and half the side of the hollow square about the origin."""
_SQUARE: _Ring = (0.0, 100_000.0, 0.0)
_ROOM_M = 6_000.0
"""What mountains in a ring leave free about start and target; radars leave half of it."""


@functools.cache
def world(family: str, seed: int, index: int) -> DrawnWorld:
    """One world, always the same for the same three."""
    if family == SPREAD:
        return _spread_out(index, seed)
    stream, draw = _FAMILIES[family]
    key: tuple[int, ...] = (stream, seed, index)
    name = f"{family}-{seed}-{index}"
    if stream in _WITHOUT_SEEDS:  # as they were drawn before there were seeds
        key = (stream, index, seed)
        if seed == 0:
            key, name = key[:2], f"{family}-{index}"
    rng = np.random.default_rng(key)
    for _ in range(_MOST_DRAWS):
        drawn = replace(draw(rng), name=name)
        if drawn_world.has_way_through(drawn) and not drawn_world.is_straight_line_free(drawn):
            return drawn
    raise AssertionError(f"{family}: no world {index} of seed {seed} in {_MOST_DRAWS} draws")


def unseen(world: DrawnWorld) -> KnownMap:
    """The map of a world of which nothing is known."""
    limits = world.task.limits
    return empty_map(world.task.cell_m, limits.north_m, limits.east_m)


# --- 100 km x 100 km, the mission of environment-2


def _anywhere(
    mountains: tuple[int, int], radars: tuple[int, int], range_m: _Between, rng: Rng
) -> DrawnWorld:
    """So many mountains, and radars of such ranges, anywhere in the square."""
    base = drawn_world.bundled("environment-2")
    peaks = _peaks_in(_SQUARE, rng, base, int(rng.integers(*mountains, endpoint=True)))
    count = int(rng.integers(*radars, endpoint=True))
    return _on_a_plain(base, peaks, _radars_in(_SQUARE, rng, base, count, range_m))


def _spread_out(count: int, variant: int) -> DrawnWorld:
    """Obstacles at equal density (0.004 per km2, 60 % mountains) on an area that grows.

    Worlds of one variant lie in each other: that of 100 holds that of 10 in its middle, so that
    what is in sight there is the same and only the world's size differs. Start and target are
    57 km apart about the middle; the task's map covers everything, or as much as a mission may
    have (2.5e7 cells).  No way through is promised.
    """
    base, half = drawn_world.bundled("environment-2"), 20_000.0
    start_nea_m, targets_ne_m = (-half, -half, base.start_nea_m[2]), ((half, half),)
    base = replace(base, start_nea_m=start_nea_m, targets_ne_m=targets_ne_m)
    peaks, radars = list[Peak](), list[Radar]()
    inner_m, size = 0.0, 10
    while len(peaks) + len(radars) < count:
        size = min(size, count)
        more = size - len(peaks) - len(radars)
        rng = np.random.default_rng((_SPREAD_STREAM, variant, size))
        outer_m = 500.0 * math.sqrt(size / _DENSITY_1_KM2)
        ring = (-outer_m, outer_m, inner_m)
        mountains = round(0.6 * more)
        peaks += _peaks_in(ring, rng, base, mountains)
        radars += _radars_in(ring, rng, base, more - mountains, (6_000.0, 11_000.0))
        inner_m, size = outer_m, 10 * size
    edge_m = min(max(inner_m + 5_000.0, 60_000.0), _MOST_EDGE_M)
    limits = replace(base.task.limits, north_m=(-edge_m, edge_m), east_m=(-edge_m, edge_m))
    spread = _on_a_plain(base, peaks, radars)
    return replace(spread, name=f"growth-{count}", task=replace(spread.task, limits=limits))


def _peaks_in(ring: _Ring, rng: Rng, base: DrawnWorld, count: int) -> list[Peak]:
    """Mountains of 3,600 to 6,000 m, none of which stands over a start or a target."""
    result = list[Peak]()
    while len(result) < count:
        at, height_m = _somewhere(rng, ring), float(np.round(rng.uniform(3_600.0, 6_000.0), -1))
        spreads = [float(v) for v in np.round(rng.uniform(3_000.0, 5_500.0, 2), -1)]
        if _leaves_ends(base, at, max(spreads), _ROOM_M):
            result.append(Peak(*at, height_m, *spreads))
    return result


def _radars_in(
    ring: _Ring, rng: Rng, base: DrawnWorld, count: int, range_m: _Between
) -> list[Radar]:
    """Radars on the plain, none of which sees a start or a target."""

    def drawn() -> tuple[_Place, float]:
        return _somewhere(rng, ring), float(np.round(rng.uniform(*range_m), -1))

    return _radars(base, count, drawn, 0.5 * _ROOM_M)


def _somewhere(rng: Rng, ring: _Ring) -> _Place:
    while True:
        north, east = (float(v) for v in np.round(rng.uniform(*ring[:2], 2), -1))
        if max(abs(north), abs(east)) >= ring[2]:
            return north, east


def _gathered(rng: Rng) -> DrawnWorld:
    """12 mountains and 10 radars gathered about the straight line, where the mission must pass."""
    base = drawn_world.bundled("environment-2")
    peaks = list[Peak]()
    while len(peaks) < 12:
        at, height = _beside_the_line(rng, base, 18_000.0), float(rng.uniform(3_400.0, 6_000.0))
        spreads = rng.uniform(4_000.0, 8_000.0, 2).tolist()
        if _leaves_ends(base, at, max(spreads) * math.sqrt(math.log(height / 2_400.0))):
            peaks.append(Peak(*at, height, *spreads))
    return _on_a_plain(base, peaks, _radars_beside(rng, base, 10, (6_000.0, 11_000.0), 20_000.0))


def _walls(rng: Rng) -> DrawnWorld:
    """Ridges across the way, each with a gap and a saddle, and pockets that open to the start."""
    base = drawn_world.bundled("environment-2")
    peaks = list[Peak]()
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
    return _on_a_plain(base, peaks, _radars_beside(rng, base, 3, (5_000.0, 9_000.0), 35_000.0))


def _ridge(base: DrawnWorld, line_m: FloatArray, top_m: FloatArray) -> list[Peak]:
    """Mountains in a row: (N, 2) metres along the straight line and aside of it."""
    places = [_at(base, along, aside) for along, aside in line_m.tolist()]
    return [
        Peak(*place, top, 3_000.0, 3_000.0)
        for place, top in zip(places, top_m.tolist(), strict=True)
        if _leaves_ends(base, place, 6_000.0)
    ]


# --- small vehicles: hills, towers and keep-outs about a straight line of any bearing


class _Small(NamedTuple):
    """What worlds for a small vehicle are drawn between; one number: it is always that."""

    scan_range_m: _Between | float
    speed_m_s: _Between | float
    turn_radius_m: _Between | float
    away_m: _Between | float  # of the target from the start, at most `most_ranges` scan ranges
    safety_m: _Between | float
    climb_deg: float
    dive_deg: float
    band_m: _Between  # floor and ceiling above the ground,
    tops_m: _Between  # and tops of hills and towers likewise
    towers_m: _Between  # their radius at the ground
    times_s: _Between  # of planning, and of a scan
    limits: dict[str, Any]  # others of the vehicle
    most_ranges: float = math.inf
    on_the_map: bool = False  # without keep-outs that lie off the map: a mission file drops them


_COPTER: Final = _Small(
    scan_range_m=(300.0, 1_500.0), speed_m_s=(8.0, 12.0), turn_radius_m=(20.0, 40.0),
    away_m=(4_000.0, 10_000.0), safety_m=(5.0, 10.0), most_ranges=14.0,
    climb_deg=12.0, dive_deg=12.0, band_m=(40.0, 110.0), tops_m=(50.0, 190.0),
    towers_m=(12.0, 25.0), times_s=(1.0, 2.0),
    limits={"acceleration_m_s2": 2.5, "climb_rate_m_s": 2.0, "tracking_error_m": 1.5,
            "navigation_error_m": 2.0},
)  # fmt: skip
_PLANE: Final = _Small(
    scan_range_m=(3_000.0, 5_000.0), speed_m_s=22.0, turn_radius_m=(110.0, 150.0),
    away_m=(15_000.0, 30_000.0), safety_m=(30.0, 50.0),
    climb_deg=7.0, dive_deg=5.0, band_m=(120.0, 350.0), tops_m=(150.0, 700.0),
    towers_m=(60.0, 120.0), times_s=(3.0, 4.0),
    limits={"acceleration_m_s2": 3.0, "climb_rate_m_s": 2.5, "loiter_radius_m": 100.0},
)  # fmt: skip
_SHORT_COPTER: Final = _Small(  # a flight of one to two minutes
    scan_range_m=280.0, speed_m_s=8.0, turn_radius_m=25.0, away_m=560.0, safety_m=12.0,
    climb_deg=12.0, dive_deg=10.0, band_m=(16.0, 75.0), tops_m=(30.0, 120.0),
    towers_m=(5.0, 15.0), times_s=(1.0, 4.0),
    limits={"acceleration_m_s2": 2.0, "climb_rate_m_s": 1.5, "tracking_error_m": 4.0,
            "navigation_error_m": 3.0},
    on_the_map=True,
)  # fmt: skip
_SHORT_PLANE: Final = _Small(  # of two to three minutes
    scan_range_m=1_400.0, speed_m_s=15.0, turn_radius_m=100.0, away_m=2_400.0, safety_m=30.0,
    climb_deg=6.0, dive_deg=6.0, band_m=(70.0, 190.0), tops_m=(100.0, 260.0),
    towers_m=(30.0, 60.0), times_s=(1.0, 4.0),
    limits={"acceleration_m_s2": 2.0, "climb_rate_m_s": 3.0, "tracking_error_m": 15.0,
            "navigation_error_m": 4.0, "loiter_radius_m": 100.0},
    on_the_map=True,
)  # fmt: skip


def _small(of: _Small, rng: Rng) -> DrawnWorld:
    range_m, speed_m_s, turn_radius_m, away_m, safety_m = (
        float(rng.uniform(*value)) if isinstance(value, tuple) else value
        for value in (of.scan_range_m, of.speed_m_s, of.turn_radius_m, of.away_m, of.safety_m)
    )
    away_m = min(away_m, of.most_ranges * range_m)
    bearing, ground = rng.uniform(0.0, 2.0 * math.pi), float(rng.uniform(100.0, 700.0))
    margin = 1.5 * range_m
    north, east = (away_m * np.array([abs(math.cos(bearing)), abs(math.sin(bearing))])).tolist()
    limits = Limits(
        speed_m_s=speed_m_s,
        turn_radius_m=turn_radius_m,
        climb_angle_rad=math.radians(of.climb_deg),
        dive_angle_rad=math.radians(of.dive_deg),
        floor_amsl_m=ground + of.band_m[0],
        ceiling_amsl_m=ground + of.band_m[1],
        north_m=(0.0, 2.0 * margin + north),
        east_m=(0.0, 2.0 * margin + east),
        **of.limits,
    )
    settings = PlannerSettings(
        scan_range_m=range_m,
        safety_distance_m=safety_m,
        planning_time_s=of.times_s[0],
        scan_time_s=of.times_s[1],
        overlap_m=0.1 * range_m,
    )
    task = Task(limits=limits, settings=settings)
    start_m = task.band_amsl_m[0] + 0.1 * task.error_m  # a little above the lowest altitude
    base = DrawnWorld(
        name="",
        terrain=PeakTerrain(peaks=(), ground_amsl_m=ground),
        task=task,
        start_nea_m=(margin, margin, start_m),
        targets_ne_m=((margin + north, margin + east),),
    )
    count = round(rng.uniform(2.0, 4.0) * away_m / range_m) + 4
    hills = rng.uniform(0.12, 0.45, count) * range_m
    feet = np.concatenate([hills, rng.uniform(*of.towers_m, count)]).tolist()
    peaks = list[Peak]()
    while len(peaks) < len(feet):
        at, foot = _beside_the_line(rng, base, range_m), feet[len(peaks)]
        if _leaves_ends(base, at, foot):
            high = ground + float(rng.uniform(*of.tops_m))
            spread = foot / math.sqrt(math.log(high / ground))
            peaks.append(Peak(*at, high, spread, spread))
    zones = list[CircleZone]()
    while len(zones) < 3:
        (n, e), radius = _beside_the_line(rng, base, range_m), rng.uniform(0.1, 0.3) * range_m
        if _leaves_ends(base, (n, e), radius):
            name = f"zone {len(zones) + 1}"
            zones.append(CircleZone(name=name, north_m=n, east_m=e, radius_m=float(radius)))
    radars = _radars_beside(rng, base, 2, (0.2 * range_m, 0.5 * range_m), range_m)
    if of.on_the_map:
        zones = [zone for zone in zones if _touches_map(zone, limits)]
    return replace(
        base,
        terrain=PeakTerrain(peaks=tuple(peaks), ground_amsl_m=ground),
        task=replace(task, zones=tuple(zones), radars=tuple(radars)),
    )


def _touches_map(zone: CircleZone, limits: Limits) -> bool:
    sides = (zone.north_m, *limits.north_m), (zone.east_m, *limits.east_m)
    return all(low - zone.radius_m < at < high + zone.radius_m for at, low, high in sides)


# --- what they are made of


def _on_a_plain(base: DrawnWorld, peaks: Iterable[Peak], radars: Iterable[Radar]) -> DrawnWorld:
    """With these obstacles alone, at sea level."""
    task = replace(base.task, radars=tuple(radars), zones=())
    return replace(base, terrain=PeakTerrain(peaks=tuple(peaks), ground_amsl_m=0.0), task=task)


def _radars(
    base: DrawnWorld,
    count: int,
    drawn: Callable[[], tuple[_Place, float]],
    room_m: float | None = None,
) -> list[Radar]:
    """Radars on the plain that see neither end.  drawn: where one stands, and its range."""
    assert isinstance(base.terrain, PeakTerrain)
    radars = list[Radar]()
    while len(radars) < count:
        at, range_m = drawn()
        if _leaves_ends(base, at, range_m, room_m):
            place, name = (*at, base.terrain.ground_amsl_m), f"radar {len(radars) + 1}"
            radars.append(Radar(name=name, centre_nea_m=place, range_m=range_m))
    return radars


def _radars_beside(
    rng: Rng, base: DrawnWorld, count: int, range_m: _Between, aside_m: float
) -> list[Radar]:
    def drawn() -> tuple[_Place, float]:
        return _beside_the_line(rng, base, aside_m), float(rng.uniform(*range_m))

    return _radars(base, count, drawn)


def _at(base: DrawnWorld, along_m: float, aside_m: float) -> _Place:
    """A place so far along the straight line from the start, and so far to the right of it."""
    start, target = np.array(base.start_nea_m[:2]), np.array(base.targets_ne_m[0])
    ahead = (target - start) / np.linalg.norm(target - start)
    at = start + along_m * ahead + aside_m * np.array([-ahead[1], ahead[0]])
    return float(at[0]), float(at[1])


def _beside_the_line(rng: Rng, base: DrawnWorld, aside_m: float) -> _Place:
    """A place about the middle three quarters of the straight line, normally so far aside."""
    way = math.dist(base.start_nea_m[:2], base.targets_ne_m[0])
    return _at(base, float(rng.uniform(0.125, 0.875)) * way, float(rng.normal(0.0, aside_m)))


def _leaves_ends(
    base: DrawnWorld, at_ne_m: _Place, reach_m: float, room_m: float | None = None
) -> bool:
    """Whether something so large leaves room about start and target: 0.15 R, if not said."""
    if room_m is None:
        room_m = 0.15 * base.task.settings.scan_range_m + base.task.limits.loiter_radius_m
    ends = (base.start_nea_m[:2], base.targets_ne_m[0])
    return all(math.dist(at_ne_m, end) >= reach_m + room_m for end in ends)


_FAMILIES: dict[str, tuple[int, Callable[[Rng], DrawnWorld]]] = {
    # as environment-2 and environment-1 are
    "dense": (1, functools.partial(_anywhere, (12, 28), (10, 14), (6_000.0, 11_000.0))),
    "sparse": (2, functools.partial(_anywhere, (4, 8), (3, 5), (9_000.0, 15_000.0))),
    "gathered": (11, _gathered),
    "walls": (12, _walls),
    "copter": (14, functools.partial(_small, _COPTER)),
    "plane": (15, functools.partial(_small, _PLANE)),
    "short-copter": (16, functools.partial(_small, _SHORT_COPTER)),
    "short-plane": (17, functools.partial(_small, _SHORT_PLANE)),
}
"""Each with the stream of chance that is its own."""
FAMILIES = tuple(_FAMILIES)
