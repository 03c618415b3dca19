"""The search of profile `flight`: the paper's improved DE (eq. 13-18), refined.

What differs from `improved_de`, each part measured (planner-numbers, part C;
docs/results/benchmarks.md):

- x_best of eq. 17 is one of the p best, x_r1 half the time the member itself, and x_r3 may come
  from an archive of beaten parents (as in JADE: Zhang and Sanderson, IEEE Trans. Evol. Comp. 13,
  2009);
- the factor of x_r2 - x_r3 is 1 - a, not k2 a: the paper's takes no differences when it goes
  towards the best, and the population collapses; k1 and k2 (eq. 18) stay at 0 and 1;
- a and Cr are drawn about a memory of what succeeded, 1 - a by its Lehmer mean and from Cauchy's
  distribution (as F in L-SHADE: Tanabe and Fukunaga, CEC 2014, sec. II);
- the population shrinks linearly (the same), and begins as large as the budget allows;
- the last share of the budget goes to a simplex about the best (Nelder and Mead 1965).

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
_COLLAPSED = 1e-5  # widest edge of a simplex that is begun anew

SPENT, PHASE, SIZE, KEPT, NEXT = range(5)
"""Of `State.now`: evaluations, what the trials under way are, members, archived parents, the slot
of the memory that is written next."""
START, EVOLVE, BUILD, REFLECT, EXPAND, OUTSIDE, INSIDE, SHRINK = range(8)  # what trials are
SLOT, P_BEST, R1, R2, R3, CERTAIN, ARCHIVE, CROSS = range(8)
"""Columns of `State.uniforms`: slot of the memory, x_best, x_r1, x_r2 and x_r3 of eq. 17, the
variable that certainly changes, whose place in the archive is taken; from CROSS on, eq. 13."""


class Settings(NamedTuple):
    """The refined DE's parameters; the defaults were measured (docs/results/benchmarks.md)."""

    population: int = 0  # members at the start; 0: as the budget allows, 60 for 3,000 evaluations
    smallest: int = 6  # members at the end of the linear reduction
    p_best: float = 0.2  # share of the population among which x_best of eq. 17 is drawn
    own: float = 0.5  # share of trials whose x_r1 is the member itself: it keeps basins apart
    memory: int = 5  # pairs of a and Cr that are remembered
    spread: float = 0.1  # of a and Cr about what is remembered
    polish: float = 0.15  # share of the budget that goes to the simplex, at the end
    edge: float = 0.05  # of a new simplex

    def members(self, evaluations: int) -> int:
        """Members at the start of a search with so many evaluations."""
        wanted = round(_PER_ROOT * math.sqrt(max(evaluations, 0)))
        return self.population or max(min(max(wanted, _LEAST), _MOST), self.smallest)


class State(NamedTuple):
    """A search under way: arrays that are changed in place.  NP members, D variables."""

    settings: Settings
    budget: int
    polish_at: int  # evaluations before the simplex
    uniforms: FloatArray  # (E, CROSS + D): row e is drawn for evaluation e of the evolution
    deviates: FloatArray  # (E, 2): likewise, Cauchy's for a, normal ones for Cr
    now: IntArray  # (5,): how far it is
    population: FloatArray  # (NP, D): the first `SIZE` rows count
    costs: FloatArray  # (NP,)
    order: IntArray  # (NP,): members, best first
    drawn: FloatArray  # (NP, 2): 1 - a and Cr of the trials under way
    trial: FloatArray  # (max(NP, D), D): what ask() wants to know
    trial_costs: FloatArray  # (max(NP, D),): the answer
    trial_bounds: FloatArray  # (max(NP, D),): a trial that costs more is sure to be rejected
    archive: FloatArray  # (NP, D): beaten parents, the first `KEPT` rows count
    memory: FloatArray  # (H, 2): 1 - a and Cr that succeeded
    simplex: FloatArray  # (D + 2, D): vertices, best first, and one that may replace the worst
    simplex_costs: FloatArray  # (D + 2,): infinite where there is none


def begin(
    dimensions: int, evaluations: int, seeds: FloatArray | None, settings: Settings, rng: Generator
) -> State:
    """A search of the unit cube that has not evaluated anything.

    evaluations: the budget; seeds: candidates to start from, (K, D).  The more seeds, the fewer
    random members.  All that is random in the search is drawn here.
    """
    polish_at = max(evaluations - int(settings.polish * evaluations), 1)
    size = min(settings.members(evaluations), polish_at)
    rows = max(size, dimensions)
    trial = np.zeros((rows, dimensions))
    trial[:size] = first_members(size, dimensions, rng, seeds)
    deviates = np.stack([rng.standard_cauchy(polish_at), rng.standard_normal(polish_at)], axis=1)
    return State(
        settings=settings,
        budget=evaluations,
        polish_at=polish_at,
        uniforms=rng.random((polish_at, CROSS + dimensions)),
        deviates=deviates,
        now=np.array([0, START, size, 0, 0]),
        population=np.zeros((size, dimensions)),
        costs=np.full(size, math.inf),
        order=np.arange(size),
        drawn=np.zeros((size, 2)),
        trial=trial,
        trial_costs=np.full(rows, math.inf),
        trial_bounds=np.full(rows, math.inf),
        archive=np.zeros((size, dimensions)),
        memory=np.full((settings.memory, 2), 0.5),
        simplex=np.zeros((dimensions + 2, dimensions)),
        simplex_costs=np.full(dimensions + 2, math.inf),
    )


