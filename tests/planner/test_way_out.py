"""From rest there is a leg whenever there is a way: against a flood fill that shares no code.

    python tests/planner/test_way_out.py 10000 [FIRST]

looks at as many places, and tells from which no leg was found.
"""

import math
import sys
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from itertools import count
from pathlib import Path
from typing import final

import numpy as np
import pytest
import scipy
from planning import ask, planned

from companion.config import load_mission
from companion.geodesy import BoolArray, FloatArray
from companion.planner.field import cost_to_go
from companion.planner.plan import plan
from companion.planner.price import Prices
from companion.planner.request import Planned, PlanOutcome, PlanRequest, Rest
from companion.planner.searches import Searches
from companion.planner.settings import Task
from companion.planner.way_out import way_out
from companion.world.known_map import KnownMap
from companion.world.radars import Radar

CELL_M, HALF = 0.25, 80  # cells to each side of the vehicle
ALTITUDE_M, GROUND_M, TOP_M = 108.0, 100.5, 126.0
PLACES = 60


@cache
def mission_task(speed_m_s: float, evaluations: int) -> Task:
    task = load_mission("posts").task
    side = -(HALF + 0.5) * CELL_M, (HALF - 0.5) * CELL_M
    limits = replace(
        task.limits,
        speed_m_s=speed_m_s,
        turn_radius_m=min(speed_m_s**2 / 1.5, 8.0),
        north_m=side,
        east_m=side,
    )
    settings = replace(task.settings, cell_m=CELL_M, evaluations=evaluations)
    return replace(task, limits=limits, settings=settings)


def things(rng: np.random.Generator) -> BoolArray:
    """What stands about the vehicle: a wood, rooms, or a dead end.  (160, 160)."""
    size = 2 * HALF
    north, east = np.meshgrid(*(np.arange(size) + 0.5,) * 2, indexing="ij")
    full = np.zeros((size, size), dtype=bool)
    kind = rng.integers(0, 3)
    if kind == 0:
        for _ in range(rng.integers(20, 260)):
            n, e, radius = *rng.uniform(0, size, 2), rng.uniform(1.0, 5.0)
            full |= np.hypot(north - n, east - e) < radius
        return full
    if kind == 1:
        for _ in range(rng.integers(4, 14)):
            at, gap, wide = rng.integers(0, size), rng.integers(0, size), rng.integers(6, 20)
            wall = full if rng.random() < 0.5 else full.T
            wall[at : at + 2, :gap] = wall[at : at + 2, gap + wide :] = True
        return full
    depth, wide = rng.integers(12, 60), rng.integers(6, 24)
    begin, end, low, high = HALF - 6, HALF + depth + 2, HALF - wide - 2, HALF + wide + 2
    full[begin:end, low:high] = True
    full[begin : end - 2, low + 2 : high - 2] = False
    return np.rot90(full, int(rng.integers(0, 4))).copy()


def seen_from(full: BoolArray, row: float, column: float) -> BoolArray:
    """Cells that rays from a place pass before they meet something, within R."""
    seen = np.zeros_like(full)
    bearings = np.linspace(0.0, 2.0 * math.pi, 720, endpoint=False)
    blind = np.zeros(len(bearings), dtype=bool)
    for away in np.arange(0.0, 16.0 / CELL_M, 0.4):
        i = np.clip((row + away * np.cos(bearings)).astype(int), 0, len(full) - 1)
        j = np.clip((column + away * np.sin(bearings)).astype(int), 0, len(full) - 1)
        blind |= full[i, j]
        seen[i[~blind], j[~blind]] = True
    return seen


def wholly_clear(taken: BoolArray, clearance_m: float) -> BoolArray:
    """Cells all of whose points keep the clearance from all cells that are taken."""
    reach = math.ceil(clearance_m / CELL_M) + 1
    gap_m = CELL_M * np.maximum(np.abs(np.arange(-reach, reach + 1)) - 1, 0)
    near = np.hypot(gap_m[:, None], gap_m) < clearance_m
    return ~scipy.ndimage.maximum_filter(taken, footprint=near, mode="constant", cval=True)


def steps_from(free: BoolArray, begin: tuple[int, int]) -> FloatArray:
    """Steps north, south, east or west to each free cell; infinite where none lead."""
    walled = np.pad(free, 1)  # with what is not free: each cell has four beside it
    steps, width = np.full(walled.size, math.inf), walled.shape[1]
    front = np.array([(begin[0] + 1) * width + begin[1] + 1])
    for step in count():
        steps[front] = step
        beside = np.unique(front[:, None] + [-width, -1, 1, width])
        front = beside[walled.flat[beside] & np.isinf(steps[beside])]
        if not len(front):
            break
    return steps.reshape(walled.shape)[1:-1, 1:-1]


