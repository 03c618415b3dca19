import math
from collections.abc import Callable
from dataclasses import asdict, replace
from itertools import count

import numpy as np
import pytest
from brute_force import violations
from numpy.typing import NDArray
from planning import ask as asked
from planning import column_distance_m, hills

from companion import jit
from companion.objective import Scene
from companion.optimise import refined_de
from companion.optimise.refined_de import State
from companion.optimise.registry import OPTIMISERS
from companion.path.envelope import ending_m_s, rising_m_s, slowing_m
from companion.path.subpath import Pose
from companion.planner import kernels
from companion.planner.plan import plan
from companion.planner.procedure import Leg, hover_pose
from companion.planner.request import NotPlanned, Planned, PlanRequest, Refusal, Rest
from companion.planner.settings import Task
from companion.world.known_map import KnownMap, empty_map
from companion.world.simulated_scan import true_map
from companion.world.zones import PolygonZone

FloatArray = NDArray[np.float64]

START = (1_000.0, 1_000.0, 450.0)
FAR_TARGET = (7_500.0, 7_500.0)
RANDOM_STARTS = 12


def ask(task: Task, known: KnownMap, **changes: object) -> PlanRequest:
    return asked(task, known, START, **changes)


def beside_a_hill(task: Task, known: KnownMap) -> PlanRequest:
    """In flight, where no warm start is the best answer."""
    place = (3_500.0, 3_100.0, 500.0)
    pose = Pose(position_nea_m=np.array(place), **heading_to(20.0))
    return ask(task, known, scan_nea_m=place, start=pose, from_rest=False)


def planned(request: PlanRequest) -> Planned:
    outcome = plan(request)
    assert isinstance(outcome, Planned)
    return outcome


def with_budget(task: Task, evaluations: int, **changes: object) -> Task:
    settings = replace(task.settings, evaluations=evaluations, **changes)  # type: ignore[arg-type]
    return replace(task, settings=settings)


def heading_to(degrees: float, climb: float = 0.0, bend_1_m: float = 0.0) -> dict[str, FloatArray]:
    """Tangent and curvature of a pose: level bends to the right."""
    north, east = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    level = math.hypot(1.0, climb)
    return {
        "tangent_nea": np.array([north, east, climb]) / level,
        "curvature_nea_1_m": bend_1_m * np.array([-east, north, 0.0]),
    }


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
def test_a_plan_is_proven_and_passes_an_independent_check_of_every_metre(
    task: Task,
    truth: KnownMap,
    start: tuple[float, float, float],
    heading_deg: float,
    from_rest: bool,
) -> None:
    pose = Pose(position_nea_m=np.array(start), **heading_to(heading_deg, 0.03, 1.0 / 900.0))
    outcome = planned(ask(task, truth, start=pose, scan_nea_m=start, from_rest=from_rest))
    assert outcome.certificate.proven
    control = outcome.subpath.control_nea_m
    assert violations(control, task, truth, from_rest=from_rest) == []
    begins = outcome.subpath.pose(0.0)
    assert begins.position_nea_m == pytest.approx(pose.position_nea_m)
    if not from_rest:
        assert begins.tangent_nea == pytest.approx(pose.tangent_nea, abs=1e-9)
        assert np.linalg.norm(begins.curvature_nea_1_m) == pytest.approx(1.0 / 900.0, rel=0.01)


