"""What is compared: Table 1, Fig. 3 and Fig. 4 (4.1, 4.2), and planners of whole routes."""

import itertools
import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import final

from rich import box
from rich.table import Table

from companion import extras
from companion.campaign.drawn_world import DrawnWorld, bundled
from companion.paper.compare import PER_SECOND
from companion.paper.compare.missions import (
    KINDS,
    ROUND,
    Case,
    Outcome,
    as_published,
    with_settings,
)
from companion.paper.rivals import PLANNERS
from companion.planning import OURS, planner_of
from companion.profiles import PAPER, Weights
from companion.world.radars import Radar
from companion.world.terrain import Peak, PeakTerrain

Row = Callable[[Outcome], dict[str, str]]  # what a table says of an outcome, by its columns


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Cases that are flown, and how what came of them is told."""

    cases: Sequence[Case]
    tables: Mapping[str, Row]  # by their titles
    remarks: Callable[[Sequence[Outcome]], list[str]]  # what the tables cannot say by themselves


def table(title: str, row: Row, every: Sequence[Outcome]) -> Table:
    """A row for each outcome, under its heading; cells stay whole in a terminal of 80 columns."""
    result = Table(title=title, box=box.SIMPLE_HEAD, padding=0)
    result.add_column("", no_wrap=True)
    for name in row(every[0]):
        result.add_column(name, justify="right")
    for heading, outcomes in itertools.groupby(every, lambda outcome: outcome.case.heading):
        result.add_row(heading)
        for outcome in outcomes:
            result.add_row(f"  {outcome.case.label}", *row(outcome).values())
    return result


def _with_budget(environment: str, optimiser: str, time_s: float, per_second: int) -> DrawnWorld:
    """An environment as published, with an optimiser, T, and the evaluations that stand for it."""
    budget = {"planning_time_s": time_s, "evaluations": round(time_s * per_second)}
    return as_published(environment, optimiser=optimiser, **budget)


# --- Table 1: four algorithms, two environments, two planning times, twenty runs each

ALGORITHMS = {
    "improved DE": "improved-de",
    "classical DE": "de/rand/1/bin",
    "PSO": "pso",
    "GA": "ga",
}
PAPERS = {
    ("environment-1", 3.0): ((88.3, 4.9), (97.9, 8.2), (94.4, 8.2), (125.4, 27.4)),
    ("environment-1", 5.0): ((76.6, 3.7), (79.4, 3.7), (84.5, 7.6), (110.7, 16.5)),
    ("environment-2", 3.0): ((123.2, 9.0), (146.0, 18.3), (157.2, 23.3), (166.7, 22.8)),
    ("environment-2", 5.0): ((117.5, 8.0), (123.3, 11.1), (146.7, 27.6), (148.5, 16.4)),
}
"""By environment and T the paper's mean and standard deviation of the cost of `ALGORITHMS`."""
_SURE = 0.05  # significance at which costs count as different,
_LEAST = 0.005  # if their medians differ by this part


def table_1(per_second: int = PER_SECOND) -> Comparison:
    """Four algorithms on two environments with two budgets."""
    cases = [
        Case(
            heading=f"{environment}, {time_s:g} s",
            label=algorithm,
            world=_with_budget(environment, optimiser, time_s, per_second),
            papers_cost=cost,
        )
        for (environment, time_s), costs in PAPERS.items()
        for (algorithm, optimiser), cost in zip(ALGORITHMS.items(), costs, strict=True)
    ]
    tables = {
        "Table 1: cost from start to target, mean ± standard deviation": _costs,
        "Missions that break a bound, and the mean metres that do": _broken,
    }
    remark = (
        f"T = 3 s is {3 * per_second:,} evaluations, T = 5 s is {5 * per_second:,}. T also sets "
        "L = V T + d_s (eq. 4). No result depends on the speed of this machine. <: surely less "
        "(Mann-Whitney, 5 %, medians half a percent apart); ~: not surely."
    )
    return Comparison(
        cases=cases, tables=tables, remarks=lambda outcomes: [remark, *_orders(outcomes)]
    )


