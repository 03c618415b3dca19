"""An ant colony (a max-min ant system) on a grid, its best way pulled straight (as in paper 1).

Ants walk from node to node; what draws them is pheromone and, as what an ant may know, the cost of
a step and how much nearer it brings the target.  Loops are cut out of their walks.
"""

import math
from itertools import pairwise

import numpy as np

from companion.geodesy import FloatArray
from companion.paper.rivals.roadmaps import SIXTEEN, step_costs
from companion.paper.rivals.routes import IntArray, RouteProblem

_STRIDE = 10  # points of the lattice to a step of the grid: R / 16
_ANTS, _GENERATIONS, _EVAPORATES = 40, 60, 0.1
_GREED = 4.0  # how strongly what lies in the target's direction draws, beside the pheromone
_LEAST = 0.01  # of the most pheromone
_WAYS = np.array(SIXTEEN)


def ants(problem: RouteProblem, rng: np.random.Generator) -> FloatArray | str:
    """The best way that the colony has found, pulled straight."""
    start, target = problem.start_ne_m, problem.target_ne_m
    if math.isfinite(problem.line_cost(start, target)) and (
        math.dist(start, target) < 3.0 * _STRIDE * problem.spacing_m
    ):
        return np.array([start, target])
    costs = step_costs(problem.rate, _STRIDE, SIXTEEN) / _STRIDE
    nodes = np.argwhere(np.isfinite(costs).any(axis=2))
    ends = np.zeros(costs.shape[:2], dtype=bool)
    begins = _joined(problem, nodes, start)
    for node in _joined(problem, nodes, target):
        ends[tuple(node)] = True
    middle = problem.index(target) / _STRIDE
    away = np.hypot(*(np.moveaxis(np.indices(ends.shape), 0, -1) - middle).transpose(2, 0, 1))
    after = np.indices(ends.shape)[:, :, :, None] + _WAYS.T[:, None, None, :]
    row, column = (np.clip(a, 0, n - 1) for a, n in zip(after, costs.shape[:2], strict=True))
    beyond = costs + away[row, column] - away[:, :, None]
    draw = np.exp(-_GREED * beyond / np.hypot(*_WAYS.T))
    pheromone, best, best_way = np.ones(costs.shape), math.inf, None
    for _ in range(_GENERATIONS if begins else 0):
        for way in _walks(pheromone * draw, begins[0], ends, rng):
            steps = [(*a, SIXTEEN.index((b[0] - a[0], b[1] - a[1]))) for a, b in pairwise(way)]
            cost = sum(float(costs[step]) for step in steps)
            if cost < best:
                best, best_way, best_steps = cost, way, steps
        pheromone *= 1.0 - _EVAPORATES
        for step in best_steps if best_way else ():
            pheromone[step] += _EVAPORATES
        pheromone = np.clip(pheromone, _LEAST, 1.0)
    if best_way is None:
        return "no ant came to the target"
    places = problem.place_m(_STRIDE * np.array(best_way))
    return problem.straight(np.concatenate([[start], places, [target]]))


def _joined(problem: RouteProblem, nodes: IntArray, place: FloatArray) -> list[IntArray]:
    """Nodes about a place that a free line leads to, the nearest first."""
    places = problem.place_m(_STRIDE * nodes)
    near = np.argsort(np.linalg.norm(places - place, axis=-1), kind="stable")[:25]
    return [nodes[k] for k in near if math.isfinite(problem.line_cost(place, places[k]))]


def _walks(
    weights: FloatArray, begin: IntArray, ends: np.ndarray, rng: np.random.Generator
) -> list[list[tuple[int, int]]]:
    """The walks of a generation that came to an end node, without their loops."""
    at, going = np.tile(begin, (_ANTS, 1)), np.ones(_ANTS, dtype=bool)
    trails = [at]
    for _ in range(4 * sum(ends.shape)):
        going = going & ~ends[at[:, 0], at[:, 1]]
        each = np.cumsum(weights[at[:, 0], at[:, 1]], axis=1)
        going &= each[:, -1] > 0.0  # else it is stuck
        if not going.any():
            break
        pick = (each < (rng.random(_ANTS) * each[:, -1])[:, None]).sum(axis=1)
        at = np.where(going[:, None], at + _WAYS[np.minimum(pick, len(_WAYS) - 1)], at)
        trails.append(at)
    walks = np.stack(trails, axis=1)[ends[at[:, 0], at[:, 1]]]
    return [_without_loops(list(map(tuple, walk.tolist()))) for walk in walks]


def _without_loops(walk: list[tuple[int, int]]) -> list[tuple[int, int]]:
    last = {node: k for k, node in enumerate(walk)}
    way, k = [walk[0]], last[walk[0]]
    while k + 1 < len(walk):
        way.append(walk[k + 1])
        k = last[walk[k + 1]]
    return way
