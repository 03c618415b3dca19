import math
from dataclasses import replace

import numpy as np
import pytest

from companion.planner.offline import OfflineFlight, fly_offline
from companion.planner.plan import plan
from companion.planner.request import NotPlanned, Planned, PlanOutcome, PlanRequest, Refusal
from companion.planner.settings import Task
from companion.world.known_map import KnownMap
from companion.world.terrain import PeakTerrain

START = (800.0, 800.0, 450.0)
TARGET = (7_200.0, 7_000.0)


@pytest.fixture(scope="module")
def flight(task: Task, blank: KnownMap, truth: KnownMap) -> OfflineFlight:
    return fly_offline(
        task, blank=blank, truth=truth, start_nea_m=START, targets_ne_m=(TARGET,), seed=3
    )


def flown(flight: OfflineFlight, task: Task) -> np.ndarray:
    """Points of the whole path, 5 m apart, each leg up to where the next one takes over."""
    points = []
    for leg in flight.legs:
        last = leg.subpath.length_m if leg is flight.legs[-1] else leg.successor_at_m(task)
        points += [leg.subpath.pose(at).position_nea_m for at in np.arange(0.0, last, 5.0)]
    return np.array(points)


def test_the_flight_arrives_at_the_target(flight: OfflineFlight) -> None:
    assert flight.failure is None
    assert flight.legs[-1].reaches_target
    assert flight.legs[-1].subpath.control_nea_m[-1, :2] == pytest.approx(TARGET)
    assert [leg.number for leg in flight.legs] == list(range(1, len(flight.legs) + 1))
    assert not any(leg.reaches_target for leg in flight.legs[:-1])
    assert len(flight.plans) == len(flight.scans_nea_m) == len(flight.legs) >= 4


def test_position_and_tangent_go_on_from_leg_to_leg(flight: OfflineFlight, task: Task) -> None:
    assert flight.legs[0].subpath.pose(0.0).position_nea_m == pytest.approx(START)
    for leg, after in zip(flight.legs, flight.legs[1:], strict=False):
        here = leg.subpath.pose(leg.successor_at_m(task))
        there = after.subpath.pose(0.0)
        assert there.position_nea_m == pytest.approx(here.position_nea_m)
        assert there.tangent_nea == pytest.approx(here.tangent_nea, abs=1e-9)


def test_scans_are_made_at_p_scan_of_each_leg(flight: OfflineFlight, task: Task) -> None:
    assert flight.scans_nea_m[0] == START
    for leg, scan in zip(flight.legs, flight.scans_nea_m[1:], strict=False):
        before_the_end = leg.subpath.length_m - task.scan_distance_m
        expected = leg.subpath.pose(max(before_the_end, 0.0)).position_nea_m
        assert scan == pytest.approx(tuple(expected))


def test_the_whole_flight_keeps_the_safety_distance_to_the_true_terrain(
    flight: OfflineFlight, task: Task, terrain: PeakTerrain
) -> None:
    points = flown(flight, task)
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


def test_the_map_that_the_flight_began_with_is_left_as_it_was(
    flight: OfflineFlight, blank: KnownMap
) -> None:
    assert flight.known is not blank
    assert np.isposinf(blank.upper_m).all()
    assert not blank.seen.any()


def test_the_same_seed_flies_the_same_path(
    task: Task, blank: KnownMap, truth: KnownMap, flight: OfflineFlight
) -> None:
    again = fly_offline(
        task, blank=blank, truth=truth, start_nea_m=START, targets_ne_m=(TARGET,), seed=3
    )
    for a, b in zip(flight.legs, again.legs, strict=True):
        assert a.subpath.control_nea_m.tobytes() == b.subpath.control_nea_m.tobytes()


def test_a_flight_without_a_plan_ends_with_the_reason(
    task: Task, blank: KnownMap, truth: KnownMap
) -> None:
    def refuses(request: PlanRequest) -> NotPlanned:
        return NotPlanned(
            plan_id=request.plan_id, refusal=Refusal.NOTHING_SAFE, broken=("x",), evaluations=1
        )

    flight = fly_offline(
        task,
        blank=blank,
        truth=truth,
        start_nea_m=START,
        targets_ne_m=(TARGET,),
        seed=3,
        planner=refuses,
    )
    assert flight.failure is not None
    assert flight.legs == flight.plans == ()
    assert flight.scans_nea_m == (START,)


def test_the_flight_goes_round_the_radar(flight: OfflineFlight, task: Task) -> None:
    points, radar = flown(flight, task), task.radars[0]
    straight = np.linspace(START[:2], TARGET, 500)
    crossed = np.hypot(*(straight - radar.centre_nea_m[:2]).T) < radar.range_m
    assert math.dist(START[:2], TARGET) < 5.0 * len(points) < 1.3 * math.dist(START[:2], TARGET)
    inside = radar.distance_m(points) <= radar.range_m
    assert inside.mean() <= crossed.mean()


def test_a_flight_begins_anew_from_where_the_task_changes(
    task: Task, blank: KnownMap, truth: KnownMap
) -> None:
    without = replace(task, radars=())
    near = (START[0] + 900.0, START[1] + 500.0)
    flight = fly_offline(
        without, blank=blank, truth=truth, start_nea_m=START, targets_ne_m=(near,), seed=3
    )
    assert len(flight.legs) == 1
    assert flight.legs[0].reaches_target


def test_targets_are_reached_in_their_order_with_a_stop_at_each(
    task: Task, blank: KnownMap, truth: KnownMap
) -> None:
    targets = (TARGET, (6_000.0, 2_000.0))
    flight = fly_offline(
        task, blank=blank, truth=truth, start_nea_m=START, targets_ne_m=targets, seed=3
    )
    ends = [leg.subpath.control_nea_m[-1, :2] for leg in flight.legs if leg.reaches_target]
    np.testing.assert_allclose(ends, targets, atol=1e-6)
