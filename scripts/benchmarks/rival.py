"""The rival of whole missions: Dijkstra over what has been seen so far, planned again and again.

A point without turn radius or climb limit.  At each look it sees the ground within R that nothing
hides, takes what it has not seen as free, searches a lattice of R / 40 with 16 directions from the
target, pulls the way straight where that is not dearer, and flies 0.375 R of it, lower where it can
and higher where it must.  It shares the measure of cost and the surface of safe altitudes with the
optimum, and nothing with the planner.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from companion.campaign import drawn_world, truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.route_cost import Rates, cost_rate

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

_CELLS_PER_RANGE = 40
_FINE = 4  # points of the fine lattice to a cell
_SPARE = 0.35  # of a fine cell, kept beside the required clearance
_OFTEN = 0.375  # of R: how far it flies from one look ahead to the next
_STRAIGHT = 2.0  # of R: how far ahead the way is pulled straight
_NOT_FREE = 1e12  # metres of level flight
_MOST_IN_VAIN = 50  # plans in a row that lead nowhere
_OFFSETS = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RivalFlight:
    """What the rival flew."""

    points_nea_m: FloatArray  # (S, 3)
    arrived: bool
    plans: int
    scans: int

    def cost(self, world: DrawnWorld) -> float:
        """J, as of curves."""
        middle = 0.5 * (self.points_nea_m[1:] + self.points_nea_m[:-1])
        return float(cost_rate(middle, world) @ self._pieces_m)

    @property
    def length_m(self) -> float:
        return float(self._pieces_m.sum())

    @property
    def _pieces_m(self) -> FloatArray:
        return np.linalg.norm(np.diff(self.points_nea_m, axis=0), axis=-1)


def fly(world: DrawnWorld) -> RivalFlight:
    """The rival's flight to the only target of a world."""
    rival = Rival(world)
    at = np.array(world.start_nea_m[:2])
    flown, plans, in_vain = [at], 0, 0
    while in_vain < _MOST_IN_VAIN:
        rival.look(at)
        plans += 1
        ahead = rival.way(at)
        if ahead is None:
            break
        done = rival.follow(ahead)
        in_vain = in_vain + 1 if len(done) == 1 else 0
        flown += done[1:]
        at = flown[-1]
        if len(done) == len(ahead):
            return rival.flight(np.array(flown), plans, arrived=True)
    return rival.flight(np.array(flown), plans, arrived=False)


