import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning import LARGE

from companion.planner import cost_grid
from companion.planner.cost_grid import Belief
from companion.planner.field import CostToGo, Memory, cost_to_go
from companion.planner.settings import PlannerSettings, Task
from companion.world.clearance import Surface
from companion.world.known_map import KnownMap, empty_map
from companion.world.radars import Radar
from companion.world.zones import CircleZone, PolygonZone, Zone

Place = tuple[float, float]

R = 20_000.0
CELL = R / 20.0
FLOOR, CEILING = 3_000.0, 5_000.0
CLIMB = math.radians(10.0)
HEIGHT = 2.4 * 0.15 / 0.1  # cost per metre at the ceiling: f2 over f1 with the paper's weights
RADAR = 7.2 * 0.3 / 0.1  # and per unit of detection probability: f5 over f1


def a_task(
    *, radars: tuple[Radar, ...] = (), zones: tuple[Zone, ...] = (), size_m: float = 60e3
) -> Task:
    return Task(
        limits=replace(
            LARGE,
            climb_angle_rad=CLIMB,
            dive_angle_rad=CLIMB,
            north_m=(0.0, size_m),
            east_m=(0.0, size_m),
        ),
        settings=PlannerSettings(
            scan_range_m=R, safety_distance_m=500.0, planning_time_s=5.0, evaluations=100
        ),
        radars=radars,
        zones=zones,
    )


def near(task: Task) -> Task:
    """The task among near things."""
    return replace(task, settings=replace(task.settings, cell_m=task.cell_m))


def a_map(task: Task) -> KnownMap:
    return empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)


def seen(task: Task, height_m: np.ndarray | float, where: np.ndarray | bool = True) -> KnownMap:
    blank = a_map(task)
    everywhere = np.broadcast_to(np.asarray(where), blank.seen.shape)
    return replace(blank, upper_m=np.where(everywhere, height_m, np.inf), seen=everywhere.copy())


def middles(task: Task) -> tuple[np.ndarray, np.ndarray]:
    blank = a_map(task)
    return blank.middles_m(0, 0, (blank.upper_m.shape[0], blank.upper_m.shape[1]))


def radar(north: float, east: float, range_m: float) -> Radar:
    return Radar(name="radar", centre_nea_m=(north, east, 0.0), range_m=range_m)


def value(field: CostToGo, place: Place) -> float:
    return float(field.at_m(np.array(place[0]), np.array(place[1])))


def length(route: tuple[Place, ...]) -> float:
    return sum(math.dist(a, b) for a, b in pairwise(route))


def along(route: tuple[Place, ...], step_m: float = 100.0) -> np.ndarray:
    pieces = [
        np.linspace(a, b, max(math.ceil(math.dist(a, b) / step_m), 1), endpoint=False)
        for a, b in pairwise(route)
    ]
    return np.concatenate([*pieces, np.array(route[-1:])])


def detour_m(
    here: Place, there: Place, centre: Place, radius_m: float, far_side: bool = False
) -> float:
    """Tangent, arc, tangent about a circle that the straight line crosses."""
    a = np.subtract(here, centre)
    b = np.subtract(there, centre)
    da, db = np.hypot(*a), np.hypot(*b)
    between = math.acos(np.dot(a, b) / (da * db))
    between = 2.0 * math.pi - between if far_side else between
    arc = between - math.acos(radius_m / da) - math.acos(radius_m / db)
    return math.sqrt(da**2 - radius_m**2) + math.sqrt(db**2 - radius_m**2) + radius_m * arc


places = st.tuples(st.floats(1e3, 59e3), st.floats(1e3, 59e3))


@given(here=places, target=places)
def test_over_a_free_plane_the_cost_is_the_distance(here: Place, target: Place) -> None:
    task = a_task()
    field = cost_to_go(a_map(task), task, here, target)
    apart = math.dist(here, target)
    assert value(field, here) == pytest.approx(apart, rel=0.01, abs=0.75 * CELL)
    assert field.route_ne_m == (here, target)


def test_the_error_of_the_metric_is_under_one_per_cent_in_every_direction() -> None:
    task, target = a_task(), (30_000.0, 30_000.0)
    field = cost_to_go(a_map(task), task, target, target)
    bearing = np.linspace(0.0, 2.0 * math.pi, 721)
    for far in (5e3, 12e3, 29e3):
        got = field.at_m(target[0] + far * np.cos(bearing), target[1] + far * np.sin(bearing))
        assert got.min() >= 0.9999 * far
        assert got.max() <= 1.009 * far


