"""One plan, by the profile that its mission has chosen: the one place above both planners."""

from collections.abc import Callable

from companion import extras
from companion.paper.plan import plan_as_published
from companion.planner import plan as flight
from companion.planner.request import PlanOutcome, PlanRequest

OURS = "ours"


def plan(request: PlanRequest, stop: Callable[[], bool] = lambda: False) -> PlanOutcome:
    """The next subpath, or the way back, or why there is none.

    stop: asked now and then; true: time is up (profile `flight`; `paper` spends its budget).
    """
    if request.flown is None and not request.task.settings.profile.verified:
        return plan_as_published(request)
    return flight.plan(request, stop)


def planner_of(name: str, field: str = "planner") -> Callable[[PlanRequest], PlanOutcome]:
    """What plans under this name: ours, or a rival.

    InputError about a field if there is none, or what it needs is not installed.
    """
    if name == OURS:
        return plan
    if name == "rrt-star":  # of OMPL
        extras.need("compare", field, name)
    from companion.paper.rivals import PLANNERS, leg_by_leg  # slow to import, and seldom needed

    return leg_by_leg(PLANNERS.chosen(name, field))
