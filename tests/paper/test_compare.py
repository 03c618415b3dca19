"""The table and the figures: what is told of runs that nobody flew, and the ways that are flown."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from companion import extras
from companion.cli import app
from companion.errors import InputError
from companion.paper.compare import missions
from companion.paper.compare.comparisons import (
    ALGORITHMS,
    Comparison,
    figure_3,
    figure_4,
    order,
    surely_less,
    table_1,
)
from companion.paper.compare.missions import KINDS, Case, Outcome, Point, Run, crosses
from companion.paper.compare.pictures import composed

TABLE = table_1()
EFFECTS = [figure_3(), figure_4()]
CLEAN = dict.fromkeys(KINDS, 0.0)
points = st.tuples(*[st.tuples(*[st.floats(-100.0, 100.0)] * 2)] * 4)


def run(cost: float, aside_m: float = 0.0, **changes: Any) -> Run:
    """A run along the diagonal, bent aside in the middle."""
    at = np.linspace(0.0, 1.0, 101)
    bend = aside_m * np.sin(np.pi * at)
    values: dict[str, Any] = {
        "arrived": True,
        "cost": cost,
        "length_m": 150_000.0,
        "highest_amsl_m": 3_500.0,
        "j": 30.0,
        "plan_s": 1.0,
        "way": "",
        "violations_m": CLEAN,
        "route_nea_m": np.stack([1e5 * at + bend, 1e5 * at - bend, 3_500.0 + 0.0 * at], axis=-1),
        "scans_nea_m": ((0.0, 0.0, 3_500.0),),
    }
    return Run(**values | changes)


def row(*costs: list[float]) -> list[Outcome]:
    """The four algorithms of the first row of the table."""
    runs = (tuple(map(run, each)) for each in costs)
    return [Outcome(case=case, runs=each) for case, each in zip(TABLE.cases, runs, strict=False)]


def called(*words: str) -> str:
    """What a command prints."""
    runner = CliRunner(env={"COLUMNS": "80"})
    result = runner.invoke(app, ["compare", *words], standalone_mode=False)
    if result.exception is not None:
        raise result.exception
    return result.stdout


# --- Table 1


def test_the_table_is_4_algorithms_on_2_environments_with_2_budgets() -> None:
    settings = [case.world.task.settings for case in TABLE.cases]
    assert len({(case.heading, case.label) for case in TABLE.cases}) == len(TABLE.cases) == 16
    for case, each in zip(TABLE.cases, settings, strict=True):
        assert case.heading == f"{case.world.name}, {each.planning_time_s:g} s"
        assert ALGORITHMS[case.label] == each.optimiser
    assert {(s.planning_time_s, s.evaluations) for s in settings} == {(3.0, 3000), (5.0, 5000)}
    assert {case.world.task.settings.evaluations for case in table_1(200).cases} == {600, 1000}


@pytest.mark.parametrize("arrive", [0, 1, 4])
def test_the_command_tells_of_the_runs_that_arrived_what_numpy_does(
    arrive: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = CLEAN | {"clearance": 30.0, "turn": 10.0}

    def flown(case: Case, seed: int) -> Run:
        cost = sum(case.papers_cost) * seed**2
        return run(cost, arrived=seed <= arrive, violations_m=bad if seed == 1 else CLEAN)

    monkeypatch.setattr(missions, "fly", flown)
    numbers = tmp_path / "numbers.json"
    shown = called("table-1", "--runs", "5", "--jobs", "1", "--json", str(numbers))
    assert "…" not in shown  # no cell is cut in 80 columns
    written = json.loads(numbers.read_text(), parse_constant=pytest.fail)  # NaN is no JSON
    assert (written["runs"], written["seed"]) == (5, 1)
    lines = [" ".join(line.split()) for line in shown.splitlines()]
    for case, each in zip(TABLE.cases, written["results"], strict=True):
        costs = sum(case.papers_cost) * np.arange(1, arrive + 1) ** 2.0
        assert [r["cost"] for r in each["runs"] if r["arrived"]] == pytest.approx(costs.tolist())
        assert [r["violations_m"]["turn"] for r in each["runs"]] == [10.0, 0.0, 0.0, 0.0, 0.0]
        assert each["papers_cost"] == list(case.papers_cost)
        mean = costs.mean() if arrive else math.nan
        deviation = costs.std(ddof=1) if arrive > 1 else math.nan
        papers = "{:.1f} ± {:.1f}".format(*case.papers_cost)
        told = f"{case.label} {mean:.2f} ± {deviation:.2f} {papers} {arrive}/5"
        assert any(line.startswith(told) for line in lines)
    assert "T = 3 s is 3,000 evaluations" in shown


def test_algorithms_are_ordered_by_mean_and_those_that_never_arrive_come_last() -> None:
    found = row([9.0, 9.0], [1.0, 30.0], [5.0, 6.0], [10.0, 11.0])
    assert order(found) == "PSO ~ improved DE ~ GA ~ classical DE"  # two prove nothing
    lost = replace(found[2], runs=(run(0.1, arrived=False),))
    assert order([*found[:2], lost, found[3]]).endswith(" ~ PSO")


def test_only_costs_that_lie_apart_noticeably_are_surely_less() -> None:
    low, high = [100.0 + v for v in range(20)], [150.0 + v for v in range(20)]
    a, b, c = row(low, high, [v + 0.9 for v in low])
    assert surely_less(a, b)
    assert not surely_less(b, a)
    assert not surely_less(a, c)
    a, b, c = row([1.0, 2.0, 3.0], [7.0, 8.0, 9.0, 10.0], [7.0, 8.0, 9.0])
    assert surely_less(a, b)  # by chance once in 35 times
    assert not surely_less(a, c)  # once in 20
    for apart, counts in ((1.0, True), (0.1, False)):  # 1 %, and a sure 0.1 %
        a, b = row(*([100.0 + 1e-4 * v + k * apart for v in range(20)] for k in range(2)))
        assert surely_less(a, b) is counts


def test_the_order_is_told_beside_the_papers() -> None:
    # "The classical DE performs better than PSO and GA": not in environment 1 with T = 3 s
    papers = "improved DE < PSO < classical DE < GA"
    for last, order_here in ((160.0, papers), (90.0, f"GA < {papers[:-5]}")):
        costs = ([cost + 0.1 * v for v in range(20)] for cost in (100.0, 140.0, 120.0, last))
        told = TABLE.remarks(row(*costs))[1]
        assert told == f"environment-1, 3 s: {order_here}. The paper: {papers}."


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
    assert crosses(np.array([(*a, 0.0), (*b, 0.0)]), (c, d)) == expected
    assert crosses(np.array([(*a, 0.0), middle, (*b, 0.0)]), (c, d)) == expected


def test_the_settings_of_the_figures_are_the_papers() -> None:
    over, past = (case.world.task.settings.weights for case in EFFECTS[0].cases)
    assert [(w.height, w.guide) for w in (over, past)] == [(0.15, 0.15), (0.25, 0.05)]
    assert (over.length, over.crash, over.radar, over.constraints) == (0.1, 0.3, 0.3, 1)
    small, large = (case.world.task for case in EFFECTS[1].cases)
    one, two = small.radars
    overlap = one.range_m + two.range_m - math.dist(one.centre_nea_m, two.centre_nea_m)
    assert small.settings.overlap_m == 2_000.0 < overlap < large.settings.overlap_m == 6_000.0


@pytest.mark.parametrize(("runs", "seed"), [(1, 2), pytest.param(3, 1, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("name", ["figure-3", "figure-4"])
def test_a_figure_is_flown_the_papers_way_in_both_settings_drawn_and_told(
    name: str, runs: int, seed: int, tmp_path: Path
) -> None:
    picture, numbers = tmp_path / "p.pdf", tmp_path / "numbers.json"
    words = [name, "--runs", str(runs), "--seed", str(seed), "--jobs", "1"]
    shown = " ".join(called(*words, "--figure", str(picture), "--json", str(numbers)).split())
    assert picture.read_bytes().startswith(b"%PDF-")
    assert "when we increase" in shown or "may traverse" in shown
    one, other = results = json.loads(numbers.read_text())["results"]
    for each in results:  # a search of chance: nearly always
        there = [r["way"] for r in each["runs"]].count(each["papers_way"])
        assert there >= (runs + 1) // 2
        assert all(r["arrived"] for r in each["runs"])
        assert each["evaluations"] == 3_000
        assert f"{each['label']} {each['papers_way']} {there}/{runs}" in shown  # in one line
    for here, there in zip(one["runs"], other["runs"], strict=True):
        if name == "figure-3":  # over: higher and shorter
            assert here["highest_amsl_m"] > there["highest_amsl_m"] + 300.0
            assert here["length_m"] < there["length_m"]
        else:  # between: through what both radars see
            assert here["violations_m"]["radar"] == 0.0
            assert there["violations_m"]["radar"] > 5_000.0


@pytest.mark.parametrize("effect", EFFECTS, ids=["figure-3", "figure-4"])
def test_each_panel_shows_the_route_of_median_cost_and_says_how_many_go_the_papers_way(
    effect: Comparison,
) -> None:
    runs = [run(30.0), run(20.0, way=effect.cases[0].papers_way), run(40.0, 4e4)]
    found = [Outcome(case=case, runs=runs) for case in effect.cases]
    figure = composed(effect, found)
    words = [text.get_text() for text in figure.texts]
    for case, letter, told in zip(effect.cases, "ab", ("1/3", "0/3"), strict=True):
        assert f"({letter}) {case.label}: {case.papers_way} ({told} runs)" in words
    for remark in effect.remarks(found):
        assert remark.replace(" ", "") in "".join(words).replace(" ", "").replace("\n", "")
    route_km = runs[0].route_nea_m / 1e3
    shown = route_km[:, [1, 0]]  # from above
    if effect is EFFECTS[0]:  # vertical profile
        along = np.hypot(*np.diff(route_km[:, :2], axis=0).T).cumsum()
        shown = np.stack([np.insert(along, 0, 0.0), route_km[:, 2]], axis=-1)
    for axes in (axes for axes in figure.axes if axes.get_label() == "below"):
        lines = [np.asarray(line.get_xydata()) for line in axes.lines]
        assert any(line.shape == shown.shape and np.allclose(line, shown) for line in lines)


def test_routes_flies_whoever_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.paper.compare.comparisons.ENVIRONMENTS", ("environment-1",))
    words = ["routes", "--jobs", "1", "--planner", "paper", "--planner", "a-star"]
    shown = called(*words, "--json", str(tmp_path / "routes.json"))
    results = json.loads((tmp_path / "routes.json").read_text())["results"]
    assert [each["label"] for each in results] == ["paper", "a-star"]
    for each in results:
        assert each["runs"][0]["arrived"]
        assert f"{each['runs'][0]['j']:.2f}" in shown
    with pytest.raises(InputError, match=r"--planner = 'magic': there is no such planner"):
        called("routes", "--planner", "magic")
    with pytest.raises(InputError, match=r"--planner = 'a-star': it has no effect on figure-3"):
        called("figure-3", "--planner", "a-star")


def test_without_dask_one_process_flies_and_more_name_the_extra(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _name: None)
    monkeypatch.setattr(missions, "fly", lambda case, _seed: run(sum(case.papers_cost)))
    words = ["table-1", "--runs", "1"]
    with pytest.raises(InputError, match=r"--jobs = 2: not installed: dask.*companion\[campaign\]"):
        called(*words, "--jobs", "2")
    assert "improved DE" in called(*words)


def test_a_file_that_cannot_be_written_is_refused_before_anything_is_flown(tmp_path: Path) -> None:
    for command, option in (
        ("table-1", "--json"),
        ("figure-3", "--json"),
        ("figure-3", "--figure"),
    ):
        for path in (tmp_path, tmp_path / "nowhere" / "file.png"):
            with pytest.raises(InputError, match=f"{option} = .*{path.name}"):
                called(command, option, str(path))
    with pytest.raises(InputError, match=r"--figure = 'x.jpg': .* \.png, \.svg or \.pdf"):
        called("figure-3", "--figure", "x.jpg")
    with pytest.raises(InputError, match=r"--figure = 'x.png': it has no effect on table-1"):
        called("table-1", "--figure", "x.png")
    assert list(tmp_path.iterdir()) == []
