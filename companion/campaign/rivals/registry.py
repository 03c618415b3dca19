"""Every planner of whole routes by its name.

Other distributions add theirs by an entry point `companion.planners`: a `RoutePlanner`.
"""

import inspect

from companion.campaign.rivals import a_star, ants, sampling, voronoi
from companion.campaign.rivals.problem import RoutePlanner
from companion.entry_points import Parts


def _wrong_with(planner: RoutePlanner) -> str | None:
    """Why it cannot be asked; None: it can."""
    if not callable(planner):
        return "it cannot be called"
    try:
        inspect.signature(planner).bind(None, None)
    except TypeError as error:
        return f"it does not take a problem and a random generator: {error}"
    return None


_OWN: dict[str, RoutePlanner] = {
    "a-star": a_star.plan,
    "rrt-star": sampling.rrt_star,
    "bit-star": sampling.bit_star,
    "voronoi": voronoi.plan,
    "ants": ants.plan,
}
PLANNERS = Parts("companion.planners", _OWN, what="planner", check=_wrong_with)
