"""The search of profile `flight`: the paper's improved DE (eq. 13-18), refined.

What differs from `improved_de`, each part measured (planner-numbers, part C;
scripts/benchmarks/quality.py):

- x_best of eq. 17 is one of the p best, x_r1 half the time the member itself, and x_r3 may come
  from an archive of beaten parents (as in JADE: Zhang and Sanderson, IEEE Trans. Evol. Comp. 13,
  2009);
- the factor of x_r2 - x_r3 is k2 (1 - a), not k2 a: the paper's takes no differences when it goes
  towards the best, and the population collapses; k1 and k2 (eq. 18) stay at 0 and 1 by default;
- a and Cr are drawn about a memory of what succeeded, 1 - a by its Lehmer mean and from Cauchy's
  distribution (as F in L-SHADE: Tanabe and Fukunaga, CEC 2014, sec. II);
- the population shrinks linearly (the same), and begins as large as the budget allows;
- the last share of the budget goes to a simplex about the best (`nelder_mead`).

What follows `Single source` is plain Python over the arrays of a `State` and runs as it is; a
compiler may take `HELPERS` as well, and makes the same search.  One round is

    n = ask(state)
    for i in range(n):
        state.trial_costs[i] = cost(state.trial[i])  # or inf, once it is above trial_bounds[i]
    tell(state, n)

and after each round `ranked` tells the best so far.
"""

import math
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.optimise import nelder_mead
from companion.optimise.nelder_mead import begin_polish, propose_vertices, transform
from companion.optimise.refined_state import (
    ARCHIVE,
    ARCHIVED,
    BUDGET,
    EVOLVE,
    FEWEST,
    FIRST,
    K1_FROM,
    K1_TO,
    K2_FROM,
    K2_TO,
    OWN,
    P_BEST,
    PHASE,
    POLISH_AT,
    SIZE,
    SLOT,
    SMALLEST,
    SPENT,
    SPREAD,
    START,
    U_ARCHIVE,
    U_CROSS,
    U_KEPT,
    U_P_BEST,
    U_R1,
    U_R2,
    U_R3,
    U_SLOT,
    Settings,
    State,
    begin,
    ranked,
)

__all__ = ["HELPERS", "RefinedDE", "Settings", "State", "ask", "begin", "ranked", "spent", "tell"]

_MOST_GAIN = 1e9  # counts for one success: it may be infinite


@final
class RefinedDE:
    """The search as an `Optimiser` for the one loop; it goes on polishing beyond its budget."""

    def __init__(
        self,
        dimensions: int,
        evaluations: int,
        settings: Settings,
        rng: np.random.Generator,
        seeds: FloatArray | None = None,
    ) -> None:
        """evaluations: the budget; seeds: candidates to start from, (K, D) in the unit cube."""
        if seeds is None:
            seeds = np.empty((0, dimensions))
        self._state = begin(dimensions, max(evaluations, 1), seeds, settings, rng)
        self._state.counters[BUDGET] = np.iinfo(np.int64).max

    @property
    def population(self) -> FloatArray:
        """What was evaluated and is worth a closer look, best first.  -> (M, D)."""
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
    return int(state.counters[SPENT])


def ask(state: State) -> int:
    """Put the next candidates into trial[:n] and trial_bounds[:n].  -> n, 0 at the budget's end."""
    counters = state.counters
    left = int(counters[BUDGET] - counters[SPENT])
    phase = int(counters[PHASE])
    if left <= 0:
        return 0
    if phase == START:
        return min(int(counters[SIZE]), left)
    if phase == EVOLVE:
        n = min(int(counters[SIZE]), int(counters[POLISH_AT] - counters[SPENT]))
        _propose(state, n)
        return n
    return min(propose_vertices(state, phase), left)


def tell(state: State, n: int) -> None:
    """Learn from trial_costs[:n], the costs of the trials of the last ask()."""
    counters = state.counters
    phase = int(counters[PHASE])
    counters[SPENT] += n
    for i in range(n):
        if math.isnan(state.trial_costs[i]):
            state.trial_costs[i] = math.inf
    if phase == START:
        _populate(state, n)
    elif phase == EVOLVE:
        _select(state, n)
    else:
        transform(state, n, phase)
        return
    _sort(state)
    _reduce(state)
    if counters[SPENT] >= counters[POLISH_AT] or counters[SIZE] < FEWEST:
        begin_polish(state)


def _populate(state: State, n: int) -> None:
    """The first trials are the population."""
    for i in range(n):
        for j in range(state.trial.shape[1]):
            state.population[i, j] = state.trial[i, j]
        state.costs[i] = state.trial_costs[i]
    state.counters[SIZE] = n
    state.counters[PHASE] = EVOLVE


