"""That there is no way is said only where there is none, and then at once; and a mission ends.

The argument that it ends is in `planner.progress`.
"""

import math
from dataclasses import replace

import numpy as np
import planning
import pytest
import scipy.ndimage
from hypothesis import given
from hypothesis import strategies as st
from planning import ask, circle, hills, planned, refused

from companion.campaign import families
from companion.config import load_mission
from companion.geodesy import BoolArray, FloatArray
from companion.planner.field import cost_to_go
from companion.planner.progress import SLACK, Progress
from companion.planner.request import PlanRequest, Refusal
from companion.planner.settings import PlannerSettings, Task
from companion.planner.way_out import blocked_at
from companion.world.known_map import KnownMap, empty_map
from companion.world.simulated import true_map
from companion.world.zones import PolygonZone, Zone

_BASE = load_mission("environment-1").task
SIZE_M, CELL_M = 40e3, 250.0
TASK = replace(
    _BASE,
    radars=(),
    zones=(),
    limits=replace(_BASE.limits, north_m=(0.0, SIZE_M), east_m=(0.0, SIZE_M)),
)
BLANK = empty_map(CELL_M, (0.0, SIZE_M), (0.0, SIZE_M))
ROWS = BLANK.upper_m.shape[0]
NORTH, EAST = BLANK.middles_m()
HERE, TARGET = (5e3, 20e3), (35e3, 20e3)
CLEAR_M = TASK.required_clearance_m


def all_seen(height_m: FloatArray) -> KnownMap:
    height = np.broadcast_to(height_m, (ROWS, ROWS)).astype(np.float64)
    return replace(BLANK, upper_m=height, seen=np.ones((ROWS, ROWS), dtype=bool))


def closed(known: KnownMap, task: Task = TASK) -> tuple[float, float] | None:
    field = cost_to_go(known, task, HERE, TARGET)
    return blocked_at(known, task, field, (HERE, TARGET))


def wall(gap_m: float = 0.0, at_m: float = 30e3) -> FloatArray:
    """Over the ceiling from edge to edge, but for a gap."""
    across = np.abs(NORTH - 20e3) < 300.0
    return np.asarray(np.where(across & (np.abs(EAST - at_m) > 0.5 * gap_m), 6e3, 0.0))


def edge_to_edge(east_m: float) -> PolygonZone:
    corners = ((18e3, -1e3), (22e3, -1e3), (22e3, east_m), (18e3, east_m))
    return PolygonZone(name="fence", vertices_ne_m=corners)


@pytest.mark.parametrize(("height_m", "unseen_m", "zones", "shut"), [
    (wall(), SIZE_M, (), True),
    (wall(gap_m=2.0 * CLEAR_M + 4.0 * CELL_M), SIZE_M, (), False),
    (wall(gap_m=2.9 * CELL_M, at_m=30_125.0), SIZE_M, (), True),  # much less than twice
    (wall(), 30e3, (), False), (wall(), 39e3, (), False),  # a bound is not ground
    (wall(2.0 * SIZE_M), SIZE_M, (edge_to_edge(41e3),), True),
    (wall(2.0 * SIZE_M), SIZE_M, (edge_to_edge(36e3),), False),
])  # fmt: skip
def test_there_is_no_way_where_ground_and_zones_reach_from_edge_to_edge(
    height_m: FloatArray, unseen_m: float, zones: tuple[Zone, ...], shut: bool
) -> None:
    """And the place is where they do."""
    known = all_seen(height_m)
    place = closed(replace(known, seen=known.seen & (unseen_m > EAST)), replace(TASK, zones=zones))
    assert (place is not None) is shut
    assert place is None or abs(place[0] - 20e3) < (2e3 if zones else 300.0) + CLEAR_M + CELL_M


circles = st.lists(
    st.tuples(st.floats(8e3, 32e3), st.floats(0.0, SIZE_M), st.floats(1e3, 7e3)), max_size=9
)


@given(peaks=circles, zones=circles)
def test_where_it_says_that_there_is_none_a_finer_fill_finds_none(
    peaks: list[tuple[float, float, float]], zones: list[tuple[float, float, float]]
) -> None:
    """Independently: points 60 m apart, and their distances."""
    height = np.zeros((ROWS, ROWS))
    for north, east, spread in peaks:
        inside = np.hypot(NORTH - north, EAST - east) < spread
        height = np.maximum(height, np.where(inside, 6e3, 0.0))
    task = replace(TASK, zones=tuple(circle(n, e, 0.5 * r) for n, e, r in zones))
    if closed(all_seen(height), task) is not None:
        regions, _ = scipy.ndimage.label(_free(height > 5e3, task.zones), np.ones((3, 3)))
        here, target = (regions[int(n / STEP_M), int(e / STEP_M)] for n, e in (HERE, TARGET))
        assert here == 0 or here != target


