"""One plan: it is proven and passes a check that shares nothing with the proof, or says why not."""

import ast
import math
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from brute_force import violations
from made_up_plans import straight_plan
from planning import BLANK, TASK, TRUTH, planned, refused
from planning import ask as asked

from companion import jit
from companion.path.subpath import Pose
from companion.planner import kernels
from companion.planner.field import cost_to_go
from companion.planner.plan import plan
from companion.planner.price import Prices
from companion.planner.procedure import hover_pose
from companion.planner.progress import SLACK, Progress
from companion.planner.request import NotPlanned, Planned, PlanRequest, Refusal, Rest
from companion.planner.settings import Task
from companion.world.known_map import KnownMap
from companion.world.radars import Radar
from companion.world.zones import PolygonZone

Vector = tuple[float, float, float]

START = (1_000.0, 1_000.0, 450.0)
BESIDE_A_HILL = (3_500.0, 3_100.0, 500.0)


def ask(task: Task, known: KnownMap, **changes: Any) -> PlanRequest:
    return asked(task, known, START, **changes)


def flying(place: Vector, degrees: float, climb: float = 0.0, bend: float = 0.0) -> dict[str, Any]:
    """There, on such a heading, in a level bend to the right of so much 1/m."""
    north, east = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    pose = Pose(
        position_nea_m=np.array(place),
        tangent_nea=np.array([north, east, climb]) / math.hypot(1.0, climb),
        curvature_nea_1_m=bend * np.array([-east, north, 0.0]),
    )
    return {"start": pose, "scan_nea_m": place, "from_rest": False}


def hover(*place: float) -> dict[str, Any]:
    return {"start": hover_pose(np.array(place)), "scan_nea_m": place}


PLAIN = replace(TRUTH, upper_m=np.full_like(TRUTH.upper_m, 100.0))
"""All of the map, and level."""
IN_FLIGHT_BESIDE_A_HILL = flying(BESIDE_A_HILL, 20.0)  # where no seed is the best answer


def budget(evaluations: int, **changes: Any) -> Task:
    return replace(TASK, settings=replace(TASK.settings, evaluations=evaluations, **changes))


# --- what is planned is safe


PLACES = (
    (START, 45.0), ((2_100.0, 2_000.0, 600.0), 30.0), (BESIDE_A_HILL, 20.0),
    ((2_400.0, 3_700.0, 400.0), -20.0), ((4_600.0, 4_700.0, 600.0), 60.0),
    ((1_300.0, 5_000.0, 500.0), 80.0),
)  # fmt: skip


def from_anywhere(seed: int) -> PlanRequest:
    """From any place, in any bend and climb, to any target: perhaps there is no way."""
    rng = np.random.default_rng(seed)
    north, east, up = rng.uniform((500, 500, 315), (7_500, 7_500, 680)).tolist()
    where = flying((north, east, up), *rng.uniform((-180, -0.15, -1 / 300), (180, 0.15, 1 / 300)))
    target = tuple(rng.uniform(500.0, 7_500.0, 2).tolist())
    return ask(budget(100), TRUTH, **where, target_ne_m=target)


@pytest.mark.parametrize("from_rest", [True, False], ids=["from rest", "in flight"])
@pytest.mark.parametrize("asked", [
    *(ask(TASK, TRUTH, **flying(*place, 0.03, 1.0 / 900.0)) for place in PLACES),
    *map(from_anywhere, range(6)),
], ids=lambda asked: f"{asked.start.point_nea_m} to {asked.target_ne_m}")  # fmt: skip
def test_a_plan_is_proven_and_passes_an_independent_check_of_every_metre_or_says_why_not(
    asked: PlanRequest, from_rest: bool
) -> None:
    request = replace(asked, from_rest=from_rest)
    outcome = plan(request)
    if isinstance(outcome, NotPlanned):
        assert request.task.settings.evaluations == 100  # from the other places there is one
        assert outcome.broken or outcome.refusal is not Refusal.NOTHING_SAFE
        return
    assert outcome.certificate.proven
    begins = outcome.subpath.pose(0.0)
    assert begins.position_nea_m == pytest.approx(request.start.position_nea_m)
    if outcome.evaluations:  # else it is the way out of where no certificate can begin
        control = outcome.subpath.control_nea_m
        assert violations(control, TASK, TRUTH, from_rest=from_rest) == []
    if not from_rest:
        assert begins.tangent_nea == pytest.approx(request.start.tangent_nea, abs=1e-9)
        bend = request.start.curvature_nea_1_m
        assert begins.curvature_nea_1_m == pytest.approx(bend, rel=0.01, abs=1e-6)


def test_the_check_of_every_metre_finds_what_is_wrong() -> None:
    """Else that nothing is found would say nothing, here and in what is flown offline."""
    control = planned(ask(TASK, TRUTH)).subpath.control_nea_m
    shaken, steep = control.copy(), control.copy()
    shaken[2:4, 1] += [900.0, -900.0]
    steep[-2, 2] += 800.0
    hill = 0.97 * (np.array([3_000.0, 2_600.0, 0.0]) - control[-1])
    for wrong, told in (
        (control - [0, 0, 30.0], {"floor"}), (control - [0, 0, -380.0], {"ceiling"}),
        (control + hill, {"clearance"}), (control - [1_500.0, 0, 0], {"map"}),
        (shaken, {"turn"}), (steep, {"climb", "dive"}),
    ):  # fmt: skip
        assert told <= set(violations(wrong, TASK, TRUTH, from_rest=True))


