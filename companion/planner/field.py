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
from companion.geodesy import BoolArray
from companion.planner import cheapest_ways
from companion.planner.cheapest_ways import Box, Costs, IndexArray
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
Memory = dict[Belief, tuple[CostGrid, Costs]]
"""What guidance keeps from one plan to the next, so that it looks at changes only.

Answers do not depend on it, to the last digit.  One plan at a time."""
_idle: list[Memory] = []
"""What plans before have left.  It is taken out while it is used: by one plan, of one thread."""
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
    memory: Memory | None = None,
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
    mine = memory if memory is not None else _idle.pop() if _idle else Memory()
    grid, costs, dirty = _up_to_date(mine, known, task, belief, here_ne_m, target_ne_m)
    range_m, beside = task.settings.scan_range_m, grid.around(here_ne_m)
    beyond_m = _BEYOND_RANGES * range_m
    window = grid.box_about(here_ne_m, math.ceil(_GIVEN_RANGES * range_m / (2.0 * grid.step_m)))
    jit.compiled(cheapest_ways.repair)(grid.samples, costs, dirty, beside, beyond_m, window)
    most_m = float(costs.cost[beside].min()) + beyond_m  # so far costs are right
    route = _route_ne_m(grid, costs, (here_ne_m, target_ne_m), beside[costs.cost[beside] <= most_m])
    value, needed = _surfaces(grid, costs, window, target_ne_m, most_m)
    is_barred = grid.bars(np.array(route))
    if memory is None and not _idle:
        _idle.append(mine)
    return CostToGo(value=value, needed=needed, route_ne_m=route, is_barred=is_barred)


def _up_to_date(
    memory: Memory,
    known: KnownMap,
    task: Task,
    belief: Belief,
    here_ne_m: Place,
    target_ne_m: Place,
) -> tuple[CostGrid, Costs, BoolArray]:
    """The grid as it is now, the costs to be repaired, and the points where they are wrong."""
    grid, costs = memory.get(belief, (None, None))
    if grid is None or not grid.fits(known, task):
        grid, costs = CostGrid(known, task, belief), None
    dirty, seeds = grid.update(known, here_ne_m), grid.around(target_ne_m)
    many = np.count_nonzero(dirty) > _MANY * dirty.size
    if costs is None or many or not np.array_equal(np.flatnonzero(costs.seed < np.inf), seeds):
        costs, dirty[:] = Costs.unknown(np.full(dirty.size, np.inf)), False
    costs.seed[seeds] = grid.lines_m(target_ne_m, grid.points_m(seeds))
    dirty.flat[seeds] = True
    memory[belief] = grid, costs
    return grid, costs, dirty


def _route_ne_m(
    grid: CostGrid, costs: Costs, ends_ne_m: tuple[Place, Place], starts: IndexArray
) -> tuple[Place, ...]:
    """The cheapest way from here to the target, straightened.

    starts: lattice points beside here, one of which it leads over.
    """
    start, target = ends_ne_m
    cost_m = grid.lines_m(start, grid.points_m(starts)) + costs.cost[starts]
    way = jit.compiled(cheapest_ways.way_from)(grid.samples, costs, starts[np.argmin(cost_m)])
    points = np.concatenate([[start], grid.points_m(way), [target]])
    first_m, last_m = grid.lines_m(start, points[1:2]), grid.lines_m(target, points[-2:-1])
    along_m = np.concatenate([[0.0], first_m, -np.diff(costs.cost[way]), last_m]).cumsum()
    keep = jit.compiled(cheapest_ways.straightened)(grid.samples, grid.sample_of(points), along_m)
    return tuple((float(north), float(east)) for north, east in points[keep])


def _surfaces(
    grid: CostGrid, costs: Costs, window: Box, target_ne_m: Place, most_m: float
) -> tuple[Surface, Surface]:
    """`CostToGo.value` and `needed`, in a window of the lattice."""
    limits, samples, cell_m = grid.task.limits, grid.samples, 2.0 * grid.step_m
    south, north, west, east = window
    inside = slice(2 * south, 2 * north - 1, 2), slice(2 * west, 2 * east - 1, 2)
    row, column = grid.sample_of(np.array(target_ne_m)).tolist()
    asked_m = -np.inf
    if 0.0 <= row <= grid.shape[0] - 1.0 and 0.0 <= column <= grid.shape[1] - 1.0:
        asked_m = float(samples.lowest_m.reshape(grid.shape)[round(row), round(column)])
    needed_m = jit.compiled(cheapest_ways.needed_m)(
        samples, costs, window, most_m, math.tan(limits.climb_angle_rad), (row, column, asked_m)
    )
    blocked = samples.cost.reshape(grid.shape)[inside] >= BLOCKED
    free_m = np.where(blocked, limits.ceiling_amsl_m, needed_m)
    about_m = scipy.ndimage.minimum_filter(free_m, 3, mode="nearest")
    value_m = costs.cost.reshape(grid.lattice_shape)[south:north, west:east]
    value_m = np.minimum(value_m, most_m)
    one_side_m = _ONE_SIDE_CELLS * cell_m
    jit.compiled(cheapest_ways.smooth_edges)(value_m, grid.ground.costly[inside].copy(), one_side_m)
    north_m, east_m = (
        low + cell_m * at for low, at in zip(grid.corner_ne_m, (south, west), strict=True)
    )
    value = Surface(north_min_m=north_m, east_min_m=east_m, cell_m=cell_m, vertex_m=value_m)
    return value, value._replace(vertex_m=np.where(blocked, about_m, needed_m))


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
