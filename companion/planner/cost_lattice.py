"""What flying costs, sampled over a lattice of the map, for the cost-to-go (`cost_to_go`).

Costs are those of the objective (`companion.objective.terms`) in metres of level flight at the
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
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np
import numpy.typing as npt
import scipy

from companion.geodesy import BoolArray, FloatArray
from companion.planner.kernels import compiled
from companion.planner.settings import Task
from companion.world.guess import Guess, taken
from companion.world.known_map import KnownMap
from companion.world.radars import detection_probability
from companion.world.zones import too_near

Place = tuple[float, float]
IndexArray = npt.NDArray[np.int32]

MAX_CELLS = 160  # across; a larger map is coarse beyond a window of this size
BLOCKED = 300.0  # cost per metre where nothing may fly
_GUESSED_BLOCKED = 30.0  # where that is only guessed: if all is blocked, it is looked at first
_REACH_CELLS = 2  # lattice points within so many cells of a place are joined to it directly
_MAX_PIECES = 400  # of a straight line


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lattice:
    """Costs at the lattice points and halfway between them: (2 rows - 1, 2 columns - 1)."""

    north_min_m: float
    east_min_m: float
    step_m: float
    """Distance between samples: half a cell of the lattice."""
    cost: FloatArray
    """Per metre of way."""
    height: FloatArray
    """The part of `cost` that is due to height."""
    ramp_m: FloatArray
    """What the height of the steepest climb from the floor to here costs."""
    lowest_m: FloatArray
    """The altitude that the terrain asks for, within the limits, AMSL."""
    costly: BoolArray
    """Blocked, or seen by a radar."""
    covers_map: bool

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of lattice points."""
        return (self.cost.shape[0] + 1) // 2, (self.cost.shape[1] + 1) // 2

    @property
    def samples_m(self) -> tuple[FloatArray, FloatArray]:
        """North (2 rows - 1, 1) and east (1, 2 columns - 1) of the samples."""
        north = self.north_min_m + self.step_m * np.arange(float(self.cost.shape[0]))
        east = self.east_min_m + self.step_m * np.arange(float(self.cost.shape[1]))
        return north[:, None], east[None, :]

    def holds(self, place: Place) -> bool:
        """Whether a place lies within the lattice."""
        u, v = self.sample_of(np.array([place]))[0]
        return bool(0 <= u <= self.cost.shape[0] - 1 and 0 <= v <= self.cost.shape[1] - 1)

    def sample_of(self, points_ne_m: FloatArray) -> FloatArray:
        """Row and column among the samples, not rounded.  (..., 2) -> (..., 2)."""
        return (points_ne_m - (self.north_min_m, self.east_min_m)) / self.step_m

    def points_m(self, index: IndexArray) -> FloatArray:
        """North, east of lattice points.  (K,) -> (K, 2)."""
        rows, columns = np.divmod(index, self.shape[1])
        corner = np.array([self.north_min_m, self.east_min_m])
        return corner + 2.0 * self.step_m * np.stack([rows, columns], axis=-1)

    def around(self, place: Place) -> IndexArray:
        """The lattice points about a place, or the nearest ones if it lies outside."""
        middle = np.rint(self.sample_of(np.array(place)) / 2.0)
        near = [
            np.arange(
                np.clip(middle[axis] - _REACH_CELLS, 0, self.shape[axis] - 1),
                np.clip(middle[axis] + _REACH_CELLS, 0, self.shape[axis] - 1) + 1,
            )
            for axis in (0, 1)
        ]
        return np.add.outer(near[0] * self.shape[1], near[1]).ravel().astype(np.int32)