def _propose(state: State, n: int) -> None:
    """The trials of the first n members: eq. 17 with k1 and k2 of eq. 18, and eq. 13."""
    counters, numbers, memory = state.counters, state.numbers, state.memory
    population, archive, trial = state.population, state.archive, state.trial
    size, total = int(counters[SIZE]), int(counters[SIZE] + counters[ARCHIVED])
    among = min(max(int(numbers[P_BEST] * size + 0.5), 2), size)
    progress = (counters[SPENT] / counters[POLISH_AT]) ** 2
    k1 = numbers[K1_FROM] + (numbers[K1_TO] - numbers[K1_FROM]) * progress
    k2 = numbers[K2_FROM] + (numbers[K2_TO] - numbers[K2_FROM]) * progress
    spread, own = numbers[SPREAD], numbers[OWN]
    memories, dimensions = memory.shape[0], trial.shape[1]
    uniforms, deviates = state.uniforms, state.deviates
    for i in range(n):
        row = int(counters[SPENT]) + i
        slot = int(uniforms[row, U_SLOT] * memories)
        pull = min(max(memory[slot, 0] + spread * deviates[row, 0], 0.0), 1.0)  # 1 - a
        cr = memory[slot, 1] + spread * deviates[row, 1]
        state.pull[i], state.cr[i] = pull, min(max(cr, 0.0), 1.0)
        best = state.order[int(uniforms[row, U_P_BEST] * among)]
        drawn = (uniforms[row, U_R1] - own) / (1.0 - own)
        r1, r2, r3 = others(
            i, size, total, max(drawn, 0.0), uniforms[row, U_R2], uniforms[row, U_R3]
        )
        if drawn < 0.0:
            r1 = i
        of_1, of_best, of_pair = 1.0 - pull - k1 * pull, pull + k1 * pull, k2 * pull
        kept = int(uniforms[row, U_KEPT] * dimensions)
        for j in range(dimensions):
            if uniforms[row, U_CROSS + j] <= cr or j == kept:
                x_3 = population[r3, j] if r3 < size else archive[r3 - size, j]
                mutant = of_1 * population[r1, j] + of_best * population[best, j]
                mutant += of_pair * (population[r2, j] - x_3)
                trial[i, j] = min(max(mutant, 0.0), 1.0)
            else:
                trial[i, j] = population[i, j]
        state.trial_bounds[i] = state.costs[i]


def others(i: int, size: int, total: int, u1: float, u2: float, u3: float) -> tuple[int, int, int]:
    """Three that are not i nor each other, two of size and the third of total, by uniform u."""
    r1 = int(u1 * (size - 1))
    if r1 >= i:
        r1 += 1
    low, high = min(i, r1), max(i, r1)
    r2 = int(u2 * (size - 2))
    if r2 >= low:
        r2 += 1
    if r2 >= high:
        r2 += 1
    middle = max(low, min(high, r2))
    low, high = min(low, r2), max(high, r2)
    r3 = int(u3 * (total - 3))
    if r3 >= low:
        r3 += 1
    if r3 >= middle:
        r3 += 1
    if r3 >= high:
        r3 += 1
    return r1, r2, r3


def _select(state: State, n: int) -> None:
    """Eq. 14, and what it teaches: the archive and the memory of a and Cr, by gains in cost."""
    first_row = int(state.counters[SPENT]) - n
    total = pulls = squares = crs = 0.0
    for i in range(n):
        cost, trial_cost = float(state.costs[i]), float(state.trial_costs[i])
        if trial_cost > cost:
            continue
        if trial_cost < cost:
            gain = min(cost - trial_cost, _MOST_GAIN)
            total += gain
            pulls += gain * state.pull[i]
            squares += gain * state.pull[i] ** 2
            crs += gain * state.cr[i]
            _keep(state, i, first_row + i)
        for j in range(state.trial.shape[1]):
            state.population[i, j] = state.trial[i, j]
        state.costs[i] = trial_cost
    if total > 0.0:
        slot = int(state.counters[SLOT])
        state.memory[slot, 0] = squares / pulls if pulls > 0.0 else 0.0
        state.memory[slot, 1] = crs / total
        state.counters[SLOT] = (slot + 1) % state.memory.shape[0]


def _keep(state: State, i: int, row: int) -> None:
    """Member i, beaten by its trial, goes into the archive, in place of a random one if full."""
    counters = state.counters
    room = int(state.numbers[ARCHIVE] * counters[SIZE])
    if room == 0:
        return
    slot = int(counters[ARCHIVED])
    if slot < room:
        counters[ARCHIVED] += 1
    else:
        slot = int(state.uniforms[row, U_ARCHIVE] * room)
    for j in range(state.archive.shape[1]):
        state.archive[slot, j] = state.population[i, j]


def _sort(state: State) -> None:
    """Bring the order up to date: by insertion, as few members change their place."""
    order, costs = state.order, state.costs
    for k in range(1, int(state.counters[SIZE])):
        member = order[k]
        cost = costs[member]
        at = k
        while at > 0 and costs[order[at - 1]] > cost:
            order[at] = order[at - 1]
            at -= 1
        order[at] = member


def _reduce(state: State) -> None:
    """Drop the worst members: the size falls linearly with the evaluations."""
    counters = state.counters
    progress = min(counters[SPENT] / counters[POLISH_AT], 1.0)
    wanted = int(counters[FIRST] + (counters[SMALLEST] - counters[FIRST]) * progress + 0.5)
    while counters[SIZE] > wanted:
        last = int(counters[SIZE]) - 1
        worst = int(state.order[last])
        for j in range(state.population.shape[1]):
            state.population[worst, j] = state.population[last, j]
        state.costs[worst] = state.costs[last]
        for k in range(last):
            if state.order[k] == last:
                state.order[k] = worst
        counters[SIZE] = last
    counters[ARCHIVED] = min(counters[ARCHIVED], int(state.numbers[ARCHIVE] * counters[SIZE]))


HELPERS = (
    *nelder_mead.HELPERS,
    spent,
    others,
    _propose,
    ask,
    _populate,
    _keep,
    _select,
    _sort,
    _reduce,
    tell,
)
"""Every function that a compiled search needs, callees first."""