@pytest.mark.parametrize("height_m", [2_800.0, 3_500.0, 4_200.0])
def test_a_plateau_costs_its_height(height_m: float) -> None:
    task = a_task()
    field = cost_to_go(seen(task, height_m), task, (5e3, 7e3), (50e3, 40e3))
    need = height_m + task.search_clearance_m
    expected = math.dist((5e3, 7e3), (50e3, 40e3)) * (1 + HEIGHT * (need - FLOOR) / 2e3)
    assert value(field, (5e3, 7e3)) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("bound_m", [3_500.0, np.inf])
def test_unseen_ground_that_has_to_be_flown_over_costs_the_altitude_of_its_bound(
    bound_m: float,
) -> None:
    task, here, there = a_task(), (5e3, 7e3), (50e3, 40e3)
    hidden = seen(task, np.inf, where=False)
    hidden = replace(
        hidden,
        upper_m=np.full_like(hidden.upper_m, bound_m),
        guess_m=np.full_like(hidden.upper_m, 2_800.0),
    )
    field = cost_to_go(hidden, task, here, there)
    flown_m = min(bound_m + task.search_clearance_m, CEILING)
    expected = math.dist(here, there) * (1 + HEIGHT * (flown_m - FLOOR) / 2e3)
    assert value(field, here) == pytest.approx(expected, rel=0.01)


def test_before_a_plateau_the_altitude_needed_falls_with_the_steepest_climb() -> None:
    task = a_task()
    north, _ = middles(task)
    rise_m, foot_m = 1_000.0, 30e3
    lowest_m = FLOOR + rise_m
    known = seen(task, np.where(north > foot_m, lowest_m - task.search_clearance_m, 0.0))
    field = cost_to_go(known, task, (5e3, 30e3), (55e3, 30e3))
    coarse_m = 0.75 * CELL * math.tan(CLIMB)  # the lattice's, of where the cliff stands
    for away_m in np.arange(-10e3, 12e3, 500.0):
        needed_m = float(field.needed.altitude_m(np.array(foot_m - away_m), np.array(30e3)))
        before_m = max(away_m - task.search_clearance_m, 0.0)
        on_the_ramp_m = max(lowest_m - before_m * math.tan(CLIMB), FLOOR)
        assert needed_m == pytest.approx(on_the_ramp_m, abs=coarse_m)


@pytest.mark.parametrize("off_m", [300.0, 3_000.0, 6_000.0])
@pytest.mark.parametrize("range_m", [7_000.0, 11_000.0])
def test_round_a_radar_the_way_is_tangent_arc_tangent(off_m: float, range_m: float) -> None:
    centre = (30e3 + off_m, 30e3 - off_m)
    task = a_task(radars=(radar(*centre, range_m),))
    here, target = (6e3, 7e3), (55e3, 52e3)
    field = cost_to_go(a_map(task), task, here, target)
    outside = math.sqrt(range_m**2 - FLOOR**2)  # the radar stands at 0 m
    expected = detour_m(here, target, centre, outside)
    assert expected > 1.002 * math.dist(here, target) or off_m > 5e3
    assert value(field, here) == pytest.approx(expected, rel=0.02)
    assert length(field.route_ne_m) == pytest.approx(expected, rel=0.02)
    points = along(field.route_ne_m)
    assert np.hypot(*(points - centre).T).min() >= outside


@pytest.mark.parametrize("bearing_deg", [0.0, 11.0, 27.0, 45.0])
@pytest.mark.parametrize("shift", [0.0, 0.3, 0.6, 0.85])
def test_a_gap_of_one_and_a_half_cells_stays_open(bearing_deg: float, shift: float) -> None:
    task = a_task()
    north, east = middles(task)
    turn = math.radians(bearing_deg)
    n, e = north - 30e3 - shift * CELL, east - 30e3 - 0.7 * shift * CELL
    across, aside = n * math.cos(turn) + e * math.sin(turn), e * math.cos(turn) - n * math.sin(turn)
    free = 0.75 * CELL + task.search_clearance_m + 0.5 * task.cell_m
    wall = np.where((np.abs(across) < 2e3) & (np.abs(aside) > free), 9e3, 0.0)
    ahead = np.array([math.cos(turn), math.sin(turn)])
    gap = np.array([30e3, 30e3]) + shift * CELL * np.array([1.0, 0.7])
    here, target = tuple(gap - 20e3 * ahead), tuple(gap + 20e3 * ahead)
    field = cost_to_go(seen(task, wall), task, here, target)
    assert length(field.route_ne_m) == pytest.approx(40e3, rel=0.02)
    assert value(field, here) == pytest.approx(40e3, rel=0.03)


