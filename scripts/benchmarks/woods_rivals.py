"""Two rivals for flights among near things, on the same map, by the same lidar.

- `Bendy`: what ArduPilot's BendyRuler does (AC_Avoidance/AP_OABendyRuler, horizontal search): every
  5 degrees to either side of the target's bearing, the first that keeps the margin from what was
  seen over the look-ahead, and from its end on in one of three directions; it resists turning.
- `AStar`: the cheapest way over the cells of the map, and pure pursuit of it.

For both, what nobody has seen is free, as it is for them in the field.  Both keep from what stands
what our own vehicle has to keep.  A place is north + 1j east, in metres.
"""

import cmath
import math
from typing import final

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray
from scipy.sparse import csr_array

from companion.geodesy import FloatArray
from companion.paper.rivals.roadmaps import EIGHT, cheapest, grid_edges
from companion.world.near_map import NearMap

_DEAR = 20.0  # what a metre costs nearer than the clearance: A* would find no way out else
_LOOK_AHEAD_M, _RATIO, _RESISTS_RAD = 15.0, 1.5, math.radians(75.0)  # OA_BR_* as by default
_PAST_M = 2.0  # OA_BENDYRULER_LOOKAHEAD_PAST_DEST, and _STEP2_MIN
_ASIDE = [0.0, *(side * step for step in range(5, 175, 5) for side in (-1.0, 1.0))]
_PURSUES = 0.125  # of R, ahead of the vehicle on its way: 2 m in the forest


class Clearances:
    """How far the cells of a map are from what stands, up to some distance."""

    def __init__(self, near: NearMap, most_m: float) -> None:
        self.lattice, self._most_m = near.lattice, most_m
        self.away_m = np.full(near.lattice.shape, most_m)

    def look(self, near: NearMap, here: complex, reach_m: float) -> None:
        """The map may have changed within reach of a place."""
        point = np.array([[here.real, here.imag]])
        told = near.lattice.about(point, reach_m + self._most_m)
        wide = near.lattice.about(point, reach_m + 2.0 * self._most_m)
        stands = near.occupied(wide) & near.sharp[wide]
        away_m = np.full(stands.shape, np.inf)
        if stands.any():
            away_m = scipy.ndimage.distance_transform_edt(~stands) - 0.5
        rows, columns = (
            slice(a.start - b.start, a.stop - b.start) for a, b in zip(told, wide, strict=True)
        )
        self.away_m[told] = np.clip(away_m[rows, columns] * self.lattice.cell_m, 0.0, self._most_m)

    def margin_m(self, start: complex, end: complex) -> float:
        """The least along a straight line; off the map there is nothing."""
        lattice = self.lattice
        places = np.linspace(start, end, math.ceil(abs(end - start) / lattice.cell_m) + 2)
        row = np.floor((places.real - lattice.north_min_m) / lattice.cell_m).astype(int)
        column = np.floor((places.imag - lattice.east_min_m) / lattice.cell_m).astype(int)
        on = (row >= 0) & (row < lattice.shape[0]) & (column >= 0) & (column < lattice.shape[1])
        return float(self.away_m[row[on], column[on]].min(initial=self._most_m))


