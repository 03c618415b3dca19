"""One plan as the paper has it (profile `paper`): for comparison, not for flight.

Four control points, six variables, ten samples, the tangent guide, one search; what it finds is
flown as it is.  Its certificate is only a report.
"""

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from companion.geodesy import wrap_rad
from companion.objective import terms
from companion.objective.terms import VARIABLES, Scene, control_points
from companion.optimise.loop import minimise
from companion.optimise.registry import OPTIMISERS
from companion.path.certificate import Prover, certify, pack_surroundings
from companion.path.subpath import Pose, Subpath
from companion.planner.request import Planned, PlanRequest
from companion.world.clearance import terrain_surface
from companion.world.radars import Radar

REACH = 1.1  # of R about p_scan: what lies farther out counts as unknown
STREAM_PLAN = 1  # the planner's random stream among those of one seed
_WIDEST_RAD = math.radians(135.0)  # part A, row 15: a cluster may span more than half a turn


def plan_as_published(request: PlanRequest, prove: Prover) -> Planned:
    """The best candidate of one search."""
    task, settings = request.task, request.task.settings
    scene = _scene(request)
    rng = np.random.default_rng([request.seed, STREAM_PLAN, request.plan_id, request.attempt, 0])
    name = settings.optimiser or settings.profile.optimiser
    optimiser = OPTIMISERS[name](VARIABLES, settings.evaluations, rng, None)
    ranked = minimise(optimiser, lambda x: terms.cost(x, scene), settings.evaluations)
    best = ranked.x[:1]
    subpath = Subpath(control_nea_m=control_points(best, scene)[0])
    surroundings = pack_surroundings(
        request.known,
        task.limits,
        task.radars,
        task.zones,
        task.margins,
        centre_ne_m=request.scan_nea_m[:2],
        reach_m=REACH * settings.scan_range_m,
    )
    return Planned(
        plan_id=request.plan_id,
        kernel="numpy",
        subpath=subpath,
        reaches_target=scene.final_ne_m is not None,
        cost=float(ranked.costs[0]),
        to_go=0.0,
        terms={name: float(column[0]) for name, column in terms.cost_table(best, scene).items()},
        certificate=certify(subpath, surroundings, from_rest=request.from_rest, prover=prove),
        guide_rad=scene.guide_rad,
        route_ne_m=(),
        evaluations=ranked.evaluations,
        rank=0,
        tries=1,
    )


def _scene(request: PlanRequest) -> Scene:
    task, settings = request.task, request.task.settings
    scan_ne, target = request.scan_nea_m[:2], request.target_ne_m
    guide = tangent_guide_rad(scan_ne, target, task.radars, settings.overlap_m)
    north, east = target[0] - scan_ne[0], target[1] - scan_ne[1]
    final = math.hypot(north, east) <= settings.scan_range_m and request.known.is_known(*target)
    if final:
        guide = math.atan2(east, north)
    return Scene(
        samples=settings.profile.samples,
        weights=settings.weights,
        limits=task.limits,
        start=facing(request.start, guide) if request.from_rest else request.start,
        scan_ne_m=scan_ne,
        scan_range_m=settings.scan_range_m,
        guide_rad=guide,
        final_ne_m=target if final else None,
        safety_distance_m=settings.safety_distance_m,
        surface=terrain_surface(
            request.known, centre_ne_m=scan_ne, reach_m=REACH * settings.scan_range_m
        ),
        radars=task.radars,
        zones=task.zones,
    )


def facing(pose: Pose, bearing_rad: float) -> Pose:
    """A pose at rest, turned to a bearing: level, and without a bend."""
    tangent = np.array([math.cos(bearing_rad), math.sin(bearing_rad), 0.0])
    return replace(pose, tangent_nea=tangent, curvature_nea_1_m=np.zeros(3))


# --- the guide direction (2.6, f3): towards the target, or along a tangent of radars


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Circle:
    bearing_rad: float
    distance_m: float
    radius_m: float

    @property
    def half_width_rad(self) -> float:
        return math.asin(self.radius_m / self.distance_m)


def tangent_guide_rad(
    scan_ne_m: tuple[float, float],
    target_ne_m: tuple[float, float],
    radars: tuple[Radar, ...],
    overlap_m: float,
) -> float:
    """Bearing of the guide direction from p_scan, radians clockwise from the frame's north.

    Case 1: S-T crosses no radar circle: towards the target.  Case 2: the nearest circle that
    S-T crosses, with all circles that overlap it by more than d_overlap, and those that overlap
    these, and so on (part A, row 17); of its two outer tangents the one with the smaller angle
    to S-T (row 16).  Circles of the whole range (row 14); a radar around S is ignored (row 15).
    """
    north, east = target_ne_m[0] - scan_ne_m[0], target_ne_m[1] - scan_ne_m[1]
    straight, distance = math.atan2(east, north), math.hypot(north, east)
    around = [radar for radar in radars if _distance_m(scan_ne_m, radar) > radar.range_m]
    crossed = [
        (entry, radar)
        for radar in around
        if (entry := _entry_m(_circle(scan_ne_m, radar), straight, distance)) is not None
    ]
    if not crossed:
        return straight
    nearest = min(crossed, key=lambda pair: pair[0])[1]
    left, right = 0.0, 0.0
    for radar in _cluster(nearest, around, overlap_m):
        circle = _circle(scan_ne_m, radar)
        offset = wrap_rad(circle.bearing_rad - straight)
        left = min(left, offset - circle.half_width_rad)
        right = max(right, offset + circle.half_width_rad)
    left, right = max(left, -_WIDEST_RAD), min(right, _WIDEST_RAD)
    return wrap_rad(straight + (left if -left < right else right))


def _distance_m(point_ne_m: tuple[float, float], radar: Radar) -> float:
    centre = radar.centre_nea_m
    return math.hypot(centre[0] - point_ne_m[0], centre[1] - point_ne_m[1])


def _circle(scan_ne_m: tuple[float, float], radar: Radar) -> _Circle:
    north, east = radar.centre_nea_m[0] - scan_ne_m[0], radar.centre_nea_m[1] - scan_ne_m[1]
    return _Circle(
        bearing_rad=math.atan2(east, north),
        distance_m=math.hypot(north, east),
        radius_m=radar.range_m,
    )


def _entry_m(circle: _Circle, bearing_rad: float, reach_m: float) -> float | None:
    """Distance along a ray from S to where it enters a circle, None if it does not in reach."""
    offset = wrap_rad(circle.bearing_rad - bearing_rad)
    along, aside = circle.distance_m * math.cos(offset), circle.distance_m * math.sin(offset)
    if along <= 0.0 or abs(aside) >= circle.radius_m:
        return None
    entry = along - math.sqrt(circle.radius_m**2 - aside**2)
    return entry if entry < reach_m else None


def _cluster(first: Radar, radars: list[Radar], overlap_m: float) -> list[Radar]:
    """All radars joined to the first by overlaps of more than d_overlap, transitively."""
    cluster, waiting = [first], [first]
    while waiting:
        here = waiting.pop()
        for other in radars:
            apart = _distance_m((here.centre_nea_m[0], here.centre_nea_m[1]), other)
            if other not in cluster and apart < here.range_m + other.range_m - overlap_m:
                cluster.append(other)
                waiting.append(other)
    return cluster
