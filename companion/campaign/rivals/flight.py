"""Flies a planner of whole routes through a drawn world, with full knowledge or with its own.

What flies is a point without turn radius or climb limit, lower where it can and higher where it
must.  With full knowledge it plans once.  With scans it sees, at each look, the ground within R
that nothing hides, takes what it has not seen as free, plans to the target, flies 0.375 R of that,
never over ground that it has not seen, and looks and plans again.  All rivals have this driver in
common; it shares the measure of cost and the surface of safe altitudes with the optimum of
`scripts/bench optimum`, and nothing with our planner.
"""

import math
import time
from dataclasses import dataclass
from typing import Literal, final

import numpy as np

from companion.campaign import drawn_world, truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.rivals.problem import (
    Field,
    FloatArray,
    NoRoute,
    RoutePlanner,
    RouteProblem,
    resampled,
)
from companion.campaign.route_cost import Rates

Knowledge = Literal["scans", "elevation", "full"]
"""Of the ground before the flight: none; a poor elevation file, for guidance; all of it."""
EVALUATIONS = {"scans": 20_000, "full": 100_000}
"""Lines that a planner by sampling may cost for one plan: seconds, where ours takes 10 ms."""

_FINE_PER_RANGE, _FINE_PER_CLEARANCE = 160, 0.4
_SPARE = 0.75  # of the fine lattice's spacing, kept beside the clearance: routes lie between points
_OFTEN = 0.375  # of R: how far it flies from one look ahead to the next
_STRAIGHT = 2.0  # of R: how far ahead the way is pulled straight
_MOST_IN_VAIN = 50  # plans in a row that lead nowhere
_ARRIVED = 1e-6


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RouteFlight:
    """What was flown."""

    points_nea_m: FloatArray
    """(S, 3), from the start as far as it came."""
    arrived: bool
    why: str
    """Why it did not arrive; empty if it did."""
    scans: int
    plan_s: tuple[float, ...]
    """Processor time of each plan."""
    stops: tuple[int, ...] = ()
    """Points at which it stood still, and may have turned on the spot."""
    subpaths_nea_m: tuple[FloatArray, ...] = ()
    """Control points (N, 3) of each, tail included, of who plans by subpaths."""


def fly(
    world: DrawnWorld,
    planner: RoutePlanner,
    *,
    knowledge: Knowledge = "scans",
    evaluations: int | None = None,
    seed: int = 1,
) -> RouteFlight:
    """Fly a world's mission, target by target.  Deterministic but for the times.

    evaluations: for one plan; None: `EVALUATIONS`.
    """
    evaluations = evaluations or EVALUATIONS[knowledge]
    explorer, rng = Explorer(world, everything=knowledge == "full"), np.random.default_rng(seed)
    flown, plan_s, why = [np.array(world.start_nea_m)], list[float](), ""
    for target in world.targets_ne_m:
        in_vain = 0
        while not why and math.dist(flown[-1][:2], target) > _ARRIVED:
            explorer.look(flown[-1][:2])
            problem = explorer.problem(flown[-1], np.array(target), evaluations)
            began_s = time.process_time()
            answer = planner(problem, rng)
            plan_s.append(time.process_time() - began_s)
            route = _checked(answer, problem)
            if isinstance(route, NoRoute):
                why = route.why
                break
            done = explorer.follow(route)
            in_vain = in_vain + 1 if len(done) == 1 else 0
            flown += done[1:]
            if in_vain == _MOST_IN_VAIN:
                why = f"{_MOST_IN_VAIN} plans in a row led nowhere"
    points = explorer.as_flown(np.array(flown))
    return RouteFlight(
        points_nea_m=points,
        arrived=not why,
        why=why,
        scans=explorer.looks,
        plan_s=tuple(plan_s),
    )


