"""The table and the figures: what is told of runs that nobody flew, and the ways that are flown."""

import json
import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.cli import app
from companion.errors import InputError
from companion.paper.compare import missions
from companion.paper.compare.comparisons import surely_less, table_1
from companion.paper.compare.missions import KINDS, Case, Outcome, Run

TABLE = table_1()
CLEAN = dict.fromkeys(KINDS, 0.0)


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


def called(*words: str) -> str:
    """What a command prints."""
    runner = CliRunner(env={"COLUMNS": "80"})
    result = runner.invoke(app, ["compare", *words], standalone_mode=False)
    if result.exception is not None:
        raise result.exception
    return result.stdout


# --- Table 1


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


def test_only_costs_that_lie_apart_noticeably_are_surely_less() -> None:
    low, high = [100.0 + v for v in range(20)], [150.0 + v for v in range(20)]
    few, more = [7.0, 8.0, 9.0], [7.0, 8.0, 9.0, 10.0]
    for one, other, is_less in (
        (low, high, True), (high, low, False), (low, [v + 0.9 for v in low], False),
        ([1.0, 2.0, 3.0], more, True), ([1.0, 2.0, 3.0], few, False),  # by chance once in 35, 20
        ([100.0] * 20, [101.0] * 20, True), ([100.0] * 20, [100.1] * 20, False),  # sure, but 0.1 %
    ):  # fmt: skip
        runs = (tuple(map(run, each)) for each in (one, other))
        assert surely_less(*(Outcome(case=TABLE.cases[0], runs=each) for each in runs)) is is_less


# --- Fig. 3 and Fig. 4


@pytest.mark.parametrize(("runs", "seed"), [(1, 2), pytest.param(3, 1, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("name", ["figure-3", "figure-4"])
def test_a_figure_is_flown_the_papers_way_in_both_settings_drawn_and_told(
    name: str, runs: int, seed: int, tmp_path: Path
) -> None:
    picture, numbers = tmp_path / "p.pdf", tmp_path / "numbers.json"
    words = [name, "--runs", str(runs), "--seed", str(seed), "--jobs", "1"]
    shown = " ".join(called(*words, "--figure", str(picture), "--json", str(numbers)).split())
    assert picture.read_bytes().startswith(b"%PDF-")
    one, other = results = json.loads(numbers.read_text())["results"]
    for each in results:  # a search of chance: nearly always
        there = [r["way"] for r in each["runs"]].count(each["papers_way"])
        assert there >= (runs + 1) // 2
        assert all(r["arrived"] for r in each["runs"])
        assert f"{each['label']} {each['papers_way']} {there}/{runs}" in shown  # in one line
    for here, there in zip(one["runs"], other["runs"], strict=True):
        if name == "figure-3":  # over: higher and shorter
            assert here["highest_amsl_m"] > there["highest_amsl_m"] + 300.0
            assert here["length_m"] < there["length_m"]
        else:  # between: through what both radars see
            assert here["violations_m"]["radar"] == 0.0
            assert there["violations_m"]["radar"] > 5_000.0


def test_routes_flies_whoever_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.paper.compare.comparisons.ENVIRONMENTS", ("environment-1",))
    words = ["routes", "--jobs", "1", "--planner", "paper", "--planner", "a-star"]
    shown = called(*words, "--json", str(tmp_path / "routes.json"))
    results = json.loads((tmp_path / "routes.json").read_text())["results"]
    assert [each["label"] for each in results] == ["paper", "a-star"]
    for each in results:
        assert each["runs"][0]["arrived"]
        assert f"{each['runs'][0]['j']:.2f}" in shown


def test_a_file_that_cannot_be_written_is_refused_before_anything_is_flown(tmp_path: Path) -> None:
    pairs = ("table-1", "--json"), ("figure-3", "--json"), ("figure-3", "--figure")
    for (command, option), path in product(pairs, (tmp_path, tmp_path / "nowhere" / "file.png")):
        with pytest.raises(InputError, match=f"{option} = .*{path.name}"):
            called(command, option, str(path))
    assert list(tmp_path.iterdir()) == []
    for words, line in (
        ("figure-3 --figure x.jpg", r"--figure = 'x.jpg': .* \.png, \.svg or \.pdf"),
        ("table-1 --figure x.png", r"--figure = 'x.png': it has no effect on table-1"),
        ("routes --planner magic", r"--planner = 'magic': there is no such planner"),
        ("figure-3 --planner a-star", r"--planner = 'a-star': it has no effect on figure-3"),
    ):
        with pytest.raises(InputError, match=line):
            called(*words.split())
