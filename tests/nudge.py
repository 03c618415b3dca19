"""Another processor, as far as a decision can tell: every position is off by up to a micrometre.

The last digits of what is computed differ between processors (kernels of OpenBLAS, glibc, LLVM).
What hangs on them is found by moving what it is computed from (fixture `nudge`, tests/conftest.py).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from renewed import replace

from companion.mission import machine
from companion.planner import plan as planning
from companion.planner.request import PlanRequest

MOST_M = 1e-6
SEEDS = tuple(range(10))


def nudged(place_m: Any, seed: int) -> tuple[float, ...]:
    """A place, off by up to a micrometre along each axis; the same place always by the same."""
    places = tuple(float(at) for at in place_m)
    bits = hash((seed, *places))  # of numbers: the same in every process
    shares = [((bits >> 16 * k) & 0xFFFF) / 32767.5 - 1.0 for k in range(len(places))]
    return tuple(at + MOST_M * share for at, share in zip(places, shares, strict=True))


@contextmanager
def nudged_positions(seed: int) -> Iterator[None]:
    """The mission machine hears of every position a little beside it."""
    exact = machine.step

    def step(state: Any, event: Any, context: Any) -> Any:
        place = getattr(event, "position_nea_m", None)
        if place is not None:
            event = replace(event, position_nea_m=nudged(place, seed))
        return exact(state, event, context)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine, "step", step)
        yield


@contextmanager
def nudged_questions(module: Any, seed: int) -> Iterator[None]:
    """The planner, as a module of tests knows it, is asked a little beside where it was asked."""
    exact = planning.plan

    def plan(request: PlanRequest, *arguments: Any, **keywords: Any) -> Any:
        start = request.start
        place = np.array(nudged(start.position_nea_m, seed))
        aside = replace(
            request,
            start=replace(start, position_nea_m=place),
            scan_nea_m=nudged(request.scan_nea_m, seed),
            target_ne_m=nudged(request.target_ne_m, seed),
        )
        return exact(aside, *arguments, **keywords)

    with pytest.MonkeyPatch.context() as patch:
        if getattr(module, "plan", None) is exact:
            patch.setattr(module, "plan", plan)
        yield