def sampled(route_ne_m: FloatArray, step_m: float, most_m: float = math.inf) -> FloatArray:
    """Points so far apart along a route, from its start on.  (K, 2) -> (N, 2)."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(route_ne_m, axis=0).T)))
    at = np.arange(0.0, min(along[-1], most_m), step_m)
    return np.stack([np.interp(at, along, route_ne_m[:, axis]) for axis in (0, 1)], axis=-1)


def bars(lattices: Sequence[Lattice], route_ne_m: FloatArray) -> bool:
    """Whether a route comes to a sample where nothing may fly.  (K, 2), north and east.

    lattices: the first that holds a point counts there.  It is looked at twice a sample.
    """
    left = sampled(route_ne_m, 0.5 * lattices[0].step_m)
    for lattice in lattices:
        samples = np.rint(lattice.sample_of(left)).astype(np.intp)
        inside = ((samples >= 0) & (samples < lattice.cost.shape)).all(axis=1)
        if (lattice.cost[tuple(samples[inside].T)] >= BLOCKED).any():
            return True
        left = left[~inside]
    return False


def line_cost_m(lattice: Lattice, from_ne_m: FloatArray, to_ne_m: FloatArray) -> FloatArray:
    """Costs of straight lines.  (K, 2) or (2,), (K, 2) -> (K,)."""
    offset = to_ne_m - from_ne_m
    length = np.hypot(offset[:, 0], offset[:, 1])
    most = float(length.max(initial=0.0)) / lattice.step_m
    pieces = min(max(math.ceil(most), 1), _MAX_PIECES)
    along = np.linspace(0.0, 1.0, pieces + 1)[:, None, None]
    place = np.moveaxis(lattice.sample_of(from_ne_m + along * offset), -1, 0)  # (2, S, K)
    piece_m = length / pieces
    cost = _sampled(lattice.cost, place)
    total = 0.5 * (cost[1:] + cost[:-1]).sum(axis=0) * piece_m
    if lattice.ramp_m.any():
        ramp, height = _sampled(lattice.ramp_m, place), _sampled(lattice.height, place)
        level = 0.5 * (height[1:] + height[:-1]) * piece_m
        total += np.maximum(np.abs(np.diff(ramp, axis=0)) - level, 0.0).sum(axis=0)
    return total


def _sampled(field: FloatArray, place: FloatArray) -> FloatArray:
    return scipy.ndimage.map_coordinates(field, place, order=1, mode="nearest")


def lattice_of(known: KnownMap, guess: Guess, task: Task, here_ne_m: Place, cells: int) -> Lattice:
    """Costs on a lattice of samples `cells` cells of the map apart, aligned with the map.

    The whole map, or a window about here if that is more than 160 cells across.
    """
    first, count, whole = [], [], True
    for axis, here in enumerate(known.cell_of(*here_ne_m)):
        across = max(known.upper_m.shape[axis] // (2 * cells), 1)
        size = min(across, MAX_CELLS)
        middle = round(here / (2 * cells)) - size // 2
        first.append(2 * cells * min(max(middle, 0), across - size))
        count.append(2 * size + 1)
        whole &= size == across
    step = cells * known.cell_m
    lowest = _lowest_m(known, guess.at, task, first, count, cells)
    proven = _lowest_m(known, partial(taken, known.upper_m), task, first, count, cells)
    north_min = known.north_min_m + first[0] * known.cell_m
    east_min = known.east_min_m + first[1] * known.cell_m
    north = north_min + step * np.arange(count[0])[:, None]
    east = east_min + step * np.arange(count[1])[None, :]
    limits, weights = task.limits, task.settings.weights
    per_length = max(weights.length, 1e-3) / 2.4  # a_1 / 2.4 R, per metre; times R
    per_height = weights.height / per_length
    band = limits.ceiling_amsl_m - limits.floor_amsl_m
    inset = task.search_clearance_m - task.settings.safety_distance_m  # as from the terrain
    unproven = (lowest > limits.floor_amsl_m) & ~_seen(known, first, count, cells)
    above = np.maximum(lowest - (limits.ceiling_amsl_m - inset), 0.0) / band
    altitude = np.clip(lowest, limits.floor_amsl_m, limits.ceiling_amsl_m)
    fraction = (altitude - limits.floor_amsl_m) / band
    flown_m = np.where(unproven, np.clip(proven, altitude, limits.ceiling_amsl_m), altitude)
    seen = _detection(task, north, east, altitude, step)
    shut = _in_zone(task, north, east) | _at_edge(known, task, north, east)
    blocked = (above > 0.0) | shut
    cost = (
        1.0
        + per_height * (flown_m - limits.floor_amsl_m) / band
        + 3.0 * weights.radar / per_length * seen
    )
    return Lattice(
        north_min_m=north_min,
        east_min_m=east_min,
        step_m=step,
        cost=cost + np.where(unproven & ~shut, _GUESSED_BLOCKED, BLOCKED) * (blocked + above),
        height=per_height * fraction,
        ramp_m=0.5 * per_height * fraction**2 * band / math.tan(limits.climb_angle_rad),
        lowest_m=altitude,
        costly=blocked | (seen > 0.0),
        covers_map=whole,
    )


def descent_m(altitude_m: float, task: Task) -> float:
    """What it costs to come down to the floor: the height on the way, in metres of level flight."""
    weights, limits = task.settings.weights, task.limits
    per_height = weights.height * 2.4 / max(weights.length, 1e-3)
    band = limits.ceiling_amsl_m - limits.floor_amsl_m
    fraction = min(max((altitude_m - limits.floor_amsl_m) / band, 0.0), 1.0)
    return 0.5 * per_height * fraction**2 * band / math.tan(limits.dive_angle_rad)


def _seen(known: KnownMap, first: list[int], count: list[int], cells: int) -> BoolArray:
    """Whether the terrain of the four cells at each sample is known.  -> count."""
    firm = known.firm
    result = np.ones((count[0], count[1]), dtype=bool)
    for south, west in np.ndindex(2, 2):
        rows, columns = (
            np.clip(first[axis] + cells * np.arange(count[axis]) - before, 0, size - 1)
            for axis, (before, size) in enumerate(zip((south, west), firm.shape, strict=True))
        )
        result &= firm.take(rows, axis=0).take(columns, axis=1)
    return result


def _lowest_m(
    known: KnownMap,
    believed_m: Callable[[IndexArray, IndexArray], FloatArray],
    task: Task,
    first: list[int],
    count: list[int],
    cells: int,
) -> FloatArray:
    """The lowest altitude that keeps the clearance from terrain as it is believed to be, AMSL.

    At vertices of the map's cells, every `cells` of them from `first`; cells count with their
    highest terrain over their whole square.  -> count; -inf where nothing is near.
    On the wide lattice, whose samples are far apart, only the four cells at a vertex count.
    """
    clearance = task.search_clearance_m
    reach = math.ceil((clearance + known.registration_m) / known.cell_m) + 1
    stride = cells
    if cells > 2 * reach:
        reach, stride = 1, 2
    (rows, south_north), (columns, west_east) = (
        _cells_about(first[axis], count[axis], cells, reach, known.upper_m.shape[axis])
        for axis in (0, 1)
    )
    upper = believed_m(rows, columns).astype(np.float32)
    upper = np.pad(upper, (south_north, west_east), mode="edge")
    lowest, part = np.full((2, count[0], count[1]), -np.inf, dtype=np.float32)
    if not (upper > task.limits.floor_amsl_m - clearance).any():
        return lowest.astype(np.float64)
    last = 2 * reach - 1
    for left in range(reach):  # cells to the west and east, south and north are as far away
        strip, other = (upper[:, at::stride][:, : count[1]] for at in (left, last - left))
        strip = np.maximum(strip, other)
        for down in range(reach):
            gaps = ((reach - 1 - at) * known.cell_m for at in (down, left))
            gap = max(math.hypot(*gaps) - known.registration_m, 0.0)
            if gap < clearance:
                south, north = (strip[at::stride][: count[0]] for at in (down, last - down))
                np.maximum(south, north, out=part)
                part += math.sqrt(clearance**2 - gap**2)
                np.maximum(lowest, part, out=lowest)
    return lowest.astype(np.float64)


def _cells_about(
    first: int, count: int, cells: int, reach: int, size: int
) -> tuple[IndexArray, tuple[int, int]]:
    """Indices of the cells within reach of `count` vertices, and how many are beyond the map.

    Before and behind it; there its last cell counts.
    """
    if cells <= 2 * reach:  # neighbouring vertices share cells
        begin, end = first - reach, first + cells * (count - 1) + reach
        index = np.arange(max(begin, 0), min(end, size), dtype=np.int32)
        return index, (max(-begin, 0), max(end - size, 0))
    index = np.add.outer(first + cells * np.arange(count), np.arange(-reach, reach)).ravel()
    return np.clip(index, 0, size - 1).astype(np.int32), (0, 0)


def _detection(
    task: Task, north: FloatArray, east: FloatArray, altitude_m: FloatArray, step_m: float
) -> FloatArray:
    """Eq. 3, summed over the radars.  North (rows, 1), east (1, columns) -> (rows, columns).

    Half a step of margin: straight lines between samples outside stay out.
    """
    margin = 0.5 * step_m
    total = np.zeros(altitude_m.shape)
    middle = 0.5 * (north[0, 0] + north[-1, 0]), 0.5 * (east[0, 0] + east[0, -1])
    across = math.hypot(north[-1, 0] - north[0, 0], east[0, -1] - east[0, 0])
    radars = task.radars_near(middle, 0.5 * across + margin)
    centres = np.array([radar.centre_nea_m for radar in radars]).reshape(-1, 3)
    ranges_m = np.array([radar.range_m for radar in radars])
    # the lattice points in the square about each: one row for each radar and row of points
    reach = (ranges_m + margin)[:, None] * (-1.0, 1.0)
    south_north = np.searchsorted(north[:, 0], centres[:, :1] + reach)
    west_east = np.searchsorted(east[0], centres[:, 1:2] + reach)
    radar, row = _runs(*south_north.T)
    of, column = _runs(*west_east[radar].T)
    radar, row = radar[of], row[of]
    squared = (altitude_m[row, column] - centres[radar, 2]) ** 2
    squared += (north[row, 0] - centres[radar, 0]) ** 2 + (east[0, column] - centres[radar, 1]) ** 2
    seen = detection_probability(np.sqrt(squared), ranges_m[radar], margin)
    np.add.at(total, (row, column), seen)
    return total


def _runs(
    first: npt.NDArray[np.integer], end: npt.NDArray[np.integer]
) -> tuple[npt.NDArray[np.integer], npt.NDArray[np.integer]]:
    """All of first[k]..end[k] - 1, for each k one after the other -> k, index.  (N,) x2 -> (M,)."""
    count = end - first
    k = np.repeat(np.arange(len(count)), count)
    index = np.arange(len(k)) - np.repeat(np.cumsum(count) - count, count) + first[k]
    return k, index


def _at_edge(known: KnownMap, task: Task, north: FloatArray, east: FloatArray) -> BoolArray:
    """Where the map ends nearer than the clearance: what lies beyond counts as terrain.

    North (rows, 1), east (1, columns) -> (rows, columns).
    """
    rows, columns = known.upper_m.shape
    gap_m = [
        np.minimum(at - low, low + count * known.cell_m - at)
        for at, low, count in ((north, known.north_min_m, rows), (east, known.east_min_m, columns))
    ]
    return np.asarray(np.minimum(*gap_m) < task.search_clearance_m)


def _in_zone(task: Task, north: FloatArray, east: FloatArray) -> BoolArray:
    """Where zones forbid to be, or are nearer than the search keeps from them."""
    if not task.zones:
        return np.zeros((north.shape[0], east.shape[1]), dtype=bool)
    places, gaps = (tuple(north[:, 0].tolist()), tuple(east[0].tolist())), compiled().zone_gaps
    return too_near(task.zones, *places, task.zone_search_clearance_m, gaps)
