"""Planners of whole routes beside ours and the paper's, in the bundled environments."""

from collections.abc import Sequence
from dataclasses import replace

from rich.table import Table

from companion import extras
from companion.config import load_mission
from companion.paper.compare.missions import Case, Outcome, add_rows, bundled_case, narrow_table
from companion.paper.compare.table_1 import ENVIRONMENTS
from companion.paper.rivals.routes import PLANNERS
from companion.planning import OURS, planner_of
from companion.profiles import PAPER

REMARK = (
    "J: length, height and radar of eq. 5 along what was flown; below d_s: metres nearer to the "
    "ground than d_s. All scan as they go; the rivals turn on the spot and climb without limit."
)


def installed() -> list[str]:
    """The names of all planners that can be asked for here: ours, the paper's, the rivals."""
    ompl = ("rrt-star", "bit-star") if extras.missing("compare") else ()
    return [OURS, PAPER.name, *(name for name in PLANNERS if name not in ompl)]


def cases(names: Sequence[str]) -> list[Case]:
    """Environment by environment, planner by planner; L as a flight needs it, for all alike."""
    asked = {name: OURS if name == PAPER.name else name for name in names}
    for name in asked.values():
        planner_of(name, "--planner")  # or says why not
    return [
        replace(
            bundled_case(environment),
            label=name,
            planner=planner,
            task=load_mission(environment, name if name == PAPER.name else None).task,
        )
        for environment in ENVIRONMENTS
        for name, planner in asked.items()
    ]


def table(found: Sequence[Outcome]) -> Table:
    """Means over the runs that arrived."""

    def cells(outcome: Outcome) -> list[str]:
        return [
            f"{outcome.mean(lambda run: run.j):.2f}",
            f"{outcome.mean(lambda run: run.length_m) / 1000:.1f} km",
            f"{outcome.violations['clearance']['mean_m']:,.0f}",
            f"{outcome.mean(lambda run: run.legs):.0f}",
            outcome.arrivals,
            f"{outcome.mean(lambda run: run.took_s):.1f} s",
        ]

    title = "Planners of whole routes, and planners of subpaths"
    headings = ("J", "length", "below d_s", "legs", "arrived", "processor")
    return add_rows(narrow_table(title, *headings), found, cells)
