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
from hypothesis import given
from hypothesis import strategies as st
from planning import hills

from companion.paper.compare.missions import (
    KINDS,
    Case,
    bundled_case,
    fly_all,
    peak_distance_m,
    violations,
)
from companion.path.subpath import Subpath
from companion.profiles import PAPER
from companion.world.radars import Radar

Point = tuple[float, float, float]
TASK = replace(bundled_case("environment-1").task, radars=())
"""The limits of environment-1: 3 to 5 km, turns of 2.5 km, 10 degrees; d_s 500 m."""
FLAT = hills()
STEP_M = 10.0


def quick(planning_time_s: float = 3.0) -> Case:
    settings = {"optimiser": "improved-de", "planning_time_s": planning_time_s}
    return bundled_case("environment-1", **settings, evaluations=60)


@pytest.mark.parametrize("planning_time_s", [3.0, 5.0])
def test_a_scan_is_taken_l_before_the_end_by_equation_4(planning_time_s: float) -> None:
    task = quick(planning_time_s).task
    assert task.settings.profile is PAPER
    # L = V T + d_s, with V = 150 m/s and d_s = 500 m
    assert task.scan_distance_m == pytest.approx(150.0 * planning_time_s + 500.0)
    assert task.tail_m == 500.0


def test_routes_lead_to_the_target_and_do_not_depend_on_the_number_of_processes() -> None:
    (alone,), (together,) = (fly_all([quick()], 2, 7, jobs) for jobs in (1, 2))
    assert alone.costs == together.costs
    for seed, one, other in zip((7, 8), alone.runs, together.runs, strict=True):
        assert fly_all([quick()], 1, seed, 1)[0].costs == [one.cost]
        route = one.route_nea_m
        assert route.tobytes() == other.route_nea_m.tobytes()
        assert route[0] == pytest.approx(quick().start_nea_m)
        assert route[-1, :2] == pytest.approx([100_000.0, 100_000.0])
        steps = np.linalg.norm(np.diff(route, axis=0), axis=1)
        assert steps.max() < 110.0
        assert steps.sum() == pytest.approx(one.length_m, rel=1e-3)
        assert len(one.scans_nea_m) == one.legs
        # a1 f1 = 0.1 x 100 for 2.4 R of control polygon, which is no shorter than its curve
        assert one.cost > 0.1 * 100.0 * one.length_m / (2.4 * 20_000.0)
    assert not multiprocessing.active_children()


def test_ctrl_c_ends_it_with_its_processes() -> None:
    code = """
        import multiprocessing, signal, sys
        from companion.paper.compare.missions import bundled_case, fly_all
        if __name__ == "__main__":
            signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background
            def told(flown):
                for each in flown:
                    print(*(each.pid for each in multiprocessing.active_children()), flush=True)
                    yield each
            quick = {"optimiser": "pso", "planning_time_s": 3.0, "evaluations": 100}
            try:
                fly_all([bundled_case("environment-1", **quick)], 999, 1, 2, told)
            except KeyboardInterrupt:
                sys.exit(130)
    """
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    ) as program:
        workers = [os.pidfd_open(int(word)) for word in program.stdout.readline().split()]
        assert len(workers) == 2
        # as from a terminal: to all processes of the session
        os.killpg(program.pid, signal.SIGINT)
        _, errors = program.communicate(timeout=60)
    assert program.returncode == 130
    assert "Traceback" not in errors
    for worker in workers:
        assert select.select([worker], [], [], 5.0)[0]  # it has ended
        os.close(worker)


# --- what breaks a bound


def curve(*corners: Point) -> Subpath:
    """Straight between two of them."""
    return Subpath(
        control_nea_m=np.linspace(*corners, 4) if len(corners) == 2 else np.array(corners)
    )


def radar(north_m: float, east_m: float, range_m: float) -> Radar:
    return Radar(name="r", centre_nea_m=(north_m, east_m, 0.0), range_m=range_m)


def slope(angle_deg: float) -> Subpath:
    rise_m = 5_000.0 * math.tan(math.radians(angle_deg))
    return curve((0.0, 0.0, 4000.0), (5_000.0, 0.0, 4000.0 + rise_m))


def turn(radius_m: float) -> Subpath:
    """A quarter of a circle; the cubic Bezier curve is one to 0.03 % (its curvature to 1.5 %)."""
    k, r = 4.0 / 3.0 * math.tan(math.pi / 8.0) * radius_m, radius_m
    return curve((0.0, 0.0, 3e3), (k, 0.0, 3e3), (r, r - k, 3e3), (r, r, 3e3))


