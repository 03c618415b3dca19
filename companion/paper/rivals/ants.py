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
    graph, end = graph.maximum(graph.T).tocsr(), len(places_m) - 1
    step = np.repeat(np.arange(end + 1), np.diff(graph.indptr)), np.arange(graph.nnz)
    step[1][:] -= graph.indptr[step[0]]  # node, and which of its steps
    there = np.full((end + 1, np.diff(graph.indptr).max()), -1)
    cost, draw = np.full(there.shape, np.inf), np.zeros(there.shape)
    there[step], cost[step] = graph.indices, graph.data
    left_m = np.linalg.norm(places_m - places_m[end], axis=-1)
    length_m = np.linalg.norm(places_m[step[0]] - places_m[graph.indices], axis=-1)
    beyond_m = graph.data + left_m[graph.indices] - left_m[step[0]]
    draw[step] = np.exp(-_GREED * beyond_m / length_m)
    pheromone, best, best_way = np.ones(there.shape), math.inf, np.empty(0, dtype=np.intp)
    for _ in range(_GENERATIONS):
        for way in _walks(pheromone * draw, there, rng):
            steps = way[:-1], (there[way[:-1]] == way[1:, None]).argmax(axis=1)
            if cost[steps].sum() < best:
                best, best_way, best_steps = cost[steps].sum(), way, steps
        pheromone *= 1.0 - _EVAPORATES
        if len(best_way):
            pheromone[best_steps] += _EVAPORATES
        pheromone = np.clip(pheromone, _LEAST, 1.0)
    return best_way.tolist()


def _walks(weights: FloatArray, there: IntArray, rng: np.random.Generator) -> list[IntArray]:
    """The walks of a generation that came to the last node, without their loops."""
    end, total = len(there) - 1, np.cumsum(weights, axis=1)
    at, going = np.full(_ANTS, end - 1), np.ones(_ANTS, dtype=bool)
    trails = [at]
    for _ in range(8 * math.isqrt(end)):  # four times from edge to edge, and again
        each = total[at]
        going = going & (at != end) & (each[:, -1] > 0.0)  # there, or stuck
        if not going.any():
            break
        pick = (each < (rng.random(_ANTS) * each[:, -1])[:, None]).sum(axis=1)
        at = np.where(going, there[at, pick], at)
        trails.append(at)
    return [_without_loops(walk) for walk in np.stack(trails, axis=1)[at == end].tolist()]


def _without_loops(walk: list[int]) -> IntArray:
    last = {node: k for k, node in enumerate(walk)}
    way, k = [walk[0]], last[walk[0]]
    while k + 1 < len(walk):
        way.append(walk[k + 1])
        k = last[walk[k + 1]]
    return np.array(way)
