"""The field: what it costs from anywhere to the target, and the best way from here.

Over a lattice of cells of R / 20, the cheapest ways by what flying costs (`cost_grid`), found and
repaired by `cheapest_ways`.  A map of more than 320 lattice cells across is looked at twice: all of
it coarsely, and a window about here in full, whose rim holds the costs of the coarse one.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import final

import numpy as np
import scipy

from companion.geodesy import BoolArray, FloatArray
from companion.planner import kernels
from companion.planner.cheapest_ways import Costs, IndexArray
from companion.planner.cost_grid import CostGrid, Extent, Place, bars
from companion.planner.cost_samples import BLOCKED
from companion.planner.settings import Task
from companion.world.clearance import Surface
from companion.world.guess import Guess, guess_of
from companion.world.known_map import KnownMap

_CELLS_PER_RANGE = 20
"""Lattice cells in R.  A certified leg spans ten or more of them; with 48 directions the error is
that of directions, not of cells, and a gap of one and a half cells stays open (both by test)."""
_WHOLE_CELLS = 320
"""Lattice cells across a map that is looked at whole: 16 R, 0.1 million points."""
_WINDOW_CELLS, _SNAP_CELLS = 160, 40
"""Across the window on a larger map, 8 R, and how far it moves at a time: its rim is 3 R away."""
_GIVEN_RANGES = 1.6
"""Of R about here: as far costs are given.  Legs end within R, and look ahead by a turn radius, of
R / 2 at most."""
_CORRIDOR = 0.2  # of R on either side of the previous route
_CORRIDOR_RANGES = 4.0  # of R about here, in which it counts
_DISCOUNT = 0.03
"""On costs in the corridor, when another way looks cheaper.  Without it missions in `valley` take
9 % longer and cost 10 % more (decision 0009)."""
_ONE_SIDE_CELLS = 4.0
"""Free neighbours of a point differ by less than so many cells of way if they lie on one side of
it: they are two cells apart at most, and not on ground that costs more than twice the least."""
_MANY = 0.25  # of all points: if more are touched, solving anew is faster than repairing


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CostToGo:
    """Cost to the target within 1.6 R of here, in metres of level flight at the floor.

    Always finite.
    """

    value: Surface
    """The cost at lattice points, bilinear between them and clamped at the edges.

    Points inside threats and blocked terrain that border on free ones hold the cost of these, so
    that interpolation near an edge stays true.
    """
    needed: Surface
    """The lowest altitude from which the way on can be climbed, AMSL, likewise."""
    route_ne_m: tuple[Place, ...]
    """The cheapest way from here to the target."""
    undisputed: Surface
    """`value` without the discount of the corridor: by this one is told whether one gets on."""
    is_barred: bool
    """Whether even that leads through what may not be flown."""

    def at_m(self, north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Cost from points to the target.  (...) x2 -> (...)."""
        return self.value.altitude_m(north_m, east_m)

    def leaving_rad(self, centre_ne_m: Place, radius_m: float) -> float:
        """Bearing, from the centre of a circle, of the point where the route first leaves it.

        Radians clockwise from the frame's north.  Towards the target if the route stays inside.
        """
        there = self.route_ne_m[-1]
        for a, b in pairwise(self.route_ne_m):
            crossing = _leaves(a, b, centre_ne_m, radius_m)
            if crossing is not None:
                there = crossing
                break
        return math.atan2(there[1] - centre_ne_m[1], there[0] - centre_ne_m[0])


@final
class Memory:
    """What guidance keeps from one plan to the next, so that it looks at changes only.

    Answers do not depend on it, to the last digit.  One plan at a time.
    """

    def __init__(self) -> None:
        self.near, self.wide = _Solver(), _Solver()


_idle: list[Memory] = []
"""What plans before have left.  It is taken out while it is used: by one plan, of one thread."""


def cost_to_go(
    known: KnownMap,
    task: Task,
    here_ne_m: Place,
    target_ne_m: Place,
    previous_route_ne_m: tuple[Place, ...] = (),
    memory: Memory | None = None,
    *,
    guesses: bool = True,
) -> CostToGo:
    """The cost to the target over what is known, and the way from here.

    Parameters
    ----------
    known, task
        The map and the threats, limits and weights.
    here_ne_m, target_ne_m
        North, east; both may be anywhere, also off the map or inside a threat.
    previous_route_ne_m
        The route of the previous scan.  When the cheapest way now leaves its corridor (0.2 R to
        either side), costs in the corridor count 3 % less, so that a small gain does not make
        the vehicle change sides.  The discount is left out as long as nobody disputes the
        route: values are then exact, and ends of subpaths are not drawn to the corridor.
    memory
        Of the plans before: it makes this one faster.  None: what the last plan has left.
    guesses
        Whether what was seen is continued where it was not; else that is free.
    """
    mine = memory or (_idle.pop() if _idle else Memory())
    field = _found(
        mine, known, task, (here_ne_m, target_ne_m), previous_route_ne_m, guesses=guesses
    )
    if memory is None and not _idle:
        _idle.append(mine)
    return field


