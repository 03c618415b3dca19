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
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import subpaths
from numpy.typing import NDArray
from running import Bar, Found, OneOf, Some, least, main, most, progress
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


Gaps = dict[tuple[str, int], FloatArray]
"""By search and budget how far above the best known runs have ended.  (problems, seeds)."""


def compare(
    names: Sequence[str],
    problems: Sequence[Problem],
    data: dict[str, Any],
    seeds: Callable[[str], int],
) -> Gaps:
    """Run everything; what is found anew lowers the best known before gaps are taken."""
    costs: Gaps = {}
    for name, budget in progress([(name, budget) for name in names for budget in BUDGETS]):
        found = costs[name, budget] = np.empty((len(problems), seeds(name)))
        for (i, seed), _ in np.ndenumerate(found):
            found[i, seed], x = solve(name, problems[i], budget, seed)
            subpaths.keep_best(data, problems[i], found[i, seed], x)
    best = np.array([subpaths.best_known(data, each) for each in problems])[:, None]
    return {key: (each - best) / np.maximum(best, 2.0) for key, each in costs.items()}


def resampled(gaps: FloatArray) -> FloatArray:
    """Success of bootstrap samples of problems and seeds, of all searches the same.

    (problems, seeds) -> (samples,).
    """
    problems, seeds = gaps.shape
    which = np.random.default_rng(1).integers(problems, size=(_SAMPLES, problems))
    again = np.random.default_rng([2, seeds]).integers(seeds, size=(_SAMPLES, problems, seeds))
    return np.asarray((gaps <= SUCCESS)[which[:, :, None], again].mean(axis=(1, 2)))


def interval(shares: FloatArray) -> tuple[float, float]:
    """95 % of samples lie within it."""
    low, high = np.percentile(shares, [2.5, 97.5])
    return float(low), float(high)


def needles(gaps: Gaps) -> NDArray[np.bool_]:
    """Problems whose best basin nobody finds in 30 % of runs with the largest budget."""
    shares = [
        (v <= SUCCESS).mean(axis=1) for (_, budget), v in gaps.items() if budget == BUDGETS[-1]
    ]
    return np.asarray(np.max(shares, axis=0) < _NEEDLE)


def rows(gaps: Gaps) -> Found:
    """Mean gap, success with its interval, and how far the refined DE is ahead; percent."""
    for (name, budget), mine in gaps.items():
        samples = resampled(mine)
        low, high = interval(100.0 * samples)
        ours, ahead = gaps.get((OURS, budget)), (None, None)
        if name != OURS and ours is not None:
            ahead = interval(100.0 * (resampled(ours) - samples))
        yield {
            "search": name,
            "evaluations|,": budget,
            "mean gap|.2f": 100.0 * mine.mean(),
            "within 1 %|.1f": 100.0 * (mine <= SUCCESS).mean(),
            "from|.1f": low,
            "to|.1f": high,
            "ours ahead from|.1f": ahead[0],
            "ahead to|.1f": ahead[1],
        }


def bars_of(gaps: Gaps, objective: str) -> Iterator[Bar]:
    """Ours beside its bars and, with the flight objective, beside the best of the rivals there."""
    percent = {key: 100.0 * float((each <= SUCCESS).mean()) for key, each in gaps.items()}
    ours = {budget: value for (name, budget), value in percent.items() if name == OURS}
    for budget, bar in _BARS[objective].items() if ours else ():
        yield least(f"search, {objective} objective, {budget:,}: within 1 %, %", ours[budget], bar)
    for budget, value in ours.items() if objective == "flight" else ():
        rivals = {n: each for (n, b), each in percent.items() if b == budget and n != OURS}
        if rivals:
            best = max(rivals, key=rivals.__getitem__)
            yield most(f"search, {budget:,}: points behind {best}", rivals[best] - value, 0.0)


def search_long(problems: Sequence[Problem], data: dict[str, Any], runs: int) -> None:
    """Best known values by long searches with large populations, half without warm starts."""
    for problem in progress(problems):
        for run in range(runs):
            how = refined_de.Settings(population=(120, 200, 300)[run % 3], smallest=8, memory=20)
            seeds = problem.seeds if run % 2 else problem.seeds[:0]
            rng = np.random.default_rng([run, 1])
            state = refined_de.begin(problem.dimensions, 30_000, seeds, how, rng)
            subpaths.keep_best(data, problem, *refine(state, problem, 30_000))


def quality(
    objective: str = OneOf("flight", "paper"),
    seeds: int = 10,
    slow_seeds: int = 2,
    only: tuple[str, ...] = Some((OURS, *RIVALS)),
    all_: bool = False,
    record: bool = False,
    best_known: int = 0,
) -> Found:
    """The comparison.

    slow_seeds: of CMA-ES and scipy's DE; all_: with the problems used for tuning; record: the
    missions are flown anew; best_known: runs of long searches.
    """
    data = subpaths.record() if record else subpaths.load()
    problems = [p for p in subpaths.problems(data, objective) if all_ or not p.for_tuning]
    if best_known:
        search_long(problems, data, best_known)
        subpaths.store(data)
    stale = sum(math.isinf(subpaths.best_known(data, p)) for p in problems)
    if stale:
        yield f"{stale} objectives are not those on file: add --best-known 12"
    gaps = compare(only, problems, data, lambda n: slow_seeds if n in _SLOW else seeds)
    subpaths.store(data)
    hard = needles(gaps)
    yield f"{len(problems)} problems"
    yield from rows(gaps)
    if hard.any():
        names = ", ".join(p.name for p, drop in zip(problems, hard, strict=True) if drop)
        yield f"without {hard.sum()} needles ({names})"
        gaps = {key: each[~hard] for key, each in gaps.items()}
        yield from rows(gaps)
    yield from bars_of(gaps, objective)


if __name__ == "__main__":
    main(quality)
