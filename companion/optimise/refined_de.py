"""The search of profile `flight`: the paper's improved DE (eq. 13-18), refined.

What differs from `improved_de`, each part measured (planner-numbers, part C): the best of eq. 17 is
one of the p best; x_r3 may come from an archive of beaten parents; a and Cr follow a memory of what
succeeded (as in L-SHADE: Tanabe and Fukunaga, CEC 2014, sec. II); the population shrinks linearly;
and the last share of the budget goes to a Nelder-Mead simplex about the best (Nelder and Mead 1965,
with the coefficients of Gao and Han 2012 for the number of variables).

The functions below `Single source` are plain Python over the arrays of a `State` and run as they
are; a compiler may take `HELPERS` as well.  All that is random is drawn in `begin`, so that both
make the same search.  One round is

    n = ask(state)
    for i in range(n):
        state.trial_costs[i] = cost(state.trial[i])  # or inf, once it is above trial_bounds[i]
    tell(state, n)

and a round may be followed by `ranked` at any time.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
import numpy.typing as npt

from companion.errors import InputError
from companion.geodesy import FloatArray

IntArray = npt.NDArray[np.int64]

FEWEST = 4
"""Members that eq. 17 needs: a parent and three others."""
_SPREAD = 0.2  # standard deviation of a and Cr (3.2)
_MOST_GAIN = 1e9  # counts for one success: it may be infinite
_COLLAPSED = 1e-5  # widest edge of a simplex that is begun anew


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The refined DE's parameters; the defaults are measured (docs/search.md)."""

    population: int = 60
    """Members at the start."""
    smallest: int = 6
    """Members at the end of the linear reduction."""
    p_best: float = 0.2
    """Share of the population among which x_best of eq. 17 is drawn."""
    archive: float = 1.0
    """Beaten parents that are kept, per member."""
    memory: int = 5
    """Pairs of a and Cr that are remembered."""
    polish: float = 0.15
    """Share of the budget that goes to Nelder-Mead, at the end."""
    k1: tuple[float, float] = (0.0, 0.5)
    """k1 goes from the first to the second value (eq. 18)."""
    k2: tuple[float, float] = (1.0, 0.5)
    """k2 goes from the first to the second value (eq. 18)."""
    step: float = 0.05
    """Edge of a new simplex."""

    def __post_init__(self) -> None:
        if self.smallest < FEWEST:
            rule = f"eq. 17 needs {FEWEST} members"
            raise InputError("smallest", self.smallest, rule, f"Set {FEWEST} or more.")
        if self.population < self.smallest:
            rule = "the population cannot be smaller than its end"
            raise InputError("population", self.population, rule, f"Set {self.smallest} or more.")


class State(NamedTuple):
    """A search under way: arrays alone, changed in place.  NP members, D variables."""

    population: FloatArray  # (NP, D): the first counters[SIZE] rows count
    costs: FloatArray  # (NP,)
    order: IntArray  # (NP,): members, best first
    a: FloatArray  # (NP,): of the trials under way
    cr: FloatArray  # (NP,)
    trial: FloatArray  # (max(NP, D), D): what ask() wants to know
    trial_costs: FloatArray  # (max(NP, D),): the answer
    trial_bounds: FloatArray  # (max(NP, D),): a trial that costs more is sure to be rejected
    archive: FloatArray  # (A, D): the first counters[ARCHIVED] rows count
    memory: FloatArray  # (H, 2): a and Cr that succeeded
    simplex: FloatArray  # (D + 1, D): vertices, best first
    simplex_costs: FloatArray  # (D + 1,)
    centre: FloatArray  # (D,): of all vertices but the worst
    reflected: FloatArray  # (D,): the worst vertex reflected at the centre
    uniforms: FloatArray  # (E, 7 + D): row e is for evaluation e of the evolution
    normals: FloatArray  # (E, 2)
    numbers: FloatArray  # settings and scalars, by the names below
    counters: IntArray  # by the names below


# State.counters
SPENT, BUDGET, POLISH_AT, SIZE, FIRST, SMALLEST, ARCHIVED, SLOT, PHASE = range(9)
# State.numbers
P_BEST, ARCHIVE, K1_FROM, K1_TO, K2_FROM, K2_TO, STEP, REFLECTED_COST = range(8)
# State.counters[PHASE]: what the trials under way are
_START, _EVOLVE, _SIMPLEX, _REFLECT, _EXPAND, _OUTSIDE, _INSIDE, _SHRINK = range(8)
# columns of State.uniforms; the crossover of the variables follows
_U_SLOT, _U_P_BEST, _U_R1, _U_R2, _U_R3, _U_KEPT, _U_ARCHIVE, _U_CROSS = range(8)


