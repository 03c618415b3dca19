import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from runs import CASES, CLEAN, run, table

from companion.paper.compare import table_1
from companion.paper.compare.missions import Outcome


def row(*costs: list[float]) -> list[Outcome]:
    """The four algorithms of the first row."""
    return table(*(tuple(run(cost) for cost in each) for each in costs))[:4]


def test_the_table_is_4_algorithms_on_2_environments_with_2_budgets() -> None:
    settings = [case.task.settings for case in CASES]
    assert len({(case.heading, case.label) for case in CASES}) == len(CASES) == 16
    assert {case.heading for case in CASES} == set(table_1.PAPERS)
    for case, each in zip(CASES, settings, strict=True):
        assert case.heading == f"{case.world}, {each.planning_time_s:g} s"
        assert table_1.ALGORITHMS[case.label] == each.optimiser
    assert {(s.planning_time_s, s.evaluations) for s in settings} == {(3.0, 3000), (5.0, 5000)}
    few = {case.task.settings.evaluations for case in table_1.cases(per_second=200)}
    assert few == {600, 1000}


@given(costs=st.lists(st.floats(1.0, 1e4), min_size=2, max_size=20), lost=st.integers(0, 3))
def test_mean_and_deviation_are_those_of_the_runs_that_arrived(
    costs: list[float], lost: int
) -> None:
    runs = [run(cost) for cost in costs] + [run(1e9, arrived=False)] * lost
    outcome = Outcome(case=CASES[0], runs=tuple(runs))
    assert outcome.mean() == pytest.approx(np.mean(costs))
    assert outcome.deviation == pytest.approx(np.std(costs, ddof=1), abs=1e-9)
    assert outcome.arrivals == f"{len(costs)}/{len(costs) + lost}"


def test_algorithms_are_ordered_by_mean_and_those_that_never_arrive_come_last() -> None:
    found = row([9.0, 9.0], [1.0, 30.0], [5.0, 6.0], [10.0, 11.0])
    assert table_1.order(found) == "PSO ~ improved DE ~ GA ~ classical DE"  # two prove nothing
    lost = replace(found[2], runs=(run(0.1, arrived=False),))
    assert table_1.order([*found[:2], lost, found[3]]).endswith(" ~ PSO")
    assert math.isnan(lost.mean())


def test_the_papers_order_is_that_of_its_text_but_for_one_row_of_its_table() -> None:
    # "The classical DE performs better than PSO and GA": not in environment 1 with T = 3 s
    orders = [table_1.papers_order(each) for each in table_1.rows(table((run(1.0),)))]
    assert orders[0] == ["improved DE", "PSO", "classical DE", "GA"]
    assert orders[1:] == [["improved DE", "classical DE", "PSO", "GA"]] * 3


def test_only_costs_that_lie_apart_are_surely_less() -> None:
    low, high = [100.0 + v for v in range(20)], [150.0 + v for v in range(20)]
    mixed, hair = [v + 0.9 for v in low], [v + 0.4 * (i == 0) for i, v in enumerate(low)]
    a, b, c, d = row(low, high, mixed, hair)
    assert table_1.surely_less(a, b)
    assert not table_1.surely_less(b, a)
    for one, other in itertools.permutations((a, c, d), 2):
        assert not table_1.surely_less(one, other)


@pytest.mark.parametrize(("apart", "counts"), [(1.0, True), (0.1, False)])
def test_a_difference_that_is_sure_but_of_no_size_does_not_count(
    apart: float, counts: bool
) -> None:
    one, other, *_ = row(*([100.0 + 1e-4 * v + k * apart for v in range(20)] for k in range(2)))
    assert table_1.surely_less(one, other) is counts  # 1 %, 0.1 %


def test_the_agreement_with_the_paper_is_counted_in_pairs() -> None:
    # the paper: improved DE < PSO < classical DE < GA in this row
    costs = {"improved DE": 100.0, "classical DE": 140.0, "PSO": 120.0, "GA": 160.0}
    spread = [0.1 * v for v in range(20)]
    same = row(*([cost + v for v in spread] for cost in costs.values()))
    assert table_1.agreement(same) == (6, [])
    assert table_1.order(same) == " < ".join(table_1.papers_order(same))
    other = row(*([cost + v for v in spread] for cost in (costs | {"GA": 90.0}).values()))
    expected = ["GA < improved DE", "GA < PSO", "GA < classical DE"]
    assert table_1.agreement(other) == (3, expected)


def test_violations_are_shares_of_missions_and_means_of_metres() -> None:
    bad = replace(CLEAN, clearance_m=30.0, turn_m=10.0)
    facts = Outcome(case=CASES[0], runs=(run(1.0), run(1.0, violations=bad))).violations
    assert facts["clearance"] == {"missions": 0.5, "mean_m": 15.0}
    assert facts["turn"] == {"missions": 0.5, "mean_m": 5.0}
    assert facts["radar"] == {"missions": 0.0, "mean_m": 0.0}
    assert bad.any
    assert not CLEAN.any


def test_the_numbers_survive_json_even_when_nothing_arrived() -> None:
    found = table((run(1.0, arrived=False), run(2.0, arrived=False)))
    facts = json.loads(json.dumps(table_1.facts(found), allow_nan=False))
    assert len(facts) == 16
    assert facts[0]["costs"] == [None, None]
    assert (facts[0]["paper_mean_cost"], facts[15]["paper_st_dev_cost"]) == (88.3, 16.4)


def test_the_remarks_state_the_budget_and_both_orders() -> None:
    words = "\n".join(table_1.remarks(table((run(1.0), run(2.0)))))
    assert "3,000 evaluations" in words
    assert "improved DE < PSO < classical DE < GA" in words