STEP_M = 62.5


def _free(high: BoolArray, zones: tuple[Zone, ...]) -> BoolArray:
    """Points where a curve can be proven: so far from the edges of all cells that are too high."""
    step = STEP_M
    at = np.arange(0.5 * step, SIZE_M, step)
    each = round(CELL_M / step)
    cells = high.repeat(each, axis=0).repeat(each, axis=1)
    away = scipy.ndimage.distance_transform_edt(~cells, sampling=step) - 0.5 * step
    free = away >= CLEAR_M + step if cells.any() else np.ones_like(cells)
    for zone in zones:
        free &= zone.distance_m(*np.meshgrid(at, at, indexing="ij")) >= CLEAR_M + step
    return np.asarray(free)


@pytest.mark.parametrize(("gap_m", "is_known", "most_m"), [
    (2_350.0, True, 140e3),  # 1 km wide at the floor
    (2_500.0, False, math.inf),  # by what was seen from along the ridge sight lines leave no way
    (1_800.0, True, 0.0),  # 500 m are kept on either side
])  # fmt: skip
def test_a_narrow_gap_is_flown_through_and_one_that_is_too_narrow_told_at_once(
    gap_m: float, is_known: bool, most_m: float
) -> None:
    """Of a ridge 6 km high from edge to edge two peaks are so far apart."""
    east = [40e3 + side * (0.5 * gap_m + 400.0 * i) for side in (-1, 1) for i in range(120)]
    ridge = hills(*((50e3, at, 6e3, 800.0, 800.0) for at in east if -2e3 < at < 82e3))
    task = replace(TASK, limits=replace(TASK.limits, north_m=(-5e3, 105e3), east_m=(0.0, 80e3)))
    blank = empty_map(CELL_M, task.limits.north_m, task.limits.east_m)
    truth, start = true_map(ridge, blank), (0.0, 60e3, 3_100.0)
    known = truth if is_known else blank
    flight = planning.fly(task, truth, start, (100e3, 60e3), blank=known)
    refusal = flight.failure and flight.failure.refusal
    assert refusal is (None if most_m else Refusal.NO_WAY)
    assert sum(flight.flown_m) <= most_m


def test_the_saddle_of_a_ridge_is_climbed_to_and_crossed() -> None:
    """Too high for a climb at its foot; and its far side is guessed to be as high as the ridge."""
    crest = np.where(np.abs(EAST - 30e3) < 3e3, 4_000.0, 6e3)
    ridge = all_seen(crest * np.maximum(1.0 - np.abs(NORTH - 20e3) / 4e3, 0.0))
    flight = planning.fly(TASK, ridge, (*HERE, 3_100.0), TARGET)
    assert flight.failure is None
    assert sum(flight.flown_m) < 2.5 * 2.0 * math.dist(HERE, (20e3, 30e3))


# --- a mission that gets nowhere ends: a ridge whose gap the map shows, and no proof does
#
# The ridge is 6 km high, in cells of 250 m.  Through a gap of 2,332 m a path is proven just
# below the ceiling, through one of 2,282 m none; guidance, which knows no turns, uses both.

RANGE_M, RIDGE_NORTH_M, RIDGE_EAST_M = 20e3, (30e3, 100e3), (10e3, 50e3)
RIDGE = Task(
    limits=replace(
        planning.LARGE, north_m=RIDGE_NORTH_M, east_m=RIDGE_EAST_M, tracking_error_m=15.0,
        floor_amsl_m=2_978.0, ceiling_amsl_m=5_022.0, climb_angle_rad=math.radians(10.0),
    ),
    settings=PlannerSettings(scan_range_m=RANGE_M, safety_distance_m=480.0, planning_time_s=5.0),
)  # fmt: skip
MOUTH = (49_375.0, 30_000.0, 4_710.0)  # as high as it comes in front of the gap


