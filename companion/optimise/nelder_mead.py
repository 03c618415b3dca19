"""The simplex that ends a refined search: it polishes the best member (Nelder and Mead 1965).

Factors for the number of variables D as Gao and Han choose them (Comput. Optim. Appl. 51, 2012):
expansion 1 + 2 / D, contraction 3 / 4 - 1 / (2 D), shrinking 1 - 1 / D.  Vertices are clipped into
the unit cube; a simplex that has collapsed is begun anew about its best vertex.
Single source: see `refined_de`.
"""

import math

from companion.geodesy import FloatArray
from companion.optimise.refined_state import (
    BUILD,
    EDGE,
    EXPAND,
    INSIDE,
    OUTSIDE,
    PHASE,
    REFLECT,
    REFLECTED_COST,
    SHRINK,
    State,
)

_COLLAPSED = 1e-5  # widest edge of a simplex that is begun anew


def begin_polish(state: State) -> None:
    """The best member is the simplex's first vertex."""
    best = int(state.order[0])
    for j in range(state.simplex.shape[1]):
        state.simplex[0, j] = state.population[best, j]
    state.simplex_costs[0] = state.costs[best]
    state.counters[PHASE] = BUILD


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
        factor, bound = 1.0 + 2.0 / variables, float(state.numbers[REFLECTED_COST])
    elif phase == OUTSIDE:
        factor, bound = 0.75 - 0.5 / variables, float(state.numbers[REFLECTED_COST])
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
            _put(state.trial, k, simplex, k + 1)
            costs[k + 1] = state.trial_costs[k]
        _sort(simplex, costs)
    elif phase == REFLECT:
        following = _after_reflection(state, cost)
    elif phase == EXPAND:
        if cost < state.numbers[REFLECTED_COST]:
            _insert(simplex, costs, state.trial, cost)
        else:
            _insert(simplex, costs, state.reflected, float(state.numbers[REFLECTED_COST]))
    elif (phase == OUTSIDE and cost <= state.numbers[REFLECTED_COST]) or (
        phase == INSIDE and cost < costs[worst]
    ):
        _insert(simplex, costs, state.trial, cost)
    else:
        following = SHRINK
    if following == REFLECT and _has_collapsed(simplex):
        following = BUILD
    state.counters[PHASE] = following


def _after_reflection(state: State, cost: float) -> int:
    """Take the reflected vertex, or keep it in mind.  -> what to try next."""
    costs, worst = state.simplex_costs, state.simplex.shape[1]
    if cost >= costs[worst]:
        return INSIDE
    if costs[0] <= cost < costs[worst - 1]:
        _insert(state.simplex, costs, state.trial, cost)
        return REFLECT
    _put(state.trial, 0, state.reflected, 0)
    state.numbers[REFLECTED_COST] = cost
    return EXPAND if cost < costs[0] else OUTSIDE


def _propose_simplex(state: State) -> None:
    """Vertices one edge from the first, along each axis, inwards where there is no room."""
    dimensions, edge = state.simplex.shape[1], state.numbers[EDGE]
    for k in range(dimensions):
        for j in range(dimensions):
            state.trial[k, j] = state.simplex[0, j]
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


def _put(source: FloatArray, row: int, target: FloatArray, at: int) -> None:
    for j in range(target.shape[1]):
        target[at, j] = source[row, j]


def _insert(simplex: FloatArray, costs: FloatArray, found: FloatArray, cost: float) -> None:
    """The first row of what was found takes the worst vertex's place."""
    _put(found, 0, simplex, simplex.shape[1])
    costs[simplex.shape[1]] = cost
    _sort(simplex, costs)


def _sort(simplex: FloatArray, costs: FloatArray) -> None:
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


HELPERS = (
    begin_polish,
    _propose_simplex,
    _propose_smaller,
    _find_centre,
    propose_vertices,
    _put,
    _sort,
    _insert,
    _has_collapsed,
    _after_reflection,
    transform,
)
"""Every function that a compiled search needs, callees first."""