def test_along_the_edge_of_the_map_there_is_no_way() -> None:
    """What lies beyond counts as terrain: the vehicle was led there again and again."""
    task = a_task()
    n, e = middles(task)
    wall = np.where((np.abs(n - 30e3) < 2e3) & (e > 4e3), 9e3, 0.0)  # nearer to the edge: free
    here, target = (10e3, 3e3), (50e3, 3e3)
    free_m = cost_to_go(seen(task, wall), task, here, target).at_m(*map(np.asarray, here))
    barred = np.where(
        np.abs(n - 30e3) < 2e3, np.where(e > 1.5 * task.search_clearance_m, 9e3, 0.0), 0.0
    )
    along_m = cost_to_go(seen(task, barred), task, here, target).at_m(*map(np.asarray, here))
    assert free_m < 50e3
    assert along_m > 10 * free_m


def a_scene(seed: int) -> tuple[Task, KnownMap]:
    """Radars, keep-outs and hills, some above the ceiling, some in ground that was not seen."""
    rng = np.random.default_rng(seed)
    radars = tuple(
        radar(*rng.uniform(12e3, 48e3, 2), float(rng.uniform(5e3, 9e3))) for _ in range(3)
    )
    north, east = (float(x) for x in rng.uniform(15e3, 45e3, 2))
    zones: tuple[Zone, ...] = (
        CircleZone(name="circle", north_m=north, east_m=east, radius_m=2_500.0),
    )
    task = a_task(radars=radars, zones=zones)
    n, e = middles(task)
    hills = rng.uniform((8e3, 8e3, 2e3, 2e3), (52e3, 52e3, 6e3, 6e3), (6, 4))
    terrain = np.max(
        [h * np.exp(-((n - a) ** 2 + (e - b) ** 2) / s**2) for a, b, s, h in hills], axis=0
    )
    known = seen(task, terrain, where=np.hypot(n - 20e3, e - 20e3) < 30e3)
    return task, replace(known, guess_m=np.full_like(terrain, -np.inf))  # free beyond


@pytest.mark.parametrize("seed", range(6))
def test_along_the_route_the_cost_falls_all_the_way(seed: int) -> None:
    task, known = a_scene(seed)
    target = 58e3, 57e3
    points = along(cost_to_go(known, task, (2e3, 2e3), target).route_ne_m, 1_000.0)
    values = np.array([value(cost_to_go(known, task, (n, e), target), (n, e)) for n, e in points])
    assert values[0] > 70e3
    assert np.diff(values).max() <= 0.4 * CELL  # interpolation beside threats is not exact
    later = np.minimum.accumulate(values)
    assert (values - later).max() <= CELL


