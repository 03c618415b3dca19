"""What flying costs, sampled over a grid of the map, for the field (`field`).

Costs are those of the objective (`companion.objective`) in metres of level flight at the
floor of the band, so that they add to the cost of a subpath.  Per metre of way:

- 1 for the length (f1: a_1 100 / 2.4 R);
- the height that the known terrain asks for (f2: a_2 100 / R from floor to ceiling);
- radars (f5: a_5 300 / R per unit of eq. 3, at that height);
- 300 where a zone forbids to be or where terrain reaches above the ceiling: finite, so that there
  is always a way out, and it is the short one; 30 where that terrain is only guessed.

Ground that no scan has seen counts as it is guessed (`companion.world.guess`); where nothing is
guessed it is free, also where a sight line bounds it: that bound grows with distance and would make
a wall of every shadow.  Unseen ground that has to be flown over costs the altitude that its bound
asks for, the ceiling where it has none: what is behind a saddle is proven only from above it, so
ways over it are flown high and in short legs, and a way round is rarely dearer.

Among near things, what stands is taken to go on: unseen ground beside it costs three times as much.
"""

import enum
import math
from typing import final

import numpy as np

from companion import jit
from companion.geodesy import BoolArray, FloatArray
from companion.planner import cheapest_ways, cost_samples
from companion.planner.cheapest_ways import Box, Grid, IndexArray
from companion.planner.cost_samples import BLOCKED, Ground, Scale
from companion.planner.settings import Task
from companion.world.guess import Blocks, believed_m
from companion.world.known_map import KnownMap, Lattice
from companion.world.zones import too_near

Place = tuple[float, float]

_STEPS_PER_RANGE = 40
"""Steps between samples in R: two to a cell of the lattice.  A certified leg spans ten or more
cells; with 48 directions the error is that of directions, not of cells, and a gap of one and a half
cells stays open (both by test)."""
_MOST_CELLS = 640
"""Lattice cells across a map, 32 R; those of a larger map are wider: to solve it takes a second."""
_GOES_ON, _GOES_ON_RANGES = 2.0, 0.25
"""What a metre of unseen ground costs more beside a near thing, and how far from it, in R.  Else
the way is believed to lead round the end of what was seen of a wall, wherever that is, and legs end
there (decision 0021)."""
_REACH_CELLS = 2  # lattice points within so many cells of a place are joined to it directly
_TERMS = 2.4  # f1 is 100 for a way of 2.4 R, f2 for one of R at the ceiling (eq. 6, 7)
_RADAR = 3.0  # f5 is 300 for a way of R at a radar (`objective.RADAR_SCALE` for each of ten)


class Belief(enum.Enum):
    """What is taken to be where nothing was seen."""

    GUESSED = enum.auto()
    """What was seen, continued (`companion.world.guess`)."""
    BOUNDED = enum.auto()
    """As much as sight lines leave room for; where none does, nothing."""
    FREE = enum.auto()
    """Nothing."""


