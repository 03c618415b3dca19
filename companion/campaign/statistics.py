"""What follows from the rows of a campaign, and what does not: rates, costs, pairs by seed.

Rates have Wilson intervals, medians and means bootstrap intervals, all of 95 %.  Runs that differ
in one thing alone, in the same world with the same seed, are compared in pairs.
"""

import warnings
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Final, Literal, final

import numpy as np
from scipy.stats import binomtest, bootstrap, wilcoxon

from companion.campaign.row import Row
from companion.geodesy import FloatArray

CONFIDENCE: Final = 0.95
ALPHA: Final = 1.0 - CONFIDENCE
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

Label = tuple[str | int | None, ...]
"""The values of the factors of a group."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """An estimate and its 95 % interval; None: too few values for one."""

    value: float
    low: float | None = None
    high: float | None = None

    def over(self, scale: float) -> "Interval":
        """All three divided."""
        low, high = (None if end is None else end / scale for end in (self.low, self.high))
        return Interval(value=self.value / scale, low=low, high=high)


@final
@dataclass(frozen=True, slots=True)
class Measure:
    """Something that is compared between runs."""

    name: str
    words: str
    of: Callable[[Row], float | None] | None = None
    """None: the column of its name."""
    unit: str = ""
    digits: int = 0
    """Decimals to show."""
    in_short: bool = False
    """Whether it is in the tables of the terminal, as rates are."""
    better: Literal["less", "more"] = "less"
    is_rate: bool = False
    arrived_only: bool = False
    """Whether it means something only if the run arrived."""

    def value(self, row: Row) -> float | None:
        """That of a run; None: it has none."""
        if self.arrived_only and not row.arrived:
            return None
        value: float | None = getattr(row, self.name) if self.of is None else self.of(row)
        return value


def _violated(row: Row) -> float | None:
    return None if row.violations is None else float(row.violations > 0)


def _detour(row: Row) -> float | None:
    return row.length_m / row.straight_m if row.length_m and row.straight_m else None


MEASURES: Final = (
    Measure("arrived", "arrived", lambda row: float(row.arrived), better="more", is_rate=True),
    Measure("violated", "violated a bound", _violated, is_rate=True),
    Measure("cost", "cost J", digits=2, in_short=True, arrived_only=True),
    Measure("detour", "length / straight", _detour, digits=3, in_short=True, arrived_only=True),
    Measure("length_m", "length", unit="m", arrived_only=True),
    Measure("flight_s", "flight time", unit="s", arrived_only=True),
    Measure(
        "clearance_least_m", "least clearance", unit="m", digits=1, in_short=True, better="more"
    ),
    Measure("plan_ms_median", "planning time", unit="ms", digits=1, in_short=True),
)
RATES: Final = tuple(measure for measure in MEASURES if measure.is_rate)
SIZES: Final = tuple(measure for measure in MEASURES if not measure.is_rate)


# --- one sample


def rate(successes: int, runs: int) -> Interval:
    """A share of runs, with the Wilson score interval; of no runs, nothing is known."""
    if runs == 0:
        return Interval(value=float("nan"), low=0.0, high=1.0)
    low, high = binomtest(successes, runs).proportion_ci(CONFIDENCE, method="wilson")
    return Interval(value=successes / runs, low=float(low), high=float(high))


def _median(values: FloatArray, axis: int = -1) -> FloatArray:
    return np.asarray(np.median(values, axis=axis))


def _mean(values: FloatArray, axis: int = -1) -> FloatArray:
    return np.asarray(np.mean(values, axis=axis))


def _between(statistic: Callable[..., FloatArray]) -> Callable[..., FloatArray]:
    def difference(reference: FloatArray, other: FloatArray, axis: int = -1) -> FloatArray:
        return np.asarray(statistic(other, axis=axis) - statistic(reference, axis=axis))

    return difference


def bootstrapped(statistic: Callable[..., FloatArray], *samples: FloatArray) -> Interval:
    """A statistic of one sample, or of several that are paired, with its bootstrap interval.

    Bias-corrected and accelerated (Efron 1987); by percentiles where that is not defined, or the
    sample is large.  The draws are always the same.  (N,) each.
    """
    size, value = len(samples[0]), float(statistic(*samples))
    if size < FEWEST:
        return Interval(value=value)
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
        ends = np.quantile(found.bootstrap_distribution, [ALPHA / 2.0, 1.0 - ALPHA / 2.0])
        low, high = ends.tolist()
    return Interval(value=value, low=low, high=high)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """How a measure is distributed over the runs of a group."""

    runs: int
    median: Interval
    mean: Interval
    tenth: float
    """Exceeded by 90 % of them."""
    ninetieth: float
    """Exceeded by 10 % of them."""


def spread(values: Sequence[float]) -> Spread | None:
    """The distribution of some values, in whatever order; None: there are none."""
    if not values:
        return None
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    tenth, ninetieth = np.quantile(ordered, [0.1, 0.9]).tolist()
    return Spread(
        runs=len(ordered),
        median=bootstrapped(_median, ordered),
        mean=bootstrapped(_mean, ordered),
        tenth=tenth,
        ninetieth=ninetieth,
    )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """The runs that have some factors in common."""

    label: Label
    runs: int
    errors: int
    """Runs that raised; they count as not arrived."""
    rates: dict[str, tuple[Interval, int]]
    """Measure -> share, and of how many runs."""
    spreads: dict[str, Spread | None]
    """Measure -> its distribution; None: no run has it."""


def group(label: Label, rows: Sequence[Row]) -> Group:
    """Rates and distributions of some runs."""

    def values(measure: Measure) -> list[float]:
        found = (measure.value(row) for row in rows)
        return [value for value in found if value is not None]

    shares = {measure.name: values(measure) for measure in RATES}
    return Group(
        label=label,
        runs=len(rows),
        errors=sum(row.error is not None for row in rows),
        rates={k: (rate(round(sum(v)), len(v)), len(v)) for k, v in shares.items()},
        spreads={measure.name: spread(values(measure)) for measure in SIZES},
    )


def split(rows: Iterable[Row], by: Sequence[str]) -> dict[Label, list[Row]]:
    """Rows by the values of some factors, in the order of the campaign."""
    found: dict[Label, list[Row]] = defaultdict(list)
    for row in sorted(rows, key=attrgetter("run")):
        found[tuple(getattr(row, factor) for factor in by)].append(row)
    return dict(found)


def varying(rows: Sequence[Row]) -> dict[str, int]:
    """The factors that differ between runs, with how many values each has."""
    counts = {factor: len({getattr(row, factor) for row in rows}) for factor in FACTORS}
    return {factor: count for factor, count in counts.items() if count > 1}


# --- two samples, in pairs


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """A measure of the other runs less that of their partners."""

    measure: Measure
    pairs: int
    """In which both have a value."""
    reference: float
    """Median of the reference; its mean if it is a rate."""
    medians: Interval
    """Difference of the medians; of the means if it is a rate."""
    means: Interval
    relative: Interval | None
    """Median over the pairs of the difference as a share of the reference; None: of a rate."""
    wins: int
    """Pairs in which the other one is better."""
    ties: int
    losses: int
    p: float
    """That the two are alike: McNemar's exact test of rates, else Wilcoxon's signed ranks."""
    p_holm: float = 1.0
    """Corrected for the comparisons of the same measure (Holm 1979)."""
    tests: int = 1
    """How many those are."""

    @property
    def can_tell(self) -> bool:
        """Whether p could fall below 5 % if all pairs that differ pointed the same way."""
        return self.tests * 2.0 ** (1 - self.wins - self.losses) < ALPHA

    @property
    def is_told(self) -> bool:
        """Whether the two differ."""
        return self.p_holm < ALPHA


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Two groups, compared in the pairs that differ in nothing but what parts the groups."""

    by: tuple[str, ...]
    reference: Label
    other: Label
    entailed: tuple[tuple[str, str | int | None, str | int | None], ...]
    """Factors that have one value in each group, and not the same: they cannot be told apart."""
    pairs: int
    alone: tuple[int, int]
    """Runs without a partner, of the reference and of the other."""
    ambiguous: tuple[int, int]
    """Runs that have several: what else they differ in is not known."""
    differences: tuple[Difference, ...]


