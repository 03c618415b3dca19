"""Cheapest ways over a grid of costs: against scipy's Dijkstra, and repaired against anew."""

import itertools
import math

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.geodesy import FloatArray
from companion.jit import compiled
from companion.planner import cheapest_ways
from companion.planner.cheapest_ways import Costs, Grid

Window = tuple[int, int, int, int]
HERE = np.array([0])
STEP_M = 10.0
NEIGHBOURS = [
    (i, j) for i, j in itertools.product(range(-4, 5), repeat=2) if math.gcd(i, j) == 1
]  # up to four points away, and no two in one direction


def a_grid(rng: np.random.Generator, rows: int, columns: int) -> Grid:
    """Level ground, walls and hills."""
    grid = Grid.empty(rows, columns, STEP_M)
    grid.cost[:] = 1.0
    change(grid, rng, len(grid.cost) // 20)
    return grid


def change(grid: Grid, rng: np.random.Generator, count: int) -> None:
    """Draw some samples anew."""
    at = rng.integers(0, len(grid.cost), count)
    height = rng.choice([0.0, 0.3, 1.0], count)
    wall = np.where(rng.random(count) < 0.3, 300.0, 0.0)
    grid.cost[at] = 1.0 + height + wall


def edge_m(grid: Grid, begin: tuple[int, int], end: tuple[int, int]) -> float:
    """Sampled finely: trapezoids between samples."""
    shape = 2 * grid.rows - 1, 2 * grid.columns - 1
    most = max(abs(end[0] - begin[0]), abs(end[1] - begin[1]))
    u, v = (np.linspace(2 * a, 2 * b, 2 * most + 1) for a, b in zip(begin, end, strict=True))
    along = scipy.ndimage.map_coordinates(grid.cost.reshape(shape), np.array([u, v]), order=1)
    return float(np.trapezoid(along)) * STEP_M * math.dist(begin, end) / most


def dijkstra(grid: Grid, seeds: dict[int, float]) -> FloatArray:
    """scipy's, from one more point joined to the seeds."""
    count = grid.rows * grid.columns
    graph = scipy.sparse.lil_array((count + 1, count + 1))
    for u in range(count):
        begin = divmod(u, grid.columns)
        for north, east in NEIGHBOURS:
            end = begin[0] + north, begin[1] + east
            if 0 <= end[0] < grid.rows and 0 <= end[1] < grid.columns:
                graph[u, end[0] * grid.columns + end[1]] = edge_m(grid, begin, end)
    for u, cost in seeds.items():
        graph[count, u] = cost
    result: FloatArray = scipy.sparse.csgraph.dijkstra(graph.tocsr(), indices=count)[:count]
    return result


def solved(grid: Grid, seeds: dict[int, float]) -> Costs:
    seed = np.full(grid.rows * grid.columns, np.inf)
    seed[list(seeds)] = list(seeds.values())
    costs = Costs.unknown(seed)
    repair(grid, costs, np.isfinite(seed))
    return costs


def repair(
    grid: Grid,
    costs: Costs,
    dirty: NDArray[np.bool_],
    beyond_m: float = math.inf,
    window: Window | None = None,
) -> int:
    """All costs, or those in a window up to so much above that of HERE.  How often it looked."""
    shape = grid.rows, grid.columns
    window = window or (0, shape[0], 0, shape[1])
    looked: int = compiled(cheapest_ways.repair)(
        grid, costs, dirty.reshape(shape), HERE, beyond_m, window
    )
    return looked


def touched_by(grid: Grid, changed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The lattice points whose edges come by a changed sample: up to four points away each way."""
    size = 2 * 2 * 4 + 1
    near = scipy.ndimage.maximum_filter(changed.reshape(2 * grid.rows - 1, -1), size)
    return np.asarray(near[::2, ::2])


@pytest.mark.parametrize("seed", range(6))
def test_costs_are_those_of_another_dijkstra_over_the_same_edges(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = a_grid(rng, 9, 13)
    seeds = {int(u): float(rng.uniform(1.0, 90.0)) for u in rng.integers(0, 9 * 13, 3)}
    costs = solved(grid, seeds)
    np.testing.assert_allclose(costs.cost, dijkstra(grid, seeds), rtol=1e-12)
    for start in range(0, 9 * 13, 5):
        way = cheapest_ways.way_from(grid, costs, start).tolist()
        total = costs.seed[way[-1]]
        for u, v in itertools.pairwise(way):
            total += edge_m(grid, divmod(u, 13), divmod(v, 13))
        assert total == pytest.approx(costs.cost[start], rel=1e-12)


@given(seed=st.integers(0, 10**6), rows=st.integers(2, 20), columns=st.integers(2, 20))
def test_what_is_repaired_is_what_is_found_anew_to_the_last_digit(
    seed: int, rows: int, columns: int
) -> None:
    """After any sequence of changes of costs and seeds; and so are the ways."""
    rng = np.random.default_rng(seed)
    grid = a_grid(rng, rows, columns)
    seeds = {int(u): float(rng.uniform(0.0, 50.0)) for u in rng.integers(0, rows * columns, 4)}
    costs = solved(grid, seeds)
    for _ in range(6):
        before = grid.cost.copy()
        change(grid, rng, int(rng.integers(0, 9)))
        changed = before != grid.cost
        if rng.random() < 0.5:
            seeds[int(rng.integers(rows * columns))] = float(rng.uniform(0.0, 200.0))
            seeds.pop(int(rng.choice(list(seeds))))
        anew = solved(grid, seeds or {0: 1.0})
        dirty = touched_by(grid, changed).ravel() | (anew.seed != costs.seed)
        costs.seed[:] = anew.seed
        beyond_m = float(rng.choice([0.0, 30.0, math.inf]))
        window = (0, int(rng.integers(1, rows + 1)), 0, int(rng.integers(1, columns + 1)))
        repair(grid, costs, dirty, beyond_m, window)
        if beyond_m < math.inf:  # as far as they matter; and all, when they do
            inside = np.zeros((rows, columns), dtype=bool)
            inside[: window[1], : window[3]] = True
            right = inside.ravel() & (anew.cost <= anew.cost[HERE].min() + beyond_m)
            for u in np.flatnonzero(right).tolist():  # and so are the ways on, wherever they lead
                right[cheapest_ways.way_from(grid, anew, u)] = True
            assert costs.cost[right].tobytes() == anew.cost[right].tobytes()
            assert costs.via[right].tobytes() == anew.via[right].tobytes()
            dearer = costs.cost[inside.ravel() & ~right]
            assert (dearer > anew.cost[HERE].min() + beyond_m).all()
            if rng.random() < 0.5:
                continue
            repair(grid, costs, np.zeros(rows * columns, dtype=bool))
        for mine, other in zip(costs[:4], anew[:4], strict=True):
            assert mine.tobytes() == other.tobytes()


def test_where_nothing_has_changed_nothing_is_looked_at_and_far_changes_are_not_led_on() -> None:
    grid = a_grid(np.random.default_rng(2), 60, 60)
    costs, changed = solved(grid, {0: 0.0}), np.zeros(119 * 119, dtype=bool)
    assert repair(grid, costs, touched_by(grid, changed)) == 0
    grid.cost[-1] = 250.0  # in the far corner
    changed[-1] = True
    assert 0 < repair(grid, costs, touched_by(grid, changed)) < 60


@given(seed=st.integers(0, 10**6))
def test_what_is_needed_is_the_most_that_the_way_asks_for_less_what_can_be_climbed(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    grid = a_grid(rng, 12, 10)
    grid.lowest_m[:] = rng.uniform(100.0, 200.0, len(grid.lowest_m))
    costs, steepness = solved(grid, {35: 0.0, 77: 12.0}), 0.3
    target = 7.0, 11.0, 180.0
    window = 2, 11, 0, 9
    most_m = float(np.quantile(costs.cost, 0.8))
    needed_m = compiled(cheapest_ways.needed_m)(grid, costs, window, most_m, steepness, target)
    lowest_m = grid.lowest_m.reshape(23, 19)
    for row in range(window[0], window[1]):
        for column in range(window[2], window[3]):
            way = cheapest_ways.way_from(grid, costs, row * 10 + column).tolist()
            places = [(2 * (u // 10), 2 * (u % 10)) for u in way]
            most, flown_m = float(lowest_m[places[0]]), 0.0
            if costs.cost[row * 10 + column] > most_m:
                assert needed_m[row - 2, column] == most
                continue
            for a, b in itertools.pairwise(places):
                far_m = STEP_M * math.dist(a, b)
                for p in range(1, 9):
                    i, j = (
                        math.floor(x + (y - x) * p / 8 + 0.5) for x, y in zip(a, b, strict=True)
                    )
                    most = max(most, lowest_m[i, j] - steepness * (flown_m + far_m * p / 8))
                flown_m += far_m
            flown_m += STEP_M * math.dist(places[-1], target[:2])
            most = max(most, target[2] - steepness * flown_m)
            assert needed_m[row - 2, column] == pytest.approx(most, abs=1e-9)


@given(seed=st.integers(0, 10**6))
def test_costly_points_beside_free_ones_cost_what_these_do_and_on_a_thin_wall_the_dearest(
    seed: int,
) -> None:
    """Else what costs less beyond the wall draws towards it, and it is flown along."""
    rng = np.random.default_rng(seed)
    before = rng.choice([10.0, 20.0, 300.0], (9, 7)) + rng.random((9, 7))
    costly, after = rng.random((9, 7)) < 0.6, before.copy()
    compiled(cheapest_ways.smooth_edges)(after, costly, 50.0)
    assert (after[~costly] == before[~costly]).all()
    for i, j in np.argwhere(costly).tolist():
        near = slice(max(i - 1, 0), i + 2), slice(max(j - 1, 0), j + 2)
        free = before[near][~costly[near]]
        most = math.inf
        if len(free):
            most = free.max() if np.ptp(free) > 50.0 else free.mean()
        assert after[i, j] == pytest.approx(min(before[i, j], most))
