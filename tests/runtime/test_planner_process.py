"""A planner in a process of its own: the same plans, and no way to take the flight down with it."""

import contextlib
import importlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stub_session import request_of

from companion.planner.plan import plan
from companion.planner.request import Planned
from companion.runtime.planner_process import PlannerEndedError, PlannerProcess
from companion.world.known_map import KnownMap

Made = Callable[[str], PlannerProcess]


def never() -> bool:
    return False


@pytest.fixture
def planner() -> Iterator[PlannerProcess]:
    with contextlib.closing(PlannerProcess()) as made:
        yield made


@pytest.fixture
def odd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Made]:
    """Makes a process that does what the text of a module says."""
    made: list[PlannerProcess] = []

    def make(text: str) -> PlannerProcess:
        (tmp_path / "odd_planner.py").write_text(text, encoding="utf-8")
        monkeypatch.syspath_prepend(str(tmp_path))
        sys.modules.pop("odd_planner", None)
        module = importlib.import_module("odd_planner")
        made.append(PlannerProcess(module.plan, module.prepare))
        return made[-1]

    yield make
    for each in made:
        each.close()


def test_a_plan_is_the_same_from_another_process_which_is_started_once_and_answers_any_number(
    planner: PlannerProcess,
) -> None:
    planner.start()
    before = planner.pid
    planner.start()
    assert planner.pid == before
    assert [planner(request_of(number), never).plan_id for number in (1, 2, 3)] == [1, 2, 3]
    request = request_of(7)
    expected, found = plan(request, never), planner(request, never)
    assert type(found) is type(expected)
    if isinstance(expected, Planned):
        assert isinstance(found, Planned)
        control = expected.subpath.control_nea_m
        np.testing.assert_allclose(found.subpath.control_nea_m, control, atol=1e-6)


def test_arrays_arrive_as_they_were_whatever_their_order_in_memory(odd: Made) -> None:
    planner = odd("prepare = int\ndef plan(request, stop): return request.known\n")
    request = request_of(1)
    heights = np.arange(1_000_000.0).reshape(1000, 1000)
    heights[3, :3] = np.nan, np.inf, -np.inf
    frozen = heights.copy()
    frozen.setflags(write=False)
    for upper_m in (heights, heights.T, heights[::3, 1:-5], heights[:0], frozen):
        known = replace(request.known, upper_m=upper_m, seen=upper_m > 7.0)
        echo = planner(replace(request, known=known), never)
        assert isinstance(echo, KnownMap)
        np.testing.assert_array_equal(echo.upper_m, upper_m)
        np.testing.assert_array_equal(echo.seen, known.seen)


NOISY = """
def plan(request, stop):
    if request.plan_id == 1: raise ZeroDivisionError("made up")
    while not stop(): pass
    return "stopped"
def prepare():
    print("noise on the standard output")
"""


def test_a_plan_that_raises_is_an_error_with_its_words_and_what_it_prints_is_no_output_of_ours(
    odd: Made, capfd: pytest.CaptureFixture[str]
) -> None:
    planner, asked = odd(NOISY), list[int]()
    capfd.readouterr()
    with pytest.raises(PlannerEndedError, match="ZeroDivisionError: made up"):
        planner(request_of(1), never)

    def stop() -> bool:
        asked.append(1)
        return len(asked) > 3

    assert str(planner(request_of(2), stop)) == "stopped"
    assert capfd.readouterr().out == ""


def test_a_process_that_does_not_come_up_is_an_error(odd: Made) -> None:
    planner = odd("import sys\ndef prepare(): sys.exit(3)\nplan = prepare\n")
    with pytest.raises(PlannerEndedError, match="exit code 3"):
        planner.start()


PARENT = """
import os, signal
from companion.runtime.planner_process import PlannerProcess
planner = PlannerProcess()
planner.start()
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_planner_does_not_outlive_a_companion_that_is_killed() -> None:
    """Its standard error ends when the last process that holds it does."""
    parent = subprocess.run(
        [sys.executable, "-c", PARENT], capture_output=True, timeout=60, check=False
    )
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
