"""Missions as the paper flies them, and dense measures of curves known in closed form."""

import math
import multiprocessing
import os
import select
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace

import numpy as np
import pytest
from planning import hills

from companion.geodesy import FloatArray
from companion.paper.compare.missions import KINDS, Case, as_published, fly_all, violations
from companion.world.radars import Radar
from companion.world.terrain import PeakTerrain

Point = tuple[float, float, float]
FLAT, STEP_M = hills(), 10.0


def quick(planning_time_s: float = 3.0) -> Case:
    world = as_published("environment-1", planning_time_s=planning_time_s, evaluations=60)
    return Case(heading="environment-1", label="", world=world)


@pytest.mark.xdist_group("campaign")
def test_routes_lead_to_the_target_and_do_not_depend_on_the_number_of_processes() -> None:
    cases = [quick(), quick(5.0)]
    alone, together = (fly_all(cases, 2, 7, jobs) for jobs in (1, 2))
    assert fly_all(cases[:1], 1, 8, 1)[0].costs == alone[0].costs[1:]
    for case, one, other in zip(cases, alone, together, strict=True):
        for run, again in zip(one.runs, other.runs, strict=True):
            assert run.route_nea_m.tobytes() == again.route_nea_m.tobytes()
        assert len(set(one.costs)) == 2
        for run in one.runs:
            assert run.route_nea_m[0] == pytest.approx(case.world.start_nea_m)
            assert run.route_nea_m[-1, :2] == pytest.approx([100_000.0, 100_000.0])
            steps = np.linalg.norm(np.diff(run.route_nea_m, axis=0), axis=1)
            assert steps.max() < 110.0
            assert steps.sum() == pytest.approx(run.length_m, rel=1e-3)
            # a1 f1 = 0.1 x 100 for 2.4 R of control polygon, which is no shorter than its curve
            assert run.cost > 0.1 * 100.0 * run.length_m / (2.4 * 20_000.0)
    assert not multiprocessing.active_children()


@pytest.mark.xdist_group("campaign")
def test_ctrl_c_ends_it_with_its_processes() -> None:
    code = """
        import multiprocessing, signal, sys
        from companion.paper.compare.missions import Case, as_published, fly_all
        if __name__ == "__main__":
            signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background
            def told(flown):
                for each in flown:
                    print(*(each.pid for each in multiprocessing.active_children()), flush=True)
                    yield each
            world = as_published("environment-1", optimiser="pso", evaluations=100)
            try:
                fly_all([Case(heading="", label="", world=world)], 999, 1, 2, told)
            except KeyboardInterrupt:
                sys.exit(130)
    """
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    command = [sys.executable, "-c", textwrap.dedent(code)]
    with subprocess.Popen(command, start_new_session=True, **pipes) as program:
        workers = [os.pidfd_open(int(word)) for word in program.stdout.readline().split()]
        assert len(workers) == 2
        os.killpg(program.pid, signal.SIGINT)  # as from a terminal: to all of the session
        _, errors = program.communicate(timeout=60)
    assert program.returncode == 130
    assert "Traceback" not in errors
    for worker in workers:
        assert select.select([worker], [], [], 5.0)[0]  # it has ended
        os.close(worker)


# --- what breaks a bound


def curve(*corners: Point) -> FloatArray:
    """Control points; straight between two of them."""
    return np.linspace(*corners, 4) if len(corners) == 2 else np.array(corners)


def broken(
    *flown: tuple[FloatArray, float], radars: tuple[Radar, ...] = (), terrain: PeakTerrain = FLAT
) -> dict[str, float]:
    """With the limits of environment-1: turns of 2.5 km; d_s 500 m."""
    world = as_published("environment-1")
    task = replace(world.task, radars=radars)
    return violations(flown, replace(world, task=task, terrain=terrain))


def radar(north_m: float, east_m: float, range_m: float) -> Radar:
    return Radar(name="r", centre_nea_m=(north_m, east_m, 0.0), range_m=range_m)


def turn(radius_m: float) -> FloatArray:
    """A quarter of a circle; the cubic Bezier curve is one to 0.03 % (its curvature to 1.5 %)."""
    k, r = 4.0 / 3.0 * math.tan(math.pi / 8.0) * radius_m, radius_m
    return curve((0.0, 0.0, 3e3), (k, 0.0, 3e3), (r, r - k, 3e3), (r, r, 3e3))


def chord_m(range_m: float, aside_m: float = 0.0) -> float:
    """How long a line 3 km up is within the range of a radar so far aside."""
    return 2.0 * math.sqrt(range_m**2 - 3000.0**2 - aside_m**2)


LEVEL = curve((0.0, 0.0, 3000.0), (20_000.0, 0.0, 3000.0))
BREAKS: list[tuple[FloatArray, float, tuple[Radar, ...], str, float]] = [
    (LEVEL, 20e3, (), "", 0.0),
    (LEVEL, 20e3, (radar(10e3, 2e3, 6e3),), "radar", chord_m(6e3, 2e3)),
    (LEVEL, 20e3, (radar(10e3, 2e3, 6e3),) * 2, "radar", chord_m(6e3, 2e3)),  # once
    (LEVEL, 20e3, (radar(20e3, 0.0, 5e3),), "radar", 0.5 * chord_m(5e3)),
    (LEVEL, 15e3, (radar(20e3, 0.0, 5e3),), "", 0.0),  # it is not flown so far
    (turn(2_700.0), 1e4, (), "", 0.0),
    (turn(2_300.0), 1e4, (), "turn", 2_300.0 * math.pi / 2.0),
]
"""Curve, how far it is flown, radars, and what of it breaks which bound."""


@pytest.mark.parametrize(("control", "flown_m", "radars", "kind", "broken_m"), BREAKS)
def test_of_what_is_flown_just_so_much_breaks_a_bound(
    control: FloatArray, flown_m: float, radars: tuple[Radar, ...], kind: str, broken_m: float
) -> None:
    found = broken((control, flown_m), radars=radars)
    for each in KINDS:
        expected = broken_m if each == kind else 0.0
        assert found[each] == pytest.approx(expected, rel=0.01, abs=2.0 * STEP_M)


def test_nearer_than_d_s_to_ground_and_peaks_is_what_lies_within_500_m_of_them() -> None:
    low = curve((0.0, 0.0, 400.0), (20_000.0, 0.0, 400.0))
    assert broken((low, 8_000.0))["clearance"] == pytest.approx(8_000.0)
    peaks = hills((10e3, 0.0, 3_000.0, 4e3, 1e9))  # along the way h = 3000 exp(-(x / 4 km)^2)
    found = broken((LEVEL + np.array([0.0, 0.0, 400.0]), 20e3), terrain=peaks)["clearance"]
    x = np.arange(-10e3, 10e3, 5.0)
    ground = np.stack([x, 3_000.0 * np.exp(-((x / 4e3) ** 2))], axis=-1)
    near = [np.hypot(*(ground - (at, 3_400.0)).T).min() < 500.0 for at in x]
    assert found == pytest.approx(5.0 * sum(near), abs=2.0 * STEP_M)
