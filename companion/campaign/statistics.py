"""What follows from the rows of a campaign: rates, medians, and differences in pairs by seed.

Rates have Wilson intervals, all else bootstrap intervals, of 95 %.  Runs that differ in one thing
alone, in the same world with the same seed, are compared in pairs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, final

import numpy as np
import polars as pl
from scipy.stats import binomtest, bootstrap, wilcoxon

from companion.campaign.file import FactorsTable, Place
from companion.geodesy import FloatArray

CONFIDENCE: Final = 0.95
FEWEST: Final = 6
"""Values for an interval: the range of five holds the median in 93.75 % of draws only."""
TASK: Final = Place._fields
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
    of: pl.Expr
    """Of a row; null: it has none, which counts neither way."""
    unit: str = ""
    digits: int = 1
    """Decimals to show."""
    more_is_better: bool = False
    is_rate: bool = False
    in_percent: bool = True
    """Whether two runs are compared by their ratio; else by their difference, as rates are."""


def _if_arrived(value: pl.Expr) -> pl.Expr:
    """What means something only if the run arrived."""
    return pl.when("arrived").then(value)


_DETOUR: Final = pl.col("length_m") / pl.when(pl.col("straight_m") > 0.0).then("straight_m")
MEASURES: Final = (
    Measure("arrived", "arrived", pl.col("arrived"), "%", 1, True, True, False),
    Measure("violated", "violated a bound", pl.col("violations") > 0, "%", 1, False, True, False),
    Measure("cost", "cost J", _if_arrived(pl.col("cost")), digits=2),
    Measure("detour", "length / straight", _if_arrived(_DETOUR), digits=3),
    Measure("flight_s", "flight time", _if_arrived(pl.col("flight_s")), "s", 0),
    Measure(
        *("clearance_least_m", "least clearance", pl.col("clearance_least_m"), "m"),
        more_is_better=True,
        in_percent=False,
    ),
    Measure("plan_ms_median", "planning time", pl.col("plan_ms_median"), "ms"),
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


def split(rows: pl.DataFrame, by: Sequence[str]) -> dict[str, pl.DataFrame]:
    """Groups of rows by the values of some factors, in words, in the order of the campaign."""
    if not by or rows.is_empty():
        return {} if rows.is_empty() else {"all": rows}
    parts = rows.sort("run").partition_by(by, maintain_order=True, as_dict=True)
    return {
        ", ".join("none" if value is None else str(value) for value in values): runs
        for values, runs in parts.items()
    }


def varying(rows: pl.DataFrame) -> dict[str, int]:
    """The factors that differ between runs, with how many values each has."""
    counts = {factor: rows[factor].n_unique() for factor in FACTORS}
    return {factor: count for factor, count in counts.items() if count > 1}


def _measured(rows: pl.DataFrame) -> pl.DataFrame:
    """Runs by their factors, with every measure in words."""
    measures = (measure.of.cast(pl.Float64).alias(measure.words) for measure in MEASURES)
    return rows.select("run", "seed", *FACTORS, *measures)


def groups(rows: pl.DataFrame, by: Sequence[str]) -> list[Figure]:
    """Every measure of every group, without those that no run of a group has."""
    figures = []
    for group, runs in split(_measured(rows), by).items():
        for measure in MEASURES:
            known = runs[measure.words].drop_nulls().sort().to_numpy()
            if not len(known):
                continue
            if measure.is_rate:
                value, low, high = rate(round(known.sum()), len(known))
            else:
                value, low, high = bootstrapped(np.median, known)
            who: dict[str, Any] = {"by": " × ".join(by), "group": group, "measure": measure}
            figures.append(Figure(**who, n=len(known), value=value, low=low, high=high))
    return figures


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
    interval = bootstrap(
        (values,),
        statistic,
        confidence_level=CONFIDENCE,
        n_resamples=_RESAMPLES,
        batch=max(_AT_ONCE // size, 1),
        method="percentile",
        rng=np.random.default_rng(size),
    )
    low, high = interval.confidence_interval
    return value, float(low), float(high)


# --- pairs


def pairs(rows: pl.DataFrame, by: Sequence[str]) -> tuple[list[Figure], list[str]]:
    """Every group against the first of the campaign -> figures, and what to know of them.

    Two runs are a pair if they have all in common but what parts the groups.  Groups that differ in
    what is flown, and in nothing else, are not compared.
    """
    if set(by) <= set(TASK):
        return [], []
    (first, reference), *others = split(_measured(rows), by).items()
    paired, notes = dict[str, pl.DataFrame](), list[str]()
    for group, runs in others:
        pair = f"{group} against {first}"
        paired[group], along = _paired(reference, runs, by)
        count = len(paired[group])
        alone = len(runs) - count, len(reference) - count
        notes += [
            f"{pair}: {factor} differs with it: either may be the reason." for factor in along
        ]
        if any(alone):
            notes.append(f"{pair}: {alone[0]} and {alone[1]} runs have no partner, or several.")
        if not count:
            notes.append(f"{pair}: nothing to pair, more differs; name that too with --by.")
    figures = []
    for measure in MEASURES:
        differences = {group: _differences(measure, both) for group, both in paired.items()}
        tested = {group: _compared(measure, d) for group, d in differences.items() if len(d)}
        corrected = holm([columns["p"] for columns in tested.values()])
        who: dict[str, Any] = {"by": " × ".join(by), "against": first, "measure": measure}
        for (group, columns), p_holm in zip(tested.items(), corrected, strict=True):
            figures.append(Figure(group=group, p_holm=p_holm, **who, **columns))
    return figures, notes


def _paired(
    reference: pl.DataFrame, other: pl.DataFrame, by: Sequence[str]
) -> tuple[pl.DataFrame, list[str]]:
    """Pairs, a row each, and factors that have one value in each group, and not the same.

    Columns of the other run of a pair end in `_right`.
    """
    kept, along = ["seed"], list[str]()
    for factor in (factor for factor in FACTORS if factor not in by):
        a, b = set(reference[factor]), set(other[factor])
        (along if len(a) == len(b) == 1 and a != b else kept).append(factor)
    single = pl.len().over(kept) == 1
    left, right = reference.filter(single), other.filter(single)
    return left.join(right, on=kept, nulls_equal=True, maintain_order="left"), along


def _differences(measure: Measure, paired: pl.DataFrame) -> FloatArray:
    """By how much the second runs of pairs are above the first, sorted: 0 of those that are alike.

    (N,): of the pairs that both have the measure.
    """
    both = paired.select(measure.words, f"{measure.words}_right").drop_nulls().to_numpy()
    before, after = both[both[:, 0] != 0.0].T if measure.in_percent else both.T
    differences = np.where(np.isclose(before, after, rtol=_SAME, atol=0.0), 0.0, after - before)
    return np.sort(100.0 * differences / np.abs(before) if measure.in_percent else differences)


def _compared(measure: Measure, differences: FloatArray) -> dict[str, Any]:
    """What differences come to; (N,)."""
    more, less, p = int(np.sum(differences > 0.0)), int(np.sum(differences < 0.0)), 1.0
    if more + less and measure.is_rate:
        p = float(binomtest(more, more + less).pvalue)
    elif more + less:
        p = float(wilcoxon(differences[differences != 0.0], method="auto").pvalue)
    value, low, high = bootstrapped(np.mean if measure.is_rate else np.median, differences)
    wins, losses = (more, less) if measure.more_is_better else (less, more)
    columns = {"n": len(differences), "value": value, "low": low, "high": high, "p": p}
    return columns | {"wins": wins, "ties": len(differences) - more - less, "losses": losses}


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down correction, in the order given."""
    order, corrected = np.argsort(p_values), np.empty(len(p_values))
    steps = np.minimum(np.arange(len(order), 0, -1) * np.array(p_values)[order], 1.0)
    corrected[order] = np.maximum.accumulate(steps)
    return [float(p) for p in corrected]
