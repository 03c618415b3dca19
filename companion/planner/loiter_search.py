"""Searches a place where a plane can loiter that has to leave its path for a new zone."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from companion.geodesy import BoolArray, FloatArray
from companion.planner.settings import Task
from companion.world.clearance import sees_anything
from companion.world.columns import distance_to_terrain_m, distances_to_terrain_m
from companion.world.known_map import KnownMap
from companion.world.zones import ZoneTable, gaps_m, near, nearest, packed

Vector = tuple[float, float, float]
Ways = tuple[FloatArray, FloatArray, BoolArray]
"""Ways to M of N places: (M, S, 2), their lengths (M,), and to which (N,)."""

_BEARINGS, _LENGTHS = 36, 16
"""Places about the vehicle: 10 degrees and 2.5 % of R apart, about a turn radius at the rim."""
_FARTHEST = 0.4
"""Of R: what lies farther out is often beyond what the last scan, up to half of R behind, saw."""
_SAMPLES, _ROUGHLY = 64, 24
"""Points of a way that is proven, 1 % of R apart on the longest; and of one that is ranked."""
_LOOKED_AT, _MIN_LOOKED_AT = 40, 3
"""Ways that are looked at closely, the best first; each takes 1 ms for a zone or two where they
begin, and longer the more there are: the watchdog allows the whole search 0.2 s."""
_AT_ONCE = 16
"""Circles held against the terrain together: more are mostly not asked for."""
_SLACK_M = 1.0
"""How much nearer than the vehicle is a way may come: its own position is no better known."""
_NODES = 48
"""Of `_Field` across: its error is 1.5 % of its side, a third of a plane's usual errors."""
_TURNS = (0.5, 1.0)
"""Of the turn radius of paths: autopilots turn more tightly to a point."""
_EITHER_SIDE_RAD = math.radians(135.0)
"""So far behind that it may turn either way: within 45 degrees of straight behind."""
_AHEAD_RAD = 1e-6
"""A turn short of full by less is none: rounding, 0.1 mm on a turn of 100 m."""
_STILL_M_S = 1.0
"""Slower over ground no plane flies: then its course means nothing."""


class Motion(NamedTuple):
    """Where a plane is and how it flies."""

    here_nea_m: Vector
    velocity_nea_m_s: Vector
    """Over ground; it turns from there towards a place (almost zero: straight flight)."""


def loiter_point(known: KnownMap, task: Task, motion: Motion, preferred: Vector) -> Vector | None:
    """A point to loiter at: its circle is clear of terrain and zones.

    The preferred point if the way there is clear, else the point around the vehicle with the
    shortest way, where parts too near to zones count twice; at its own height or half way
    to the ceiling; with the required clearance about the circle, or if there is none with the
    vehicle's errors.  Of the way there, which begins with a turn:

    - it clears terrain by the errors, or comes no nearer than the vehicle is; all of it counts as
      flown at the lower of its ends, as a climb takes longer than the way;
    - it clears zones by the errors, or comes no nearer than the vehicle is.

    Unknown ground is never clear.  None: there is no such place, or none among the best by
    approximate distances (`_Field`): only those are checked exactly.
    """
    reach_m = _FARTHEST * task.settings.scan_range_m
    here, spot = np.asarray(motion.here_nea_m), motion.here_nea_m[:2]
    if not sees_anything(known, spot, reach_m):
        return None
    places, loiter_m = _places_ne_m(here, reach_m, preferred), task.limits.loiter_radius_m
    allowed_m = min(task.error_m, nearest(task.zones, *spot)[1] - _SLACK_M)
    field, place_m = _field(task, places, here[:2])
    clear_at = place_m >= task.error_m + loiter_m
    if not clear_at.any():
        return None
    rank, nearest_m = np.full((2, len(places)), -np.inf)
    rank[clear_at], nearest_m[clear_at] = _judged(task, motion, field, places[clear_at])
    open_ = np.flatnonzero(clear_at & (nearest_m + field.error_m >= allowed_m))
    prefers = _keeps_off_zones(task, motion, field, places[0], task.required_clearance_m)
    heights = _heights_m(task, motion)
    here_too = len(near(task.zones, spot, spot, task.error_m))
    looks = max(_LOOKED_AT // max(here_too, 1), _MIN_LOOKED_AT)
    for clearance_m in (task.required_clearance_m, task.error_m):
        keeps = place_m[open_] >= clearance_m + loiter_m
        points = (
            (float(places[k, 0]), float(places[k, 1]), height_m)
            for k in _in_order(open_[keeps], rank, first=0 if prefers else None)
            for height_m in (heights if k else (preferred[2],))
        )
        for point in _clear_of_terrain(known, task, motion, points, clearance_m):
            if _is_open(known, task, motion, field, point, allowed_m):
                return point
            looks -= 1
            if looks == 0:
                return None
    return None


def _is_open(
    known: KnownMap, task: Task, motion: Motion, field: "_Field", point: Vector, gap_m: float
) -> bool:
    """Whether all possible ways to a point clear zones and terrain."""
    place = np.array(point[:2])
    off_zones = _keeps_off_zones(task, motion, field, place, gap_m)
    return off_zones and _keeps_off_terrain(known, task, motion, point)


def _places_ne_m(here: FloatArray, reach_m: float, preferred: Vector) -> FloatArray:
    """The preferred one, here, and rings about here, the nearest first.  -> (N, 2)."""
    turns = np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False)
    radii = np.linspace(0.0, reach_m, _LENGTHS + 1)[1:, None, None]
    rings = here[:2] + radii * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    return np.concatenate([[preferred[:2], here[:2]], rings.reshape(-1, 2)])


