"""What bars a leg or a route, seen near by, believed or forbidden: against brute force."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning import PLANE_TASK, TASK, leg_of, limits, zone_distance_m

from companion.geodesy import FloatArray
from companion.planner.cost_grid import CostGrid
from companion.planner.cost_samples import BLOCKED
from companion.planner.procedure import Leg
from companion.planner.settings import Task
from companion.world.known_map import Lattice, empty_map
from companion.world.near_map import NearMap
from companion.world.zones import CircleZone, PolygonZone, Zone

seeds = st.integers(0, 10**6)


def a_leg(rng: np.random.Generator, length_m: float, climb: float = 0.0) -> Leg:
    """Curved, from the origin towards the north."""
    points = int(rng.integers(4, 7))
    turn = np.cumsum(rng.normal(0.0, 0.5, points - 1))
    steps = np.stack([np.cos(turn), np.sin(turn), np.full_like(turn, climb)], axis=-1)
    control = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]) * length_m / (points - 1)
    return leg_of(control)


def straight_on(north_m: float) -> Leg:
    return leg_of(np.outer(np.linspace(0.0, 1.0, 4), [north_m, 0.0, 0.0]))


def rest_ne_m(leg: Leg, from_m: float, count: int) -> FloatArray:
    """So many points of what is left of it.  (count, 2)."""
    return leg.subpath.points_nea_m(np.linspace(from_m, leg.subpath.length_m, count))[:, :2]


# --- zones


def zones_along(rng: np.random.Generator, leg: Leg) -> tuple[Zone, ...]:
    zones: list[Zone] = []
    for _ in range(rng.integers(1, 5)):
        at_m = rng.uniform(0.0, leg.subpath.length_m)
        n, e = leg.subpath.pose(at_m).position_nea_m[:2] + rng.normal(0.0, 900.0, 2)
        corners = np.array([n, e]) + rng.normal(0.0, 500.0, (5, 2))
        circle = CircleZone(name="c", north_m=n, east_m=e, radius_m=rng.uniform(50.0, 800.0))
        polygon = PolygonZone(name="p", vertices_ne_m=tuple((a, b) for a, b in corners.tolist()))
        zones.append(circle if rng.random() < 0.5 else polygon)
    if rng.random() < 0.3:
        zones.append(CircleZone(name="k", north_m=0.0, east_m=0.0, radius_m=15_000.0, keep_in=True))
    return tuple(zones)


@given(seed=seeds, required_m=st.floats(20.0, 600.0))
def test_a_leg_comes_too_near_where_dense_samples_do(seed: int, required_m: float) -> None:
    rng = np.random.default_rng(seed)
    leg = a_leg(rng, 20_000.0, 0.05)
    zones, from_m = zones_along(rng, leg), rng.uniform(0.0, 0.5) * leg.subpath.length_m
    points = rest_ne_m(leg, from_m, 8_001)  # about 2.5 m apart
    gap_m = min(zone_distance_m(zone, *points.T).min() for zone in zones)
    if leg.nears(zones, from_m, required_m):
        assert gap_m < required_m + 2.0
    else:
        assert gap_m >= 0.998 * required_m - 0.01


def fence(edge_m: float) -> PolygonZone:
    corners = (-1e4, edge_m), (3e4, edge_m), (3e4, 5e3), (-1e4, 5e3)
    return PolygonZone(name="p", vertices_ne_m=corners)


def needle(tip_m: float) -> PolygonZone:
    """Its tip comes near to the path, off the middles of its pieces."""
    corners = (7_010.0, tip_m), (7_009.0, 400.0), (7_011.0, 400.0)
    return PolygonZone(name="p", vertices_ne_m=corners)


BEHIND = CircleZone(name="c", north_m=5_000.0, east_m=0.0, radius_m=500.0)


@pytest.mark.parametrize(("zone", "from_m", "required_m", "near"), [
    (fence(515.0 - 1.5), 100.0, 515.0, True), (fence(515.0 - 1.1), 100.0, 515.0, True),
    (fence(515.0), 100.0, 515.0, False), (fence(516.0), 100.0, 515.0, False),
    (BEHIND, 5_599.0, 100.0, True), (BEHIND, 5_600.5, 100.0, False),
    (needle(98.0), 0.0, 100.0, True), (needle(101.0), 0.0, 100.0, False),
])  # fmt: skip
def test_of_a_leg_at_just_the_required_distance_none_is_too_near(
    zone: Zone, from_m: float, required_m: float, near: bool
) -> None:
    assert straight_on(20_000.0).nears((zone,), from_m, required_m) is near


# --- rules that have changed

LOW_M = 300.0 + 10.0  # of the floor, and tracking and navigation error
ACROSS = CircleZone(name="new", north_m=4_000.0, east_m=500.0, radius_m=100.0)


def low_leg(rules: Task, below_m: float = 0.0) -> Leg:
    """Across the map, as low as it is proven, or lower."""
    control = np.linspace((1_000.0, 500.0, LOW_M - below_m), (7_000.0, 500.0, LOW_M + 90.0), 4)
    return leg_of(control, rules=rules)


def but(task: Task, *zones: Zone, **changes: float) -> Task:
    return replace(task, limits=replace(task.limits, **changes), zones=(*task.zones, *zones))


@pytest.mark.parametrize("below_m", [0.0, 0.7, 50.0])
def test_what_was_proven_stays_proven_while_the_rules_are_the_same_or_less(below_m: float) -> None:
    """However it was proven: `paper` proves nothing, a way out leads through its zone."""
    bounded, above = but(TASK, ACROSS), but(TASK, ceiling_amsl_m=350.0)
    less = but(TASK, floor_amsl_m=250.0, ceiling_amsl_m=800.0)
    pairs = (TASK, but(TASK)), (bounded, bounded), (bounded, TASK), (TASK, less), (above, above)
    for before, now in pairs:
        assert not low_leg(before, below_m).is_touched(0.0, now)


def test_a_rule_that_is_new_is_held_against_what_is_left_of_a_leg() -> None:
    leg = low_leg(TASK)
    for from_m, now, touched in (
        (0.0, but(TASK, ACROSS), True),
        (4_000.0, but(TASK, ACROSS), False),
        (0.0, but(TASK, floor_amsl_m=301.0), True),
        (0.0, but(TASK, floor_amsl_m=300.4), False),  # home moves so far
        (1_000.0, but(TASK, floor_amsl_m=301.0), False),
        (0.0, but(TASK, ceiling_amsl_m=LOW_M + 90.0), True),
    ):
        assert leg.is_touched(from_m, now) is touched
    # of one whose rules nobody knows all rules count
    unruled = TASK.unruled()
    assert not low_leg(unruled).is_touched(0.0, TASK)
    assert low_leg(unruled, below_m=0.7).is_touched(0.0, TASK)
    assert low_leg(unruled).is_touched(0.0, but(TASK, ACROSS))


# --- near things

CELL_M = 0.25
PLACE = Lattice(cell_m=CELL_M, north_min_m=-5.0, east_min_m=-10.0, shape=(120, 80))


def near_map(*occupied: tuple[int, int]) -> NearMap:
    near = NearMap(PLACE)
    for cell in occupied:
        near.met_since_s[cell] = near.met_s[cell] = 1.0
    return near


def gap_m(points: FloatArray, cells: list[tuple[int, int]]) -> float:
    """From the nearest of points to the nearest square.  Each by itself."""
    least = math.inf
    for row, column in cells:
        low = np.array([PLACE.north_min_m + row * CELL_M, PLACE.east_min_m + column * CELL_M])
        apart = np.maximum(np.maximum(low - points, points - low - CELL_M), 0.0)
        least = min(least, float(np.hypot(*apart.T).min()))
    return least


@given(seed=seeds, required_m=st.floats(CELL_M, 3.0), share=st.floats(0.0, 0.99))
def test_a_leg_meets_what_stands_nearer_to_its_rest_than_required(
    seed: int, required_m: float, share: float
) -> None:
    rng = np.random.default_rng(seed)
    leg = a_leg(rng, 15.0)
    cells = [tuple(rng.integers(0, PLACE.shape).tolist()) for _ in range(rng.integers(0, 6))]
    from_m = share * leg.subpath.length_m
    points = rest_ne_m(leg, from_m, 4_001)
    gap, now = gap_m(points, cells), gap_m(points[:1], cells)
    meets = leg.meets(near_map(*cells), from_m, required_m)
    if gap >= required_m + 1e-9:
        assert not meets
    elif gap < required_m - CELL_M / 30.0 and now >= required_m:
        assert meets


BESIDE = (18, 40)  # 0.25 m south of where the leg begins
WALL = [(row, 42) for row in range(10, 110)]  # 0.5 m to the east of it


@pytest.mark.parametrize(("length_m", "cells", "meets"), [
    (8.0, [BESIDE], False),
    (0.5, [BESIDE], True),  # it ends too near
    (8.0, [(22, 40)], True), (8.0, WALL, True),
    (8.0, [BESIDE, (44, 40)], True),
])  # fmt: skip
def test_what_is_too_near_is_left_by_a_leg_that_leads_away_soon_and_to_nothing_else(
    length_m: float, cells: list[tuple[int, int]], meets: bool
) -> None:
    assert straight_on(length_m).meets(near_map(*cells), 0.0, 1.0) is meets


# --- routes


def costs(rng: np.random.Generator, rows: int, corner_m: float) -> CostGrid:
    """Of a map whose cells are a metre wide, some blocked."""
    area = (corner_m, corner_m + rows - 1.0)
    task = replace(PLANE_TASK, limits=limits(north_m=area, east_m=area))
    task = replace(task, settings=replace(task.settings, scan_range_m=40.0))
    grid = CostGrid(empty_map(1.0, area, area), task)
    blocked = rng.random(len(grid.samples.cost)) < 0.04
    grid.samples.cost[:] = np.where(blocked, BLOCKED + rng.random(len(blocked)), 30.0)
    return grid


def any_blocked(grid: CostGrid, points: FloatArray, within: float) -> bool:
    """Whether any of (N, 2) points lies within so much of a step, each way, of a blocked sample."""
    cost = grid.samples.cost.reshape(grid.shape)
    at, last = grid.sample_of(points), np.array(cost.shape) - 1
    inside = ((at >= -0.5) & (at <= last + 0.5)).all(axis=1)
    cells = np.clip(np.floor(at[inside] + 0.5).astype(int), 0, last)
    near = np.abs(at[inside] - cells).max(axis=1) <= within
    return bool((near & (cost[cells[:, 0], cells[:, 1]] >= BLOCKED)).any())


@given(seed=seeds)
def test_a_route_is_barred_where_it_passes_a_blocked_sample(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = costs(rng, 21, -10.0)
    route = rng.uniform(-15.0, 15.0, (int(rng.integers(2, 6)), 2))
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(route, axis=0).T)))

    def sampled(until_m: float) -> FloatArray:
        at = np.linspace(0.0, until_m, 6_000)
        return np.stack([np.interp(at, along, route[:, k]) for k in (0, 1)], axis=-1)

    if grid.bars(route):
        assert any_blocked(grid, sampled(along[-1]), 0.51)
    else:
        assert not any_blocked(grid, sampled(along[-1] - 0.51), 0.24)