def compare(rows: Sequence[Row], by: Sequence[str]) -> list[Comparison]:
    """Every group against the first of the campaign; of factors of the task alone, nothing."""
    if set(by) <= set(TASK):
        return []
    (first, reference), *others = split(rows, by).items()
    found = [_compared(tuple(by), first, reference, label, runs) for label, runs in others]
    corrected = dict[tuple[int, str], Difference]()
    for measure in MEASURES:
        tested = [
            (at, each)
            for at, comparison in enumerate(found)
            for each in comparison.differences
            if each.measure is measure
        ]
        for (at, each), p_holm in zip(tested, holm([e.p for _, e in tested]), strict=True):
            corrected[at, measure.name] = replace(each, p_holm=p_holm, tests=len(tested))
    return [
        replace(c, differences=tuple(corrected[at, d.measure.name] for d in c.differences))
        for at, c in enumerate(found)
    ]


def _compared(
    by: tuple[str, ...], first: Label, reference: list[Row], second: Label, other: list[Row]
) -> Comparison:
    entailed = []
    for factor in (factor for factor in FACTORS if factor not in by):
        ours, theirs = ({getattr(row, factor) for row in side} for side in (reference, other))
        if len(ours) == len(theirs) == 1 and ours != theirs:
            entailed.append((factor, ours.pop(), theirs.pop()))
    apart = {*by, *(factor for factor, *_ in entailed)}
    kept = ["seed", *(factor for factor in FACTORS if factor not in apart)]
    sides = split(reference, kept), split(other, kept)
    common = sides[0].keys() & sides[1].keys()
    chosen = {key for key in common if all(len(side[key]) == 1 for side in sides)}
    pairs = [(sides[0][key][0], sides[1][key][0]) for key in sides[0] if key in chosen]
    tried = (_difference(measure, pairs) for measure in MEASURES)
    return Comparison(
        by=by,
        reference=first,
        other=second,
        entailed=tuple(entailed),
        pairs=len(pairs),
        alone=_count(sides, lambda key: key not in common),
        ambiguous=_count(sides, lambda key: key in common and key not in chosen),
        differences=tuple(each for each in tried if each is not None),
    )


