import math
from dataclasses import replace
from itertools import pairwise, zip_longest

import numpy as np
import pytest
from brute_force import fastest_m_s, violations
from hypothesis import given, settings
from hypothesis import strategies as st
from planning import TASK, TRUTH, ask, fly, spline

from companion.mission.way_back import way_of
from companion.planner.backtrack import backtrack
from companion.planner.offline import OfflineFlight
from companion.planner.plan import plan
from companion.planner.procedure import Reference, advance, entering_m_s
from companion.planner.request import Backtrack, FlownSegment
from companion.world.zones import CircleZone

START, TARGET = (1_000.0, 1_200.0, 500.0), (4_800.0, 2_600.0)


@pytest.fixture(scope="module")
def flight() -> OfflineFlight:
    flight = fly(TASK, TRUTH, START, TARGET, seed=3)
    assert flight.failure is None
    assert len(flight.legs) >= 3
    return flight


def flown(flight: OfflineFlight) -> tuple[FlownSegment, ...]:
    return tuple(
        FlownSegment(control_nea_m=leg.subpath.control_nea_m, from_m=0.0, until_m=until_m)
        for leg, until_m in zip(flight.legs, flight.flown_m, strict=True)
    )


@pytest.fixture(scope="module")
def back(flight: OfflineFlight) -> Backtrack:
    """As the planner answers it."""
    end = flight.legs[-1].subpath.pose(1e9).point_nea_m
    outcome = plan(ask(TASK, flight.known, end, plan_id=77, flown=flown(flight)))
    assert isinstance(outcome, Backtrack)
    return outcome


def test_it_leads_back_to_the_start_along_the_same_curve(
    back: Backtrack, flight: OfflineFlight
) -> None:
    """Every part of it is safe, also for a vehicle that dies at full speed."""
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
    zone = CircleZone(name="new", north_m=north, east_m=east, radius_m=100.0)
    fenced = replace(TASK, zones=(*TASK.zones, zone))
    back, none = (backtrack(each, fenced, flight.known) for each in (flown(flight), ()))
    assert (none.subpaths, none.reaches_start) == ((), True)  # nothing was flown: it is at home
    assert not back.reaches_start
    assert back.subpaths
    for subpath in back.subpaths:
        points = spline(subpath.control_nea_m)(np.linspace(0.0, 1.0, 200))
        assert zone.distance_m(points[:, 0], points[:, 1]).min() >= TASK.required_clearance_m


def test_a_part_of_a_leg_and_a_corner_and_a_gap_are_joined() -> None:
    def line(*ends: tuple[float, float, float]) -> np.ndarray:
        return np.linspace(*ends, 5)

    first = line((1_000.0, 1_000.0, 500.0), (2_000.0, 1_000.0, 500.0))
    second = line((1_700.0, 1_000.02, 500.0), (1_700.0, 2_000.0, 500.0))  # about where it stopped
    third = line((1_700.0, 1_420.0, 500.0), (1_000.0, 1_420.0, 500.0))  # it was held 20 m aside
    parts = (
        FlownSegment(control_nea_m=first, from_m=100.0, until_m=700.0),
        FlownSegment(control_nea_m=second, from_m=0.0, until_m=400.0),
        FlownSegment(control_nea_m=third, from_m=0.0, until_m=300.0),
    )
    back = backtrack(parts, TASK, TRUTH)
    assert back.reaches_start
    ends = [subpath.control_nea_m[-1].tolist() for subpath in back.subpaths]
    corners = [(1_700.0, 1_420.0), (1_700.0, 1_400.0), (1_700.0, 1_000.0), (1_100.0, 1_000.0)]
    assert back.subpaths[0].control_nea_m[0] == pytest.approx([1_400.0, 1_420.0, 500.0], abs=0.5)
    for corner in corners:
        assert min(math.dist(end[:2], corner) for end in ends) < 1.0
    for through, (subpath, after) in zip(back.through, pairwise(back.subpaths), strict=False):
        assert (subpath.control_nea_m[-1] == after.control_nea_m[0]).all()
        turn = subpath.pose(subpath.length_m).tangent_nea @ after.pose(0.0).tangent_nea
        assert through == (turn > 0.99)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), tick_s=st.sampled_from([0.05, 0.1, 0.2]))
def test_it_comes_to_no_end_faster_than_it_can_stop_there_however_short_its_legs_are(
    seed: int, tick_s: float
) -> None:
    """Of straight legs, flown in pieces of 2 to 40 m at up to 15 m/s, with corners between some."""
    rng, here, bearing_rad = np.random.default_rng(seed), np.array([1_500.0, 1_500.0, 500.0]), 0.3
    parts = list[FlownSegment]()
    for _ in range(8):
        bearing_rad += rng.choice([0.0, 0.0, 1.5])
        length_m, pieces = rng.uniform(8.0, 120.0), int(rng.integers(1, 5))
        ahead = np.array([math.cos(bearing_rad), math.sin(bearing_rad), 0.0])
        control = here + np.linspace(0.0, length_m, pieces + 3)[:, None] * ahead
        speed_m_s = rng.choice([None, 6.0])
        parts.append(
            FlownSegment(control_nea_m=control, from_m=0.0, until_m=length_m, speed_m_s=speed_m_s)
        )
        here = control[-1]
    back = backtrack(tuple(parts), TASK, TRUTH)
    assert back.reaches_start
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
