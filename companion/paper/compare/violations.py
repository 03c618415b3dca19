"""What a route violates, looked at every 10 m: the paper's ten samples a subpath miss it.

Clearance is the paper's distance to each peak to first order, (z - h) / sqrt(1 + |grad h|^2)
(row 12 of the paper's page), of the true peaks and not of a grid.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import final

import numpy as np

from companion.geodesy import BoolArray, FloatArray
from companion.path.bspline import climb_angle_rad, horizontal_curvature_1_m
from companion.path.subpath import Subpath
from companion.planner.settings import Task
from companion.world.terrain import PeakTerrain

SPACING_M = 10.0
_TOLERANCE = 1e-6  # relative: what lies on a bound has not crossed it


@final
@dataclass(frozen=True, kw_only=True)
class Violations:
    """Metres of a route that break a bound."""

    clearance_m: float
    """Nearer than d_s to a peak or to the ground."""
    radar_m: float
    """Within the range of a radar (eq. 3)."""
    turn_m: float
    """Turning more tightly than the vehicle can, joins included."""
    climb_m: float
    """Climbing or diving more steeply than the vehicle can."""
    band_m: float
    """Below the floor or above the ceiling."""

    @property
    def any(self) -> bool:
        """Whether anything at all is violated."""
        return any(asdict(self).values())


def violations(
    flown: Sequence[tuple[Subpath, float]], task: Task, terrain: PeakTerrain
) -> Violations:
    """Measure subpaths, each as far as it was flown (metres)."""
    limits, more, less = task.limits, 1.0 + _TOLERANCE, 1.0 - _TOLERANCE
    total = np.zeros(5)
    for subpath, flown_m in flown:
        points, curvature, climb, step_m = _measured(subpath, flown_m)
        seen = np.zeros(len(points), dtype=bool)
        for radar in task.radars:
            seen |= radar.distance_m(points) < radar.range_m * less
        slack = _TOLERANCE * (limits.ceiling_amsl_m - limits.floor_amsl_m)
        altitude = points[:, 2]
        broken: list[BoolArray] = [
            peak_distance_m(points, terrain) < task.settings.safety_distance_m * less,
            seen,
            curvature * limits.turn_radius_m > more,
            (climb > limits.climb_angle_rad + _TOLERANCE)
            | (climb < -limits.dive_angle_rad - _TOLERANCE),
            (altitude < limits.floor_amsl_m - slack) | (altitude > limits.ceiling_amsl_m + slack),
        ]
        total += np.array(broken) @ step_m
    clearance_m, radar_m, turn_m, climb_m, band_m = total.tolist()
    return Violations(
        clearance_m=clearance_m, radar_m=radar_m, turn_m=turn_m, climb_m=climb_m, band_m=band_m
    )


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


def _measured(
    subpath: Subpath, flown_m: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Points (S, 3), horizontal curvature, climb angle and metres that each stands for (S,)."""
    whole = subpath.length_m
    samples = subpath.sampled(SPACING_M)
    at_m = np.linspace(0.0, whole, len(samples.value))
    flown = at_m <= flown_m + 1e-9
    edges = np.concatenate([[0.0], 0.5 * (at_m[1:] + at_m[:-1]), [whole]]).clip(max=flown_m)
    speed = np.linalg.norm(samples.first, axis=1)
    corner = speed < 1e-6 * speed.max()  # r2 = 0: the join is a corner, and has no direction
    curvature = horizontal_curvature_1_m(samples.first, samples.second)
    climb = climb_angle_rad(samples.first)
    return (
        samples.value[flown],
        np.where(corner, np.inf, curvature)[flown],
        np.where(corner, 0.0, climb)[flown],
        np.diff(edges)[flown],
    )
