"""What follows from the rows of a campaign: rates, medians, and differences in pairs by seed.

Rates have Wilson intervals, all else bootstrap intervals, of 95 %.  Runs that differ in one thing
alone, in the same world with the same seed, are compared in pairs.
"""

import warnings
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, final

import numpy as np
from scipy.stats import binomtest, bootstrap, wilcoxon

from companion.campaign.store import Row
from companion.geodesy import FloatArray

CONFIDENCE: Final = 0.95
FEWEST: Final = 6
"""Values for an interval: the range of five holds the median in 93.75 % of draws only."""
TASK: Final = ("world", "family", "family_seed", "family_index", "mission")
"""The factors that say what is to be flown; the others say how."""
FACTORS: Final = (
    *(*TASK, "planner", "knowledge", "optimiser", "profile", "budget", "vehicle", "sensor"),
    *("faults", "wind", "noise"),
)
_RESAMPLES: Final = 2000
_AT_ONCE: Final = 1_000_000  # values that are drawn
_BCA_UP_TO: Final = 1000  # values: its corrections are of the order 1 / n, its effort of n squared
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
    in_short: bool = True
    """Whether it is in the tables of the terminal."""


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
    Measure("arrived", "arrived", lambda r: float(r.arrived), "%", 1, True, True),
    Measure("violated", "violated a bound", _violated, "%", is_rate=True),
    Measure("error", "raised", lambda r: float(r.error is not None), "%", 1, False, True, False),
    Measure("cost", "cost J", _if_arrived("cost"), digits=2),
    Measure("detour", "length / straight", _detour, digits=3),
    Measure("length_m", "length", _if_arrived("length_m"), "m", 0, in_short=False),
    Measure("flight_s", "flight time", _if_arrived("flight_s"), "s", 0, in_short=False),
    Measure("clearance_least_m", "least clearance", lambda r: r.clearance_least_m, "m", 1, True),
    Measure("plan_ms_median", "planning time", lambda r: r.plan_ms_median, "ms"),
)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One number of a report: a measure of a group, or of two groups in pairs.

    Of a group: the share of its runs, or their median.  Of two: by how much the group is above the
    one that it is compared with, in shares or medians.  Fields that do not apply are None.
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
    tenth: float | None = None
    """Exceeded by 90 % of the runs."""
    ninetieth: float | None = None
    """Exceeded by 10 % of the runs."""
    percent: float | None = None
    """Median over the pairs of the difference in per cent of the other one; then its interval."""
    percent_low: float | None = None
    percent_high: float | None = None
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
    return [
        found
        for values, runs in split(rows, by).items()
        for measure in MEASURES
        if (found := _of_group(" × ".join(by), label(values), measure, runs)) is not None
    ]


def _of_group(by: str, name: str, measure: Measure, runs: Sequence[Row]) -> Figure | None:
    values = np.sort([value for row in runs if (value := measure.of(row)) is not None])
    if not len(values):
        return None
    tenth = ninetieth = None
    if measure.is_rate:
        value, low, high = rate(round(sum(values)), len(values))
    else:
        value, low, high = bootstrapped(np.median, values)
        tenth, ninetieth = np.quantile(values, [0.1, 0.9]).tolist()
    return Figure(by=by, group=name, measure=measure, n=len(values), value=value, low=low,
                  high=high, tenth=tenth, ninetieth=ninetieth)  # fmt: skip


def rate(successes: int, runs: int) -> Interval:
    """A share of runs, with the Wilson score interval."""
    low, high = binomtest(successes, runs).proportion_ci(CONFIDENCE, method="wilson")
    return successes / runs, float(low), float(high)


