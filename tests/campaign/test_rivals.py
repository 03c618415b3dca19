"""Laws of the planners of whole routes that ours is held against, and of what flies them."""

import functools
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from companion import extras
from companion.campaign import drawn_world, families, truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.rivals import a_star, flight, ours
from companion.campaign.rivals.measure import measured
from companion.campaign.rivals.problem import Field, NoRoute, RouteProblem
from companion.campaign.rivals.registry import PLANNERS
from companion.campaign.route_cost import Rates, cost_rate
from companion.errors import InputError
from companion.planner.kernels import compiled_alone
from companion.world.radars import Radar
from companion.world.terrain import Peak, PeakTerrain

FloatArray = NDArray[np.float64]
SIZE, SPACING_M = 161, 10.0
NIGHTLY = pytest.mark.nightly
every_planner = pytest.mark.parametrize("name", sorted(PLANNERS))


def problem_in(rate: FloatArray, start: tuple[float, float], target: tuple[float, float]):
    """A question in a small world, 1,600 m wide."""
    field = Field(
        corner_ne_m=(-100.0, 50.0),
        spacing_m=SPACING_M,
        rate=rate,
        altitude_m=np.full(rate.shape, 120.0),
    )
    corner = np.array(field.corner_ne_m)
    return RouteProblem(
        task=families.world("copter", 5, 0).task,
        field=field,
        start_nea_m=np.array([*(corner + start), 120.0]),
        target_ne_m=corner + target,
        evaluations=5_000,
        ahead_m=math.inf,
    )


def with_discs(seed: int) -> FloatArray:
    """Closed discs and dear ones, none about the ends."""
    rng, axis = np.random.default_rng(seed), SPACING_M * np.arange(SIZE)
    rate = np.ones((SIZE, SIZE))
    for k in range(14):
        north, east = rng.uniform(250.0, 1_350.0, 2)
        away = np.hypot(axis[:, None] - north, axis[None, :] - east)
        rate[away < rng.uniform(40.0, 130.0)] = np.inf if k % 3 else 4.0
    return rate


@functools.cache
def copter_world(seed: int) -> DrawnWorld:
    """A drawn world of copters as far as 40 % of its way, with 700 m about it."""
    world = families.world("copter", seed, 0)
    start = np.array(world.start_nea_m[:2])
    target = start + 0.4 * (np.array(world.targets_ne_m[0]) - start)
    (south, north), (west, east) = (
        (max(limit[0], min(ends) - 700.0), min(limit[1], max(ends) + 700.0))
        for limit, ends in zip(
            (world.task.limits.north_m, world.task.limits.east_m),
            np.stack([start, target], axis=-1).tolist(),
            strict=True,
        )
    )
    limits = replace(world.task.limits, north_m=(south, north), east_m=(west, east))
    task, (to_north, to_east) = replace(world.task, limits=limits), target.tolist()
    near = replace(world, task=task, targets_ne_m=((to_north, to_east),))
    assert not drawn_world.is_straight_line_free(near)
    return near


def planned(name: str, problem: RouteProblem) -> FloatArray:
    route = PLANNERS[name](problem, np.random.default_rng(1))
    assert not isinstance(route, NoRoute), route
    return route


@functools.cache
def among_discs(name: str, seed: int) -> tuple[RouteProblem, FloatArray]:
    problem = problem_in(with_discs(seed), (103.0, 98.0), (1_480.0, 1_512.0))
    return problem, planned(name, problem)


@every_planner
@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=NIGHTLY), pytest.param(2, marks=NIGHTLY)]
)
def test_routes_go_from_start_to_target_and_are_free_by_brute_force(name: str, seed: int) -> None:
    problem, route = among_discs(name, seed)
    np.testing.assert_allclose(route[0, :2], problem.start_ne_m, atol=1e-9)
    np.testing.assert_allclose(route[-1, :2], problem.target_ne_m, atol=1e-9)
    assert (route[:, 2] == 120.0).all()
    closed = problem.field.place_m(np.argwhere(np.isinf(problem.field.rate)))
    for a, b in pairwise(route[:, :2]):
        for share in np.linspace(0.0, 1.0, max(math.ceil(math.dist(a, b)), 2)):
            at = a + share * (b - a)
            # off by a quarter of a spacing between the places that are looked at
            assert np.abs(closed - at).max(axis=1).min() > 0.25 * SPACING_M