def _count(
    sides: tuple[dict[Label, list[Row]], dict[Label, list[Row]]], wanted: Callable[[Label], bool]
) -> tuple[int, int]:
    first, second = (sum(len(s[key]) for key in s if wanted(key)) for s in sides)
    return first, second


def _difference(measure: Measure, pairs: Sequence[tuple[Row, Row]]) -> Difference | None:
    """None: in no pair have both a value."""
    values = [(measure.value(ours), measure.value(theirs)) for ours, theirs in pairs]
    known = [(a, b) for a, b in values if a is not None and b is not None]
    if not known:
        return None
    reference, other = np.array(sorted(known)).T
    ties = np.isclose(reference, other, rtol=_SAME, atol=0.0)
    apart = np.where(ties, 0.0, other - reference)
    wins = int(np.sum(apart > 0.0 if measure.better == "more" else apart < 0.0))
    losses = int(np.sum(~ties)) - wins
    if wins + losses == 0:
        p = 1.0
    elif measure.is_rate:
        p = float(binomtest(wins, wins + losses).pvalue)
    else:
        p = float(wilcoxon(apart[~ties], method="auto").pvalue)
    means = bootstrapped(_between(_mean), reference, other)
    return Difference(
        measure=measure,
        pairs=len(known),
        reference=float((_mean if measure.is_rate else _median)(reference)),
        medians=means if measure.is_rate else bootstrapped(_between(_median), reference, other),
        means=means,
        relative=None
        if measure.is_rate or not reference.all()
        else bootstrapped(_median, np.sort(apart / np.abs(reference))),
        wins=wins,
        ties=int(np.sum(ties)),
        losses=losses,
        p=p,
    )


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down correction, in the order given."""
    count, corrected, highest = len(p_values), [0.0] * len(p_values), 0.0
    for rank, at in enumerate(sorted(range(count), key=p_values.__getitem__)):
        highest = max(highest, min((count - rank) * p_values[at], 1.0))
        corrected[at] = highest
    return corrected
