"""Table 1: four algorithms, two environments, two planning times, twenty runs each (4.2)."""

import itertools
import math
import statistics
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from scipy.stats import mannwhitneyu

from companion.paper.compare.missions import Comparison, Outcome, bundled_case, by_heading
from companion.paper.compare.violations import KINDS

ALGORITHMS = {
    "improved DE": "improved-de",
    "classical DE": "de/rand/1/bin",
    "PSO": "pso",
    "GA": "ga",
}
PER_SECOND = 1000
"""Evaluations that stand for a second of T: what interpreted Matlab did in 2011, about."""
_SURE = 0.05  # significance at which costs count as different,
_LEAST = 0.005  # if their medians differ by this part

PAPERS = {
    ("environment-1", 3.0): ((88.3, 4.9), (97.9, 8.2), (94.4, 8.2), (125.4, 27.4)),
    ("environment-1", 5.0): ((76.6, 3.7), (79.4, 3.7), (84.5, 7.6), (110.7, 16.5)),
    ("environment-2", 3.0): ((123.2, 9.0), (146.0, 18.3), (157.2, 23.3), (166.7, 22.8)),
    ("environment-2", 5.0): ((117.5, 8.0), (123.3, 11.1), (146.7, 27.6), (148.5, 16.4)),
}
"""By environment and T the paper's mean and standard deviation of the cost of `ALGORITHMS`."""


def table_1(per_second: int = PER_SECOND) -> Comparison:
    """Table 1: improved DE, classical DE, PSO and GA on two environments with two budgets."""

    def broken(outcome: Outcome, kind: str) -> str:
        of_kind = outcome.violations[kind]
        return f"{math.ceil(100.0 * of_kind['missions'] - 1e-6)}% {of_kind['mean_m']:6,.0f}"

    cases = [
        replace(
            bundled_case(environment).planned_with(
                optimiser=optimiser,
                planning_time_s=planning_time_s,
                evaluations=round(planning_time_s * per_second),
            ),
            heading=f"{environment}, {planning_time_s:g} s",
            label=algorithm,
            papers_cost=papers_cost,
        )
        for (environment, planning_time_s), papers_costs in PAPERS.items()
        for (algorithm, optimiser), papers_cost in zip(
            ALGORITHMS.items(), papers_costs, strict=True
        )
    ]
    return Comparison(
        cases=cases,
        tables={
            "Table 1: cost from start to target, mean ± standard deviation": {
                "cost": lambda outcome: f"{outcome.mean():.2f} ± {outcome.deviation:.2f}",
                "paper": lambda outcome: "{:.1f} ± {:.1f}".format(*outcome.case.papers_cost),
                "arrived": lambda outcome: outcome.arrivals,
                "length": lambda outcome: f"{outcome.mean('length_m') / 1000:.1f} km",
            },
            "Missions that break a bound somewhere, and the mean metres that do": {
                words: partial(broken, kind=kind) for kind, words in KINDS.items()
            },
        },
        remarks=partial(remarks, per_second=per_second),
        more=lambda outcome: dict(
            zip(("paper_mean_cost", "paper_st_dev_cost"), outcome.case.papers_cost, strict=True)
        ),
    )


def remarks(found: Sequence[Outcome], per_second: int) -> list[str]:
    """The budget, and whose order it is."""
    budgets = ", ".join(
        f"T = {time_s:g} s is {round(time_s * per_second):,} evaluations"
        for time_s in dict.fromkeys(time_s for _, time_s in PAPERS)
    )
    usual = per_second == PER_SECOND
    why = ", about what interpreted Matlab did in 2011" if usual else ""
    lines = [
        f"{budgets}: {per_second:,} a second{why}. T also sets L = V T + d_s (eq. 4). "
        "No result depends on the speed of this machine.",
        "<: surely less (Mann-Whitney, 5 %, medians half a percent apart); ~: not surely.",
    ]
    for row in by_heading(found):
        papers_order = " < ".join(outcome.case.label for outcome in by_the_paper(row))
        confirmed, contradicted = agreement(row)
        against = f"; against it: {', '.join(contradicted)}" if contradicted else ""
        lines.append(
            f"{row[0].case.heading}: {order(row)}. The paper: {papers_order}. "
            f"{confirmed} of its 6 pairs are surely so here{against}."
        )
    return lines


def order(row: Sequence[Outcome]) -> str:
    """The algorithms by mean cost, best first; `~` where the next is not surely worse.

    Those that never arrived come last.
    """
    ranked = sorted(row, key=lambda each: (not each.costs, each.mean()))
    words = ranked[0].case.label
    for better, worse in itertools.pairwise(ranked):
        words += (" < " if surely_less(better, worse) else " ~ ") + worse.case.label
    return words


def by_the_paper(row: Sequence[Outcome]) -> list[Outcome]:
    """In the paper's order, by its means."""
    return sorted(row, key=lambda outcome: outcome.case.papers_cost)


def agreement(row: Sequence[Outcome]) -> tuple[int, list[str]]:
    """How many of the paper's six pairs are surely as there, and which surely are not."""
    confirmed, contradicted = 0, []
    for better, worse in itertools.combinations(
        sorted(row, key=lambda each: each.case.papers_cost), 2
    ):
        confirmed += surely_less(better, worse)
        if surely_less(worse, better):
            contradicted.append(f"{worse.case.label} < {better.case.label}")
    return confirmed, contradicted


def surely_less(one: Outcome, other: Outcome) -> bool:
    """Whether the costs of one are surely, and noticeably, less than those of the other.

    Mann and Whitney's one-sided test at 5 %, and medians that differ by half a percent.
    """
    if not one.costs or not other.costs:
        return False
    if statistics.median(one.costs) > (1.0 - _LEAST) * statistics.median(other.costs):
        return False
    return bool(mannwhitneyu(one.costs, other.costs, alternative="less").pvalue < _SURE)
