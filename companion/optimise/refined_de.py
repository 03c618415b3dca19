"""The search of profile `flight`: the paper's improved DE (eq. 13-18), refined.

What differs from `improved_de`, each part measured (planner-numbers, part C;
scripts/benchmarks/quality.py):

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

from companion.geodesy import FloatArray
from companion.optimise.loop import first_members

IntArray = npt.NDArray[np.int64]

FEWEST = 4
"""Members that eq. 17 needs: a parent and three others."""
_PER_ROOT = 1.1  # members at the start for each square root of an evaluation
_LEAST, _MOST = 20, 150  # members at the start
_MAX_GAIN = 1e9  # counts for one success: it may be infinite
_COLLAPSED = 1e-5  # widest edge of a simplex that is begun anew

START, EVOLVE, BUILD, REFLECT, EXPAND, OUTSIDE, INSIDE, SHRINK = range(8)
"""`State.phase`: what the trials under way are."""


class Settings(NamedTuple):
    """The refined DE's parameters; the defaults were measured by scripts/benchmarks/quality.py."""

    population: int = 0
    """Members at the start; 0: as the budget allows, 60 for 3,000 evaluations."""
    smallest: int = 6
    """Members at the end of the linear reduction."""
    p_best: float = 0.2
    """Share of the population among which x_best of eq. 17 is drawn."""
    own: float = 0.5
    """Share of trials whose x_r1 of eq. 17 is the member itself: it keeps basins apart."""
    archive: float = 1.0
    """Beaten parents that are kept, per member."""
    memory: int = 5
    """Pairs of a and Cr that are remembered."""
    spread: float = 0.1
    """Of a and Cr about what is remembered."""
    polish: float = 0.15
    """Share of the budget that goes to the simplex, at the end."""
    edge: float = 0.05
    """Of a new simplex."""

    def members(self, evaluations: int) -> int:
        """Members at the start of a search with so many evaluations."""
        wanted = round(_PER_ROOT * math.sqrt(max(evaluations, 0)))
        return self.population or max(min(max(wanted, _LEAST), _MOST), self.smallest)


class Draws(NamedTuple):
    """Uniform numbers: row e is for evaluation e of the evolution."""

    slot: FloatArray  # (E,): of the memory
    p_best: FloatArray
    r1: FloatArray
    r2: FloatArray
    r3: FloatArray
    kept: FloatArray  # the variable that certainly changes
    archive: FloatArray  # whose place there a beaten parent takes
    cross: FloatArray  # (E, D)
    deviates: FloatArray  # (E, 2): Cauchy's for a, normal ones for Cr


class State(NamedTuple):
    """A search under way: arrays that are changed in place.  NP members, D variables."""

    settings: Settings
    budget: int
    polish_at: int  # evaluations before the simplex
    first: int  # members at the start
    smallest: int  # at the end
    draws: Draws
    spent: IntArray  # (1,): evaluations
    phase: IntArray  # (1,)
    size: IntArray  # (1,): members
    population: FloatArray  # (NP, D): the first `size` rows count
    costs: FloatArray  # (NP,)
    order: IntArray  # (NP,): members, best first
    pull: FloatArray  # (NP,): 1 - a of the trials under way
    cr: FloatArray  # (NP,)
    trial: FloatArray  # (max(NP, D), D): what ask() wants to know
    trial_costs: FloatArray  # (max(NP, D),): the answer
    trial_bounds: FloatArray  # (max(NP, D),): a trial that costs more is sure to be rejected
    archived: IntArray  # (1,)
    archive: FloatArray  # (A, D): the first `archived` rows count
    slot: IntArray  # (1,): of the memory, the next to be written
    memory: FloatArray  # (H, 2): 1 - a and Cr that succeeded
    simplex: FloatArray  # (D + 1, D): vertices, best first
    simplex_costs: FloatArray  # (D + 1,)
    centre: FloatArray  # (D,): of all vertices but the worst
    reflected: FloatArray  # (1, D): the worst vertex reflected at the centre
    reflected_cost: FloatArray  # (1,)