def _found(
    memory: Memory,
    known: KnownMap,
    task: Task,
    ends_ne_m: tuple[Place, Place],
    previous_route_ne_m: tuple[Place, ...],
    *,
    guesses: bool,
) -> CostToGo:
    """`cost_to_go`."""
    (here_ne_m, target_ne_m), range_m = ends_ne_m, task.settings.scan_range_m
    guess = guess_of(known, here_ne_m, range_m) if guesses else Guess.nothing(known)
    cells = max(round(range_m / (2 * _CELLS_PER_RANGE * known.cell_m)), 1)
    extent, far = _extent(known, here_ne_m, cells), None
    if not extent.is_whole:
        most = max(known.upper_m.shape)
        whole = Extent.whole(known, max(math.ceil(most / (2 * _WINDOW_CELLS)), 1))
        far = memory.wide
        far.update(known, guess, task, whole)
        far.solve(_seeds(far.grid, target_ne_m))
    near = memory.near
    near.update(known, guess, task, extent)
    seeds = _seeds(near.grid, target_ne_m)
    if far is not None:
        border = _border_seeds(near.grid, far)
        seeds = border | seeds if near.grid.holds(target_ne_m) else border
    near.solve(seeds)
    solved, route = near, _route(near, far, here_ne_m, target_ne_m)
    corridor_m = _CORRIDOR * range_m
    if _disputed(route, previous_route_ne_m, corridor_m):
        inside = _corridor(near.grid, here_ne_m, previous_route_ne_m, corridor_m)
        solved = near.discounted(inside, here_ne_m, range_m)
        route = _route(solved, far, here_ne_m, target_ne_m)
    grids = [near.grid] if far is None else [near.grid, far.grid]
    value, needed = _given(solved, here_ne_m, target_ne_m, task)
    undisputed = value if solved is near else _given(near, here_ne_m, target_ne_m, task)[0]
    return CostToGo(
        value=value,
        needed=needed,
        route_ne_m=route,
        undisputed=undisputed,
        is_barred=bars(grids, np.array(route)),
    )


