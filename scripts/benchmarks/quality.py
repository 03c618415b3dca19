"""How good the search is, against every rival, on problems drawn from complete missions.

    python scripts/benchmarks/quality.py [--objective flight|paper] [--seeds 10] [--slow-seeds 2]
                           [--all] [--json FILE] [--only NAME ...] [--record] [--best-known RUNS]

Gap: (f - f*) / max(f*, 2), f* the best known (best_known.json; every run may lower it). Success:
a gap of at most 1 %. Every search gets the same warm starts (its first members; CMA-ES begins at
the best of them), the unit cube as bounds, and the budget to the evaluation; populations are what
its authors recommend, or (`-60`) 60. Intervals: 95 %, by resampling problems and seeds.
"""

import contextlib
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import running
import subpaths
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from running import Bar
from subpaths import Problem

from companion.geodesy import FloatArray
from companion.jit import compiled
from companion.objective import Scene
from companion.optimise import refined_de
from companion.optimise.loop import minimise
from companion.optimise.registry import OPTIMISERS
from companion.planner import kernels

BUDGETS = (600, 1_500, 3_000, 6_000)
SUCCESS = 0.01
_BARS = {"flight": {3_000: 95.0, 6_000: 97.0}, "paper": {1_500: 95.0, 3_000: 97.0}}
_SAMPLES = 1_000  # of the bootstrap
_NEEDLE = 0.3  # a problem that nobody solves in this share of runs with the largest budget


class _Spent(Exception):
    """The budget is: the way out of a rival's loop."""


class Counted:
    """An objective with a budget; keeps the best."""

    def __init__(self, problem: Problem, budget: int) -> None:
        self._problem = problem
        self.left = budget
        self.best, self.best_x = math.inf, np.zeros(problem.dimensions)

    def __call__(self, x: FloatArray) -> FloatArray:
        """(P, D) -> (P,); candidates beyond the budget are infinite, and it ends when it is 0."""
        if self.left == 0:
            raise _Spent
        x = np.clip(np.asarray(x, dtype=float), 0.0, 1.0)
        count = min(len(x), self.left)
        costs = np.full(len(x), math.inf)
        costs[:count] = self._problem.costs(x[:count])
        self.left -= count
        if costs.min() < self.best:
            self.best, self.best_x = float(costs.min()), x[costs.argmin()].copy()
        return costs


Search = Callable[[Counted, Problem, int, int], None]
"""Spends the budget (the first number) from a seed (the second)."""


def _minion(algorithm: str, population: int | None) -> Search:
    def search(cost: Counted, problem: Problem, budget: int, seed: int) -> None:
        import minionpy

        options = {"population_size": population} if population else None
        minionpy.Minimizer(
            lambda x: cost(np.array(x)).tolist() if cost.left else [1e9] * len(x),
            [(0.0, 1.0)] * problem.dimensions,
            x0=problem.seeds.tolist(),
            algo=algorithm,
            maxevals=budget,
            seed=seed,
            options=options,
        ).optimize()

    return search


def _scipy_de(cost: Counted, problem: Problem, budget: int, seed: int) -> None:
    from scipy.optimize import differential_evolution

    rng = np.random.default_rng(seed)
    members = rng.random((15 * problem.dimensions, problem.dimensions))  # its default size
    members[: len(problem.seeds)] = problem.seeds
    differential_evolution(
        lambda x: cost(np.atleast_2d(x.T)),
        [(0.0, 1.0)] * problem.dimensions,
        init=members,
        maxiter=budget,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=rng,
    )


def _cma(cost: Counted, problem: Problem, budget: int, seed: int) -> None:
    import cma

    start = problem.seeds[cost(problem.seeds).argmin()]
    options = {"bounds": [0.0, 1.0], "seed": seed + 1, "verbose": -9, "maxfevals": budget}
    cma.fmin2(
        None,
        start,
        0.25,
        options,
        parallel_objective=lambda x: cost(np.array(x)).tolist(),
        restarts=9,
        bipop=True,
    )