@final
class Rival:
    """What it knows, and what it makes of it."""

    def __init__(self, world: DrawnWorld) -> None:
        self.world, self.rates = world, Rates.of(world)
        self.range_m = world.task.settings.scan_range_m
        self.cell_m = self.range_m / _CELLS_PER_RANGE
        self.fine_m = self.cell_m / _FINE
        north, east = drawn_world.axes_m(world, self.cell_m)
        self.shape = (len(north), len(east))
        self.corner_ne_m = np.array([north[0], east[0]])
        fine_n, fine_e = drawn_world.axes_m(world, self.fine_m)
        fine = (_FINE * (len(north) - 1) + 1, _FINE * (len(east) - 1) + 1)
        self.fine_n, self.fine_e = fine_n[: fine[0], None], fine_e[None, : fine[1]]
        clearance = world.task.required_clearance_m + _SPARE * self.fine_m
        need = drawn_world.lowest_safe_m(world, self.fine_m, clearance)
        self.need_m = need[: fine[0], : fine[1]]
        self.height_m = truth.height_m(world.terrain, self.fine_n[::2], self.fine_e[:, ::2])
        self.seen = np.zeros(self.height_m.shape, dtype=bool)
        self.closed = np.zeros(fine, dtype=bool)
        self.balked = self.closed.copy()  # a way over the lattice led there, but not through
        for zone in world.task.zones:
            away = zone.distance_m(*np.broadcast_arrays(self.fine_n, self.fine_e))
            self.closed |= away < clearance
        self.looks = 0

    # --- seeing

    def look(self, at_ne_m: FloatArray) -> None:
        """See the ground in range that nothing hides, from the altitude flown there."""
        self.looks += 1
        step, size = 2.0 * self.fine_m, self.height_m.shape
        here = (at_ne_m - self.corner_ne_m) / step
        reach = math.floor(self.range_m / step)
        rows, columns = (
            np.arange(max(round(c) - reach, 0), min(round(c) + reach + 1, n))
            for c, n in zip(here.tolist(), size, strict=True)
        )
        row, column = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
        away = np.hypot(row - here[0], column - here[1])
        wanted = (away <= reach) & ~self.seen[row, column]
        row, column, away = row[wanted], column[wanted], away[wanted]
        altitude = self._altitude_m(at_ne_m[None, :])[0]
        target = self.height_m[row, column]
        free = np.ones(len(row), dtype=bool)
        for k in range(1, reach):
            left = np.nonzero(free & (away > k + 0.75))[0]
            share = k / away[left]
            n = np.rint(here[0] + share * (row[left] - here[0])).astype(np.intp)
            e = np.rint(here[1] + share * (column[left] - here[1])).astype(np.intp)
            line = altitude + share * (target[left] - altitude)
            free[left[self.height_m[n, e] > line]] = False
        self.seen[row[free], column[free]] = True

    @property
    def known_need_m(self) -> FloatArray:
        """Lowest safe altitude at the fine points; -inf where nothing has been seen."""
        seen = np.repeat(np.repeat(self.seen, 2, axis=0), 2, axis=1)
        rows, columns = self.need_m.shape
        return np.where(seen[:rows, :columns], self.need_m, -np.inf)

    # --- searching

    def rate(self, at_ne_m: FloatArray | None = None) -> FloatArray:
        """Cost per metre at the fine points, in metres of level flight; infinite: closed."""
        world, need = self.world, self.known_need_m
        band = world.ceiling_amsl_m - world.floor_amsl_m
        altitude = np.clip(need, world.floor_amsl_m, world.ceiling_amsl_m)
        rate = 1.0 + self.rates.height * (altitude - world.floor_amsl_m) / band
        for radar in world.task.radars:
            n, e, z = radar.centre_nea_m
            away2 = (self.fine_n - n) ** 2 + (self.fine_e - e) ** 2 + (altitude - z) ** 2
            ratio2 = away2 / radar.range_m**2
            rate += np.where(ratio2 <= 1.0, self.rates.radar / (1.0 + ratio2**2), 0.0)
        closed = self.closed | self.balked | (need > world.ceiling_amsl_m)
        if at_ne_m is not None:
            closed[tuple(self._fine_index(at_ne_m))] = False  # it is there
        rate[closed] = np.inf
        return rate

    def way(self, at_ne_m: FloatArray) -> FloatArray | None:
        """The cheapest way to the target by what is known, at even steps; None: there is none."""
        rate = self.rate(at_ne_m)
        target = np.array(self.world.targets_ne_m[0])
        rows, columns = self.shape
        end = np.rint((target - self.corner_ne_m) / self.cell_m).astype(int)
        costs, before = dijkstra(
            self._graph(rate),
            directed=False,
            indices=int(end[0] * columns + end[1]),
            return_predecessors=True,
        )
        if math.dist(at_ne_m, target) < 3.0 * self.cell_m:
            direct = np.array([at_ne_m, target])
            if math.isfinite(self.line_cost(rate, *direct)):
                return self.even(direct)
        here = np.rint((at_ne_m - self.corner_ne_m) / self.cell_m).astype(int)
        best, first = math.inf, -1
        for row in range(max(here[0] - 2, 0), min(here[0] + 3, rows)):
            for column in range(max(here[1] - 2, 0), min(here[1] + 3, columns)):
                node = row * columns + column
                total = costs[node]
                if total < best:
                    total += self.line_cost(rate, at_ne_m, self._place(node))
                    if total < best:
                        best, first = total, node
        if first < 0:
            return None
        nodes = [first]
        while before[nodes[-1]] >= 0:
            nodes.append(int(before[nodes[-1]]))
        route = np.array([at_ne_m, *(self._place(node) for node in nodes)])
        route[-1] = target
        return self.even(self._straight(rate, route))

    def _graph(self, rate: FloatArray) -> csr_array:
        """Edges to 16 neighbours, each with its mean rate at quarters of the edge."""
        rows, columns = self.shape
        cell = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
        parts = []
        for i, j in _OFFSETS:
            a = cell[: rows - i, max(0, -j) : columns - max(0, j)]
            r, c = _FINE * (a // columns), _FINE * (a % columns)
            mean = 0.125 * (rate[r, c] + rate[r + _FINE * i, c + _FINE * j])
            for k in (1, 2, 3):
                mean += 0.25 * rate[r + k * i, c + k * j]
            ok = np.isfinite(mean)
            length = self.cell_m * math.hypot(i, j)
            parts.append((mean[ok] * length, a[ok], a[ok] + i * columns + j))
        costs, starts, ends = (np.concatenate(part) for part in zip(*parts, strict=True))
        return csr_array((costs, (starts, ends)), shape=(rows * columns, rows * columns))

    def _place(self, node: int) -> FloatArray:
        row, column = divmod(node, self.shape[1])
        return self.corner_ne_m + self.cell_m * np.array([row, column])

    def _straight(self, rate: FloatArray, route: FloatArray) -> FloatArray:
        """The way with lines in place of its bends where they cost no more, near its beginning."""
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=-1))])
        last = int(np.searchsorted(along, _STRAIGHT * self.range_m))
        pieces = [self.line_cost(rate, a, b) for a, b in pairwise(route)]
        pieces = np.minimum(pieces, _NOT_FREE)  # between the points that the lattice looks at
        cost = np.concatenate([[0.0], np.cumsum(pieces)])
        kept, here = [0], 0
        while here < min(last, len(route) - 1):
            ends = range(min(last, len(route) - 1), here + 1, -1)
            there = next(
                (k for k in ends
                 if self.line_cost(rate, route[here], route[k]) <= cost[k] - cost[here]),
                here + 1,
            )  # fmt: skip
            kept.append(there)
            here = there
        return np.concatenate([route[kept], route[here + 1 :]])

    def rate_at(self, rate: FloatArray, at_ne_m: FloatArray) -> float:
        """Cost per metre at the fine point nearest to a place."""
        row, column = self._fine_index(at_ne_m).tolist()
        return float(rate[row, column])

    def line_cost(self, rate: FloatArray, a: FloatArray, b: FloatArray) -> float:
        """Cost of a straight line, in metres of level flight; infinite: it is not free."""
        length = float(np.linalg.norm(b - a))
        count = max(math.ceil(length / (0.5 * self.fine_m)), 2)
        points = a + np.linspace(0.0, 1.0, count + 1)[:, None] * (b - a)
        index = self._fine_index(points)
        values = rate[index[:, 0], index[:, 1]]
        return length * float(values.mean())

    def _fine_index(self, at_ne_m: FloatArray) -> IntArray:
        index = np.rint((at_ne_m - self.corner_ne_m) / self.fine_m).astype(np.intp)
        return np.clip(index, 0, np.array(self.need_m.shape) - 1)

    # --- flying

    def even(self, route: FloatArray) -> FloatArray:
        """The same way in steps of half the fine lattice."""
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=-1))])
        count = max(math.ceil(along[-1] / (0.5 * self.fine_m)), 1)
        at = np.linspace(0.0, along[-1], count + 1)
        return np.stack([np.interp(at, along, column) for column in route.T], axis=-1)

    def follow(self, way_ne_m: FloatArray) -> list[FloatArray]:
        """What it flies before it plans again: never over ground that it has not seen."""
        steps = math.ceil(_OFTEN * self.range_m / (0.5 * self.fine_m))
        done = [way_ne_m[0]]
        for point in way_ne_m[1 : 1 + steps]:
            row, column = (self._fine_index(point) // 2).tolist()
            if not self.seen[row, column]:
                self.look(done[-1])
                self.seen[row, column] = True  # right ahead of it
            i, j = self._fine_index(point).tolist()
            if self.closed[i, j] or self.need_m[i, j] > self.world.ceiling_amsl_m:
                self.balked[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2] = True
                break
            done.append(point)
        return done

    def _need_at(self, at_ne_m: FloatArray) -> FloatArray:
        """Lowest safe altitude between the fine points.  (S, 2) -> (S,)."""
        last = np.array(self.need_m.shape) - 2
        index = np.clip(np.floor((at_ne_m - self.corner_ne_m) / self.fine_m), 0, last)
        i, j = index.astype(np.intp).T
        u, v = np.clip(((at_ne_m - self.corner_ne_m) / self.fine_m - index).T, 0.0, 1.0)
        need = self.need_m
        south = need[i, j] * (1 - v) + need[i, j + 1] * v
        return (1 - u) * south + u * (need[i + 1, j] * (1 - v) + need[i + 1, j + 1] * v)

    def _altitude_m(self, at_ne_m: FloatArray) -> FloatArray:
        world = self.world
        return np.clip(self._need_at(at_ne_m), world.floor_amsl_m, world.ceiling_amsl_m)

    def flight(self, flown_ne_m: FloatArray, plans: int, *, arrived: bool) -> RivalFlight:
        """What was flown, with its altitudes."""
        points = np.column_stack([flown_ne_m, self._altitude_m(flown_ne_m)])
        return RivalFlight(points_nea_m=points, arrived=arrived, plans=plans, scans=self.looks)
