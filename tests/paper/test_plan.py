"""One plan by profile `paper`, as in environment-2."""

import math
from dataclasses import replace

import numpy as np
import pytest
from planning import ask

from companion.paper.compare.missions import as_published
from companion.paper.guide import tangent_guide_rad
from companion.planner.procedure import hover_pose
from companion.planner.request import Planned
from companion.planning import plan
from companion.world.known_map import KnownMap, empty_map
from companion.world.simulated import true_map

WORLD = as_published("environment-2", evaluations=200)
START, TASK, TARGET = WORLD.start_nea_m, WORLD.task, WORLD.targets_ne_m[0]
BLANK = empty_map(TASK.cell_m, TASK.limits.north_m, TASK.limits.east_m)
TRUTH = true_map(WORLD.terrain, BLANK)


def planned(known: KnownMap = TRUTH, **changes: object) -> Planned:
    outcome = plan(ask(TASK, known, START, **{"target_ne_m": TARGET} | changes))
    assert isinstance(outcome, Planned)
    return outcome


def test_the_best_of_one_search_is_taken_as_it_is_and_ends_at_the_range_of_the_scan() -> None:
    outcome = planned()
    assert (outcome.tries, outcome.rank, outcome.evaluations) == (1, 0, 200)
    assert outcome.subpath.control_nea_m.shape == (4, 3)
    weights = {"length": 0.1, "height": 0.15, "guide": 0.15, "crash": 0.3, "radar": 0.3}
    weights["constraints"] = 1.0
    assert outcome.terms.keys() == weights.keys()
    assert outcome.cost == pytest.approx(sum(a * outcome.terms[f] for f, a in weights.items()))
    assert not outcome.reaches_target
    assert math.dist(outcome.subpath.control_nea_m[-1, :2], START[:2]) == pytest.approx(20_000.0)


def test_from_rest_it_leaves_level_along_the_papers_tangents() -> None:
    climbing = replace(hover_pose(START), tangent_nea=np.array([0.8, 0.0, 0.6]))
    outcome = planned(start=climbing)
    guide = tangent_guide_rad(START[:2], TARGET, TASK.radars, TASK.settings.overlap_m)
    assert outcome.guide_rad == pytest.approx(guide, abs=1e-8)
    assert abs(guide - math.pi / 4) > 0.1  # a radar is in the way
    leaving = outcome.subpath.control_nea_m[1] - outcome.subpath.control_nea_m[0]
    assert math.atan2(leaving[1], leaving[0]) == pytest.approx(guide)
    assert leaving[2] == pytest.approx(0.0, abs=1e-9)


def test_a_target_within_range_is_the_end_also_where_that_is_not_safe_and_so_reported() -> None:
    wall = replace(BLANK, upper_m=np.full_like(BLANK.upper_m, 9_000.0))
    target = (START[0] + 11_000.0, START[1] + 16_000.0)
    outcome = planned(wall, target_ne_m=target)
    assert outcome.reaches_target
    assert outcome.subpath.control_nea_m[-1, :2] == pytest.approx(target)
    assert outcome.guide_rad == pytest.approx(math.atan2(16.0, 11.0))
    assert not outcome.certificate.proven
    assert "terrain clearance" in outcome.certificate.broken
