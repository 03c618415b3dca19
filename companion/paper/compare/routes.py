"""Planners of whole routes beside ours and the paper's, in the bundled environments."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from companion import extras
from companion.config import load_mission
from companion.paper.compare.missions import Comparison, Outcome, bundled_case
from companion.paper.rivals.routes import PLANNERS
from companion.planning import OURS, planner_of
from companion.profiles import PAPER

ENVIRONMENTS = ("environment-1", "environment-2")
REMARK = (
    "J: length, height and radar of eq. 5 along what was flown; below d_s: metres nearer to the "
    "ground than d_s. All scan as they go; the rivals turn on the spot and climb without limit."
)


def routes(names: Sequence[str] = ()) -> Comparison:
    """Environment by environment, planner by planner; L as a flight needs it, for all alike.

    names: of planners; none: ours, the paper's, and all rivals that are installed.
    """
    ompl = ("rrt-star", "bit-star") if extras.missing("compare") else ()
    installed = [OURS, PAPER.name, *(name for name in PLANNERS if name not in ompl)]
    asked = {name: OURS if name == PAPER.name else name for name in names or installed}
    for name in asked.values():
        planner_of(name, "--planner")  # or says why not
    cases = [
        replace(
            bundled_case(environment),
            label=name,
            planner=planner,
            task=load_mission(environment, name if name == PAPER.name else None).task,
        )
        for environment in ENVIRONMENTS
        for name, planner in asked.items()
    ]
    columns: dict[str, Callable[[Outcome], str]] = {  # means over the runs that arrived
        "J": lambda outcome: f"{outcome.mean('j'):.2f}",
        "length": lambda outcome: f"{outcome.mean('length_m') / 1000:.1f} km",
        "below d_s": lambda outcome: f"{outcome.violations['clearance']['mean_m']:,.0f}",
        "legs": lambda outcome: f"{outcome.mean('legs'):.0f}",
        "arrived": lambda outcome: outcome.arrivals,
        "processor": lambda outcome: f"{outcome.mean('took_s'):.1f} s",
    }
    title = "Planners of whole routes, and planners of subpaths"
    return Comparison(cases=cases, tables={title: columns}, remarks=lambda _: [REMARK])