def begin(
    dimensions: int,
    evaluations: int,
    seeds: FloatArray,
    settings: Settings,
    rng: np.random.Generator,
) -> State:
    """A search of the unit cube that has not evaluated anything.

    evaluations: the budget; seeds: candidates to start from, (K, D).  All that is random in the
    search is drawn here.
    """
    polish_at = max(evaluations - int(settings.polish * evaluations), 1)
    size = min(settings.population, polish_at)
    rows = max(size, dimensions)
    trial = np.zeros((rows, dimensions))
    trial[:size] = rng.random((size, dimensions))
    given = min(len(seeds), size)
    trial[:given] = np.clip(seeds[:given], 0.0, 1.0)
    numbers = np.zeros(8)
    numbers[:STEP] = settings.p_best, settings.archive, *settings.k1, *settings.k2
    numbers[STEP] = settings.step
    counters = np.zeros(9, dtype=np.int64)
    counters[:ARCHIVED] = 0, evaluations, polish_at, size, size, min(settings.smallest, size)
    return State(
        population=np.zeros((size, dimensions)),
        costs=np.full(size, math.inf),
        order=np.arange(size),
        a=np.zeros(size),
        cr=np.zeros(size),
        trial=trial,
        trial_costs=np.full(rows, math.inf),
        trial_bounds=np.full(rows, math.inf),
        archive=np.zeros((max(int(settings.archive * size), 1), dimensions)),
        memory=np.full((settings.memory, 2), 0.5),
        simplex=np.zeros((dimensions + 1, dimensions)),
        simplex_costs=np.full(dimensions + 1, math.inf),
        centre=np.zeros(dimensions),
        reflected=np.zeros(dimensions),
        uniforms=rng.random((polish_at, _U_CROSS + dimensions)),
        normals=rng.standard_normal((polish_at, 2)),
        numbers=numbers,
        counters=counters,
    )


def ranked(state: State) -> tuple[FloatArray, FloatArray]:
    """What is worth a closer look: population and simplex without repetitions, best first.

    -> (M, D) in the unit cube, and their costs (M,).
    """
    size = int(state.counters[SIZE]) if state.counters[PHASE] != _START else 0
    x = np.concatenate([state.simplex, state.population[:size]])
    costs = np.concatenate([state.simplex_costs, state.costs[:size]])
    known = np.concatenate([np.isfinite(state.simplex_costs), np.full(size, True)])
    x, costs = x[known], costs[known]
    order = np.argsort(costs, kind="stable")
    x, costs = x[order], costs[order]
    first = np.sort(np.unique(x, axis=0, return_index=True)[1])
    return x[first], costs[first]


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
    if phase == _START:
        return min(int(counters[SIZE]), left)
    if left <= 0:
        return 0
    if phase == _EVOLVE:
        n = min(int(counters[SIZE]), int(counters[POLISH_AT] - counters[SPENT]))
        for i in range(n):
            _propose(state, i)
        return n
    return min(_propose_vertices(state, phase), left)


def tell(state: State, n: int) -> None:
    """Learn from trial_costs[:n], the costs of the trials of the last ask()."""
    counters = state.counters
    phase = int(counters[PHASE])
    counters[SPENT] += n
    for i in range(n):
        if math.isnan(state.trial_costs[i]):
            state.trial_costs[i] = math.inf
    if phase == _START:
        _populate(state, n)
    elif phase == _EVOLVE:
        _select(state, n)
    else:
        _transform(state, n, phase)
        return
    if counters[SPENT] >= counters[POLISH_AT] or counters[SIZE] < FEWEST:
        _begin_polish(state)


def _populate(state: State, n: int) -> None:
    """The first trials are the population."""
    for i in range(n):
        for j in range(state.trial.shape[1]):
            state.population[i, j] = state.trial[i, j]
        state.costs[i] = state.trial_costs[i]
    state.counters[SIZE] = n
    state.counters[PHASE] = _EVOLVE
    _sort(state)


