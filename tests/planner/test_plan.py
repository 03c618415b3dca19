"""One plan, and an independent look at what it promises.

`assert_safe` shares no code with the product: a Bernstein sum, circles through three points, the
true terrain of eq. 1 on a lattice of points.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.objective.scene import PAPER
from companion.path.subpath import Pose, Subpath
from companion.planner.plan import NotPlanned, Planned, PlanRequest, Refusal, plan
from companion.planner.procedure import hover_pose
from companion.planner.settings import Task
from companion.world.known_map import KnownMap, empty_map
from companion.world.terrain import PeakTerrain

FloatArray = NDArray[np.float64]

START = (1_000.0, 1_000.0, 450.0)
FAR_TARGET = (7_500.0, 7_500.0)


def ask(task: Task, known: KnownMap, **changes: object) -> PlanRequest:
    request = PlanRequest(
        plan_id=1,
        seed=7,
        task=task,
        known=known,
        scan_nea_m=START,
        start=hover_pose(START),
        from_rest=True,
        target_ne_m=FAR_TARGET,
    )
    return replace(request, **changes)  # type: ignore[arg-type]


def planned(request: PlanRequest) -> Planned:
    outcome = plan(request)
    assert isinstance(outcome, Planned)
    return outcome


def curve(subpath: Subpath, count: int = 4_000) -> FloatArray:
    u = np.linspace(0.0, 1.0, count + 1)[:, None]
    shares = np.hstack([(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u * u * (1 - u), u**3])
    return shares @ subpath.control_nea_m


def distance_to_terrain_m(terrain: PeakTerrain, points: FloatArray, reach_m: float) -> FloatArray:
    """To the true terrain at points 8 m apart: never less than the true distance."""
    around = np.arange(-reach_m, reach_m + 1.0, 8.0)
    n = points[:, 0, None, None] + around[:, None]
    e = points[:, 1, None, None] + around[None, :]
    height = np.full(np.broadcast(n, e).shape, terrain.ground_amsl_m)
    for p in terrain.peaks:
        x, y = (n - p.north_m) / p.spread_north_m, (e - p.east_m) / p.spread_east_m
        height = np.maximum(height, p.height_amsl_m * np.exp(-x * x - y * y))
    down = np.maximum(points[:, 2, None, None] - height, 0.0)
    aside = around[:, None] ** 2 + around[None, :] ** 2
    return np.asarray(np.sqrt((aside + down**2).min(axis=(1, 2))))


def turn_radii_m(points: FloatArray) -> FloatArray:
    """Of the circles through three successive points of the ground track."""
    a, b, c = (points[k : len(points) - 2 + k, :2] for k in range(3))
    sides = [np.hypot(*(q - p).T) for p, q in ((a, b), (b, c), (a, c))]
    (p, q) = (b - a).T, (c - a).T
    area2 = np.abs(p[0] * q[1] - p[1] * q[0])
    return np.asarray(sides[0] * sides[1] * sides[2] / np.maximum(2.0 * area2, 1e-12))


def assert_safe(subpath: Subpath, task: Task, terrain: PeakTerrain) -> None:
    limits, d_s = task.limits, task.settings.safety_distance_m
    points = curve(subpath)
    wanted = d_s + limits.tracking_error_m
    assert distance_to_terrain_m(terrain, points[::8], wanted + 8.0).min() >= wanted
    assert turn_radii_m(points[::4]).min() >= limits.turn_radius_m * 0.99
    steps = np.diff(points, axis=0)
    angles = np.arctan2(steps[:, 2], np.hypot(steps[:, 0], steps[:, 1]))
    assert angles.max() <= limits.climb_angle_rad + 1e-3
    assert angles.min() >= -limits.dive_angle_rad - 1e-3
    assert points[:, 2].min() >= limits.floor_amsl_m
    assert points[:, 2].max() <= limits.ceiling_amsl_m
    for axis, (low, high) in enumerate((limits.north_m, limits.east_m)):
        assert low <= points[:, axis].min()
        assert points[:, axis].max() <= high
    n, e = points[:, 0], points[:, 1]
    assert (np.hypot(n - 2_300.0, e - 4_300.0) - 350.0).min() >= d_s - 0.01  # of the fixture
    square = np.maximum(np.abs(n - 5_200.0), np.abs(e - 5_200.0)) - 200.0
    corner = np.hypot(*(np.maximum(np.abs(v - 5_200.0) - 200.0, 0.0) for v in (n, e)))
    assert np.where(square > 0.0, corner, square).min() >= d_s - 0.01


STARTS = [
    ((1_000.0, 1_000.0, 450.0), 45.0),
    ((2_100.0, 2_000.0, 600.0), 30.0),
    ((3_500.0, 3_100.0, 500.0), 20.0),
    ((2_400.0, 3_700.0, 400.0), -20.0),
    ((4_600.0, 4_700.0, 600.0), 60.0),
    ((1_300.0, 5_000.0, 500.0), 80.0),
]


@pytest.mark.parametrize(("start", "heading_deg"), STARTS)
@pytest.mark.parametrize("from_rest", [True, False], ids=["from rest", "in flight"])
def test_a_subpath_that_is_planned_in_flight_passes_an_independent_dense_check(
    task: Task,
    truth: KnownMap,
    terrain: PeakTerrain,
    start: tuple[float, float, float],
    heading_deg: float,
    from_rest: bool,
) -> None:
    heading = math.radians(heading_deg)
    tangent = np.array([math.cos(heading), math.sin(heading), 0.0])
    pose = Pose(position_nea_m=np.array(start), tangent_nea=tangent)
    outcome = plan(ask(task, truth, start=pose, scan_nea_m=start, from_rest=from_rest))
    if isinstance(outcome, NotPlanned):
        assert outcome.broken  # it may find nothing, but it says what was in the way
        return
    assert_safe(outcome.subpath, task, terrain)
    leaves = outcome.subpath.pose(0.0)
    assert leaves.position_nea_m == pytest.approx(start)
    if not from_rest:
        assert leaves.tangent_nea == pytest.approx(tangent, abs=1e-9)


def test_most_of_these_starts_have_a_subpath(task: Task, truth: KnownMap) -> None:
    outcomes = [
        plan(ask(task, truth, start=hover_pose(start), scan_nea_m=start)) for start, _ in STARTS
    ]
    assert sum(isinstance(outcome, Planned) for outcome in outcomes) >= 5


def test_from_rest_the_subpath_leaves_level_along_the_guide_direction(
    task: Task, truth: KnownMap
) -> None:
    outcome = planned(ask(task, truth))
    guide = [math.cos(outcome.guide_rad), math.sin(outcome.guide_rad), 0.0]
    assert outcome.subpath.pose(0.0).tangent_nea == pytest.approx(guide)


def test_a_climbing_tangent_at_p_prog_is_kept(task: Task, truth: KnownMap) -> None:
    tangent = np.array([math.cos(0.7), math.sin(0.7), 0.1])
    tangent /= np.linalg.norm(tangent)
    pose = Pose(position_nea_m=np.array(START), tangent_nea=tangent)
    outcome = planned(ask(task, truth, start=pose, from_rest=False))
    assert outcome.subpath.pose(0.0).tangent_nea == pytest.approx(tangent)


def test_the_end_lies_on_the_circle_about_p_scan(task: Task, truth: KnownMap) -> None:
    outcome = planned(ask(task, truth))
    assert not outcome.reaches_target
    assert outcome.tries == 1
    end = outcome.subpath.control_nea_m[-1]
    # R less the clearance and two diagonals of a cell
    radius = 2_000.0 - 65.5 - 2.0 * math.sqrt(2.0) * 25.0
    assert math.dist(end[:2], START[:2]) == pytest.approx(radius)


@pytest.mark.parametrize("left_m", [400.0, 1_200.0, 1_850.0])
def test_a_target_within_reach_is_the_end(task: Task, truth: KnownMap, left_m: float) -> None:
    target = (START[0] + left_m * math.cos(1.2), START[1] + left_m * math.sin(1.2))
    outcome = planned(ask(task, truth, target_ne_m=target))
    assert outcome.reaches_target
    assert outcome.subpath.control_nea_m[-1, :2] == pytest.approx(target)
    assert outcome.guide_rad == pytest.approx(1.2)


@pytest.mark.parametrize("left_m", [1_900.0, 2_100.0, 2_400.0])
def test_a_target_just_beyond_reach_is_left_with_room_for_the_last_subpath(
    task: Task, truth: KnownMap, left_m: float
) -> None:
    target = (START[0] + left_m * math.cos(1.2), START[1] + left_m * math.sin(1.2))
    outcome = planned(ask(task, truth, target_ne_m=target))
    assert not outcome.reaches_target
    room = math.dist(outcome.subpath.control_nea_m[-1, :2], target)
    assert room >= 0.35 * task.end_radius_m - 1e-6
    assert room >= 2.0 * task.limits.turn_radius_m


def test_a_target_on_unknown_ground_is_not_an_end(task: Task, truth: KnownMap) -> None:
    target = (START[0] + 1_000.0, START[1] + 1_000.0)
    known = replace(truth, upper_m=truth.upper_m.copy())
    known.upper_m[known.cell_of(*target)] = np.inf
    outcome = plan(ask(task, known, target_ne_m=target))
    assert isinstance(outcome, NotPlanned) or not outcome.reaches_target


def test_the_same_question_has_the_same_answer(task: Task, truth: KnownMap) -> None:
    a, b = planned(ask(task, truth)), planned(ask(task, truth))
    assert a.subpath.control_nea_m.tobytes() == b.subpath.control_nea_m.tobytes()
    assert (a.cost, a.terms, a.report, a.evaluations) == (b.cost, b.terms, b.report, b.evaluations)


@pytest.mark.parametrize("changes", [{"seed": 8}, {"plan_id": 2}, {"attempt": 1}], ids=str)
def test_another_seed_plan_or_attempt_is_another_search(
    task: Task, truth: KnownMap, changes: dict[str, int]
) -> None:
    beside_a_hill = (3_500.0, 3_100.0, 500.0)  # where no warm start is the best answer
    tangent = np.array([math.cos(0.35), math.sin(0.35), 0.0])
    request = ask(
        task,
        truth,
        scan_nea_m=beside_a_hill,
        start=Pose(position_nea_m=np.array(beside_a_hill), tangent_nea=tangent),
        from_rest=False,
    )
    a, b = planned(request), planned(replace(request, **changes))  # type: ignore[arg-type]
    assert not np.array_equal(a.subpath.control_nea_m, b.subpath.control_nea_m)


def test_each_attempt_searches_wider(task: Task, truth: KnownMap) -> None:
    first, third = planned(ask(task, truth)), planned(ask(task, truth, attempt=2))
    assert first.tries == third.tries == 1
    assert (first.evaluations, third.evaluations) == (400, 1_200)


def test_the_cost_is_the_weighted_sum_of_the_terms_that_are_reported(
    task: Task, truth: KnownMap
) -> None:
    outcome = planned(ask(task, truth))
    weights = {"length": 0.1, "height": 0.15, "guide": 0.15, "crash": 0.3, "radar": 0.3}
    weights["constraints"] = 1.0
    assert outcome.cost == pytest.approx(sum(a * outcome.terms[f] for f, a in weights.items()))
    assert outcome.report.violations(task.limits, task.settings.safety_distance_m) == ()


@pytest.fixture(scope="module")
def quick(task: Task) -> Task:
    """For questions without an answer: all sixteen tries are made."""
    settings = replace(
        task.settings, evaluations=60, search=replace(task.settings.search, population=10)
    )
    return replace(task, settings=settings)


def test_boxed_in_by_what_is_unknown_there_is_no_plan_but_a_reason(
    quick: Task, blank: KnownMap
) -> None:
    known = empty_map(blank.cell_m, (0.0, 8_000.0), (0.0, 8_000.0))
    known.upper_m[32:48, 32:48] = 100.0  # 200 m around the start
    outcome = plan(ask(quick, known))
    assert isinstance(outcome, NotPlanned)
    assert outcome.refusal is Refusal.NOTHING_SAFE
    assert "terrain clearance" in outcome.broken
    assert outcome.evaluations > 16 * 60


def test_boxed_in_by_a_keep_out_there_is_no_plan_but_a_reason(quick: Task, truth: KnownMap) -> None:
    circle = quick.keep_outs[0]
    inside = (2_300.0, 4_300.0, 500.0)
    outcome = plan(
        ask(replace(quick, keep_outs=(circle,)), truth, scan_nea_m=inside, start=hover_pose(inside))
    )
    assert isinstance(outcome, NotPlanned)
    assert "keep-out zone" in outcome.broken


@pytest.mark.parametrize("off_m", [0.0, 0.5, 30.0])
def test_a_target_where_the_vehicle_is_gives_a_path_of_numbers_or_no_path(
    quick: Task, truth: KnownMap, off_m: float
) -> None:
    with np.errstate(all="ignore"):
        outcome = plan(ask(quick, truth, target_ne_m=(START[0] + off_m, START[1])))
        if isinstance(outcome, Planned):
            pose = outcome.subpath.pose(0.0)
            assert np.isfinite(pose.position_nea_m).all()
            assert np.isfinite(pose.tangent_nea).all()
            assert math.isfinite(outcome.cost)


def test_the_paper_profile_takes_the_best_candidate_as_it_is(task: Task, truth: KnownMap) -> None:
    papers = replace(task, settings=replace(task.settings, profile=PAPER))
    outcome = planned(ask(papers, truth))
    assert (outcome.tries, outcome.rank, outcome.evaluations) == (1, 0, 400)
    end = outcome.subpath.control_nea_m[-1]
    assert math.dist(end[:2], START[:2]) == pytest.approx(2_000.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_subpath_of_the_paper_profile_has_a_direction_everywhere(
    task: Task, truth: KnownMap, seed: int
) -> None:
    papers = replace(task, settings=replace(task.settings, profile=PAPER, evaluations=2_000))
    with np.errstate(all="ignore"):
        subpath = planned(ask(papers, truth, seed=seed)).subpath
        tangents = [subpath.pose(share * subpath.length_m).tangent_nea for share in (0, 0.5, 1)]
    assert np.linalg.norm(tangents, axis=-1) == pytest.approx([1.0, 1.0, 1.0])
