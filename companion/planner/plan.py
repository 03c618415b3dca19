"""One plan: from what is known at p_scan to the next subpath, or the reason why there is none."""

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from companion.geodesy import FloatArray, wrap_rad
from companion.objective.scene import VARIABLES, Scene, control_points
from companion.objective.terms import cost, cost_table
from companion.optimise.improved_de import ImprovedDE
from companion.optimise.loop import Ranked, minimise
from companion.path.check import CheckReport, check
from companion.path.subpath import Pose, Subpath
from companion.planner.guidance import tangent_guide_rad
from companion.planner.settings import Task
from companion.world.clearance import Surface, safe_surface, terrain_surface
from companion.world.known_map import KnownMap

_REACH = 1.1  # of R about p_scan: no curve bulges further, whatever its variables
_STREAM_PLAN = 1  # the planner's random stream among those of one seed


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanRequest:
    """The question: everything that the answer depends on."""

    plan_id: int
    seed: int
    task: Task
    known: KnownMap
    scan_nea_m: tuple[float, float, float]
    """p_scan."""
    start: Pose
    """p_prog and the tangent there."""
    from_rest: bool
    """Whether the vehicle hovers at the start, so that the path may leave in any direction."""
    target_ne_m: tuple[float, float]
    attempt: int = 0
    """How often this question has been asked in vain; each time the search is wider."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Planned:
    """The next subpath."""

    plan_id: int
    subpath: Subpath
    reaches_target: bool
    cost: float
    terms: dict[str, float]
    report: CheckReport
    guide_rad: float
    evaluations: int
    rank: int
    """Position among the candidates by cost: 0 is the best, more if better ones were unsafe."""
    tries: int


class Refusal(enum.Enum):
    """Why there is no subpath, and what helps."""

    NOTHING_SAFE = (
        "no candidate subpath passed the safety check; "
        "lower planner.safety_distance_m or raise planner.evaluations"
    )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NotPlanned:
    """No subpath: the reason, and which bound the best candidate broke."""

    plan_id: int
    refusal: Refusal
    broken: tuple[str, ...]
    evaluations: int


PlanOutcome = Planned | NotPlanned


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Try:
    """One way of asking: the guide turned, a nearer end, a larger budget."""

    turn_rad: float = 0.0
    reach: float = 1.0
    budget: int = 1


_TRIES = (
    _Try(),
    _Try(budget=2),
    *(_Try(turn_rad=side * turn, budget=2) for turn in (0.35, 0.7, 1.1) for side in (1, -1)),
    *(_Try(reach=reach, budget=2) for reach in (0.7, 0.45)),
    *(_Try(turn_rad=side * turn, reach=0.6, budget=2) for turn in (0.7, 1.4) for side in (1, -1)),
)


def plan(request: PlanRequest, stop: Callable[[], bool] = lambda: False) -> PlanOutcome:
    """Search for the next subpath until one passes the check (profile `paper`: the first).

    stop: asked between tries; in real time it tells that there is no time for another.
    """
    check_surface = _surface(request, request.task.required_clearance_m)
    base = _scene(request)
    spent = 0
    broken: tuple[str, ...] = ()
    for number, how in enumerate(_TRIES):
        if number and stop():
            break
        scene = _vary(base, request, how)
        rng = np.random.default_rng(
            [request.seed, _STREAM_PLAN, request.plan_id, request.attempt, number]
        )
        ranked = _search(scene, request.task, how.budget * (1 + request.attempt), rng)
        spent += ranked.evaluations
        for rank, x in enumerate(ranked.x):
            subpath = Subpath(control_nea_m=control_points(x[None], scene)[0])
            report = _check(subpath, check_surface, request)
            violations = _violations(report, request.task)
            if not violations or not scene.profile.verified:
                return _planned(request, scene, x, subpath, report, spent, rank, number + 1)
            broken = broken or violations
    return NotPlanned(
        plan_id=request.plan_id,
        refusal=Refusal.NOTHING_SAFE,
        broken=broken,
        evaluations=spent,
    )


def _planned(
    request: PlanRequest,
    scene: Scene,
    x: FloatArray,
    subpath: Subpath,
    report: CheckReport,
    evaluations: int,
    rank: int,
    tries: int,
) -> Planned:
    table = cost_table(x[None], scene)
    return Planned(
        plan_id=request.plan_id,
        subpath=subpath,
        reaches_target=scene.final_ne_m is not None,
        cost=float(cost(x[None], scene)[0]),
        terms={name: float(column[0]) for name, column in table.items()},
        report=report,
        guide_rad=scene.guide_rad,
        evaluations=evaluations,
        rank=rank,
        tries=tries,
    )


def _search(scene: Scene, task: Task, budget: int, rng: np.random.Generator) -> Ranked:
    settings = task.settings
    evaluations = budget * settings.evaluations
    optimiser = ImprovedDE(
        VARIABLES,
        generations=evaluations // settings.search.population,
        settings=settings.search,
        rng=rng,
        seeds=_seeds(scene) if scene.profile.verified else None,
    )
    return minimise(optimiser, lambda x: cost(x, scene), evaluations)


def _seeds(scene: Scene) -> FloatArray:
    """Plausible subpaths to begin with: towards the guide, level or rising, and bent aside."""
    tangent = scene.start.tangent_nea
    aim = wrap_rad(scene.guide_rad - math.atan2(tangent[1], tangent[0])) / math.pi + 0.5
    band = scene.ceiling_amsl_m - scene.floor_amsl_m
    level = (scene.start.position_nea_m[2] - scene.floor_amsl_m) / band
    bends = [(0.0, 0.0), (0.1, 0.1), (-0.1, -0.1), (0.15, 0.0), (-0.15, 0.0)]
    rows = [
        (0.1, 0.4, aim / 2 + 0.25 + at_3, altitude, aim + at_4, altitude)
        for altitude in (level, 0.0, 0.5)
        for at_3, at_4 in bends
    ]
    return np.clip(np.array(rows), 0.0, 1.0)


def _scene(request: PlanRequest) -> Scene:
    task, settings = request.task, request.task.settings
    scan_ne = request.scan_nea_m[:2]
    guide = tangent_guide_rad(scan_ne, request.target_ne_m, task.radars, settings.overlap_m)
    final, end_radius = _end(request)
    if final:
        guide = _bearing_rad(scan_ne, request.target_ne_m)
    if settings.profile.verified:
        surface = _surface(request, task.search_clearance_m)
    else:
        surface = terrain_surface(
            request.known, centre_ne_m=scan_ne, reach_m=_REACH * settings.scan_range_m
        )
    return Scene(
        profile=settings.profile,
        weights=settings.weights,
        limits=task.limits,
        start=_facing(request.start, guide) if request.from_rest else request.start,
        scan_ne_m=scan_ne,
        scan_range_m=settings.scan_range_m,
        end_radius_m=end_radius,
        guide_rad=guide,
        final_ne_m=request.target_ne_m if final else None,
        safety_distance_m=settings.safety_distance_m,
        clearance_m=task.search_clearance_m,
        surface=surface,
        radars=task.radars,
        keep_outs=task.keep_outs,
    )


def _end(request: PlanRequest) -> tuple[bool, float]:
    """Whether the subpath ends at the target, and the radius of the circle on which it ends else.

    When the target is just beyond sight, the end stays so far from it that the last subpath has
    room to turn.
    """
    reach = request.task.end_radius_m
    north, east, _ = request.scan_nea_m
    left = math.hypot(request.target_ne_m[0] - north, request.target_ne_m[1] - east)
    if left <= reach and request.known.is_known(*request.target_ne_m):
        return True, reach
    if request.task.settings.profile.verified:
        reach = min(reach, max(left - 0.35 * reach, 0.5 * reach))
    return False, reach


def _vary(scene: Scene, request: PlanRequest, how: _Try) -> Scene:
    """The scene as one try sees it; tries that are not straight do not end at the target."""
    if how.turn_rad == 0.0 and how.reach == 1.0:
        return scene
    guide = wrap_rad(scene.guide_rad + how.turn_rad)
    return replace(
        scene,
        guide_rad=guide,
        end_radius_m=scene.end_radius_m * how.reach,
        final_ne_m=None,
        start=_facing(scene.start, guide) if request.from_rest else scene.start,
    )


def _facing(pose: Pose, bearing_rad: float) -> Pose:
    return replace(pose, tangent_nea=np.array([math.cos(bearing_rad), math.sin(bearing_rad), 0.0]))


def _bearing_rad(here_ne_m: tuple[float, float], there_ne_m: tuple[float, float]) -> float:
    return math.atan2(there_ne_m[1] - here_ne_m[1], there_ne_m[0] - here_ne_m[0])


def _surface(request: PlanRequest, clearance_m: float) -> Surface:
    return safe_surface(
        request.known,
        centre_ne_m=request.scan_nea_m[:2],
        reach_m=_REACH * request.task.settings.scan_range_m,
        clearance_m=clearance_m,
        unknown_m=request.task.limits.ceiling_amsl_m,
    )


def _check(subpath: Subpath, safe: Surface, request: PlanRequest) -> CheckReport:
    task = request.task
    return check(
        subpath,
        safe=safe,
        known=request.known,
        limits=task.limits,
        radars=task.radars,
        keep_outs=task.keep_outs,
        safety_distance_m=task.settings.safety_distance_m,
    )


def _violations(report: CheckReport, task: Task) -> tuple[str, ...]:
    return report.violations(task.limits, task.required_clearance_m)