def bootstrapped(statistic: Callable[..., Any], *samples: FloatArray) -> Interval:
    """A statistic of one sample, or of several that are paired, with its bootstrap interval.

    Bias-corrected and accelerated (Efron 1987); by percentiles where that is not defined, or the
    sample is large.  The draws are always the same.  (N,) each.
    """
    size, value = len(samples[0]), float(statistic(*samples))
    if size < FEWEST:
        return value, None, None
    with warnings.catch_warnings(), np.errstate(invalid="ignore", divide="ignore"):
        warnings.simplefilter("ignore")  # a sample without spread has no acceleration
        found = bootstrap(
            samples,
            statistic,
            paired=len(samples) > 1,
            vectorized=True,
            confidence_level=CONFIDENCE,
            n_resamples=_RESAMPLES,
            batch=max(_AT_ONCE // size, 1),
            method="BCa" if size <= _BCA_UP_TO else "percentile",
            rng=np.random.default_rng(size),
        )
    low, high = (float(end) for end in found.confidence_interval)
    if np.isnan(low) or np.isnan(high):
        beyond = 0.5 * (1.0 - CONFIDENCE)
        low, high = np.quantile(found.bootstrap_distribution, [beyond, 1.0 - beyond]).tolist()
    return value, low, high


# --- pairs


def pairs(rows: Iterable[Row], by: Sequence[str]) -> tuple[list[Figure], list[str]]:
    """Every group against the first of the campaign -> figures, and what to know of them.

    Two runs are a pair if they have all in common but what parts the groups.  Groups that differ in
    what is flown, and in nothing else, are not compared.
    """
    if set(by) <= set(TASK):
        return [], []
    (first, reference), *others = split(rows, by).items()
    found, notes = list[Figure](), list[str]()
    for values, runs in others:
        pair = f"{label(values)} against {label(first)}"
        chosen, along = _paired(reference, runs, by)
        notes += [
            f"{pair}: {factor} differs with it: either may be the reason." for factor in along
        ]
        left_out = len(reference) - len(chosen), len(runs) - len(chosen)
        if any(left_out):
            notes.append(
                f"{pair}: {left_out[1]} and {left_out[0]} runs have no partner, or several."
            )
        if not chosen:
            notes.append(f"{pair}: nothing to pair, more differs; name that too with --by.")
        for measure in MEASURES:
            values_of = [(measure.of(a), measure.of(b)) for a, b in chosen]
            known = [(a, b) for a, b in values_of if a is not None and b is not None]
            if known:
                apart = _of_pairs(measure, *np.array(sorted(known)).T)
                place: dict[str, Any] = {
                    "by": " × ".join(by),
                    "group": label(values),
                    "against": label(first),
                }
                found.append(Figure(**place, measure=measure, n=len(known), **apart))
    return [figure for measure in MEASURES for figure in _corrected(found, measure)], notes


def _paired(
    reference: list[Row], other: list[Row], by: Sequence[str]
) -> tuple[list[tuple[Row, Row]], list[str]]:
    """Pairs, and factors that have one value in each group, and not the same."""
    values = {
        factor: [{getattr(row, factor) for row in side} for side in (reference, other)]
        for factor in FACTORS
        if factor not in by
    }
    along = [factor for factor, (a, b) in values.items() if len(a) == len(b) == 1 and a != b]
    kept = ["seed", *(factor for factor in values if factor not in along)]
    ours, theirs = split(reference, kept), split(other, kept)
    both = [(ours[key], theirs[key]) for key in ours if key in theirs]
    return [(a[0], b[0]) for a, b in both if len(a) == len(b) == 1], along


def _of_pairs(measure: Measure, reference: FloatArray, other: FloatArray) -> dict[str, Any]:
    """What the second is against the first; (N,) each."""
    statistic = np.mean if measure.is_rate else np.median
    is_tie = np.isclose(reference, other, rtol=_SAME, atol=0.0)
    apart = np.where(is_tie, 0.0, other - reference)
    more, less = int(np.sum(apart > 0.0)), int(np.sum(apart < 0.0))
    percent: tuple[float | None, ...] = (None, None, None)
    p = 1.0
    if more + less and measure.is_rate:
        p = float(binomtest(more, more + less).pvalue)
    elif more + less:
        p = float(wilcoxon(apart[~is_tie], method="auto").pvalue)
    if not measure.is_rate and reference.all():
        percent = bootstrapped(np.median, np.sort(100.0 * apart / np.abs(reference)))
    value, low, high = bootstrapped(
        lambda a, b, axis=-1: statistic(b, axis=axis) - statistic(a, axis=axis), reference, other
    )
    wins, losses = (more, less) if measure.more_is_better else (less, more)
    names = ("percent", "percent_low", "percent_high")
    found = {"value": value, "low": low, "high": high, "p": p} | dict(
        zip(names, percent, strict=True)
    )
    return found | {"wins": wins, "ties": int(np.sum(is_tie)), "losses": losses}


def _corrected(figures: Iterable[Figure], measure: Measure) -> list[Figure]:
    """Those of a measure, corrected for how many they are."""
    tested = [figure for figure in figures if figure.measure is measure]
    corrected = holm([figure.p or 0.0 for figure in tested])
    return [replace(f, p_holm=p_holm) for f, p_holm in zip(tested, corrected, strict=True)]


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down correction, in the order given."""
    count, corrected, highest = len(p_values), [0.0] * len(p_values), 0.0
    for rank, at in enumerate(sorted(range(count), key=p_values.__getitem__)):
        highest = max(highest, min((count - rank) * p_values[at], 1.0))
        corrected[at] = highest
    return corrected