def _extent(known: KnownMap, here_ne_m: Place, cells: int) -> Extent:
    """All of the map, or what is looked at in full of a larger one."""
    across = [max(size // (2 * cells), 1) for size in known.upper_m.shape]
    if max(across) <= _WHOLE_CELLS:
        return Extent.whole(known, cells)
    first, count = [], []
    for size, here in zip(across, known.cell_of(*here_ne_m), strict=True):
        some = min(size, _WINDOW_CELLS)
        middle = _SNAP_CELLS * round(here / (2 * cells * _SNAP_CELLS)) - some // 2
        first.append(2 * cells * min(max(middle, 0), size - some))
        count.append(2 * some + 1)
    return Extent(
        cells=cells, first=(first[0], first[1]), count=(count[0], count[1]), is_whole=False
    )


_Seeds = dict[int, float]
"""Lattice points from which the way on is known, and its cost."""


def _seeds(grid: CostGrid, target_ne_m: Place) -> _Seeds:
    """The lattice points about the target, with the cost of the straight line to it."""
    index = grid.around(target_ne_m)
    cost_m = grid.lines_m(np.array([target_ne_m]), grid.points_m(index))
    return dict(zip(index.tolist(), cost_m.tolist(), strict=True))


def _border_seeds(near: CostGrid, far: "_Solver") -> _Seeds:
    """The outermost points of a window, with their cost on the wide lattice."""
    rows, columns = near.shape
    edge = np.zeros((rows, columns), dtype=bool)
    edge[[0, -1], :] = edge[:, [0, -1]] = True
    index = np.flatnonzero(edge)
    place = far.grid.sample_of(near.points_m(index)).T / 2.0
    value = far.costs.cost.reshape(far.grid.shape)
    cost_m = scipy.ndimage.map_coordinates(value, place, order=1, mode="nearest")
    return dict(zip(index.tolist(), cost_m.tolist(), strict=True))


@final
class _Solver:
    """A grid and the costs of its lattice points, repaired as either changes."""

    grid: CostGrid
    costs: Costs

    def __init__(self) -> None:
        self._touched: BoolArray | None = None
        """(rows, columns), points whose edges have changed; None: all is new."""
        self._is_new = True

    def update(self, known: KnownMap, guess: Guess, task: Task, extent: Extent) -> None:
        """Take over costs as they are now."""
        after = None if self._is_new else self.grid.after(known, guess, task, extent)
        self._is_new = False
        if after is None:
            self.grid, self._touched = CostGrid.of(known, guess, task, extent), None
        else:
            self.grid, self._touched = after

    def solve(self, seeds: _Seeds) -> None:
        """Find the costs of all points by those of the seeds."""
        count = self.grid.shape[0] * self.grid.shape[1]
        seed = np.full(count, np.inf)
        seed[list(seeds)] = list(seeds.values())
        dirty = None
        if self._touched is not None:
            dirty = self._touched.ravel() | (seed != self.costs.seed)
        if dirty is None or np.count_nonzero(dirty) > _MANY * count:
            dirty = np.isfinite(seed)
            self.costs = Costs.unknown(seed)
        self.costs.seed[:] = seed
        everywhere = np.empty(0, dtype=np.int64)
        kernels.compiled().guidance.repair(
            self.grid.samples, self.costs, np.flatnonzero(dirty), everywhere
        )

    def discounted(self, inside: BoolArray, here_ne_m: Place, range_m: float) -> "_Solver":
        """Where the costs of some samples count less: a copy.

        Right where costs are given, but behind what is blocked.
        """
        samples, touched = self.grid.samples, np.zeros(self.grid.shape, dtype=bool)
        less = np.where(inside.ravel(), _DISCOUNT * samples.cost, 0.0)
        cheaper = samples._replace(
            cost=samples.cost - less,
            barring=samples.barring - less,
            least=(1.0 - _DISCOUNT) * samples.least,
        )
        result, guidance = _Solver(), kernels.compiled().guidance
        result.grid = replace(self.grid, samples=cheaper)
        result.costs = self.costs.copied()
        guidance.touch_all(inside, touched)
        cost = self.costs.cost.reshape(self.grid.shape)
        most_m = cost.ravel()[self.grid.around(here_ne_m)].min() + 2.0 * BLOCKED * samples.step_m
        matters = np.zeros(cost.shape, dtype=bool)
        box = _box_given(self.grid, here_ne_m, range_m)
        matters[box] = cost[box] <= most_m
        wanted = np.flatnonzero(matters)
        guidance.repair(cheaper, result.costs, np.flatnonzero(touched), wanted)
        return result

    def way(self, here_ne_m: Place) -> IndexArray:
        """Lattice points on the cheapest way from a place to a seed."""
        near = self.grid.around(here_ne_m)
        cost = self.grid.lines_m(np.array([here_ne_m]), self.grid.points_m(near))
        start = int(near[np.argmin(cost + self.costs.cost[near])])
        way: IndexArray = kernels.compiled().guidance.way_from(self.grid.samples, self.costs, start)
        return way


def _route(
    solved: _Solver, far: _Solver | None, here_ne_m: Place, target_ne_m: Place
) -> tuple[Place, ...]:
    """The cheapest way from here to the target, straightened where the grid is fine."""
    grid, way = solved.grid, solved.way(here_ne_m)
    near = np.concatenate([[here_ne_m], grid.points_m(way)])
    along_m = np.concatenate([grid.lines_m(near[:1], near[1:2]), -np.diff(solved.costs.cost[way])])
    if far is not None and not np.isin(way[-1], grid.around(target_ne_m)):
        wide = far.grid.points_m(far.way((float(near[-1, 0]), float(near[-1, 1]))))
        beyond = np.concatenate([wide, [target_ne_m]])
    else:
        beyond, near = np.empty((0, 2)), np.concatenate([near, [target_ne_m]])
        along_m = np.append(along_m, grid.lines_m(near[-2:-1], near[-1:]))
    keep = kernels.compiled().guidance.straightened(
        grid.samples, grid.sample_of(near), np.append(0.0, np.cumsum(along_m))
    )
    points = np.concatenate([near[keep], beyond])
    return tuple((float(north), float(east)) for north, east in points)


def _given(
    solved: _Solver, here_ne_m: Place, target_ne_m: Place, task: Task
) -> tuple[Surface, Surface]:
    """`CostToGo.value` and `needed` about here."""
    grid, limits = solved.grid, task.limits
    rows, columns = box = _box_given(grid, here_ne_m, task.settings.scan_range_m)
    samples = (
        slice(2 * rows.start, 2 * rows.stop - 1, 2),
        slice(2 * columns.start, 2 * columns.stop - 1, 2),
    )
    row, column = grid.sample_of(np.array(target_ne_m))
    asked_m = -np.inf
    if grid.holds(target_ne_m):
        asked_m = float(grid.sheet(grid.samples.lowest_m)[round(row), round(column)])
    needed_m = kernels.compiled().guidance.needed_m(
        grid.samples,
        solved.costs,
        (rows.start, rows.stop, columns.start, columns.stop),
        math.tan(limits.climb_angle_rad),
        limits.floor_amsl_m,
        (float(row), float(column), asked_m),
    )
    blocked = grid.sheet(grid.samples.cost)[samples] >= BLOCKED
    free_m = np.where(blocked, limits.ceiling_amsl_m, needed_m)
    about_m = scipy.ndimage.minimum_filter(free_m, 3, mode="nearest")
    value = solved.costs.cost.reshape(grid.shape)[box].copy()
    kernels.compiled().guidance.smooth_edges(
        value, grid.costly[samples].copy(), _ONE_SIDE_CELLS * 2.0 * grid.step_m
    )
    here = {
        "north_min_m": float(grid.north_min_m + 2.0 * grid.step_m * rows.start),
        "east_min_m": float(grid.east_min_m + 2.0 * grid.step_m * columns.start),
        "cell_m": 2.0 * float(grid.step_m),
    }
    return (
        Surface(vertex_m=value, **here),
        Surface(vertex_m=np.where(blocked, about_m, needed_m), **here),
    )


def _box_given(grid: CostGrid, here_ne_m: Place, range_m: float) -> tuple[slice, slice]:
    """Rows and columns of the lattice points for which costs are given."""
    reach = math.ceil(_GIVEN_RANGES * range_m / (2.0 * grid.step_m))
    return grid.box_about(here_ne_m, reach)


def _disputed(route: tuple[Place, ...], previous: tuple[Place, ...], corridor_m: float) -> bool:
    """Whether a route leaves the corridor of the previous one to the same target."""
    if len(previous) < 2 or math.dist(route[-1], previous[-1]) > corridor_m:
        return False
    aside_m: float = kernels.compiled().guidance.aside_m(np.array(route), np.array(previous))
    return aside_m > corridor_m


def _corridor(
    grid: CostGrid, here_ne_m: Place, previous: tuple[Place, ...], corridor_m: float
) -> BoolArray:
    """The samples within the corridor of a route, as far as it counts."""
    inside = np.zeros(grid.extent.count, dtype=bool)
    north, east = grid.samples_m
    far_m = _CORRIDOR_RANGES / _CORRIDOR * corridor_m
    for a, b in pairwise(previous):
        box = []
        for at, here, one, other in zip((north[:, 0], east[0]), here_ne_m, a, b, strict=True):
            low = max(min(one, other) - corridor_m, here - far_m)
            high = min(max(one, other) + corridor_m, here + far_m)
            box.append(slice(*np.searchsorted(at, (low, high))))
        rows, columns = box
        inside[rows, columns] |= _distance_m(north[rows], east[:, columns], a, b) < corridor_m
    return inside


def _distance_m(north: FloatArray, east: FloatArray, a: Place, b: Place) -> FloatArray:
    """Distance of points from the line between two places.  (...) x2 -> (...)."""
    dn, de = b[0] - a[0], b[1] - a[1]
    squared = max(dn * dn + de * de, 1e-12)
    share = np.clip(((north - a[0]) * dn + (east - a[1]) * de) / squared, 0.0, 1.0)
    return np.asarray(np.hypot(north - a[0] - share * dn, east - a[1] - share * de))


def _leaves(a: Place, b: Place, centre: Place, radius_m: float) -> Place | None:
    """Where the way from a to b leaves a circle, None if it does not."""
    an, ae = a[0] - centre[0], a[1] - centre[1]
    dn, de = b[0] - a[0], b[1] - a[1]
    squared = dn * dn + de * de
    half = an * dn + ae * de
    inside = half * half - squared * (an * an + ae * ae - radius_m * radius_m)
    if squared == 0.0 or inside < 0.0:
        return None
    share = (-half + math.sqrt(inside)) / squared
    return (a[0] + share * dn, a[1] + share * de) if 0.0 <= share < 1.0 else None
