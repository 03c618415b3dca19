"""What flying costs, sampled over a grid of the map, for the field (`field`).

Costs are those of the objective (`companion.objective.kernel`) in metres of level flight at the
floor of the band, so that they add to the cost of a subpath.  Per metre of way:

- 1 for the length (f1: a_1 100 / 2.4 R);
- the height that the known terrain asks for (f2: a_2 100 / R from floor to ceiling), and where
  it rises faster than the vehicle climbs, the height of the ramp before and behind it;
- radars (f5: a_5 300 / R per unit of eq. 3, at that height);
- 300 where a zone forbids to be or where terrain reaches above the ceiling: finite, so that there
  is always a way out, and it is the short one; 30 where that terrain is only guessed.

Ground that no scan has seen counts as it is guessed (`companion.world.guess`); where nothing is
guessed it is free, also where a sight line bounds it: that bound grows with distance and would make
a wall of every shadow.  Unseen ground that has to be flown over costs the altitude that its bound
asks for, the ceiling where it has none: what is behind a saddle is proven only from above it, so
ways over it are flown high and in short legs, and a way round is rarely dearer.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from companion.geodesy import BoolArray, FloatArray
from companion.planner import kernels
from companion.planner.cheapest_ways import Grid, IndexArray
from companion.planner.cost_samples import BLOCKED, Scale
from companion.planner.settings import Task
from companion.world.guess import Guess
from companion.world.known_map import KnownMap
from companion.world.zones import too_near

Place = tuple[float, float]

_REACH_CELLS = 2  # lattice points within so many cells of a place are joined to it directly
_TERMS = 2.4  # f1 is 100 for a way of 2.4 R, f2 for one of R at the ceiling (eq. 6, 7)
_RADAR = 3.0  # f5 is 300 for a way of R at a radar (`scene.RADAR_SCALE` for each of ten samples)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Extent:
    """Which samples a grid has: vertices of the map's cells."""

    cells: int
    """Every so many of them."""
    first: tuple[int, int]
    """Row and column of the first."""
    count: tuple[int, int]
    """(2 rows - 1, 2 columns - 1)."""
    is_whole: bool
    """Whether these are all of the map."""

    @staticmethod
    def whole(known: KnownMap, cells: int) -> "Extent":
        """All of a map."""
        rows, columns = (2 * max(size // (2 * cells), 1) + 1 for size in known.upper_m.shape)
        return Extent(cells=cells, first=(0, 0), count=(rows, columns), is_whole=True)


_Box = tuple[slice, slice]
"""Rows and columns of some samples, or cells."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CostGrid:
    """Costs at the points of a lattice and halfway between them.

    Changed in place by the grid that comes `after` it.
    """

    extent: Extent
    north_min_m: float
    east_min_m: float
    samples: Grid
    shut: BoolArray
    """(2 rows - 1, 2 columns - 1), where zones or the edge of the map forbid to be."""
    costly: BoolArray
    """Blocked, or seen by a radar."""
    known: KnownMap
    guess: Guess
    task: Task
    remembered: KnownMap
    """The map that the costs are of, for comparison: a copy that nobody else changes."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of lattice points."""
        rows, columns = self.extent.count
        return (rows + 1) // 2, (columns + 1) // 2

    @property
    def step_m(self) -> float:
        """Distance between samples: half a cell of the lattice."""
        return self.samples.step_m

    def sheet(self, values: FloatArray) -> FloatArray:
        """Values of the samples, or a view of them, by rows and columns."""
        return values.reshape(self.extent.count)

    @property
    def samples_m(self) -> tuple[FloatArray, FloatArray]:
        """North (2 rows - 1, 1) and east (1, 2 columns - 1) of the samples."""
        rows, columns = self.extent.count
        north = self.north_min_m + self.step_m * np.arange(float(rows))
        east = self.east_min_m + self.step_m * np.arange(float(columns))
        return north[:, None], east[None, :]

    def holds(self, place: Place) -> bool:
        """Whether a place lies within the grid."""
        u, v = self.sample_of(np.array(place))
        rows, columns = self.extent.count
        return bool(0 <= u <= rows - 1 and 0 <= v <= columns - 1)

    def sample_of(self, points_ne_m: FloatArray) -> FloatArray:
        """Row and column among the samples, not rounded.  (..., 2) -> (..., 2)."""
        return (points_ne_m - (self.north_min_m, self.east_min_m)) / self.step_m

    def points_m(self, index: IndexArray) -> FloatArray:
        """North, east of lattice points.  (K,) -> (K, 2)."""
        rows, columns = np.divmod(index, self.shape[1])
        corner = np.array([self.north_min_m, self.east_min_m])
        return corner + 2.0 * self.step_m * np.stack([rows, columns], axis=-1)

    def around(self, place: Place, reach: int = _REACH_CELLS) -> IndexArray:
        """The lattice points about a place, or about the one nearest to it.  -> (K,)."""
        rows, columns = self.box_about(place, reach)
        across = self.shape[1]
        row, column = np.arange(rows.start, rows.stop), np.arange(columns.start, columns.stop)
        return np.add.outer(row * across, column).ravel()

    def box_about(self, place: Place, reach: int) -> _Box:
        """Rows and columns of the lattice points up to so many from the one nearest to a place."""
        middle = np.clip(
            np.rint(self.sample_of(np.array(place)) / 2.0), 0, np.array(self.shape) - 1
        )
        rows, columns = (
            slice(max(int(m) - reach, 0), min(int(m) + reach + 1, n))
            for m, n in zip(middle, self.shape, strict=True)
        )
        return rows, columns

    def lines_m(self, from_ne_m: FloatArray, to_ne_m: FloatArray) -> FloatArray:
        """Costs of straight lines.  (K, 2) or (1, 2), (K, 2) -> (K,)."""
        begin, end = self.sample_of(from_ne_m), self.sample_of(to_ne_m)
        begin = np.array(np.broadcast_to(begin, end.shape))  # not of another kind: compiled once
        costs: FloatArray = kernels.compiled().guidance.lines_m(self.samples, begin, end)
        return costs

    @staticmethod
    def of(known: KnownMap, guess: Guess, task: Task, extent: Extent) -> "CostGrid":
        """Costs over a map."""
        (rows, columns), step_m = extent.count, extent.cells * known.cell_m
        grid = CostGrid(
            extent=extent,
            north_min_m=known.north_min_m + extent.first[0] * known.cell_m,
            east_min_m=known.east_min_m + extent.first[1] * known.cell_m,
            samples=Grid.empty(rows, columns, step_m),
            shut=np.zeros((rows, columns), dtype=bool),
            costly=np.zeros((rows, columns), dtype=bool),
            known=known,
            guess=guess,
            task=task,
            remembered=replace(known, upper_m=known.upper_m.copy(), seen=known.seen.copy()),
        )
        north, east = grid.samples_m
        if task.zones:
            places, gaps = (
                (tuple(north[:, 0].tolist()), tuple(east[0].tolist())),
                kernels.compiled().zone_gaps,
            )
            grid.shut[:] |= too_near(task.zones, *places, task.zone_search_clearance_m, gaps)
        for at, low, size in zip(
            (north, east),
            (known.north_min_m, known.east_min_m),
            known.upper_m.shape,
            strict=True,
        ):  # what is beyond the map may be terrain
            edge_m = np.minimum(at - low, low + size * known.cell_m - at)
            grid.shut[:] |= edge_m < task.search_clearance_m
        grid._fill((slice(0, rows), slice(0, columns)), np.zeros(grid.shape, dtype=bool))
        return grid

    def after(
        self, known: KnownMap, guess: Guess, task: Task, extent: Extent
    ) -> tuple["CostGrid", BoolArray] | None:
        """Costs as they are now, and the lattice points with an edge whose cost has changed.

        None: they are to be computed anew.
        """
        geometry, before = (
            (m.cell_m, m.north_min_m, m.east_min_m, m.registration_m, m.upper_m.shape)
            for m in (known, self.remembered)
        )
        if extent != self.extent or geometry != before or task != self.task:
            return None
        old = self.remembered
        cells = _changed(old, known)
        if cells is not None:
            old.upper_m[cells], old.seen[cells] = known.upper_m[cells], known.seen[cells]
            old = replace(old, given=known.given, guess_m=known.guess_m)
        box = self._to_fill(cells, guess)
        grid = replace(self, known=known, guess=guess, remembered=old)
        touched = np.zeros(self.shape, dtype=bool)
        if box is not None:
            grid._fill(box, touched)
        return grid, touched

    def _to_fill(self, cells: _Box | None, guess: Guess) -> _Box | None:
        """The samples whose costs changed cells, or another guess, may change.  None: none.

        What is continued from what was seen may change anywhere.
        """
        rows, columns = self.extent.count
        if not (guess.near is None and self.guess.near is None):
            return slice(0, rows), slice(0, columns)
        if cells is None:
            return None
        reach, parts = self._reach, []
        for part, first, count in zip(cells, self.extent.first, self.extent.count, strict=True):
            every = self.extent.cells
            low = max(-((first + reach - 1 - part.start) // every), 0)
            high = min((part.stop - 1 + reach - first) // every + 1, count)
            if low >= high:
                return None
            parts.append(slice(low, high))
        return parts[0], parts[1]

    @property
    def _reach(self) -> int:
        """Cells on each side of a sample that may come nearer than the clearance.

        On a wide grid, whose samples are far apart, only the four cells at a sample count.
        """
        known = self.known
        wide_m = self.task.search_clearance_m + known.registration_m
        reach = math.ceil(wide_m / known.cell_m) + 1
        return 1 if self.extent.cells > 2 * reach else reach

    def _scale(self) -> Scale:
        task, known = self.task, self.known
        limits, weights = task.limits, task.settings.weights
        per_length = max(weights.length, 1e-3) / _TERMS
        per_height = weights.height / per_length
        band_m = limits.ceiling_amsl_m - limits.floor_amsl_m
        inset_m = task.search_clearance_m - task.settings.safety_distance_m  # as from the terrain
        apart_m = np.arange(self._reach) * known.cell_m
        away_m = np.hypot(apart_m[:, None], apart_m[None, :]) - known.registration_m
        squared = task.search_clearance_m**2 - np.maximum(away_m, 0.0) ** 2
        return Scale(
            floor_m=limits.floor_amsl_m,
            ceiling_m=limits.ceiling_amsl_m,
            highest_m=limits.ceiling_amsl_m - inset_m,
            per_height=per_height,
            per_radar=_RADAR * weights.radar / per_length,
            per_ramp_m=0.5 * per_height * band_m / math.tan(limits.climb_angle_rad),
            radars=np.array(
                [(*radar.centre_nea_m, radar.range_m) for radar in task.radars], dtype=np.float64
            ).reshape(-1, 4),
            rises_m=np.where(squared > 0.0, np.sqrt(np.maximum(squared, 0.0)), -np.inf),
        )

    def _fill(self, box: _Box, touched: BoolArray) -> None:
        """Compute the costs of some samples."""
        known, scale, every = self.known, self._scale(), self.extent.cells
        guidance, reach = kernels.compiled().guidance, self._reach
        vertices = [
            first + every * np.arange(count)
            for first, count in zip(self.extent.first, self.extent.count, strict=True)
        ]
        first = int(vertices[0][box[0].start]), int(vertices[1][box[1].start])
        cells = []
        for at, part, size in zip(vertices, box, known.upper_m.shape, strict=True):
            low, high = at[part][0] - reach, at[part][-1] + reach
            index = np.arange(low, high)
            if every > 2 * reach:  # neighbours share no cells
                index = np.add.outer(at[part], np.arange(-reach, reach)).ravel()
            cells.append(index[(index >= 0) & (index < size)])
        lowest_m = np.full([part.stop - part.start for part in box], -np.inf)
        guidance.raise_to(
            lowest_m,
            self.guess.at(*cells),
            tuple(cells),
            first,
            every,
            scale.rises_m,
            scale.floor_m - self.task.search_clearance_m,
        )
        north, east = self.samples_m
        guidance.fill(
            self.samples,
            (box[0].start, box[0].stop, box[1].start, box[1].stop),
            lowest_m,
            tuple(vertices),
            known.upper_m,
            known.surveyed,
            (north[:, 0], east[0]),
            self.shut,
            self.costly,
            scale,
            touched,
        )


def _changed(old: KnownMap, new: KnownMap) -> _Box | None:
    """The rows and columns of the cells in which two maps differ; None: there are none."""
    changed = (old.upper_m != new.upper_m) | (old.seen != new.seen)
    for one, other in ((old.given, new.given), (old.guess_m, new.guess_m)):
        if one is other:
            continue
        if one is None or other is None:
            changed[:] = True
        else:
            changed |= (one != other) & ~((one != one) & (other != other))  # NaN is as NaN
    rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    if not len(rows):
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def sampled(route_ne_m: FloatArray, step_m: float, most_m: float = math.inf) -> FloatArray:
    """Points so far apart along a route, from its start on.  (K, 2) -> (N, 2)."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(route_ne_m, axis=0).T)))
    at = np.arange(0.0, min(along[-1], most_m), step_m)
    return np.stack([np.interp(at, along, route_ne_m[:, axis]) for axis in (0, 1)], axis=-1)


def bars(grids: Sequence[CostGrid], route_ne_m: FloatArray) -> bool:
    """Whether a route comes to a sample where nothing may fly.  (K, 2), north and east.

    grids: the first that holds a point counts there.  It is looked at twice a sample.
    """
    left = sampled(route_ne_m, 0.5 * grids[0].step_m)
    for grid in grids:
        samples = np.rint(grid.sample_of(left)).astype(np.intp)
        inside = ((samples >= 0) & (samples < grid.extent.count)).all(axis=1)
        if (grid.sheet(grid.samples.cost)[tuple(samples[inside].T)] >= BLOCKED).any():
            return True
        left = left[~inside]
    return False


def descent_m(altitude_m: float, task: Task) -> float:
    """What it costs to come down to the floor: the height on the way, in metres of level flight."""
    weights, limits = task.settings.weights, task.limits
    per_height = weights.height * _TERMS / max(weights.length, 1e-3)
    band = limits.ceiling_amsl_m - limits.floor_amsl_m
    fraction = min(max((altitude_m - limits.floor_amsl_m) / band, 0.0), 1.0)
    return 0.5 * per_height * fraction**2 * band / math.tan(limits.dive_angle_rad)
