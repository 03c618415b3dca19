"""A reference with full knowledge: OMPL's RRT* for a point over the ground (--ompl).

The package is not among the pinned ones: `pip install ompl`.  A state is north and east; the
altitude is the lowest safe one, as of the rival, and so is what a metre costs.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rival import Rival
from worlds import BenchmarkWorld

FloatArray = NDArray[np.float64]

_SECONDS = 30.0


def cost(world: BenchmarkWorld, seconds: float = _SECONDS, seed: int = 1) -> float:
    """J of what RRT* found in so many seconds, NaN if it found nothing."""
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise SystemExit("--ompl needs the package ompl: pip install ompl") from error
    util.RNG.setSeed(seed)
    util.setLogLevel(util.LogLevel.LOG_NONE)
    rival = Rival(world)
    rival.seen[:] = True
    rate = rival.rate()
    limits = world.task.limits

    def place(state: Any) -> FloatArray:
        return np.array([state[0], state[1]])

    class Motions(base.MotionValidator):
        def checkMotion(self, first: Any, second: Any, *_: Any) -> bool:
            return math.isfinite(rival.line_cost(rate, place(first), place(second)))

    class Metres(base.OptimizationObjective):
        def stateCost(self, _: Any) -> Any:
            return base.Cost(0.0)

        def motionCost(self, first: Any, second: Any) -> Any:
            return base.Cost(rival.line_cost(rate, place(first), place(second)))

    space = base.RealVectorStateSpace(2)
    bounds = base.RealVectorBounds(2)
    for axis, (low, high) in enumerate((limits.north_m, limits.east_m)):
        bounds.setLow(axis, low)
        bounds.setHigh(axis, high)
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    information = setup.getSpaceInformation()
    setup.setStateValidityChecker(lambda state: math.isfinite(rival.rate_at(rate, place(state))))
    information.setMotionValidator(Motions(information))
    setup.setOptimizationObjective(Metres(information))
    ends = []
    for north, east in (world.start_nea_m[:2], world.targets_ne_m[0]):
        state = space.allocState()
        state[0], state[1] = north, east
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(geometric.RRTstar(information))
    if not setup.solve(seconds) or not setup.haveExactSolutionPath():
        return math.nan
    states = setup.getSolutionPath().getStates()
    route = np.array([place(state) for state in states])
    return rival.flight(rival.even(route), 1, arrived=True).cost(world)
