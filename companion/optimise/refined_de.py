"""The search of profile `flight`: the paper's improved DE (eq. 13-18), refined.

What differs from `improved_de`, each part measured (planner-numbers, part C;
docs/lab/benchmarks.md):

- x_best of eq. 17 is one of the p best, x_r1 half the time the member itself, and x_r3 may come
  from an archive of beaten parents (as in JADE: Zhang and Sanderson, IEEE Trans. Evol. Comp. 13,
  2009);
- the factor of x_r2 - x_r3 is 1 - a, not k2 a: the paper's takes no differences when it goes
  towards the best, and the population collapses; k1 and k2 (eq. 18) stay at 0 and 1;
- a and Cr are drawn about a memory of what succeeded, 1 - a by its Lehmer mean and from Cauchy's
  distribution (as F in L-SHADE: Tanabe and Fukunaga, CEC 2014, sec. II);
- the population shrinks linearly (the same), and begins as large as the budget allows.

What follows `Single source` is plain Python over a `State`, which numba compiles as it is: compiled
or not, the search is the same.  One round is

    n = ask(state)
    for i in range(n):
        state.trial_costs[i] = cost(state.trial[i])  # or inf, once it is above trial_bounds[i]
    tell(state, n)

and after each round `ranked` tells the best so far.
"""

import math
from typing import NamedTuple, final

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from companion.geodesy import FloatArray
from companion.optimise.loop import first_members

IntArray = npt.NDArray[np.int64]

FEWEST = 4  # members that eq. 17 needs: a parent and three others
_PER_ROOT = 1.1  # members at the start for each square root of an evaluation
_LEAST, _MOST = 20, 150  # members at the start
_MAX_GAIN = 1e9  # counts for one success: it may be infinite

SPENT, SIZE, KEPT, NEXT = range(4)
"""Of `State.now`: evaluations, members (0 before the first are told), archived parents, the slot of
the memory that is written next."""
SLOT, P_BEST, R1, R2, R3, CERTAIN, ARCHIVE, CROSS = range(8)
"""Columns of `State.uniforms`: slot of the memory, x_best, x_r1, x_r2 and x_r3 of eq. 17, the
variable that certainly changes, whose place in the archive is taken; from CROSS on, eq. 13."""


class Settings(NamedTuple):
    """The refined DE's parameters; the defaults were measured (docs/lab/benchmarks.md)."""

    population: int = 0  # members at the start; 0: as the budget allows, 60 for 3,000 evaluations
    smallest: int = 6  # members at the end of the linear reduction
    p_best: float = 0.2  # share of the population among which x_best of eq. 17 is drawn
    own: float = 0.5  # share of trials whose x_r1 is the member itself: it keeps basins apart
    memory: int = 5  # pairs of a and Cr that are remembered
    spread: float = 0.1  # of a and Cr about what is remembered

    def members(self, evaluations: int) -> int:
        """Members at the start of a search with so many evaluations."""
        wanted = round(_PER_ROOT * math.sqrt(max(evaluations, 0)))
        return self.population or max(min(max(wanted, _LEAST), _MOST), self.smallest)


class State(NamedTuple):
    """A search under way: arrays that are changed in place.  NP members, D variables."""

    settings: Settings
    budget: int
    uniforms: FloatArray  # (E, CROSS + D): row e is drawn for evaluation e
    deviates: FloatArray  # (E, 2): likewise, Cauchy's for a, normal ones for Cr
    now: IntArray  # (4,): how far it is
    population: FloatArray  # (NP, D): the first `SIZE` rows count
    costs: FloatArray  # (NP,)
    order: IntArray  # (NP,): members, best first
    drawn: FloatArray  # (NP, 2): 1 - a and Cr of the trials under way
    trial: FloatArray  # (NP, D): what ask() wants to know
    trial_costs: FloatArray  # (NP,): the answer
    trial_bounds: FloatArray  # (NP,): a trial that costs more is sure to be rejected
    archive: FloatArray  # (NP, D): beaten parents, the first `KEPT` rows count
    memory: FloatArray  # (H, 2): 1 - a and Cr that succeeded


