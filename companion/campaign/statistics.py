"""What follows from the rows of a campaign: rates, medians, and differences in pairs by seed.

Rates have Wilson intervals, all else bootstrap intervals, of 95 %.  Runs that differ in one thing
alone, in the same world with the same seed, are compared in pairs.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, final

import numpy as np
from scipy.stats import binomtest, bootstrap, wilcoxon

from companion.campaign.file import FactorsTable
from companion.campaign.store import Row
from companion.geodesy import FloatArray

CONFIDENCE: Final = 0.95
FEWEST: Final = 6
"""Values for an interval: the range of five holds the median in 93.75 % of draws only."""
TASK: Final = ("world", "family", "family_seed", "family_index", "mission")
"""The factors that say what is to be flown; the others say how."""
FACTORS: Final = (*TASK, *FactorsTable.model_fields)
_RESAMPLES: Final = 2000
_AT_ONCE: Final = 1_000_000  # values that are drawn
_SAME: Final = 1e-9  # relative: a tie

Interval = tuple[float, float | None, float | None]
"""An estimate and its 95 % interval; None: too few values for one."""


class Measure(NamedTuple):
    """Something that is compared between runs."""

    name: str
    words: str
    of: Callable[[Row], float | None]
    """Of a run; None: it has none, which counts neither way."""
    unit: str = ""
    digits: int = 1
    """Decimals to show."""
    more_is_better: bool = False
    is_rate: bool = False
    in_percent: bool = True
    """Whether two runs are compared by their ratio; else by their difference, as rates are."""


def _if_arrived(name: str) -> Callable[[Row], float | None]:
    """A column that means something only if the run arrived."""
    return lambda row: getattr(row, name) if row.arrived else None


def _detour(row: Row) -> float | None:
    if not (row.arrived and row.length_m and row.straight_m):
        return None
    return row.length_m / row.straight_m


def _violated(row: Row) -> float | None:
    return None if row.violations is None else float(row.violations > 0)


MEASURES: Final = (
    Measure("arrived", "arrived", lambda r: float(r.arrived), "%", 1, True, True, False),
    Measure("violated", "violated a bound", _violated, "%", 1, False, True, False),
    Measure("cost", "cost J", _if_arrived("cost"), digits=2),
    Measure("detour", "length / straight", _detour, digits=3),
    Measure("flight_s", "flight time", _if_arrived("flight_s"), "s", 0),
    Measure(
        *("clearance_least_m", "least clearance", lambda r: r.clearance_least_m, "m"),
        more_is_better=True,
        in_percent=False,
    ),
    Measure("plan_ms_median", "planning time", lambda r: r.plan_ms_median, "ms"),
)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One number of a report: a measure of a group, or of two groups in pairs.

    Of a group: the share of its runs, or their median.  Of two: the mean of the differences from
    the group that it is compared with, of rates; else their median, in per cent if the measure is.
    Fields that do not apply are None.
    """

    by: str
    """The factors whose values the groups are."""
    group: str
    against: str | None = None
    measure: Measure
    n: int
    """Runs, or pairs, that have it."""
    value: float
    low: float | None
    high: float | None
    wins: int | None = None
    """Pairs in which the group is better."""
    ties: int | None = None
    losses: int | None = None
    p: float | None = None
    """That the two are alike: McNemar's exact test of rates, else Wilcoxon's signed ranks."""
    p_holm: float | None = None
    """Corrected for the comparisons of the same measure with other groups (Holm 1979)."""


# --- groups


def label(values: Iterable[object]) -> str:
    """A group by the values of its factors."""
    return ", ".join("none" if value is None else str(value) for value in values) or "all"


def split(rows: Iterable[Row], by: Sequence[str]) -> dict[tuple[Any, ...], list[Row]]:
    """Rows by the values of some factors, in the order of the campaign."""
    found: dict[tuple[Any, ...], list[Row]] = defaultdict(list)
    for row in sorted(rows, key=lambda row: row.run):
        found[tuple(getattr(row, factor) for factor in by)].append(row)
    return dict(found)


def varying(rows: Sequence[Row]) -> dict[str, int]:
    """The factors that differ between runs, with how many values each has."""
    counts = {factor: len({getattr(row, factor) for row in rows}) for factor in FACTORS}
    return {factor: count for factor, count in counts.items() if count > 1}


def groups(rows: Iterable[Row], by: Sequence[str]) -> list[Figure]:
    """Every measure of every group, without those that no run of a group has."""
    found = []
    for values, runs in split(rows, by).items():
        who: dict[str, Any] = {"by": " × ".join(by), "group": label(values)}
        for measure in MEASURES:
            known = np.sort([value for row in runs if (value := measure.of(row)) is not None])
            if measure.is_rate and len(known):
                value, low, high = rate(round(known.sum()), len(known))
            elif len(known):
                value, low, high = bootstrapped(np.median, known)
            else:
                continue
            who |= {"n": len(known), "value": value, "low": low, "high": high}
            found.append(Figure(measure=measure, **who))
    return found


