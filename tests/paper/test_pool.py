import multiprocessing
import os
import select
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace

from companion.paper.compare.missions import Case, bundled_case, fly, fly_all, planned_with


def quick() -> Case:
    settings = {"optimiser": "improved-de", "planning_time_s": 3.0, "evaluations": 60}
    return planned_with(bundled_case("environment-1"), **settings)


def test_the_results_do_not_depend_on_the_number_of_processes() -> None:
    (alone,), (together,) = (fly_all([quick()], 2, 7, jobs) for jobs in (1, 2))
    assert alone.costs == together.costs
    for run, (one, other) in enumerate(zip(alone.runs, together.runs, strict=True)):
        assert one.route_nea_m.tobytes() == other.route_nea_m.tobytes()
        assert one.cost == fly(replace(quick(), seed=7 + run)).cost
    assert not multiprocessing.active_children()


def test_ctrl_c_ends_it_with_its_processes() -> None:
    code = """
        import multiprocessing, signal, sys
        from companion.paper.compare.missions import bundled_case, fly_all, planned_with
        if __name__ == "__main__":
            signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background
            def told(flown):
                for each in flown:
                    print(*(each.pid for each in multiprocessing.active_children()), flush=True)
                    yield each
            quick = {"optimiser": "pso", "planning_time_s": 3.0, "evaluations": 100}
            try:
                fly_all([planned_with(bundled_case("environment-1"), **quick)], 999, 1, 2, told)
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
        workers = [int(word) for word in program.stdout.readline().split()]
        assert len(workers) == 2
        # as from a terminal: to all processes of the session
        os.killpg(program.pid, signal.SIGINT)
        _, errors = program.communicate(timeout=60)
    assert program.returncode == 130
    assert "Traceback" not in errors
    assert all(ends_within(5.0, pid) for pid in workers)


def ends_within(limit_s: float, pid: int) -> bool:
    try:
        process = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([process], [], [], limit_s)[0])
    finally:
        os.close(process)
