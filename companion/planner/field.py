"""The field: what it costs from anywhere to the target, and the best way from here.

Over a lattice of cells of R / 20, the cheapest ways by what flying costs (`cost_grid`), found and
repaired by `cheapest_ways`.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import final

import numpy as np
import scipy

from companion import jit
from companion.geodesy import BoolArray, FloatArray
from companion.planner import cheapest_ways
from companion.planner.cheapest_ways import Costs
from companion.planner.cost_grid import Belief, CostGrid, Place
from companion.planner.cost_samples import BLOCKED
from companion.planner.settings import Task
from companion.world.columns import Surface
from companion.world.known_map import KnownMap

_GIVEN_RANGES = 1.6
"""Of R about here: as far costs are given.  Legs end within R, and look ahead by a turn radius, of
R / 2 at most."""
_BEYOND_RANGES = 6.0
"""Of R: costs are told apart up to so much above that of here.  Legs end within R and look ahead by
R / 2: at the ceiling that costs as much as 6.9 R with the paper's weights."""
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

    6 R more than from here at most.  Points inside threats and blocked terrain that border on free
    ones hold the cost of these, so that interpolation near an edge stays true.
    """
    needed: Surface
    """The lowest altitude from which the way on can be climbed, AMSL, likewise."""
    route_ne_m: tuple[Place, ...]
    """The cheapest way from here to the target."""
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


def cost_to_go(
    known: KnownMap,
    task: Task,
    here_ne_m: Place,
    target_ne_m: Place,
    memory: "Memory | None" = None,
    *,
    belief: Belief = Belief.GUESSED,
) -> CostToGo:
    """The cost to the target over what is known, and the way from here.

    Parameters
    ----------
    known, task
        The map and the threats, limits and weights.
    here_ne_m, target_ne_m
        North, east; both may be anywhere, also off the map or inside a threat.
    memory
        Of the plans before: it makes this one faster.  None: what the last plan has left.
    belief
        What is taken to be where nothing was seen.
    """
    mine = memory or (_idle.pop() if _idle else Memory())
    field = mine.solve(known, task, here_ne_m, target_ne_m, belief)
    route, (value, needed) = field.route_ne_m(), field.surfaces()
    if memory is None and not _idle:
        _idle.append(mine)
    return CostToGo(
        value=value,
        needed=needed,
        route_ne_m=route,
        is_barred=field.grid.bars(np.array(route)),
    )


@final
class Memory:
    """What guidance keeps from one plan to the next, so that it looks at changes only.

    Answers do not depend on it, to the last digit.  One plan at a time.
    """

    def __init__(self) -> None:
        self._kept: dict[Belief, tuple[CostGrid, Costs | None]] = {}

    def solve(
        self, known: KnownMap, task: Task, here_ne_m: Place, target_ne_m: Place, belief: Belief
    ) -> "_Field":
        """The costs of lattice points, as they are now."""
        grid, costs = self._kept.get(belief, (None, None))
        if grid is None or not grid.fits(known, task):
            grid, costs = CostGrid(known, task, belief), None
        dirty = grid.update(known, here_ne_m)
        seed, about = np.full(dirty.size, np.inf), grid.around(target_ne_m)
        seed[about] = grid.lines_m(target_ne_m, grid.points_m(about))
        many = np.count_nonzero(dirty) > _MANY * dirty.size
        if costs is None or many or not np.isfinite(costs.seed[about]).all():  # another target
            costs, dirty = Costs.unknown(seed), np.isfinite(seed).reshape(dirty.shape)
        elif not np.array_equal(seed, costs.seed):
            dirty |= (seed != costs.seed).reshape(dirty.shape)
            costs.seed[:] = seed
        self._kept[belief] = grid, costs
        ends_ne_m = here_ne_m, target_ne_m
        field = _Field(grid=grid, costs=costs, task=task, ends_ne_m=ends_ne_m)
        field.repair(dirty)
        return field


_idle: list[Memory] = []
"""What plans before have left.  It is taken out while it is used: by one plan, of one thread."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Field:
    """The costs of lattice points."""

    grid: CostGrid
    costs: Costs
    task: Task
    ends_ne_m: tuple[Place, Place]
    """Here, and the target."""

    @property
    def _range_m(self) -> float:
        return self.task.settings.scan_range_m

    def repair(self, dirty: BoolArray) -> None:
        """Make costs right again; dirty: the points whose edges have changed."""
        here, (rows, columns) = self.grid.around(self.ends_ne_m[0]), self._box()
        window = rows.start, rows.stop, columns.start, columns.stop
        jit.compiled(cheapest_ways.repair)(
            self.grid.samples, self.costs, dirty, here, _BEYOND_RANGES * self._range_m, window
        )

    def _box(self) -> tuple[slice, slice]:
        """Rows and columns of the lattice points whose costs are asked for."""
        reach = math.ceil(_GIVEN_RANGES * self._range_m / (2.0 * self.grid.step_m))
        return self.grid.box_about(self.ends_ne_m[0], reach)

    @property
    def most_m(self) -> float:
        """Costs are right as far as they are no more than this."""
        near = self.costs.cost[self.grid.around(self.ends_ne_m[0])]
        return float(near.min()) + _BEYOND_RANGES * self._range_m

    def route_ne_m(self) -> tuple[Place, ...]:
        """The cheapest way from here to the target, straightened."""
        (here, target), grid, cost = self.ends_ne_m, self.grid, self.costs.cost
        near = grid.around(here)
        near = near[cost[near] <= self.most_m]
        start = near[np.argmin(grid.lines_m(here, grid.points_m(near)) + cost[near])]
        way = jit.compiled(cheapest_ways.way_from)(self.grid.samples, self.costs, int(start))
        points = np.concatenate([[here], grid.points_m(way), [target]])
        first_m, last_m = grid.lines_m(here, points[1:2]), grid.lines_m(target, points[-2:-1])
        along_m = np.concatenate([[0.0], first_m, -np.diff(cost[way]), last_m]).cumsum()
        keep = jit.compiled(cheapest_ways.straightened)(
            self.grid.samples, grid.sample_of(points), along_m
        )
        return tuple((float(north), float(east)) for north, east in points[keep])

    def surfaces(self) -> tuple[Surface, Surface]:
        """`CostToGo.value` and `needed` about here."""
        target, grid, limits = self.ends_ne_m[1], self.grid, self.task.limits
        rows, columns = box = self._box()
        inside = (
            slice(2 * rows.start, 2 * rows.stop - 1, 2),
            slice(2 * columns.start, 2 * columns.stop - 1, 2),
        )
        most_m = self.most_m
        row, column = grid.sample_of(np.array(target)).tolist()
        asked_m = -np.inf
        if 0.0 <= row <= grid.shape[0] - 1.0 and 0.0 <= column <= grid.shape[1] - 1.0:
            asked_m = float(
                self.grid.samples.lowest_m.reshape(grid.shape)[round(row), round(column)]
            )
        needed_m = jit.compiled(cheapest_ways.needed_m)(
            self.grid.samples, self.costs, (rows.start, rows.stop, columns.start, columns.stop),
            most_m, math.tan(limits.climb_angle_rad), (row, column, asked_m),
        )  # fmt: skip
        blocked = self.grid.samples.cost.reshape(grid.shape)[inside] >= BLOCKED
        free_m = np.where(blocked, limits.ceiling_amsl_m, needed_m)
        about_m = scipy.ndimage.minimum_filter(free_m, 3, mode="nearest")
        value = np.minimum(self.costs.cost.reshape(grid.lattice_shape)[box], most_m)
        jit.compiled(cheapest_ways.smooth_edges)(
            value, grid.costly[inside].copy(), _ONE_SIDE_CELLS * 2.0 * grid.step_m
        )
        cell_m = 2.0 * grid.step_m
        north_min_m, east_min_m = (
            low + cell_m * part.start for low, part in zip(grid.corner_ne_m, box, strict=True)
        )
        value_m = Surface(
            vertex_m=value, north_min_m=north_min_m, east_min_m=east_min_m, cell_m=cell_m
        )
        return value_m, value_m._replace(vertex_m=np.where(blocked, about_m, needed_m))


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
