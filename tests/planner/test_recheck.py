"""What bars a leg or a route, seen near by, believed or forbidden: against brute force."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning import PLANE_TASK, TASK, circle, drawn_zones, leg_of, limits, zones_distance_m

from companion.geodesy import FloatArray
from companion.planner.cost_grid import CostGrid
from companion.planner.cost_samples import BLOCKED
from companion.planner.procedure import Leg
from companion.planner.settings import Task
from companion.world.known_map import Lattice, empty_map
from companion.world.near_map import NearMap
from companion.world.zones import Zone

seeds = st.integers(0, 10**6)


def a_leg(rng: np.random.Generator, length_m: float, climb: float = 0.0) -> Leg:
    """Curved, from the origin towards the north."""
    turn = np.cumsum(rng.normal(0.0, 0.5, int(rng.integers(3, 6))))
    steps = np.stack([np.cos(turn), np.sin(turn), np.full_like(turn, climb)], axis=-1)
    return leg_of(np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]) * length_m / len(turn))


def rest_ne_m(leg: Leg, from_m: float, count: int) -> FloatArray:
    """So many points of what is left of it.  (count, 2)."""
    return leg.subpath.points_nea_m(np.linspace(from_m, leg.subpath.length_m, count))[:, :2]


# --- zones


@settings(max_examples=40)
@given(seed=seeds, share=st.floats(0.0, 0.5), off=st.sampled_from([0.5, 0.98, 1.0, 1.01]))
def test_a_leg_is_too_near_to_zones_where_dense_samples_are(
    seed: int, share: float, off: float
) -> None:
    """off: the distance as a share of what is required."""
    rng = np.random.default_rng(seed)
    leg = a_leg(rng, 5_000.0, 0.05)
    at_ne_m = leg.subpath.pose(rng.uniform(0.0, leg.subpath.length_m)).position_nea_m[:2]
    zones = drawn_zones(rng, int(rng.integers(1, 5)), at_ne_m, 1_500.0, 800.0, 0.1)
    from_m = share * leg.subpath.length_m
    points = rest_ne_m(leg, from_m, 1_001)  # about 5 m apart
    gap_m = float(zones_distance_m(zones, points).min())
    required_m = max(gap_m / off, 20.0)
    nears = leg.nears(zones, from_m, required_m)
    if gap_m >= required_m + 0.01:
        assert not nears
    elif gap_m < 0.997 * required_m - 0.1:
        assert nears


# --- rules that have changed

LOW_M = 300.0 + 10.0  # of the floor, and tracking and navigation error
ACROSS = circle(4_000.0, 500.0, 100.0)


def but(task: Task, *zones: Zone, **changes: float) -> Task:
    return replace(task, limits=replace(task.limits, **changes), zones=(*task.zones, *zones))


NOBODY_KNOWS = TASK.unruled()


@pytest.mark.parametrize(("below_m", "before", "from_m", "now", "is_touched"), [
    # what was proven stays proven while rules are the same or less, however it was proven
    *((below_m, before, 0.0, now, False) for below_m in (0.0, 50.0) for before, now in (
        (TASK, but(TASK)), (but(TASK, ACROSS), but(TASK, ACROSS)), (but(TASK, ACROSS), TASK),
        (TASK, but(TASK, floor_amsl_m=250.0, ceiling_amsl_m=800.0)),
        (but(TASK, ceiling_amsl_m=350.0), but(TASK, ceiling_amsl_m=350.0)),
    )),
    # a rule that is new is held against what is left
    (0.0, TASK, 0.0, but(TASK, ACROSS), True), (0.0, TASK, 4_000.0, but(TASK, ACROSS), False),
    (0.0, TASK, 0.0, but(TASK, floor_amsl_m=301.0), True),
    (0.0, TASK, 0.0, but(TASK, floor_amsl_m=300.4), False),  # home moves so far
    (0.0, TASK, 1_000.0, but(TASK, floor_amsl_m=301.0), False),
    (0.0, TASK, 0.0, but(TASK, ceiling_amsl_m=LOW_M + 90.0), True),
    (0.0, NOBODY_KNOWS, 0.0, TASK, False), (0.7, NOBODY_KNOWS, 0.0, TASK, True),
    (0.0, NOBODY_KNOWS, 0.0, but(TASK, ACROSS), True),
])  # fmt: skip
def test_only_a_rule_that_is_new_or_stricter_touches_what_is_left_of_a_leg(
    below_m: float, before: Task, from_m: float, now: Task, is_touched: bool
) -> None:
    """The leg goes across the map, as low as it is proven, or lower."""
    control = np.linspace((1_000.0, 500.0, LOW_M - below_m), (7_000.0, 500.0, LOW_M + 90.0), 4)
    assert leg_of(control, rules=before).is_touched(from_m, now) is is_touched


# --- near things

CELL_M = 0.25
PLACE = Lattice(cell_m=CELL_M, north_min_m=-5.0, east_min_m=-10.0, shape=(120, 80))


def near_map(*occupied: tuple[int, int]) -> NearMap:
    near = NearMap(PLACE)
    for cell in occupied:
        near.met_since_s[cell] = near.met_s[cell] = 1.0
    return near


@given(seed=seeds, required_m=st.floats(CELL_M, 3.0), share=st.floats(0.0, 0.99))
def test_a_leg_meets_what_stands_nearer_to_its_rest_than_required(
    seed: int, required_m: float, share: float
) -> None:
    rng = np.random.default_rng(seed)
    leg = a_leg(rng, 15.0)
    cells = rng.integers(0, PLACE.shape, (rng.integers(1, 6), 2))
    from_m = share * leg.subpath.length_m
    points, low = rest_ne_m(leg, from_m, 4_001), cells * CELL_M - (5.0, 10.0)
    apart = np.maximum(np.maximum(low - points[:, None], points[:, None] - low - CELL_M), 0.0)
    gaps_m = np.hypot(*np.moveaxis(apart, -1, 0)).min(axis=1)
    meets = leg.meets(near_map(*map(tuple, cells.tolist())), from_m, required_m)
    if gaps_m.min() >= required_m + 1e-9:
        assert not meets
    elif gaps_m.min() < required_m - CELL_M / 30.0 and gaps_m[0] >= required_m:
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
    leg = leg_of(np.outer(np.linspace(0.0, 1.0, 4), [length_m, 0.0, 0.0]))
    assert leg.meets(near_map(*cells), 0.0, 1.0) is meets


# --- routes


@given(seed=seeds)
def test_a_route_is_barred_where_it_passes_a_blocked_sample(seed: int) -> None:
    """Of a map whose cells are a metre wide; samples are half a metre apart."""
    rng, area = np.random.default_rng(seed), (-10.0, 10.0)
    task = replace(PLANE_TASK, limits=limits(north_m=area, east_m=area))
    task = replace(task, settings=replace(task.settings, scan_range_m=40.0))
    grid = CostGrid(empty_map(1.0, area, area), task)
    blocked = rng.random(len(grid.samples.cost)) < 0.04
    grid.samples.cost[:] = np.where(blocked, BLOCKED + rng.random(len(blocked)), 30.0)
    middles = np.argwhere(blocked.reshape(grid.shape))
    route = rng.uniform(-15.0, 15.0, (int(rng.integers(2, 6)), 2))
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(route, axis=0).T)))

    def passes(until_m: float, within: float) -> bool:
        """Whether it comes within so much of a step, each way, of a blocked sample."""
        at_m = np.linspace(0.0, until_m, 6_000)
        points = np.stack([np.interp(at_m, along, route[:, k]) for k in (0, 1)], axis=-1)
        apart = np.abs(grid.sample_of(points)[:, None] - middles)
        return bool((apart.max(axis=2) <= within).any())

    if grid.bars(route):
        assert passes(along[-1], 0.51)
    else:
        assert not passes(along[-1] - 0.51, 0.24)