# --- where it leads


@pytest.mark.parametrize(
    ("left_m", "reaches"),
    [(0.5, None), (400.0, True), (1_600.0, True), (1_950.0, False), (2_400.0, False)],
)
def test_a_target_within_reach_is_the_end_and_one_beyond_is_left_room_for_the_last_subpath(
    left_m: float, reaches: bool | None
) -> None:
    """Where the vehicle is already there is a path of numbers, or none."""
    target = (START[0] + left_m * math.cos(1.2), START[1] + left_m * math.sin(1.2))
    outcome = plan(ask(TASK, TRUTH, target_ne_m=target))
    if reaches is None:
        assert isinstance(outcome, NotPlanned) or np.isfinite(outcome.subpath.control_nea_m).all()
        return
    assert isinstance(outcome, Planned)
    end = outcome.subpath.control_nea_m[-1, :2]
    assert outcome.reaches_target is reaches
    if reaches:
        assert end == pytest.approx(target)
        assert outcome.guide_rad == pytest.approx(1.2, abs=0.05)
        assert outcome.to_go == 0.0
    else:
        assert math.dist(end, target) >= 2.0 * TASK.limits.turn_radius_m


# --- when there is none


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
        ({"scan_nea_m": (math.nan, 1_000.0, 450.0)}, Refusal.NO_QUESTION),
        (hover(2_300.0, 4_600.0, 450.0) | {"from_rest": False}, Refusal.START_IN_KEEP_OUT),
        (hover(3_000.0, 3_000.0, 320.0) | {"from_rest": False}, Refusal.START_NEAR_TERRAIN),
    ],
    ids=str,
)
def test_a_question_without_an_answer_is_refused_at_once_with_its_reason(
    changes: dict[str, Any], refusal: Refusal
) -> None:
    known = BLANK if refusal is Refusal.NOTHING_SEEN else TRUTH
    outcome = refused(ask(TASK, known, **changes))
    assert (outcome.refusal, outcome.evaluations) == (refusal, 0)
    assert "; " in refusal.value  # the reason, and what helps


def test_in_a_ring_of_walls_nothing_is_proven_and_more_is_evaluated_with_each_attempt() -> None:
    north, east = TRUTH.middles_m()
    away_m = np.hypot(north - START[0], east - START[1])
    ring = np.where((away_m > 120.0) & (away_m < 900.0), 690.0, 100.0)
    request = ask(budget(60, cell_m=TRUTH.cell_m), replace(TRUTH, upper_m=ring))
    found = [refused(replace(request, attempt=attempt)) for attempt in (0, 1)]
    assert [outcome.refusal for outcome in found] == [Refusal.NOTHING_SAFE] * 2
    assert all(outcome.broken for outcome in found)
    assert found[1].evaluations == 2 * found[0].evaluations


# --- where it is better to stop


def test_it_stops_where_flying_back_from_there_is_shorter_than_the_way_round() -> None:
    """Between two walls there is no room to turn; round them to the target it is some 4 km."""
    gap_m, here = TASK.zone_search_clearance_m + 30.0, (3_000.0, 4_000.0, 320.0)
    corners = (2e3, 0.0), (3.5e3, 0.0), (3.5e3, 60.0), (2e3, 60.0)
    walls = tuple(
        PolygonZone(
            name=f"wall {side}",
            vertices_ne_m=tuple((n, 4_000.0 + side * (gap_m + thick)) for n, thick in corners),
        )
        for side in (-1, 1)
    )
    task = replace(budget(1_500), radars=(), zones=walls)
    request = ask(
        task, PLAIN, **flying(here, 0.0), target_ne_m=(1_000.0, 4_000.0),
        rest=Rest(length_m=300.0, end_nea_m=(here[0] + 300.0, *here[1:])),
    )  # fmt: skip
    assert refused(request).refusal is Refusal.BETTER_TO_STOP
    going_on = planned(replace(request, rest=None))
    metre = 2.4 * TASK.settings.scan_range_m / (100.0 * TASK.settings.weights.length)
    assert (going_on.cost + going_on.to_go) * metre > 3_500.0


def test_a_leg_leads_away_only_if_that_is_news() -> None:
    """From rest a leg may be chosen though its end is farther off: turned back, it would again."""
    here, end, target_ne_m = (4_000.0, 4_000.0, 320.0), (4_000.0, 3_500.0, 320.0), (4e3, 7e3)
    prices = Prices(TASK, cost_to_go(PLAIN, TASK, here[:2], target_ne_m))
    for thought_m, is_news in ((0.0, False), (-2.0 * SLACK * TASK.settings.scan_range_m, True)):
        progress = Progress(end_m=prices.promised_m(end) + thought_m)
        told = replace(prices, progress=progress)
        assert told.leads_away(here, end) is is_news
        assert not told.leads_away(end, here)  # nearer to the target