def ranked(state: State) -> tuple[FloatArray, FloatArray]:
    """What is worth a closer look: population and simplex without repetitions, best first.

    -> (M, D) in the unit cube, and their costs (M,); nothing before the first tell().
    """
    size = int(state.now[SIZE]) if state.now[PHASE] != START else 0
    vertices = state.simplex_costs < math.inf
    x = np.concatenate([state.simplex[vertices], state.population[:size]])
    costs = np.concatenate([state.simplex_costs[vertices], state.costs[:size]])
    order = np.argsort(costs, kind="stable")
    first = np.sort(np.unique(x[order], axis=0, return_index=True)[1])
    return x[order][first], costs[order][first]


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
    return int(state.now[SPENT])


def ask(state: State) -> int:
    """Put the next candidates into trial[:n] and trial_bounds[:n].  -> n, 0 at the budget's end."""
    left, size, phase = state.budget - spent(state), int(state.now[SIZE]), int(state.now[PHASE])
    if left <= 0:
        return 0
    if phase == START:
        return min(size, left)
    if phase == EVOLVE:
        return _propose(state, min(size, state.polish_at - spent(state)))
    return min(_propose_vertices(state, phase), left)


def tell(state: State, n: int) -> None:
    """Learn from trial_costs[:n], the costs of the trials of the last ask()."""
    now, costs = state.now, state.trial_costs[:n]
    costs[:] = np.where(np.isnan(costs), math.inf, costs)
    now[SPENT] += n
    if now[PHASE] > EVOLVE:
        _transform(state, n, int(now[PHASE]))
        return
    if now[PHASE] == START:
        state.population[:n], state.costs[:n] = state.trial[:n], costs
        now[SIZE], now[PHASE] = n, EVOLVE
    else:
        _select(state, n)
    order = state.order[: now[SIZE]]
    order[:] = order[np.argsort(state.costs[order], kind="mergesort")]
    _reduce(state)
    if now[SPENT] >= state.polish_at or now[SIZE] < FEWEST:
        best = state.order[0]
        state.simplex[0], state.simplex_costs[0] = state.population[best], state.costs[best]
        now[PHASE] = BUILD


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
    progress = min(now[SPENT] / state.polish_at, 1.0)
    wanted = int(first + (smallest - first) * progress + 0.5)
    for last in range(int(now[SIZE]) - 1, wanted - 1, -1):  # the last takes the worst's place
        order, worst = state.order[:last], int(state.order[last])
        state.population[worst], state.costs[worst] = state.population[last], state.costs[last]
        order[order == last] = worst
    now[SIZE] = min(now[SIZE], wanted)
    now[KEPT] = min(now[KEPT], now[SIZE])


# The simplex.  Factors for the number of variables D as Gao and Han choose them (Comput. Optim.
# Appl. 51, 2012): expansion 1 + 2 / D, contraction 3 / 4 - 1 / (2 D), shrinking 1 - 1 / D.
# Vertices are clipped into the unit cube; one that has collapsed is begun anew about its best.


def _propose_vertices(state: State, phase: int) -> int:
    """The trials of one step of the simplex.  -> how many."""
    simplex, trial, bounds = state.simplex, state.trial, state.trial_bounds
    dimensions = simplex.shape[1]
    best, worst, variables = simplex[0], simplex[dimensions], max(dimensions, 2)
    if phase == BUILD:  # one edge from the best along each axis, inwards where there is no room
        edge = state.settings.edge
        for k in range(dimensions):
            trial[k] = best
            trial[k, k] += edge if best[k] + edge <= 1.0 else -edge
    elif phase == SHRINK:
        trial[:dimensions] = best + (1.0 - 1.0 / variables) * (simplex[1 : dimensions + 1] - best)
    if phase in (BUILD, SHRINK):
        bounds[:dimensions] = math.inf
        return dimensions
    contraction = 0.75 - 0.5 / variables
    factors = (1.0, 1.0 + 2.0 / variables, contraction, -contraction)  # from REFLECT to INSIDE
    centre = simplex[:dimensions].sum(axis=0) / dimensions
    trial[0] = np.clip(centre + factors[phase - REFLECT] * (centre - worst), 0.0, 1.0)
    bounds[0] = state.simplex_costs[-1 if phase in (EXPAND, OUTSIDE) else dimensions]
    return 1


def _transform(state: State, n: int, phase: int) -> None:
    """Decide by the costs of the trials what the simplex becomes and what it tries next."""
    simplex, costs, trial = state.simplex, state.simplex_costs, state.trial
    cost, to_beat, worst = state.trial_costs[0], state.trial_bounds[0], simplex.shape[1]
    following = REFLECT
    if phase in (BUILD, SHRINK):
        simplex[1 : n + 1], costs[1 : n + 1] = trial[:n], state.trial_costs[:n]
    elif phase == REFLECT and cost >= to_beat:
        following = INSIDE
    elif phase == REFLECT and not costs[0] <= cost < costs[worst - 1]:
        simplex[-1], costs[-1] = trial[0], cost
        following = EXPAND if cost < costs[0] else OUTSIDE
    elif cost < to_beat or (phase == OUTSIDE and cost == to_beat):
        simplex[worst], costs[worst] = trial[0], cost
    elif phase == EXPAND:
        simplex[worst], costs[worst] = simplex[-1], to_beat
    else:
        following = SHRINK
    if following not in (EXPAND, OUTSIDE):
        costs[-1] = math.inf
    if following == REFLECT:
        order = np.argsort(costs[:-1], kind="mergesort")  # a stable one, and known to numba
        simplex[:-1], costs[:-1] = simplex[order], costs[order]
        if np.abs(simplex[1:-1] - simplex[0]).max() < _COLLAPSED:
            following = BUILD
    state.now[PHASE] = following
