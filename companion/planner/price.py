"""What a subpath and all that follows it costs: the one price by which subpaths are compared.

All in metres of level flight at the floor of the band; guidance promises the least of them.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.objective import PER_LENGTH, PER_SAMPLE, RADAR_SCALE
from companion.planner.cost_grid import descent_m
from companion.planner.field import CostToGo
from companion.planner.procedure import Leg
from companion.planner.progress import NO_PROGRESS, SLACK, Progress
from companion.planner.request import Planned
from companion.planner.settings import Task
from companion.world.radars import detection_probability

_OWED, _OWED_NEAR = 1.0, 0.25
"""Of R: what may be owed (`planner.progress`), if a stop costs no more; the second near things.

Chosen on 13 worlds of 20261128 (`walls`, `gathered`, `copter`: mean J 56.7, 51.1 and 52.1 with
0.25, 1 and 2), and on forests (218 and 240 s with 0.25 and 1 for seed 3001)."""
_LEAST = 1e-9  # of the cost of R: where length has no weight, the cost alone decides
_LOOKS = 50  # along a straight piece, for radars
_LEAST_LENGTH = 1e-3  # its weight, beside that of height


@final
@dataclass(frozen=True)  # no slots: legs are kept
class Prices:
    """The prices of one plan, and what the mission owes with them."""

    task: Task
    field: CostToGo
    progress: Progress = NO_PROGRESS  # at the start of the plan

    @cached_property
    def _leg_of(self) -> Callable[[Planned], Leg]:
        """The leg of a subpath: it is asked for often."""
        return cache(partial(Leg.of, number=1, rules=self.task))

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

    def cost_m(self, planned: Planned) -> float:
        """A subpath and what follows; where none does, the mean of its radar term stands for R."""
        if planned.is_escape:
            return self._straight_m(planned)
        cost, settings = planned.cost + planned.to_go, self.task.settings
        cost_of_r = max(settings.weights.length * PER_LENGTH, _LEAST)
        if planned.reaches_target:
            share = min(planned.subpath.length_m / settings.scan_range_m, 1.0)
            cost -= (1.0 - share) * settings.weights.radar * planned.terms["radar"]
        return cost * (settings.scan_range_m / cost_of_r)

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
        subpaths = [subpath for subpath in (one, other) if subpath is not None]
        return min(subpaths, key=self.price_m, default=None)

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

    # --- what is owed

    @property
    def allowed_m(self) -> float:
        """What may be owed."""
        share = _OWED_NEAR if self.task.settings.is_near else _OWED
        return max(self.task.stop_m, share * self.task.settings.scan_range_m)

    def owed_m(self, planned: Planned) -> float:
        """What the mission owes with this subpath; a straight piece only if more is left then."""
        if not planned.is_escape:
            return self.progress.owing(self.excess_m(planned), self.task.settings.scan_range_m)
        owed_m, stop_m = self.progress.owed_m, self.task.stop_m
        here_nea_m, end_nea_m = planned.subpath.control_nea_m[[0, -1]].tolist()
        more_m = self.promised_m(end_nea_m) - self.promised_m(here_nea_m)
        return owed_m + more_m + stop_m if more_m > 0.0 else owed_m

    def goes_round(self, planned: Planned) -> bool:
        """Whether the mission would owe more than a stop costs."""
        return not planned.reaches_target and self.owed_m(planned) > self.allowed_m

    def leads_away(self, here_nea_m: Sequence[float], end_nea_m: Sequence[float]) -> bool:
        """Whether the leg to an end is found to lead away, which was not known when it was chosen.

        Without news of it the vehicle would choose it again.
        """
        end_m, hardly_m = self.promised_m(end_nea_m), SLACK * self.task.settings.scan_range_m
        return end_m > self.promised_m(here_nea_m) and end_m > self.progress.end_m + hardly_m

    def with_progress(self, planned: Planned) -> Planned:
        """The subpath, and what is owed and left by the same map where the next one starts.

        That is p_prog, or the end.
        """
        leg = self._leg_of(planned)
        at_m = leg.successor_at_m if leg.can_be_left else leg.subpath.length_m
        left_m = self.promised_m(leg.subpath.pose(at_m).point_nea_m)
        end_m = self.promised_m(planned.subpath.control_nea_m[-1].tolist())
        owed_m = self.owed_m(planned)
        progress = replace(self.progress, owed_m=owed_m, expected_m=left_m, end_m=end_m)
        return replace(planned, progress=progress)