def chord_m(range_m: float, aside_m: float = 0.0) -> float:
    """How long a line 3 km up is within the range of a radar so far aside."""
    return 2.0 * math.sqrt(range_m**2 - 3000.0**2 - aside_m**2)


LEVEL = curve((0.0, 0.0, 3000.0), (20_000.0, 0.0, 3000.0))
BREAKS: list[tuple[Subpath, tuple[Radar, ...], float, str, float]] = [
    (LEVEL, (), 1.0, "", 0.0),
    (LEVEL, (radar(10e3, 2e3, 6e3),), 1.0, "radar", chord_m(6e3, 2e3)),
    (LEVEL, (radar(10e3, 2e3, 6e3),) * 2, 1.0, "radar", chord_m(6e3, 2e3)),  # once
    (LEVEL, (radar(20e3, 0.0, 5e3),), 1.0, "radar", 0.5 * chord_m(5e3)),
    (LEVEL, (radar(20e3, 0.0, 5e3),), 0.75, "", 0.0),  # it is not flown so far
    (curve((0.0, 0.0, 2e3), (40e3, 0.0, 6e3)), (), 1.0, "band", 20e3 * math.hypot(1.0, 0.1)),
    (slope(9.9), (), 1.0, "", 0.0),
    (slope(-9.9), (), 1.0, "", 0.0),
    (slope(10.1), (), 1.0, "climb", slope(10.1).length_m),
    (slope(-10.1), (), 1.0, "climb", slope(10.1).length_m),
    (turn(2_700.0), (), 1.0, "", 0.0),
    (turn(2_300.0), (), 1.0, "turn", turn(2_300.0).length_m),
]
"""Curve, radars, the share that is flown, and what of it breaks which bound."""


@pytest.mark.parametrize(("path", "radars", "share", "kind", "broken_m"), BREAKS)
def test_of_what_is_flown_just_so_much_breaks_a_bound(
    path: Subpath, radars: tuple[Radar, ...], share: float, kind: str, broken_m: float
) -> None:
    found = violations([(path, share * path.length_m)], replace(TASK, radars=radars), FLAT)
    for each in KINDS:
        expected = broken_m if each == kind else 0.0
        assert found[each] == pytest.approx(expected, rel=0.01, abs=2.0 * STEP_M)


def test_a_join_with_r2_of_0_is_a_corner_and_subpaths_add_up() -> None:
    corner = curve((0.0, 0.0, 3e3), (0.0, 0.0, 3e3), (9e3, 4e3, 3e3), (20e3, 0.0, 3e3))
    assert violations([(corner, corner.length_m)], TASK, FLAT)["turn"] > 0.0
    one = curve((0.0, 0.0, 2900.0), (5_000.0, 0.0, 2900.0))
    two = curve((5_000.0, 0.0, 3000.0), (9_000.0, 0.0, 3000.0))
    found = violations([(one, 4_000.0), (two, two.length_m)], TASK, FLAT)
    assert found["band"] == pytest.approx(4_000.0)


@given(
    spread_m=st.floats(4_000.0, 12_000.0),
    at_m=st.floats(-9_000.0, 9_000.0),
    above_m=st.floats(50.0, 600.0),
)
def test_near_a_peak_its_distance_is_that_of_the_nearest_of_many_points_of_its_surface(
    spread_m: float, at_m: float, above_m: float
) -> None:
    terrain, east_m = hills((0.0, 0.0, 4000.0, spread_m, 9e3), ground_m=-1e6), 2_000.0
    ground_m = 4000.0 * math.exp(-((at_m / spread_m) ** 2) - (east_m / 9e3) ** 2)
    point = np.array([at_m, east_m, ground_m + above_m])
    offsets = np.arange(-1_000.0, 1_001.0, 20.0)
    north, east = np.meshgrid(at_m + offsets, east_m + offsets, indexing="ij")
    surface = 4000.0 * np.exp(-((north / spread_m) ** 2) - (east / 9e3) ** 2)
    gap = np.sqrt((north - at_m) ** 2 + (east - east_m) ** 2 + (surface - point[2]) ** 2).min()
    # planner-numbers A, row 12: 0.954 to 1.048 of the Euclidean distance
    assert peak_distance_m(point[None], terrain)[0] == pytest.approx(gap, rel=0.07, abs=2.0)


def test_the_nearest_of_peaks_and_ground_counts_and_inside_is_negative() -> None:
    terrain = hills((7e3, -4e3, 1000.0, 5e3, 5e3), ground_m=100.0)
    points = np.array([(7e3, -4e3, 1300.0), (7e3, -4e3, 900.0), (9e4, 0.0, 350.0)])
    assert peak_distance_m(points, terrain).tolist() == pytest.approx([300.0, -100.0, 250.0])