def begin(
    dimensions: int,
    evaluations: int,
    seeds: FloatArray,
    settings: Settings,
    rng: np.random.Generator,
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
    uniforms = rng.random((polish_at, 7 + dimensions))
    return State(
        settings=settings,
        budget=evaluations,
        polish_at=polish_at,
        first=size,
        smallest=min(settings.smallest, size),
        draws=Draws._make([*uniforms.T[:7], uniforms[:, 7:], deviates]),
        spent=np.array([0]),
        phase=np.array([START]),
        size=np.array([size]),
        population=np.zeros((size, dimensions)),
        costs=np.full(size, math.inf),
        order=np.arange(size),
        pull=np.zeros(size),
        cr=np.zeros(size),
        trial=trial,
        trial_costs=np.full(rows, math.inf),
        trial_bounds=np.full(rows, math.inf),
        archived=np.array([0]),
        archive=np.zeros((int(settings.archive * size), dimensions)),
        slot=np.array([0]),
        memory=np.full((settings.memory, 2), 0.5),
        simplex=np.zeros((dimensions + 1, dimensions)),
        simplex_costs=np.full(dimensions + 1, math.inf),
        centre=np.zeros(dimensions),
        reflected=np.zeros((1, dimensions)),
        reflected_cost=np.zeros(1),
    )


def ranked(state: State) -> tuple[FloatArray, FloatArray]:
    """What is worth a closer look: population and simplex without repetitions, best first.

    -> (M, D) in the unit cube, and their costs (M,); nothing before the first tell().
    """
    phase = int(state.phase[0])
    size = int(state.size[0]) if phase != START else 0
    vertices = state.simplex_costs < math.inf  # the others have not been evaluated
    pending = int(phase in (EXPAND, OUTSIDE))  # a reflected vertex may be the best so far
    x = np.concatenate(
        [state.simplex[vertices], state.reflected[:pending], state.population[:size]]
    )
    costs = np.concatenate(
        [
            state.simplex_costs[vertices],
            state.reflected_cost[:pending],
            state.costs[:size],
        ]
    )
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
        rng: np.random.Generator,
        seeds: FloatArray | None = None,
    ) -> None:
        """evaluations: the budget; seeds: candidates to start from, (K, D) in the unit cube."""
        if seeds is None:
            seeds = np.empty((0, dimensions))
        state = begin(dimensions, max(evaluations, 1), seeds, Settings(), rng)
        self._state = state._replace(budget=np.iinfo(np.int64).max)

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
    return int(state.spent[0])


def ask(state: State) -> int:
    """Put the next candidates into trial[:n] and trial_bounds[:n].  -> n, 0 at the budget's end."""
    left = int(state.budget - state.spent[0])
    phase = int(state.phase[0])
    if left <= 0:
        return 0
    if phase == START:
        return min(int(state.size[0]), left)
    if phase == EVOLVE:
        n = min(int(state.size[0]), int(state.polish_at - state.spent[0]))
        _propose(state, n)
        return n
    return min(propose_vertices(state, phase), left)


def tell(state: State, n: int) -> None:
    """Learn from trial_costs[:n], the costs of the trials of the last ask()."""
    phase = int(state.phase[0])
    state.spent[0] += n
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
    if state.spent[0] >= state.polish_at or state.size[0] < FEWEST:
        begin_polish(state)


def _populate(state: State, n: int) -> None:
    """The first trials are the population."""
    state.population[:n] = state.trial[:n]
    state.costs[:n] = state.trial_costs[:n]
    state.size[0] = n
    state.phase[0] = EVOLVE


