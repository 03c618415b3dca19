"""The cheapest ways over a grid when everything is known."""

import math
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from companion.campaign import drawn_world
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.route_cost import Rates
from companion.geodesy import FloatArray

GRID_M = 500.0
SURFACE_M = 125.0
_REACH = 4  # lattice offsets: all coprime pairs up to this, 48 directions


@final
class Lattice:
    """The world on a lattice of points, and the cheapest ways over it."""

    def __init__(self, world: DrawnWorld, cell_m: float = GRID_M) -> None:
        self.world, self.cell_m = world, cell_m
        self.north_m, self.east_m = drawn_world.axes_m(world, cell_m)
        fine = 0.5 * cell_m
        north, east = drawn_world.axes_m(world, fine)
        self.fine_shape = (2 * len(self.north_m) - 1, 2 * len(self.east_m) - 1)
        surface = drawn_world.lowest_safe_m(world, SURFACE_M, world.task.required_clearance_m)
        every = round(fine / SURFACE_M)
        self.need_m = surface[::every, ::every][: self.fine_shape[0], : self.fine_shape[1]]
        self._fine_ne = (north[: self.fine_shape[0], None], east[None, : self.fine_shape[1]])

    def rate(self, *, over: bool, radar_free: bool) -> FloatArray:
        """Cost per metre at the points of a lattice twice as fine; infinite: closed."""
        world, rates = self.world, Rates.of(self.world)
        band = world.ceiling_amsl_m - world.floor_amsl_m
        altitude = np.clip(self.need_m, world.floor_amsl_m, world.ceiling_amsl_m)
        result = 1.0 + rates.height * (altitude - world.floor_amsl_m) / band
        top = world.ceiling_amsl_m if over else world.floor_amsl_m + 15.0
        result[self.need_m > top] = np.inf
        north, east = self._fine_ne
        for radar in world.task.radars:
            n, e, z = radar.centre_nea_m
            ratio2 = ((north - n) ** 2 + (east - e) ** 2 + (altitude - z) ** 2) / radar.range_m**2
            inside = np.inf if radar_free else rates.radar / (1.0 + ratio2**2)
            result += np.where(ratio2 <= 1.0, inside, 0.0)
        for zone in world.task.zones:
            away = zone.distance_m(*np.broadcast_arrays(north, east))
            result[away < world.task.required_clearance_m] = np.inf
        return result

    def ways(
        self, rate: FloatArray, count: int, ends_ne_m: tuple[tuple[float, float], ...]
    ) -> list[tuple[float, FloatArray]]:
        """The cheapest way and others that differ: cost in metres, (N, 2) points."""
        found: list[tuple[float, FloatArray]] = []
        dearer, graph = rate, self._graph(rate)
        for turn in range(count):
            way = self._cheapest(self._graph(dearer) if turn else graph, ends_ne_m)
            if way is None:
                break
            places = np.stack(np.divmod(way, len(self.east_m)), axis=-1)
            route = np.stack([self.north_m[places[:, 0]], self.east_m[places[:, 1]]], axis=-1)
            route[0], route[-1] = ends_ne_m
            found.append((float(graph[way[:-1], way[1:]].sum()), route))
            dearer = dearer * self._near(places, ends_ne_m)
        return found

    def _cheapest(
        self, graph: csr_array, ends_ne_m: tuple[tuple[float, float], ...]
    ) -> NDArray[np.intp] | None:
        """The cells that are passed, by their numbers."""
        begin, end = (
            round((n - self.north_m[0]) / self.cell_m) * len(self.east_m)
            + round((e - self.east_m[0]) / self.cell_m)
            for n, e in ends_ne_m
        )
        costs, before = dijkstra(graph, indices=begin, return_predecessors=True)
        if not np.isfinite(costs[end]):
            return None
        way = [end]
        while way[-1] != begin:
            way.append(int(before[way[-1]]))
        return np.array(way[::-1])

    def _graph(self, rate: FloatArray) -> csr_array:
        """Edges to all coprime offsets, each with its mean rate at quarters of the edge."""
        rows, columns = len(self.north_m), len(self.east_m)
        cell = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
        parts: list[tuple[FloatArray, NDArray[np.int32], NDArray[np.int32]]] = []
        for i, j in _offsets():
            a = cell[max(0, -i) : rows - max(0, i), max(0, -j) : columns - max(0, j)]
            r, c = 2 * (a // columns), 2 * (a % columns)
            mean = np.zeros(a.shape)
            for t, weight in ((0.0, 0.5), (1.0, 0.5), *((k / 4, 1.0) for k in (1, 2, 3))):
                mean += weight * rate[r + round(2 * i * t), c + round(2 * j * t)]
            length = self.cell_m * math.hypot(i, j)
            ok = np.isfinite(mean)
            parts.append((mean[ok] * (0.25 * length), a[ok], a[ok] + i * columns + j))
        costs, starts, ends = (np.concatenate(p) for p in zip(*parts, strict=True))
        size = rows * columns
        return csr_array((costs, (starts, ends)), shape=(size, size))

    def _near(
        self, way: NDArray[np.intp], ends_ne_m: tuple[tuple[float, float], ...]
    ) -> FloatArray:
        """1.25 within 3 km of a way except near the ends, else 1."""
        north, east = self._fine_ne
        result = np.ones(self.fine_shape)
        reach = 3_000.0
        half = math.ceil(2.0 * reach / self.cell_m)
        for r, c in (2 * way[:: max(round(1_000.0 / self.cell_m), 1)]).tolist():
            at = float(north[r, 0]), float(east[0, c])
            if min(math.dist(at, end) for end in ends_ne_m) > 8_000.0:
                box = (slice(max(r - half, 0), r + half), slice(max(c - half, 0), c + half))
                near = np.hypot(north[box[0]] - at[0], east[:, box[1]] - at[1]) <= reach
                result[box][near] = 1.25
        return result


def _offsets() -> list[tuple[int, int]]:
    span = range(-_REACH, _REACH + 1)
    return [(i, j) for i in span for j in span if math.gcd(i, j) == 1]
