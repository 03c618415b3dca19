"""A mission over terrain without MAVLink: legs, scans, stops and ends."""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from brute_force import violations
from planning import TASK, TRUTH, fly

from companion.planner.offline import usual_most_legs
from companion.planner.plan import plan
from companion.planner.progress import NO_PROGRESS
from companion.planner.request import NotPlanned, PlanOutcome, PlanRequest, Refusal
from companion.world.zones import PolygonZone

START = (800.0, 800.0, 450.0)
TARGET = (7_200.0, 7_000.0)


class Refusing:
    """The planner itself, but for some of the requests; remembers them all."""

    def __init__(self, *numbers: int) -> None:
        self.numbers, self.requests = numbers, list[PlanRequest]()

    def __call__(self, request: PlanRequest) -> PlanOutcome:
        self.requests.append(request)
        if len(self.requests) in self.numbers:
            return NotPlanned(plan_id=request.plan_id, refusal=Refusal.NOTHING_SAFE, broken=("x",))
        return plan(request)

    def told(self, what: str, count: int) -> list[object]:
        return [getattr(request, what) for request in self.requests[:count]]


AREA = ((200.0, 200.0), (200.0, 7_800.0), (7_800.0, 7_800.0), (7_800.0, 200.0))
PLANE = replace(
    TASK,
    limits=replace(TASK.limits, loiter_radius_m=80.0, turn_radius_m=110.0),
    zones=(TASK.zones[0], PolygonZone(name="area", vertices_ne_m=AREA, keep_in=True)),
)


def test_it_arrives_by_proven_legs_on_what_it_has_scanned_at_p_scan_each_from_p_prog() -> None:
    planner = Refusing()
    flight = fly(TASK, TRUTH, START, TARGET, seed=3, planner=planner)
    assert flight.failure is None
    assert [leg.reaches_target for leg in flight.legs] == [False] * (len(flight.legs) - 1) + [True]
    assert flight.legs[-1].subpath.control_nea_m[-1, :2] == pytest.approx(TARGET)
    assert len(flight.plans) == len(flight.scans_nea_m) == len(flight.legs) >= 4
    assert len(flight.legs) < usual_most_legs(TASK, START, (TARGET,))
    assert sum(flight.flown_m) < 1.3 * math.dist(START[:2], TARGET)
    for k, (leg, planned) in enumerate(zip(flight.legs, flight.plans, strict=True)):
        assert (leg.number, planned.certificate.proven) == (k + 1, True)
        assert violations(leg.subpath.control_nea_m, TASK, TRUTH, from_rest=k == 0) == []
    assert flight.scans_nea_m[0] == START
    assert flight.flown_m[-1] == flight.legs[-1].subpath.length_m
    assert planner.told("plan_id", 99) == [*range(1, len(flight.legs) + 1)]
    legs = zip(flight.legs, flight.flown_m, planner.requests[1:], strict=False)
    for k, (leg, flown_m, request) in enumerate(legs, 1):
        length_m, there = leg.subpath.length_m, leg.subpath.pose(flown_m)
        assert length_m - flown_m == pytest.approx(TASK.tail_m)
        scan = leg.subpath.pose(max(length_m - TASK.scan_distance_m, 0.0)).point_nea_m
        assert flight.scans_nea_m[k] == request.scan_nea_m == pytest.approx(scan)
        assert there.position_nea_m == pytest.approx(flight.legs[k].subpath.control_nea_m[0])
        np.testing.assert_array_equal(request.start.tangent_nea, there.tangent_nea)
        np.testing.assert_array_equal(request.start.curvature_nea_1_m, there.curvature_nea_1_m)
    known = flight.known
    assert (known.upper_m[known.seen] == TRUTH.upper_m[known.seen]).all()
    north, east = known.middles_m()
    nearest = np.min([np.hypot(north - n, east - e) for n, e, _ in flight.scans_nea_m], axis=0)
    assert np.isposinf(known.upper_m[nearest > TASK.settings.scan_range_m]).all()


def test_a_plane_arrives_and_may_circle_anywhere_on_its_way() -> None:
    flight = fly(PLANE, TRUTH, START, TARGET, seed=3)
    assert flight.failure is None
    assert flight.legs[-1].reaches_target
    for leg in flight.legs:
        assert violations(leg.subpath.control_nea_m, PLANE, TRUTH, from_rest=False) == []


# --- when there is no plan


@pytest.mark.parametrize(("refused", "attempts", "from_rest"), [
    (range(1, 100), [0, 1, 2, 3], [True] * 4),
    # twice from the start; in flight, which ends it in a hover; twice from there
    ((1, 2, 4, 5, 6), [0, 1, 2, 0, 0, 1, 2], [True, True, True, False, True, True, True]),
])  # fmt: skip
def test_at_rest_it_asks_four_times_each_wider_and_a_leg_without_a_successor_is_flown_to_its_end(
    refused: Iterable[int], attempts: list[int], from_rest: list[bool]
) -> None:
    planner = Refusing(*refused)
    flight = fly(TASK, TRUTH, START, TARGET, seed=3, planner=planner)
    assert (planner.told("attempt", 7), planner.told("from_rest", 7)) == (attempts, from_rest)
    assert len({*planner.told("plan_id", 7)}) == len(attempts)
    if flight.failure is not None:
        assert flight.failure.broken == ("x",)
        assert flight.legs == flight.plans == flight.flown_m == []
        assert flight.scans_nea_m == [START] * len(attempts)
        return
    assert flight.legs[-1].reaches_target
    assert flight.holds >= 1
    held = flight.legs[0].subpath
    end = held.pose(held.length_m).point_nea_m
    assert flight.flown_m[0] == held.length_m
    assert planner.requests[4].scan_nea_m == end
    assert flight.legs[1].subpath.control_nea_m[0] == pytest.approx(np.array(end))


def test_a_flight_that_runs_out_of_legs_stops_and_says_so_and_how_to_go_on() -> None:
    cut = fly(TASK, TRUTH, START, TARGET, seed=3, most_legs=2)
    assert cut.failure is not None
    assert cut.failure.refusal is Refusal.TOO_MANY_LEGS
    assert "most_legs" in cut.failure.refusal.value
    assert (len(cut.legs), len(cut.scans_nea_m), cut.holds) == (2, 2, 1)
    assert cut.flown_m[-1] == pytest.approx(cut.legs[1].subpath.length_m)


def test_targets_are_reached_in_their_order_with_a_stop_at_each() -> None:
    targets, planner = ((2_500.0, 2_000.0), (1_000.0, 3_500.0), (1_000.0, 3_400.0)), Refusing()
    flight = fly(TASK, TRUTH, START, *targets, seed=3, planner=planner)
    ends = [leg.subpath.control_nea_m[-1, :2] for leg in flight.legs if leg.reaches_target]
    np.testing.assert_allclose(ends, targets, atol=1e-6)
    reached, stands = 0, True
    for request, leg, flown_m in zip(planner.requests, flight.legs, flight.flown_m, strict=True):
        assert (request.target_ne_m, request.from_rest) == (targets[reached], stands)
        if stands:  # what was true of the way to the target before is no more
            assert request.progress == NO_PROGRESS
        reached, stands = reached + leg.reaches_target, leg.reaches_target
        assert flown_m == leg.subpath.length_m or not stands
    assert flight.holds == 0