def rate(successes: int, runs: int) -> Interval:
    """A share of runs, with the Wilson score interval."""
    low, high = binomtest(successes, runs).proportion_ci(CONFIDENCE, method="wilson")
    return successes / runs, float(low), float(high)


def bootstrapped(statistic: Callable[..., Any], values: FloatArray) -> Interval:
    """A statistic of a sample, (N,), with its bootstrap interval by percentiles (Efron 1979).

    Not the bias-corrected one: its acceleration is by a jackknife, which medians have none of.  The
    draws are always the same.
    """
    size, value = len(values), float(statistic(values))
    if size < FEWEST:
        return value, None, None
    found = bootstrap(
        (values,),
        statistic,
        confidence_level=CONFIDENCE,
        n_resamples=_RESAMPLES,
        batch=max(_AT_ONCE // size, 1),
        method="percentile",
        rng=np.random.default_rng(size),
    )
    low, high = found.confidence_interval
    return value, float(low), float(high)


# --- pairs


def pairs(rows: Iterable[Row], by: Sequence[str]) -> tuple[list[Figure], list[str]]:
    """Every group against the first of the campaign -> figures, and what to know of them.

    Two runs are a pair if they have all in common but what parts the groups.  Groups that differ in
    what is flown, and in nothing else, are not compared.
    """
    if set(by) <= set(TASK):
        return [], []
    (first, reference), *others = split(rows, by).items()
    paired, notes = dict[str, list[tuple[Row, Row]]](), list[str]()
    for values, runs in others:
        group, pair = label(values), f"{label(values)} against {label(first)}"
        paired[group], along = _paired(reference, runs, by)
        count = len(paired[group])
        notes += [
            f"{pair}: {factor} differs with it: either may be the reason." for factor in along
        ]
        left_out = len(runs) - count, len(reference) - count
        if any(left_out):
            notes.append(
                f"{pair}: {left_out[0]} and {left_out[1]} runs have no partner, or several."
            )
        if not count:
            notes.append(f"{pair}: nothing to pair, more differs; name that too with --by.")
    found = []
    for measure in MEASURES:
        differences = {group: _apart(measure, chosen) for group, chosen in paired.items()}
        tested = {group: _compared(measure, d) for group, d in differences.items() if len(d)}
        corrected = holm([told["p"] for told in tested.values()])
        who: dict[str, Any] = {"by": " × ".join(by), "against": label(first), "measure": measure}
        for (group, told), p_holm in zip(tested.items(), corrected, strict=True):
            found.append(Figure(group=group, p_holm=p_holm, **who, **told))
    return found, notes


def _paired(
    reference: list[Row], other: list[Row], by: Sequence[str]
) -> tuple[list[tuple[Row, Row]], list[str]]:
    """Pairs, and factors that have one value in each group, and not the same."""
    kept, along = ["seed"], list[str]()
    for factor in (factor for factor in FACTORS if factor not in by):
        a, b = ({getattr(row, factor) for row in side} for side in (reference, other))
        (along if len(a) == len(b) == 1 and a != b else kept).append(factor)
    ours, theirs = split(reference, kept), split(other, kept)
    both = [(ours[key], theirs[key]) for key in ours if key in theirs]
    return [(a[0], b[0]) for a, b in both if len(a) == len(b) == 1], along


def _apart(measure: Measure, chosen: Iterable[tuple[Row, Row]]) -> FloatArray:
    """By how much the second runs of pairs are above the first, sorted: 0 of those that are alike.

    (N,): of the pairs that both have the measure.
    """
    apart = []
    for one, other in chosen:
        before, after = measure.of(one), measure.of(other)
        if before is None or after is None or (measure.in_percent and before == 0.0):
            continue
        by = 0.0 if math.isclose(before, after, rel_tol=_SAME) else after - before
        apart.append(100.0 * by / abs(before) if measure.in_percent else by)
    return np.sort(apart)


def _compared(measure: Measure, apart: FloatArray) -> dict[str, Any]:
    """What differences come to; (N,)."""
    more, less, p = int(np.sum(apart > 0.0)), int(np.sum(apart < 0.0)), 1.0
    if more + less and measure.is_rate:
        p = float(binomtest(more, more + less).pvalue)
    elif more + less:
        p = float(wilcoxon(apart[apart != 0.0], method="auto").pvalue)
    value, low, high = bootstrapped(np.mean if measure.is_rate else np.median, apart)
    wins, losses = (more, less) if measure.more_is_better else (less, more)
    told = {"n": len(apart), "value": value, "low": low, "high": high, "p": p}
    return told | {"wins": wins, "ties": len(apart) - more - less, "losses": losses}


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down correction, in the order given."""
    count, corrected, highest = len(p_values), [0.0] * len(p_values), 0.0
    for rank, at in enumerate(sorted(range(count), key=p_values.__getitem__)):
        highest = max(highest, min((count - rank) * p_values[at], 1.0))
        corrected[at] = highest
    return corrected