def _propose(state: State, n: int) -> None:
    """The trials of the first n members: eq. 17 with k1 and k2 of eq. 18, and eq. 13."""
    rules, draws, memory = state.settings, state.draws, state.memory
    population, archive, trial = state.population, state.archive, state.trial
    size, total = int(state.size[0]), int(state.size[0] + state.archived[0])
    among = min(max(int(rules.p_best * size + 0.5), 2), size)
    spread, own = rules.spread, rules.own
    memories, dimensions = memory.shape[0], trial.shape[1]
    deviates = state.draws.deviates
    for i in range(n):
        row = int(state.spent[0]) + i
        slot = int(draws.slot[row] * memories)
        pull = min(max(memory[slot, 0] + spread * deviates[row, 0], 0.0), 1.0)  # 1 - a
        cr = memory[slot, 1] + spread * deviates[row, 1]
        state.pull[i], state.cr[i] = pull, min(max(cr, 0.0), 1.0)
        best = state.order[int(draws.p_best[row] * among)]
        drawn = (draws.r1[row] - own) / (1.0 - own)
        r1, r2, r3 = others(i, size, total, max(drawn, 0.0), draws.r2[row], draws.r3[row])
        if drawn < 0.0:
            r1 = i
        kept = int(draws.kept[row] * dimensions)
        for j in range(dimensions):
            if draws.cross[row, j] <= cr or j == kept:
                x_3 = population[r3, j] if r3 < size else archive[r3 - size, j]
                mutant = (1.0 - pull) * population[r1, j] + pull * population[best, j]
                mutant += pull * (population[r2, j] - x_3)
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
    first_row = int(state.spent[0]) - n
    total = pulls = squares = crs = 0.0
    for i in range(n):
        cost, trial_cost = float(state.costs[i]), float(state.trial_costs[i])
        if trial_cost > cost:
            continue
        if trial_cost < cost:
            gain = min(cost - trial_cost, _MAX_GAIN)
            total += gain
            pulls += gain * state.pull[i]
            squares += gain * state.pull[i] ** 2
            crs += gain * state.cr[i]
            _keep(state, i, first_row + i)
        state.population[i] = state.trial[i]
        state.costs[i] = trial_cost
    if total > 0.0:
        slot = int(state.slot[0])
        state.memory[slot, 0] = squares / pulls if pulls > 0.0 else 0.0
        state.memory[slot, 1] = crs / total
        state.slot[0] = (slot + 1) % state.memory.shape[0]


def _keep(state: State, i: int, row: int) -> None:
    """Member i, beaten by its trial, goes into the archive, in place of a random one if full."""
    room = int(state.settings.archive * state.size[0])
    if room == 0:
        return
    slot = int(state.archived[0])
    if slot < room:
        state.archived[0] += 1
    else:
        slot = int(state.draws.archive[row] * room)
    state.archive[slot] = state.population[i]


def _sort(state: State) -> None:
    """Bring the order up to date: by insertion, as few members change their place."""
    order, costs = state.order, state.costs
    for k in range(1, int(state.size[0])):
        member = order[k]
        cost = costs[member]
        at = k
        while at > 0 and costs[order[at - 1]] > cost:
            order[at] = order[at - 1]
            at -= 1
        order[at] = member


def _reduce(state: State) -> None:
    """Drop the worst members: the size falls linearly with the evaluations."""
    progress = min(state.spent[0] / state.polish_at, 1.0)
    wanted = int(state.first + (state.smallest - state.first) * progress + 0.5)
    while state.size[0] > wanted:
        last = int(state.size[0]) - 1
        worst = int(state.order[last])
        state.population[worst] = state.population[last]
        state.costs[worst] = state.costs[last]
        for k in range(last):
            if state.order[k] == last:
                state.order[k] = worst
        state.size[0] = last
    state.archived[0] = min(state.archived[0], int(state.settings.archive * state.size[0]))


# The simplex.  Factors for the number of variables D as Gao and Han choose them (Comput. Optim.
# Appl. 51, 2012): expansion 1 + 2 / D, contraction 3 / 4 - 1 / (2 D), shrinking 1 - 1 / D.
# Vertices are clipped into the unit cube; one that has collapsed is begun anew about its best.


def begin_polish(state: State) -> None:
    """The best member is the simplex's first vertex."""
    best = int(state.order[0])
    state.simplex[0] = state.population[best]
    state.simplex_costs[0] = state.costs[best]
    state.phase[0] = BUILD


def propose_vertices(state: State, phase: int) -> int:
    """The trials of one step of the simplex.  -> how many."""
    if phase == BUILD:
        _propose_simplex(state)
        return state.simplex.shape[1]
    if phase == SHRINK:
        _propose_smaller(state)
        return state.simplex.shape[1]
    worst = state.simplex.shape[1]
    variables = float(max(worst, 2))
    factor, bound = 1.0, float(state.simplex_costs[worst])
    if phase == REFLECT:
        _find_centre(state.simplex, state.centre)
    elif phase == EXPAND:
        factor, bound = 1.0 + 2.0 / variables, float(state.reflected_cost[0])
    elif phase == OUTSIDE:
        factor, bound = 0.75 - 0.5 / variables, float(state.reflected_cost[0])
    else:
        factor = 0.5 / variables - 0.75
    simplex, centre, trial = state.simplex, state.centre, state.trial
    for j in range(worst):
        at = centre[j] + factor * (centre[j] - simplex[worst, j])
        trial[0, j] = min(max(at, 0.0), 1.0)
    state.trial_bounds[0] = bound
    return 1