def map_of(upper_m: FloatArray, seen: BoolArray, cell_m: float = CELL_M) -> KnownMap:
    """With the vehicle in its middle."""
    corner = -0.5 * (len(upper_m) + 1) * cell_m
    return KnownMap(
        cell_m=cell_m, north_min_m=corner, east_min_m=corner, upper_m=upper_m, seen=seen
    )


def has_way(known: KnownMap, clearance_m: float, target: tuple[int, int]) -> bool:
    """Whether free cells lead to where less is left to fly, or to the edge of what is seen."""
    taken = known.upper_m > GROUND_M
    free = wholly_clear(taken, clearance_m)
    begin = HALF, HALF
    if not free[begin]:
        return False
    steps = steps_from(free, begin)
    hoped = wholly_clear(taken & known.seen, clearance_m)  # what is not seen is free
    left = steps_from(hoped, target)
    reached = np.isfinite(steps) & (steps >= 8)
    nothing = known.upper_m == GROUND_M
    seam = ~known.seen & ~wholly_clear(nothing, 0.1)  # what is behind a wall stays hidden
    edge = ~wholly_clear(seam, clearance_m + 2.0 * CELL_M)
    return bool((reached & (edge | (left < left[begin] - 8))).any())


def place(seed: int) -> tuple[PlanRequest, bool] | None:
    """A vehicle at rest among things, and whether there is a way; None: it cannot be there."""
    rng = np.random.default_rng(seed)
    full = things(rng)
    task = mission_task(float(rng.choice([1.0, 3.0, 5.0])), int(rng.choice([60, 600])))
    if not wholly_clear(full, task.required_clearance_m)[HALF, HALF]:
        return None
    seen = seen_from(full, HALF + 0.5, HALF + 0.5)
    for _ in range(rng.integers(0, 3)):
        row, column = rng.integers(10, 2 * HALF - 10, 2)
        if not full[row, column]:
            seen |= seen_from(full, row + 0.5, column + 0.5)
    met = full & ~wholly_clear(seen, 0.1)  # next to what is free
    known = map_of(np.where(met, TOP_M, np.where(seen, GROUND_M, math.inf)), seen | met)
    bearing, away = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(4.0, 18.0)
    target = away * math.cos(bearing), away * math.sin(bearing)
    cell = known.cell_of(*target)
    if not wholly_clear(met, 2.0 * task.required_clearance_m)[cell]:
        return None
    here = (*rng.uniform(-0.1, 0.1, 2).tolist(), ALTITUDE_M)
    request = ask(task, known, here, seed=seed, target_ne_m=target)
    return request, has_way(known, task.required_clearance_m, cell)


def looked_at(seeds: Iterable[int]) -> tuple[int, list[tuple[int, PlanOutcome]]]:
    """How many of these places have a way, and from which of them no leg was found."""
    ways, lost = 0, list[tuple[int, PlanOutcome]]()
    for seed in seeds:
        found = place(seed)
        if found is not None and found[1]:
            ways, outcome = ways + 1, plan(found[0])
            if not isinstance(outcome, Planned) or not outcome.certificate.proven:
                lost.append((seed, outcome))
    return ways, lost


@pytest.mark.sample(8)
@pytest.mark.parametrize("part", range(8))
def test_from_rest_there_is_a_leg_whenever_there_is_a_way(part: int) -> None:
    ways, lost = looked_at(range(part * PLACES, (part + 1) * PLACES))
    assert lost == []
    assert ways > PLACES // 4


def test_a_straight_way_out_ends_before_a_radar_sees_it_where_it_can() -> None:
    """The target lies within its range: the farthest piece towards it would be seen."""
    radar = Radar(name="r", centre_nea_m=(12.0, 0.0, ALTITUDE_M), range_m=6.0)
    task, target = replace(mission_task(5.0, 60), radars=(radar,)), (12.0, 0.0)
    open_m = np.full((2 * HALF, 2 * HALF), GROUND_M)
    known = map_of(open_m, open_m > 0.0)
    request = ask(task, known, (0.0, 0.0, ALTITUDE_M), target_ne_m=target)
    searches = Searches(request, lambda: False)
    searches.prices = Prices(task, cost_to_go(known, task, (0.0, 0.0), target))
    found = way_out(request, searches, looks=False, strays=False)
    assert found is not None
    ends_at = found[0].subpath.control_nea_m[-1]
    assert 6.0 < math.dist(ends_at, radar.centre_nea_m) < 8.0
    # the way there takes another such piece, and a stop before it
    assert found[1] >= searches.prices.price_m(found[0]) + task.stop_m


