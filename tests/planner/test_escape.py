import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from companion.planner.plan import plan
from companion.planner.procedure import hover_pose
from companion.planner.request import NotPlanned, Planned, PlanRequest, Refusal
from companion.planner.settings import Task
from companion.world.known_map import KnownMap

sys.path.insert(0, str(Path(__file__).parent))
from dense_check import column_distance_m, keep_out_distance_m, spline, violations

REQUIRED_M = 70.0  # d_s 60 m, tracking 5 m, navigation 5 m


def ask(task: Task, known: KnownMap, start: tuple[float, float, float]) -> PlanRequest:
    return PlanRequest(
        plan_id=1,
        seed=7,
        task=task,
        known=known,
        scan_nea_m=start,
        start=hover_pose(start),
        from_rest=True,
        target_ne_m=(7_500.0, 7_500.0),
    )


def escaped(task: Task, known: KnownMap, start: tuple[float, float, float]) -> Planned:
    outcome = plan(ask(task, known, start))
    assert isinstance(outcome, Planned)
    assert outcome.certificate.proven
    assert not outcome.reaches_target
    assert outcome.subpath.control_nea_m[0] == pytest.approx(start)
    return outcome


# The circle is at 2300, 4300 with a radius of 350 m, the square from 5000 to 5400 both ways.
INSIDE = [(2_300.0, 4_300.0), (2_300.0, 4_600.0), (2_100.0, 4_100.0), (5_200.0, 5_050.0)]


@pytest.mark.parametrize("start_ne_m", [*INSIDE, (2_300.0, 4_700.0)], ids=str)
def test_the_way_out_of_a_keep_out_is_straight_and_little_longer_than_it_must_be(
    task: Task, truth: KnownMap, start_ne_m: tuple[float, float]
) -> None:
    outcome = escaped(task, truth, (*start_ne_m, 600.0))
    control = outcome.subpath.control_nea_m
    for zone in task.keep_outs:
        assert keep_out_distance_m(zone, control[-1:])[0] >= REQUIRED_M
    legs = np.diff(control, axis=0)
    assert legs / np.linalg.norm(legs, axis=-1)[:, None] == pytest.approx(
        np.tile(outcome.subpath.pose(0.0).tangent_nea, (3, 1)), abs=1e-6
    )
    n, e = start_ne_m
    if n < 4_000.0:
        shortest = 350.0 + REQUIRED_M - math.dist(start_ne_m, (2_300.0, 4_300.0))
    else:
        shortest = min(n - 5_000, 5_400 - n, e - 5_000, 5_400 - e) + REQUIRED_M
    step_m = 0.4 * 2_000.0 / 24.0
    assert shortest - 1e-6 <= outcome.subpath.length_m <= 1.05 * shortest + step_m


@pytest.mark.parametrize("bearing_deg", [0, 70, 200])
@pytest.mark.parametrize("now_m", [3.0, 30.0, 65.0])
def test_the_way_out_from_beside_a_slope_comes_no_nearer_and_ends_clear(
    task: Task, truth: KnownMap, bearing_deg: int, now_m: float
) -> None:
    far, turn = np.arange(0.0, 900.0), math.radians(bearing_deg)  # from the peak of the hill
    line = np.array([3_000.0, 2_600.0, 450.0]) + far[:, None] * [math.cos(turn), math.sin(turn), 0]
    away = column_distance_m(truth, line, 200.0)
    start = tuple(float(v) for v in line[np.flatnonzero(away >= now_m)[0]])
    now = away[np.flatnonzero(away >= now_m)[0]]
    assert now < REQUIRED_M
    outcome = escaped(task, truth, start)
    points = spline(outcome.subpath.control_nea_m)(np.linspace(0.0, 1.0, 500))
    away = column_distance_m(truth, points, 200.0)
    assert away.min() >= now - 1.0
    assert away[-1] >= REQUIRED_M


def test_from_the_end_of_a_way_out_a_plan_begins(task: Task, truth: KnownMap) -> None:
    outcome = escaped(task, truth, (2_300.0, 4_600.0, 600.0))
    end = outcome.subpath.pose(outcome.subpath.length_m).point_nea_m
    after = plan(ask(task, truth, end))
    assert isinstance(after, Planned)
    assert after.evaluations > 0
    assert violations(after.subpath.control_nea_m, task, truth, from_rest=True) == []


def test_where_there_is_no_way_out_the_reason_is_what_is_around(
    task: Task, blank: KnownMap
) -> None:
    pit = replace(blank, upper_m=np.full_like(blank.upper_m, 5_000.0), seen=~blank.seen)
    pit.upper_m[40:42, 40:42] = 100.0
    pit.upper_m[290:310, 290:310] = 100.0  # where the target is
    outcome = plan(ask(task, pit, (1_025.0, 1_025.0, 450.0)))
    assert isinstance(outcome, NotPlanned)
    assert outcome.refusal is Refusal.START_NEAR_TERRAIN
