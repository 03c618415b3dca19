"""Table 1: four algorithms, two environments, two planning times, twenty runs each (4.2)."""

import itertools
import math
import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, final

import scipy
from rich import box
from rich.table import Table

from companion.paper.compare.missions import Case, Run, bundled_case, planned_with

ALGORITHMS = {
    "improved DE": "improved-de",
    "classical DE": "de/rand/1/bin",
    "PSO": "pso",
    "GA": "ga",
}
ENVIRONMENTS = ("environment-1", "environment-2")
PLANNING_TIMES_S = (3.0, 5.0)  # T
PER_SECOND = 1000
"""Evaluations that stand for a second of T: what interpreted Matlab did in 2011, about."""
_KINDS = {
    "clearance_m": "nearer than d_s",
    "radar_m": "seen by radars",
    "turn_m": "turn",
    "climb_m": "climb",
    "band_m": "altitude",
}
_SURE = 0.05  # significance at which costs count as different,
_LEAST = 0.005  # if their medians differ by this part

PAPERS = {
    ("environment-1", 3.0): ((88.3, 4.9), (97.9, 8.2), (94.4, 8.2), (125.4, 27.4)),
    ("environment-1", 5.0): ((76.6, 3.7), (79.4, 3.7), (84.5, 7.6), (110.7, 16.5)),
    ("environment-2", 3.0): ((123.2, 9.0), (146.0, 18.3), (157.2, 23.3), (166.7, 22.8)),
    ("environment-2", 5.0): ((117.5, 8.0), (123.3, 11.1), (146.7, 27.6), (148.5, 16.4)),
}
"""The paper's mean and standard deviation of the cost, in the order of `ALGORITHMS`."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """The runs of one algorithm in one row of the table."""

    algorithm: str
    runs: tuple[Run, ...]

    @property
    def costs(self) -> list[float]:
        """Of the runs that reached the target: only they have a cost from start to target."""
        return [run.cost for run in self.runs if run.arrived]

    @property
    def deviation(self) -> float:
        """Standard deviation of the costs; not a number with fewer than two."""
        return statistics.stdev(self.costs) if len(self.costs) > 1 else math.nan

    def mean(self, measure: Callable[[Run], float] = lambda run: run.cost) -> float:
        """Mean of a measure over the runs that arrived; not a number when none did."""
        values = [measure(run) for run in self.runs if run.arrived]
        return statistics.fmean(values) if values else math.nan


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Row:
    """The four algorithms on one environment with one budget."""

    environment: str
    planning_time_s: float
    outcomes: tuple[Outcome, ...]

    @property
    def place(self) -> str:
        """How it is headed."""
        return f"{self.environment}, {self.planning_time_s:g} s"

    @property
    def papers(self) -> tuple[tuple[float, float], ...]:
        """The paper's mean and standard deviation of each outcome."""
        return PAPERS[self.environment, self.planning_time_s]

    @property
    def order(self) -> str:
        """The algorithms by mean cost, best first; `~` where the next is not surely worse.

        Those that never arrived come last.
        """
        ranked = sorted(self.outcomes, key=lambda each: (not each.costs, each.mean()))
        words = ranked[0].algorithm
        for better, worse in itertools.pairwise(ranked):
            words += (" < " if surely_less(better, worse) else " ~ ") + worse.algorithm
        return words

    @property
    def papers_order(self) -> str:
        """The paper's order, by its means."""
        return " < ".join(self._papers())

    def agreement(self) -> tuple[int, list[str]]:
        """How many of the paper's six pairs are surely as there, and which surely are not."""
        by_name = {each.algorithm: each for each in self.outcomes}
        confirmed, contradicted = 0, []
        for better, worse in itertools.combinations(self._papers(), 2):
            confirmed += surely_less(by_name[better], by_name[worse])
            if surely_less(by_name[worse], by_name[better]):
                contradicted.append(f"{worse} < {better}")
        return confirmed, contradicted

    def _papers(self) -> list[str]:
        return [algorithm for _, algorithm in sorted(zip(self.papers, ALGORITHMS, strict=True))]


def surely_less(one: Outcome, other: Outcome) -> bool:
    """Whether the costs of one are surely, and noticeably, less than those of the other.

    Mann and Whitney's one-sided test at 5 %, and medians that differ by half a percent.
    """
    if not one.costs or not other.costs:
        return False
    if statistics.median(one.costs) > (1.0 - _LEAST) * statistics.median(other.costs):
        return False
    test = scipy.stats.mannwhitneyu(one.costs, other.costs, alternative="less")
    return bool(test.pvalue < _SURE)


def cases(runs: int, seed: int, per_second: int = PER_SECOND) -> list[Case]:
    """Every mission of the table, row by row, algorithm by algorithm, run by run."""
    worlds = {environment: bundled_case(environment) for environment in ENVIRONMENTS}
    return [
        planned_with(
            worlds[environment],
            optimiser=optimiser,
            planning_time_s=planning_time_s,
            evaluations=round(planning_time_s * per_second),
            seed=seed + run,
        )
        for environment in ENVIRONMENTS
        for planning_time_s in PLANNING_TIMES_S
        for optimiser in ALGORITHMS.values()
        for run in range(runs)
    ]


