"""A planner in a process of its own: the same plans, and no way to take the flight down with it."""

import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stub_session import request_of

from companion.planner.plan import plan
from companion.planner.request import NotPlanned, Planned
from companion.runtime.planner_process import PlannerEndedError, PlannerProcess
from companion.world.known_map import KnownMap


def never() -> bool:
    return False


@pytest.fixture
def planner() -> Iterator[PlannerProcess]:
    made = PlannerProcess()
    try:
        yield made
    finally:
        made.close()


def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> PlannerProcess:
    (tmp_path / "odd_planner.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    return PlannerProcess("odd_planner")


def test_a_plan_is_the_same_from_another_process(planner: PlannerProcess) -> None:
    request = request_of(7)
    expected, found = plan(request, never), planner(request, never)
    assert type(found) is type(expected)
    assert found.plan_id == 7
    if isinstance(expected, Planned):
        assert isinstance(found, Planned)
        control = expected.subpath.control_nea_m
        np.testing.assert_allclose(found.subpath.control_nea_m, control, atol=1e-6)
    else:
        assert isinstance(found, NotPlanned)


ECHO = """
import companion.runtime.planner_process as process
process.plan = lambda request, stop: request.known
process.load_kernel = lambda: None
process.main()
"""


def test_arrays_arrive_as_they_were_whatever_their_order_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    planner, request = module(tmp_path, monkeypatch, ECHO), request_of(1)
    heights = np.arange(1_000_000.0).reshape(1000, 1000)
    heights[3, :3] = np.nan, np.inf, -np.inf
    frozen = heights.copy()
    frozen.setflags(write=False)
    try:
        for upper_m in (heights, heights.T, heights[::3, 1:-5], heights[:0], frozen):
            known = replace(request.known, upper_m=upper_m, seen=upper_m > 7.0)
            echo = planner(replace(request, known=known), never)
            assert isinstance(echo, KnownMap)
            np.testing.assert_array_equal(echo.upper_m, upper_m)
            np.testing.assert_array_equal(echo.seen, known.seen)
    finally:
        planner.close()


def test_one_process_answers_any_number_of_questions(planner: PlannerProcess) -> None:
    assert [planner(request_of(number), never).plan_id for number in (1, 2, 3)] == [1, 2, 3]


def test_what_is_ready_before_the_flight_is_not_started_again(planner: PlannerProcess) -> None:
    planner.start()
    before = planner.pid
    planner.start()
    assert planner.pid == before
    assert planner(request_of(1), never).plan_id == 1


def test_a_process_that_is_killed_is_an_error_that_says_so(planner: PlannerProcess) -> None:
    planner.start()
    child = planner._child
    assert child is not None
    threading.Timer(0.0, os.kill, (child.pid, signal.SIGKILL)).start()
    child.wait()
    with pytest.raises(PlannerEndedError, match="SIGKILL"):
        planner(request_of(1), never)


def test_a_process_that_ends_while_it_has_nothing_to_do_is_told_of_at_once(
    planner: PlannerProcess,
) -> None:
    told: queue.SimpleQueue[PlannerEndedError] = queue.SimpleQueue()
    planner.on_end = told.put
    planner.start()
    assert planner._child is not None
    planner._child.kill()
    assert "SIGKILL" in str(told.get(timeout=10.0))


def test_a_plan_that_raises_is_an_error_with_its_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = """
import companion.runtime.planner_process as process
def plan(request, stop):
    if request.plan_id == 1: raise ZeroDivisionError("made up")
    while not stop(): pass
    return "stopped"
process.plan = plan
process.load_kernel = lambda: print("noise on the standard output")
process.main()
"""
    planner = module(tmp_path, monkeypatch, text)
    try:
        with pytest.raises(PlannerEndedError, match="ZeroDivisionError: made up"):
            planner(request_of(1), never)
        asked: list[int] = []

        def stop() -> bool:
            asked.append(1)
            return len(asked) > 3

        assert str(planner(request_of(2), stop)) == "stopped"
    finally:
        planner.close()


def test_a_process_that_does_not_come_up_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    planner = module(tmp_path, monkeypatch, "raise SystemExit(3)")
    with pytest.raises(PlannerEndedError, match="exit code 3"):
        planner.start()
    planner.close()


COMPILING = """
import threading
import companion.runtime.planner_process as process
process.load_kernel = threading.Event().wait
process.main()
"""


def test_a_planner_that_still_compiles_does_not_outlive_its_companion() -> None:
    command = [sys.executable, "-c", COMPILING]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdin is not None
        child.stdin.close()
        assert child.wait(30.0) == 0


PARENT = """
import os, signal
from companion.runtime.planner_process import PlannerProcess
planner = PlannerProcess()
planner.start()
print(planner._child.pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_planner_does_not_outlive_a_companion_that_is_killed() -> None:
    """Its standard error ends when the last process that holds it does."""
    command = [sys.executable, "-c", PARENT]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as parent:
        _, errors = parent.communicate(timeout=60)
    assert parent.returncode == -signal.SIGKILL
    assert errors == b""


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted on Linux")
def test_linear_algebra_takes_no_threads_of_its_own() -> None:
    factorised = """
import os
import companion.world.guess
import numpy as np
np.linalg.cholesky(np.eye(500))
print(len(os.listdir("/proc/self/task")))
"""
    environment = {name: value for name, value in os.environ.items() if "THREADS" not in name}
    command = [sys.executable, "-c", factorised]
    assert subprocess.check_output(command, env=environment) == b"1\n"
