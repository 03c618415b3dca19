"""What a flown route costs and which bounds it keeps, by the same dense check for every planner."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import final

import numpy as np

from companion.campaign import truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.rivals.problem import FloatArray, resampled
from companion.campaign.route_cost import cost_rate

_STRETCH = 0.5  # of the turn radius: over which turns and climbs are measured
_PIECES = 20  # of a stretch
_LITTLE = 0.01  # of a bound: the samples' own error


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RouteMeasures:
    """The worst of everything along a route."""

    cost: float
    """J."""
    length_m: float
    clearance_m: float
    """True distance to the terrain, and to keep-outs; at most twice what is required."""
    turn_radius_m: float
    """Of the sharpest turn, over any stretch of half the vehicle's turn radius."""
    slope: float
    """Steepest climb or dive over such a stretch, as a share of what the vehicle can do."""
    keeps_clearance: bool
    keeps_turns: bool
    keeps_slopes: bool


def measured(
    world: DrawnWorld, points_nea_m: FloatArray, stops: tuple[int, ...] = ()
) -> RouteMeasures:
    """Measure a route, (S, 3), flown straight from one point to the next.

    stops: points at which it stood still, and may have turned on the spot.
    """
    task, limits = world.task, world.task.limits
    middle = 0.5 * (points_nea_m[1:] + points_nea_m[:-1])
    pieces_m = np.linalg.norm(np.diff(points_nea_m, axis=0), axis=-1)
    need_m = task.required_clearance_m
    step_m = min(0.1 * need_m, _STRETCH * limits.turn_radius_m / _PIECES)
    dense = resampled(points_nea_m, step_m)
    gaps = [truth.keep_out_distance_m(dense, zone).min() for zone in task.zones]
    terrain_m = truth.terrain_distance_m(dense, world.terrain, 2.0 * need_m).min()
    clearance_m = float(min(terrain_m, *gaps, 2.0 * need_m))
    ends = [0, *stops, len(points_nea_m) - 1]
    parts = [_turn_and_slope(world, points_nea_m[a : b + 1]) for a, b in pairwise(ends) if a < b]
    turn_radius_m, slope = min(part[0] for part in parts), max(part[1] for part in parts)
    return RouteMeasures(
        cost=float(cost_rate(middle, world) @ pieces_m),
        length_m=float(pieces_m.sum()),
        clearance_m=clearance_m,
        turn_radius_m=turn_radius_m,
        slope=slope,
        keeps_clearance=clearance_m >= (1.0 - _LITTLE) * need_m,
        keeps_turns=turn_radius_m >= (1.0 - _LITTLE) * limits.turn_radius_m,
        keeps_slopes=slope <= 1.0 + _LITTLE,
    )


def _turn_and_slope(world: DrawnWorld, points_nea_m: FloatArray) -> tuple[float, float]:
    limits = world.task.limits
    stretch_m = _STRETCH * limits.turn_radius_m
    even = resampled(points_nea_m, stretch_m / _PIECES)
    steps = np.diff(even, axis=0)
    if len(steps) <= _PIECES:
        return math.inf, 0.0
    flat_m = np.hypot(steps[:, 0], steps[:, 1])
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    turned = np.abs(heading[_PIECES:] - heading[:-_PIECES]).max()
    along = np.concatenate([[0.0], np.cumsum(flat_m)])
    climb = (even[_PIECES:, 2] - even[:-_PIECES, 2]) / (along[_PIECES:] - along[:-_PIECES])
    most = math.tan(limits.climb_angle_rad), math.tan(limits.dive_angle_rad)
    slope = max(float(climb.max()) / most[0], -float(climb.min()) / most[1])
    return float(stretch_m / max(turned, 1e-9)), slope
