import multiprocessing
import os
import select
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from companion.paper.compare.missions import Case, bundled_case, fly_all
from companion.profiles import PAPER


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
