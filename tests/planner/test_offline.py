import math
from dataclasses import replace

import numpy as np
import pytest
from brute_force import violations
from planning import fly

from companion.planner.offline import OfflineFlight, usual_most_legs
from companion.planner.plan import plan
from companion.planner.request import NotPlanned, Planned, PlanOutcome, PlanRequest, Refusal
from companion.planner.settings import Task
from companion.planning import OURS, planner_of
from companion.world.known_map import KnownMap
from companion.world.radars import Radar
from companion.world.terrain import PeakTerrain

START = (800.0, 800.0, 450.0)
TARGET = (7_200.0, 7_000.0)


class Refusing:
    """The planner itself, but for some of the requests; remembers them all."""

    def __init__(self, *numbers: int) -> None:
        self.numbers = numbers
        self.requests: list[PlanRequest] = []
        self.outcomes: list[PlanOutcome] = []

    def __call__(self, request: PlanRequest) -> PlanOutcome:
        self.requests.append(request)
        if len(self.requests) in self.numbers:
            outcome: PlanOutcome = NotPlanned(
                plan_id=request.plan_id, refusal=Refusal.NOTHING_SAFE, broken=("x",)
            )
        else:
            outcome = plan(request)
        self.outcomes.append(outcome)
        return outcome


@pytest.fixture(scope="module")
def planner() -> Refusing:
    return Refusing()


@pytest.fixture(scope="module")
def flight(task: Task, truth: KnownMap, planner: Refusing) -> OfflineFlight:
    return fly(task, truth, START, TARGET, seed=3, planner=planner)


def test_the_flight_arrives_at_the_target(flight: OfflineFlight) -> None:
    assert flight.failure is None
    assert flight.legs[-1].reaches_target
    assert flight.legs[-1].subpath.control_nea_m[-1, :2] == pytest.approx(TARGET)
    assert [leg.number for leg in flight.legs] == list(range(1, len(flight.legs) + 1))
    assert not any(leg.reaches_target for leg in flight.legs[:-1])
    assert len(flight.plans) == len(flight.scans_nea_m) == len(flight.legs) >= 4


def test_a_target_in_the_middle_of_a_radar_is_flown_to(task: Task, truth: KnownMap) -> None:
    target = (1_200.0, 3_000.0)
    watched = Radar(name="r", centre_nea_m=(*target, 0.0), range_m=1_200.0)
    among = replace(task, radars=(watched,))
    flight = fly(among, truth, START, target, seed=3)
    assert flight.failure is None
    assert sum(flight.flown_m) < 2.0 * math.dist(START[:2], target)


def test_each_leg_is_flown_to_where_the_next_one_begins(
    flight: OfflineFlight, task: Task, planner: Refusing
) -> None:
    assert len(flight.flown_m) == len(flight.legs)
    for leg, flown_m, after in zip(flight.legs, flight.flown_m, flight.legs[1:], strict=False):
        there = leg.subpath.pose(flown_m).position_nea_m
        assert there == pytest.approx(after.subpath.control_nea_m[0])
        assert leg.subpath.length_m - flown_m == pytest.approx(task.tail_m)
    assert flight.flown_m[-1] == flight.legs[-1].subpath.length_m
    for leg, flown_m, request in zip(
        flight.legs, flight.flown_m, planner.requests[1:], strict=False
    ):  # the plan goes on with tangent and curvature: tests/objective/test_flight.py
        there = leg.subpath.pose(flown_m)
        np.testing.assert_array_equal(request.start.tangent_nea, there.tangent_nea)
        np.testing.assert_array_equal(request.start.curvature_nea_1_m, there.curvature_nea_1_m)


def test_every_leg_is_proven_and_passes_a_check_of_every_metre_against_the_truth(
    flight: OfflineFlight, task: Task, truth: KnownMap
) -> None:
    for number, (leg, planned) in enumerate(zip(flight.legs, flight.plans, strict=True)):
        assert planned.certificate.proven
        control = leg.subpath.control_nea_m
        assert violations(control, task, truth, from_rest=number == 0) == []


def test_each_plan_knows_the_route_that_the_last_one_had_in_mind(planner: Refusing) -> None:
    assert planner.requests[0].route_ne_m == ()
    for outcome, request in zip(planner.outcomes, planner.requests[1:], strict=False):
        assert isinstance(outcome, Planned)
        assert request.route_ne_m == outcome.route_ne_m
        assert request.plan_id == outcome.plan_id + 1


def test_scans_are_made_at_p_scan_of_each_leg(flight: OfflineFlight, task: Task) -> None:
    assert flight.scans_nea_m[0] == START
    for leg, scan in zip(flight.legs, flight.scans_nea_m[1:], strict=False):
        before_the_end = leg.subpath.length_m - task.scan_distance_m
        expected = leg.subpath.pose(max(before_the_end, 0.0)).position_nea_m
        assert scan == pytest.approx(tuple(expected))


def test_the_whole_flight_keeps_the_safety_distance_to_the_true_terrain(
    flight: OfflineFlight, task: Task, terrain: PeakTerrain
) -> None:
    points = flight.route_nea_m(5.0)
    around = np.arange(-72.0, 73.0, 8.0)
    n = points[:, 0, None, None] + around[:, None]
    e = points[:, 1, None, None] + around[None, :]
    down = np.maximum(points[:, 2, None, None] - terrain.height_m(n, e), 0.0)
    distance = np.sqrt((around[:, None] ** 2 + around[None, :] ** 2 + down**2).min(axis=(1, 2)))
    assert distance.min() >= task.settings.safety_distance_m


