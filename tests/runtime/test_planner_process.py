"""A planner in a process of its own: the same plans, and no way to take the flight down with it."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import odd_planners as odd
import pytest
from stub_session import PATIENCE_S, request_of

from companion.runtime import planner_process
from companion.runtime.planner_process import PlannerEndedError, PlannerProcess


@pytest.fixture
def of() -> Iterator[Callable[..., PlannerProcess]]:
    """Makes one that is ready.  Its plans are those of this process: `closed_loop`."""
    with contextlib.ExitStack() as stack:

        def made(*does: Any, **keywords: Any) -> PlannerProcess:
            planner = stack.enter_context(contextlib.closing(PlannerProcess(*does, **keywords)))
            while not planner.is_ready:
                assert planner.answer(PATIENCE_S) is None
            return planner

        yield made


@pytest.mark.parametrize(
    ("does", "why"),
    [(odd.raises, "ZeroDivisionError: made up"), (odd.never_ends, "it has stood still")],
)
def test_a_plan_that_raises_or_does_not_end_is_an_error_and_what_it_prints_is_no_output_of_ours(
    of: Any, does: Any, why: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """It has T and five seconds more, by the clock of the one that waits."""
    capfd.readouterr()
    planner, now_s, wait_s = of(does, odd.is_noisy), 0.0, PATIENCE_S
    monkeypatch.setattr(planner_process, "time", SimpleNamespace(monotonic=lambda: now_s))
    planner.ask(request_of(1, planning_time_s=0.2))
    if does is odd.never_ends:
        now_s, wait_s = 5.1, 0.0
        assert planner.answer() is None
        now_s = 5.3
    with pytest.raises(PlannerEndedError, match=why):
        planner.answer(wait_s)
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("hurries", [True, False])
def test_of_two_plans_that_are_asked_for_only_the_newer_counts_and_a_search_ends_in_time(
    of: Any, hurries: bool
) -> None:
    """The first stops as soon as nobody waits for it; in lockstep nothing else stops one."""
    planner = of(odd.searches, odd.nothing, hurries=hurries)
    for number in (1, 3):
        planner.ask(request_of(number, planning_time_s=1000.0))
        planner._sender.join()
        planner.ask(request_of(number + 1, planning_time_s=0.1))
        assert planner.answer(PATIENCE_S) is None  # of the first
        answer = planner.answer(PATIENCE_S if hurries else 0.2)
        assert (answer is not None) is hurries
        if answer is None:
            return
        assert answer[0].plan_id == number + 1
        assert 0.08 <= answer[1] < 1.0
        assert planner.answer() is None  # once


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
from stub_session import request_of
from companion.runtime.planner_process import PlannerProcess
planner = PlannerProcess(odd.echoes, odd.cannot_hear_ctrl_c)
while not planner.is_ready:
    planner.answer(1.0)
for number in (signal.SIGINT, signal.SIGTERM):
    os.kill(planner.process.pid, number)
planner.ask(request_of(1))
while planner.answer(1.0) is None:
    pass
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_planner_does_not_outlive_a_companion_that_is_killed_nor_end_by_ctrl_c() -> None:
    """Nor while it is started, nor by SIGTERM; its standard error ends with who holds it last."""
    command = [sys.executable, "-c", PROGRAM]
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    parent = subprocess.run(command, env=paths, capture_output=True, timeout=60, check=False)
    assert (parent.returncode, parent.stderr) == (-signal.SIGKILL, b"")


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
