"""The way back is the way flown, proven again, and slow enough for its stops."""

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
    zone = CircleZone(name="new", north_m=north, east_m=east, radius_m=100.0)
    fenced = replace(TASK, zones=(*TASK.zones, zone))
    back, none = (backtrack(each, fenced, flight.known) for each in (flown(flight), ()))
    assert (none.subpaths, none.reaches_start) == ((), True)  # nothing was flown: it is at home
    assert not back.reaches_start
    assert back.subpaths
    for subpath in back.subpaths:
        points = spline(subpath.control_nea_m)(np.linspace(0.0, 1.0, 200))
        assert zone.distance_m(points[:, 0], points[:, 1]).min() >= TASK.required_clearance_m


@settings(max_examples=15)
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
