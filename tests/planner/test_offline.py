"""A mission over terrain without MAVLink: legs, scans, stops and ends, and the way back."""

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise, zip_longest

import numpy as np
import pytest
from brute_force import fastest_m_s, violations
from hypothesis import given, settings
from hypothesis import strategies as st
from planning import TASK, TRUTH, ask, circle, fly, spline

from companion.mission.way_back import way_of
from companion.planner.backtrack import backtrack
from companion.planner.offline import OfflineFlight, usual_most_legs
from companion.planner.plan import plan
from companion.planner.procedure import Reference, advance, entering_m_s
from companion.planner.progress import NO_PROGRESS
from companion.planner.request import (
    Backtrack,
    FlownSegment,
    NotPlanned,
    PlanOutcome,
    PlanRequest,
    Refusal,
)
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


@pytest.fixture(scope="module")
def planner() -> Refusing:
    return Refusing()


@pytest.fixture(scope="module")
def flight(planner: Refusing) -> OfflineFlight:
    flight = fly(TASK, TRUTH, START, TARGET, seed=3, planner=planner)
    assert flight.failure is None
    return flight


def test_it_arrives_by_proven_legs_on_what_it_has_scanned_at_p_scan_each_from_p_prog(
    flight: OfflineFlight, planner: Refusing
) -> None:
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


def test_a_leg_is_flown_no_faster_than_its_plan_is_proven_for_and_takes_the_longer() -> None:
    took_s = []
    for share in (1.0, 0.5):
        slow_m_s = share * TASK.limits.speed_m_s
        flight = fly(TASK, TRUTH, START, TARGET, seed=3, most_legs=1,
            planner=lambda r, slow=slow_m_s: replace(plan(r), speed_m_s=slow))  # fmt: skip
        took_s.append(flight.seconds)
    assert took_s[1] > 1.5 * took_s[0]


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


# --- the way back is the way flown, proven again, and slow enough for its stops


def flown(flight: OfflineFlight) -> tuple[FlownSegment, ...]:
    return tuple(
        FlownSegment(control_nea_m=leg.subpath.control_nea_m, from_m=0.0, until_m=until_m)
        for leg, until_m in zip(flight.legs, flight.flown_m, strict=True)
    )


def test_it_leads_back_to_the_start_along_the_same_curve_in_safe_parts(
    flight: OfflineFlight,
) -> None:
    """Also for a vehicle that dies at full speed."""
    end = flight.legs[-1].subpath.pose(1e9).point_nea_m
    back = plan(ask(TASK, flight.known, end, plan_id=77, flown=flown(flight)))
    assert isinstance(back, Backtrack)
    steep = max(TASK.limits.climb_angle_rad, TASK.limits.dive_angle_rad)
    both = replace(TASK, limits=replace(TASK.limits, climb_angle_rad=steep, dive_angle_rad=steep))
    for subpath in back.subpaths:
        assert violations(subpath.control_nea_m, both, flight.known, from_rest=False) == []
    assert (back.reaches_start, back.plan_id) == (True, 77)
    assert back.through == (True,) * (len(back.subpaths) - 1) + (False,)
    control = [subpath.control_nea_m for subpath in back.subpaths]
    assert control[0][0] == pytest.approx(flight.legs[-1].subpath.control_nea_m[-1])
    assert control[-1][-1] == pytest.approx(np.array(START))
    length_m = sum(subpath.length_m for subpath in back.subpaths)
    assert length_m == pytest.approx(sum(flight.flown_m), rel=1e-5)
    there = flight.route_nea_m(2.0)
    for point in np.concatenate([spline(each)(np.linspace(0.0, 1.0, 20)) for each in control]):
        assert np.linalg.norm(there - point, axis=-1).min() < 2.0
    for before, after in pairwise(back.subpaths):
        end, start = before.pose(before.length_m), after.pose(0.0)
        assert end.position_nea_m == pytest.approx(start.position_nea_m, abs=1e-9)
        assert end.tangent_nea == pytest.approx(start.tangent_nea, abs=1e-5)
        assert end.curvature_nea_1_m == pytest.approx(start.curvature_nea_1_m, abs=1e-6)