def _costs(outcome: Outcome) -> dict[str, str]:
    deviation = statistics.stdev(outcome.costs) if len(outcome.costs) > 1 else math.nan
    return {
        "cost": f"{outcome.mean():.2f} ± {deviation:.2f}",
        "paper": "{:.1f} ± {:.1f}".format(*outcome.case.papers_cost),
        "arrived": outcome.share(),
        "length": f"{outcome.mean('length_m') / 1000:.1f} km",
    }


def _broken(outcome: Outcome) -> dict[str, str]:
    violations = {words: outcome.violated(kind) for kind, words in KINDS.items()}
    return {
        words: f"{math.ceil(100.0 * share - 1e-6)}% {mean_m:6,.0f}"
        for words, (share, mean_m) in violations.items()
    }


def _orders(every: Sequence[Outcome]) -> list[str]:
    """The algorithms by cost, here and in the paper, row by row."""
    lines = []
    for heading, outcomes in itertools.groupby(every, lambda outcome: outcome.case.heading):
        row = sorted(outcomes, key=lambda outcome: outcome.case.papers_cost)
        papers_order = " < ".join(outcome.case.label for outcome in row)
        lines.append(f"{heading}: {order(row)}. The paper: {papers_order}.")
    return lines


def order(row: Sequence[Outcome]) -> str:
    """The algorithms by mean cost, best first; `~` where the next is not surely worse.

    Those that never arrived come last.
    """
    ranked = sorted(row, key=lambda outcome: (not outcome.costs, outcome.mean()))
    words = ranked[0].case.label
    for better, worse in itertools.pairwise(ranked):
        words += (" < " if surely_less(better, worse) else " ~ ") + worse.case.label
    return words


def surely_less(one: Outcome, other: Outcome) -> bool:
    """Whether the costs of one are surely, and noticeably, less than those of the other.

    Mann and Whitney's one-sided test at 5 %, and medians that differ by half a percent.
    """
    if not one.costs or not other.costs:
        return False
    from scipy.stats import mannwhitneyu  # slow to import, and only for this table

    if statistics.median(one.costs) > (1.0 - _LEAST) * statistics.median(other.costs):
        return False
    return bool(mannwhitneyu(one.costs, other.costs, alternative="less").pvalue < _SURE)


# --- Fig. 3 and Fig. 4: what a parameter of the planner decides
#
# In the bundled environments neither effect shows: their mountains on the way rise above the band,
# and their radars are not passed where they overlap.  So each figure has a small world of its own,
# 100 km x 100 km, flown from corner to corner as in the paper.

_T_S = 3.0  # T, for a plan: the budget follows from it
_RANGE_M, _OVERLAP_M, _ASIDE_M = 16_000.0, 2_500.0, 1_000.0  # of the radars; aside of the way
_RIDGE = [Peak(k * 1e3, 100e3 - k * 1e3, 3_900.0, 10_000.0, 10_000.0) for k in (42.0, 50.0, 58.0)]
_HILLS = [
    Peak(88_000.0, 25_000.0, 4_200.0, 6_000.0, 6_000.0),
    Peak(22_000.0, 86_000.0, 4_800.0, 6_000.0, 6_000.0),
    Peak(66_000.0, 92_000.0, 3_400.0, 6_000.0, 6_000.0),
]


def figure_3(per_second: int = PER_SECOND) -> Comparison:
    """Climb over a ridge or go round it, by the weights of height and guide."""
    changed = partial(with_settings, _small_world("ridge", _RIDGE, (), per_second))
    across = "climbs over"
    ends = ((_RIDGE[0].north_m, _RIDGE[0].east_m), (_RIDGE[-1].north_m, _RIDGE[-1].east_m))
    case = partial(Case, heading="environment-1", across=across, between_ne_m=ends)
    low, high = Weights(height=0.15, guide=0.15), Weights(height=0.25, guide=0.05)
    return _effect(
        "Fig. 3: 3D path and vertical profile for two weightings",
        "“UAV can choose climbing or bypassing the mountain by weighing the relative size of a2 "
        "and a3”; it “chooses bypassing the mountains when we increase the proportion of a2”",
        case(label="a2 = 0.15, a3 = 0.15", papers_way=across, world=changed(weights=low)),
        case(label="a2 = 0.25, a3 = 0.05", papers_way=ROUND, world=changed(weights=high)),
    )