def _propose(state: State, i: int) -> None:
    """The trial of member i: eq. 17 with k1 and k2 of eq. 18, and eq. 13."""
    counters, numbers = state.counters, state.numbers
    size, archived = int(counters[SIZE]), int(counters[ARCHIVED])
    row = int(counters[SPENT]) + i
    uniforms = state.uniforms[row]
    slot = int(uniforms[_U_SLOT] * state.memory.shape[0])
    a = min(max(state.memory[slot, 0] + _SPREAD * state.normals[row, 0], 0.0), 1.0)
    cr = min(max(state.memory[slot, 1] + _SPREAD * state.normals[row, 1], 0.0), 1.0)
    state.a[i], state.cr[i] = a, cr
    progress = (counters[SPENT] / counters[POLISH_AT]) ** 2
    k1 = numbers[K1_FROM] + (numbers[K1_TO] - numbers[K1_FROM]) * progress
    k2 = numbers[K2_FROM] + (numbers[K2_TO] - numbers[K2_FROM]) * progress
    best = state.order[int(uniforms[_U_P_BEST] * max(int(numbers[P_BEST] * size + 0.5), 2))]
    r1, r2, r3 = _others(
        i, size, size + archived, uniforms[_U_R1], uniforms[_U_R2], uniforms[_U_R3]
    )
    parent, trial = state.population[i], state.trial[i]
    x_best, x_1, x_2 = state.population[best], state.population[r1], state.population[r2]
    x_3 = state.population[r3] if r3 < size else state.archive[r3 - size]
    of_1, of_best, of_pair = a - k1 * (1.0 - a), (1.0 + k1) * (1.0 - a), k2 * a
    dimensions = len(trial)
    kept = int(uniforms[_U_KEPT] * dimensions)
    for j in range(dimensions):
        if j == kept or uniforms[_U_CROSS + j] <= cr:
            mutant = of_1 * x_1[j] + of_best * x_best[j] + of_pair * (x_2[j] - x_3[j])
            trial[j] = min(max(mutant, 0.0), 1.0)
        else:
            trial[j] = parent[j]
    state.trial_bounds[i] = state.costs[i]


def _others(i: int, size: int, total: int, u1: float, u2: float, u3: float) -> tuple[int, int, int]:
    """Three distinct others than i: two of size members, the third of total, by uniform numbers."""
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
    """Eq. 14, the archive, the memory of a and Cr, and the reduction of the population."""
    total = mean_a = mean_cr = 0.0
    first_row = int(state.counters[SPENT]) - n
    for i in range(n):
        cost, trial_cost = float(state.costs[i]), float(state.trial_costs[i])
        if trial_cost > cost:
            continue
        if trial_cost < cost:
            weight = min(cost - trial_cost, _MOST_GAIN)
            total += weight
            mean_a += weight * state.a[i]
            mean_cr += weight * state.cr[i]
            _keep(state, i, first_row + i)
        for j in range(state.trial.shape[1]):
            state.population[i, j] = state.trial[i, j]
        state.costs[i] = trial_cost
    if total > 0.0:
        slot = int(state.counters[SLOT])
        state.memory[slot, 0] = mean_a / total
        state.memory[slot, 1] = mean_cr / total
        state.counters[SLOT] = (slot + 1) % state.memory.shape[0]
    _sort(state)
    _reduce(state)


def _keep(state: State, i: int, row: int) -> None:
    """Member i, beaten by its trial, goes into the archive, in place of a random one if full."""
    counters = state.counters
    room = max(int(state.numbers[ARCHIVE] * counters[SIZE]), 1)
    slot = int(counters[ARCHIVED])
    if slot < room:
        counters[ARCHIVED] += 1
    else:
        slot = int(state.uniforms[row, _U_ARCHIVE] * room)
    for j in range(state.archive.shape[1]):
        state.archive[slot, j] = state.population[i, j]


def _reduce(state: State) -> None:
    """Drop the worst members: the size falls linearly with the evaluations."""
    counters = state.counters
    progress = min(counters[SPENT] / counters[POLISH_AT], 1.0)
    wanted = int(counters[FIRST] + (counters[SMALLEST] - counters[FIRST]) * progress + 0.5)
    while counters[SIZE] > max(wanted, FEWEST):
        last = int(counters[SIZE]) - 1
        worst = int(state.order[last])
        for j in range(state.population.shape[1]):
            state.population[worst, j] = state.population[last, j]
        state.costs[worst] = state.costs[last]
        for k in range(last):
            if state.order[k] == last:
                state.order[k] = worst
        counters[SIZE] = last
    counters[ARCHIVED] = min(counters[ARCHIVED], max(int(state.numbers[ARCHIVE] * wanted), 1))


def _sort(state: State) -> None:
    """Bring order up to date: insertion, as few members change their place."""
    order, costs = state.order, state.costs
    for k in range(1, int(state.counters[SIZE])):
        member = order[k]
        cost = costs[member]
        at = k
        while at > 0 and costs[order[at - 1]] > cost:
            order[at] = order[at - 1]
            at -= 1
        order[at] = member


def _begin_polish(state: State) -> None:
    """The best member is the simplex's first vertex."""
    best = int(state.order[0])
    for j in range(state.simplex.shape[1]):
        state.simplex[0, j] = state.population[best, j]
    state.simplex_costs[0] = state.costs[best]
    state.counters[PHASE] = _SIMPLEX