def transform(state: State, n: int, phase: int) -> None:
    """Decide by the costs of the trials what the simplex becomes and what it tries next."""
    simplex, costs = state.simplex, state.simplex_costs
    worst = simplex.shape[1]
    cost = float(state.trial_costs[0])
    following = REFLECT
    if phase in (BUILD, SHRINK):
        for k in range(n):
            simplex[k + 1] = state.trial[k]
            costs[k + 1] = state.trial_costs[k]
        _sort_vertices(simplex, costs)
    elif phase == REFLECT:
        following = _after_reflection(state, cost)
    elif phase == EXPAND:
        if cost < state.reflected_cost[0]:
            _insert(simplex, costs, state.trial, cost)
        else:
            _insert(simplex, costs, state.reflected, float(state.reflected_cost[0]))
    elif (phase == OUTSIDE and cost <= state.reflected_cost[0]) or (
        phase == INSIDE and cost < costs[worst]
    ):
        _insert(simplex, costs, state.trial, cost)
    else:
        following = SHRINK
    if following == REFLECT and _has_collapsed(simplex):
        following = BUILD
    state.phase[0] = following


def _after_reflection(state: State, cost: float) -> int:
    """Take the reflected vertex, or keep it in mind.  -> what to try next."""
    costs, worst = state.simplex_costs, state.simplex.shape[1]
    if cost >= costs[worst]:
        return INSIDE
    if costs[0] <= cost < costs[worst - 1]:
        _insert(state.simplex, costs, state.trial, cost)
        return REFLECT
    state.reflected[0] = state.trial[0]
    state.reflected_cost[0] = cost
    return EXPAND if cost < costs[0] else OUTSIDE


def _propose_simplex(state: State) -> None:
    """Vertices one edge from the first, along each axis, inwards where there is no room."""
    dimensions, edge = state.simplex.shape[1], state.settings.edge
    for k in range(dimensions):
        state.trial[k] = state.simplex[0]
        up = state.simplex[0, k] + edge
        state.trial[k, k] = up if up <= 1.0 else state.simplex[0, k] - edge
        state.trial_bounds[k] = math.inf


def _propose_smaller(state: State) -> None:
    """All vertices but the best drawn towards it."""
    dimensions = state.simplex.shape[1]
    left = 1.0 - 1.0 / max(dimensions, 2)
    for k in range(dimensions):
        for j in range(dimensions):
            best = state.simplex[0, j]
            state.trial[k, j] = best + left * (state.simplex[k + 1, j] - best)
        state.trial_bounds[k] = math.inf


def _find_centre(simplex: FloatArray, centre: FloatArray) -> None:
    """Of all vertices but the worst."""
    dimensions = len(centre)
    for j in range(dimensions):
        total = 0.0
        for k in range(dimensions):
            total += simplex[k, j]
        centre[j] = total / dimensions


def _insert(simplex: FloatArray, costs: FloatArray, found: FloatArray, cost: float) -> None:
    """The first row of what was found takes the worst vertex's place."""
    simplex[-1] = found[0]
    costs[-1] = cost
    _sort_vertices(simplex, costs)


def _sort_vertices(simplex: FloatArray, costs: FloatArray) -> None:
    """Vertices by cost, by insertion."""
    for k in range(1, len(costs)):
        at = k
        while at > 0 and costs[at - 1] > costs[at]:
            costs[at - 1], costs[at] = costs[at], costs[at - 1]
            for j in range(simplex.shape[1]):
                simplex[at - 1, j], simplex[at, j] = simplex[at, j], simplex[at - 1, j]
            at -= 1


def _has_collapsed(simplex: FloatArray) -> bool:
    """Whether all vertices are as good as one."""
    for k in range(1, simplex.shape[0]):
        for j in range(simplex.shape[1]):
            if abs(simplex[k, j] - simplex[0, j]) >= _COLLAPSED:
                return False
    return True
