"""An ant colony (a max-min ant system) on a grid, its best way pulled straight.

Ants walk from node to node; what draws them is pheromone and, as what an ant may know, the cost of
a step and how much nearer it brings the target.  Loops are cut out of their walks.
"""

import math
from itertools import pairwise

import numpy as np

from companion.campaign.rivals.a_star import SIXTEEN, entrances, nearest, step_costs
from companion.campaign.rivals.problem import FloatArray, IntArray, NoRoute, RouteProblem

_STRIDE = 10  # points of the field to a step of the grid: R / 16
_ANTS = 40
_GENERATIONS = 60
_EVAPORATES = 0.1
_GREED = 4.0
"""How strongly what lies in the target's direction draws, beside the pheromone."""
_LEAST = 0.01  # of the most pheromone


def plan(problem: RouteProblem, rng: np.random.Generator) -> FloatArray | NoRoute:
    """The best way that the colony has found, pulled straight."""
    field, start, target = problem.field, problem.start_ne_m, problem.target_ne_m
    if math.isfinite(field.line_cost(start, target)):
        direct = np.array([start, target])
        if math.dist(start, target) < 3.0 * _STRIDE * field.spacing_m:
            return problem.route(direct)
    costs = step_costs(field.rate, _STRIDE, SIXTEEN) / _STRIDE
    nodes, first = entrances(field, start, costs.shape[:2], _STRIDE)
    ends, last = entrances(field, target, costs.shape[:2], _STRIDE)
    if not len(nodes) or not len(ends):
        return NoRoute(why="the start or the target is shut in")
    begin = nodes[np.argmin(first + np.linalg.norm(nodes - ends[np.argmin(last)], axis=1))]
    colony = _Colony(costs, begin, {tuple(node) for node in ends.tolist()}, rng)
    middle = nearest(field, target, costs.shape[:2], _STRIDE)
    way = colony.best_way(middle)
    if way is None:
        return NoRoute(why="no ant came to the target")
    route = np.concatenate([[start], field.place_m(_STRIDE * np.array(way)), [target]])
    return problem.route(route)


class _Colony:
    """Pheromone on the steps of a grid."""

    def __init__(
        self,
        costs: FloatArray,
        begin: IntArray,
        ends: set[tuple[int, int]],
        rng: np.random.Generator,
    ) -> None:
        self._costs, self._rng, self._ways = costs, rng, np.array(SIXTEEN)
        self._begin, self._ends = begin, ends
        self._pheromone = np.where(np.isfinite(costs), 1.0, 0.0)
        self._most_steps = 4 * sum(costs.shape[:2])

    def best_way(self, target: IntArray) -> list[tuple[int, int]] | None:
        """The cheapest walk of all generations, as nodes; None: none came there."""
        rows, columns, _ = self._costs.shape
        to_go = np.hypot(
            np.arange(rows)[:, None] - target[0], np.arange(columns)[None, :] - target[1]
        )
        ends = np.zeros((rows, columns), dtype=bool)
        ends[tuple(np.array(sorted(self._ends)).T)] = True
        draw = np.zeros_like(self._costs)
        for k, (i, j) in enumerate(SIXTEEN):
            row = np.clip(np.arange(rows) + i, 0, rows - 1)
            column = np.clip(np.arange(columns) + j, 0, columns - 1)
            beyond = self._costs[:, :, k] + to_go[np.ix_(row, column)] - to_go
            draw[:, :, k] = np.exp(-_GREED * beyond / math.hypot(i, j))
        best, best_way = math.inf, None
        for _ in range(_GENERATIONS):
            for way in self._walks(draw, ends):
                cost = self._cost(way)
                if cost < best:
                    best, best_way = cost, way
            self._pheromone *= 1.0 - _EVAPORATES
            if best_way is not None:
                for step in self._steps(best_way):
                    self._pheromone[step] += _EVAPORATES
            self._pheromone = np.where(
                np.isfinite(self._costs), np.clip(self._pheromone, _LEAST, 1.0), 0.0
            )
        return best_way

    def _walks(self, draw: FloatArray, ends: np.ndarray) -> list[list[tuple[int, int]]]:
        """The walks of a generation that came to an end node, without their loops."""
        weights = self._pheromone * draw
        at = np.tile(self._begin, (_ANTS, 1))
        trails = [at.copy()]
        there = ends[at[:, 0], at[:, 1]]
        stuck = np.zeros(_ANTS, dtype=bool)
        for _ in range(self._most_steps):
            going = ~there & ~stuck
            if not going.any():
                break
            each = np.cumsum(weights[at[:, 0], at[:, 1]], axis=1)
            stuck |= each[:, -1] <= 0.0
            pick = (each < (self._rng.random(_ANTS) * each[:, -1])[:, None]).sum(axis=1)
            step = self._ways[np.minimum(pick, len(self._ways) - 1)]
            at = np.where((going & ~stuck)[:, None], at + step, at)
            there = ends[at[:, 0], at[:, 1]]
            trails.append(at.copy())
        walks = np.stack(trails, axis=1)
        return [_without_loops(walks[ant]) for ant in np.nonzero(there)[0]]

    def _steps(self, way: list[tuple[int, int]]) -> list[tuple[int, int, int]]:
        index = {step: k for k, step in enumerate(SIXTEEN)}
        return [(*a, index[(b[0] - a[0], b[1] - a[1])]) for a, b in pairwise(way)]

    def _cost(self, way: list[tuple[int, int]]) -> float:
        return float(sum(self._costs[step] for step in self._steps(way)))


def _without_loops(walk: IntArray) -> list[tuple[int, int]]:
    way: list[tuple[int, int]] = []
    at: dict[tuple[int, int], int] = {}
    for node in map(tuple, walk.tolist()):
        if node in at:
            for left in way[at[node] + 1 :]:
                del at[left]
            del way[at[node] + 1 :]
        else:
            at[node] = len(way)
            way.append(node)
    return way
