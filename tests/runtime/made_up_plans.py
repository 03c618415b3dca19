"""A planner without a search: straight paths, proven as far as they keep to the altitude band."""

import math
from dataclasses import fields, replace

import numpy as np
import numpy.typing as npt

from companion.path.certificate import Certificate
from companion.path.subpath import Subpath
from companion.planner.request import NotPlanned, Planned, PlanRequest, Refusal
from companion.planner.settings import Task

LEG_M = 17_000.0
_CERTIFIED = {
    **dict.fromkeys((field.name for field in fields(Certificate)), 0.0),
    "clearance_m": 1e3,
    "keep_out_m": math.inf,
    "turn_radius_m": math.inf,
    "dead_man_m": 150.0,
    "required_clearance_m": 515.0,
    "required_contact_m": 15.0,
    "speed_m_s": 150.0,
    "pieces": 1,
}
"""A straight subpath with nothing near it."""


def certificate(
    lowest_amsl_m: float = 3030.0, highest_amsl_m: float = 3030.0, broken: tuple[str, ...] = ()
) -> Certificate:
    heights_m = {"lowest_amsl_m": lowest_amsl_m, "highest_amsl_m": highest_amsl_m}
    return Certificate(**_CERTIFIED | heights_m | {"broken": broken})  # type: ignore[arg-type]


def straight(start_nea_m: npt.ArrayLike, end_nea_m: npt.ArrayLike) -> Subpath:
    return Subpath(control_nea_m=np.linspace(np.asarray(start_nea_m), np.asarray(end_nea_m), 4))


def within_band(subpath: Subpath, task: Task) -> bool:
    """Whether a planner could prove of a straight subpath that it keeps to the altitude band."""
    heights, inset_m = subpath.control_nea_m[:, 2], task.error_m
    lowest_m, highest_m = heights.min() - inset_m, heights.max() + inset_m
    limits = task.limits
    return bool(limits.floor_amsl_m <= lowest_m and highest_m <= limits.ceiling_amsl_m)


def planned(request: PlanRequest, length_m: float = LEG_M, climb_m: float = 0.0) -> Planned:
    """A straight subpath towards a point above the target, or to it if it is near enough.

    climb_m: how much higher than its start that point is; it is level by default.
    """
    start = request.start.position_nea_m
    target = np.array([*request.target_ne_m, start[2] + climb_m])
    left_m = float(np.linalg.norm(target - start))
    reaches = left_m <= length_m
    end = target if reaches else start + (target - start) / left_m * length_m
    subpath = straight(start, end)
    broken = () if within_band(subpath, request.task) else ("altitude band",)
    return Planned(
        plan_id=request.plan_id,
        kernel="made up",
        subpath=subpath,
        reaches_target=reaches,
        cost=1.0,
        to_go=0.0,
        terms={"f1": 1.0},
        certificate=certificate(*sorted((float(start[2]), float(end[2]))), broken=broken),
        guide_rad=0.0,
        route_ne_m=(request.target_ne_m,),
        evaluations=60,
        rank=0,
        tries=1,
    )


def straight_plan(request: PlanRequest, _stop: object = None) -> Planned:
    """Proven whatever the altitude band."""
    return replace(planned(request), certificate=certificate())


def not_planned(request: PlanRequest) -> NotPlanned:
    return NotPlanned(
        plan_id=request.plan_id, refusal=Refusal.NOTHING_SAFE, broken=("floor",), evaluations=60
    )
