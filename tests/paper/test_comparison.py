"""What is told of runs that nobody flew: tables, remarks, numbers and pictures."""

import itertools
import json
import math
from dataclasses import replace
from io import StringIO
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from companion.paper.compare.command import table
from companion.paper.compare.comparisons import (
    ALGORITHMS,
    Comparison,
    agreement,
    by_heading,
    figure_3,
    figure_4,
    order,
    surely_less,
    table_1,
)
from companion.paper.compare.missions import KINDS, Outcome, Run, crosses, fly_all
from companion.paper.compare.pictures import compose_effect, compose_table

TABLE = table_1()
EFFECTS = [figure_3(), figure_4()]
CLEAN = dict.fromkeys(KINDS, 0.0)
Point = tuple[float, float]
points = st.tuples(*[st.tuples(*[st.floats(-100.0, 100.0)] * 2)] * 4)
every_effect = pytest.mark.parametrize("effect", EFFECTS, ids=["figure-3", "figure-4"])


def run(cost: float, aside_m: float = 0.0, **changes: Any) -> Run:
    """A run along the diagonal, bent aside in the middle."""
    at = np.linspace(0.0, 1.0, 101)
    bend = aside_m * np.sin(np.pi * at)
    values: dict[str, Any] = {
        "arrived": True,
        "cost": cost,
        "legs": 8,
        "length_m": 150_000.0,
        "highest_amsl_m": 3_500.0,
        "j": 30.0,
        "took_s": 1.0,
        "route_nea_m": np.stack([1e5 * at + bend, 1e5 * at - bend, 3_500.0 + 0.0 * at], axis=-1),
        "scans_nea_m": ((0.0, 0.0, 3_500.0),),
        "violations": CLEAN,
    }
    return Run(**values | changes)


def told(*runs: tuple[Run, ...]) -> list[Outcome]:
    """Table 1, cell by cell; the runs of the last one stand for all that follow."""
    every = [*runs, *[runs[-1]] * (len(TABLE.cases) - len(runs))]
    return [Outcome(case=case, runs=each) for case, each in zip(TABLE.cases, every, strict=True)]


def row(*costs: list[float]) -> list[Outcome]:
    """The four algorithms of the first row."""
    return told(*(tuple(run(cost) for cost in each) for each in costs))[:4]


# --- Table 1


def test_the_table_is_4_algorithms_on_2_environments_with_2_budgets() -> None:
    settings = [case.task.settings for case in TABLE.cases]
    assert len({(case.heading, case.label) for case in TABLE.cases}) == len(TABLE.cases) == 16
    for case, each in zip(TABLE.cases, settings, strict=True):
        assert case.heading == f"{case.world}, {each.planning_time_s:g} s"
        assert ALGORITHMS[case.label] == each.optimiser
    assert {(s.planning_time_s, s.evaluations) for s in settings} == {(3.0, 3000), (5.0, 5000)}
    assert {case.task.settings.evaluations for case in table_1(200).cases} == {600, 1000}


@given(costs=st.lists(st.floats(1.0, 1e4), min_size=2, max_size=20), lost=st.integers(0, 3))
def test_mean_and_deviation_are_those_of_the_runs_that_arrived(
    costs: list[float], lost: int
) -> None:
    runs = [run(cost) for cost in costs] + [run(1e9, arrived=False)] * lost
    outcome = Outcome(case=TABLE.cases[0], runs=tuple(runs))
    assert outcome.mean() == pytest.approx(np.mean(costs))
    assert outcome.deviation == pytest.approx(np.std(costs, ddof=1), abs=1e-9)
    assert outcome.arrivals == f"{len(costs)}/{len(costs) + lost}"


def test_algorithms_are_ordered_by_mean_and_those_that_never_arrive_come_last() -> None:
    found = row([9.0, 9.0], [1.0, 30.0], [5.0, 6.0], [10.0, 11.0])
    assert order(found) == "PSO ~ improved DE ~ GA ~ classical DE"  # two prove nothing
    lost = replace(found[2], runs=(run(0.1, arrived=False),))
    assert order([*found[:2], lost, found[3]]).endswith(" ~ PSO")


