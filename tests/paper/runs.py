"""Runs that nobody flew, for what is said of them."""

from typing import Any

import numpy as np

from companion.paper.compare import table_1
from companion.paper.compare.missions import Outcome, Run
from companion.paper.compare.violations import Violations

CLEAN = Violations(clearance_m=0.0, radar_m=0.0, turn_m=0.0, climb_m=0.0, band_m=0.0)
CASES = table_1.cases()


def run(cost: float, aside_m: float = 0.0, **changes: Any) -> Run:
    """A run along the diagonal, bent aside in the middle."""
    at = np.linspace(0.0, 1.0, 101)
    bend = aside_m * np.sin(np.pi * at)
    route = np.stack([1e5 * at + bend, 1e5 * at - bend, 3_500.0 + 0.0 * at], axis=-1)
    values: dict[str, Any] = {
        "arrived": True,
        "cost": cost,
        "legs": 8,
        "length_m": 150_000.0,
        "j": 30.0,
        "took_s": 1.0,
        "route_nea_m": route,
        "scans_nea_m": ((0.0, 0.0, 3_500.0),),
        "violations": CLEAN,
    }
    return Run(**values | changes)


def table(*runs: tuple[Run, ...]) -> list[Outcome]:
    """Table 1, cell by cell; the runs of the last one stand for all that follow."""
    every = [*runs, *[runs[-1]] * (len(CASES) - len(runs))]
    return [Outcome(case=case, runs=each) for case, each in zip(CASES, every, strict=True)]