@every_planner
def test_in_an_empty_world_the_route_is_the_straight_line(name: str) -> None:
    problem = problem_in(np.ones((SIZE, SIZE)), (103.0, 98.0), (1_480.0, 1_512.0))
    route = planned(name, problem)
    length = np.linalg.norm(np.diff(route, axis=0), axis=1).sum()
    assert length <= 1.005 * math.dist(problem.start_ne_m, problem.target_ne_m)


@every_planner
def test_a_plan_is_a_function_of_problem_and_seed(name: str) -> None:
    problem, first = among_discs(name, 0)
    assert np.array_equal(first, planned(name, problem))


@every_planner
def test_who_is_shut_in_says_so(name: str) -> None:
    rate = np.ones((SIZE, SIZE))
    rate[60:70, :] = np.inf
    problem = problem_in(rate, (103.0, 98.0), (1_480.0, 1_512.0))
    answer = PLANNERS[name](problem, np.random.default_rng(1))
    assert isinstance(answer, NoRoute)
    assert answer.why


@pytest.mark.parametrize("seed", range(5))
def test_a_star_over_the_grid_costs_what_dijkstra_finds(seed: int) -> None:
    rate = with_discs(seed)
    costs = a_star.step_costs(rate, 4, a_star.SIXTEEN)
    rows, columns, _ = costs.shape
    edges = []
    for i, j in np.ndindex(rows, columns):
        for k, (up, right) in enumerate(a_star.SIXTEEN):
            line = [(4 * i + s * up, 4 * j + s * right) for s in range(5)]
            if 0 <= i + up < rows and 0 <= j + right < columns:
                mean = sum(w * rate[at] for w, at in zip((1, 2, 2, 2, 1), line, strict=True)) / 8
                assert costs[i, j, k] == pytest.approx(4 * math.hypot(up, right) * mean)
                if math.isfinite(mean):
                    edges.append((costs[i, j, k], i * columns + j, (i + up) * columns + j + right))
            else:
                assert costs[i, j, k] == math.inf
    cost, here, there = zip(*edges, strict=True)
    graph = coo_array((cost, (here, there)), shape=(rows * columns, rows * columns))
    start, end = np.array([[2, 2], [3, 2]]), np.array([37, 38])
    first = np.array([1.5, 0.25])
    from_starts = dijkstra(graph, indices=start @ (columns, 1))[:, end @ (columns, 1)]
    for search in (a_star.a_star, compiled_alone(a_star.a_star)):
        found, way = search(costs / 4, np.array(a_star.SIXTEEN), start, first, end)
        assert found == pytest.approx((from_starts / 4 + first).min())
        assert tuple(way[-1]) == tuple(end)
        assert tuple(way[0]) in {(2, 2), (3, 2)}


# --- flown


@pytest.fixture(scope="module", params=["full", "scans"])
def flown(request: pytest.FixtureRequest) -> tuple[DrawnWorld, flight.RouteFlight]:
    world = copter_world(5)
    return world, flight.fly(world, a_star.plan, knowledge=request.param)


Flown = tuple[DrawnWorld, flight.RouteFlight]


def test_a_rival_arrives_and_keeps_its_clearance(flown: Flown) -> None:
    world, flight_ = flown
    points = flight_.points_nea_m
    assert flight_.arrived
    assert math.dist(points[-1, :2], world.targets_ne_m[0]) < 1e-6
    need = world.task.required_clearance_m
    over = points[:, 2] - world.terrain.height_m(points[:, 0], points[:, 1])
    assert over.min() >= 0.99 * need
    assert truth.terrain_distance_m(points, world.terrain, 2.0 * need).min() >= 0.99 * need
    assert measured(world, points).keeps_clearance
    assert points[:, 2].min() >= world.floor_amsl_m - 1e-6
    assert points[:, 2].max() <= world.ceiling_amsl_m + 1e-6


def test_a_rivals_cost_is_the_sum_along_what_it_flew(flown: Flown) -> None:
    world, flight_ = flown
    settings, weights = world.task.settings, world.task.settings.weights
    total = 0.0
    for a, b in pairwise(flight_.points_nea_m):
        middle, length = 0.5 * (a + b), math.dist(a, b)
        share = (middle[2] - world.floor_amsl_m) / (world.ceiling_amsl_m - world.floor_amsl_m)
        rate = weights.length * 100.0 / 2.4 + weights.height * 100.0 * share
        for radar in world.task.radars:
            away = math.dist(middle, radar.centre_nea_m)
            if away <= radar.range_m:
                rate += weights.radar * 300.0 / (1.0 + (away / radar.range_m) ** 4)
        total += rate / settings.scan_range_m * length
    found = measured(world, flight_.points_nea_m)
    assert found.cost == pytest.approx(total, rel=1e-9)
    assert found.length_m > 0.99 * math.dist(world.start_nea_m[:2], world.targets_ne_m[0])