def test_the_last_leg_pays_a_radar_for_its_own_length_as_a_straight_piece_does() -> None:
    """That is charged metre by metre; the mean over a short leg stood for all of R."""
    low_m, range_m = TASK.band_amsl_m[0], TASK.settings.scan_range_m
    here, target_ne_m = (4_000.0, 4_000.0, low_m), (4_200.0, 4_000.0)
    radar = Radar(name="r", centre_nea_m=(*target_ne_m, low_m), range_m=9_000.0)
    task = replace(TASK, radars=(radar,))
    prices = Prices(task, cost_to_go(PLAIN, task, here[:2], target_ne_m))
    piece = replace(
        straight_plan(ask(task, PLAIN, **hover(*here), target_ne_m=target_ne_m)), terms={}
    )
    seen, weights = 300.0, task.settings.weights  # ten samples, each surely seen
    cost = weights.length * 100.0 / 2.4 * piece.subpath.length_m / range_m + weights.radar * seen
    leg = replace(piece, cost=cost, terms={"radar": seen})
    assert prices.cost_m(leg) == pytest.approx(prices.cost_m(piece), rel=0.05)


# --- the search


def test_the_same_question_has_the_same_answer_and_another_seed_plan_or_attempt_another() -> None:
    request = ask(TASK, TRUTH, **IN_FLIGHT_BESIDE_A_HILL)
    a, b = planned(request), planned(request)
    assert a.subpath.control_nea_m.tobytes() == b.subpath.control_nea_m.tobytes()
    assert (a.cost, a.terms, a.certificate) == (b.cost, b.terms, b.certificate)
    assert (a.evaluations, a.rank, a.tries) == (b.evaluations, b.rank, b.tries)
    for changed in (
        replace(request, seed=8), replace(request, plan_id=2), replace(request, attempt=1)
    ):  # fmt: skip
        other = planned(changed)
        assert not np.array_equal(a.subpath.control_nea_m, other.subpath.control_nea_m)


@pytest.mark.parametrize("time_s", [0.1, 10.0])
def test_a_wider_search_has_more_time_where_the_vehicle_hovers_but_no_longer_than_3_s_or_t(
    time_s: float,
) -> None:
    task = budget(3000, planning_time_s=time_s)
    most_s = max(3.0, time_s)
    for attempt in range(5):
        at_rest = ask(task, TRUTH, attempt=attempt).time_s
        assert at_rest == pytest.approx(min((1 + 3 * attempt) * time_s, most_s))
        assert ask(task, TRUTH, attempt=attempt, from_rest=False).time_s == time_s


@pytest.mark.parametrize("looks", [1, 4])
@pytest.mark.parametrize("start", [START, BESIDE_A_HILL], ids=str)
def test_the_search_ends_with_the_first_look_at_the_clock_after_time_is_up(
    looks: int, start: Vector
) -> None:
    """And what it has found by then is proven, or there is no plan."""
    clock = count(1)
    outcome = plan(ask(budget(6_000), TRUTH, **hover(*start)), stop=lambda: next(clock) >= looks)
    assert 300 * (looks - 1) < outcome.evaluations <= 300 * (looks + 1)
    assert next(clock) - looks <= 5  # it does not go on with other ways
    if isinstance(outcome, Planned):
        assert violations(outcome.subpath.control_nea_m, TASK, TRUTH, from_rest=True) == []


# --- compiled and plain code are one


@pytest.mark.parametrize(
    ("start", "from_rest"), [((1e3, 1e3, 450.0), True), ((3_500.0, 3_100.0, 500.0), False)]
)
def test_plain_python_makes_the_same_plan(
    start: Vector, from_rest: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    request = asked(TASK, TRUTH, start, from_rest=from_rest)
    fast = planned(request)
    monkeypatch.setattr(jit, "compiled", lambda function: function)
    slow = planned(request)
    assert fast.kernel == kernels.signature()
    np.testing.assert_allclose(
        fast.subpath.control_nea_m, slow.subpath.control_nea_m, rtol=1e-6, atol=1e-6
    )
    assert fast.cost == pytest.approx(slow.cost, rel=1e-9)
    assert (fast.rank, fast.tries, fast.evaluations) == (slow.rank, slow.tries, slow.evaluations)
    assert fast.certificate.proven
    for name in ("clearance_m", "keep_out_m", "dead_man_m", "turn_radius_m", "climb_angle_rad"):
        one, other = getattr(fast.certificate, name), getattr(slow.certificate, name)
        assert one == pytest.approx(other, rel=1e-6), name


@pytest.mark.parametrize("source", jit.SOURCES)
def test_a_constant_that_compiled_code_imports_comes_from_such_a_source_too(source: str) -> None:
    """numba freezes constants into the machine code."""
    known = {"companion." + each.replace("/", ".") for each in jit.SOURCES}
    file = Path(jit.__file__).parent / f"{source}.py"
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("companion"):
            constants = [each.name for each in node.names if each.name.lstrip("_").isupper()]
            assert not constants or node.module in known, constants
