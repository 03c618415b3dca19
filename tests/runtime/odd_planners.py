"""What planners in a process of their own may do; each is `plan`, or `prepare` before it."""

import signal
import sys
from collections.abc import Callable
from typing import Any

from companion.planner.request import PlanRequest


def nothing() -> None:
    pass


def comes_not_up() -> None:
    sys.exit(3)


def cannot_hear_ctrl_c() -> None:
    """Nor could it before its first line of ours."""
    assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def is_noisy() -> None:
    sys.stdout.write("noise on the standard output")


def echoes(request: PlanRequest, _stop: object) -> Any:
    return request


def raises(_request: PlanRequest, _stop: object) -> Any:
    raise ZeroDivisionError("made up")


def never_ends(_request: PlanRequest, _stop: object) -> Any:
    while True:
        pass


def searches(request: PlanRequest, stop: Callable[[], bool]) -> Any:
    """For as long as it may."""
    while not stop():
        pass
    return request
