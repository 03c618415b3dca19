"""The question that planners of whole routes are asked, and what they may answer."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, final

import numpy as np
from numpy.typing import NDArray

from companion.planner.settings import Task

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

_NOT_FREE = 2.0  # times its cost: what a piece counts that is barred between the grid's points


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Field:
    """A world as known: what a metre costs at the lowest safe altitude, on a square lattice."""

    corner_ne_m: tuple[float, float]
    """Of point (0, 0): the south-west corner of the map."""
    spacing_m: float
    rate: FloatArray
    """(rows, columns): cost per metre in metres of level flight at the floor, so never below 1;
    infinite: no one may be there."""
    altitude_m: FloatArray
    """(rows, columns): the lowest safe altitude AMSL within the band, by what is known."""

    def index(self, at_ne_m: FloatArray) -> IntArray:
        """Row and column of the nearest points.  (..., 2) -> (..., 2)."""
        index = np.rint((at_ne_m - np.asarray(self.corner_ne_m)) / self.spacing_m).astype(np.intp)
        return np.clip(index, 0, np.array(self.rate.shape) - 1)

    def place_m(self, index: IntArray) -> FloatArray:
        """North and east of points.  (..., 2) -> (..., 2)."""
        return np.asarray(self.corner_ne_m) + self.spacing_m * np.asarray(index)

    def rate_at(self, at_ne_m: FloatArray) -> FloatArray:
        """The rate at the nearest points.  (..., 2) -> (...)."""
        index = self.index(at_ne_m)
        return self.rate[index[..., 0], index[..., 1]]

    def line_cost(self, a_ne_m: FloatArray, b_ne_m: FloatArray) -> float:
        """Cost of a straight line, in metres of level flight; infinite: it is not free."""
        length = math.dist(a_ne_m, b_ne_m)
        count = max(math.ceil(length / (0.5 * self.spacing_m)), 2)
        points = a_ne_m + np.linspace(0.0, 1.0, count + 1)[:, None] * (b_ne_m - a_ne_m)
        return length * float(self.rate_at(points).mean())

    def _piece_cost(self, a_ne_m: FloatArray, b_ne_m: FloatArray) -> float:
        """Of a piece that the grid took for free, and that may not quite be."""
        cost = self.line_cost(a_ne_m, b_ne_m)
        if math.isfinite(cost):
            return cost
        rates = self.rate_at(self.even(np.array([a_ne_m, b_ne_m])))
        length = math.dist(a_ne_m, b_ne_m)
        return _NOT_FREE * length * float(rates[np.isfinite(rates)].mean())

    def even(self, route_ne_m: FloatArray) -> FloatArray:
        """The same route in steps of half the spacing.  (N, 2) or (N, 3) -> (S, same)."""
        return resampled(route_ne_m, 0.5 * self.spacing_m)

    def straightened(self, route_ne_m: FloatArray, ahead_m: float) -> FloatArray:
        """A route with lines in place of its bends where they cost no more, as far as ahead_m."""
        along = _along_m(route_ne_m)
        last = min(int(np.searchsorted(along, ahead_m)), len(route_ne_m) - 1)
        pieces = [self._piece_cost(a, b) for a, b in pairwise(route_ne_m)]
        cost = np.concatenate([[0.0], np.cumsum(pieces)])
        kept, here = [0], 0
        while here < last:
            there = next(
                (
                    k
                    for k in range(last, here + 1, -1)
                    if self.line_cost(route_ne_m[here], route_ne_m[k]) <= cost[k] - cost[here]
                ),
                here + 1,
            )
            kept.append(there)
            here = there
        return np.concatenate([route_ne_m[kept], route_ne_m[here + 1 :]])


def resampled(route: FloatArray, step_m: float) -> FloatArray:
    """Points evenly along a route, both ends included, at most a step apart.  (N, K) -> (S, K)."""
    along = _along_m(route[:, :2])
    count = max(math.ceil(along[-1] / step_m), 1)
    at = np.linspace(0.0, along[-1], count + 1)
    return np.stack([np.interp(at, along, column) for column in route.T], axis=-1)


def _along_m(route_ne_m: FloatArray) -> FloatArray:
    steps = np.linalg.norm(np.diff(route_ne_m, axis=0), axis=-1)
    return np.concatenate([[0.0], np.cumsum(steps)])


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RouteProblem:
    """From a start to a target, by what is known now."""

    task: Task
    """Limits, radars, zones and distances of the mission."""
    field: Field
    """The world as known; what nobody has seen is free."""
    start_nea_m: FloatArray
    target_ne_m: FloatArray
    evaluations: int
    """How many lines may be costed; a planner that does not sample needs no limit."""
    ahead_m: float
    """How far ahead it will be flown before the next question: further on, details do not count."""

    @property
    def start_ne_m(self) -> FloatArray:
        """North and east of the start."""
        return self.start_nea_m[:2]

    def route(self, route_ne_m: FloatArray) -> FloatArray:
        """A plane route with straight pieces, pulled straight and at its altitudes.  -> (S, 3)."""
        return self.raised(self.field.straightened(route_ne_m, self.ahead_m))

    def raised(self, route_ne_m: FloatArray) -> FloatArray:
        """A plane route in small steps, each at the lowest safe altitude.  (N, 2) -> (S, 3)."""
        even = self.field.even(route_ne_m)
        index = self.field.index(even)
        return np.column_stack([even, self.field.altitude_m[index[:, 0], index[:, 1]]])


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NoRoute:
    """Why there is none."""

    why: str


class RoutePlanner(Protocol):
    """Plans a whole route; also what an entry point `companion.planners` names."""

    def __call__(self, problem: RouteProblem, rng: np.random.Generator) -> FloatArray | NoRoute:
        """Points (N, 3) from the start to the target, flown straight from one to the next."""
        ...