@pytest.mark.parametrize("seed", range(RANDOM_STARTS))
def test_from_anywhere_a_plan_is_safe_or_there_is_none_and_a_reason(
    task: Task, truth: KnownMap, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    start = tuple(float(v) for v in rng.uniform((500, 500, 315), (7_500, 7_500, 680)))
    pose = Pose(
        position_nea_m=np.array(start),
        **heading_to(*rng.uniform((-180, -0.15, -1 / 300.0), (180, 0.15, 1 / 300.0))),
    )
    hurried = with_budget(task, 100)
    from_rest = seed % 2 == 0
    target = tuple(float(v) for v in rng.uniform(500.0, 7_500.0, 2))
    outcome = plan(
        ask(hurried, truth, start=pose, scan_nea_m=start, from_rest=from_rest, target_ne_m=target)
    )
    if isinstance(outcome, NotPlanned):
        assert outcome.broken or outcome.refusal is not Refusal.NOTHING_SAFE
        return
    assert outcome.certificate.proven
    control = outcome.subpath.control_nea_m
    assert control[0] == pytest.approx(start)
    if outcome.evaluations:  # else it is the way out of where no certificate can begin
        assert violations(control, task, truth, from_rest=from_rest) == []


@pytest.mark.parametrize("left_m", [400.0, 1_200.0, 1_600.0])
def test_a_target_within_reach_is_the_end(task: Task, truth: KnownMap, left_m: float) -> None:
    target = (START[0] + left_m * math.cos(1.2), START[1] + left_m * math.sin(1.2))
    outcome = planned(ask(task, truth, target_ne_m=target))
    assert outcome.reaches_target
    assert outcome.subpath.control_nea_m[-1, :2] == pytest.approx(target)
    assert outcome.guide_rad == pytest.approx(1.2, abs=0.05)
    assert outcome.to_go == 0.0


@pytest.mark.parametrize("left_m", [1_950.0, 2_100.0, 2_400.0])
def test_a_target_just_beyond_reach_is_left_with_room_for_the_last_subpath(
    task: Task, truth: KnownMap, left_m: float
) -> None:
    target = (START[0] + left_m * math.cos(1.2), START[1] + left_m * math.sin(1.2))
    outcome = planned(ask(task, truth, target_ne_m=target))
    assert not outcome.reaches_target
    room = math.dist(outcome.subpath.control_nea_m[-1, :2], target)
    assert room >= 2.0 * task.limits.turn_radius_m


def test_a_target_on_unknown_ground_is_not_an_end(task: Task, truth: KnownMap) -> None:
    target = (START[0] + 1_000.0, START[1] + 1_000.0)
    known = replace(truth, upper_m=truth.upper_m.copy(), seen=truth.seen.copy())
    known.upper_m[known.cell_of(*target)] = np.inf
    known.seen[known.cell_of(*target)] = False
    outcome = plan(ask(task, known, target_ne_m=target))
    assert isinstance(outcome, NotPlanned) or not outcome.reaches_target


def test_the_same_question_has_the_same_answer(task: Task, truth: KnownMap) -> None:
    a, b = planned(ask(task, truth)), planned(ask(task, truth))
    assert a.subpath.control_nea_m.tobytes() == b.subpath.control_nea_m.tobytes()
    assert (a.cost, a.terms, a.certificate) == (b.cost, b.terms, b.certificate)
    assert (a.evaluations, a.rank, a.tries) == (b.evaluations, b.rank, b.tries)


@pytest.mark.parametrize("changes", [{"seed": 8}, {"plan_id": 2}, {"attempt": 1}], ids=str)
def test_another_seed_plan_or_attempt_is_another_search(
    task: Task, truth: KnownMap, changes: dict[str, int]
) -> None:
    request = beside_a_hill(task, truth)
    a, b = planned(request), planned(replace(request, **changes))  # type: ignore[arg-type]
    assert not np.array_equal(a.subpath.control_nea_m, b.subpath.control_nea_m)


def walled_in(task: Task, truth: KnownMap) -> PlanRequest:
    """From rest in a ring of walls: nothing can be proven, whatever is tried."""
    north, east = truth.middles_m(0, 0, truth.upper_m.shape)
    away_m = np.hypot(north - START[0], east - START[1])
    walls_m = np.where((away_m > 120.0) & (away_m < 900.0), 690.0, 100.0)
    near = with_budget(task, 60, cell_m=truth.cell_m)
    return ask(near, replace(truth, upper_m=walls_m), from_rest=True)


def test_with_hardly_any_search_a_hovering_vehicle_finds_the_gap_in_a_wall(
    task: Task, truth: KnownMap
) -> None:
    """Three real flights gave up where a leg existed: their computers had no time to find it."""
    request = ask(task, truth, from_rest=True)
    north, east = truth.middles_m(0, 0, truth.upper_m.shape)
    away_m = np.hypot(north - START[0], east - START[1])
    bearing = np.arctan2(east - START[1], north - START[0])
    ring = (away_m > 250.0) & (away_m < 900.0) & (np.abs(bearing + 2.0) > 0.35)
    shut = replace(truth, upper_m=np.where(ring, 690.0, 100.0))
    outcome = planned(replace(request, known=shut, task=with_budget(task, 60)))
    assert outcome.certificate.proven
    slower = task.at_speed(outcome.speed_m_s)
    assert violations(outcome.subpath.control_nea_m, slower, shut, from_rest=True) == []


def test_in_a_ring_of_walls_nothing_is_proven_and_more_is_evaluated_with_each_attempt(
    task: Task, truth: KnownMap
) -> None:
    found = [plan(replace(walled_in(task, truth), attempt=attempt)) for attempt in (0, 1)]
    for outcome in found:
        assert isinstance(outcome, NotPlanned)
        assert outcome.refusal is Refusal.NOTHING_SAFE
        assert outcome.broken
    assert found[1].evaluations == 2 * found[0].evaluations


def each(calls: int) -> Callable[[], bool]:
    """Time is up after so many questions whether it is."""
    asked = count(1)
    return lambda: next(asked) > calls


@pytest.mark.parametrize("time_s", [0.1, 0.4, 1.0, 3.0, 10.0])
def test_a_wider_search_has_more_time_where_the_vehicle_hovers_but_no_longer_than_3_s_or_t(
    task: Task, truth: KnownMap, time_s: float
) -> None:
    task = with_budget(task, 3000, planning_time_s=time_s)
    for attempt in range(5):
        at_rest = ask(task, truth, attempt=attempt, from_rest=True).time_s
        assert at_rest == pytest.approx(min((1 + 3 * attempt) * time_s, max(3.0, time_s)))
        assert ask(task, truth, attempt=attempt, from_rest=False).time_s == time_s


def test_the_cost_is_the_weighted_sum_of_the_terms_that_are_reported(
    task: Task, truth: KnownMap
) -> None:
    outcome, weights = planned(ask(task, truth)), asdict(task.settings.weights)
    assert outcome.cost == pytest.approx(sum(a * outcome.terms[f] for f, a in weights.items()))
    assert outcome.to_go == pytest.approx(weights["length"] * outcome.terms["to_go"])
    assert outcome.to_go > 0.0


@pytest.mark.parametrize("name", ["improved-de", "pso", "de/rand/1/bin", "refined-de"])
def test_the_optimiser_that_the_settings_name_searches(
    task: Task, truth: KnownMap, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    request = beside_a_hill(task, truth)
    default = planned(request)
    asked: list[str] = []
    for each, make in OPTIMISERS.items():

        def noted(*arguments: object, each: str = each, make: object = make) -> object:
            asked.append(each)
            return make(*arguments)  # type: ignore[operator]

        monkeypatch.setitem(OPTIMISERS, each, noted)
    chosen = planned(replace(request, task=with_budget(task, 600, optimiser=name)))
    same = np.array_equal(chosen.subpath.control_nea_m, default.subpath.control_nea_m)
    assert same == (name == "refined-de")  # the default of profile `flight`
    assert set(asked) == (set() if name == "refined-de" else {name})
    assert violations(chosen.subpath.control_nea_m, task, truth, from_rest=False) == []


@pytest.mark.parametrize("looks", [1, 2, 4])
def test_the_search_ends_with_the_first_look_at_the_clock_after_time_is_up(
    task: Task, truth: KnownMap, looks: int
) -> None:
    asked = count(1)
    request = ask(with_budget(task, 6_000), truth)
    outcome = plan(request, stop=lambda: next(asked) >= looks)
    assert 300 * (looks - 1) < outcome.evaluations <= 300 * (looks + 1)
    assert next(asked) - looks <= 5  # it does not go on with other ways


def test_boxed_in_by_what_is_unknown_there_is_no_plan_but_a_reason(
    task: Task, blank: KnownMap
) -> None:
    known = empty_map(blank.cell_m, (0.0, 8_000.0), (0.0, 8_000.0))
    known.upper_m[36:44, 36:44] = 100.0  # 100 m around the start
    outcome = plan(ask(with_budget(task, 40), known))
    assert isinstance(outcome, NotPlanned)
    assert outcome.refusal is Refusal.NOTHING_SAFE
    assert "terrain clearance" in outcome.broken
    assert outcome.evaluations == 40 * outcome.tries > 40


def hover(north: float, east: float, altitude: float) -> dict[str, object]:
    place = (north, east, altitude)
    return {"start": hover_pose(place), "scan_nea_m": place}


@pytest.mark.parametrize(
    ("changes", "refusal"),
    [
        (hover(-10.0, 1_000.0, 450.0), Refusal.START_OUTSIDE),
        (hover(1_000.0, 8_010.0, 450.0), Refusal.START_OUTSIDE),
        (hover(1_000.0, 1_000.0, 305.0), Refusal.START_OUTSIDE),
        (hover(1_000.0, 1_000.0, 695.0), Refusal.START_OUTSIDE),
        ({"target_ne_m": (2_300.0, 4_300.0)}, Refusal.TARGET_IN_KEEP_OUT),
        ({"target_ne_m": (2_300.0, 4_300.0 + 350.0 + 69.0)}, Refusal.TARGET_IN_KEEP_OUT),
        ({"target_ne_m": (3_000.0, 2_600.0)}, Refusal.TARGET_IN_TERRAIN),
        ({}, Refusal.NOTHING_SEEN),
        ({}, Refusal.NO_ROOM_TO_TURN),
        ({"scan_nea_m": (math.nan, 1_000.0, 450.0)}, Refusal.NO_QUESTION),
        (hover(2_300.0, 4_600.0, 450.0) | {"from_rest": False}, Refusal.START_IN_KEEP_OUT),
        (hover(3_000.0, 3_000.0, 320.0) | {"from_rest": False}, Refusal.START_NEAR_TERRAIN),
    ],
    ids=str,
)
def test_a_question_without_an_answer_is_refused_at_once_with_its_reason(
    task: Task, truth: KnownMap, blank: KnownMap, changes: dict[str, object], refusal: Refusal
) -> None:
    if refusal is Refusal.NOTHING_SEEN:
        truth = blank
    if refusal is Refusal.NO_ROOM_TO_TURN:
        task = replace(task, limits=replace(task.limits, turn_radius_m=1_001.0))
    outcome = plan(ask(task, truth, **changes))
    assert isinstance(outcome, NotPlanned)
    assert (outcome.refusal, outcome.evaluations) == (refusal, 0)
    assert "; " in refusal.value  # the reason, and what helps


@pytest.mark.parametrize("off_m", [0.0, 0.5, 30.0])
def test_a_target_where_the_vehicle_is_gives_a_path_of_numbers_or_no_path(
    task: Task, truth: KnownMap, off_m: float
) -> None:
    with np.errstate(all="ignore"):
        target = (START[0] + off_m, START[1])
        outcome = plan(ask(with_budget(task, 60), truth, target_ne_m=target))
        if isinstance(outcome, Planned):
            pose = outcome.subpath.pose(0.0)
            assert np.isfinite(pose.position_nea_m).all()
            assert np.isfinite(pose.tangent_nea).all()
            assert math.isfinite(outcome.cost)


def test_the_check_of_every_metre_finds_what_is_wrong(task: Task, truth: KnownMap) -> None:
    control = planned(ask(task, truth)).subpath.control_nea_m
    assert "floor" in violations(control - np.array([0, 0, 30.0]), task, truth, from_rest=True)
    assert "ceiling" in violations(control + np.array([0, 0, 380.0]), task, truth, from_rest=True)
    hill = np.array([3_000.0, 2_600.0, 0.0]) - control[-1]
    assert "clearance" in violations(control + 0.97 * hill, task, truth, from_rest=True)
    shaken, steep = control.copy(), control.copy()
    shaken[2:4, 1] += [900.0, -900.0]
    steep[-2, 2] += 800.0
    assert "turn" in violations(shaken, task, truth, from_rest=True)
    assert {"climb", "dive"} <= set(violations(steep, task, truth, from_rest=True))
    assert "map" in violations(control - np.array([1_500.0, 0, 0]), task, truth, from_rest=True)
    over = column_distance_m(truth, np.array([[6_000.0, 6_200.0, 540.0]]), 100.0)
    assert over[0] == pytest.approx(40.0, abs=5.0)


def test_it_stops_where_flying_back_from_there_is_shorter_than_the_way_round(
    task: Task, truth: KnownMap
) -> None:
    """Between two walls there is no room to turn; round them to the target it is some 4 km."""
    level = replace(truth, upper_m=np.full_like(truth.upper_m, 100.0))
    gap_m = task.zone_search_clearance_m + 30.0
    walls = tuple(
        PolygonZone(
            name=f"wall {side}",
            vertices_ne_m=tuple(
                (north, 4_000.0 + side * (gap_m + thick))
                for north, thick in ((2e3, 0.0), (3.5e3, 0.0), (3.5e3, 60.0), (2e3, 60.0))
            ),
        )
        for side in (-1, 1)
    )
    alone = with_budget(replace(task, radars=(), zones=walls), 1_500)
    here = (3_000.0, 4_000.0, 320.0)
    request = ask(
        alone, level, from_rest=False, scan_nea_m=here, target_ne_m=(1_000.0, 4_000.0),
        start=Pose(position_nea_m=np.array(here), **heading_to(0.0)),
        rest=Rest(length_m=300.0, end_nea_m=(here[0] + 300.0, *here[1:])),
    )  # fmt: skip
    outcome = plan(request)
    assert isinstance(outcome, NotPlanned)
    assert outcome.refusal is Refusal.BETTER_TO_STOP
    going_on = planned(replace(request, rest=None))
    metre = 2.4 * task.settings.scan_range_m / (100.0 * task.settings.weights.length)
    assert (going_on.cost + going_on.to_go) * metre > 3_500.0


def test_what_a_stop_costs_is_what_is_not_flown_meanwhile(task: Task) -> None:
    """Braking for the end and setting out again as the reference point does; a scan and a plan."""
    motion, step_s = task.envelope, 1e-3
    lost_m, left_m, flown_m = 0.0, slowing_m(motion, motion.speed_m_s), 1e-6
    while (speed := ending_m_s(motion, left_m)) > 0.1 * motion.speed_m_s:  # slower: it is there
        left_m, lost_m = left_m - speed * step_s, lost_m + (motion.speed_m_s - speed) * step_s
    while (speed := rising_m_s(motion, flown_m)) < motion.speed_m_s:
        flown_m, lost_m = flown_m + speed * step_s, lost_m + (motion.speed_m_s - speed) * step_s
    stands_s = task.settings.scan_time_s + task.settings.planning_time_s
    assert task.stop_m == pytest.approx(lost_m + motion.speed_m_s * stands_s, rel=0.1)


def subpaths_until_it_arrives(task: Task, known: KnownMap, start: Pose, most: int) -> int:
    """How many follow each other, with stops where the planner wants to, until one arrives."""
    request = ask(
        task, known, start=start, from_rest=False, scan_nea_m=tuple(start.point_nea_m),
        target_ne_m=(4_000.0, 4_000.0),
    )  # fmt: skip
    end = start.point_nea_m
    for number in range(1, most + 1):
        outcome = plan(replace(request, plan_id=number))
        if isinstance(outcome, NotPlanned):
            assert not request.from_rest
            request = replace(
                request, start=hover_pose(end), scan_nea_m=end, from_rest=True, rest=None
            )  # fmt: skip
            continue
        assert isinstance(outcome, Planned)
        if outcome.reaches_target:
            return number
        leg = Leg.of(outcome, number)
        end = leg.subpath.pose(leg.subpath.length_m).point_nea_m
        request = replace(
            request,
            start=leg.subpath.pose(leg.successor_at_m(task)),
            scan_nea_m=leg.subpath.pose(leg.scan_at_m(task)).point_nea_m,
            from_rest=False,
            rest=leg.rest(task),
        )
    return most + 1


@pytest.mark.parametrize("beside_m", [240.0, 280.0, 320.0])
def test_no_vehicle_circles_a_target_that_its_turns_are_too_wide_for(
    task: Task, truth: KnownMap, beside_m: float
) -> None:
    """Each subpath is hardly dearer than promised, but it could stop and leave for the target."""
    level = replace(truth, upper_m=np.full_like(truth.upper_m, 100.0))
    alone = replace(task, zones=(), radars=())
    start = Pose(position_nea_m=np.array([4_000.0, 4_000.0 + beside_m, 320.0]), **heading_to(0.0))
    assert subpaths_until_it_arrives(alone, level, start, most=6) <= 6


@pytest.mark.parametrize(
    ("top_m", "down_m", "away_m"), [(500.0, 230.0, 1_000.0), (550.0, 280.0, 1_000.0)]
)
def test_a_proven_way_up_to_the_target_is_taken_though_a_near_end_looks_cheaper(
    task: Task, blank: KnownMap, top_m: float, down_m: float, away_m: float
) -> None:
    """From the near end it could only fly past: the cost-to-go knows nothing of turns."""
    known = true_map(hills((4e3, 4e3, top_m, 400.0, 400.0), ground_m=100.0), blank)
    target = (4_000.0 - down_m, 4_000.0)
    start = (target[0] - away_m, 4_000.0, 310.001)
    pose = Pose(position_nea_m=np.array(start), **heading_to(20.0))
    request = ask(
        replace(task, zones=(), radars=()), known, start=pose, scan_nea_m=start, from_rest=False
    )
    assert planned(replace(request, target_ne_m=target)).reaches_target


def test_a_plan_stays_in_a_fence_of_many_corners_and_goes_round_its_bight(
    task: Task, truth: KnownMap
) -> None:
    turn = np.linspace(0.0, 2.0 * math.pi, 240, endpoint=False)
    far = np.where(np.abs(turn - math.pi / 2.0) < 0.35, 500.0, 2_400.0)  # a bight in the east
    vertices = tuple(
        (float(n), float(e))
        for n, e in zip(4_000.0 + far * np.cos(turn), 4_000.0 + far * np.sin(turn), strict=True)
    )
    fence = PolygonZone(name="f", vertices_ne_m=vertices, keep_in=True)
    start, target = (5_200.0, 5_200.0, 600.0), (2_800.0, 5_200.0)
    level = replace(truth, upper_m=np.full_like(truth.upper_m, 100.0))
    fenced = replace(task, zones=(fence,), radars=())
    request = replace(
        ask(fenced, level), start=hover_pose(start), scan_nea_m=start, target_ne_m=target
    )
    outcome = plan(request)
    assert isinstance(outcome, Planned)
    route = np.array(outcome.route_ne_m)
    assert route[:, 1].min() < 4_600.0  # round the bight, not across it
    points = outcome.subpath.points_nea_m(np.linspace(0.0, outcome.subpath.length_m, 2_000))
    gap = fence.distance_m(points[:, 0], points[:, 1])
    assert gap.min() >= task.required_clearance_m


def test_from_rest_a_plan_leaves_level_about_where_the_guide_points(
    task: Task, truth: KnownMap
) -> None:
    outcome = planned(ask(task, truth))
    pose = outcome.subpath.pose(0.0)
    guide = [math.cos(outcome.guide_rad), math.sin(outcome.guide_rad), 0.0]
    assert pose.tangent_nea @ guide > math.cos(0.6)
    assert pose.tangent_nea[2] == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(pose.curvature_nea_1_m) <= 1e-9


def test_the_end_is_within_the_circle_about_p_scan_and_mostly_on_it(
    task: Task, truth: KnownMap
) -> None:
    outcome = planned(ask(task, truth))
    assert not outcome.reaches_target
    end = outcome.subpath.control_nea_m[-1]
    assert 0.95 * task.end_radius_m < math.dist(end[:2], START[:2]) <= task.end_radius_m + 1e-6
    assert math.dist(end[:2], FAR_TARGET) < math.dist(START[:2], FAR_TARGET) - 1_000.0


def test_it_goes_round_a_hill_that_the_straight_way_cannot_cross(
    task: Task, blank: KnownMap
) -> None:
    known = replace(blank, upper_m=np.zeros_like(blank.upper_m), seen=~blank.seen)
    low, high = known.cell_of(2_000.0, 2_000.0)[0], known.cell_of(2_400.0, 2_400.0)[0]
    known.upper_m[low:high, low:high] = 5_000.0  # ahead, above the ceiling
    free = replace(task, zones=(), radars=())
    outcome = planned(ask(free, known, target_ne_m=(3_600.0, 3_600.0)))
    control = outcome.subpath.control_nea_m
    assert violations(control, free, known, from_rest=True) == []
    assert outcome.subpath.length_m < 1.5 * math.dist(control[0, :2], control[-1, :2])


def test_evaluations_and_tries_are_those_of_the_plan_not_of_the_search_that_found_it(
    task: Task, truth: KnownMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counted by the kernel, of plans that search again and keep what they had, or find nothing."""
    compiled = jit.compiled
    for degrees in range(0, 360, 60):
        searched: dict[int, tuple[object, int]] = {}

        def search(state: State, scene: Scene, until: int) -> None:
            compiled(kernels.search)(state, scene, until)
            searched[id(state)] = state, refined_de.spent(state)  # noqa: B023 - called in this turn

        start = Pose(position_nea_m=np.array(START), **heading_to(degrees))
        request = ask(with_budget(task, 60), truth, start=start, from_rest=False)
        counted = {kernels.search: search}
        monkeypatch.setattr(jit, "compiled", lambda f, by=counted: by.get(f) or compiled(f))
        outcome = plan(request)
        assert outcome.evaluations == sum(spent for _, spent in searched.values())
        if isinstance(outcome, Planned):
            assert outcome.tries == len(searched)


@pytest.mark.parametrize("start", [START, (3_500.0, 3_100.0, 500.0)])
def test_with_no_time_at_all_it_still_gives_a_proven_plan_or_none(
    task: Task, truth: KnownMap, start: tuple[float, float, float]
) -> None:
    request = ask(with_budget(task, 30_000), truth, scan_nea_m=start, start=hover_pose(start))
    outcome = plan(request, stop=lambda: True)
    assert outcome.evaluations <= 600
    if isinstance(outcome, Planned):
        assert outcome.certificate.proven
        assert violations(outcome.subpath.control_nea_m, task, truth, from_rest=True) == []


def test_the_longer_it_may_search_the_better_the_plan(task: Task, truth: KnownMap) -> None:
    costs = []
    for looks in (1, 10):
        asked, request = count(1), beside_a_hill(with_budget(task, 3_000), truth)
        outcome = plan(request, stop=lambda: next(asked) >= looks)  # noqa: B023
        assert isinstance(outcome, Planned)
        costs.append(outcome.cost + outcome.to_go)
    assert costs[1] < costs[0]


def test_what_stands_flies_less_than_l_where_no_more_is_seen(task: Task, blank: KnownMap) -> None:
    """It will stop there, and see on."""
    known = empty_map(blank.cell_m, (0.0, 8_000.0), (0.0, 8_000.0))
    known.upper_m[28:52, 28:52] = 100.0  # 300 m around the start
    alone = replace(task, zones=(), radars=())
    short = planned(ask(alone, known))
    assert 50.0 < short.subpath.length_m < task.scan_distance_m
    assert violations(short.subpath.control_nea_m, alone, known, from_rest=True) == []