def _checked(answer: FloatArray | NoRoute, problem: RouteProblem) -> FloatArray | NoRoute:
    """The answer if it is a route from the start to the target."""
    if isinstance(answer, NoRoute):
        return answer
    route = np.asarray(answer, dtype=np.float64)
    if route.ndim != 2 or route.shape[1] != 3 or len(route) < 2 or not np.isfinite(route).all():
        return NoRoute(why=f"its answer of shape {route.shape} is no route: finite, (N, 3)")
    ends = (route[0, :2], problem.start_ne_m), (route[-1, :2], problem.target_ne_m)
    if any(math.dist(*pair) > 0.01 for pair in ends):
        return NoRoute(why="its route does not go from the start to the target")
    return route


@final
class Explorer:
    """What is known of a world, and what comes of following routes in it."""

    def __init__(self, world: DrawnWorld, *, everything: bool) -> None:
        self.world, self._rates = world, Rates.of(world)
        self._range_m, self._everything = world.task.settings.scan_range_m, everything
        required_m = world.task.required_clearance_m
        self._fine_m = min(self._range_m / _FINE_PER_RANGE, _FINE_PER_CLEARANCE * required_m)
        north, east = drawn_world.axes_m(world, self._fine_m)
        rows, columns = ((len(axis) - 1) // 4 * 4 + 1 for axis in (north, east))
        self._corner_ne_m = np.array([north[0], east[0]])
        self.north_m, self.east_m = north[:rows, None], east[None, :columns]
        clearance = required_m + _SPARE * self._fine_m
        need = drawn_world.lowest_safe_m(world, self._fine_m, clearance)
        self._need_m = need[:rows, :columns]
        self._height_m = truth.height_m(world.terrain, self.north_m[::2], self.east_m[:, ::2])
        self.seen = np.full(self._height_m.shape, everything)
        self._closed = np.zeros((rows, columns), dtype=bool)
        self._balked = self._closed.copy()  # a way over the lattice led there, but not through
        for zone in world.task.zones:
            away = zone.distance_m(*np.broadcast_arrays(self.north_m, self.east_m))
            self._closed |= away < clearance
        self.looks = 0

    def look(self, at_ne_m: FloatArray) -> None:
        """See the ground in range that nothing hides, from the altitude flown there."""
        if self._everything:
            return
        self.looks += 1
        step, size = 2.0 * self._fine_m, self._height_m.shape
        here = (at_ne_m - self._corner_ne_m) / step
        reach = math.floor(self._range_m / step)
        rows, columns = (
            np.arange(max(round(c) - reach, 0), min(round(c) + reach + 1, n))
            for c, n in zip(here.tolist(), size, strict=True)
        )
        row, column = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
        away = np.hypot(row - here[0], column - here[1])
        wanted = (away <= reach) & ~self.seen[row, column]
        row, column, away = row[wanted], column[wanted], away[wanted]
        altitude = self._altitude_m(at_ne_m[None, :])[0]
        target = self._height_m[row, column]
        free = np.ones(len(row), dtype=bool)
        for k in range(1, reach):
            left = np.nonzero(free & (away > k + 0.75))[0]
            share = k / away[left]
            n = np.rint(here[0] + share * (row[left] - here[0])).astype(np.intp)
            e = np.rint(here[1] + share * (column[left] - here[1])).astype(np.intp)
            line = altitude + share * (target[left] - altitude)
            free[left[self._height_m[n, e] > line]] = False
        self.seen[row[free], column[free]] = True

    def problem(
        self, start_nea_m: FloatArray, target_ne_m: FloatArray, evaluations: int
    ) -> RouteProblem:
        """The question that is to be asked from here, by what is known now."""
        return RouteProblem(
            task=self.world.task,
            field=self.field(start_nea_m[:2]),
            start_nea_m=start_nea_m,
            target_ne_m=target_ne_m,
            evaluations=evaluations,
            ahead_m=math.inf if self._everything else _STRAIGHT * self._range_m,
        )

    def field(self, at_ne_m: FloatArray) -> Field:
        """What a metre costs by what is known; where it is now is open."""
        world = self.world
        seen = np.repeat(np.repeat(self.seen, 2, axis=0), 2, axis=1)
        rows, columns = self._need_m.shape
        need = np.where(seen[:rows, :columns], self._need_m, -np.inf)
        band = world.ceiling_amsl_m - world.floor_amsl_m
        altitude = np.clip(need, world.floor_amsl_m, world.ceiling_amsl_m)
        rate = 1.0 + self._rates.height * (altitude - world.floor_amsl_m) / band
        for radar in world.task.radars:
            n, e, z = radar.centre_nea_m
            box = np.ix_(
                np.abs(self.north_m[:, 0] - n) <= radar.range_m,
                np.abs(self.east_m[0] - e) <= radar.range_m,
            )
            away2 = (self.north_m[box[0][:, 0]] - n) ** 2 + (self.east_m[:, box[1][0]] - e) ** 2
            ratio2 = (away2 + (altitude[box] - z) ** 2) / radar.range_m**2
            rate[box] += np.where(ratio2 <= 1.0, self._rates.radar / (1.0 + ratio2**2), 0.0)
        rate[self._closed | self._balked | (need > world.ceiling_amsl_m)] = np.inf
        field = Field(
            corner_ne_m=(float(self._corner_ne_m[0]), float(self._corner_ne_m[1])),
            spacing_m=self._fine_m,
            rate=rate,
            altitude_m=altitude,
        )
        here = tuple(field.index(at_ne_m))
        if not math.isfinite(rate[here]):
            rate[here] = 1.0 + self._rates.height  # it is there
        return field

    def follow(self, route_nea_m: FloatArray) -> list[FloatArray]:
        """What is flown of a route before the next plan: never over ground that it has not seen."""
        route = resampled(route_nea_m, 0.5 * self._fine_m)
        steps = math.ceil(_OFTEN * self._range_m / (0.5 * self._fine_m))
        if self._everything:
            steps = len(route)
        done = [route[0]]
        for point in route[1 : 1 + steps]:
            i, j = self._index(point[:2])
            if not self.seen[i // 2, j // 2]:
                self.look(done[-1][:2])
                self.seen[i // 2, j // 2] = True  # right ahead of it
            if self._closed[i, j] or self._need_m[i, j] > self.world.ceiling_amsl_m:
                self._balked[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2] = True
                break
            done.append(point)
        return done

    def as_flown(self, points_nea_m: FloatArray) -> FloatArray:
        """The points at their own altitude, or higher where the ground asks for it."""
        lowest = self._altitude_m(points_nea_m[:, :2])
        wanted = np.minimum(points_nea_m[:, 2], self.world.ceiling_amsl_m)
        return np.column_stack([points_nea_m[:, :2], np.maximum(wanted, lowest)])

    def _index(self, at_ne_m: FloatArray) -> tuple[int, int]:
        index = np.rint((at_ne_m - self._corner_ne_m) / self._fine_m).astype(np.intp)
        row, column = np.clip(index, 0, np.array(self._need_m.shape) - 1).tolist()
        return row, column

    def _altitude_m(self, at_ne_m: FloatArray) -> FloatArray:
        """Lowest safe altitude in the band, bilinear between the fine points.  (S, 2) -> (S,)."""
        last = np.array(self._need_m.shape) - 2
        at = (at_ne_m - self._corner_ne_m) / self._fine_m
        index = np.clip(np.floor(at), 0, last)
        i, j = index.astype(np.intp).T
        u, v = np.clip((at - index).T, 0.0, 1.0)
        need = self._need_m
        south = need[i, j] * (1 - v) + need[i, j + 1] * v
        result = (1 - u) * south + u * (need[i + 1, j] * (1 - v) + need[i + 1, j + 1] * v)
        return np.clip(result, self.world.floor_amsl_m, self.world.ceiling_amsl_m)
