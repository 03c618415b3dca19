"""What follows from rows: intervals against closed forms and simulation, pairs against counting."""

import itertools
import math
import random

import numpy as np
import pytest
from campaign_rows import paired_rows, row
from hypothesis import given
from hypothesis import strategies as st

from companion.campaign.statistics import Figure, groups, holm, pairs
from companion.campaign.store import table


def of(figures: list[Figure], measure: str) -> Figure:
    return next(figure for figure in figures if figure.measure.name == measure)


def test_a_group_has_its_rates_and_its_medians() -> None:
    values = np.random.default_rng(1).normal(10.0, size=4000)
    rows = [row(n, cost=float(v), arrived=n >= 40) for n, v in enumerate(values)]
    figures = groups(table(rows), ())
    assert figures == groups(table(random.Random(3).sample(rows, len(rows))), ())
    cost, arrived = of(figures, "cost"), of(figures, "arrived")
    assert (cost.group, cost.n, arrived.n, arrived.value) == ("all", 3960, 4000, 0.99)
    for end in (arrived.low, arrived.high):  # where the score test just does not reject it
        assert (0.99 - end) ** 2 == pytest.approx(1.959964**2 * end * (1.0 - end) / 4000)
    assert cost.value == np.median(values[40:])
    width = 1.2533 / math.sqrt(4000) * 2 * 1.96  # of a normal median, asymptotically
    assert cost.high - cost.low == pytest.approx(width, rel=0.25)


def test_pairs_are_counted_and_the_difference_is_their_median_in_per_cent() -> None:
    rows = paired_rows()
    figures, notes = pairs(table(rows), ["optimiser"])
    assert (figures, notes) == pairs(table(random.Random(3).sample(rows, len(rows))), ["optimiser"])
    cost, arrived = of(figures, "cost"), of(figures, "arrived")
    assert (cost.group, cost.against, cost.n, arrived.n) == ("l-shade", "refined-de", 37, 40)
    costs = [(a["cost"], b["cost"]) for a, b in zip(rows[::2], rows[1::2], strict=True)]
    first, second = np.array([both for both in costs if None not in both]).T
    assert cost.value == pytest.approx(100.0 * np.median(second / first - 1.0))
    assert (cost.wins, cost.ties, cost.losses) == (sum(second < first), 0, sum(second > first))
    assert cost.p_holm < 0.05
    assert cost.low < cost.value < cost.high < 0.0
    assert arrived.value == pytest.approx(-3 / 40)
    assert (arrived.wins, arrived.ties, arrived.losses) == (0, 37, 3)
    assert arrived.p == pytest.approx(2 * 0.5**3)


def test_signed_ranks_of_few_pairs_are_those_of_all_signs() -> None:
    apart = [-3.0, -2.5, -2.0, -1.5, 0.5, -1.0, -4.0]
    rows = [row(2 * seed, seed=seed, cost=20.0) for seed in range(len(apart))]
    for seed, by in enumerate(apart):
        rows.append(row(2 * seed + 1, seed=seed, budget=6000, cost=20.0 + by))
    ranks = np.argsort(np.argsort(np.abs(apart))) + 1

    def statistic(ups: tuple[bool, ...]) -> float:
        up = float(ranks[list(ups)].sum())
        return min(up, ranks.sum() - up)

    told = statistic(tuple(by > 0 for by in apart))
    every = [statistic(ups) for ups in itertools.product([False, True], repeat=len(apart))]
    expected = np.mean([each <= told for each in every])
    assert of(pairs(table(rows), ["budget"])[0], "cost").p == pytest.approx(expected)


def test_runs_without_a_partner_and_what_differs_along_with_a_factor_are_told() -> None:
    rows = [each for each in paired_rows() if each["run"] not in (1, 3, 4)]
    figures, notes = pairs(table([*rows, rows[-1] | {"run": 99}]), ["optimiser"])
    assert of(figures, "arrived").n == 36
    assert notes == ["l-shade against refined-de: 3 and 3 runs have no partner, or several."]
    ours = paired_rows(8)[::2]
    other = {"planner": "bit-star", "optimiser": "none"}
    rivals = [each | other | {"run": 100 + each["run"]} for each in ours]
    figures, notes = pairs(table(ours + rivals), ["planner"])
    assert notes == ["bit-star against ours: optimiser differs with it: either may be the reason."]
    assert of(figures, "cost").ties == 8


@given(st.lists(st.floats(0.0, 1.0), max_size=6))
def test_holm_is_the_closed_test_of_all_intersections_by_bonferroni(p: list[float]) -> None:
    every = range(len(p))
    some = [each for n in every for each in itertools.combinations(every, n + 1)]
    least = {each: min(1.0, len(each) * min(p[k] for k in each)) for each in some}
    expected = [max(least[each] for each in some if at in each) for at in every]
    assert holm(p) == pytest.approx(expected)
