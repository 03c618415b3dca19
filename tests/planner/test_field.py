"""What is left to fly and the way there: scipy's Dijkstra, closed forms, and repaired as anew."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import scipy
import shapely
from planning import LARGE, circle, radar

from companion.geodesy import FloatArray
from companion.jit import compiled
from companion.planner import cheapest_ways, cost_grid
from companion.planner.cheapest_ways import Costs, Grid
from companion.planner.cost_grid import Belief
from companion.planner.field import CostToGo, Memory, cost_to_go
from companion.planner.settings import PlannerSettings, Task
from companion.world.columns import Surface
from companion.world.known_map import KnownMap, Scan, empty_map
from companion.world.radars import Radar
from companion.world.zones import Zone

Place = tuple[float, float]

R, SIZE = 20_000.0, 60e3
CELL = R / 20.0
FLOOR, CEILING = 3_000.0, 5_000.0
CLIMB = math.radians(10.0)
HEIGHT = 2.4 * 0.15 / 0.1  # cost per metre at the ceiling: f2 over f1 with the paper's weights


def a_task(*, radars: tuple[Radar, ...] = (), zones: tuple[Zone, ...] = (), size_m: float = SIZE,
           range_m: float = R, safety_m: float = 500.0) -> Task:  # fmt: skip
    area = {"north_m": (0.0, size_m), "east_m": (0.0, size_m)}
    settings = PlannerSettings(
        scan_range_m=range_m, safety_distance_m=safety_m, planning_time_s=5.0, evaluations=100
    )
    limits = replace(LARGE, climb_angle_rad=CLIMB, dive_angle_rad=CLIMB, **area)
    return Task(limits=limits, settings=settings, radars=radars, zones=zones)


def a_map(task: Task) -> KnownMap:
    return empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)


def seen(task: Task, height_m: np.ndarray | float, where: np.ndarray | bool = True) -> KnownMap:
    blank = a_map(task)
    everywhere = np.broadcast_to(np.asarray(where), blank.seen.shape)
    return replace(blank, upper_m=np.where(everywhere, height_m, np.inf), seen=everywhere.copy())


TASK = a_task()
FREE, CLEAR_M = a_map(TASK), TASK.search_clearance_m
NORTH, EAST = FREE.middles_m()


def value(field: CostToGo, place: Place) -> float:
    return float(field.value.altitude_m(np.array(place[0]), np.array(place[1])))


def detour_m(here: Place, there: Place, centre: Place, radius_m: float) -> float:
    """Tangent, arc, tangent about a circle that the straight line crosses."""
    a, b = np.subtract(here, centre), np.subtract(there, centre)
    da, db = np.hypot(*a), np.hypot(*b)
    between = math.acos(np.dot(a, b) / (da * db))
    arc = between - math.acos(radius_m / da) - math.acos(radius_m / db)
    return math.sqrt(da**2 - radius_m**2) + math.sqrt(db**2 - radius_m**2) + radius_m * arc


# --- cheapest ways over a grid of costs

STEP_M = 10.0
NEIGHBOURS = [
    (i, j) for i, j in itertools.product(range(-4, 5), repeat=2) if math.gcd(i, j) == 1
]  # up to four points away, and no two in one direction


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


@pytest.mark.parametrize("seed", range(6))
def test_costs_and_ways_are_those_of_another_dijkstra_over_the_same_edges(seed: int) -> None:
    """Where nothing has changed nothing is looked at."""
    rng, everywhere = np.random.default_rng(seed), np.ones((9, 13), dtype=bool)
    grid = Grid.empty(*everywhere.shape, STEP_M)  # level ground, hills, and then walls
    grid.cost[:] = 1.0 + rng.choice([0.0, 0.0, 0.3, 1.0], len(grid.cost))
    grid.cost[rng.random(len(grid.cost)) < 0.05] += 300.0
    seeds = {int(u): float(rng.uniform(1.0, 90.0)) for u in rng.integers(0, 9 * 13, 3)}
    seed_m = np.full(9 * 13, np.inf)
    seed_m[list(seeds)] = list(seeds.values())
    costs, how = Costs.unknown(seed_m), (np.array([0]), math.inf, (0, 9, 0, 13))
    repair = compiled(cheapest_ways.repair)
    assert repair(grid, costs, everywhere, *how) > 0
    assert repair(grid, costs, ~everywhere, *how) == 0
    np.testing.assert_allclose(costs.cost, dijkstra(grid, seeds), rtol=1e-12)
    for start in range(0, 9 * 13, 5):
        way = cheapest_ways.way_from(grid, costs, start).tolist()
        total = costs.seed[way[-1]]
        for u, v in itertools.pairwise(way):
            total += edge_m(grid, divmod(u, 13), divmod(v, 13))
        assert total == pytest.approx(costs.cost[start], rel=1e-12)


# --- what a place costs


@pytest.mark.parametrize(("bound_m", "is_seen"), [
    (2_800.0, True), (3_500.0, True), (4_200.0, True), (3_500.0, False), (np.inf, False),
])  # fmt: skip
def test_ground_costs_the_altitude_that_it_or_its_bound_is_flown_over_at(
    bound_m: float, is_seen: bool
) -> None:
    here, there, known = (5e3, 7e3), (5e4, 4e4), seen(TASK, bound_m, is_seen)
    if not is_seen:
        nothing = np.full_like(known.upper_m, 2_800.0)
        known = replace(known, upper_m=np.full_like(nothing, bound_m), guess_m=nothing)
    flown_m = min(bound_m + CLEAR_M, CEILING)
    expected = math.dist(here, there) * (1 + HEIGHT * (flown_m - FLOOR) / 2e3)
    assert value(cost_to_go(known, TASK, here, there), here) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("rise_m", [400.0, 900.0, 1_500.0])
def test_before_a_cliff_the_altitude_needed_falls_with_the_steepest_climb(rise_m: float) -> None:
    foot_m, top_m, here = 30e3, FLOOR + rise_m, (5e3, 30e3)
    known = seen(TASK, np.where(foot_m < NORTH, top_m - CLEAR_M, 0.0) + 0.0 * EAST)
    field = cost_to_go(known, TASK, here, (55e3, 30e3))
    coarse_m = 0.75 * CELL * math.tan(CLIMB)  # the lattice's, of where the cliff stands
    for away_m in np.arange(-10e3, 12e3, 500.0):
        needed_m = float(field.needed.altitude_m(np.array(foot_m - away_m), np.array(30e3)))
        on_the_ramp_m = top_m - max(away_m - CLEAR_M, 0.0) * math.tan(CLIMB)
        assert needed_m == pytest.approx(max(on_the_ramp_m, FLOOR), abs=coarse_m)


@pytest.mark.parametrize(("off_m", "times", "range_m"), [
    *itertools.product((300.0, 3_000.0, 6_000.0), (1.0,), (7_000.0, 11_000.0)), (0.0, 10.0, 90e3),
])  # fmt: skip
def test_round_a_radar_the_way_is_tangent_arc_tangent(
    off_m: float, times: float, range_m: float
) -> None:
    """Also on a map so large that costs are given about the vehicle alone."""
    size_m, off_m = times * SIZE, times * off_m
    centre, here, target = (
        (0.5 * size_m + off_m, 0.5 * size_m - off_m),
        (0.1 * size_m, 0.12 * size_m),
        (0.92 * size_m, 0.87 * size_m),
    )
    task = a_task(radars=(radar(*centre, range_m),), size_m=size_m)
    field, outside = cost_to_go(a_map(task), task, here, target), math.sqrt(range_m**2 - FLOOR**2)
    assert max(field.value.vertex_m.shape) <= 161
    expected = detour_m(here, target, centre, outside)  # the radar stands at 0 m
    assert value(field, here) == pytest.approx(expected, rel=0.02)
    route = shapely.LineString(field.route_ne_m)
    assert route.length == pytest.approx(expected, rel=0.02)
    assert route.distance(shapely.Point(centre)) >= outside


@pytest.mark.parametrize("bearing_deg", [0.0, 11.0, 27.0, 45.0])
@pytest.mark.parametrize("shift", [0.0, 0.3, 0.6, 0.85])
def test_a_gap_of_one_and_a_half_cells_stays_open(bearing_deg: float, shift: float) -> None:
    ahead = np.array([math.cos(math.radians(bearing_deg)), math.sin(math.radians(bearing_deg))])
    gap = np.array([30e3, 30e3]) + shift * CELL * np.array([1.0, 0.7])
    n, e = NORTH - gap[0], EAST - gap[1]
    across, aside = n * ahead[0] + e * ahead[1], e * ahead[0] - n * ahead[1]
    free = 0.75 * CELL + CLEAR_M + 0.5 * TASK.cell_m
    wall = np.where((np.abs(across) < 2e3) & (np.abs(aside) > free), 9e3, 0.0)
    here, target = tuple(gap - 20e3 * ahead), tuple(gap + 20e3 * ahead)
    field = cost_to_go(seen(TASK, wall), TASK, here, target)
    assert shapely.LineString(field.route_ne_m).length == pytest.approx(40e3, rel=0.02)
    assert value(field, here) == pytest.approx(40e3, rel=0.03)


def test_along_the_edge_of_the_map_there_is_no_way() -> None:
    """What lies beyond counts as terrain: the vehicle was led there again and again."""
    here, target, costs = (10e3, 3e3), (50e3, 3e3), []
    for free_east_m in (4e3, 1.5 * CLEAR_M):
        wall = np.where((np.abs(NORTH - 30e3) < 2e3) & (free_east_m < EAST), 9e3, 0.0)
        costs.append(value(cost_to_go(seen(TASK, wall), TASK, here, target), here))
    assert costs[0] < 50e3
    assert costs[1] > 10 * costs[0]


def test_hidden_ground_is_as_high_as_its_sight_line_allows_or_free_as_is_asked() -> None:
    """By bounds what is promised can be proven: a slope is climbed where it is hidden, too."""
    here, there = (5e3, 30e3), (55e3, 30e3)
    ridge = np.abs(NORTH - 30e3) < 5e3
    known = seen(TASK, np.where(ridge, 3_900.0, 0.0) + 0.0 * EAST)
    hidden = replace(known, seen=known.seen & ~ridge)
    told, guessed = cost_to_go(known, TASK, here, there), cost_to_go(hidden, TASK, here, there)
    bounded, free = (
        cost_to_go(hidden, TASK, here, there, belief=belief)
        for belief in (Belief.BOUNDED, Belief.FREE)
    )
    assert bounded.value.vertex_m == pytest.approx(told.value.vertex_m)
    assert bounded.needed.vertex_m == pytest.approx(told.needed.vertex_m)
    foot = np.array(24.5e3), np.array(30e3)
    assert guessed.needed.altitude_m(*foot) < told.needed.altitude_m(*foot) - 500.0
    nothing = cost_to_go(FREE, TASK, here, there).value.vertex_m
    assert free.value.vertex_m == pytest.approx(nothing)
    unseen = replace(seen(TASK, 9e3), seen=np.zeros_like(known.seen))  # of it nothing is guessed
    assert cost_to_go(unseen, TASK, here, there).value.vertex_m == pytest.approx(nothing)
    assert value(cost_to_go(seen(TASK, 9e3), TASK, here, there), here) > 1e6


# --- routes through worlds that nobody chose


def a_scene(seed: int) -> tuple[Task, KnownMap]:
    """Radars, keep-outs and hills, some above the ceiling, some in ground that was not seen."""
    rng = np.random.default_rng(seed)
    radars = tuple(
        radar(*rng.uniform(12e3, 48e3, 2), float(rng.uniform(5e3, 9e3))) for _ in range(3)
    )
    task = a_task(radars=radars, zones=(circle(*rng.uniform(15e3, 45e3, 2).tolist(), 2_500.0),))
    hills = rng.uniform((8e3, 8e3, 2e3, 2e3), (52e3, 52e3, 6e3, 6e3), (6, 4))
    terrain = np.max(
        [h * np.exp(-((NORTH - a) ** 2 + (EAST - b) ** 2) / s**2) for a, b, s, h in hills], axis=0
    )
    known = seen(task, terrain, where=np.hypot(NORTH - 20e3, EAST - 20e3) < 30e3)
    return task, replace(known, guess_m=np.full_like(terrain, -np.inf))  # free beyond


def a_scan(scanned: np.ndarray, rng: np.random.Generator) -> Scan:
    """Of these cells; now and then it is all that is known of those about them."""
    (row, column), (row_end, column_end) = rng.integers(0, 120, 2), rng.integers(121, 241, 2)
    heights_m = np.where(scanned, rng.uniform(0.0, 5e3), np.nan)[row:row_end, column:column_end]
    return Scan(
        row=int(row), column=int(column), heights_m=heights_m, radar_nea_m=np.zeros((1, 1, 3)),
        range_m=R, complete=False, supersedes=bool(rng.random() < 0.5),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(12))
def test_what_is_remembered_changes_no_answer_and_all_answers_are_numbers(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scans, other targets, zones and places; ground told or guessed; coarse; near things."""
    rng = np.random.default_rng(seed)
    if seed % 2:  # the map is too large for cells of R / 20
        monkeypatch.setattr(cost_grid, "_MOST_CELLS", 20)
    task, known = a_scene(seed)
    if seed % 4 < 2:
        known = replace(known, guess_m=None)
    if seed >= 8:
        task = replace(task, settings=replace(task.settings, cell_m=task.cell_m))
    memory, target = Memory(), (58e3, 57e3)
    for step in range(12):
        near_m = (-80e3, 140e3) if step % 6 == 5 else (5e3, 30e3)
        here: Place = rng.uniform(*near_m), rng.uniform(*near_m)
        kind, at = rng.integers(0, 5), rng.uniform(0.0, 60e3, 2)
        scanned = np.hypot(NORTH - at[0], EAST - at[1]) < rng.uniform(0.0, 8e3)
        if kind == 0:  # a map that does not tell what has changed
            upper_m = np.where(scanned, rng.uniform(0.0, 5e3), known.upper_m)
            known = replace(known, upper_m=upper_m, seen=known.seen | scanned)
        elif kind < 3:
            known = known.with_scan(a_scan(scanned, rng))
        elif kind == 3:
            target = here if step == 7 else tuple(at.tolist())
        else:
            task = replace(task, zones=(*task.zones, circle(*at.tolist(), 2e3)))
        belief = (*Belief, Belief.GUESSED)[step % 4]
        anew = cost_to_go(known, task, here, target, Memory(), belief=belief)
        repaired = cost_to_go(known, task, here, target, memory, belief=belief)
        assert np.isfinite(anew.value.vertex_m).all()
        assert (anew.value.vertex_m >= 0.0).all()
        assert np.isfinite([*anew.route_ne_m, (value(anew, here), anew.leaving_rad(here, R))]).all()
        assert (anew.route_ne_m[0], anew.route_ne_m[-1]) == (here, target)
        assert repaired.value.vertex_m.tobytes() == anew.value.vertex_m.tobytes()
        assert repaired.needed.vertex_m.tobytes() == anew.needed.vertex_m.tobytes()
        assert repaired.route_ne_m == anew.route_ne_m
        assert repaired.is_barred == anew.is_barred


@pytest.mark.parametrize(("here", "radius_m", "expected"), [
    ((0.0, 0.0), 5.0, (1.0, 0.0)), ((0.0, 0.0), 10.0, (8.0, 6.0)), ((0.0, 0.0), 17.0, (15.0, 8.0)),
    ((0.0, 0.0), 50.0, (30.0, 8.0)), ((1.0, 0.0), 0.5, (30.0, 7.0)),
])  # fmt: skip
def test_the_route_leaves_a_circle_where_it_crosses_it_outwards_first(
    here: Place, radius_m: float, expected: Place
) -> None:
    route = ((0.0, 0.0), (0.0, 8.0), (8.0, 8.0), (8.0, 30.0))
    flat = Surface(north_min_m=0.0, east_min_m=0.0, cell_m=1.0, vertex_m=np.zeros((2, 2)))
    field = CostToGo(value=flat, needed=flat, route_ne_m=route, is_barred=False)
    assert field.leaving_rad(here, radius_m) == pytest.approx(math.atan2(*expected))
