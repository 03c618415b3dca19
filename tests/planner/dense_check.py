"""An independent look at what a certificate promises, every metre of a curve.

Shares no code with the product: the curve is scipy's, columns are compared one by one, the
dead-man stretches are flown point by point.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from planning import column_distance_m, spline, zone_distance_m

from companion.path.envelope import ending_m_s, rising_m_s
from companion.planner.settings import Task
from companion.world.known_map import KnownMap

FloatArray = NDArray[np.float64]

_SLACK_M = 1e-3


def nearest_m(task: Task, known: KnownMap, points: FloatArray, within_m: float) -> float:
    """Least distance of points to terrain and keep-outs."""
    gaps = [float(zone_distance_m(zone, *points.T[:2]).min()) for zone in task.zones]
    return min(float(column_distance_m(known, points, within_m).min()), *gaps, within_m)


def stretches_nea_m(curve: Any, task: Task, *, from_rest: bool) -> FloatArray:
    """Where the vehicle comes if the companion dies: every 20 m along, every 4 m ahead."""
    motion = task.envelope
    fine = np.linspace(0.0, 1.0, 3_001)
    chords = np.linalg.norm(np.diff(curve(fine), axis=0), axis=-1)
    flown = np.concatenate([[0.0], np.cumsum(chords)])
    points = []
    for at in np.arange(0.0, flown[-1], 20.0):
        u = float(np.interp(at, flown, fine))
        speed = ending_m_s(motion, flown[-1] - at)
        speed = min(speed, rising_m_s(motion, at)) if from_rest else speed
        reach = speed * motion.dead_man_s + speed**2 / (2.0 * motion.braking_m_s2)
        tangent = curve(u, 1) / np.linalg.norm(curve(u, 1))
        points += [curve(u) + ahead * tangent for ahead in np.append(np.arange(0, reach, 4), reach)]
    return np.array(points)


def violations(
    control_nea_m: FloatArray, task: Task, known: KnownMap, *, from_rest: bool
) -> list[str]:
    """The bounds that a curve breaks somewhere, in words; empty: none was found."""
    limits, curve = task.limits, spline(control_nea_m)
    wanted = task.settings.safety_distance_m
    wanted += limits.tracking_error_m + limits.navigation_error_m
    error = limits.tracking_error_m + limits.navigation_error_m
    legs = np.linalg.norm(np.diff(control_nea_m, axis=0), axis=-1).sum()
    u = np.linspace(0.0, 1.0, math.ceil(1.5 * legs) + 1)  # metres, or less where it is fast
    points, first, second = curve(u), curve(u, 1), curve(u, 2)
    ground = np.hypot(first[:, 0], first[:, 1])
    bend = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / ground**3
    slope = np.arctan2(first[:, 2], ground)
    n, e, z = points.T
    stretches = stretches_nea_m(curve, task, from_rest=from_rest)
    found = {
        "clearance": nearest_m(task, known, points, 2.0 * wanted) < wanted - _SLACK_M,
        "dead man": nearest_m(task, known, stretches, 2.0 * error) < error - _SLACK_M,
        "turn": bend.max() > (1.0 + 1e-6) / limits.turn_radius_m,
        "climb": slope.max() > limits.climb_angle_rad + 1e-6,
        "dive": slope.min() < -limits.dive_angle_rad - 1e-6,
        "floor": z.min() < limits.floor_amsl_m + error - _SLACK_M,
        "ceiling": z.max() > limits.ceiling_amsl_m - error + _SLACK_M,
        "map": min(n.min() - limits.north_m[0], e.min() - limits.east_m[0]) < -_SLACK_M
        or max(n.max() - limits.north_m[1], e.max() - limits.east_m[1]) > _SLACK_M,
    }
    return [name for name, broken in found.items() if broken]