def test_it_plans_on_what_its_scans_have_shown_only(
    flight: OfflineFlight, task: Task, truth: KnownMap
) -> None:
    known = flight.known
    assert (known.upper_m[known.seen] == truth.upper_m[known.seen]).all()
    north, east = known.middles_m(0, 0, (known.upper_m.shape[0], known.upper_m.shape[1]))
    nearest = np.min([np.hypot(north - n, east - e) for n, e, _ in flight.scans_nea_m], axis=0)
    assert not known.seen[nearest > task.settings.scan_range_m].any()
    assert np.isposinf(known.upper_m[nearest > task.settings.scan_range_m]).all()


# --- when there is no plan


def test_a_flight_that_finds_no_way_gives_up_after_four_attempts_each_wider(
    task: Task, truth: KnownMap
) -> None:
    planner = Refusing(*range(1, 100))
    flight = fly(task, truth, START, TARGET, seed=3, planner=planner)
    assert flight.failure is planner.outcomes[-1]
    assert flight.legs == flight.plans == flight.flown_m == []
    assert flight.scans_nea_m == [START] * 4
    assert [request.attempt for request in planner.requests] == [0, 1, 2, 3]
    assert len({request.plan_id for request in planner.requests}) == 4


def test_a_flight_that_runs_out_of_legs_says_so_and_how_to_go_on(
    task: Task, truth: KnownMap, flight: OfflineFlight
) -> None:
    cut = fly(task, truth, START, TARGET, seed=3, planner=planner_of(OURS), most_legs=2)
    assert cut.failure is not None
    assert cut.failure.refusal is Refusal.TOO_MANY_LEGS
    assert "most_legs" in cut.failure.refusal.value
    assert len(cut.legs) == 2
    assert np.array_equal(cut.legs[1].subpath.control_nea_m, flight.legs[1].subpath.control_nea_m)
    assert len(flight.legs) < usual_most_legs(task, START, (TARGET,))
    far = ((TARGET[0] + 1e6, TARGET[1]), TARGET)
    assert usual_most_legs(task, START, far) > 2e6 / task.settings.scan_range_m


def test_a_leg_without_a_successor_is_flown_to_its_end_and_the_flight_goes_on_from_there(
    task: Task, truth: KnownMap
) -> None:
    planner = Refusing(3)
    flight = fly(task, truth, START, TARGET, seed=3, planner=planner)
    assert flight.failure is None
    assert flight.legs[-1].reaches_target
    assert flight.holds == 1
    held = flight.legs[1].subpath
    assert flight.flown_m[1] == held.length_m
    assert flight.flown_m[0] < flight.legs[0].subpath.length_m
    end = held.pose(held.length_m).position_nea_m
    assert flight.legs[2].subpath.control_nea_m[0] == pytest.approx(end)
    anew = planner.requests[3]
    assert anew.from_rest
    assert anew.attempt == 0
    assert anew.scan_nea_m == pytest.approx(tuple(end))
    assert not planner.requests[2].from_rest
    assert not planner.requests[4].from_rest


def test_attempts_are_counted_anew_once_a_plan_is_found(task: Task, truth: KnownMap) -> None:
    planner = Refusing(1, 2, 4, 5, 6)
    flight = fly(task, truth, START, TARGET, seed=3, planner=planner)
    assert flight.legs[-1].reaches_target
    # twice from the start; in flight, which ends it in a hover; twice from there
    assert [request.attempt for request in planner.requests[:7]] == [0, 1, 2, 0, 0, 1, 2]
    assert [request.from_rest for request in planner.requests[:7]] == [True] * 3 + [False] + [
        True
    ] * 3
    assert flight.holds >= 1


def test_the_flight_goes_round_the_radar(flight: OfflineFlight, task: Task) -> None:
    points, radar = flight.route_nea_m(5.0), task.radars[0]
    straight = np.linspace(START[:2], TARGET, 500)
    crossed = np.hypot(*(straight - radar.centre_nea_m[:2]).T) < radar.range_m
    assert math.dist(START[:2], TARGET) < 5.0 * len(points) < 1.3 * math.dist(START[:2], TARGET)
    inside = radar.distance_m(points) <= radar.range_m
    assert inside.mean() <= crossed.mean()


def test_targets_are_reached_in_their_order_with_a_stop_at_each(
    task: Task, truth: KnownMap
) -> None:
    targets, planner = ((2_500.0, 2_000.0), (1_000.0, 3_500.0), (1_000.0, 3_400.0)), Refusing()
    flight = fly(task, truth, START, *targets, seed=3, planner=planner)
    ends = [leg.subpath.control_nea_m[-1, :2] for leg in flight.legs if leg.reaches_target]
    np.testing.assert_allclose(ends, targets, atol=1e-6)
    reached = 0
    for request, leg in zip(planner.requests, flight.legs, strict=True):
        assert request.target_ne_m == targets[reached]
        reached += leg.reaches_target
    from_rest = [request.from_rest for request in planner.requests]
    assert from_rest == [True, *(leg.reaches_target for leg in flight.legs[:-1])]
    for (leg, flown_m), after in zip(
        zip(flight.legs, flight.flown_m, strict=True), flight.legs[1:], strict=False
    ):
        if leg.reaches_target:
            assert flown_m == leg.subpath.length_m
            end = leg.subpath.pose(flown_m).position_nea_m
            assert after.subpath.control_nea_m[0] == pytest.approx(end)
