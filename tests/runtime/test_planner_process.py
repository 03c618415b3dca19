"""A planner in a process of its own: the same plans, and no way to take the flight down with it."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import odd_planners as odd
import pytest
from stub_session import PATIENCE_S, request_of

from companion.planner.plan import plan
from companion.planner.request import Planned, PlanRequest
from companion.runtime.planner_process import PlannerEndedError, PlannerProcess


@pytest.fixture
def of() -> Iterator[Callable[..., PlannerProcess]]:
    """Makes one that is ready; it does what `plan` does if nothing is said."""
    with contextlib.ExitStack() as stack:

        def made(*does: Any, **keywords: Any) -> PlannerProcess:
            planner = stack.enter_context(contextlib.closing(PlannerProcess(*does, **keywords)))
            while not planner.is_ready:
                assert planner.answer(PATIENCE_S) is None
            return planner

        yield made


def planned(planner: PlannerProcess, request: PlanRequest) -> Any:
    planner.ask(request)
    answer = planner.answer(PATIENCE_S)
    assert answer is not None
    assert planner.answer() is None  # once
    return answer[0]


def test_a_plan_is_the_same_from_a_process_that_answers_any_number(of: Any) -> None:
    planner = of()
    before = planner.process
    assert [planned(planner, request_of(number)).plan_id for number in (1, 2, 3)] == [1, 2, 3]
    assert planner.process is before
    request = request_of(7)
    expected, found = plan(request, lambda: False), planned(planner, request)
    assert type(found) is type(expected)
    if isinstance(expected, Planned):
        assert isinstance(found, Planned)
        control = expected.subpath.control_nea_m
        np.testing.assert_allclose(found.subpath.control_nea_m, control, atol=1e-6)


def test_arrays_arrive_as_they_were_whatever_their_order(of: Any) -> None:
    planner, request = of(odd.echoes, odd.nothing), request_of(1)
    heights = np.arange(1_000_000.0).reshape(1000, 1000)
    heights[3, :3] = np.nan, np.inf, -np.inf
    frozen = heights.copy()
    frozen.setflags(write=False)
    for upper_m in (heights, heights.T, heights[::3, 1:-5], heights[:0], frozen):
        known = replace(request.known, upper_m=upper_m, seen=upper_m > 7.0)
        echo = planned(planner, replace(request, known=known)).known
        np.testing.assert_array_equal(echo.upper_m, upper_m)
        np.testing.assert_array_equal(echo.seen, known.seen)


def test_a_plan_that_raises_is_an_error_with_its_words_and_what_it_prints_is_no_output_of_ours(
    of: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    capfd.readouterr()
    planner = of(odd.raises, odd.is_noisy)
    planner.ask(request_of(1))
    with pytest.raises(PlannerEndedError, match="ZeroDivisionError: made up"):
        planner.answer(PATIENCE_S)
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("hurries", [True, False])
def test_of_two_plans_that_are_asked_for_only_the_newer_counts_and_a_search_ends_in_time(
    of: Any, hurries: bool
) -> None:
    """The first stops as soon as nobody waits for it; in lockstep nothing else stops one."""
    planner = of(odd.searches, odd.nothing, hurries=hurries)
    planner.ask(request_of(1, planning_time_s=1000.0))
    planner._sender.join()
    planner.ask(request_of(2, planning_time_s=0.1))
    assert planner.answer(PATIENCE_S) is None  # of the first
    answer = planner.answer(PATIENCE_S if hurries else 0.2)
    if hurries:
        assert answer is not None
        assert answer[0].plan_id == 2
        assert 0.08 <= answer[1] < 1.0
    else:
        assert answer is None


def test_a_process_that_does_not_come_up_or_cannot_be_started_is_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    gone, unable = PlannerProcess(odd.echoes, odd.comes_not_up), PlannerProcess()
    monkeypatch.setattr(unable, "_start", Path("/nowhere").stat)
    for planner, why in ((gone, "exit code 3"), (unable, "No such file")):
        with contextlib.closing(planner), pytest.raises(PlannerEndedError, match=why):
            planner.answer(PATIENCE_S)


PROGRAM = """
import os, signal
import odd_planners as odd
from companion.runtime.planner_process import PlannerProcess
planner = PlannerProcess({does})
while not planner.is_ready:
    planner.answer(1.0)
{then}
"""


def ended(does: str, then: str) -> subprocess.CompletedProcess[bytes]:
    """A program that has had a planner, the first process that it has started."""
    command = [sys.executable, "-c", PROGRAM.format(does=does, then=then)]
    here = Path(__file__).parent
    return subprocess.run(command, cwd=here, capture_output=True, timeout=60, check=False)


def test_a_planner_does_not_outlive_a_companion_that_is_killed() -> None:
    """Its standard error ends when the last process that holds it does."""
    parent = ended("", "os.kill(os.getpid(), signal.SIGKILL)")
    assert (parent.returncode, parent.stderr) == (-signal.SIGKILL, b"")


def test_ctrl_c_in_a_terminal_does_not_end_a_planner_that_is_being_started() -> None:
    """Not the first process that is started, either, of which there may be one in a program."""
    assert ended("odd.echoes, odd.cannot_hear_ctrl_c", "planner.close()").returncode == 0


FACTORISED = """
import os
import companion.world.guess
import numpy as np
np.linalg.cholesky(np.eye(500))
print(len(os.listdir("/proc/self/task")))
"""


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted on Linux")
def test_linear_algebra_takes_no_threads_of_its_own() -> None:
    environment = {name: value for name, value in os.environ.items() if "THREADS" not in name}
    command = [sys.executable, "-c", FACTORISED]
    assert subprocess.check_output(command, env=environment) == b"1\n"