def _own(name: str) -> Search:
    def search(cost: Counted, problem: Problem, budget: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        minimise(OPTIMISERS[name](problem.dimensions, budget, rng, problem.seeds), cost, budget)

    return search


RIVALS: dict[str, Search] = {
    "L-SHADE": _minion("LSHADE", None),
    "L-SHADE-60": _minion("LSHADE", 60),
    "jSO": _minion("jSO", None),
    "jSO-60": _minion("jSO", 60),
    "ARRDE": _minion("ARRDE", None),
    "CMA-ES": _cma,
    "scipy DE": _scipy_de,
    "improved-de": _own("improved-de"),
    "pso": _own("pso"),
    "ga": _own("ga"),
}
_SLOW = ("CMA-ES", "scipy DE")
OURS = "refined-de"


def refine(state: refined_de.State, problem: Problem, budget: int) -> tuple[float, FloatArray]:
    """Our search, from its beginning until the budget is spent: the best cost, and where."""
    if isinstance(problem.scene, Scene):
        compiled(kernels.search)(state, problem.scene, budget)
    else:
        ask, tell = map(compiled, (refined_de.ask, refined_de.tell))
        while refined_de.spent(state) < budget:
            count = ask(state)
            state.trial_costs[:count] = problem.costs(state.trial[:count])
            tell(state, count)
    x, costs = refined_de.ranked(state)
    return float(costs[0]), x[0]


def solve(name: str, problem: Problem, budget: int, seed: int) -> tuple[float, FloatArray]:
    """The best cost that a search finds, and where."""
    if name == OURS:
        rng, how = np.random.default_rng(seed), refined_de.Settings()
        state = refined_de.begin(problem.dimensions, budget, problem.seeds, how, rng)
        return refine(state, problem, budget)
    cost = Counted(problem, budget)
    with contextlib.suppress(_Spent):
        RIVALS[name](cost, problem, budget, seed)
    return cost.best, cost.best_x


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """One search at one budget."""

    gaps: FloatArray  # (problems, seeds)

    @property
    def success(self) -> float:
        """Share of runs within 1 % of the best known."""
        return float((self.gaps <= SUCCESS).mean())

    def interval(self) -> tuple[float, float]:
        """95 % of the success, by resampling problems and seeds."""
        return _interval(_resampled(self.gaps <= SUCCESS))

    def ahead_of(self, rival: "Figures") -> tuple[float, float]:
        """95 % of the difference in success on the same problems."""
        mine = _resampled(self.gaps <= SUCCESS)
        return _interval(mine - _resampled(rival.gaps <= SUCCESS))


def _resampled(hits: NDArray[np.bool_]) -> FloatArray:
    """Shares of bootstrap samples; every set of figures draws the same problems.  -> (samples,)."""
    problems, seeds = hits.shape
    which = np.random.default_rng(1).integers(problems, size=(_SAMPLES, problems))
    again = np.random.default_rng([2, seeds]).integers(seeds, size=(_SAMPLES, problems, seeds))
    return np.asarray(hits[which[:, :, None], again].mean(axis=(1, 2)))


def _interval(values: FloatArray) -> tuple[float, float]:
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)


def compare(
    names: Sequence[str],
    problems: Sequence[Problem],
    data: dict[str, Any],
    seeds: Callable[[str], int],
    console: Console,
) -> dict[tuple[str, int], Figures]:
    """Run everything; what is found anew lowers the best known before gaps are taken."""
    found: dict[tuple[str, int], FloatArray] = {}
    jobs = [(name, budget) for name in names for budget in BUDGETS]
    for name, budget in track(jobs, "searches", console=console, transient=True):
        costs = np.empty((len(problems), seeds(name)))
        for i, problem in enumerate(problems):
            for seed in range(seeds(name)):
                costs[i, seed], x = solve(name, problem, budget, seed)
                subpaths.keep_best(data, problem, costs[i, seed], x)
        found[name, budget] = costs
    best = np.array([subpaths.best_known(data, each) for each in problems])[:, None]
    return {k: Figures(gaps=(v - best) / np.maximum(best, 2.0)) for k, v in found.items()}


def needles(figures: dict[tuple[str, int], Figures]) -> NDArray[np.bool_]:
    """Problems whose best basin nobody finds in 30 % of runs with the largest budget."""
    hits = [f.gaps <= SUCCESS for (_, budget), f in figures.items() if budget == BUDGETS[-1]]
    return np.asarray(np.max([each.mean(axis=1) for each in hits], axis=0) < _NEEDLE)


def without(
    figures: dict[tuple[str, int], Figures], dropped: NDArray[np.bool_]
) -> dict[tuple[str, int], Figures]:
    """The figures without some problems."""
    return {k: Figures(gaps=f.gaps[~dropped]) for k, f in figures.items()}