def begin(
    dimensions: int, evaluations: int, seeds: FloatArray | None, settings: Settings, rng: Generator
) -> State:
    """A search of the unit cube that has not evaluated anything.

    evaluations: the budget; seeds: candidates to start from, (K, D).  The more seeds, the fewer
    random members.  All that is random in the search is drawn here.
    """
    size = min(max(settings.members(evaluations), FEWEST), evaluations)
    first = first_members(size, dimensions, rng, seeds)
    deviates = np.stack([rng.standard_cauchy(evaluations), rng.standard_normal(evaluations)], 1)
    return State(
        settings=settings,
        budget=evaluations,
        uniforms=rng.random((evaluations, CROSS + dimensions)),
        deviates=deviates,
        now=np.zeros(4, dtype=np.int64),
        population=np.zeros((size, dimensions)),
        costs=np.full(size, math.inf),
        order=np.arange(size),
        drawn=np.zeros((size, 2)),
        trial=first,
        trial_costs=np.full(size, math.inf),
        trial_bounds=np.full(size, math.inf),
        archive=np.zeros((size, dimensions)),
        memory=np.full((settings.memory, 2), 0.5),
    )


def ranked(state: State) -> tuple[FloatArray, FloatArray]:
    """The members without repetitions, best first.

    -> (M, D) in the unit cube, and their costs (M,); nothing before the first tell().
    """
    order = state.order[: state.now[SIZE]]
    x, costs = state.population[order], state.costs[order]
    first = np.sort(np.unique(x, axis=0, return_index=True)[1])
    return x[first], costs[first]


@final
class RefinedDE:
    """The search as an `Optimiser` for the one loop."""

    def __init__(
        self, dimensions: int, evaluations: int, rng: Generator, seeds: FloatArray | None = None
    ) -> None:
        """evaluations: the budget; seeds: candidates to start from, (K, D) in the unit cube."""
        self._state = begin(dimensions, evaluations, seeds, Settings(), rng)

    @property
    def population(self) -> FloatArray:
        """The members, best first.  -> (M, D)."""
        return ranked(self._state)[0]

    @property
    def costs(self) -> FloatArray:
        """The costs of the population.  -> (M,)."""
        return ranked(self._state)[1]

    def ask(self) -> FloatArray:
        """The candidates to evaluate next.  -> (P, D) in the unit cube."""
        return self._state.trial[: ask(self._state)].copy()

    def tell(self, costs: FloatArray) -> None:
        """The costs of the candidates of the last ask(): (P,)."""
        self._state.trial_costs[: len(costs)] = costs
        tell(self._state, len(costs))


# Single source ------------------------------------------------------------------------------


def spent(state: State) -> int:
    """Evaluations so far."""
    return int(state.now[SPENT])


def ask(state: State) -> int:
    """Put the next candidates into trial[:n] and trial_bounds[:n].  -> n, 0 at the budget's end."""
    left = state.budget - spent(state)
    if spent(state) == 0:
        return min(len(state.trial), left)
    return _propose(state, min(int(state.now[SIZE]), left))


def tell(state: State, n: int) -> None:
    """Learn from trial_costs[:n], the costs of the trials of the last ask()."""
    now, costs = state.now, state.trial_costs[:n]
    costs[:] = np.where(np.isnan(costs), math.inf, costs)
    now[SPENT] += n
    if now[SPENT] == n:  # the first members
        state.population[:n], state.costs[:n], now[SIZE] = state.trial[:n], costs, n
    else:
        _select(state, n)
    order = state.order[: now[SIZE]]
    order[:] = order[np.argsort(state.costs[order], kind="mergesort")]  # stable, known to numba
    _reduce(state)