def test_only_costs_that_lie_apart_noticeably_are_surely_less() -> None:
    low, high = [100.0 + v for v in range(20)], [150.0 + v for v in range(20)]
    mixed, hair = [v + 0.9 for v in low], [v + 0.4 * (i == 0) for i, v in enumerate(low)]
    a, b, c, d = row(low, high, mixed, hair)
    assert surely_less(a, b)
    assert not surely_less(b, a)
    assert not any(surely_less(one, other) for one, other in itertools.permutations((a, c, d), 2))
    for apart, counts in ((1.0, True), (0.1, False)):  # 1 %, and a sure 0.1 %
        a, b, *_ = row(*([100.0 + 1e-4 * v + k * apart for v in range(20)] for k in range(2)))
        assert surely_less(a, b) is counts


def by_the_paper(found: list[Outcome]) -> list[Outcome]:
    return [found[k] for k in (0, 2, 1, 3)]


def test_the_agreement_with_the_paper_is_counted_in_pairs() -> None:
    # the paper: improved DE < PSO < classical DE < GA in this row
    costs = {"improved DE": 100.0, "classical DE": 140.0, "PSO": 120.0, "GA": 160.0}
    spread = [0.1 * v for v in range(20)]
    same = row(*([cost + v for v in spread] for cost in costs.values()))
    assert agreement(by_the_paper(same)) == (6, [])
    assert order(same) == "improved DE < PSO < classical DE < GA"
    other = row(*([cost + v for v in spread] for cost in (costs | {"GA": 90.0}).values()))
    expected = ["GA < improved DE", "GA < PSO", "GA < classical DE"]
    assert agreement(by_the_paper(other)) == (3, expected)


def test_the_remarks_state_the_budget_and_the_papers_order_of_each_row() -> None:
    words = TABLE.remarks(told((run(1.0), run(2.0))))
    assert "3,000 evaluations" in words[0]
    # "The classical DE performs better than PSO and GA": not in environment 1 with T = 3 s
    assert "improved DE < PSO < classical DE < GA" in words[2]
    assert all("improved DE < classical DE < PSO < GA" in each for each in words[3:])


def test_violations_are_shares_of_missions_and_means_of_metres() -> None:
    bad = CLEAN | {"clearance": 30.0, "turn": 10.0}
    found = Outcome(case=TABLE.cases[0], runs=(run(1.0), run(1.0, violations=bad))).violations
    assert found["clearance"] == {"missions": 0.5, "mean_m": 15.0}
    assert found["turn"] == {"missions": 0.5, "mean_m": 5.0}
    assert found["radar"] == {"missions": 0.0, "mean_m": 0.0}


def test_no_cell_of_a_table_is_cut_in_80_columns() -> None:
    found = told((run(208.55), run(596.96)))
    with (console := Console(width=80, file=StringIO())).capture() as said:
        for title, each in TABLE.tables.items():
            console.print(table(title, each, found))
    assert "…" not in said.get()
    for cell in ("environment-2, 5 s", "classical DE", "402.75 ± 274.65", "150.0 km"):
        assert cell in said.get()


def test_what_nobody_arrived_in_can_be_drawn_and_written() -> None:
    found = told((run(1.0, arrived=False), run(2.0, arrived=False)))
    compose_table(TABLE, found)
    facts = json.loads(json.dumps([each.facts() for each in found], allow_nan=False))
    assert facts[0]["costs"] == [None, None]
    assert (facts[0]["paper_mean_cost"], facts[15]["paper_st_dev_cost"]) == (88.3, 16.4)


def test_the_picture_of_the_table_shows_every_run_and_every_mean() -> None:
    rng = np.random.default_rng(1)
    found = told(*(tuple(map(run, rng.uniform(30.0, 500.0, 5).tolist())) for _ in range(16)))
    figure = compose_table(TABLE, found)
    panels = [axes for axes in figure.axes if axes.get_label() == "row"]
    assert len(panels) == 4
    for axes, each in zip(panels, by_heading(found), strict=True):
        assert axes.get_yscale() == "log"
        lines = [np.asarray(line.get_ydata()).tolist() for line in axes.lines]
        for outcome in each:
            assert outcome.costs in lines
            assert any(line == pytest.approx([outcome.mean()]) for line in lines if line)