@pytest.mark.parametrize("seed", range(12))
def test_what_is_remembered_changes_no_answer(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scans, other targets, zones and places; ground told or guessed; coarse; near things."""
    rng = np.random.default_rng(seed)
    if seed % 2:  # the map is too large for cells of R / 20
        monkeypatch.setattr(cost_grid, "_MOST_CELLS", 20)
    task, known = a_scene(seed)
    n, e = middles(task)
    if seed % 4 < 2:
        known = replace(known, guess_m=None)
    if seed >= 8:
        task = near(task)
    memory, target = Memory(), (58e3, 57e3)
    for step in range(12):
        here = (float(rng.uniform(5e3, 30e3)), float(rng.uniform(5e3, 30e3)))
        kind = rng.integers(0, 5)
        at = rng.uniform(0.0, 60e3, 2)
        scanned = np.hypot(n - at[0], e - at[1]) < rng.uniform(0.0, 8e3)
        if kind < 3:
            known.upper_m[scanned] = rng.uniform(0.0, 5e3)  # even a map that is changed in place
            known.seen[scanned] = True
        elif kind == 3:
            target = (float(at[0]), float(at[1]))
        else:
            zone = CircleZone(name="new", north_m=at[0], east_m=at[1], radius_m=2e3)
            task = replace(task, zones=(*task.zones, zone))
        belief = (*Belief, Belief.GUESSED)[step % 4]
        anew = cost_to_go(known, task, here, target, Memory(), belief=belief)
        repaired = cost_to_go(known, task, here, target, memory, belief=belief)
        assert repaired.value.vertex_m.tobytes() == anew.value.vertex_m.tobytes()
        assert repaired.needed.vertex_m.tobytes() == anew.needed.vertex_m.tobytes()
        assert repaired.route_ne_m == anew.route_ne_m
        assert repaired.is_barred == anew.is_barred


def test_ground_that_has_not_been_seen_is_free() -> None:
    task = a_task()
    known = seen(task, 9e3)
    unseen = replace(known, seen=np.zeros_like(known.seen))
    free = cost_to_go(a_map(task), task, (5e3, 5e3), (50e3, 40e3))
    assert cost_to_go(unseen, task, (5e3, 5e3), (50e3, 40e3)).value.vertex_m == pytest.approx(
        free.value.vertex_m
    )
    assert value(cost_to_go(known, task, (5e3, 5e3), (50e3, 40e3)), (5e3, 5e3)) > 1e6


def test_what_stands_near_is_taken_to_go_on() -> None:
    """Between walls that are seen for 5 km more, and free ground for 20, to a target aside."""
    task, here, target = a_task(), (15e3, 30e3), (50e3, 58e3)
    north, east = middles(task)
    aside, lane = np.abs(east - 30e3), north < 35e3
    walls = (aside > 3e3) & (aside < 4e3) & (north < 20e3)
    known = seen(task, np.where(walls, 9e3, 0.0), walls | ((aside < 3e3) & lane))
    known = replace(known, guess_m=np.zeros_like(known.upper_m))
    turns_at_m = []
    for each in (task, near(task)):
        points = along(cost_to_go(known, each, here, target).route_ne_m)
        turns_at_m.append(float(points[np.abs(points[:, 1] - 30e3) > 3e3][0, 0]))
    assert turns_at_m[0] < 20e3 + 0.1 * R
    assert turns_at_m[1] > 20e3 + 0.25 * R


def test_hidden_ground_is_as_high_as_its_sight_line_allows_or_free_as_is_asked() -> None:
    """By bounds what is promised can be proven: a slope is climbed where it is hidden, too."""
    task, here, there = a_task(), (5e3, 30e3), (55e3, 30e3)
    north, _ = middles(task)
    known = seen(task, np.where(np.abs(north - 30e3) < 5e3, 3_900.0, 0.0))
    hidden = replace(known, seen=known.seen & (np.abs(north - 30e3) > 5e3))
    told, guessed = cost_to_go(known, task, here, there), cost_to_go(hidden, task, here, there)
    bounded, free = (
        cost_to_go(hidden, task, here, there, belief=belief)
        for belief in (Belief.BOUNDED, Belief.FREE)
    )
    assert bounded.value.vertex_m == pytest.approx(told.value.vertex_m)
    assert bounded.needed.vertex_m == pytest.approx(told.needed.vertex_m)
    foot = np.array(24.5e3), np.array(30e3)
    assert guessed.needed.altitude_m(*foot) < told.needed.altitude_m(*foot) - 500.0
    nothing = cost_to_go(a_map(task), task, here, there)
    assert free.value.vertex_m == pytest.approx(nothing.value.vertex_m)


@given(
    bearing=st.floats(-math.pi, math.pi),
    depth=st.floats(1_500.0, 7_000.0),
    zone=st.sampled_from(["radar", "circle", "hill"]),
)
def test_from_inside_a_threat_the_route_takes_the_short_way_out(
    bearing: float, depth: float, zone: str
) -> None:
    centre, out = np.array([30e3, 30e3]), 9e3
    task = a_task()
    known = a_map(task)
    if zone == "radar":
        task = a_task(radars=(radar(30e3, 30e3, math.hypot(out, FLOOR)),))
    elif zone == "circle":
        keep_out = CircleZone(name="zone", north_m=30e3, east_m=30e3, radius_m=out - 530.0)
        task = a_task(zones=(keep_out,))
    else:
        north, east = middles(task)
        known = seen(task, np.where(np.hypot(north - 30e3, east - 30e3) < out - 530.0, 9e3, 0.0))
    here = centre + (out - depth) * np.array([math.cos(bearing), math.sin(bearing)])
    field = cost_to_go(known, task, (float(here[0]), float(here[1])), (57e3, 30e3))
    points = along(field.route_ne_m)
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    inside = np.hypot(*(points - centre).T) < out
    assert way[np.argmin(inside)] < 1.15 * depth + 1.0 * CELL


def test_a_target_inside_a_threat_is_reached_by_the_short_way_in() -> None:
    corners = ((25e3, 20e3), (35e3, 20e3), (35e3, 40e3), (25e3, 40e3))
    task = a_task(zones=(PolygonZone(name="box", vertices_ne_m=corners),))
    field = cost_to_go(a_map(task), task, (30e3, 5e3), (33e3, 30e3))
    points = along(field.route_ne_m)
    inside = task.zones[0].distance_m(points[:, 0], points[:, 1]) < 0.0
    assert 100.0 * inside.sum() < 1.2 * 2e3 + CELL
    assert np.isfinite(field.value.vertex_m).all()


anywhere = st.tuples(st.floats(-80e3, 140e3), st.floats(-80e3, 140e3))


@given(
    here=anywhere,
    target=anywhere,
    seed=st.integers(0, 3),
    same=st.booleans(),
)
def test_everything_is_finite_wherever_it_is_asked_from(
    here: Place, target: Place, seed: int, same: bool
) -> None:
    task, known = a_scene(seed)
    target = here if same else target
    field = cost_to_go(known, task, here, target)
    assert np.isfinite(field.value.vertex_m).all()
    assert (field.value.vertex_m >= 0.0).all()
    assert (field.route_ne_m[0], field.route_ne_m[-1]) == (here, target)
    assert np.isfinite(field.route_ne_m).all()
    assert math.isfinite(field.leaving_rad(here, 19e3))
    assert math.isfinite(value(field, here))


@pytest.mark.parametrize(
    ("range_m", "size_m"),
    [(range_m, size * range_m) for range_m in (30.0, 1e3, 2e4) for size in (0.02, 0.1, 1.02, 9.7)],
)
def test_a_map_of_any_size_has_a_field(range_m: float, size_m: float) -> None:
    task = a_task(radars=(radar(0.4 * size_m, 0.6 * size_m, 0.2 * size_m),), size_m=size_m)
    task = replace(
        task,
        settings=replace(task.settings, scan_range_m=range_m, safety_distance_m=0.02 * range_m),
    )
    here, target = (0.3 * size_m, 0.1 * size_m), (0.9 * size_m, 0.8 * size_m)
    field = cost_to_go(seen(task, 500.0), task, here, target)
    assert np.isfinite(field.value.vertex_m).all()
    assert max(field.value.vertex_m.shape) <= 161
    apart = math.dist(here, target)
    has_room = 0.1 * size_m > task.search_clearance_m + field.value.cell_m  # else all of it is edge
    if has_room:
        assert value(field, here) == pytest.approx(apart, rel=0.05, abs=2.0 * field.value.cell_m)
    else:
        assert value(field, here) > apart
    assert has_room or size_m < 2.0 * range_m


def test_on_a_large_map_the_route_goes_round_what_is_beyond_the_window() -> None:
    task = a_task(radars=(radar(300e3, 300e3, 90e3),), size_m=600e3)
    here, target = (20e3, 20e3), (580e3, 575e3)
    field = cost_to_go(a_map(task), task, here, target)
    assert max(field.value.vertex_m.shape) <= 161
    expected = detour_m(here, target, (300e3, 300e3), 90e3)
    assert value(field, here) == pytest.approx(expected, rel=0.02)
    assert length(field.route_ne_m) == pytest.approx(expected, rel=0.02)
    a = np.subtract((300e3, 300e3), here)
    tangent = math.asin(90e3 / np.hypot(*a))
    guide = field.leaving_rad(here, 19e3) - math.atan2(a[1], a[0])
    assert abs(guide) == pytest.approx(tangent, abs=0.06)


def test_the_route_leaves_a_circle_where_it_crosses_it_outwards_first() -> None:
    route = ((0.0, 0.0), (0.0, 8.0), (8.0, 8.0), (8.0, 30.0))
    flat = Surface(north_min_m=0.0, east_min_m=0.0, cell_m=1.0, vertex_m=np.zeros((2, 2)))
    field = CostToGo(value=flat, needed=flat, route_ne_m=route, is_barred=False)
    assert field.leaving_rad((0.0, 0.0), 5.0) == pytest.approx(math.pi / 2)
    assert field.leaving_rad((0.0, 0.0), 10.0) == pytest.approx(math.atan2(8.0, 6.0))
    assert field.leaving_rad((0.0, 0.0), 17.0) == pytest.approx(math.atan2(15.0, 8.0))
    assert field.leaving_rad((0.0, 0.0), 50.0) == pytest.approx(math.atan2(30.0, 8.0))
    assert field.leaving_rad((1.0, 0.0), 0.5) == pytest.approx(math.atan2(30.0, 7.0))
