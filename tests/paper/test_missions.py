"""Plans and missions as the paper flies them, and measures of curves known in closed form."""

import math
import os
import select
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace

import numpy as np
import pytest
from planning import ask, hills, radar

from companion.paper.compare.missions import Case, as_published, fly_all, violations
from companion.paper.guide import tangent_guide_rad
from companion.planner.procedure import hover_pose
from companion.planner.request import Planned
from companion.planning import plan
from companion.world.known_map import KnownMap, empty_map
from companion.world.simulated import true_map


def quick(planning_time_s: float = 3.0) -> Case:
    world = as_published("environment-1", planning_time_s=planning_time_s, evaluations=60)
    return Case(heading="environment-1", label="", world=world)


def test_routes_lead_to_the_target() -> None:
    cases = [quick(), quick(5.0)]
    flown = fly_all(cases, 2, 7, 1)
    assert fly_all(cases[:1], 1, 8, 1)[0].costs == flown[0].costs[1:]
    for case, outcome in zip(cases, flown, strict=True):
        assert len(set(outcome.costs)) == 2
        for run in outcome.runs:
            assert run.route_nea_m[0] == pytest.approx(case.world.start_nea_m)
            assert run.route_nea_m[-1, :2] == pytest.approx([100_000.0, 100_000.0])
            steps = np.linalg.norm(np.diff(run.route_nea_m, axis=0), axis=1)
            assert steps.max() < 110.0
            assert steps.sum() == pytest.approx(run.length_m, rel=1e-3)
            # a1 f1 = 0.1 x 100 for 2.4 R of control polygon, which is no shorter than its curve
            assert run.cost > 0.1 * 100.0 * run.length_m / (2.4 * 20_000.0)


@pytest.mark.xdist_group("campaign")
def test_of_many_processes_each_flies_the_same_and_ctrl_c_ends_all() -> None:
    code = """
        import multiprocessing, signal, sys
        from companion.paper.compare.missions import Case, as_published, fly_all
        if __name__ == "__main__":
            signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background
            def told(flown):
                for number, run in flown:
                    print(*(each.pid for each in multiprocessing.active_children()))
                    print(number, run.route_nea_m.tobytes().hex(), flush=True)
                    yield number, run
            world = as_published("environment-1", planning_time_s=3.0, evaluations=60)
            try:
                fly_all([Case(heading="", label="", world=world)], 999, 7, 2, told)
            except KeyboardInterrupt:
                sys.exit(130)
    """
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    command = [sys.executable, "-c", textwrap.dedent(code)]
    with subprocess.Popen(command, start_new_session=True, **pipes) as program:
        workers, *told = (program.stdout.readline().split() for _ in range(4))
        ended = [os.pidfd_open(int(word)) for word in workers]
        assert len(ended) == 2
        os.killpg(program.pid, signal.SIGINT)  # as from a terminal: to all of the session
        _, errors = program.communicate(timeout=60)
    assert program.returncode == 130
    assert "Traceback" not in errors
    for worker in ended:
        assert select.select([worker], [], [], 5.0)[0]
        os.close(worker)
    for number, route in told[::2]:
        [alone] = fly_all([quick()], 1, 7 + int(number), 1)[0].runs
        assert alone.route_nea_m.tobytes().hex() == route


def test_of_what_is_flown_just_so_much_breaks_each_bound() -> None:
    """In environment-1 that is turns of 2.5 km, d_s 500 m.  What two radars see counts once."""
    level = np.linspace((0.0, 0.0, 3_400.0), (20e3, 0.0, 3_400.0), 4)
    k = 4.0 / 3.0 * math.tan(math.pi / 8.0)  # a circle to 0.03 %, its curvature to 1.5 %
    quarter = np.array([(0.0, 0.0, 0.0), (k, 0.0, 0.0), (1.0, 1.0 - k, 0.0), (1.0, 1.0, 0.0)])
    far = np.array([200e3, 0.0, 3_000.0])
    flown = [(level, 15e3), (2_700.0 * quarter + far, 1e4), (2_300.0 * quarter + far, 1e4)]
    seen, not_come_to = (10e3, 2e3, 6e3), (20e3, 0.0, 5e3)
    radars = tuple(radar(*each) for each in (seen, seen, not_come_to))
    world = as_published("environment-1")
    ridge = hills((10e3, 0.0, 3_000.0, 4e3, 1e9))  # along the way h = 3000 exp(-(x / 4 km)^2)
    world = replace(world, task=replace(world.task, radars=radars), terrain=ridge)
    x = np.arange(-10e3, 5e3, 5.0)
    ground = np.stack([x, 3_000.0 * np.exp(-((x / 4e3) ** 2))], axis=-1)
    near = [np.hypot(*(ground - (at, 3_400.0)).T).min() < 500.0 for at in x]
    expected = {
        "clearance": 5.0 * sum(near),
        "radar": 2.0 * math.sqrt(6_000.0**2 - 3_400.0**2 - 2_000.0**2),
        "turn": 2_300.0 * math.pi / 2.0,
    }
    assert violations(flown, world) == pytest.approx(expected, rel=0.01, abs=20.0)


# --- one plan by profile `paper`, as in environment-2

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