# --- Fig. 3 and Fig. 4


@given(ends=points)
def test_a_straight_route_crosses_a_line_when_each_separates_the_ends_of_the_other(
    ends: tuple[Point, Point, Point, Point],
) -> None:
    a, b, c, d = ends

    def left_of(p: Point, q: Point, r: Point) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    turns = [left_of(c, d, a), left_of(c, d, b), left_of(a, b, c), left_of(a, b, d)]
    if min(abs(turn) for turn in turns) < 1e-6:
        return  # they touch: either answer is right
    expected = turns[0] * turns[1] < 0.0 and turns[2] * turns[3] < 0.0
    middle = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, 9.0)
    assert crosses(np.array([(*a, 0.0), (*b, 0.0)]), c, d) == expected
    assert crosses(np.array([(*a, 0.0), middle, (*b, 0.0)]), c, d) == expected


def test_the_settings_of_the_figures_are_the_papers() -> None:
    over, past = (case.task.settings.weights for case in EFFECTS[0].cases)
    assert [(w.height, w.guide) for w in (over, past)] == [(0.15, 0.15), (0.25, 0.05)]
    assert (over.length, over.crash, over.radar, over.constraints) == (0.1, 0.3, 0.3, 1)
    small, large = (case.task for case in EFFECTS[1].cases)
    one, two = small.radars
    overlap = one.range_m + two.range_m - math.dist(one.centre_nea_m, two.centre_nea_m)
    assert small.settings.overlap_m == 2_000.0 < overlap < large.settings.overlap_m == 6_000.0


@pytest.mark.parametrize(("runs", "seed"), [(1, 2), pytest.param(3, 1, marks=pytest.mark.nightly)])
@every_effect
def test_the_paper_s_way_is_flown_in_both_settings(
    effect: Comparison, runs: int, seed: int
) -> None:
    one, other = fly_all(effect.cases, runs, seed, 1)
    for outcome in (one, other):  # a search of chance: nearly always
        assert outcome.ways.count(outcome.case.papers_way) >= (runs + 1) // 2
        assert outcome.arrivals == f"{runs}/{runs}"
    if effect is EFFECTS[0]:  # over: higher and shorter
        assert one.shown.highest_amsl_m > other.shown.highest_amsl_m + 300.0
        assert one.shown.length_m < other.shown.length_m
    else:  # between: through what both radars see
        assert one.shown.violations["radar"] == 0.0
        assert other.shown.violations["radar"] > 5_000.0


@every_effect
def test_each_panel_shows_the_route_of_median_cost_and_says_where_most_runs_go(
    effect: Comparison,
) -> None:
    runs = [(run(30.0), run(20.0), run(40.0, 4e4)), (run(1.0, 4e4), run(9.0, 4e4), run(5.0, 4e4))]
    found = [Outcome(case=c, runs=each) for c, each in zip(effect.cases, runs, strict=True)]
    figure = compose_effect(effect, found)
    words = [text.get_text() for text in figure.texts]
    across = "climbs over" if effect is EFFECTS[0] else "flies between"
    for case, letter, most in zip(
        effect.cases, "ab", (f"{across} (2", "goes round (3"), strict=True
    ):
        assert any(word.startswith(f"({letter}) {case.label}: {most} of 3") for word in words)
    for remark in effect.remarks(found):
        assert remark.replace(" ", "") in "".join(words).replace(" ", "").replace("\n", "")
    below = [axes for axes in figure.axes if axes.get_label() == "below"]
    for axes, outcome, cost in zip(below, found, (30.0, 5.0), strict=True):
        assert outcome.shown.cost == cost
        route_km = outcome.shown.route_nea_m / 1e3
        lines = [np.asarray(line.get_xydata()) for line in axes.lines]
        shown = route_km[:, [1, 0]]  # from above
        if effect is EFFECTS[0]:  # vertical profile
            along = np.hypot(*np.diff(route_km[:, :2], axis=0).T).cumsum()
            shown = np.stack([np.insert(along, 0, 0.0), route_km[:, 2]], axis=-1)
        assert any(line.shape == shown.shape and np.allclose(line, shown) for line in lines)
