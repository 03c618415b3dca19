"""Searches a place where a plane can loiter that has to leave its path for a new zone."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from companion.geodesy import BoolArray, FloatArray
from companion.planner.settings import Task
from companion.world.clearance import sees_anything
from companion.world.columns import distance_to_terrain_m, distances_to_terrain_m
from companion.world.known_map import KnownMap
from companion.world.zones import gaps_m, nearest, packed

Vector = tuple[float, float, float]
Ways = tuple[FloatArray, FloatArray, BoolArray]
"""Ways to M of N places: (M, S, 2), their lengths (M,), and to which (N,)."""

_BEARINGS, _LENGTHS = 36, 16
"""Places about the vehicle: 10 degrees and 2.5 % of R apart, about a turn radius at the rim."""
_FARTHEST = 0.4
"""Of R: what lies farther out is often beyond what the last scan, up to half of R behind, saw."""
_SAMPLES, _ROUGHLY = 64, 24
"""Points of a way that is proven, 1 % of R apart on the longest; and of one that is ranked."""
_LOOKED_AT = 40
"""Ways that are looked at closely, the best first; each takes 1 ms: the watchdog allows 0.2 s."""
_SLACK_M = 1.0
"""How much nearer than the vehicle is a way may come: its own position is no better known."""
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

    Unknown ground is never clear.  None: there is no such place among the best.
    """
    here, required_m = np.asarray(motion.here_nea_m), task.required_clearance_m
    reach_m = _FARTHEST * task.settings.scan_range_m
    if not sees_anything(known, motion.here_nea_m[:2], reach_m):
        return None
    points = _points_nea_m(task, here, reach_m, preferred)
    zones_m = gaps_m(packed(task.zones), points[:, 0], points[:, 1], task.zone_clearance_m)
    circle_m = zones_m - task.limits.loiter_radius_m
    points, circle_m = points[circle_m >= task.error_m], circle_m[circle_m >= task.error_m]
    badness_m, gap_m = _judged(task, motion, points, _ROUGHLY)
    badness_m[(points == preferred).all(axis=1) & (gap_m >= required_m)] = -1.0
    allowed_m = min(task.error_m, nearest(task.zones, *motion.here_nea_m[:2])[1] - _SLACK_M)
    open_ = gap_m >= allowed_m
    points, circle_m, badness_m = points[open_], circle_m[open_], badness_m[open_]

    low = np.column_stack([points[:, :2], np.minimum(points[:, 2], here[2])])
    grown = known.grown(task.limits.loiter_radius_m)
    circle_m = np.minimum(circle_m, distances_to_terrain_m(grown, low, required_m))
    order = np.lexsort([np.round(badness_m, 3), circle_m < required_m])
    for k in order[circle_m[order] >= task.error_m][:_LOOKED_AT]:
        off_zones = _judged(task, motion, points[k : k + 1], _SAMPLES)[1] >= allowed_m
        if off_zones and _keeps_off_terrain(known, task, motion, low[k]):
            return (float(points[k, 0]), float(points[k, 1]), float(points[k, 2]))
    return None


def _points_nea_m(task: Task, here: FloatArray, reach_m: float, preferred: Vector) -> FloatArray:
    """The preferred one; here, and on rings about here, at two heights each.  -> (N, 3)."""
    low, high = task.band_amsl_m
    level = min(max(float(here[2]), low), high)
    turns = np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False)
    radii = np.linspace(0.0, reach_m, _LENGTHS + 1)[1:, None, None]
    rings = here[:2] + radii * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    places = np.repeat(np.concatenate([here[None, :2], rings.reshape(-1, 2)]), 2, axis=0)
    heights = np.resize([level, 0.5 * (level + high)], len(places))
    return np.concatenate([[preferred], np.column_stack([places, heights])])


def _judged(
    task: Task, motion: Motion, points: FloatArray, samples: int
) -> tuple[FloatArray, FloatArray]:
    """Of the ways to each point: how bad they are, and their least distance to zones, metres.

    Bad is the length, and again what of it is too near to zones: metres, each by the share of the
    required clearance that is missing there (counted once, or up to 20 times: among 300 drawn
    fences it led out of them equally soon).  The worst of what the vehicle may fly counts:
    wide or tight turns, and to places behind it turns to either side.  -> (N,) x 2
    """
    zones, required_m = packed(task.zones), task.required_clearance_m
    places, which = np.unique(points[:, :2], axis=0, return_inverse=True)
    length_m, intruding_m = np.zeros(len(places)), np.zeros(len(places))
    nearest_m = np.full(len(places), np.inf)
    for ways, lengths_m, flown in _ways_ne_m(task, motion, places, samples):
        off_m = gaps_m(zones, ways[..., 0], ways[..., 1], required_m)
        into_m = np.maximum(1.0 - off_m / required_m, 0.0).mean(axis=-1) * lengths_m
        length_m[flown] = np.maximum(length_m[flown], lengths_m)
        intruding_m[flown] = np.maximum(intruding_m[flown], into_m)
        nearest_m[flown] = np.minimum(nearest_m[flown], off_m.min(axis=-1))
    return (length_m + intruding_m)[which], nearest_m[which]


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


def _keeps_off_terrain(known: KnownMap, task: Task, motion: Motion, end: FloatArray) -> bool:
    """Whether the way to a point keeps off terrain by the errors, or as far as the vehicle does.

    end: the point, or the one below it at the height of the vehicle.
    """
    error_m, here = task.error_m, np.asarray(motion.here_nea_m)
    least_m = min(error_m, distance_to_terrain_m(known, here, error_m) - _SLACK_M)
    for ways, _, _ in _ways_ne_m(task, motion, end[None, :2], _SAMPLES):
        flown = np.insert(ways.reshape(-1, 2), 2, end[2], axis=1)
        if (distances_to_terrain_m(known, flown, error_m) < least_m).any():
            return False
    return True
