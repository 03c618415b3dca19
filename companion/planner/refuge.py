"""Where a plane can circle when what lies about or ahead of it is no longer safe."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from companion.geodesy import BoolArray, FloatArray
from companion.planner.settings import Task
from companion.world.clearance import distance_to_terrain_m, sees_anything
from companion.world.known_map import KnownMap

Vector = tuple[float, float, float]

_BEARINGS, _LENGTHS = 36, 16
_FARTHEST = 0.4  # of R
_SAMPLES = 64  # of the way there
_INTRUDING = 5.0  # metres of way for each metre of it that has no clearance left
_SLACK_M = 1.0
_TURNS = (0.5, 1.0)  # of the turn radius of paths: autopilots turn more tightly to a point
_EITHER_SIDE_RAD = math.radians(135.0)  # so far behind, nobody knows which way round it turns
_AHEAD_RAD = 1e-6
_STILL_M_S = 1.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Circler:
    """A vehicle that looks for a place to circle."""

    here_nea_m: Vector
    velocity_nea_m_s: Vector = (0.0, 0.0, 0.0)
    """Over ground; a plane turns from there towards the place (zero: it flies straight there)."""
    height_amsl_m: float | None = None
    """Of the places to look at; None: its own, within the band."""
    stays_m: float = math.inf
    """Least distance to zones if it stayed where it circles now: no way there may come nearer."""


def loiter_point(
    known: KnownMap, task: Task, circler: Circler, preferred: Sequence[Vector] = ()
) -> Vector | None:
    """A point that the vehicle can circle (or hover at): its circle is clear of terrain and zones.

    The first of the preferred ones whose way is clear, else the place all round that it comes to by
    the shortest way, what of it is too near to zones counting several times; at this height or in
    the middle between it and the ceiling; with the whole required clearance about the circle, or if
    there is no such place with the vehicle's errors.  Of the way there, which begins with a turn:

    - it keeps off terrain by the errors, or comes no nearer than the vehicle is; all of it counts
      as flown at the lower of its ends, for a climb takes longer than the way;
    - it keeps off zones by the errors, or comes no nearer than the vehicle is, or than it would if
      it stayed where it circles.

    Nothing is clear of ground that is not known.  None: there is no such place.
    """
    reach_m = _FARTHEST * task.settings.scan_range_m
    here = np.asarray(circler.here_nea_m)
    if not sees_anything(known, (float(here[0]), float(here[1])), reach_m):
        return None
    places = _places_ne_m(here, reach_m, preferred)
    length_m, intruding_m, nearest_m = _ways(task, circler, places)
    allowed_m = min(task.error_m, _gap_m(task, here) - _SLACK_M, circler.stays_m)
    open_ = nearest_m >= allowed_m
    gaps_m = _gaps_m(task, places) - task.limits.loiter_radius_m
    for clearance_m in (task.required_clearance_m, task.error_m):
        index = np.flatnonzero(open_ & (gaps_m >= clearance_m))
        for k in _in_order(index, length_m, intruding_m, len(preferred)):
            heights = _heights_m(task, circler)
            for height_m in (preferred[k][2],) if k < len(preferred) else heights:
                north, east = (float(value) for value in places[k])
                point = (north, east, height_m)
                if _keeps_off_terrain(known, task, circler, point, clearance_m):
                    return point
    return None


def _places_ne_m(here: FloatArray, reach_m: float, preferred: Sequence[Vector]) -> FloatArray:
    """The preferred ones, here, and rings about here, the nearest first.  -> (N, 2)."""
    turns = np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False)
    radii = np.linspace(0.0, reach_m, _LENGTHS + 1)[1:, None, None]
    rings = here[:2] + radii * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    first = np.array([point[:2] for point in preferred]).reshape(-1, 2)
    return np.concatenate([first, here[None, :2], rings.reshape(-1, 2)])


def _heights_m(task: Task, circler: Circler) -> tuple[float, float]:
    low, high = task.band_amsl_m
    wanted = circler.here_nea_m[2] if circler.height_amsl_m is None else circler.height_amsl_m
    level = min(max(wanted, low), high)
    return level, 0.5 * (level + high)


def _in_order(
    index: NDArray[np.intp], length_m: FloatArray, intruding_m: FloatArray, preferred: int
) -> Iterator[int]:
    """The preferred ones whose way is clear of zones; then all, the best first."""
    clear = [int(k) for k in index if k < preferred and intruding_m[k] == 0.0]
    yield from clear
    rank = length_m + _INTRUDING * intruding_m
    order = index[np.argsort(np.round(rank[index], 3), kind="stable")]
    yield from (int(k) for k in order if int(k) not in clear)


# --- ways, and zones


def _ways(
    task: Task, circler: Circler, places: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of the ways to places: length, how much of it is too near to zones, and the least distance.

    Too near: metres, each by the share of the required clearance that is missing there.  The worst
    of what the vehicle may fly: wide or tight turns, and to places behind it turns to either side.
    (N, 2) -> (N,) x 3
    """
    length_m, intruding_m = np.zeros(len(places)), np.zeros(len(places))
    nearest_m = np.full(len(places), np.inf)
    for ways, lengths_m, flown in _ways_ne_m(task, circler, places):
        gaps_m = _gaps_m(task, ways)
        missing = np.maximum(1.0 - gaps_m / task.required_clearance_m, 0.0)
        into_m = missing.mean(axis=-1) * lengths_m
        length_m = np.where(flown, np.maximum(length_m, lengths_m), length_m)
        intruding_m = np.where(flown, np.maximum(intruding_m, into_m), intruding_m)
        nearest_m = np.where(flown, np.minimum(nearest_m, gaps_m.min(axis=-1)), nearest_m)
    return length_m, intruding_m, nearest_m