def _propose_vertices(state: State, phase: int) -> int:
    """The trials of one step of the simplex.  -> how many."""
    dimensions = state.simplex.shape[1]
    simplex, costs = state.simplex, state.simplex_costs
    if phase == _SIMPLEX:
        for k in range(dimensions):
            for j in range(dimensions):
                state.trial[k, j] = simplex[0, j]
            step = state.numbers[STEP]
            up = simplex[0, k] + step
            state.trial[k, k] = up if up <= 1.0 else simplex[0, k] - step
            state.trial_bounds[k] = math.inf
        return dimensions
    if phase == _SHRINK:
        left = 1.0 - 1.0 / max(dimensions, 2)
        for k in range(dimensions):
            for j in range(dimensions):
                state.trial[k, j] = simplex[0, j] + left * (simplex[k + 1, j] - simplex[0, j])
            state.trial_bounds[k] = math.inf
        return dimensions
    narrow = 0.75 - 0.5 / max(dimensions, 2)
    factor, bound = 1.0, float(costs[dimensions])
    if phase == _EXPAND:
        factor, bound = 1.0 + 2.0 / max(dimensions, 2), float(state.numbers[REFLECTED_COST])
    elif phase == _OUTSIDE:
        factor, bound = narrow, float(state.numbers[REFLECTED_COST])
    elif phase == _INSIDE:
        factor = -narrow
    for j in range(dimensions):
        if phase == _REFLECT:
            total = 0.0
            for k in range(dimensions):
                total += simplex[k, j]
            state.centre[j] = total / dimensions
        at = state.centre[j] + factor * (state.centre[j] - simplex[dimensions, j])
        state.trial[0, j] = min(max(at, 0.0), 1.0)
    state.trial_bounds[0] = bound
    return 1


def _transform(state: State, n: int, phase: int) -> None:
    """One step of Nelder and Mead's decisions."""
    dimensions = state.simplex.shape[1]
    costs = state.simplex_costs
    cost = float(state.trial_costs[0])
    following = _REFLECT
    if phase in (_SIMPLEX, _SHRINK):
        for k in range(n):
            _replace(state, k + 1, k)
        _sort_simplex(state)
    elif phase == _REFLECT:
        if cost < costs[0]:
            following = _EXPAND
        elif cost < costs[dimensions - 1]:
            _insert(state)
        elif cost < costs[dimensions]:
            following = _OUTSIDE
        else:
            following = _INSIDE
        if following in (_EXPAND, _OUTSIDE):
            for j in range(dimensions):
                state.reflected[j] = state.trial[0, j]
            state.numbers[REFLECTED_COST] = cost
    elif phase == _EXPAND:
        if not cost < state.numbers[REFLECTED_COST]:
            for j in range(dimensions):
                state.trial[0, j] = state.reflected[j]
            state.trial_costs[0] = state.numbers[REFLECTED_COST]
        _insert(state)
    elif phase == _OUTSIDE and cost <= state.numbers[REFLECTED_COST]:
        _insert(state)
    elif phase == _INSIDE and cost < costs[dimensions]:
        _insert(state)
    else:
        following = _SHRINK
    if following == _REFLECT and _collapsed(state):
        following = _SIMPLEX
    state.counters[PHASE] = following


def _insert(state: State) -> None:
    """The first trial takes the worst vertex's place."""
    _replace(state, state.simplex.shape[1], 0)
    _sort_simplex(state)


def _replace(state: State, vertex: int, trial: int) -> None:
    for j in range(state.simplex.shape[1]):
        state.simplex[vertex, j] = state.trial[trial, j]
    state.simplex_costs[vertex] = state.trial_costs[trial]


def _sort_simplex(state: State) -> None:
    """Vertices by cost, by insertion."""
    simplex, costs = state.simplex, state.simplex_costs
    for k in range(1, simplex.shape[0]):
        at = k
        while at > 0 and costs[at - 1] > costs[at]:
            costs[at - 1], costs[at] = costs[at], costs[at - 1]
            for j in range(simplex.shape[1]):
                simplex[at - 1, j], simplex[at, j] = simplex[at, j], simplex[at - 1, j]
            at -= 1


def _collapsed(state: State) -> bool:
    """Whether all vertices are as good as one."""
    widest = 0.0
    for k in range(1, state.simplex.shape[0]):
        for j in range(state.simplex.shape[1]):
            widest = max(widest, abs(state.simplex[k, j] - state.simplex[0, j]))
    return widest < _COLLAPSED


HELPERS = (
    spent,
    _others,
    _propose,
    _propose_vertices,
    ask,
    _keep,
    _sort,
    _reduce,
    _select,
    _populate,
    _begin_polish,
    _replace,
    _sort_simplex,
    _insert,
    _collapsed,
    _transform,
    tell,
)
"""Every function that a compiled search needs, callees first."""
ENTRIES = (ask, tell)
"""What is worth compiling by itself."""
