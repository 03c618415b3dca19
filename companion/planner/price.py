"""What a subpath and all that follows it costs: the one price by which subpaths are compared.

All in metres of level flight at the floor of the band; guidance promises the least of them.
"""

import math
from collections.abc import Sequence
from functools import cache, partial
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.objective import PER_LENGTH, PER_SAMPLE, RADAR_SCALE
from companion.planner.cost_grid import descent_m
from companion.planner.field import CostToGo
from companion.planner.procedure import Leg
from companion.planner.request import Planned
from companion.planner.settings import Task
from companion.world.radars import detection_probability

_LEAST = 1e-9  # of the cost of R: where length has no weight, the cost alone decides
_LOOKS = 50  # along a straight piece, for radars
_LEAST_LENGTH = 1e-3  # its weight, beside that of height


@final
class Prices:
    """The prices of one plan."""

    def __init__(self, task: Task, field: CostToGo) -> None:
        self.task, self.field = task, field
        settings = task.settings
        cost_of_r = max(settings.weights.length * PER_LENGTH, _LEAST)
        self._per_cost_m = settings.scan_range_m / cost_of_r
        self._leg_of = cache(partial(Leg.of, number=1, rules=task))  # each is asked for often

    def promised_m(self, place_nea_m: Sequence[float]) -> float:
        """The predicted least from a place to the target."""
        return float(self.to_go_m(np.array(place_nea_m)))

    def to_go_m(self, places_nea_m: FloatArray) -> FloatArray:
        """The same from many: the way, coming down and climbing included.  (..., 3) -> (...)."""
        north, east, altitude = np.moveaxis(places_nea_m, -1, 0)
        task, needed_m = self.task, self.field.needed.altitude_m(north, east)
        down_m = np.maximum(descent_m(altitude, task) - descent_m(needed_m, task), 0.0)
        level_m = self.field.value.altitude_m(north, east)
        return np.asarray(level_m + down_m + self.climb_m(places_nea_m))

    def climb_m(self, places_nea_m: FloatArray) -> FloatArray:
        """The way that it takes to come up to where the way on can be climbed, likewise."""
        north, east, altitude = np.moveaxis(places_nea_m, -1, 0)
        short_m = self.field.needed.altitude_m(north, east) - altitude
        return np.maximum(short_m, 0.0) / math.tan(self.task.limits.climb_angle_rad)

    def after_m(self, planned: Planned) -> float:
        """What is predicted from where the next subpath starts: p_prog, or the end."""
        leg = self._leg_of(planned)
        at_m = leg.successor_at_m if leg.can_be_left else leg.subpath.length_m
        return self.promised_m(leg.subpath.pose(at_m).point_nea_m)

    def cost_m(self, planned: Planned) -> float:
        """A subpath and what follows; where none does, the mean of its radar term stands for R."""
        if planned.is_escape:
            return self._straight_m(planned)
        cost, settings = planned.cost + planned.to_go, self.task.settings
        if planned.reaches_target:
            share = min(planned.subpath.length_m / settings.scan_range_m, 1.0)
            cost -= (1.0 - share) * settings.weights.radar * planned.terms["radar"]
        return cost * self._per_cost_m

    def excess_m(self, planned: Planned) -> float:
        """How much more it costs than was promised at its start."""
        return self.cost_m(planned) - self.promised_m(planned.subpath.control_nea_m[0].tolist())

    def price_m(self, planned: Planned) -> float:
        """The cost, the time that a slow subpath takes longer, and a stop where it ends in one."""
        task, price_m = self.task, self.cost_m(planned)
        if planned.speed_m_s is not None:
            slower = task.limits.speed_m_s / planned.speed_m_s - 1.0
            price_m += slower * planned.subpath.length_m
        if not planned.reaches_target and not self._leg_of(planned).can_be_left:
            price_m += task.stop_m
        return price_m

    def cheaper(self, one: Planned | None, other: Planned | None) -> Planned | None:
        """Of two subpaths, the first one if they cost the same."""
        found = [each for each in (one, other) if each is not None]
        return min(found, key=self.price_m, default=None)

    def _straight_m(self, planned: Planned) -> float:
        """A straight piece, which no search has made, and what follows."""
        weights, (low, high) = self.task.settings.weights, self.task.band_amsl_m
        begin, end = planned.subpath.control_nea_m[[0, -1]]
        places = begin + np.linspace(0.0, 1.0, _LOOKS)[:, None] * (end - begin)
        seen = np.zeros(_LOOKS)
        for radar in self.task.radars:
            seen += detection_probability(radar.distance_m(places), radar.range_m)
        height = 100.0 * weights.height * float((places[:, 2].mean() - low) / (high - low))
        radars = PER_SAMPLE * RADAR_SCALE * weights.radar * float(seen.mean())
        rate = 1.0 + (height + radars) / (max(weights.length, _LEAST_LENGTH) * PER_LENGTH)
        return planned.subpath.length_m * rate + self.promised_m(end.tolist())
