"""Cost-to-go guidance: what it costs from anywhere to the target, and the best way from here.

The cheapest way over a coarse lattice (cells of R / 20) of what flying costs (`cost_lattice`), by
Dijkstra's algorithm from the target over 48 directions (`scipy.sparse.csgraph`): at most 0.75 %
too long in any direction, 0.25 % in the mean.
"""

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache, partial
from itertools import pairwise
from typing import final

import numpy as np
import numpy.typing as npt
import scipy

from companion.geodesy import BoolArray, FloatArray
from companion.planner.cost_lattice import (
    BLOCKED,
    MAX_CELLS,
    IndexArray,
    Lattice,
    Place,
    bars,
    lattice_of,
    line_cost_m,
)
from companion.planner.settings import Task
from companion.world.clearance import Surface
from companion.world.guess import guess_of
from companion.world.known_map import KnownMap

SingleArray = npt.NDArray[np.float32]

_CELLS_PER_RANGE = 20
_BARRED = 1e4  # cost per metre where an edge is not to be used
_CORRIDOR = 0.2  # of R on either side of the previous route
_DISCOUNT = 0.03  # on costs in the corridor, when another way looks cheaper
_OFFSETS = tuple(
    (north, east)
    for north in range(5)
    for east in range(-4, 5)
    if math.gcd(north, east) == 1 and (north > 0 or east > 0)
)  # one of each pair of opposite directions: 24
_PARTS = 8  # of an edge, at whose ends its ground is looked at
_ONE_SIDE_CELLS = 4.0  # free neighbours of a point differ by less if they are on one side of it
_NOT_ZERO_M = 1e-9  # an edge of a sparse graph that costs nothing may be taken for none


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CostToGo:
    """Cost to the target over a coarse lattice of the map, in metres of level flight at the floor.

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
    previous_route_ne_m: tuple[Place, ...] = (),
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
    """
    guess = guess_of(known, here_ne_m, task.settings.scan_range_m)
    cells = max(round(task.settings.scan_range_m / (2 * _CELLS_PER_RANGE * known.cell_m)), 1)
    near = lattice_of(known, guess, task, here_ne_m, cells)
    seeds, far, lattices = _seeds(near, target_ne_m), None, [near]
    if not near.covers_map:
        most = max(known.upper_m.shape)
        wide_cells = max(math.ceil(most / (2 * MAX_CELLS)), 1)
        wide = lattice_of(known, guess, task, here_ne_m, wide_cells)
        lattices.append(wide)
        far = _solve(wide, _seeds(wide, target_ne_m))
        border = _border_seeds(near, far)
        seeds = seeds.joined(border) if near.holds(target_ne_m) else border
    solved = _solve(near, seeds)
    route = _route(solved, far, here_ne_m, target_ne_m)
    corridor_m = _CORRIDOR * task.settings.scan_range_m
    if _disputed(route, previous_route_ne_m, corridor_m):
        inside = _distance_m(*near.samples_m, previous_route_ne_m) < corridor_m
        kept = replace(near, cost=np.where(inside, 1.0 - _DISCOUNT, 1.0) * near.cost)
        solved = _solve(kept, seeds)
        route = _route(solved, far, here_ne_m, target_ne_m)
    on_lattice = partial(
        Surface,
        north_min_m=near.north_min_m,
        east_min_m=near.east_min_m,
        cell_m=2.0 * near.step_m,
    )
    return CostToGo(
        value=on_lattice(vertex_m=_smooth_edges(solved)),
        needed=on_lattice(vertex_m=_needed_m(solved, target_ne_m, task)),
        route_ne_m=route,
        is_barred=bars(lattices, np.array(route)),
    )


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seeds:
    """Lattice points from which the way on is known, and its cost."""

    index: IndexArray
    cost_m: FloatArray

    def joined(self, other: "_Seeds") -> "_Seeds":
        """These, and those of the other that are not among them."""
        new = ~np.isin(other.index, self.index)
        return _Seeds(
            index=np.concatenate([self.index, other.index[new]]),
            cost_m=np.concatenate([self.cost_m, other.cost_m[new]]),
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Solved:
    """Dijkstra's answer: the cost of every lattice point and the next one on its way."""

    lattice: Lattice
    cost_m: FloatArray  # (rows * columns,)
    next_index: IndexArray  # (rows * columns,); rows * columns at a seed


def _seeds(lattice: Lattice, target_ne_m: Place) -> _Seeds:
    """The lattice points about the target, with the cost of the straight line to it."""
    index = lattice.around(target_ne_m)
    cost_m = line_cost_m(lattice, np.array(target_ne_m), lattice.points_m(index))
    return _Seeds(index=index, cost_m=cost_m)


def _border_seeds(near: Lattice, far: _Solved) -> _Seeds:
    """The outermost points of a window, with their cost on the wide lattice."""
    rows, columns = near.shape
    edge = np.zeros((rows, columns), dtype=bool)
    edge[[0, -1], :] = edge[:, [0, -1]] = True
    index = np.flatnonzero(edge).astype(np.int32)
    place = far.lattice.sample_of(near.points_m(index)).T / 2.0
    value = far.cost_m.reshape(far.lattice.shape)
    cost = scipy.ndimage.map_coordinates(value, place, order=1, mode="nearest")
    return _Seeds(index=index, cost_m=cost)


@lru_cache(maxsize=8)
def _neighbours(rows: int, columns: int) -> IndexArray:
    """Neighbours of every lattice point: _OFFSETS, then their opposites.  (rows * columns, 48).

    Where there is none, the point itself.
    """
    row, column = np.divmod(np.arange(rows * columns)[:, None], columns)
    offsets = np.array(_OFFSETS + tuple((-north, -east) for north, east in _OFFSETS))
    to_row, to_column = row + offsets[:, 0], column + offsets[:, 1]
    inside = (to_row >= 0) & (to_row < rows) & (to_column >= 0) & (to_column < columns)
    there = np.where(inside, to_row * columns + to_column, row * columns + column)
    there = there.astype(np.int32)
    there.setflags(write=False)
    return there


@lru_cache(maxsize=1)
def _stencils() -> tuple[tuple[tuple[float, tuple[tuple[int, int], ...]], ...], ...]:
    """For each offset, the samples whose weighted sum is the mean along it, by weight.

    The trapezoidal rule, one point for each row or column of samples, linear between two.
    """
    result = []
    for north, east in _OFFSETS:
        steps = 2 * max(north, abs(east))
        weights: dict[tuple[int, int], Fraction] = {}
        for k in range(steps + 1):
            share = Fraction(1, 2 * steps if k in (0, steps) else steps)
            u, v = Fraction(2 * north * k, steps), Fraction(2 * east * k, steps)
            for i, part_i in ((math.floor(u), 1 - u % 1), (math.floor(u) + 1, u % 1)):
                for j, part_j in ((math.floor(v), 1 - v % 1), (math.floor(v) + 1, v % 1)):
                    weights[i, j] = weights.get((i, j), Fraction(0)) + share * part_i * part_j
        groups: dict[Fraction, list[tuple[int, int]]] = {}
        for place, weight in weights.items():
            groups.setdefault(weight, []).append(place)
        groups.pop(Fraction(0), None)
        result.append(tuple((float(weight), tuple(each)) for weight, each in groups.items()))
    return tuple(result)


def _edge_costs_m(lattice: Lattice, costs_m: FloatArray) -> None:
    """Fill in the costs of the edges to all neighbours, (rows, columns, 48).

    Infinite where there is no neighbour.

    On ground that rises or falls steeper than the vehicle only the 16 short edges serve: the
    others would have to be looked at in as many pieces, or would jump over a ridge.
    """
    rows, columns = lattice.shape
    costs_m.fill(np.inf)
    short, ramp, height = map(_Phases, (lattice.cost, lattice.ramp_m, lattice.height))
    steep = _steep(lattice)
    hilly = bool(steep.any())
    long = _Phases(lattice.cost + _BARRED * steep) if hilly else short
    for k, ((north, east), stencil) in enumerate(zip(_OFFSETS, _stencils(), strict=True)):
        if north >= rows or abs(east) >= columns:
            continue
        here = (slice(0, rows - north), slice(max(-east, 0), columns - max(east, 0)))
        there = (slice(north, rows), slice(max(east, 0), columns - max(-east, 0)))
        length = 2.0 * lattice.step_m * math.hypot(north, east)
        is_short = max(north, abs(east)) <= 2
        cost = short if is_short else long
        edge, part = np.zeros((2, rows - north, columns - abs(east)), dtype=np.float32)
        for weight, places in stencil:
            np.copyto(part, cost.at(*places[0], here))
            for i, j in places[1:]:
                part += cost.at(i, j, here)
            part *= weight * length
            edge += part
        if hilly and is_short:
            edge += _climbing_m(ramp, height, (north, east), here, length)
        costs_m[*here, k] = edge
        costs_m[*there, k + len(_OFFSETS)] = edge


def _steep(lattice: Lattice) -> BoolArray:
    """Samples next to which the height for a ramp costs more than the height of the ground."""
    steep = np.zeros(lattice.cost.shape, dtype=bool)
    if lattice.ramp_m.any():
        for axis in (0, 1):
            ends = [slice(None)] * 2, [slice(None)] * 2
            ends[0][axis], ends[1][axis] = slice(None, -1), slice(1, None)
            low, high = tuple(ends[0]), tuple(ends[1])
            level = 0.5 * lattice.step_m * (lattice.height[low] + lattice.height[high])
            found = np.abs(lattice.ramp_m[high] - lattice.ramp_m[low]) > level
            steep[low] |= found
            steep[high] |= found
    return steep


def _climbing_m(
    ramp_m: "_Phases",
    height: "_Phases",
    offset: tuple[int, int],
    here: tuple[slice, slice],
    length_m: float,
) -> SingleArray:
    """What short edges cost more because they rise or fall steeper than the vehicle.

    Such a rise takes a ramp that begins before it: the height of the ramp is paid as well.
    Added up over pieces of about one sample.
    """
    most = max(offset[0], abs(offset[1]))
    ramps, heights = (
        [
            field.halfway(offset[0] * k / most, offset[1] * k / most, here)
            for k in range(2 * most + 1)
        ]
        for field in (ramp_m, height)
    )
    total = np.zeros(ramps[0].shape, dtype=np.float32)
    for k in range(2 * most):
        level = heights[k] + heights[k + 1]
        level *= 0.25 * length_m / most
        steeper = np.abs(ramps[k + 1] - ramps[k])
        steeper -= level
        total += np.maximum(steeper, 0.0, out=steeper)
    return total


class _Phases:
    """Every second sample, by the parities of row and column, each contiguous.

    Of single precision, for speed: 1 cm in 100 km.
    """

    def __init__(self, samples: FloatArray) -> None:
        self._by_parity = {
            (i, j): samples[i::2, j::2].astype(np.float32) for i in (0, 1) for j in (0, 1)
        }

    def at(self, i: int, j: int, points: tuple[slice, slice]) -> SingleArray:
        """The samples i, j further than some lattice points."""
        rows, columns = points
        return self._by_parity[i % 2, j % 2][
            rows.start + i // 2 : rows.stop + i // 2, columns.start + j // 2 : columns.stop + j // 2
        ]

    def halfway(self, i: float, j: float, points: tuple[slice, slice]) -> SingleArray:
        """As `at`; one of i and j may be halfway between two samples."""
        low = self.at(math.floor(i), math.floor(j), points)
        if i == math.floor(i) and j == math.floor(j):
            return low
        return np.float32(0.5) * (low + self.at(math.ceil(i), math.ceil(j), points))


def _solve(lattice: Lattice, seeds: _Seeds) -> _Solved:
    """Dijkstra from one more point, joined to the seeds by edges of their costs."""
    rows, columns = lattice.shape
    count = rows * columns
    neighbours = _neighbours(rows, columns)
    each = neighbours.shape[1]
    data = np.empty(neighbours.size + len(seeds.index))
    _edge_costs_m(lattice, data[: neighbours.size].reshape(rows, columns, each))
    data[neighbours.size :] = seeds.cost_m + _NOT_ZERO_M
    index = np.concatenate([neighbours.ravel(), seeds.index])
    start = np.append(np.arange(0, count * each + 1, each), len(data)).astype(np.int32)
    graph = scipy.sparse.csr_array((data, index, start), shape=(count + 1, count + 1))
    cost, before = scipy.sparse.csgraph.dijkstra(
        graph, directed=True, indices=[count], return_predecessors=True
    )
    return _Solved(lattice=lattice, cost_m=cost[0, :count], next_index=before[0, :count])


def _route(
    solved: _Solved, far: _Solved | None, here_ne_m: Place, target_ne_m: Place
) -> tuple[Place, ...]:
    """The cheapest way from here to the target, straightened."""
    lattice = solved.lattice
    way = _way(solved, here_ne_m)
    beyond = np.empty((0, 2))
    if far is not None and not np.isin(way[-1], lattice.around(target_ne_m)):
        out = lattice.points_m(way[-1:])[0]
        beyond = far.lattice.points_m(_way(far, (float(out[0]), float(out[1]))))
    ends = np.array([here_ne_m]), np.array([target_ne_m])
    near = np.concatenate([ends[0], lattice.points_m(way)])
    if len(beyond):
        points = np.concatenate([_straightened(lattice, near), beyond, ends[1]])
    else:
        points = _straightened(lattice, np.concatenate([near, ends[1]]))
    return tuple((float(north), float(east)) for north, east in points)


def _way(solved: _Solved, here_ne_m: Place) -> IndexArray:
    """Lattice points on the cheapest way from a place to a seed."""
    lattice = solved.lattice
    near = lattice.around(here_ne_m)
    cost = line_cost_m(lattice, np.array(here_ne_m), lattice.points_m(near)) + solved.cost_m[near]
    way = [int(near[np.argmin(cost)])]
    while (after := int(solved.next_index[way[-1]])) < len(solved.cost_m):
        way.append(after)
    return np.array(way, dtype=np.int32)


def _straightened(lattice: Lattice, points_ne_m: FloatArray) -> FloatArray:
    """Without the points that a straight line may pass by at no more cost.  (K, 2) -> (J, 2).

    From each point the line goes as far as it can.
    """
    count = len(points_ne_m)
    along = np.append(0.0, np.cumsum(line_cost_m(lattice, points_ne_m[:-1], points_ne_m[1:])))
    keep = [0]
    while keep[-1] < count - 1:
        last = keep[-1]
        straight = line_cost_m(lattice, points_ne_m[last], points_ne_m[last + 1 :])
        may = np.flatnonzero(straight <= (along[last + 1 :] - along[last]) * (1.0 + 1e-9))
        keep.append(last + 1 + int(may.max(initial=0)))
    return points_ne_m[keep]


def _smooth_edges(solved: _Solved) -> FloatArray:
    """Costs of the lattice points; those just inside threats as their free neighbours'.

    Their mean, or their maximum where they lie on two sides of something thin: what costs less
    beyond a wall must not draw towards it.  -> (rows, columns).
    """
    value = solved.cost_m.reshape(solved.lattice.shape)
    costly = solved.lattice.costly[::2, ::2]
    rows, columns = value.shape
    free = np.pad(np.where(costly, np.nan, value), 1, constant_values=np.nan)
    count, total = np.zeros((2, rows, columns))
    highest, lowest = np.full(value.shape, -np.inf), np.full(value.shape, np.inf)
    for i, j in np.ndindex(3, 3):
        near = free[i : i + rows, j : j + columns]
        count += np.isfinite(near)
        total += np.nan_to_num(near)
        np.fmax(highest, near, out=highest)
        np.fmin(lowest, near, out=lowest)
    one_side = highest - lowest < _ONE_SIDE_CELLS * 2.0 * solved.lattice.step_m
    beside = np.where(one_side, total / np.maximum(count, 1.0), highest)
    return np.where(costly & (count > 0.0), np.minimum(value, beside), value)


def _needed_m(solved: _Solved, target_ne_m: Place, task: Task) -> FloatArray:
    """The lowest altitude at each point from which its cheapest way can be climbed.

    What the way asks for later, less what can be climbed until then; at blocked points, the least
    of those about.  -> (rows, columns).
    """
    lattice, limits = solved.lattice, task.limits
    count = len(solved.cost_m)
    steepness = math.tan(limits.climb_angle_rad)
    leads_on = np.flatnonzero(solved.next_index < count)
    after = solved.next_index[leads_on]
    columns, across = lattice.shape[1], lattice.lowest_m.shape[1]
    begin, end = (2 * np.stack(np.divmod(index, columns)) for index in (leads_on, after))
    step, lowest_m = end - begin, lattice.lowest_m.ravel()
    climb_m = lattice.step_m * steepness * np.hypot(*step)
    needed_m = np.full(count, limits.floor_amsl_m)
    if lattice.holds(target_ne_m):
        last = np.flatnonzero(solved.next_index >= count).astype(np.int32)
        row, column = np.rint(lattice.sample_of(np.array(target_ne_m))).astype(int)
        away_m = np.hypot(*(lattice.points_m(last) - target_ne_m).T)
        at_target_m = lattice.lowest_m[row, column] - steepness * away_m
        needed_m[last] = np.maximum(at_target_m, limits.floor_amsl_m)
    on_the_way_m = np.full(len(after), -np.inf)
    for part in range(1, _PARTS + 1):
        row, column = begin + (part * step + _PARTS // 2) // _PARTS
        asked_m = lowest_m[row * across + column] - part / _PARTS * climb_m
        np.maximum(on_the_way_m, asked_m, out=on_the_way_m)
    while (on_the_way_m > needed_m[leads_on]).any():
        needed_m[leads_on] = np.maximum(on_the_way_m, needed_m[leads_on])
        on_the_way_m = needed_m[after] - climb_m
    needed_m = needed_m.reshape(lattice.shape)
    blocked = lattice.cost[::2, ::2] >= BLOCKED
    free_m = np.where(blocked, limits.ceiling_amsl_m, needed_m)
    about_m = scipy.ndimage.minimum_filter(free_m, 3, mode="nearest")
    return np.asarray(np.where(blocked, about_m, needed_m))


def _disputed(route: tuple[Place, ...], previous: tuple[Place, ...], corridor_m: float) -> bool:
    """Whether a route leaves the corridor of the previous one to the same target."""
    if len(previous) < 2 or math.dist(route[-1], previous[-1]) > corridor_m:
        return False
    ends = np.array(route)
    along = np.linspace(0.0, 1.0, 33)[:, None, None]
    points = ends[:-1] + along * (ends[1:] - ends[:-1])  # (33, K - 1, 2)
    away = _distance_m(points[..., 0], points[..., 1], previous)
    return bool((away > corridor_m).any())


def _distance_m(north: FloatArray, east: FloatArray, route: tuple[Place, ...]) -> FloatArray:
    """Distance of points from a broken line.  (...) x2 -> (...)."""
    nearest = np.full(np.broadcast_shapes(north.shape, east.shape), np.inf)
    for (an, ae), (bn, be) in pairwise(route):
        dn, de = bn - an, be - ae
        squared = max(dn * dn + de * de, 1e-12)
        share = np.clip(((north - an) * dn + (east - ae) * de) / squared, 0.0, 1.0)
        np.minimum(nearest, np.hypot(north - an - share * dn, east - ae - share * de), out=nearest)
    return nearest


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
