"""One plan, by the profile that its mission has chosen: the one place above both planners."""

from collections.abc import Callable

from companion.paper.plan import plan_as_published
from companion.planner import kernels
from companion.planner import plan as flight
from companion.planner.request import PlanOutcome, PlanRequest

Planner = Callable[[PlanRequest], PlanOutcome]


def plan(request: PlanRequest, stop: Callable[[], bool] = lambda: False) -> PlanOutcome:
    """The next subpath, or the way back, or why there is none.

    stop: asked now and then; true: time is up (profile `flight`; `paper` spends its budget).
    """
    if request.flown is None and not request.task.settings.profile.verified:
        return plan_as_published(request, kernels.compiled().prove)
    return flight.plan(request, stop)
