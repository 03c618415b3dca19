"""What a route violates, looked at every 10 m: the paper's ten samples a subpath miss it.

Clearance is the paper's distance to each peak to first order, (z - h) / sqrt(1 + |grad h|^2)
(row 12 of the paper's page), of the true peaks and not of a grid.
"""

from collections.abc import Iterable

import numpy as np

from companion.geodesy import FloatArray
from companion.path.subpath import Subpath
from companion.planner.settings import Task
from companion.world.terrain import PeakTerrain

_SPACING_M = 10.0
_TOLERANCE = 1e-6  # relative: what lies on a bound has not crossed it
KINDS = {
    "clearance": "nearer than d_s",  # to a peak or to the ground
    "radar": "seen by radars",  # within the range of one (eq. 3)
    "turn": "turn",  # more tightly than the vehicle can, joins included
    "climb": "climb",  # or dive more steeply than it can
    "band": "altitude",  # below the floor or above the ceiling
}
"""What may be violated, and how tables say it."""


def violations(
    flown: Iterable[tuple[Subpath, float]], task: Task, terrain: PeakTerrain
) -> dict[str, float]:
    """Metres of subpaths, each as far as it was flown (metres), that break a bound, by kind."""
    limits, more, less = task.limits, 1.0 + _TOLERANCE, 1.0 - _TOLERANCE
    slack_m = _TOLERANCE * (limits.ceiling_amsl_m - limits.floor_amsl_m)
    total = dict.fromkeys(KINDS, 0.0)
    for subpath, flown_m in flown:
        samples, length_m = subpath.sampled(_SPACING_M), subpath.length_m
        points, altitude = samples.value, samples.value[:, 2]
        at_m = np.linspace(0.0, length_m, len(points))
        edges_m = np.concatenate([[0.0], 0.5 * (at_m[1:] + at_m[:-1]), [length_m]])
        stands_for_m = np.diff(edges_m.clip(max=flown_m)) * (at_m <= flown_m + 1e-9)
        speed = np.linalg.norm(samples.first, axis=1)
        corner = speed < 1e-6 * speed.max()  # r2 = 0: the join is a corner, and has no direction
        (north, east, up), (turn_n, turn_e, _) = samples.first.T, samples.second.T
        level = np.hypot(north, east)
        curvature = np.abs(north * turn_e - turn_n * east) / np.maximum(level, 1e-9) ** 3
        climb = np.where(corner, 0.0, np.arctan2(up, level))
        seen = [radar.distance_m(points) < radar.range_m * less for radar in task.radars]
        broken = {
            "clearance": peak_distance_m(points, terrain) < task.settings.safety_distance_m * less,
            "radar": np.any([np.zeros(len(points), dtype=bool), *seen], axis=0),
            "turn": corner | (curvature * limits.turn_radius_m > more),
            "climb": (climb > limits.climb_angle_rad + _TOLERANCE)
            | (climb < -limits.dive_angle_rad - _TOLERANCE),
            "band": (altitude < limits.floor_amsl_m - slack_m)
            | (altitude > limits.ceiling_amsl_m + slack_m),
        }
        for kind, where in broken.items():
            total[kind] += float(where @ stands_for_m)
    return total


def peak_distance_m(points_nea_m: FloatArray, terrain: PeakTerrain) -> FloatArray:
    """Distance to the nearest peak or the ground, to first order, metres.  (..., 3) -> (...).

    Negative below the surface.
    """
    north, east, altitude = np.moveaxis(points_nea_m, -1, 0)
    nearest = altitude - terrain.ground_amsl_m
    for peak in terrain.peaks:
        n = (north - peak.north_m) / peak.spread_north_m
        e = (east - peak.east_m) / peak.spread_east_m
        height = peak.height_amsl_m * np.exp(-(n**2) - e**2)
        slope = 2.0 * height * np.hypot(n / peak.spread_north_m, e / peak.spread_east_m)
        nearest = np.minimum(nearest, (altitude - height) / np.hypot(1.0, slope))
    return nearest
