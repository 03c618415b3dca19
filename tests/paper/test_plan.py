"""One plan by profile `paper`."""

import math
from dataclasses import replace

import numpy as np
import pytest
from planning import ask, limits

from companion.paper.guide import tangent_guide_rad
from companion.planner.procedure import hover_pose
from companion.planner.request import Planned
from companion.planner.settings import PlannerSettings, Task
from companion.planning import plan
from companion.profiles import PAPER
from companion.world.known_map import KnownMap, empty_map
from companion.world.radars import Radar
from companion.world.simulated_scan import true_map
from companion.world.terrain import Peak, PeakTerrain

START = (1_000.0, 1_000.0, 450.0)
TASK = Task(
    limits=limits(),
    settings=PlannerSettings(
        scan_range_m=2_000.0,
        safety_distance_m=60.0,
        planning_time_s=2.0,
        overlap_m=200.0,
        evaluations=400,
        profile=PAPER,
    ),
    radars=(Radar(name="r", centre_nea_m=(6_500.0, 3_300.0, 0.0), range_m=900.0),),
)
BLANK = empty_map(TASK.cell_m, TASK.limits.north_m, TASK.limits.east_m)
HILL = Peak(
    north_m=3e3, east_m=2.6e3, height_amsl_m=900.0, spread_north_m=500.0, spread_east_m=400.0
)
TRUTH = true_map(PeakTerrain(peaks=(HILL,), ground_amsl_m=100.0), BLANK)


def planned(known: KnownMap = TRUTH, **changes: object) -> Planned:
    outcome = plan(ask(TASK, known, START, **changes))
    assert isinstance(outcome, Planned)
    return outcome


def test_the_best_of_one_search_is_taken_as_it_is() -> None:
    outcome = planned()
    assert (outcome.tries, outcome.rank, outcome.evaluations) == (1, 0, 400)
    assert outcome.subpath.control_nea_m.shape == (4, 3)
    weights = {"length": 0.1, "height": 0.15, "guide": 0.15, "crash": 0.3, "radar": 0.3}
    weights["constraints"] = 1.0
    assert outcome.terms.keys() == weights.keys()
    assert outcome.cost == pytest.approx(sum(a * outcome.terms[f] for f, a in weights.items()))


def test_it_ends_at_the_range_of_the_scan_or_at_a_target_within_it() -> None:
    far = planned()
    assert not far.reaches_target
    assert math.dist(far.subpath.control_nea_m[-1, :2], START[:2]) == pytest.approx(2_000.0)
    target = (START[0] + 1_100.0, START[1] + 1_600.0)
    near = planned(target_ne_m=target)
    assert near.reaches_target
    assert near.subpath.control_nea_m[-1, :2] == pytest.approx(target)
    assert near.guide_rad == pytest.approx(math.atan2(1_600.0, 1_100.0))


def test_it_follows_the_papers_tangents() -> None:
    scan, target = (5_000.0, 2_000.0, 450.0), (7_500.0, 4_000.0)
    outcome = planned(scan_nea_m=scan, start=hover_pose(scan), target_ne_m=target)
    guide = tangent_guide_rad(scan[:2], target, TASK.radars, TASK.settings.overlap_m)
    assert outcome.guide_rad == pytest.approx(guide, abs=1e-8)  # a micrometre aside
    assert abs(guide - math.atan2(2_000.0, 2_500.0)) > 0.1  # a radar is in the way
    leaving = outcome.subpath.control_nea_m[1] - outcome.subpath.control_nea_m[0]
    assert math.atan2(leaving[1], leaving[0]) == pytest.approx(guide)


def test_what_is_not_safe_is_reported_and_flown_all_the_same() -> None:
    wall = replace(BLANK, upper_m=np.zeros_like(BLANK.upper_m))
    wall.upper_m[80:] = 5_000.0  # from 2 km north on
    outcome = planned(wall, target_ne_m=(2_900.0, 1_100.0))
    assert outcome.reaches_target
    assert not outcome.certificate.proven
    assert "terrain clearance" in outcome.certificate.broken


def test_the_same_question_has_the_same_answer_and_another_seed_another() -> None:
    a, b, c = (planned(seed=seed).subpath.control_nea_m for seed in (1, 1, 2))
    assert a.tobytes() == b.tobytes() != c.tobytes()


def test_a_pose_at_rest_turns_level_and_without_a_bend() -> None:
    pose = replace(hover_pose(START), curvature_nea_1_m=np.array([0.0, 0.01, 0.0]))
    turned = pose.facing(2.0)
    assert turned.position_nea_m is pose.position_nea_m
    assert turned.tangent_nea == pytest.approx([math.cos(2.0), math.sin(2.0), 0.0])
    assert not turned.curvature_nea_1_m.any()
