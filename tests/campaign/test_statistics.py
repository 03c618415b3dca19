"""What follows from rows: intervals against closed forms and simulation, pairs against counting."""

import itertools
import math
import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from campaign_rows import paired_rows, row
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, t

from companion.campaign.statistics import (
    Comparison,
    Difference,
    bootstrapped,
    compare,
    group,
    holm,
    rate,
    spread,
)

DRAWS = 400


def of(comparison: Comparison, name: str) -> Difference:
    return next(each for each in comparison.differences if each.measure.name == name)


# --- one sample


@given(runs=st.integers(1, 3000), share=st.floats(0.0, 1.0))
def test_the_interval_of_a_rate_holds_the_rates_that_its_score_test_does_not_reject(
    runs: int, share: float
) -> None:
    successes = round(share * runs)
    found = rate(successes, runs)
    assert found.low is not None
    assert found.high is not None
    z = 1.959963984540054
    for end, is_bound in ((found.low, successes > 0), (found.high, successes < runs)):
        if is_bound:  # where (k - n p)^2 = z^2 n p (1 - p)
            apart = (successes - runs * end) ** 2 - z**2 * runs * end * (1.0 - end)
            assert apart == pytest.approx(0.0, abs=1e-6 * runs**2)
        else:
            assert end == pytest.approx(successes / runs, abs=1e-12)


def test_of_no_runs_no_rate_is_known() -> None:
    found = rate(0, 0)
    assert math.isnan(found.value)
    assert (found.low, found.high) == (0.0, 1.0)


@pytest.mark.parametrize("statistic", [np.mean, pytest.param(np.median, marks=pytest.mark.nightly)])
def test_bootstrap_intervals_cover_the_truth_as_often_as_they_say(
    statistic: Callable[..., Any],
) -> None:
    size, rng = 60, np.random.default_rng(11)
    inside = 0
    for _ in range(DRAWS):
        found = bootstrapped(statistic, rng.normal(size=size))
        assert found.low is not None
        assert found.high is not None
        inside += found.low <= 0.0 <= found.high
    # A bootstrap of n values takes z for t and n for n - 1: what that covers is known.
    covers = 1.0 - 2.0 * t.sf(1.96 * math.sqrt((size - 1) / size), size - 1)
    low, high = binom.ppf([0.001, 0.999], DRAWS, [covers - 0.01, 0.96])
    assert low <= inside <= high, inside


@pytest.mark.parametrize("size", [1, 2, 5])
def test_a_handful_of_values_has_no_interval(size: int) -> None:
    found = bootstrapped(np.median, np.arange(float(size)))
    assert (found.low, found.high) == (None, None)


@pytest.mark.parametrize("size", [6, 2000])
def test_values_that_are_all_alike_are_known_exactly(size: int) -> None:
    found = bootstrapped(np.median, np.full(size, 7.0))
    assert (found.value, found.low, found.high) == (7.0, 7.0, 7.0)


def test_a_large_sample_is_drawn_in_parts_and_tells_its_median() -> None:
    values = np.random.default_rng(1).normal(size=4000)
    found = spread(values.tolist())
    assert found is not None
    assert found.median.low is not None
    assert found.median.high is not None
    width = 1.2533 / math.sqrt(4000) * 2 * 1.96  # of a normal median, asymptotically
    assert found.median.high - found.median.low == pytest.approx(width, rel=0.25)


def test_groups_do_not_depend_on_the_order_of_the_rows() -> None:
    rows = paired_rows()
    shuffled = random.Random(3).sample(rows, len(rows))
    assert group((), rows) == group((), shuffled)


# --- pairs


def test_comparisons_do_not_depend_on_the_order_of_the_rows() -> None:
    rows = paired_rows()
    shuffled = random.Random(3).sample(rows, len(rows))
    assert compare(rows, ["optimiser"]) == compare(shuffled, ["optimiser"])


def test_pairs_are_counted_and_their_means_are_the_mean_of_their_differences() -> None:
    rows = paired_rows()
    (found,) = compare(rows, ["optimiser"])
    costs = [(a.cost, b.cost) for a, b in zip(rows[::2], rows[1::2], strict=True)]
    cost = of(found, "cost")
    assert (found.pairs, cost.pairs) == (40, 37)
    apart = np.array([b - a for a, b in costs if a is not None and b is not None])
    assert cost.means.value == pytest.approx(apart.mean())
    assert (cost.wins, cost.ties, cost.losses) == (sum(apart < 0), 0, sum(apart > 0))
    assert cost.is_told
    assert cost.means.high is not None
    assert cost.means.high < 0.0


def test_arrivals_are_compared_by_the_exact_test_of_those_that_differ() -> None:
    arrived = of(compare(paired_rows(), ["optimiser"])[0], "arrived")
    assert (arrived.wins, arrived.ties, arrived.losses) == (0, 37, 3)
    assert arrived.p == pytest.approx(2 * 0.5**3)
    assert not arrived.can_tell


def test_signed_ranks_of_few_pairs_are_those_of_all_signs() -> None:
    apart = [-3.0, -2.5, -2.0, -1.5, 0.5, -1.0, -4.0]
    rows = []
    for seed, difference in enumerate(apart):
        rows.append(row(2 * seed, seed=seed, cost=20.0))
        rows.append(row(2 * seed + 1, seed=seed, budget=6000, cost=20.0 + difference))
    ranks = np.argsort(np.argsort(np.abs(apart))) + 1
    told = min(ranks[np.array(apart) > 0].sum(), ranks[np.array(apart) < 0].sum())
    sums = [
        min(s := sum(r for r, up in zip(ranks, ups, strict=True) if up), ranks.sum() - s)
        for ups in itertools.product([False, True], repeat=len(apart))
    ]
    expected = np.mean([s <= told for s in sums])
    assert of(compare(rows, ["budget"])[0], "cost").p == pytest.approx(expected)


def test_runs_without_a_partner_are_counted_on_their_side() -> None:
    rows = [each for each in paired_rows() if each.run not in (1, 3, 4)]
    (found,) = compare(rows, ["optimiser"])
    assert (found.pairs, found.alone, found.ambiguous) == (37, (2, 1), (0, 0))


def test_runs_with_several_partners_are_left_out_and_counted() -> None:
    rows = paired_rows(10)
    (found,) = compare([*rows, replace(rows[1], run=99)], ["optimiser"])
    assert (found.pairs, found.alone, found.ambiguous) == (9, (0, 0), (1, 2))


def test_what_differs_along_with_a_factor_is_named() -> None:
    rows = paired_rows(8)
    rivals = [
        replace(r, run=100 + r.run, planner="bit-star", optimiser="none")
        for r in rows
        if r.optimiser == "refined-de"
    ]
    ours = [r for r in rows if r.optimiser == "refined-de"]
    (found,) = compare(ours + rivals, ["planner"])
    assert found.entailed == (("optimiser", "refined-de", "none"),)
    assert (found.pairs, of(found, "cost").ties) == (8, 8)


def test_worlds_are_not_compared_in_pairs() -> None:
    rows = [row(0), row(1, world="valley", seed=0)]
    assert compare(rows, ["world"]) == []


@given(st.lists(st.floats(0.0, 1.0), max_size=6))
def test_holm_is_the_closed_test_of_all_intersections_by_bonferroni(p: list[float]) -> None:
    expected = [
        max(
            min(1.0, len(some) * min(p[k] for k in some))
            for size in range(1, len(p) + 1)
            for some in itertools.combinations(range(len(p)), size)
            if at in some
        )
        for at in range(len(p))
    ]
    assert holm(p) == pytest.approx(expected)
