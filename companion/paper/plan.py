"""One plan as the paper has it (profile `paper`): for comparison, not for flight.

Four control points, six variables, ten samples, the tangent guide, one search; what it finds is
flown as it is.  Its certificate is only a report.
"""

import math
from dataclasses import replace

from companion.geodesy import FloatArray
from companion.optimise.loop import minimise
from companion.optimise.registry import OPTIMISERS
from companion.paper.guide import tangent_guide_rad
from companion.paper.terms import VARIABLES, Scene, control_points, cost, cost_table
from companion.path.certificate import certify
from companion.path.subpath import Subpath
from companion.planner.procedure import hover_pose
from companion.planner.request import REACH, Planned, PlanRequest
from companion.world.columns import terrain_surface


def plan_as_published(request: PlanRequest) -> Planned:
    """The best candidate of one search."""
    settings, scene = request.task.settings, scene_of(request)
    chosen = settings.optimiser or settings.profile.optimiser
    make = OPTIMISERS[chosen] if isinstance(chosen, str) else chosen
    optimiser = make(VARIABLES, settings.evaluations, request.rng(0), None)
    ranked = minimise(optimiser, lambda x: cost(x, scene), settings.evaluations)
    best, reaches_target = ranked.x[:1], scene.final_ne_m is not None
    planned = reported(request, control_points(best, scene)[0], reaches_target=reaches_target)
    return replace(
        planned,
        cost=float(ranked.costs[0]),
        terms={name: float(column[0]) for name, column in cost_table(best, scene).items()},
        guide_rad=scene.guide_rad,
        evaluations=ranked.evaluations,
    )


def reported(request: PlanRequest, control_nea_m: FloatArray, *, reaches_target: bool) -> Planned:
    """A subpath (K, 3) that is flown as it is; its certificate says what could be proven."""
    task, subpath = request.task, Subpath(control_nea_m=control_nea_m)
    reach_m = REACH * task.settings.scan_range_m
    surroundings = task.surroundings(request.known, request.scan_nea_m[:2], reach_m)
    return Planned(
        plan_id=request.plan_id,
        kernel="numpy",
        subpath=subpath,
        reaches_target=reaches_target,
        certificate=certify(subpath, surroundings, from_rest=request.from_rest),
        tries=1,
    )


def scene_of(request: PlanRequest) -> Scene:
    """What the search of a plan is about.

    The first tangent is the guide direction (row 34), as from each place where the vehicle rests.
    """
    task, settings = request.task, request.task.settings
    scan_ne, target = request.scan_nea_m[:2], request.target_ne_m
    guide = tangent_guide_rad(scan_ne, target, task.radars, settings.overlap_m)
    north, east = target[0] - scan_ne[0], target[1] - scan_ne[1]
    final = math.hypot(north, east) <= settings.scan_range_m and request.known.is_known(*target)
    if final:
        guide = math.atan2(east, north)
    reach_m = REACH * settings.scan_range_m
    return Scene(
        task=task,
        start=hover_pose(request.start.position_nea_m, guide)
        if request.from_rest
        else request.start,
        scan_ne_m=scan_ne,
        guide_rad=guide,
        final_ne_m=target if final else None,
        surface=terrain_surface(request.known, centre_ne_m=scan_ne, reach_m=reach_m),
    )