def figure_4(per_second: int = PER_SECOND) -> Comparison:
    """Fly between two overlapping radars or round both, by d_overlap."""
    half_m, across = _RANGE_M - 0.5 * _OVERLAP_M, "flies between"
    aside_m = [math.sqrt(0.5) * (_ASIDE_M + side * half_m) for side in (-1.0, 1.0)]
    ends = tuple((50_000.0 - each_m, 50_000.0 + each_m) for each_m in aside_m)
    radars = tuple(
        Radar(name=f"radar {number}", centre_nea_m=(*centre, 0.0), range_m=_RANGE_M)
        for number, centre in enumerate(ends, 1)
    )
    changed = partial(with_settings, _small_world("two radars", _HILLS, radars, per_second))
    case = partial(Case, heading="environment-1", across=across, between_ne_m=ends)
    return _effect(
        "Fig. 4: 3D path for two values of d_overlap",
        "“when the value of d_overlap is small UAV will bypass all radars, otherwise it may "
        "traverse through the intersection of two radars”",
        case(label="d_overlap = 2 km", papers_way=ROUND, world=changed(overlap_m=2_000.0)),
        case(label="d_overlap = 6 km", papers_way=across, world=changed(overlap_m=6_000.0)),
    )


def _small_world(
    name: str, peaks: Sequence[Peak], radars: tuple[Radar, ...], per_second: int
) -> DrawnWorld:
    """A world with the vehicle, the band and the planner of environment-1."""
    base = _with_budget("environment-1", ALGORITHMS["improved DE"], _T_S, per_second)
    terrain = PeakTerrain(peaks=tuple(peaks), ground_amsl_m=0.0)
    return replace(base, name=name, terrain=terrain, task=replace(base.task, radars=radars))


def _effect(title: str, paper: str, *cases: Case) -> Comparison:
    """The ways of the routes, and what the paper says of them."""
    remarks = [
        f"The paper: {paper}.",
        "Length and heights are those of the run of median cost, which the picture shows. Improved "
        f"DE, {cases[0].world.task.settings.evaluations:,} evaluations for T = {_T_S:g} s.",
    ]
    return Comparison(cases=cases, tables={title: _ways}, remarks=lambda _: remarks)


def _ways(outcome: Outcome) -> dict[str, str]:
    shown, way = outcome.shown, outcome.case.papers_way
    return {
        "way": f"{way} {outcome.share(way)}",
        "arrived": outcome.share(),
        "length": f"{shown.length_m / 1000:.1f} km",
        "highest": f"{shown.highest_amsl_m / 1000:.2f} km",
        "seen": f"{shown.violations_m['radar'] / 1000:.1f} km",
    }


# --- planners of whole routes, ours and the paper's

ENVIRONMENTS = ("environment-1", "environment-2")
_ROUTES = (
    "J: length, height and radar of eq. 5 along what was flown; below d_s: metres nearer to the "
    "ground than d_s. All scan as they go; the rivals turn on the spot and climb without limit."
)


def routes(names: Sequence[str] = ()) -> Comparison:
    """Environment by environment, planner by planner; L as a flight needs it, for all alike.

    names: of planners; none: ours, the paper's, and all rivals that are installed.
    """
    absent = {"rrt-star"} if extras.missing("compare") else set()
    installed = [OURS, PAPER.name, *(name for name in PLANNERS if name not in absent)]
    cases = []
    for environment in ENVIRONMENTS:
        for name in dict.fromkeys(names or installed):
            planner, world = name, bundled(environment)
            if name == PAPER.name:
                planner, world = OURS, with_settings(world, profile=PAPER)
            planner_of(planner, "--planner")  # or says why not
            cases.append(Case(heading=environment, label=name, world=world, planner=planner))
    title = "Planners of whole routes, and planners of subpaths"
    return Comparison(cases=cases, tables={title: _means}, remarks=lambda _: [_ROUTES])


def _means(outcome: Outcome) -> dict[str, str]:
    """Over the runs that arrived."""
    return {
        "J": f"{outcome.mean('j'):.2f}",
        "length": f"{outcome.mean('length_m') / 1000:.1f} km",
        "below d_s": f"{outcome.violated('clearance')[1]:,.0f}",
        "arrived": outcome.share(),
        "processor": f"{outcome.mean('plan_s'):.1f} s",
    }
