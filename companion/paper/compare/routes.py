"""Planners of whole routes beside ours and the paper's, in the bundled environments."""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from rich.table import Table

from companion import extras
from companion.config import load_mission
from companion.library import route_terms
from companion.paper.compare.missions import Case, bundled_case, flown
from companion.paper.compare.table_1 import ENVIRONMENTS, narrow_table
from companion.paper.compare.violations import peak_distance_m
from companion.paper.rivals.routes import PLANNERS
from companion.planning import OURS, planner_of
from companion.profiles import PAPER, PROFILES

REMARK = (
    "J: length, height and radar of eq. 5 along what was flown. Nearest: to the ground, to first "
    "order, by d_s. All scan as they go; the rivals turn on the spot and climb without limit."
)
_SPACING_M = 20.0


def installed() -> list[str]:
    """The names of all planners that can be asked for here: ours, the paper's, the rivals."""
    ompl = ("rrt-star", "bit-star") if extras.missing("compare") else ()
    return [OURS, PAPER.name, *(name for name in PLANNERS if name not in ompl)]


def cases(names: Sequence[str], runs: int, seed: int) -> list[tuple[str, Case]]:
    """Every mission: environment by environment, planner by planner, run by run."""
    return [
        (name, replace(_case(environment, name), seed=seed + run))
        for environment in ENVIRONMENTS
        for name in names
        for run in range(runs)
    ]


def _case(environment: str, name: str) -> Case:
    """An environment as its mission has it; L as a flight needs it, for all alike."""
    if name not in (OURS, PAPER.name):
        planner_of(name, "--planner")  # or says why not
    profile = name if name in PROFILES else None
    return replace(bundled_case(environment), task=load_mission(environment, profile).task)


def fly(case: tuple[str, Case]) -> dict[str, Any]:
    """Fly one: a row of the table."""
    name, at = case
    began_s = time.process_time()
    flight = flown(at, planner_of(OURS if name == PAPER.name else name))
    took_s = time.process_time() - began_s
    points = flight.route_nea_m(_SPACING_M)
    return {
        "environment": at.world,
        "planner": name,
        "seed": at.seed,
        "arrived": flight.failure is None,
        "cost": sum(route_terms(points, at.task).values()),
        "length_m": sum(flight.flown_m),
        "nearest": float(
            peak_distance_m(points, at.terrain).min() / at.task.settings.safety_distance_m
        ),
        "legs": len(flight.legs),
        "processor_s": took_s,
    }


def table(found: Sequence[dict[str, Any]]) -> Table:
    """A line for each flight."""
    title = "Planners of whole routes, and planners of subpaths"
    result = narrow_table(title, "J", "length", "nearest", "legs", "processor")
    for environment in ENVIRONMENTS:
        result.add_row(environment)
        for each in (each for each in found if each["environment"] == environment):
            result.add_row(
                f"  {each['planner']}" + ("" if each["arrived"] else " (did not arrive)"),
                f"{each['cost']:.2f}",
                f"{each['length_m'] / 1000:.1f} km",
                f"{each['nearest']:.2f}",
                str(each["legs"]),
                f"{each['processor_s']:.1f} s",
            )
    return result