@final
class CostGrid:
    """Costs at the points of a lattice and halfway between them, kept up to date."""

    def __init__(self, known: KnownMap, task: Task, belief: Belief = Belief.GUESSED) -> None:
        """Of a map of which nothing is known: `update` says what is."""
        every = max(
            round(task.settings.scan_range_m / (_STEPS_PER_RANGE * known.cell_m)),
            math.ceil(max(known.shape) / (2 * _MOST_CELLS)),
            1,
        )
        height, width = known.shape
        rows, columns = max(height // (2 * every), 1) + 1, max(width // (2 * every), 1) + 1
        self.task, self.belief = task, belief
        self.corner_ne_m = known.north_min_m, known.east_min_m
        """Of the first sample."""
        self.step_m = every * known.cell_m
        """Distance between samples: half a cell of the lattice."""
        self.shape = 2 * rows - 1, 2 * columns - 1
        """Rows and columns of samples."""
        self.lattice_shape = rows, columns
        """Rows and columns of lattice points."""
        self.samples = Grid.empty(rows, columns, self.step_m)
        self.ground = Ground(
            seen_m=np.full(self.shape, -np.inf),
            guess_m=np.full(self.shape, task.limits.floor_amsl_m),
            shut=self._shut(known),
            costly=np.zeros(self.shape, dtype=bool),
            beside=np.zeros(self.shape),
            extra=np.zeros(self.shape),
        )
        self._kind, self._scale = _kind_of(known, task), _scale(task, known, every)
        self._of: int | None = None
        """The name of the map that costs are of."""
        self._blocks = Blocks(known.shape, 2 * every)
        self._open = np.zeros(self.shape, dtype=bool)
        """The samples that may be guessed: beside them nothing has been told."""
        goes_on_m = _GOES_ON_RANGES * task.settings.scan_range_m
        near = task.settings.is_near and belief is Belief.GUESSED
        self._far = goes_on_m / self.step_m if near else 0.0
        """By how many samples what stands is taken to go on."""

    def _shut(self, known: KnownMap) -> BoolArray:
        """Where zones forbid to be, or what is beyond the map, which may be terrain."""
        task = self.task
        near_m = task.zone_search_clearance_m
        shut = too_near(task.zones, self.corner_ne_m, self.step_m, self.shape, near_m).copy()
        for axis, (low, cells) in enumerate(zip(self.corner_ne_m, known.shape, strict=True)):
            at = low + self.step_m * np.arange(self.shape[axis])
            inside_m = np.minimum(at - low, low + cells * known.cell_m - at)
            shut |= np.expand_dims(inside_m < task.search_clearance_m, 1 - axis)
        return shut

    # --- what is known

    def fits(self, known: KnownMap, task: Task) -> bool:
        """Whether it can be brought up to date with a map; else a new one is to be made."""
        return self._kind == _kind_of(known, task)

    def update(self, known: KnownMap, here_ne_m: Place) -> BoolArray:
        """Costs as they are now.  -> the lattice points with an edge whose cost has changed.

        here_ne_m: what was seen is continued about it where it was not; not without guesses.
        """
        box = self._look_at(known)
        if self._is_guessed:  # all of it is another guess
            self.ground.guess_m[:] = self._continued_m(known, here_ne_m)
            box = 0, self.shape[0], 0, self.shape[1]
        touched: BoolArray = jit.compiled(cost_samples.fill)(
            self.samples, self.ground, box, self.corner_ne_m, known.upper_m, known.surveyed,
            self._scale,
        )  # fmt: skip
        return touched

    def _look_at(self, known: KnownMap) -> Box:
        """Take over what has changed.  -> the samples that may ask for another altitude."""
        scale, ground, window = self._scale, self.ground, known.changed_since(self._of)
        self._of = known.name
        if window[0].start == window[0].stop:
            return 0, 0, 0, 0
        if window == known.changed_since(None):  # what is told for guidance may differ, too
            ground.guess_m[:] = scale.floor_m
            self._open = self._not_told(known.guess_m)
        if self._is_guessed:
            self._blocks.update(known, window)
        every, reach, box, about = scale.every, len(scale.rises_m), list[int](), list[slice]()
        for part, count, cut in zip(window, self.shape, known.shape, strict=True):
            low = max((part.start - reach) // every, 0)
            high = min((part.stop + reach) // every + 1, count)
            box += [low, high]
            about.append(slice(max(low * every - reach, 0), min(high * every + reach, cut)))
        tops_m = believed_m(known, *about)
        if self.belief is Belief.BOUNDED:
            bound_m = known.upper_m[*about]
            tops_m = np.where(np.isfinite(bound_m), bound_m, tops_m)
        first = about[0].start, about[1].start
        jit.compiled(cost_samples.raise_to)(ground.seen_m, tuple(box), tops_m, first, scale)
        where: Box = jit.compiled(cost_samples.go_on)(
            ground.seen_m, scale.highest_m, tuple(box), self._far, _GOES_ON, ground.beside
        )
        return where

    def _not_told(self, told_m: FloatArray | None) -> BoolArray:
        """The samples beside which nothing has been told for guidance."""
        if told_m is None:
            return np.ones(self.shape, dtype=bool)
        row, column = (
            np.minimum(self._scale.every * np.arange(count), cut - 1)
            for count, cut in zip(self.shape, told_m.shape, strict=True)
        )
        return np.isnan(told_m[np.ix_(row, column)])

    @property
    def _is_guessed(self) -> bool:
        """Whether anything is."""
        return self.belief is Belief.GUESSED and bool(self._open.any())

    def _continued_m(self, known: KnownMap, here_ne_m: Place) -> FloatArray | float:
        """`Ground.guess_m`: linear between the points of the lattice."""
        scale, goes_on = self._scale, self._blocks.continued(known.cell_of(*here_ne_m))
        if goes_on is None:
            return scale.floor_m
        rows, columns = (4 * scale.every * np.arange(count) for count in self.lattice_shape)
        ground_m = goes_on.at_m(rows, columns) + scale.rises_m[0, 0]
        result = np.empty(self.shape)
        result[::2, ::2] = ground_m
        result[1::2, ::2] = 0.5 * (ground_m[:-1] + ground_m[1:])
        result[:, 1::2] = 0.5 * (result[:, :-1:2] + result[:, 2::2])
        return np.where(self._open, np.maximum(result, scale.floor_m), scale.floor_m)

    # --- places

    def sample_of(self, points_ne_m: FloatArray) -> FloatArray:
        """Row and column among the samples, not rounded.  (..., 2) -> (..., 2)."""
        return (points_ne_m - self.corner_ne_m) / self.step_m

    def points_m(self, index: IndexArray) -> FloatArray:
        """North, east of lattice points.  (K,) -> (K, 2)."""
        row_column = np.stack(np.divmod(index, self.lattice_shape[1]), axis=-1)
        return self.corner_ne_m + 2.0 * self.step_m * row_column

    def box_about(self, place: Place, reach: int) -> Box:
        """The lattice points up to so many rows and columns from the one nearest to a place."""
        box = list[int]()
        for at, low, count in zip(place, self.corner_ne_m, self.lattice_shape, strict=True):
            middle = min(max(round((at - low) / self.step_m / 2.0), 0), count - 1)
            box += [max(middle - reach, 0), min(middle + reach + 1, count)]
        return box[0], box[1], box[2], box[3]

    def around(self, place: Place) -> IndexArray:
        """The lattice points that are joined to a place directly.  -> (K,)."""
        south, north, west, east = self.box_about(place, _REACH_CELLS)
        first = self.lattice_shape[1] * np.arange(south, north)
        return np.add.outer(first, np.arange(west, east)).ravel()

    def lines_m(self, place: Place, to_ne_m: FloatArray) -> FloatArray:
        """Costs of straight lines from a place.  (K, 2) -> (K,)."""
        costs: FloatArray = jit.compiled(cheapest_ways.lines_m)(
            self.samples, self.sample_of(np.array(place)), self.sample_of(to_ne_m)
        )
        return costs

    def bars(self, route_ne_m: FloatArray) -> bool:
        """Whether a route comes to a sample where nothing may fly.  (K, 2), north and east."""
        at = np.rint(self.sample_of(sampled(route_ne_m, 0.5 * self.step_m))).astype(np.intp)
        at = at[((at >= 0) & (at < self.shape)).all(axis=1)]
        return bool((self.samples.cost.reshape(self.shape)[*at.T] >= BLOCKED).any())


def _scale(task: Task, known: KnownMap, every: int) -> Scale:
    limits, weights, clearance_m = task.limits, task.settings.weights, task.search_clearance_m
    per_length = max(weights.length, 1e-3) / _TERMS
    per_height = weights.height / per_length
    reach = math.ceil((clearance_m + known.registration_m) / known.cell_m) + 1
    apart_m = np.arange(reach) * known.cell_m
    away_m = np.hypot(apart_m[:, None], apart_m[None, :]) - known.registration_m
    squared = clearance_m**2 - np.maximum(away_m, 0.0) ** 2
    return Scale(
        every=every,
        floor_m=limits.floor_amsl_m,
        ceiling_m=limits.ceiling_amsl_m,
        highest_m=limits.ceiling_amsl_m - (clearance_m - task.settings.safety_distance_m),
        per_height=per_height,
        per_radar=_RADAR * weights.radar / per_length,
        radars=np.array(
            [(*radar.centre_nea_m, radar.range_m) for radar in task.radars], dtype=np.float64
        ).reshape(-1, 4),
        rises_m=np.where(squared > 0.0, np.sqrt(np.maximum(squared, 0.0)), -np.inf),
    )


def _kind_of(known: KnownMap, task: Task) -> tuple[Task, Lattice, float, bool]:
    return task, known.bare(), known.registration_m, known.guess_m is None


def sampled(route_ne_m: FloatArray, step_m: float, most_m: float = math.inf) -> FloatArray:
    """Points so far apart along a route, from its start on.  (K, 2) -> (N, 2)."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(route_ne_m, axis=0).T)))
    at = np.arange(0.0, min(along[-1], most_m), step_m)
    return np.stack([np.interp(at, along, route_ne_m[:, axis]) for axis in (0, 1)], axis=-1)


def descent_m(altitude_m: FloatArray | float, task: Task) -> FloatArray:
    """What it costs to come down to the floor: the height on the way, in metres of level flight.

    (...) -> (...).
    """
    weights, limits = task.settings.weights, task.limits
    per_height = weights.height * _TERMS / max(weights.length, 1e-3)
    band = limits.ceiling_amsl_m - limits.floor_amsl_m
    fraction = np.clip((altitude_m - limits.floor_amsl_m) / band, 0.0, 1.0)
    return 0.5 * per_height * fraction**2 * band / math.tan(limits.dive_angle_rad)