@final
class Bendy(Clearances):
    """ArduPilot's BendyRuler in the plane."""

    def __init__(self, near: NearMap, target: complex, margin_m: float, range_m: float) -> None:
        super().__init__(near, 4.0 * margin_m)
        self._target, self._required_m = target, margin_m
        self._ahead_m = self._farthest_m = min(_LOOK_AHEAD_M, range_m)
        self._before: complex | None = None

    def aim(self, here: complex, course: complex) -> complex:
        """Where to fly straight to.  course: the direction of flight, or of the nose."""
        offset, target = self._target - here, self._target
        self._ahead_m = min(max(self._ahead_m, 0.5 * self._farthest_m), self._farthest_m)
        first_m = min(self._ahead_m, abs(offset) + _PAST_M)
        found: list[tuple[float, complex]] = []
        for aside in _ASIDE:
            way = cmath.rect(1.0, cmath.phase(offset) + math.radians(aside))
            there = here + first_m * way
            margin_m = self.margin_m(here, there)
            found.append((margin_m, way))
            if margin_m <= self._required_m:
                continue
            second_m = min(max(self._ahead_m, _PAST_M), abs(target - there))
            for turn in (0.0, 0.25, -0.25):
                on = cmath.rect(second_m, cmath.phase(target - there) + turn * math.pi)
                if self.margin_m(there, there + on) > self._required_m:
                    self._ahead_m *= 1.1
                    if aside == turn == 0.0:
                        self._before = None
                    return here + min(abs(offset), first_m) * self._kept(
                        here, way, margin_m, first_m
                    )
        clear = [way for margin_m, way in found if margin_m > self._required_m]
        if clear:
            self._ahead_m *= 1.05
            return here + first_m * min(clear, key=lambda way: abs(cmath.phase(way / course)))
        self._ahead_m *= 0.9
        margin_m, way = max(found, key=lambda each: each[0])
        return here + max(first_m + margin_m - self._required_m, 0.0) * way

    def _kept(self, here: complex, way: complex, margin_m: float, first_m: float) -> complex:
        """The new direction, or the one before where the new one is a sharp turn for little."""
        before = self._before
        if before is not None and abs(cmath.phase(way / before)) > _RESISTS_RAD:
            before_m = self.margin_m(here, here + first_m * before)
            if margin_m < _RATIO * before_m:
                return before
        self._before = way
        return way


@final
class AStar(Clearances):
    """The cheapest way over the cells, planned anew each time; pure pursuit of it."""

    def __init__(self, near: NearMap, target: complex, margin_m: float, range_m: float) -> None:
        super().__init__(near, margin_m + near.lattice.cell_m)
        self._target, self._required_m, self._ahead_m = target, margin_m, _PURSUES * range_m

    def aim(self, here: complex, _course: complex) -> complex:
        """Where to fly straight to; here if there is no way."""
        lattice = self.lattice
        corner = complex(lattice.north_min_m, lattice.east_min_m)
        ends = np.array([here, self._target]) - corner
        cells = np.stack([ends.real, ends.imag], axis=-1) / lattice.cell_m
        start, end = np.clip(cells.astype(int), 0, np.array(lattice.shape) - 1)
        rate = np.where(self.away_m >= self._required_m, 1.0, _DEAR)
        way = a_star(np.where(self.away_m > 0.0, rate, np.inf), tuple(start), tuple(end))
        places = corner + (way @ np.array([1.0, 1.0j]) + 0.5 + 0.5j) * lattice.cell_m
        if not len(places):
            return here
        along_m = np.append(0.0, np.cumsum(np.abs(np.diff(places))))
        if along_m[-1] <= self._ahead_m:
            return self._target
        return complex(places[np.searchsorted(along_m, self._ahead_m)])


def a_star(rate: FloatArray, start: tuple[int, int], end: tuple[int, int]) -> NDArray[np.int64]:
    """The cheapest way over cells, eight neighbours each, (K, 2); none: there is no way.

    rate: of a cell, 1 or more; inf: not to be entered.  A step costs its length in cells times the
    mean of both; the start counts 1.
    """
    rate = rate.copy()
    rate[start] = 1.0
    before, after, cost = grid_edges(rate, 1, EIGHT)
    graph = csr_array((cost, (before, after)), shape=(rate.size, rate.size))
    way = cheapest(graph, *(row * rate.shape[1] + column for row, column in (start, end)))
    return np.stack(np.divmod(np.array(way, dtype=np.int64), rate.shape[1]), axis=-1)


PILOTS: dict[str, type[Bendy | AStar]] = {"bendy ruler": Bendy, "A*": AStar}
