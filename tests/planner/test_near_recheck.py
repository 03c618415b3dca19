"""What bars the way, seen near by or believed: against brute force."""

import math
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from planning import PLANE_TASK, leg_of, limits

from companion.planner.cost_grid import CostGrid
from companion.planner.cost_samples import BLOCKED
from companion.planner.procedure import Leg
from companion.planner.recheck import meets_near_things
from companion.world.known_map import empty_map
from companion.world.lattice import Lattice
from companion.world.near_map import NearMap

CELL_M = 0.25
PLACE = Lattice(cell_m=CELL_M, north_min_m=-5.0, east_min_m=-10.0, shape=(120, 80))


def a_leg(rng: np.random.Generator) -> Leg:
    """About 15 m, curved, level, from within the map towards the north; it may leave the map."""
    turn = np.cumsum(rng.normal(0.0, 0.4, 4))
    steps = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=-1) * 4.0
    control = np.array([0.0, 0.0, 400.0]) + np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    return leg_of(control)


def near_map(occupied: list[tuple[int, int]]) -> NearMap:
    near = NearMap(PLACE)
    for cell in occupied:
        near.met_since_s[cell] = near.met_s[cell] = 1.0
    return near


def gap_m(points: np.ndarray, cells: list[tuple[int, int]]) -> float:  # type: ignore[type-arg]
    """From the nearest of points to the nearest square.  Each by itself."""
    least = math.inf
    for row, column in cells:
        low = np.array([PLACE.north_min_m + row * CELL_M, PLACE.east_min_m + column * CELL_M])
        apart = np.maximum(np.maximum(low - points, points - low - CELL_M), 0.0)
        least = min(least, float(np.hypot(*apart.T).min()))
    return least


@given(seed=st.integers(0, 10**6), required_m=st.floats(CELL_M, 3.0), share=st.floats(0.0, 0.99))
def test_a_leg_meets_what_stands_nearer_to_its_rest_than_required(
    seed: int, required_m: float, share: float
) -> None:
    rng = np.random.default_rng(seed)
    leg = a_leg(rng)
    cells = [tuple(rng.integers(0, PLACE.shape).tolist()) for _ in range(rng.integers(0, 6))]
    from_m = share * leg.subpath.length_m
    lengths = np.linspace(from_m, leg.subpath.length_m, 4001)
    points = leg.subpath.points_nea_m(lengths)[:, :2]
    gap, now = gap_m(points, cells), gap_m(points[:1], cells)
    meets = meets_near_things(leg, from_m, near_map(cells), required_m)
    if gap >= required_m + 1e-9:
        assert not meets
    elif gap < required_m - CELL_M / 30.0 and now >= required_m:
        assert meets


def test_what_is_behind_or_was_wiped_out_is_not_met() -> None:
    leg, near = straight_on(16.0), near_map([(20, 40)])  # at the leg's begin
    assert [meets_near_things(leg, from_m, near, 0.5) for from_m in (0.0, 2.0)] == [True, False]
    near.met_since_s[20, 40] = math.inf
    assert not meets_near_things(leg, 0.0, near, 0.5)
    assert meets_near_things(leg, leg.subpath.length_m, near_map([(84, 40)]), 0.5)  # at its end


def straight_on(north_m: float) -> Leg:
    return leg_of(np.outer(np.linspace(0.0, 1.0, 4), [north_m, 0.0, 0.0]))


def test_what_is_too_near_is_left_by_a_leg_that_leads_away_soon_and_to_nothing_else() -> None:
    behind, abeam = (18, 40), [(row, 42) for row in range(10, 110)]  # 0.25 m south, 0.5 m east
    assert not meets_near_things(straight_on(8.0), 0.0, near_map([behind]), 1.0)
    assert not meets_near_things(straight_on(8.0), 0.3, near_map([behind]), 1.0)
    assert meets_near_things(straight_on(0.5), 0.0, near_map([behind]), 1.0)  # it ends too near
    assert meets_near_things(straight_on(8.0), 0.0, near_map([(22, 40)]), 1.0)  # ahead
    assert meets_near_things(straight_on(8.0), 0.0, near_map(abeam), 1.0)  # along a wall
    assert meets_near_things(straight_on(8.0), 0.0, near_map([behind, (44, 40)]), 1.0)  # to another


# --- routes


def costs(rng: np.random.Generator, rows: int, step_m: float, corner_m: float) -> CostGrid:
    """Of a map whose cells are a step wide, some blocked."""
    low_m, high_m = corner_m, corner_m + (rows - 1) * step_m
    task = replace(PLANE_TASK, limits=limits(north_m=(low_m, high_m), east_m=(low_m, high_m)))
    task = replace(task, settings=replace(task.settings, scan_range_m=40.0 * step_m))
    grid = CostGrid(empty_map(step_m, (low_m, high_m), (low_m, high_m)), task)
    blocked = rng.random(len(grid.samples.cost)) < 0.04
    grid.samples.cost[:] = np.where(blocked, BLOCKED + rng.random(len(blocked)), 30.0)
    return grid


def any_blocked(grid: CostGrid, points: np.ndarray, within: float) -> bool:  # type: ignore[type-arg]
    """Whether any of (N, 2) points lies within so much of a step, each way, of a blocked sample."""
    cost = grid.samples.cost.reshape(grid.shape)
    at = grid.sample_of(points)
    last = np.array(cost.shape) - 1
    inside = ((at >= -0.5) & (at <= last + 0.5)).all(axis=1)
    cells = np.clip(np.floor(at[inside] + 0.5).astype(int), 0, last)
    near = np.abs(at[inside] - cells).max(axis=1) <= within
    return bool((near & (cost[cells[:, 0], cells[:, 1]] >= BLOCKED)).any())


@given(seed=st.integers(0, 10**6))
def test_a_route_is_barred_where_it_passes_a_blocked_sample(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = costs(rng, 21, 1.0, -10.0)
    route = rng.uniform(-15.0, 15.0, (int(rng.integers(2, 6)), 2))
    legs = np.hypot(*np.diff(route, axis=0).T)
    along = np.append(0.0, np.cumsum(legs))
    at = np.linspace(0.0, along[-1] - 0.51, 6000)
    points = np.stack([np.interp(at, along, route[:, k]) for k in (0, 1)], axis=-1)
    if grid.bars(route):
        more = np.linspace(0.0, along[-1], 6000)
        ends = np.stack([np.interp(more, along, route[:, k]) for k in (0, 1)], axis=-1)
        assert any_blocked(grid, ends, 0.51)
    else:
        assert not any_blocked(grid, points, 0.24)


def test_no_way_at_all_and_a_way_outside_of_the_grid_are_not_barred() -> None:
    grid = costs(np.random.default_rng(1), 5, 1.0, 0.0)
    grid.samples.cost[:] = BLOCKED
    assert not grid.bars(np.array([[2.0, 2.0]]))
    assert not grid.bars(np.array([[50.0, 2.0], [60.0, 2.0]]))
    assert grid.bars(np.array([[2.0, 2.0], [2.0, 3.0]]))
