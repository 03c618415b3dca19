"""Where a plane can circle when what lies ahead of it is no longer safe."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from companion.geodesy import FloatArray
from companion.planner.settings import Task
from companion.world.clearance import distance_to_terrain_m
from companion.world.known_map import KnownMap

Vector = tuple[float, float, float]

_BEARINGS, _LENGTHS = 36, 16
_FARTHEST = 0.4  # of R
_SAMPLES = 24  # of the straight way there
_SLACK_M = 1.0


def loiter_point(
    known: KnownMap, task: Task, here_nea_m: Vector, preferred: Sequence[Vector] = ()
) -> Vector | None:
    """A point that the vehicle can circle (or hover at): its circle is clear of terrain and zones.

    The first of the preferred ones, else the nearest place all round, at this height or in the
    middle between it and the ceiling; with the whole required clearance, or if there is no such
    place with the vehicle's errors.  The straight way there keeps off terrain by these, and comes
    no nearer to zones than that or than the vehicle is.  None: there is none.
    """
    here = np.asarray(here_nea_m)
    for clearance_m in (task.required_clearance_m, task.error_m):
        for point in _candidates(task, here, preferred):
            if _is_clear(known, task, point, clearance_m) and _is_open(known, task, here, point):
                north, east, altitude = (float(value) for value in point)
                return north, east, altitude
    return None


def _candidates(task: Task, here: FloatArray, preferred: Sequence[Vector]) -> Iterator[FloatArray]:
    """Places to look at: the preferred ones, here, and rings about here at two heights."""
    yield from (np.asarray(point) for point in preferred)
    low, high = task.band_amsl_m
    level = min(max(float(here[2]), low), high)
    farthest_m = _FARTHEST * task.settings.scan_range_m
    for radius_m in np.linspace(0.0, farthest_m, _LENGTHS + 1):
        for altitude_m in (level, 0.5 * (level + high)):
            for turn in np.linspace(0.0, 2.0 * math.pi, _BEARINGS if radius_m else 1, False):
                aside = radius_m * np.array([math.cos(turn), math.sin(turn)])
                yield np.array([*(here[:2] + aside), altitude_m])


def _is_clear(known: KnownMap, task: Task, point: FloatArray, clearance_m: float) -> bool:
    """Whether the circle about a point keeps a distance from terrain and zones."""
    loiter_m = task.limits.loiter_radius_m
    if _gap_m(task, point) - loiter_m < clearance_m:
        return False
    return distance_to_terrain_m(known.grown(loiter_m), point, clearance_m) >= clearance_m


def _is_open(known: KnownMap, task: Task, here: FloatArray, there: FloatArray) -> bool:
    """Whether the straight way comes no nearer to anything than the errors, or than it is now."""
    way = here + np.linspace(0.0, 1.0, _SAMPLES + 1)[:, None] * (there - here)
    error_m, now_m = task.error_m, _gap_m(task, here)
    if any(_gap_m(task, at) < min(error_m, now_m - _SLACK_M) for at in way[1:]):
        return False
    near_m = distance_to_terrain_m(known, here, error_m)
    least_m = min(error_m, near_m - _SLACK_M)
    return all(distance_to_terrain_m(known, at, error_m) >= least_m for at in way[1:])


def _gap_m(task: Task, point: FloatArray) -> float:
    """Distance to the nearest zone, negative where it is forbidden."""
    gaps = (float(zone.distance_m(point[0], point[1])) for zone in task.zones)
    return min(gaps, default=math.inf)
