"""The comparison of searches counts fairly."""

import json
import math
from typing import Any

import numpy as np
import pytest
import quality
import subpaths
from numpy.typing import NDArray
from quality import BUDGETS, OURS, RIVALS, Counted

from companion.jit import compiled
from companion.planner import kernels

FloatArray = NDArray[np.float64]


@pytest.fixture(scope="module")
def problem() -> subpaths.Problem:
    data = subpaths.load()
    world = "sparse-1"
    plans = [each for each in data["plans"][world] if each["scan"] == 0]
    few = {"scans": {world: data["scans"][world][:1]}, "plans": {world: plans[:1]}}
    return subpaths.problems(few, "flight")[0]


@pytest.mark.parametrize("name", [OURS, *RIVALS])
def test_every_search_spends_the_budget_and_no_more(
    name: str, problem: subpaths.Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name in ("L-SHADE", "L-SHADE-60", "jSO", "jSO-60", "ARRDE", "CMA-ES"):
        pytest.importorskip("cma" if name == "CMA-ES" else "minionpy")
    asked: list[FloatArray] = []
    told: list[FloatArray] = []

    class Watched(Counted):
        def __call__(self, x: FloatArray) -> FloatArray:
            left = self.left
            costs = super().__call__(x)
            asked.append(np.array(x)[: left - self.left])
            told.append(costs[: left - self.left])
            return costs

    monkeypatch.setattr(quality, "Counted", Watched)
    cost, x = quality.solve(name, problem, 300, 1)
    assert compiled(kernels.costs)(x[None], problem.scene)[0] == pytest.approx(cost, rel=1e-12)
    if name == OURS:
        return  # spends by `ask`: tests/optimise
    assert sum(len(each) for each in asked) == 300
    assert cost == min(each.min() for each in told)
    # the warm starts are among the first that it asks for
    most = None if name == "ARRDE" else 15 * problem.dimensions + len(problem.seeds)
    first = np.concatenate(asked)[:most]
    for seed in problem.seeds:
        assert np.abs(first - seed).max(axis=1).min() < 1e-9


def test_the_file_holds_a_hundred_problems_half_of_them_not_used_for_tuning() -> None:
    data = subpaths.load()
    counts = [len(data["plans"][world]) for world in data["scans"]]
    assert sum(counts) >= 100
    assert 0.4 < sum(counts[1::2]) / sum(counts) < 0.6


def test_a_best_value_counts_for_its_own_objective_alone(problem: subpaths.Problem) -> None:
    data: dict[str, Any] = {"best": {}}
    x = np.full(problem.dimensions, 0.5)
    assert subpaths.best_known(data, problem) == math.inf
    for cost in (5.0, 4.0, 4.5):
        subpaths.keep_best(data, problem, cost, x)
    assert subpaths.best_known(data, problem) == 4.0
    data["best"][problem.name]["objective"] = "another"
    assert subpaths.best_known(data, problem) == math.inf


def test_writing_the_file_and_reading_it_changes_nothing(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = subpaths.load()
    monkeypatch.setattr(subpaths, "FILE", tmp_path / "copy.json")
    subpaths.store(data)
    assert subpaths.load() == data
    assert json.loads((tmp_path / "copy.json").read_text(encoding="utf-8")) == data


def gaps_of(success: float, problems: int = 100, seeds: int = 10) -> FloatArray:
    hits = np.random.default_rng(3).random((problems, seeds)) < success
    return np.where(hits, 0.0, 0.5)


def test_the_interval_of_independent_runs_is_that_of_the_binomial_distribution() -> None:
    each = gaps_of(0.9)
    low, high = quality.interval(quality.resampled(each))
    deviation = math.sqrt(0.9 * 0.1 / 1_000)
    # resampled seeds add as much again as the problems do
    assert low < (each == 0.0).mean() < high
    assert 2 * 1.96 * deviation < high - low < 2 * 1.96 * deviation * 1.8


def test_a_search_is_not_ahead_of_itself() -> None:
    same, ahead, behind = (
        quality.rows({(OURS, 600): gaps_of(0.9), ("other", 600): gaps_of(success)})
        for success in (0.9, 0.6, 0.97)
    )
    found = [[*each][1] for each in (same, ahead, behind)]
    intervals = [(row["ours ahead from|.1f"], row["ahead to|.1f"]) for row in found]
    assert intervals[0] == (0.0, 0.0)
    assert intervals[1][0] > 20.0
    assert intervals[2][1] < 0.0


def test_a_needle_is_a_problem_that_no_search_solves_in_a_third_of_runs() -> None:
    last = BUDGETS[-1]
    found = {
        ("a", last): np.array([[0.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]]),
        ("b", last): np.array([[0.0, 0.0, 1.0, 1.0], [0.0, 1.0, 1.0, 1.0]]),
        ("b", 600): np.zeros((2, 4)),
    }
    assert quality.needles(found).tolist() == [False, True]
