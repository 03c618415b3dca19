"""Searches a place where a plane can loiter that has to leave its path for a new zone."""

import math

import numpy as np

from companion.geodesy import FloatArray
from companion.planner.cheapest_ways import IndexArray
from companion.planner.procedure import Vector
from companion.planner.settings import Task
from companion.world.columns import distance_to_terrain_m, distances_to_terrain_m, sees_anything
from companion.world.known_map import KnownMap
from companion.world.zones import gaps_m

_BEARINGS, _LENGTHS = 36, 16
"""Places about the vehicle: 10 degrees and 2.5 % of R apart, about a turn radius at the rim."""
_FARTHEST = 0.4
"""Of R: what lies farther out is often beyond what the last scan, up to half of R behind, saw."""
_SAMPLES, _ROUGHLY = 64, 24
"""Points of a way that is proven, 1 % of R apart on the longest; and of one that is ranked."""
_LOOKED_AT = 40  # ways, the best first; each takes 1 ms: the watchdog allows 0.2 s
_SLACK_M = 1.0  # so much nearer than the vehicle is a way may come: so well it knows where it is
_TURNS = np.array([-0.5, -1.0, 0.5, 1.0])
"""Of the turn radius of paths, > 0 to the right: autopilots turn more tightly to a point."""
_EITHER_SIDE_RAD = math.radians(135.0)  # from there on, behind it, it may turn either way
_AHEAD_RAD = 1e-6  # a turn short of full by less is none: rounding, 0.1 mm on a turn of 100 m
_HERE_M = 1e-3  # a place so near is on both turns, whatever rounding says
_STILL_M_S, _ON_THE_SPOT = 1.0, 1e-6
"""Slower over ground no plane flies: its course means nothing, and it counts as turning at once."""


def loiter_point(
    known: KnownMap, task: Task, here_nea_m: Vector, velocity_nea_m_s: Vector, preferred: Vector
) -> Vector | None:
    """A point to loiter at: its circle is clear of terrain and zones.

    The preferred point if the way there is clear, else the point at the vehicle's height with the
    shortest way; what of it is too near to zones counts again, by the share of the required
    clearance that is missing there (or up to 20 times: among 300 drawn fences it led out of them
    equally soon).  A circle keeps the required clearance, or, if none does, the vehicle's errors.
    Of the way there, which begins with a turn from its velocity over ground:

    - it clears terrain by the errors, or comes no nearer than the vehicle is; all of it counts as
      flown at the lower of its ends, as a climb takes longer than the way;
    - it clears zones by the errors, or comes no nearer than the vehicle is.

    Unknown ground is never clear.  None: there is no such place among the best.
    """
    position, zones = np.array(here_nea_m), task.zones
    error_m, required_m = task.error_m, task.required_clearance_m
    farthest_m, circle_m = _FARTHEST * task.settings.scan_range_m, task.limits.loiter_radius_m
    if not sees_anything(known, here_nea_m[:2], farthest_m):
        return None
    turns = np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False)
    radii = np.linspace(0.0, farthest_m, _LENGTHS + 1)[1:, None, None]
    rings = position[:2] + radii * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    places = np.concatenate([[preferred[:2], position[:2]], rings.reshape(-1, 2)])
    low_m, high_m = task.band_amsl_m
    points = np.insert(places, 2, min(max(float(position[2]), low_m), high_m), axis=1)
    points[0] = preferred
    clear_m = gaps_m(zones, points[:, 0], points[:, 1], task.zone_clearance_m) - circle_m
    points, clear_m = points[clear_m >= error_m], clear_m[clear_m >= error_m]
    low = np.column_stack([points[:, :2], np.minimum(points[:, 2], position[2])])
    clear_m = np.minimum(clear_m, distances_to_terrain_m(known.grown(circle_m), low, required_m))

    ways, lengths_m, which = _ways_ne_m(task, position[:2], velocity_nea_m_s, low[:, :2], _ROUGHLY)
    off_m = gaps_m(zones, ways[..., 0], ways[..., 1], required_m)
    nearest_m, bad_m = np.full(len(points), np.inf), np.zeros(len(points))
    np.minimum.at(nearest_m, which, off_m.min(axis=-1))
    into_m = np.maximum(1.0 - off_m / required_m, 0.0).mean(axis=-1) * lengths_m
    np.maximum.at(bad_m, which, lengths_m + into_m)  # the worst of what it may fly counts
    bad_m[(points == preferred).all(axis=1) & (nearest_m >= required_m)] = -1.0
    off_zones_m = min(error_m, float(gaps_m(zones, position[0], position[1])) - _SLACK_M)
    off_terrain_m = min(error_m, distance_to_terrain_m(known, position, error_m) - _SLACK_M)
    order = np.lexsort([np.round(bad_m, 3), clear_m < required_m])
    for k in order[((nearest_m >= off_zones_m) & (clear_m >= error_m))[order]][:_LOOKED_AT]:
        ways, _, _ = _ways_ne_m(task, position[:2], velocity_nea_m_s, low[k : k + 1, :2], _SAMPLES)
        flown = np.insert(ways.reshape(-1, 2), 2, low[k, 2], axis=1)
        clears_zones = gaps_m(zones, flown[:, 0], flown[:, 1], required_m) >= off_zones_m
        clears_terrain = distances_to_terrain_m(known, flown, error_m) >= off_terrain_m
        if (clears_zones & clears_terrain).all():
            north, east, altitude = points[k].tolist()
            return north, east, altitude
    return None


