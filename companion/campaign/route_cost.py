"""What a metre of a route costs: the one measure by which routes of all planners are compared.

J = integral of [a1 100 / (2.4 R) + a2 100 (z - floor) / (ceiling - floor) / R + a5 300 p / R] ds:
the objective of subpaths (eq. 5-7, 10, scaled as in planner-numbers A) per metre of route.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from companion.campaign import truth
from companion.campaign.drawn_world import DrawnWorld
from companion.geodesy import FloatArray


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Rates:
    """Cost per metre, in metres of level flight at the floor; `unit`: J per such metre."""

    unit: float
    height: float
    """At the ceiling."""
    radar: float
    """Per unit of detection probability."""

    @staticmethod
    def of(world: DrawnWorld) -> "Rates":
        """Of a world's scan range and weights."""
        settings = world.task.settings
        unit = settings.weights.length * 100.0 / (2.4 * settings.scan_range_m)
        return Rates(
            unit=unit,
            height=settings.weights.height * 100.0 / settings.scan_range_m / unit,
            radar=settings.weights.radar * 300.0 / settings.scan_range_m / unit,
        )


def cost_rate(points_nea_m: FloatArray, world: DrawnWorld) -> FloatArray:
    """J per metre at points.  (S, 3) -> (S,)."""
    rates = Rates.of(world)
    band = world.ceiling_amsl_m - world.floor_amsl_m
    total = 1.0 + rates.height * (points_nea_m[:, 2] - world.floor_amsl_m) / band
    for radar in world.task.radars:
        distance = np.linalg.norm(points_nea_m - np.asarray(radar.centre_nea_m), axis=-1)
        seen = 1.0 / (1.0 + (distance / radar.range_m) ** 4)
        total = total + rates.radar * np.where(distance <= radar.range_m, seen, 0.0)
    return total * rates.unit


def curve_cost(curve: truth.Curve, world: DrawnWorld, until_m: float = math.inf) -> float:
    """J of a sampled curve, from its start as far as until_m along it."""
    until = min(until_m, float(curve.length_m[-1]))
    middle = 0.5 * (curve.points_nea_m[1:] + curve.points_nea_m[:-1])
    pieces = np.clip(until - curve.length_m[:-1], 0.0, np.diff(curve.length_m))
    return float(cost_rate(middle, world) @ pieces)