def _ways_ne_m(
    task: Task, circler: Circler, places: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray, BoolArray]]:
    """The ways to places: (N, S, 2), their lengths (N,), and which of them may be flown (N,)."""
    here, velocity = np.asarray(circler.here_nea_m[:2]), circler.velocity_nea_m_s
    away = places - here
    if task.limits.hovers or math.hypot(*velocity[:2]) < _STILL_M_S:
        share = np.linspace(0.0, 1.0, _SAMPLES + 1)[1:, None]
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
            ways, lengths_m = _turns_ne_m(here, course, radius_m, places)
            yield ways, lengths_m, flown


def _turns_ne_m(
    here: FloatArray, course: float, radius_m: float, places: FloatArray
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
    along_m = np.linspace(0.0, 1.0, _SAMPLES + 1)[1:] * lengths_m[:, None]
    turned = course + side * np.minimum(along_m / size_m, turn[:, None])
    beyond_m = np.maximum(along_m - size_m * turn[:, None], 0.0)
    north = centre[0] + radius_m * np.sin(turned) + beyond_m * np.cos(turned)
    east = centre[1] - radius_m * np.cos(turned) + beyond_m * np.sin(turned)
    return np.stack([north, east], axis=-1), lengths_m


def _gaps_m(task: Task, points_ne_m: FloatArray) -> FloatArray:
    """Distance to the nearest zone, negative where it is forbidden.  (..., 2) -> (...)."""
    gaps = np.full(points_ne_m.shape[:-1], np.inf)
    for zone in task.zones:
        gaps = np.minimum(gaps, zone.distance_m(points_ne_m[..., 0], points_ne_m[..., 1]))
    return gaps


def _gap_m(task: Task, point: FloatArray) -> float:
    return float(_gaps_m(task, point[:2]))


# --- terrain


def _keeps_off_terrain(
    known: KnownMap, task: Task, circler: Circler, point: Vector, clearance_m: float
) -> bool:
    """Whether the circle about a point keeps this distance, and the way there the errors."""
    lowest_m = min(point[2], circler.here_nea_m[2])
    circle = known.grown(task.limits.loiter_radius_m)
    there = np.array([point[0], point[1], lowest_m])
    if distance_to_terrain_m(circle, there, clearance_m) < clearance_m:
        return False
    error_m, here = task.error_m, np.asarray(circler.here_nea_m)
    least_m = min(error_m, distance_to_terrain_m(known, here, error_m) - _SLACK_M)
    for ways, _, flown in _ways_ne_m(task, circler, there[None, :2]):
        for north, east in ways[0] if flown[0] else ():
            at = np.array([north, east, lowest_m])
            if distance_to_terrain_m(known, at, error_m) < least_m:
                return False
    return True
