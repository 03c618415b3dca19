import multiprocessing
import os
import select
import signal
import subprocess
import sys
import textwrap

from companion.paper.compare.missions import Case, bundled_case, fly_all, planned_with


def cases(count: int, evaluations: int) -> list[Case]:
    return [
        planned_with(
            bundled_case("environment-1"),
            optimiser="improved-de",
            planning_time_s=3.0,
            evaluations=evaluations,
            seed=seed,
        )
        for seed in range(1, count + 1)
    ]


def test_the_results_do_not_depend_on_the_number_of_processes() -> None:
    alone = fly_all(cases(2, 60), 1, iter)
    together = fly_all(cases(2, 60), 2, iter)
    assert [run.cost for run in alone] == [run.cost for run in together]
    for one, other in zip(alone, together, strict=True):
        assert one.route_nea_m.tobytes() == other.route_nea_m.tobytes()
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
            quick = {"optimiser": "pso", "planning_time_s": 3.0, "evaluations": 100, "seed": 1}
            try:
                fly_all([planned_with(bundled_case("environment-1"), **quick)] * 999, 2, told)
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
