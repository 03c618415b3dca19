"""RRT* and BIT* of OMPL: a point in the plane, with our objective as theirs.

They stop when so many lines have been costed (or asked for without being costed), and are seeded:
OMPL's own generator is set before each plan, so a plan is a function of problem and seed.
"""

from functools import partial
from typing import Any

import numpy as np

from companion import extras
from companion.campaign.rivals.problem import FloatArray, NoRoute, RouteProblem


def plan(problem: RouteProblem, rng: np.random.Generator, *, planner: str) -> FloatArray | NoRoute:
    """The best route that one of OMPL's planners has found by then, pulled straight."""
    extras.need("compare", "planner", planner)
    from ompl import base, geometric, util  # an extra, and slow to import

    util.noOutputHandler()
    util.RNG.setSeed(int(rng.integers(1, 2**31)))
    field, origin = problem.field, np.asarray(problem.field.corner_ne_m)
    space, bounds = base.RealVectorStateSpace(2), base.RealVectorBounds(2)
    for axis, size in enumerate(field.rate.shape):
        bounds.setLow(axis, 0.0)
        bounds.setHigh(axis, (size - 1) * field.spacing_m)
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    costed = _Costed(problem)
    validator, objective = (each(information) for each in _asking(base, costed))
    information.setStateValidityChecker(costed.is_free)
    information.setMotionValidator(validator)
    information.setup()
    definition = base.ProblemDefinition(information)
    ends = [space.allocState(), space.allocState()]
    for state, place in zip(ends, (problem.start_ne_m, problem.target_ne_m), strict=True):
        state[0], state[1] = (float(value) for value in place - origin)
    definition.setStartAndGoalStates(*ends)
    definition.setOptimizationObjective(objective)
    searching = getattr(geometric, planner)(information)
    searching.setProblemDefinition(definition)
    searching.setup()
    searching.solve(base.PlannerTerminationCondition(costed.is_spent))
    if not definition.hasExactSolution():
        return NoRoute(why=f"none found with {problem.evaluations} lines")
    states = definition.getSolutionPath().getStates()
    route = origin + np.array([[state[0], state[1]] for state in states])
    route[0], route[-1] = problem.start_ne_m, problem.target_ne_m
    return problem.route(route)


class _Costed:
    """The problem's lines as OMPL asks for them, each costed once, and counted."""

    def __init__(self, problem: RouteProblem) -> None:
        self._field, self._most = problem.field, problem.evaluations
        self._origin = np.asarray(problem.field.corner_ne_m)
        self._known: dict[tuple[float, float, float, float], float] = {}
        self._asked = 0

    def cost(self, a: Any, b: Any) -> float:
        """Of the line between two states; infinite: it is not free."""
        ends = (a[0], a[1], b[0], b[1])
        if ends not in self._known:
            origin = self._origin
            self._known[ends] = self._field.line_cost(origin + ends[:2], origin + ends[2:])
        return self._known[ends]

    def is_free(self, state: Any) -> bool:
        """Whether a point may be there."""
        at = np.array([state[0], state[1]])
        return bool(np.isfinite(self._field.rate_at(self._origin + at)))

    def is_spent(self) -> bool:
        """Whether the budget is: in lines, or in steps without any."""
        self._asked += 1
        return max(len(self._known), self._asked) >= self._most


def _asking(base: Any, costed: _Costed) -> tuple[type[Any], type[Any]]:
    """Classes that let OMPL ask for what lines cost, and for whether they are free."""

    class Validator(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, a: Any, b: Any, _last: Any = None) -> bool:
            return costed.cost(a, b) < np.inf

    class Objective(base.OptimizationObjective):  # type: ignore[misc]
        def stateCost(self, _state: Any) -> Any:
            return base.Cost(1.0)

        def motionCost(self, a: Any, b: Any) -> Any:
            return base.Cost(costed.cost(a, b))

        def motionCostHeuristic(self, a: Any, b: Any) -> Any:
            return base.Cost(float(np.hypot(a[0] - b[0], a[1] - b[1])))

    return Validator, Objective


rrt_star = partial(plan, planner="RRTstar")
bit_star = partial(plan, planner="BITstar")
