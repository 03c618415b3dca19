import itertools
import json
import math
import statistics
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.paper.compare import table_1
from companion.paper.compare.missions import Run
from companion.paper.compare.violations import Violations

CLEAN = Violations(
    clearance_m=0.0,
    radar_m=0.0,
    turn_m=0.0,
    climb_m=0.0,
    band_m=0.0,
)


def run(cost: float, *, arrived: bool = True, violations: Violations = CLEAN) -> Run:
    return Run(
        arrived=arrived,
        cost=cost,
        legs=8,
        length_m=150_000.0,
        route_nea_m=np.zeros((2, 3)),
        scans_nea_m=(),
        violations=violations,
    )


def row(*costs: list[float]) -> table_1.Row:
    return table_1.Row(
        environment="environment-1",
        planning_time_s=3.0,
        outcomes=tuple(
            table_1.Outcome(algorithm=algorithm, runs=tuple(run(cost) for cost in each))
            for algorithm, each in zip(table_1.ALGORITHMS, costs, strict=True)
        ),
    )


def test_the_table_is_4_algorithms_on_2_environments_with_2_budgets_20_times() -> None:
    cases = table_1.cases(20, 1)
    assert len(cases) == 4 * 2 * 2 * 20
    keys = {(c.world, c.task.settings.optimiser, c.task.settings.evaluations) for c in cases}
    assert len(keys) == 16
    times = {(c.task.settings.planning_time_s, c.task.settings.evaluations) for c in cases}
    assert times == {(3.0, 3000), (5.0, 5000)}
    few = {c.task.settings.evaluations for c in table_1.cases(1, 1, per_second=200)}
    assert few == {600, 1000}
    for key in keys:
        seeds = [
            c.seed
            for c in cases
            if (c.world, c.task.settings.optimiser, c.task.settings.evaluations) == key
        ]
        assert seeds == list(range(1, 21))


def test_every_run_lands_in_the_cell_of_its_case() -> None:
    cases = table_1.cases(3, 1)
    # each run's cost says which case it is
    rows = table_1.rows([run(float(at)) for at in range(len(cases))])
    assert len(rows) == 4
    for found in rows:
        for outcome in found.outcomes:
            for cost in outcome.costs:
                case = cases[int(cost)]
                assert case.world == found.environment
                assert case.task.settings.planning_time_s == found.planning_time_s
                assert case.task.settings.optimiser == table_1.ALGORITHMS[outcome.algorithm]


@given(costs=st.lists(st.floats(1.0, 1e4), min_size=2, max_size=20), lost=st.integers(0, 3))
def test_mean_and_deviation_are_those_of_the_runs_that_arrived(
    costs: list[float], lost: int
) -> None:
    runs = [run(cost) for cost in costs] + [run(1e9, arrived=False)] * lost
    outcome = table_1.Outcome(algorithm="GA", runs=tuple(runs))
    assert outcome.mean() == pytest.approx(np.mean(costs))
    assert outcome.deviation == pytest.approx(np.std(costs, ddof=1), abs=1e-9)


def test_algorithms_are_ordered_by_mean_and_those_that_never_arrive_come_last() -> None:
    found = row([9.0, 9.0], [1.0, 30.0], [5.0, 6.0], [10.0, 11.0])
    assert found.order == "PSO ~ improved DE ~ GA ~ classical DE"  # two runs prove nothing
    lost = table_1.Outcome(algorithm="PSO", runs=(run(0.1, arrived=False),))
    without = replace(found, outcomes=(*found.outcomes[:2], lost, found.outcomes[3]))
    assert without.order.endswith(" ~ PSO")
    assert math.isnan(lost.mean())


def test_the_papers_order_is_that_of_its_text_but_for_one_row_of_its_table() -> None:
    # "The classical DE performs better than PSO and GA": not in environment 1 with T = 3 s
    orders = {
        (each.environment, each.planning_time_s): each.papers_order
        for each in table_1.rows([run(1.0)] * 16)
    }
    assert orders.pop(("environment-1", 3.0)) == "improved DE < PSO < classical DE < GA"
    assert set(orders.values()) == {"improved DE < classical DE < PSO < GA"}


def test_only_costs_that_lie_apart_are_surely_less() -> None:
    low, high = [100.0 + v for v in range(20)], [150.0 + v for v in range(20)]
    mixed, hair = [v + 0.9 for v in low], [v + 0.4 * (i == 0) for i, v in enumerate(low)]
    a, b, c, d = row(low, high, mixed, hair).outcomes
    assert table_1.surely_less(a, b)
    assert not table_1.surely_less(b, a)
    for one, other in itertools.permutations((a, c, d), 2):
        assert not table_1.surely_less(one, other)


def test_a_difference_that_is_sure_but_of_no_size_does_not_count() -> None:
    a, b, _, _ = row(
        *([100.0 + 1e-4 * v + shift for v in range(20)] for shift in range(4))
    ).outcomes
    assert table_1.surely_less(a, b)  # 1 %
    near = row(*([100.0 + 1e-4 * v + 0.1 * k for v in range(20)] for k in range(4))).outcomes
    assert not table_1.surely_less(near[0], near[1])  # 0.1 %


def test_the_agreement_with_the_paper_is_counted_in_pairs() -> None:
    # the paper: improved DE < PSO < classical DE < GA in this row
    costs = {"improved DE": 100.0, "PSO": 120.0, "classical DE": 140.0, "GA": 160.0}
    spread = [0.1 * v for v in range(20)]
    same = row(*([costs[name] + v for v in spread] for name in table_1.ALGORITHMS))
    assert same.agreement() == (6, [])
    assert same.order == same.papers_order
    swapped = costs | {"GA": 90.0}
    other = row(*([swapped[name] + v for v in spread] for name in table_1.ALGORITHMS))
    assert other.agreement() == (3, ["GA < improved DE", "GA < PSO", "GA < classical DE"])


def test_violations_are_shares_of_missions_and_means_of_metres() -> None:
    bad = Violations(
        clearance_m=30.0,
        radar_m=0.0,
        turn_m=10.0,
        climb_m=0.0,
        band_m=0.0,
    )
    facts = table_1.violation_facts([run(1.0), run(1.0, violations=bad)])
    assert facts["clearance"] == {"missions": 0.5, "mean_m": 15.0}
    assert facts["turn"] == {"missions": 0.5, "mean_m": 5.0}
    assert facts["radar"] == {"missions": 0.0, "mean_m": 0.0}
    assert bad.any
    assert not CLEAN.any


def test_the_numbers_survive_json_even_when_nothing_arrived() -> None:
    rows = table_1.rows([run(1.0, arrived=False)] * 32)
    facts = json.loads(json.dumps(table_1.facts(rows), allow_nan=False))
    assert len(facts) == 16
    assert facts[0]["mean_cost"] is None
    assert facts[0]["arrived"] == 0
    assert facts[0]["paper_mean_cost"] == 88.3
    assert statistics.fmean(each["paper_st_dev_cost"] for each in facts) > 1.0


def test_the_remarks_state_the_budget_and_both_orders() -> None:
    words = "\n".join(table_1.remarks(table_1.rows([run(1.0), run(2.0)] * 16)))
    assert "3,000 evaluations" in words
    assert "improved DE < PSO < classical DE < GA" in words
