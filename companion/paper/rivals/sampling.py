"""RRT* and BIT* of OMPL: a point in the plane, with our objective as theirs.

They stop when so many lines have been costed (or asked for without being costed), and are seeded:
OMPL's own generator is set before each plan, so a plan is a function of problem and seed.
"""

import itertools
from functools import cache, partial
from typing import Any

import numpy as np

from companion import extras
from companion.geodesy import FloatArray
from companion.paper.rivals.routes import RouteProblem


def plan(problem: RouteProblem, rng: np.random.Generator, *, planner: str) -> FloatArray | str:
    """The best route that one of OMPL's planners has found by then, pulled straight."""
    extras.need("compare", "planner", planner)
    from ompl import base, geometric, util  # an extra, and slow to import

    corner, asked = problem.corner_ne_m, itertools.count(1)

    @cache
    def known(*ends: float) -> float:
        return problem.line_cost(corner + ends[:2], corner + ends[2:])

    def cost(a: Any, b: Any) -> float:
        """Of the line between two states; infinite: it is not free."""
        return known(a[0], a[1], b[0], b[1])

    def is_free(state: Any) -> bool:
        return bool(np.isfinite(problem.rate_at(corner + np.array([state[0], state[1]]))))

    def is_spent() -> bool:
        return max(known.cache_info().currsize, next(asked)) >= problem.lines

    class Validator(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, a: Any, b: Any, _last: Any = None) -> bool:
            return cost(a, b) < np.inf

    class Objective(base.OptimizationObjective):  # type: ignore[misc]
        def stateCost(self, _state: Any) -> Any:
            return base.Cost(1.0)

        def motionCost(self, a: Any, b: Any) -> Any:
            return base.Cost(cost(a, b))

        def motionCostHeuristic(self, a: Any, b: Any) -> Any:
            return base.Cost(float(np.hypot(a[0] - b[0], a[1] - b[1])))

    util.noOutputHandler()
    util.RNG.setSeed(int(rng.integers(1, 2**31)))
    space, bounds = base.RealVectorStateSpace(2), base.RealVectorBounds(2)
    bounds.setLow(0.0)
    for axis, size in enumerate(problem.rate.shape):
        bounds.setHigh(axis, (size - 1) * problem.spacing_m)
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    validator, objective = Validator(information), Objective(information)  # OMPL does not keep them
    information.setStateValidityChecker(is_free)
    information.setMotionValidator(validator)
    information.setup()
    definition = base.ProblemDefinition(information)
    ends = [space.allocState(), space.allocState()]
    for state, place in zip(ends, (problem.start_ne_m, problem.target_ne_m), strict=True):
        state[0], state[1] = (float(value) for value in place - corner)
    definition.setStartAndGoalStates(*ends)
    definition.setOptimizationObjective(objective)
    searching = getattr(geometric, planner)(information)
    searching.setProblemDefinition(definition)
    searching.setup()
    searching.solve(base.PlannerTerminationCondition(is_spent))
    if not definition.hasExactSolution():
        return f"none found with {problem.lines} lines"
    states = definition.getSolutionPath().getStates()
    route = corner + np.array([[state[0], state[1]] for state in states])
    route[0], route[-1] = problem.start_ne_m, problem.target_ne_m
    return problem.straight(route)


rrt_star = partial(plan, planner="RRTstar")
bit_star = partial(plan, planner="BITstar")