def rows(flown: Sequence[Run]) -> list[Row]:
    """The table, from the runs of all cases in their order."""
    places = list(itertools.product(ENVIRONMENTS, PLANNING_TIMES_S))
    each, left = len(flown) // (len(places) * len(ALGORITHMS)), iter(flown)
    return [
        Row(
            environment=environment,
            planning_time_s=planning_time_s,
            outcomes=tuple(
                Outcome(algorithm=algorithm, runs=tuple(itertools.islice(left, each)))
                for algorithm in ALGORITHMS
            ),
        )
        for environment, planning_time_s in places
    ]


def table(found: Sequence[Row]) -> Table:
    """Our numbers beside the paper's."""
    title = "Table 1: cost from start to target, mean ± standard deviation"
    result = narrow_table(title, "cost", "paper", "arrived", "length")
    for row in found:
        result.add_row(row.place)
        for outcome, (mean, deviation) in zip(row.outcomes, row.papers, strict=True):
            result.add_row(
                f"  {outcome.algorithm}",
                f"{outcome.mean():.2f} ± {outcome.deviation:.2f}",
                f"{mean:.1f} ± {deviation:.1f}",
                f"{len(outcome.costs)}/{len(outcome.runs)}",
                f"{outcome.mean(lambda run: run.length_m) / 1000:.1f} km",
            )
    return result


def violations_table(found: Sequence[Row]) -> Table:
    """What the routes break when they are looked at every 10 m."""
    title = "Missions that break a bound somewhere, and the mean metres that do"
    result = narrow_table(title, *_KINDS.values())
    for row in found:
        result.add_row(row.place)
        for outcome in row.outcomes:
            broken = violation_facts(outcome.runs).values()
            result.add_row(f"  {outcome.algorithm}", *(_share(**each) for each in broken))
    return result


def _share(missions: float, mean_m: float) -> str:
    return f"{math.ceil(100.0 * missions - 1e-6)}% {mean_m:6,.0f}"


def narrow_table(title: str, *headings: str) -> Table:
    """A table whose cells stay whole in a terminal of 80 columns."""
    result = Table(title=title, box=box.SIMPLE_HEAD, padding=0)
    result.add_column("", no_wrap=True)
    for heading in headings:
        result.add_column(heading, justify="right")
    return result


def remarks(found: Sequence[Row], per_second: int = PER_SECOND) -> list[str]:
    """What the table cannot say by itself: the budget, and whose order it is."""
    budgets = ", ".join(
        f"T = {planning_time_s:g} s is {round(planning_time_s * per_second):,} evaluations"
        for planning_time_s in PLANNING_TIMES_S
    )
    why = ", about what interpreted Matlab did in 2011" if per_second == PER_SECOND else ""
    lines = [
        f"{budgets}: {per_second:,} a second{why}. T also sets L = V T + d_s (eq. 4). "
        "No result depends on the speed of this machine.",
        "<: surely less (Mann-Whitney, 5 %, medians half a percent apart); ~: not surely.",
    ]
    for row in found:
        confirmed, contradicted = row.agreement()
        against = f"; against it: {', '.join(contradicted)}" if contradicted else ""
        lines.append(
            f"{row.place}: {row.order}. The paper: {row.papers_order}. "
            f"{confirmed} of its 6 pairs are surely so here{against}."
        )
    return lines


def facts(found: Sequence[Row], per_second: int = PER_SECOND) -> list[dict[str, Any]]:
    """Everything in the table, and more, for --json; null for what is not a number."""
    return [
        {name: None if value != value else value for name, value in each.items()}
        for row in found
        for each in _facts_of_row(row, per_second)
    ]


def _facts_of_row(row: Row, per_second: int) -> Iterator[dict[str, Any]]:
    best = row.outcomes[0]
    for outcome, (mean, deviation) in zip(row.outcomes, row.papers, strict=True):
        yield {
            "environment": row.environment,
            "planning_time_s": row.planning_time_s,
            "evaluations": round(row.planning_time_s * per_second),
            "algorithm": outcome.algorithm,
            "optimiser": ALGORITHMS[outcome.algorithm],
            "runs": len(outcome.runs),
            "arrived": len(outcome.costs),
            "mean_cost": outcome.mean(),
            "st_dev_cost": outcome.deviation,
            "paper_mean_cost": mean,
            "paper_st_dev_cost": deviation,
            "improved_de_is_surely_less": surely_less(best, outcome),
            "is_surely_less_than_improved_de": surely_less(outcome, best),
            "costs": [run.cost if run.arrived else None for run in outcome.runs],
            "length_m": outcome.mean(lambda run: run.length_m),
            "subpaths": outcome.mean(lambda run: run.legs),
            "violations": violation_facts(outcome.runs),
        }


def violation_facts(runs: Sequence[Run]) -> dict[str, dict[str, float]]:
    """Of each kind of violation the share of missions and the mean metres of route."""
    metres = {kind: [getattr(run.violations, kind) for run in runs] for kind in _KINDS}
    return {
        kind.removesuffix("_m"): {
            "missions": sum(value > 0.0 for value in values) / len(values),
            "mean_m": statistics.fmean(values),
        }
        for kind, values in metres.items()
    }