def _propose(state: State, n: int) -> int:
    """The trials of the first n members: eq. 17 with k1 and k2 of eq. 18, and eq. 13.  -> n."""
    rules, memory = state.settings, state.memory
    population, archive, trial = state.population, state.archive, state.trial
    size, total = int(state.now[SIZE]), int(state.now[SIZE] + state.now[KEPT])
    among = min(max(int(rules.p_best * size + 0.5), 2), size)
    for i in range(n):
        u, deviates = state.uniforms[spent(state) + i], state.deviates[spent(state) + i]
        slot = int(u[SLOT] * len(memory))
        pull = min(max(memory[slot, 0] + rules.spread * deviates[0], 0.0), 1.0)  # 1 - a
        cr = memory[slot, 1] + rules.spread * deviates[1]
        state.drawn[i, 0], state.drawn[i, 1] = pull, min(max(cr, 0.0), 1.0)
        best = state.order[int(u[P_BEST] * among)]
        drawn = (u[R1] - rules.own) / (1.0 - rules.own)
        r1, r2, r3 = others(i, size, total, max(drawn, 0.0), u[R2], u[R3])
        if drawn < 0.0:
            r1 = i
        certain = int(u[CERTAIN] * trial.shape[1])
        for j in range(trial.shape[1]):
            if u[CROSS + j] <= cr or j == certain:
                x_3 = population[r3, j] if r3 < size else archive[r3 - size, j]
                mutant = (1.0 - pull) * population[r1, j] + pull * population[best, j]
                mutant += pull * (population[r2, j] - x_3)
                trial[i, j] = min(max(mutant, 0.0), 1.0)
            else:
                trial[i, j] = population[i, j]
        state.trial_bounds[i] = state.costs[i]
    return n


def others(i: int, size: int, total: int, u1: float, u2: float, u3: float) -> tuple[int, int, int]:
    """Three that are not i nor each other, two of size and the third of total, by uniform u."""
    r1 = _past(int(u1 * (size - 1)), i)
    low, high = min(i, r1), max(i, r1)
    r2 = _past(_past(int(u2 * (size - 2)), low), high)
    low, middle, high = min(low, r2), max(low, min(high, r2)), max(high, r2)
    return r1, r2, _past(_past(_past(int(u3 * (total - 3)), low), middle), high)


def _past(index: int, taken: int) -> int:
    """An index among those that are left, counted with the one that is taken."""
    return index + 1 if index >= taken else index


def _select(state: State, n: int) -> None:
    """Eq. 14, and what it teaches: the archive and the memory of a and Cr, by gains in cost."""
    now, first_row = state.now, spent(state) - n
    total = pulls = squares = crs = 0.0
    for i in range(n):
        cost, trial_cost = float(state.costs[i]), float(state.trial_costs[i])
        if trial_cost > cost:
            continue
        if trial_cost < cost:
            gain, pull = min(cost - trial_cost, _MAX_GAIN), state.drawn[i, 0]
            total += gain
            pulls += gain * pull
            squares += gain * pull**2
            crs += gain * state.drawn[i, 1]
            kept = int(now[KEPT])
            if kept < now[SIZE]:
                now[KEPT] += 1
            else:  # in the place of a random one
                kept = int(state.uniforms[first_row + i, ARCHIVE] * now[SIZE])
            state.archive[kept] = state.population[i]
        state.population[i], state.costs[i] = state.trial[i], trial_cost
    if total > 0.0:
        learnt = state.memory[now[NEXT]]
        learnt[0], learnt[1] = squares / pulls if pulls > 0.0 else 0.0, crs / total
        now[NEXT] = (now[NEXT] + 1) % len(state.memory)


def _reduce(state: State) -> None:
    """Drop the worst members: the size falls linearly with the evaluations."""
    now, first = state.now, len(state.population)
    smallest = min(state.settings.smallest, first)
    wanted = int(first + (smallest - first) * now[SPENT] / state.budget + 0.5)
    for last in range(int(now[SIZE]) - 1, wanted - 1, -1):  # the last takes the worst's place
        order, worst = state.order[:last], int(state.order[last])
        state.population[worst], state.costs[worst] = state.population[last], state.costs[last]
        order[order == last] = worst
    now[SIZE] = min(now[SIZE], wanted)
    now[KEPT] = min(now[KEPT], now[SIZE])
