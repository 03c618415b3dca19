"""Laws of the planners of whole routes that ours is held against, and of how they are flown."""

import functools
import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from planning import ask
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path

from companion import extras
from companion.campaign import families, truth
from companion.campaign.file import Knowledge
from companion.campaign.run import fly_alone
from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.paper import rivals
from companion.paper.rivals import PLANNERS, RouteProblem
from companion.planner.request import NotPlanned, PlanRequest
from companion.planning import planner_of
from companion.world.simulated import true_map

SIZE, SPACING_M = 161, 10.0
plan = rivals.leg_by_leg(PLANNERS["a-star"])


def problem_in(rate: FloatArray) -> RouteProblem:
    """A question in a small world, 1,600 m wide."""
    corner = np.array([-100.0, 50.0])
    return RouteProblem(
        corner_ne_m=corner,
        spacing_m=SPACING_M,
        rate=rate,
        start_ne_m=corner + np.array([103.0, 98.0]),
        target_ne_m=corner + np.array([1_480.0, 1_512.0]),
        lines=5_000,
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


def planned(name: str, problem: RouteProblem) -> FloatArray:
    """A route as it is flown: pulled straight."""
    route = PLANNERS[name](problem, np.random.default_rng(1))
    assert route is not None
    return problem.straight(route)


@pytest.mark.parametrize("name", PLANNERS)
def test_routes_go_from_start_to_target_are_free_by_brute_force_and_the_same_again(
    name: str,
) -> None:
    """In an empty world they are straight, and who is shut in says so."""
    empty = problem_in(np.ones((SIZE, SIZE)))
    length_m = np.linalg.norm(np.diff(planned(name, empty), axis=0), axis=1).sum()
    assert length_m <= 1.005 * math.dist(empty.start_ne_m, empty.target_ne_m)
    empty.rate[60:70, :] = np.inf
    assert PLANNERS[name](empty, np.random.default_rng(1)) is None
    problem = problem_in(with_discs(0))
    route = planned(name, problem)
    np.testing.assert_allclose(route[[0, -1]], [problem.start_ne_m, problem.target_ne_m], atol=1e-9)
    closed = problem.place_m(np.argwhere(np.isinf(problem.rate)))
    for a, b in pairwise(route):
        for share in np.linspace(0.0, 1.0, max(math.ceil(math.dist(a, b)), 2)):
            at = a + share * (b - a)
            # off by a quarter of a spacing between the places that are looked at
            assert np.abs(closed - at).max(axis=1).min() > 0.25 * SPACING_M
    assert np.array_equal(route, planned(name, problem))


@pytest.mark.parametrize(
    ("every", "ways"), [(4, rivals.SIXTEEN), (4, rivals.SIXTEEN[:4]), (1, rivals.SIXTEEN[:4])]
)
def test_steps_of_a_grid_cost_its_rate_along_them_and_the_cheapest_way_the_least_of_all(
    every: int, ways: tuple[tuple[int, int], ...]
) -> None:
    rate = with_discs(1)[60 : 61 + 20 * every, 60 : 61 + 20 * every]
    rows, columns = rate[::every, ::every].shape
    expected, along = np.full((rows * columns,) * 2, np.inf), np.arange(every + 1)[:, None]
    for up, right in ways:
        i, j = np.argwhere(np.ones((rows, columns))).T
        is_inside = (i + up < rows) & (j + right >= 0) & (j + right < columns)
        i, j = i[is_inside], j[is_inside]
        line = rate[every * i + along * up, every * j + along * right]
        there = (i + up) * columns + j + right
        expected[i * columns + j, there] = np.trapezoid(line, axis=0) * math.hypot(up, right)
    costs, steps = rivals.grid_steps(rate, every, ways)
    graph = csr_array((costs, steps.T), shape=expected.shape)
    np.testing.assert_allclose(graph.toarray(), np.where(np.isfinite(expected), expected, 0.0))
    start, end = 2 * columns + 2, 17 * columns + 18
    way = rivals.cheapest(graph, start, end)
    assert (way[0], way[-1]) == (start, end)
    paid = sum(min(expected[a, b], expected[b, a]) for a, b in pairwise(way))
    least = shortest_path(graph, method="FW", directed=False)[start, end]
    assert paid == pytest.approx(least)
    line = csr_array(([1.0, 1.0], ([0, 1], [1, 2])), shape=(4, 4))
    assert [rivals.cheapest(line, 0, end) for end in (2, 3)] == [[0, 1, 2], []]


# --- flown


@pytest.mark.parametrize("knowledge", ["full", "scans"])
def test_a_rival_arrives_and_keeps_its_clearance(knowledge: Knowledge) -> None:
    world = families.world("short-copter", 5, 0)
    flown, _ = fly_alone(world, "a-star", knowledge=knowledge)
    points = flown.route_nea_m(0.3)
    assert flown.failure is None
    assert math.dist(points[-1, :2], world.targets_ne_m[0]) < 1e-6
    need = world.task.required_clearance_m
    assert truth.terrain_distance_m(points, world.terrain, 2.0 * need).min() >= 0.99 * need
    inside_m = points[:, 2].clip(*world.task.band_amsl_m)
    assert points[:, 2] == pytest.approx(inside_m, abs=1e-6)


@functools.cache
def asked() -> PlanRequest:
    """What is asked at the start of a dense world, of which everything is known."""
    world = families.world("dense", 0, 0)
    known = true_map(world.terrain, families.unseen(world))
    return ask(world.task, known, world.start_nea_m, seed=1, target_ne_m=world.targets_ne_m[0])


def test_unseen_ground_is_free_in_the_plan_and_never_flown_over() -> None:
    request = asked()
    start = np.array(request.start.point_nea_m[:2])
    blank = replace(request.known, upper_m=np.full_like(request.known.upper_m, np.inf))
    rows, columns = request.known.middles_m()
    near = np.hypot(rows - start[0], columns - start[1]) < 6_000.0
    seen = replace(blank, upper_m=np.zeros(near.shape), seen=near)  # the rest is but bounded
    outcome = plan(replace(request, known=seen))
    assert not isinstance(outcome, NotPlanned)
    assert not outcome.reaches_target
    away = np.hypot(*(outcome.subpath.control_nea_m[:, :2] - start).T)
    assert 4_500.0 < away.max() < 6_000.0 + 1.5 * seen.cell_m
    answer = plan(replace(request, known=replace(seen, upper_m=np.where(near, 9e3, np.inf))))
    assert isinstance(answer, NotPlanned)


@pytest.mark.parametrize(
    "answer",
    [np.zeros((3, 3)), np.full((4, 2), np.nan), np.zeros((4, 2)), np.zeros((1, 2)), "no way"],
)
def test_an_answer_that_is_no_route_is_refused(answer: Any) -> None:
    plan = rivals.leg_by_leg(lambda _problem, _rng: answer)
    with pytest.raises(InputError, match="a route is"):
        plan(asked())


def test_without_ompl_its_planner_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _name: None)
    with pytest.raises(InputError, match=r"factors.planner.*rrt-star.*ompl.*companion\[compare\]"):
        planner_of("rrt-star", "factors.planner")
    with pytest.raises(InputError, match=r"planner.*rrt-star.*ompl"):  # taken by itself, too
        PLANNERS["rrt-star"](problem_in(np.ones((9, 9))), np.random.default_rng(1))