def _heights_m(task: Task, motion: Motion) -> tuple[float, float]:
    low, high = task.band_amsl_m
    level = min(max(motion.here_nea_m[2], low), high)
    return level, 0.5 * (level + high)


def _in_order(index: NDArray[np.intp], rank: FloatArray, first: int | None) -> Iterator[int]:
    """The first one, if it is among them; then all others, the best first."""
    order = index[np.argsort(np.round(rank[index], 3), kind="stable")].tolist()
    yield from sorted(order, key=lambda k: k != first)


# --- ways, and zones


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Field:
    """Distances to zones at the nodes of a lattice, exact up to that which paths keep."""

    zones: ZoneTable
    corner_ne_m: FloatArray  # (2,): its south-western node
    node_m: float
    gap_m: FloatArray  # (nodes, nodes)

    @property
    def error_m(self) -> float:
        """How far `gaps_m` may be wrong: distances differ by no more than their places do."""
        return math.sqrt(0.5) * self.node_m

    def gaps_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """About the distance to the nearest zone, bilinear between nodes.  (...) x2 -> (...)."""
        at = np.stack([north_m - self.corner_ne_m[0], east_m - self.corner_ne_m[1]]) / self.node_m
        return np.asarray(map_coordinates(self.gap_m, at, order=1, mode="nearest"))

    def keeps(self, points_ne_m: FloatArray, gap_m: float) -> bool:
        """Whether all points are no nearer to zones, exactly; the worst is asked about first."""
        about_m = self.gaps_m(*points_ne_m.T)
        order = np.argsort(about_m)[: np.count_nonzero(about_m - self.error_m < gap_m)]
        for some in (points_ne_m[order[:1]], points_ne_m[order[1:]]):
            told_m = gaps_m(self.zones, some[:, 0], some[:, 1], max(gap_m, 0.0) + _SLACK_M)
            if (told_m < gap_m).any():
                return False
        return True


def _field(task: Task, places: FloatArray, here: FloatArray) -> tuple[_Field, FloatArray]:
    """Distances to zones about the ways: none leads farther than its place, or its turn.

    And those of the places: many points at once are the cheaper.  (N, 2), (2,) -> (N,)
    """
    farthest_m = float(np.hypot(*(places - here).T).max())
    reach_m = max(farthest_m, 2.0 * task.limits.turn_radius_m)
    zones, node_m = packed(task.zones), 2.0 * reach_m / (_NODES - 1)
    nodes = here - reach_m + node_m * np.indices((_NODES, _NODES)).reshape(2, -1).T
    within_m = np.full(len(nodes) + len(places), task.zone_clearance_m)
    within_m[: len(nodes)] = task.required_clearance_m + node_m  # no way is asked to keep more
    north, east = np.concatenate([nodes, places]).T
    told_m = gaps_m(zones, north, east, within_m)
    gap_m = told_m[: len(nodes)].reshape(_NODES, _NODES)
    field = _Field(zones=zones, corner_ne_m=here - reach_m, node_m=node_m, gap_m=gap_m)
    return field, told_m[len(nodes) :]