def at_the_mouth(gap_m: float, *, owed_m: float) -> PlanRequest:
    """The question of a vehicle that hovers there, sees all and believes no guesses any more."""
    aside = np.arange(0.5 * gap_m, 20e3, 398.55)
    rows = [(50e3, 30e3 + east, 6_000.0, 800.0, 800.0) for east in (*aside, *-aside)]
    blank = empty_map(RIDGE.cell_m, RIDGE_NORTH_M, RIDGE_EAST_M)
    seen = np.ones(blank.shape, dtype=bool)
    known = replace(blank, upper_m=true_map(hills(*rows), blank).upper_m, seen=seen, given=seen)
    owes = Progress(record_m=0.0, owed_m=owed_m, seen=seen.size, believed_below_m=0.0)
    return ask(RIDGE, known, MOUTH, target_ne_m=(90e3, 30e3), progress=owes)


def test_who_owes_more_than_a_way_round_all_in_sight_is_told_that_no_way_on_was_found() -> None:
    """With less it looks elsewhere first, for far more than was promised."""
    looks = planned(at_the_mouth(2_282.0, owed_m=0.0))
    assert looks.progress.owed_m > RANGE_M
    told = refused(at_the_mouth(2_282.0, owed_m=math.tau * RANGE_M - looks.progress.owed_m + 1.0))
    assert told.refusal is Refusal.NO_WAY_PROVEN


def test_guesses_are_given_up_where_the_best_costs_far_more_than_they_promise() -> None:
    """Else it flies forth and back before a way that cannot be flown."""
    found = planned(replace(at_the_mouth(2_282.0, owed_m=0.0), progress=Progress()))
    assert found.progress.believed_below_m < math.inf


def test_a_gap_that_is_only_hidden_is_looked_into_where_its_bound_leaves_no_way() -> None:
    """By who believes no guesses any more: a way through is promised, none over the wall."""
    gap = (np.abs(NORTH - 20e3) < 300.0) & (np.abs(EAST - 30e3) < 2.0 * CLEAR_M)
    known = all_seen(wall())
    hidden, owes = replace(known, seen=known.seen & ~gap), Progress(believed_below_m=0.0)
    found = planned(ask(TASK, hidden, (*HERE, 3_600.0), target_ne_m=TARGET, progress=owes))
    assert found.progress.record_m < 2.0 * math.dist(HERE, TARGET)


def test_who_gets_on_flies_on_whatever_it_owes() -> None:
    owed_m = 2.0 * math.tau * RANGE_M
    through = planned(at_the_mouth(2_332.0, owed_m=owed_m))
    assert through.subpath.control_nea_m[-1, 0] > MOUTH[0]
    assert through.progress.owed_m <= owed_m


@pytest.mark.parametrize("owed_m", [0.0, 300.0])
def test_a_way_out_of_what_is_too_near_pays_nothing_back(owed_m: float) -> None:
    """Else a mission that begins each round with one would go round for ever."""
    owes = Progress(record_m=5_000.0, owed_m=owed_m, expected_m=6_000.0, believed_below_m=4_000.0)
    out = planned(ask(planning.TASK, planning.TRUTH, (2_300.0, 4_600.0, 600.0), progress=owes))
    assert out.is_escape
    assert out.progress == owes


# --- and any other

R_M, ALLOWED_M = 1_000.0, 300.0


@given(st.lists(st.tuples(st.floats(200.0, 900.0), st.floats(0.0, 400.0)), min_size=20))
def test_between_records_no_more_is_paid_than_way_is_gained_and_a_stop_costs(
    legs: list[tuple[float, float]],
) -> None:
    progress, left_m, paid_m, records, least_m = Progress(), 1e5, 0.0, 0, 1e9
    for cost_m, excess_m in legs:
        records, least_m = records + (left_m < least_m), min(left_m, least_m)
        progress = progress.at(left_m, 0.0, seen=1, few=0.0)
        if (owed_m := progress.owing(excess_m, R_M)) > ALLOWED_M:
            break  # it stops
        left_m, paid_m = left_m - cost_m + excess_m, paid_m + cost_m
        progress = replace(progress, owed_m=owed_m, expected_m=left_m)
    assert paid_m <= 1e5 - left_m + len(legs) * SLACK * R_M + records * ALLOWED_M + 1e-6


@pytest.mark.parametrize(("seed", "index", "most"), [(555001, 7, 30), (20261128, 24, 20)])
def test_no_loop_is_flown_again_and_again(seed: int, index: int, most: int) -> None:
    """Legs: 33 before excess was counted, then 18; 29 before guesses were given up, then 11."""
    world = families.world("gathered", seed, index)
    truth = true_map(world.terrain, families.unseen(world))
    flight = planning.fly(world.task, truth, world.start_nea_m, *world.targets_ne_m)
    assert flight.failure is None
    assert len(flight.legs) <= most