def test_an_explorer_knows_nothing_behind_a_mountain_nor_beyond_its_range() -> None:
    base = families.world("dense", 0, 0)
    mountain = Peak(
        north_m=50e3, east_m=50e3, height_amsl_m=6e3, spread_north_m=3e3, spread_east_m=3e3
    )
    terrain = PeakTerrain(peaks=(mountain,), ground_amsl_m=0.0)
    world = replace(base, terrain=terrain, task=replace(base.task, radars=()))
    seeing = flight.Explorer(world, everything=False)
    seeing.look(np.array([40e3, 50e3]))
    n, e = seeing.north_m[::2, 0], seeing.east_m[0, ::2]
    away = np.hypot(n[:, None] - 40e3, e[None, :] - 50e3)
    assert not seeing.seen[away > 20e3 + 1.0].any()
    assert seeing.seen[(away < 20e3 - 300.0) & (n[:, None] < 40e3)].all()
    assert not seeing.seen[np.ix_((n > 52e3) & (n < 57e3), np.abs(e - 50e3) < 1e3)].any()


def test_a_field_costs_at_its_points_what_the_measure_says() -> None:
    base = families.world("dense", 0, 0)
    radar = Radar(name="r", centre_nea_m=(40e3, 55e3, 0.0), range_m=9e3)
    world = replace(base, task=replace(base.task, radars=(radar,)))
    field = flight.Explorer(world, everything=True).field(np.zeros(2))
    index = np.random.default_rng(2).integers(0, min(field.rate.shape), (3_000, 2))
    rate = field.rate[tuple(index.T)]
    points = np.column_stack([field.place_m(index), field.altitude_m[tuple(index.T)]])
    free = np.isfinite(rate)
    assert 0 < free.sum() < len(free)
    expected = cost_rate(points[free], world) / Rates.of(world).unit
    np.testing.assert_allclose(rate[free], expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (np.zeros((3, 2)), "no route"),
        (np.full((4, 3), np.nan), "no route"),
        (np.zeros((4, 3)), "does not go from the start"),
        (NoRoute(why="no time"), "no time"),
    ],
)
def test_an_answer_that_is_no_route_ends_the_flight_with_its_reason(answer, why) -> None:
    found = flight.fly(copter_world(5), lambda _problem, _rng: answer)
    assert not found.arrived
    assert why in found.why
    assert len(found.points_nea_m) == 1


def test_a_turn_is_as_sharp_as_its_circle_and_a_corner_is_too_sharp() -> None:
    world = families.world("dense", 0, 0)
    radius_m = 1.2 * world.task.limits.turn_radius_m
    angle = np.linspace(0.0, math.pi, 2_000)
    high = np.full(len(angle), world.floor_amsl_m)
    half = np.column_stack([radius_m * np.sin(angle), radius_m * (1 - np.cos(angle)), high])
    found = measured(world, half)
    assert found.turn_radius_m == pytest.approx(radius_m, rel=2e-3)
    assert found.keeps_turns
    corner = np.array([[0.0, 0.0, 4e3], [20e3, 0.0, 4e3], [20e3, 20e3, 4e3]])
    assert not measured(world, corner).keeps_turns
    assert measured(world, corner, stops=(1,)).keeps_turns
    steep = np.array([[0.0, 0.0, 4e3], [20e3, 0.0, 4e3 + 20e3 * math.tan(math.radians(11.0))]])
    assert not measured(world, steep).keeps_slopes
    assert measured(world, steep * (1.0, 1.0, 0.8)).slope < 1.0


def test_ours_with_full_knowledge_costs_no_more_and_keeps_every_bound() -> None:
    world = copter_world(41)
    costs = {}
    for knowledge in ("scans", "full"):
        found = ours.fly(world, knowledge=knowledge)
        assert found.arrived
        costs[knowledge] = measured(world, found.points_nea_m, found.stops)
        of = costs[knowledge]
        assert of.keeps_clearance
        assert of.keeps_turns
        assert of.keeps_slopes
    assert costs["full"].cost <= 1.01 * costs["scans"].cost


def test_without_ompl_its_planners_name_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _name: None)
    problem = problem_in(np.ones((SIZE, SIZE)), (103.0, 98.0), (1_480.0, 1_512.0))
    with pytest.raises(InputError, match=r"RRTstar.*ompl.*companion\[compare\]"):
        PLANNERS["rrt-star"](problem, np.random.default_rng(1))