def table(title: str, figures: dict[tuple[str, int], Figures]) -> Table:
    """Mean gap, success with its interval, and how far the refined DE is ahead."""
    result = Table("search", *(f"{budget:,}" for budget in BUDGETS), title=title)
    for name in dict.fromkeys(name for name, _ in figures):
        cells = []
        for budget in BUDGETS:
            each = figures[name, budget]
            low, high = each.interval()
            text = f"{100 * each.gaps.mean():5.2f} %  [bold]{100 * each.success:5.1f}[/] "
            text += f"({100 * low:.1f}-{100 * high:.1f})"
            if name != OURS and (OURS, budget) in figures:
                low, high = figures[OURS, budget].ahead_of(each)
                text += f"\n{'ours +':>9} {100 * low:.1f} .. {100 * high:.1f}"
            cells.append(text)
        result.add_row(name, *cells)
    return result


def rows(figures: dict[tuple[str, int], Figures]) -> list[dict[str, Any]]:
    """The same for --json."""
    result = []
    for (name, budget), each in figures.items():
        row = {"search": name, "evaluations": budget, "mean_gap": float(each.gaps.mean())}
        row |= {"success": each.success, "interval": each.interval(), "runs": each.gaps.size}
        result.append(row)
    return result


def bars_of(figures: dict[tuple[str, int], Figures], objective: str) -> Iterator[Bar]:
    """Ours beside its bars and, with the flight objective, beside the best of the rivals there."""
    percent = {key: 100.0 * each.success for key, each in figures.items()}
    ours = {budget: value for (name, budget), value in percent.items() if name == OURS}
    for budget, bar in _BARS[objective].items() if ours else ():
        what = f"search, {objective} objective, {budget:,}: within 1 %, %"
        yield running.least(what, ours[budget], bar)
    rivals = {name for name, _ in percent} - {OURS} if objective == "flight" else set()
    for budget, value in ours.items() if rivals else ():
        best = max(rivals, key=lambda name, budget=budget: percent[name, budget])
        behind = percent[best, budget] - value
        yield running.most(f"search, {budget:,}: points behind {best}", behind, 0.0)


def search_long(
    problems: Sequence[Problem], data: dict[str, Any], runs: int, console: Console
) -> None:
    """Best known values by long searches with large populations, half without warm starts."""
    for problem in track(problems, "best known", console=console, transient=True):
        for run in range(runs):
            how = refined_de.Settings(population=(120, 200, 300)[run % 3], smallest=8, memory=20)
            seeds = problem.seeds if run % 2 else problem.seeds[:0]
            rng = np.random.default_rng([run, 1])
            state = refined_de.begin(problem.dimensions, 30_000, seeds, how, rng)
            subpaths.keep_best(data, problem, *refine(state, problem, 30_000))


def main() -> int:
    """Run the comparison, print the tables; 1 if a bar is missed."""
    options, console = running.begin(
        __doc__,
        width=150,
        objective=["flight", "paper"],
        seeds=10,
        slow_seeds=(2, f"for {' and '.join(_SLOW)}"),
        only={"nargs": "*", "default": [OURS, *RIVALS], "choices": [OURS, *RIVALS]},
        all=(False, "with the problems used for tuning"),
        record=(False, "fly the missions anew"),
        best_known=(0, "runs of long searches"),
    )
    data = subpaths.record() if options.record else subpaths.load()
    problems = subpaths.problems(data, options.objective)
    problems = [p for p in problems if options.all or not p.for_tuning]
    if options.best_known:
        search_long(problems, data, options.best_known, console)
        subpaths.store(data)
    stale = [p.name for p in problems if math.isinf(subpaths.best_known(data, p))]
    if stale:
        console.print(f"{len(stale)} objectives are not those on file: add --best-known 12")

    def seeds(name: str) -> int:
        return options.slow_seeds if name in _SLOW else options.seeds

    figures = compare(options.only, problems, data, seeds, console)
    subpaths.store(data)
    hard = needles(figures)
    easier = without(figures, hard)
    console.print(table(f"{len(problems)} problems: mean gap, % of runs within 1 %", figures))
    if hard.any():
        names = ", ".join(p.name for p, drop in zip(problems, hard, strict=True) if drop)
        console.print(table(f"without {hard.sum()} needles ({names})", easier))
    found = {"all": rows(figures), "without_needles": rows(easier)}
    return running.ended(console, options.json, found, list(bars_of(easier, options.objective)))


if __name__ == "__main__":
    sys.exit(main())
