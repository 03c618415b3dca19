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
from companion.planner.settings import Task
from companion.world.guess import Guess
from companion.world.known_map import KnownMap
from companion.world.zones import too_near

Place = tuple[float, float]

BLOCKED = 300.0
"""Cost per metre where nothing may fly: a detour of 300 times as much is shorter on any map."""
_GUESSED_BLOCKED = 30.0  # where that is only guessed: if all is blocked, it is looked at first
_BARRING = 1e4  # cost per metre where an edge is not to be used: far above BLOCKED
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
        begin = np.ascontiguousarray(np.broadcast_to(begin, end.shape))
        costs: FloatArray = kernels.compiled().guidance.lines_m(self.samples, begin, end)
        return costs

    @staticmethod
    def of(known: KnownMap, guess: Guess, task: Task, extent: Extent) -> "CostGrid":
        """Costs over a map."""
        (rows, columns), step_m = extent.count, extent.cells * known.cell_m
        north_min_m = known.north_min_m + extent.first[0] * known.cell_m
        east_min_m = known.east_min_m + extent.first[1] * known.cell_m
        grid = CostGrid(
            extent=extent,
            north_min_m=north_min_m,
            east_min_m=east_min_m,
            samples=Grid.empty(rows, columns, step_m),
            shut=np.zeros((rows, columns), dtype=bool),
            costly=np.zeros((rows, columns), dtype=bool),
            known=known,
            guess=guess,
            task=task,
        )
        _close(grid)
        _fill(grid, (slice(0, rows), slice(0, columns)))
        return grid

    def after(
        self, known: KnownMap, guess: Guess, task: Task, extent: Extent
    ) -> tuple["CostGrid", BoolArray] | None:
        """Costs as they are now, and the lattice points with an edge whose cost has changed.

        None: they are to be computed anew.
        """
        geometry, of_old = (
            (m.cell_m, m.north_min_m, m.east_min_m, m.registration_m, m.upper_m.shape)
            for m in (known, self.known)
        )
        if extent != self.extent or geometry != of_old or task != self.task:
            return None
        box = self._to_fill(known, guess)
        grid = replace(self, known=known, guess=guess)
        touched = np.zeros(self.shape, dtype=bool)
        if box is not None:
            rows, columns = (
                slice(max(part.start - 1, 0), part.stop + 1) for part in box
            )  # what is steep is so beside it, too
            samples = grid.samples
            sheets = [
                grid.sheet(each)[rows, columns]
                for each in (samples.cost, samples.barring, samples.height, samples.ramp_m)
            ]
            before = [each.copy() for each in sheets]
            _fill(grid, box)
            changed: BoolArray = np.zeros(before[0].shape, dtype=bool)
            for old, new in zip(before, sheets, strict=True):
                changed |= old != new
            first = rows.start, columns.start
            kernels.compiled().guidance.touched(changed, first, touched)
        return grid, touched

    def _to_fill(self, known: KnownMap, guess: Guess) -> _Box | None:
        """The samples whose costs another map may change.  None: there are none.

        What is continued from what was seen may change anywhere.
        """
        rows, columns = self.extent.count
        cells = _changed(self.known, known)
        if cells is None and guess.near is None and self.guess.near is None:
            return None
        if cells is None or not (guess.near is None and self.guess.near is None):
            return slice(0, rows), slice(0, columns)
        reach, parts = _reach(self), []
        for part, first, count in zip(cells, self.extent.first, self.extent.count, strict=True):
            every = self.extent.cells
            low = max(-((first + reach - 1 - part.start) // every), 0)
            high = min((part.stop - 1 + reach - first) // every + 1, count)
            if low >= high:
                return None
            parts.append(slice(low, high))
        return parts[0], parts[1]


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


def _close(grid: CostGrid) -> None:
    """Where zones forbid to be, are nearer than the search keeps from them, or the map ends so."""
    known, task = grid.known, grid.task
    north, east = grid.samples_m
    if task.zones:
        places, gaps = (
            (tuple(north[:, 0].tolist()), tuple(east[0].tolist())),
            kernels.compiled().zone_gaps,
        )
        grid.shut[:] |= too_near(task.zones, *places, task.zone_search_clearance_m, gaps)
    rows, columns = known.upper_m.shape
    gap_m = [
        np.minimum(at - low, low + count * known.cell_m - at)
        for at, low, count in ((north, known.north_min_m, rows), (east, known.east_min_m, columns))
    ]
    grid.shut[:] |= np.minimum(*gap_m) < task.search_clearance_m  # what is beyond may be terrain


def _fill(grid: CostGrid, box: _Box) -> None:
    """Compute the costs of some samples."""
    task, samples = grid.task, grid.samples
    limits, weights = task.limits, task.settings.weights
    per_length = max(weights.length, 1e-3) / _TERMS
    per_height = weights.height / per_length
    floor_m, band_m = limits.floor_amsl_m, limits.ceiling_amsl_m - limits.floor_amsl_m
    inset_m = task.search_clearance_m - task.settings.safety_distance_m  # as from the terrain
    lowest_m = _lowest_m(grid, box)
    altitude_m = np.clip(lowest_m, floor_m, limits.ceiling_amsl_m)
    flown_m, unproven = altitude_m.copy(), (lowest_m > floor_m) & ~_seen(grid, box)
    flown_m[unproven] = np.maximum(_bound_m(grid, box, unproven), altitude_m[unproven])
    fraction = (altitude_m - floor_m) / band_m
    above = np.maximum(lowest_m - (limits.ceiling_amsl_m - inset_m), 0.0) / band_m
    shut, detection = grid.shut[box], _detection(grid, box, altitude_m)
    blocked = (above > 0.0) | shut
    grid.sheet(samples.cost)[box] = (
        1.0
        + per_height * (flown_m - floor_m) / band_m
        + _RADAR * weights.radar / per_length * detection
        + np.where(unproven & ~shut, _GUESSED_BLOCKED, BLOCKED) * (blocked + above)
    )
    grid.sheet(samples.height)[box] = per_height * fraction
    grid.sheet(samples.ramp_m)[box] = (
        0.5 * per_height * fraction**2 * band_m / math.tan(limits.climb_angle_rad)
    )
    grid.sheet(samples.lowest_m)[box] = altitude_m
    grid.costly[box] = blocked | (detection > 0.0)
    _bar(grid, box)


def _bar(grid: CostGrid, box: _Box) -> None:
    """Bar long edges from samples, in a box and one beside it, next to which ground is steep.

    There the height for a ramp costs more than the height of the ground.
    """
    wide, inner = [], []
    for part, count in zip(box, grid.extent.count, strict=True):
        wide.append(slice(max(part.start - 2, 0), min(part.stop + 2, count)))
        low, high = max(part.start - 1, 0), min(part.stop + 1, count)
        inner.append(slice(low - wide[-1].start, high - wide[-1].start))
    samples = grid.samples
    ramp_m, height = (grid.sheet(each)[*wide] for each in (samples.ramp_m, samples.height))
    steep = np.zeros(ramp_m.shape, dtype=bool)
    if ramp_m.any():
        for axis in (0, 1):
            level_m = samples.step_m * 0.5 * _sums(height, axis)
            found = np.abs(np.diff(ramp_m, axis=axis)) > level_m
            steep[: -1 if axis == 0 else None, : -1 if axis == 1 else None] |= found
            steep[1 if axis == 0 else 0 :, 1 if axis == 1 else 0 :] |= found
    barring = grid.sheet(samples.cost)[*wide] + _BARRING * steep
    grid.sheet(samples.barring)[*wide][*inner] = barring[*inner]


def _sums(values: FloatArray, axis: int) -> FloatArray:
    """Of neighbours along an axis."""
    return values[1:] + values[:-1] if axis == 0 else values[:, 1:] + values[:, :-1]


def _reach(grid: CostGrid) -> int:
    """Cells on each side of a sample that may come nearer than the clearance.

    On a wide grid, whose samples are far apart, only the four cells at a sample count.
    """
    reach = math.ceil(
        (grid.task.search_clearance_m + grid.known.registration_m) / grid.known.cell_m
    )
    return 1 if grid.extent.cells > 2 * (reach + 1) else reach + 1


def _rises_m(grid: CostGrid) -> FloatArray:
    """By how much over a cell the clearance is kept, by how many cells are between, north and east.

    -inf beyond the clearance.  Cells count with their highest terrain over their whole square.
    """
    apart = np.arange(_reach(grid)) * grid.known.cell_m
    away_m = np.hypot(apart[:, None], apart[None, :]) - grid.known.registration_m
    squared = grid.task.search_clearance_m**2 - np.maximum(away_m, 0.0) ** 2
    return np.where(squared > 0.0, np.sqrt(np.maximum(squared, 0.0)), -np.inf)


def _lowest_m(grid: CostGrid, box: _Box) -> FloatArray:
    """The lowest altitude that keeps the clearance from terrain as it is believed to be, AMSL.

    Exact above the floor of the band.
    """
    reach, every = _reach(grid), grid.extent.cells
    first = [low + every * part.start for low, part in zip(grid.extent.first, box, strict=True)]
    index = []
    for at, part, size in zip(first, box, grid.known.upper_m.shape, strict=True):
        vertices = at + every * np.arange(part.stop - part.start)
        if every <= 2 * reach:  # neighbours share cells
            cells = np.arange(at - reach, vertices[-1] + reach)
        else:
            cells = np.add.outer(vertices, np.arange(-reach, reach)).ravel()
        index.append(cells[(cells >= 0) & (cells < size)])
    lowest_m = np.full([part.stop - part.start for part in box], -np.inf)
    least_m = grid.task.limits.floor_amsl_m - grid.task.search_clearance_m
    tops_m = grid.guess.at(index[0], index[1])
    kernels.compiled().guidance.raise_to(
        lowest_m, tops_m, index[0], index[1], (first[0], first[1]), every, _rises_m(grid), least_m
    )
    return lowest_m


def _vertices(grid: CostGrid, box: _Box) -> list[IndexArray]:
    """Rows and columns of the map's vertices at some samples."""
    return [
        first + grid.extent.cells * np.arange(part.start, part.stop)
        for first, part in zip(grid.extent.first, box, strict=True)
    ]


def _bound_m(grid: CostGrid, box: _Box, where: BoolArray) -> FloatArray:
    """As `_lowest_m`, from what is known to bound the terrain, up to the ceiling.  -> (N,)."""
    rows, columns = _vertices(grid, box)
    row, column = np.nonzero(where)
    most_m = grid.task.limits.ceiling_amsl_m
    bound: FloatArray = kernels.compiled().guidance.bound_m(
        grid.known.upper_m, rows[row], columns[column], _rises_m(grid), most_m
    )
    return bound


def _seen(grid: CostGrid, box: _Box) -> BoolArray:
    """Whether the terrain of the four cells at each sample is known."""
    known = grid.known
    result = np.ones([part.stop - part.start for part in box], dtype=bool)
    rows, columns = _vertices(grid, box)
    for south, west in np.ndindex(2, 2):
        row, column = (
            np.clip(at - before, 0, size - 1)
            for at, before, size in zip(
                (rows, columns), (south, west), known.seen.shape, strict=True
            )
        )
        at = np.ix_(row, column)
        result &= known.seen[at] if known.given is None else known.seen[at] | known.given[at]
    return result


def _detection(grid: CostGrid, box: _Box, altitude_m: FloatArray) -> FloatArray:
    """Eq. 3, summed over the radars.

    Half a step of margin: straight lines between samples outside stay out.
    """
    north, east = grid.samples_m
    north, east = north[box[0], 0], east[0, box[1]]
    total, margin_m = np.zeros(altitude_m.shape), 0.5 * grid.step_m
    middle = 0.5 * float(north[0] + north[-1]), 0.5 * float(east[0] + east[-1])
    across_m = math.hypot(north[-1] - north[0], east[-1] - east[0])
    for radar in grid.task.radars_near(middle, 0.5 * across_m + margin_m):
        kernels.compiled().guidance.add_detection(
            total, north, east, altitude_m, (*radar.centre_nea_m, radar.range_m), margin_m
        )
    return total


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