@final
class Steep(Prices):
    """Where each metre nearer to the target leaves twenty less to fly."""

    def to_go_m(self, places_nea_m: FloatArray) -> FloatArray:
        return 20.0 * np.hypot(places_nea_m[..., 0] - 12.0, places_nea_m[..., 1])


def test_who_is_shut_in_about_one_place_is_told_that_there_is_no_way_out() -> None:
    """Where the only free point is the one beside it: no piece is long enough to be flown."""
    task, here, target = mission_task(1.0, 60), (-0.2, 0.0, ALTITUDE_M), (12.0, 0.0)
    upper_m = np.full((2 * HALF, 2 * HALF), TOP_M)
    upper_m[HALF - 4 : HALF + 5, HALF - 4 : HALF + 5] = GROUND_M
    known = map_of(upper_m, upper_m > 0.0)
    request = ask(task, known, here, target_ne_m=target)
    searches = Searches(request, lambda: False)
    searches.prices = Steep(task, cost_to_go(known, task, here[:2], target))
    assert way_out(request, searches, looks=False, strays=False) is None


def test_in_flight_a_leg_is_planned_as_slowly_as_it_is_entered() -> None:
    """Before a wall, with room to turn aside only at that speed; what is entered at V has none."""
    task, here = mission_task(5.0, 1_500), (0.0, 0.0, ALTITUDE_M)
    upper_m = np.full((2 * HALF, 2 * HALF), GROUND_M)
    upper_m[HALF + 40 :] = TOP_M  # from 10 m ahead on
    known = map_of(upper_m, upper_m > 0.0)
    rest = Rest(length_m=3.5, end_nea_m=(3.5, 0.0, ALTITUDE_M), speed_m_s=3.0)
    request = ask(task, known, here, from_rest=False, target_ne_m=(4.0, 16.0), rest=rest)
    found = planned(request)
    assert found.certificate.proven
    assert found.speed_m_s == found.certificate.speed_m_s == 3.0
    at_v = plan(replace(request, rest=replace(rest, speed_m_s=None)))
    assert not isinstance(at_v, Planned)


REAL = ("od-5-55", "od-1-19", "ds-1-4", "ds-2-19")
"""Flight and plan of real ArduCopter among posts: each stood in free ground and gave up there."""


def real(name: str) -> PlanRequest:
    """The last plan of a flight that gave up, on the map that its lidar had made."""
    with np.load(Path(__file__).with_name("data") / "among_posts.npz") as kept:
        cells, corner, start, target, vehicle = (
            kept[f"{name}/{key}"]
            for key in ("cells", "corner_m", "start_nea_m", "target_ne_m", "vehicle")
        )
    speed, radius, tracking, navigation, range_m = vehicle.tolist()
    task, here = load_mission("posts").task, (float(start[0]), float(start[1]), float(start[2]))
    limits = replace(task.limits, speed_m_s=speed, turn_radius_m=radius)
    limits = replace(limits, tracking_error_m=tracking, navigation_error_m=navigation)
    cell_m = range_m / 64.0
    settings = replace(task.settings, scan_range_m=range_m, cell_m=cell_m)
    known = map_of(np.array([math.inf, GROUND_M, TOP_M])[cells], cells > 0, cell_m)
    known = replace(known, north_min_m=float(corner[0]), east_min_m=float(corner[1]))
    task = replace(task, limits=limits, settings=settings)
    return ask(task, known, here, seed=1, target_ne_m=(float(target[0]), float(target[1])))


@pytest.mark.parametrize("questions", [0, 3, 1_000])
@pytest.mark.parametrize("name", REAL)
def test_where_real_flights_gave_up_there_is_a_leg(name: str, questions: int) -> None:
    """However little time there is: it is up after so many questions whether it is."""
    asked = count(1)
    outcome = plan(real(name), lambda: next(asked) > questions)
    assert isinstance(outcome, Planned)
    assert outcome.certificate.proven
    assert outcome.subpath.length_m > 1.0


if __name__ == "__main__":
    many, first = (*map(int, sys.argv[1:]), 0)[:2]
    sys.stdout.write(f"ways, and no legs from: {looked_at(range(first, first + many))}\n")
