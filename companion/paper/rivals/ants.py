"""An ant colony (a max-min ant system) on a grid, its best way pulled straight (as in paper 1).

Ants walk from node to node; what draws them is pheromone and, as what an ant may know, the cost of
a step and how much nearer it brings the target.  Loops are cut out of their walks.
"""

import math

import numpy as np
from scipy.sparse import csr_array

from companion.geodesy import FloatArray
from companion.paper.rivals.roadmaps import over_grid
from companion.paper.rivals.routes import IntArray, RouteProblem

_STRIDE = 10  # points of the lattice to a step of the grid: R / 16
_ANTS, _GENERATIONS, _EVAPORATES = 40, 60, 0.1
_GREED = 4.0  # how strongly what lies in the target's direction draws, beside the pheromone
_LEAST = 0.01  # of the most pheromone


def ants(problem: RouteProblem, rng: np.random.Generator) -> FloatArray | str:
    """The best way that the colony has found, pulled straight."""

    def colony(graph: csr_array, places_m: FloatArray) -> list[int]:
        return best_walk(graph, places_m, rng)

    return over_grid(problem, _STRIDE, colony)


def best_walk(graph: csr_array, places_m: FloatArray, rng: np.random.Generator) -> list[int]:
    """The cheapest walk of a colony from the last place but one to the last; none: []."""
    graph = graph.maximum(graph.T).tocsr()  # a step is an index of its data
    here, there = np.repeat(np.arange(len(places_m)), np.diff(graph.indptr)), graph.indices
    left_m = np.linalg.norm(places_m - places_m[-1], axis=-1)
    length_m = np.linalg.norm(places_m[here] - places_m[there], axis=-1)
    draw = np.exp(-_GREED * (graph.data + left_m[there] - left_m[here]) / length_m)
    pheromone, least, best = np.ones(graph.nnz), math.inf, list[int]()
    for _ in range(_GENERATIONS):
        weights = pheromone * draw
        weights /= np.bincount(here, weights)[here]
        for steps in _walks(graph, np.append(0.0, np.cumsum(weights)), rng):
            walk = _without_loops(steps, here[steps])
            if (cost := graph.data[walk].sum()) < least:
                least, best = cost, walk
        pheromone *= 1.0 - _EVAPORATES
        pheromone[best] += _EVAPORATES
        pheromone = np.clip(pheromone, _LEAST, 1.0)
    return [*here[best].tolist(), len(places_m) - 1] if best else []


def _walks(graph: csr_array, total: FloatArray, rng: np.random.Generator) -> list[IntArray]:
    """The walks of a generation that came to the last place, as steps.

    total: of the probabilities of all steps before each, (steps + 1,); those from a place sum to 1.
    """
    end = len(graph.indptr) - 2
    at, walks = np.full(_ANTS, end - 1), list[IntArray]()
    for _ in range(8 * math.isqrt(end)):  # four times from edge to edge of the grid, and back
        low, high = total[graph.indptr[at]], total[graph.indptr[at + 1]]
        going = (at != end) & (high > low)  # else it is there, or stuck
        if not going.any():
            break
        drawn = low + rng.random(_ANTS) * (high - low)
        step = np.where(going, np.searchsorted(total, drawn, side="right") - 1, -1)
        at = np.where(going, graph.indices[step], at)
        walks.append(step)
    came = np.stack(walks, axis=1)[at == end] if walks else []
    return [walk[walk >= 0] for walk in came]


def _without_loops(steps: IntArray, here: IntArray) -> list[int]:
    """Of a walk only the last step from each place that it was in.  (K,) x2."""
    last = {place: k for k, place in enumerate(here.tolist())}
    way, k = list[int](), 0
    while k < len(steps):
        k = last[int(here[k])]
        way.append(int(steps[k]))
        k += 1
    return way