def _judged(
    task: Task, motion: Motion, field: "_Field", places: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Of the ways to each place: how bad they are, about, and their least distance to zones, about.

    Bad is the length, and again what of it is too near to zones: metres, each by the share of the
    required clearance that is missing there (counted once, or up to 20 times: among 300 drawn
    fences it led out of them equally soon).  The worst of what the vehicle may fly counts:
    wide or tight turns, and to places behind it turns to either side.  -> (N,) x 2
    """
    length_m, intruding_m = np.zeros(len(places)), np.zeros(len(places))
    nearest_m = np.full(len(places), np.inf)
    for ways, lengths_m, flown in _ways_ne_m(task, motion, places, _ROUGHLY):
        gaps_m = field.gaps_m(ways[..., 0], ways[..., 1])
        missing = np.maximum(1.0 - gaps_m / task.required_clearance_m, 0.0)
        into_m = missing.mean(axis=-1) * lengths_m
        length_m[flown] = np.maximum(length_m[flown], lengths_m)
        intruding_m[flown] = np.maximum(intruding_m[flown], into_m)
        nearest_m[flown] = np.minimum(nearest_m[flown], gaps_m.min(axis=-1))
    return length_m + intruding_m, nearest_m


def _keeps_off_zones(
    task: Task, motion: Motion, field: "_Field", place: FloatArray, gap_m: float
) -> bool:
    """Whether all that may be flown to a place keeps this distance from zones."""
    ways = [each for each, _, _ in _ways_ne_m(task, motion, place[None], _SAMPLES)]
    return field.keeps(np.concatenate(ways).reshape(-1, 2), gap_m)


def _ways_ne_m(task: Task, motion: Motion, places: FloatArray, samples: int) -> Iterator[Ways]:
    """The ways to places."""
    here, velocity = np.asarray(motion.here_nea_m[:2]), motion.velocity_nea_m_s
    away = places - here
    if math.hypot(*velocity[:2]) < _STILL_M_S:
        share = np.linspace(0.0, 1.0, samples + 1)[1:, None]
        always = np.ones(len(places), dtype=bool)
        yield here + share * away[:, None], np.hypot(away[:, 0], away[:, 1]), always
        return
    course = math.atan2(velocity[1], velocity[0])
    bearing = np.arctan2(away[:, 1], away[:, 0]) - course
    bearing = np.arctan2(np.sin(bearing), np.cos(bearing))
    for side in (-1.0, 1.0):
        flown = (side * bearing >= 0.0) | (np.abs(bearing) > _EITHER_SIDE_RAD)
        for tightness in _TURNS:
            radius_m = side * tightness * task.limits.turn_radius_m
            ways, lengths_m = _turns_ne_m(here, course, radius_m, places[flown], samples)
            yield ways, lengths_m, flown


def _turns_ne_m(
    here: FloatArray, course: float, radius_m: float, places: FloatArray, samples: int
) -> tuple[FloatArray, FloatArray]:
    """A turn (radius > 0: to the right) until the nose points at a place, then straight there.

    A place within the turn is never pointed at: the whole turn.  -> (N, S, 2) and lengths (N,)
    """
    side, size_m = math.copysign(1.0, radius_m), abs(radius_m)
    centre = here + radius_m * np.array([-math.sin(course), math.cos(course)])
    away = places - centre
    apart_m = np.hypot(away[:, 0], away[:, 1])
    straight_m = np.sqrt(np.maximum(apart_m**2 - size_m**2, 0.0))
    then = np.arctan2(away[:, 1], away[:, 0]) + np.arctan2(radius_m, straight_m)
    turn = np.mod(side * (then - course), 2.0 * math.pi)
    turn = np.where(turn > 2.0 * math.pi - _AHEAD_RAD, 0.0, turn)
    turn = np.where(apart_m <= size_m, 2.0 * math.pi, turn)
    lengths_m = size_m * turn + straight_m
    along_m = np.linspace(0.0, 1.0, samples + 1)[1:] * lengths_m[:, None]
    turned = course + side * np.minimum(along_m / size_m, turn[:, None])
    beyond_m = np.maximum(along_m - size_m * turn[:, None], 0.0)
    north = centre[0] + radius_m * np.sin(turned) + beyond_m * np.cos(turned)
    east = centre[1] - radius_m * np.cos(turned) + beyond_m * np.sin(turned)
    return np.stack([north, east], axis=-1), lengths_m


# --- terrain


def _clear_of_terrain(
    known: KnownMap, task: Task, motion: Motion, points: Iterable[Vector], clearance_m: float
) -> Iterator[Vector]:
    """Those of the points whose circle keeps this distance, at the lower end of the way too."""
    circle, points = known.grown(task.limits.loiter_radius_m), iter(points)
    while some := list(islice(points, _AT_ONCE)):
        there = np.array(some)
        there[:, 2] = np.minimum(there[:, 2], motion.here_nea_m[2])
        gaps_m = distances_to_terrain_m(circle, there, clearance_m)
        yield from (some[k] for k in np.flatnonzero(gaps_m >= clearance_m))


def _keeps_off_terrain(known: KnownMap, task: Task, motion: Motion, point: Vector) -> bool:
    """Whether the way to a point keeps off terrain by the errors, or as far as the vehicle does."""
    lowest_m = min(point[2], motion.here_nea_m[2])
    error_m, here = task.error_m, np.asarray(motion.here_nea_m)
    least_m = min(error_m, distance_to_terrain_m(known, here, error_m) - _SLACK_M)
    for ways, _, _ in _ways_ne_m(task, motion, np.array([point[:2]]), _SAMPLES):
        flown = ways.reshape(-1, 2)
        way = np.concatenate([flown, np.full((len(flown), 1), lowest_m)], axis=1)
        if (distances_to_terrain_m(known, way, error_m) < least_m).any():
            return False
    return True