def _ways_ne_m(
    task: Task, start: FloatArray, velocity: Vector, places_ne_m: FloatArray, samples: int
) -> tuple[FloatArray, FloatArray, IndexArray]:
    """Ways to N places: a turn, wide or tight, until the nose points there, then straight.

    To a place behind it turns either way.  A place within the turn, or where it is, is never
    pointed at: the whole turn.
    -> (M, S, 2), lengths (M,), and to which of the places (M,).
    """
    course = math.atan2(velocity[1], velocity[0])
    away = places_ne_m - start
    bearing = np.arctan2(away[:, 1], away[:, 0]) - course
    bearing = np.arctan2(np.sin(bearing), np.cos(bearing))
    is_here = np.hypot(away[:, 0], away[:, 1]) < _HERE_M
    flown = (_TURNS[:, None] * bearing >= 0.0) | (np.abs(bearing) > _EITHER_SIDE_RAD) | is_here
    turn, which = np.nonzero(flown)
    side, size_m = np.sign(_TURNS)[turn], (np.abs(_TURNS) * task.limits.turn_radius_m)[turn]
    if math.hypot(*velocity[:2]) < _STILL_M_S:
        size_m = np.full(len(size_m), _ON_THE_SPOT)
    centre = start + (side * size_m)[:, None] * [-math.sin(course), math.cos(course)]
    away = places_ne_m[which] - centre
    apart_m = np.hypot(away[:, 0], away[:, 1])
    straight_m = np.sqrt(np.maximum(apart_m**2 - size_m**2, 0.0))
    then = np.arctan2(away[:, 1], away[:, 0]) + np.arctan2(side * size_m, straight_m)
    turned = np.mod(side * (then - course), 2.0 * math.pi)
    turned = np.where(turned > 2.0 * math.pi - _AHEAD_RAD, 0.0, turned)
    turned = np.where((apart_m <= size_m) | is_here[which], 2.0 * math.pi, turned)
    lengths_m = size_m * turned + straight_m
    along_m = np.linspace(0.0, 1.0, samples + 1)[1:] * lengths_m[:, None]
    side, size_m, turned = side[:, None], size_m[:, None], turned[:, None]
    now = course + side * np.minimum(along_m / size_m, turned)
    beyond_m = np.maximum(along_m - size_m * turned, 0.0)
    north_m = centre[:, :1] + side * size_m * np.sin(now) + beyond_m * np.cos(now)
    east_m = centre[:, 1:] - side * size_m * np.cos(now) + beyond_m * np.sin(now)
    return np.stack([north_m, east_m], axis=-1), lengths_m, which