def test_a_new_zone_on_the_way_ends_it_before_that(flight: OfflineFlight) -> None:
    north, east, _ = flight.legs[1].subpath.pose(200.0).point_nea_m
    zone = circle(north, east, 100.0)
    fenced = replace(TASK, zones=(*TASK.zones, zone))
    back, none = (backtrack(each, fenced, flight.known) for each in (flown(flight), ()))
    assert (none.subpaths, none.reaches_start) == ((), True)  # nothing was flown: it is at home
    assert not back.reaches_start
    assert back.subpaths
    for subpath in back.subpaths:
        points = spline(subpath.control_nea_m)(np.linspace(0.0, 1.0, 200))
        assert zone.distance_m(points[:, 0], points[:, 1]).min() >= TASK.required_clearance_m


@settings(max_examples=8)
@given(seed=st.integers(0, 10_000), tick_s=st.sampled_from([0.05, 0.1, 0.2]))
def test_along_straight_parts_with_corners_and_gaps_it_comes_to_no_end_faster_than_it_can_stop(
    seed: int, tick_s: float
) -> None:
    """Parts of 8 to 120 m at up to 15 m/s; between some a corner, or it was held 20 m aside."""
    rng, here, bearing_rad = np.random.default_rng(seed), np.array([1_500.0, 1_500.0, 500.0]), 0.3
    parts, corners = list[FlownSegment](), list[np.ndarray]()
    for _ in range(8):
        bearing_rad += rng.choice([0.0, 0.0, 1.5])
        ahead = np.array([math.cos(bearing_rad), math.sin(bearing_rad), 0.0])
        here = here + rng.choice([0.0, 0.0, 20.0]) * ahead[[1, 0, 2]]
        length_m, pieces = rng.uniform(8.0, 120.0), int(rng.integers(1, 5))
        begin_m, beyond_m = rng.choice([0.0, 30.0], 2)  # of what it was on, this was flown
        control = here + np.linspace(-begin_m, length_m + beyond_m, pieces + 3)[:, None] * ahead
        flown_m = {"from_m": begin_m, "until_m": begin_m + length_m}
        speed_m_s = rng.choice([None, 6.0])
        parts.append(FlownSegment(control_nea_m=control, speed_m_s=speed_m_s, **flown_m))
        corners += [here, here + length_m * ahead]
        here = corners[-1]
    back = backtrack(tuple(parts), TASK, TRUTH)
    assert back.reaches_start
    ends = [back.subpaths[0].control_nea_m[0], *(each.control_nea_m[-1] for each in back.subpaths)]
    for corner in corners:
        assert np.linalg.norm(np.array(ends) - corner, axis=1).min() < 1.0
    for through, (subpath, after) in zip(back.through, pairwise(back.subpaths), strict=False):
        assert (subpath.control_nea_m[-1] == after.control_nea_m[0]).all()
        turn = subpath.pose(subpath.length_m).tangent_nea @ after.pose(0.0).tangent_nea
        assert through == (turn > 1.0 - 1e-9)
    legs, reference = way_of(back, TASK), Reference()
    for leg, follows in zip_longest(legs, legs[1:]):
        length_m, left_m = leg.subpath.length_m, leg.subpath.length_m
        while left_m > (1e-6 if leg.through else 0.05):
            slows_to_m_s = math.inf
            if leg.through:
                slows_to_m_s = entering_m_s(follows, leg.motion, left_m)
            at_nea_m = leg.subpath.pose(reference.length_m).position_nea_m
            reference = advance(
                *(reference, leg, tick_s, at_nea_m), goes_on=leg.through, slows_to_m_s=slows_to_m_s
            )
            if not leg.through:
                [most_m_s] = fastest_m_s(leg.motion, np.array([left_m]))
                assert reference.speed_m_s <= most_m_s + leg.motion.gaining_m_s2 * tick_s + 1e-6
            left_m = length_m - reference.length_m
        assert leg.through or reference.speed_m_s < 0.5
        reference = Reference(speed_m_s=reference.speed_m_s if leg.through else 0.0)


@pytest.mark.parametrize(("above_m", "parts"), [(0.001, 1), (-0.001, 0), (-0.7, 0)])
def test_what_begins_below_what_is_asked_above_the_floor_is_not_proven_though_it_was_flown(
    above_m: float, parts: int
) -> None:
    low_m = TASK.limits.floor_amsl_m + TASK.error_m + above_m
    control = np.linspace((1_000.0, 600.0, low_m), (1_600.0, 600.0, low_m + 20.0), 4)
    stretch = FlownSegment(control_nea_m=control, from_m=0.0, until_m=600.0)
    back = backtrack((stretch,), TASK, TRUTH)
    assert (len(back.subpaths), back.reaches_start) == (parts, bool(parts))
