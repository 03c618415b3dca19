"""One plan: the next subpath from the known map at p_scan, or a refusal with its reason.

Guidance, search, proof: the best candidate that is proven safe is taken (verify, then commit);
if none is, or it costs more than was hoped, the search is repeated with one more control point.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import final

import numpy as np

from companion import jit
from companion.geodesy import FloatArray
from companion.objective import TERMS, Scene, Workspace, radar_table, rows_of, weights_of
from companion.optimise import refined_de
from companion.optimise.loop import minimise
from companion.optimise.registry import OPTIMISERS
from companion.path.certificate import Certificate, certify
from companion.path.envelope import slowing_m
from companion.path.proof import Surroundings
from companion.path.subpath import Subpath
from companion.planner import kernels, rules
from companion.planner.backtrack import backtrack
from companion.planner.cost_grid import Place, descent_m
from companion.planner.escape import StartViolation, escape_path, start_violation
from companion.planner.field import CostToGo, cost_to_go
from companion.planner.price import Prices
from companion.planner.procedure import hover_pose
from companion.planner.progress import BELIEVED, Progress
from companion.planner.reachability import blocked_at
from companion.planner.request import REACH, NotPlanned, Planned, PlanOutcome, PlanRequest, Refusal
from companion.planner.seeds import seeds_of, ways_of
from companion.planner.settings import Task
from companion.planner.way_out import way_out
from companion.world.clearance import Surface, safe_surface, sees_anything
from companion.world.columns import distance_to_terrain_m
from companion.world.zones import NearCells, PolygonZone, near_cells, packed

_POINTS = (5, 6)  # control points: six where five find nothing good
_CHUNK = 300  # evaluations between two looks at the clock
_CERTIFIED = 16  # candidates of a search that are tried
_RADAR_MARGIN = 1.0 / 800.0  # of R, for what lies between samples
_DEARER = 0.05  # of the cost of R: what a first answer may cost more than was promised
_MUCH_DEARER = 0.5  # of the cost of R: then it is planned more slowly, too
_SLOWER = (1.0, 0.5, 0.25)  # of V: turns of a quarter of the radius, and of a sixteenth
_OWED, _OWED_NEAR = 1.0, 0.25
"""Of R: what may be owed (`planner.progress`), if a stop costs no more; the second near things.

Chosen on 13 worlds of 20261128 (`walls`, `gathered`, `copter`: mean J 56.7, 51.1 and 52.1 with
0.25, 1 and 2), and on forests (218 and 240 s with 0.25 and 1 for seed 3001)."""
_FEW = 0.005  # of the cells in sight: when a scan shows no more than that, nothing new was seen
_AT_TARGET_M = 1e-6  # arithmetic: an end at the target is copied from it
_ROOM = 0.35  # of the circle's radius: from ends to a target that is not the end
_STRICTER = 100.0  # times, when nothing was proven
_IN_REACH = 1.5  # of R: threats farther away concern no subpath


def plan(request: PlanRequest, stop: Callable[[], bool] = lambda: False) -> PlanOutcome:
    """Search for the next subpath until one is proven safe.

    Or the way back, if that is asked for.
    stop: asked every few hundred evaluations; in real time it tells that time is up, and then the
    best so far is taken, if it can be proven.
    """
    if request.flown is not None:
        return backtrack(request.flown, request.task, request.known, request.plan_id)
    refusal = _impossible(request)
    if refusal is None and (found := start_violation(request)) is not None:
        return _escape(request, found)
    if (refusal := refusal or _unreachable(request)) is not None:
        return NotPlanned(plan_id=request.plan_id, refusal=refusal)
    patience = _TimeBudget(stop)
    outcome = _Plan(request, patience).outcome()
    return replace(outcome, stopped_after=patience.stopped_after)


@final
class _TimeBudget:
    """Wraps `stop`: counts the calls until it is true, and then stays true."""

    def __init__(self, stop: Callable[[], bool]) -> None:
        self._stop, self._went_on = stop, 0
        self.stopped_after: int | None = None

    def __call__(self) -> bool:
        if self.stopped_after is None:
            if not self._stop():
                self._went_on += 1
                return False
            self.stopped_after = self._went_on
        return True


def _impossible(request: PlanRequest) -> Refusal | None:
    """Why the request itself, or its start, is invalid; None if it is not."""
    task, limits = request.task, request.task.limits
    if not _is_sane(request):
        return Refusal.NO_QUESTION
    if 2.0 * limits.turn_radius_m > task.settings.scan_range_m:
        return Refusal.NO_ROOM_TO_TURN
    north, east, altitude = request.start.point_nea_m
    inside = limits.north_m[0] <= north <= limits.north_m[1]
    inside = inside and limits.east_m[0] <= east <= limits.east_m[1]
    low, high = limits.inner_band_amsl_m(task.error_m)
    if not inside or not low <= altitude <= high:
        return Refusal.START_OUTSIDE
    if not sees_anything(request.known, request.scan_nea_m[:2], task.settings.scan_range_m):
        return Refusal.NOTHING_SEEN
    return None


def _unreachable(request: PlanRequest) -> Refusal | None:
    """Why the target is invalid; None if it is not."""
    task, target = request.task, "target"
    for broken, *_ in rules.of_target(task, request.target_ne_m, target):
        return Refusal.TARGET_IN_KEEP_OUT if broken == target else Refusal.TARGET_AT_EDGE
    highest = np.array([*request.target_ne_m, task.band_amsl_m[1]])
    required_m = task.required_clearance_m
    if distance_to_terrain_m(request.around, highest, required_m, seen_only=True) < required_m:
        return Refusal.TARGET_IN_TERRAIN
    return None


def _is_sane(request: PlanRequest) -> bool:
    """Whether all numbers are finite, and the limits leave room to plan."""
    limits, task = request.task.limits, request.task
    numbers = *request.scan_nea_m, *request.target_ne_m, *rows_of(request.start).ravel()
    low, high = task.band_amsl_m
    positive = (
        *(high - low, task.settings.safety_distance_m, task.settings.scan_range_m),
        *(limits.speed_m_s, limits.acceleration_m_s2, limits.turn_radius_m),
        *(limits.climb_angle_rad, limits.dive_angle_rad),
    )
    return bool(np.isfinite(numbers).all() and np.isfinite(positive).all() and min(positive) > 0.0)


def _escape(request: PlanRequest, found: StartViolation) -> PlanOutcome:
    """The shortest escape path from a place where no certificate can begin."""
    escape = escape_path(request, found) if request.from_rest else None
    if escape is None:
        refusal = Refusal.START_IN_KEEP_OUT if found.zones else Refusal.START_NEAR_TERRAIN
        if not found.zones and request.task.settings.is_near:
            refusal = Refusal.START_NEAR_THINGS
        elif not found.zones and found.unknown:
            refusal = Refusal.START_NEAR_UNKNOWN
        return NotPlanned(plan_id=request.plan_id, refusal=refusal)
    return _straight_plan(request, *escape)


def _straight_plan(request: PlanRequest, subpath: Subpath, certificate: Certificate) -> Planned:
    """A plan that no search has made: it has no cost."""
    tangent, end = subpath.pose(0.0).tangent_nea, subpath.control_nea_m[-1]
    return Planned(
        plan_id=request.plan_id,
        kernel=kernels.signature(),
        subpath=subpath,
        reaches_target=math.dist(end[:2], request.target_ne_m) < _AT_TARGET_M,
        certificate=certificate,
        guide_rad=math.atan2(tangent[1], tangent[0]),
        route_ne_m=request.route_ne_m,
    )


def _speeds_m_s(request: PlanRequest) -> tuple[float, ...]:
    """The speeds at which a subpath may be flown, the fastest first.

    A copter turns the tighter the slower it is, and stops within less.  In flight it is no slower
    than it comes.
    """
    limits, rest = request.task.limits, request.rest
    comes_m_s = None if rest is None else rest.speed_m_s
    least = limits.speed_m_s if comes_m_s is None else min(comes_m_s, limits.speed_m_s)
    least = 0.0 if request.from_rest else least
    speeds = (share * limits.speed_m_s for share in (_SLOWER if limits.hovers else (1.0,)))
    return tuple(speed for speed in speeds if speed >= least)


@final
class _Plan:
    """One plan in progress: the common data of its searches."""

    def __init__(self, request: PlanRequest, stop: Callable[[], bool]) -> None:
        self._request, self._stop = request, stop
        task, before = request.task, request.progress
        self._range_m = task.settings.scan_range_m
        owed = _OWED_NEAR if task.settings.is_near else _OWED
        self._allowed_m = max(task.stop_m, owed * self._range_m)  # what may be owed
        self._progress = self._guided(before)
        self._scene = _scene(request, self._field)
        self._surroundings: dict[float, Surroundings] = {}
        self._evaluations = self._tries = 0
        self._is_cut = False  # whether time was up before all was searched
        self._broken: tuple[str, ...] = ()

    def _guided(self, before: Progress) -> Progress:
        """Ask guidance what is left to fly, without guesses where they were found wrong."""
        left_m = self._left_m(guesses=True)
        if left_m < before.believed_below_m:
            if before.believed_below_m < math.inf:
                before = Progress(seen=before.seen)
            progress = self._at(before, left_m)
            if progress.doubt_m <= BELIEVED * self._range_m:
                return progress
            before = progress.disbelieving(left_m, self._request.known.cell_m)
        return self._at(before, self._left_m(guesses=False))

    def _left_m(self, *, guesses: bool) -> float:
        """Of the way to the target, by guidance with or without guesses."""
        request = self._request
        self._field = cost_to_go(
            request.around,
            request.task,
            request.scan_nea_m[:2],
            request.target_ne_m,
            request.route_ne_m,
            guesses=guesses,
        )
        self._prices = Prices(request.task, self._field)
        return self._prices.left_m(request.start.point_nea_m)

    def _at(self, before: Progress, left_m: float) -> Progress:
        """Whether the mission gets on, from where so much is left."""
        known = self._request.known
        few_cells = _FEW * math.pi * (self._range_m / known.cell_m) ** 2
        seen = int(np.count_nonzero(known.seen))
        return before.at(left_m, known.cell_m, seen=seen, few=few_cells)

    def outcome(self) -> Planned | NotPlanned:
        """The best subpath that is proven, or why there is none."""
        request, is_near = self._request, self._request.task.settings.is_near
        if not is_near:  # where a near thing stands is told too widely
            ends_ne_m = request.start.point_nea_m[:2], request.target_ne_m
            closed = blocked_at(request.known, request.task, self._field, ends_ne_m)
            if closed is not None:
                return self._refused(Refusal.NO_WAY, closed)
        best: Planned | None = None
        enough_m = math.inf  # to look no further; from rest a slow leg may beat a long way round
        if is_near and request.from_rest:
            enough_m = _MUCH_DEARER * self._range_m
        for speed_m_s in _speeds_m_s(request):
            if best is None or self._prices.excess_m(best) > enough_m:
                best = self._cheaper(best, self._searched(self._at_speed(speed_m_s)))
        if request.from_rest and (best is None or self._goes_round(best)):
            owes = self._progress.owed_m > self._allowed_m
            out = self._way_out(looks=best is None, strays=not owes)
            if out is None and owes and self._field.is_barred and not is_near:
                return self._refused(Refusal.NO_WAY, self._field.route_ne_m[0])
            price_m = math.inf if best is None else self._prices.price_m(best)
            if out is not None and out[1] <= price_m + (self._progress.owed_m if owes else 0.0):
                best, price_m = out[0], out[1] - self._request.task.stop_m
            dearer_m = price_m - self._prices.promised_m(request.start.point_nea_m)
            believes = not is_near and self._progress.believed_below_m == math.inf
            if dearer_m > self._allowed_m and believes and not self._is_cut:
                return self._without_guesses()
        if best is None:
            return self._refused(Refusal.OUT_OF_TIME if self._is_cut else Refusal.NOTHING_SAFE)
        if request.rest is not None and (self._goes_round(best) or self._is_better_to_stop(best)):
            return self._refused(Refusal.BETTER_TO_STOP)
        progress = self._progress.after(self._owed_m(best), self._prices.after_m(best))
        return replace(best, evaluations=self._evaluations, tries=self._tries, progress=progress)

    def _without_guesses(self) -> Planned | NotPlanned:
        """The plan anew, where what guidance has promised from here cannot be flown."""
        left_m = self._prices.left_m(self._request.start.point_nea_m)
        progress = self._progress.disbelieving(left_m, self._request.known.cell_m)
        anew = _Plan(replace(self._request, progress=progress), self._stop)
        anew._evaluations, anew._tries = self._evaluations, self._tries
        return anew.outcome()

    def _owed_m(self, planned: Planned) -> float:
        """What the mission owes with this subpath; a straight piece only if more is left then."""
        if planned.is_escape:
            here_nea_m, end_nea_m = planned.subpath.control_nea_m[[0, -1]].tolist()
            more_m = self._prices.left_m(end_nea_m) - self._prices.left_m(here_nea_m)
            stop_m = self._request.task.stop_m if more_m > 0.0 else 0.0
            return self._progress.owed_m + max(more_m, 0.0) + stop_m
        return self._progress.owing(self._prices.excess_m(planned), self._range_m)

    def _goes_round(self, planned: Planned) -> bool:
        """Whether the mission would owe more than a stop costs."""
        return not planned.reaches_target and self._owed_m(planned) > self._allowed_m

    def _at_speed(self, speed_m_s: float) -> Scene:
        """The scene of a subpath that is flown no faster than this."""
        motion = self._request.task.at_speed(speed_m_s).envelope
        shortest_m = float(max(slowing_m(motion, motion.speed_m_s), motion.lead_m))
        shortest_m = 0.0 if self._scene.from_rest else shortest_m
        return self._scene._replace(motion=motion, shortest_m=shortest_m)

    def _way_out(self, *, looks: bool, strays: bool) -> tuple[Planned, float] | None:
        """A straight piece to where less is left to fly, or (looks) more is seen; its price."""

        def prove(subpath: Subpath) -> Planned | None:
            for speed_m_s in _speeds_m_s(self._request):
                certificate = self._certified(subpath, speed_m_s, from_rest=True)
                if certificate.proven:
                    return replace(
                        _straight_plan(self._request, subpath, certificate),
                        route_ne_m=self._field.route_ne_m,
                        speed_m_s=self._told_m_s(speed_m_s),
                    )
            return None

        price = self._prices.price_m
        return way_out(self._request, self._field, prove, price, looks=looks, strays=strays)

    def _told_m_s(self, speed_m_s: float) -> float | None:
        """The speed of a plan; None if it is V."""
        return None if speed_m_s >= self._request.task.limits.speed_m_s else speed_m_s

    def _certified(self, subpath: Subpath, speed_m_s: float, *, from_rest: bool) -> Certificate:
        if (here := self._surroundings.get(speed_m_s)) is None:
            here = self._surroundings[speed_m_s] = _surroundings(self._request, speed_m_s)
        return certify(subpath, here, from_rest=from_rest)

    def _refused(self, refusal: Refusal, place_ne_m: Place | None = None) -> NotPlanned:
        return NotPlanned(
            plan_id=self._request.plan_id,
            refusal=refusal,
            broken=() if refusal is Refusal.BETTER_TO_STOP else self._broken,
            evaluations=self._evaluations,
            tries=self._tries,
            place_ne_m=place_ne_m,
        )

    def _searched(self, scene: Scene) -> Planned | None:
        """The cheapest subpath, until one costs hardly more than was hoped or time is up.

        Where none is proven, what breaks a bound counts more, so that it is not traded for way;
        and at last a subpath need not end at a target that is in sight.
        """
        scenes = [(scene, _DEARER), (_strict(scene), math.inf)]
        if scene.is_final:
            scenes.append((_past_target(_strict(scene)), math.inf))
        best: Planned | None = None
        for each, enough in scenes:
            for points in _POINTS:
                if best is not None and self._prices.excess_m(best) <= enough * self._range_m:
                    return best
                if self._tries and self._stop():
                    self._is_cut = True
                    return best
                best = self._cheaper(best, self._attempt(each.with_points(points)))
        return best

    def _cheaper(self, one: Planned | None, other: Planned | None) -> Planned | None:
        """Of two subpaths, the first one if they cost the same."""
        found = [each for each in (one, other) if each is not None]
        return min(found, key=self._prices.price_m, default=None)

    def _is_better_to_stop(self, best: Planned) -> bool:
        """Whether it costs less to stop at the end of the current leg and continue from there.

        That plan uses the same map and end circle, and may leave in any direction.
        """
        if (rest := self._request.rest) is None:
            return False
        stop_m, price_m = rest.length_m + self._request.task.stop_m, self._prices.price_m(best)
        if price_m <= stop_m + self._prices.promised_m(rest.end_nea_m):
            return False
        scene = self._scene._replace(
            start=rows_of(hover_pose(rest.end_nea_m)), from_rest=True, shortest_m=0.0
        )
        leaving = None if self._stop() else self._attempt(scene)
        return leaving is not None and self._prices.price_m(leaving) + stop_m < price_m

    def _search(self, scene: Scene) -> FloatArray:
        """The candidates of one search, best first.  -> (M, D)."""
        request, settings = self._request, self._request.task.settings
        self._tries += 1
        rng = request.rng(self._tries)
        evaluations = (1 + request.attempt) * settings.evaluations
        name = settings.optimiser or settings.profile.optimiser
        tail = None if request.rest is None else request.rest.end_nea_m
        seeds = seeds_of(scene, ways_of(scene, self._field.route_ne_m, request.known.cell_m, tail))
        if name != "refined-de":
            optimiser = OPTIMISERS[name](scene.variables, evaluations, rng, seeds)
            costs = jit.compiled(kernels.costs)
            ranked = minimise(optimiser, lambda x: costs(x, scene), evaluations, self._stop)
            self._evaluations += ranked.evaluations
            self._is_cut |= ranked.evaluations < evaluations
            return ranked.x
        state = refined_de.begin(scene.variables, evaluations, seeds, refined_de.Settings(), rng)
        for until in range(_CHUNK, evaluations + _CHUNK, _CHUNK):
            jit.compiled(kernels.search)(state, scene, min(until, evaluations))
            if self._stop():
                self._is_cut |= until < evaluations
                break
        self._evaluations += refined_de.spent(state)
        return refined_de.ranked(state)[0]

    def _attempt(self, scene: Scene) -> Planned | None:
        """One search, and the best of its candidates that has a certificate."""
        request, weights = self._request, self._scene.weights
        for rank, x in enumerate(self._search(scene)[:_CERTIFIED]):
            subpath = Subpath(control_nea_m=scene.control_points(x))
            if not subpath.is_longer_than(scene.shortest_m):
                continue  # the certificate is about a vehicle that can stop (or hold) at the end
            speed_m_s = scene.motion.speed_m_s
            certificate = self._certified(subpath, speed_m_s, from_rest=scene.from_rest)
            if certificate.proven:
                jit.compiled(kernels.costs)(x[None], scene)
                terms = dict(zip(TERMS, scene.at.terms.tolist(), strict=True))
                costs = {name: a * terms[name] for name, a in zip(TERMS, weights, strict=True)}
                return Planned(
                    plan_id=request.plan_id,
                    kernel=kernels.signature(),
                    subpath=subpath,
                    reaches_target=scene.is_final,
                    cost=sum(costs.values()) - costs["to_go"],
                    to_go=costs["to_go"],
                    terms=terms,
                    certificate=certificate,
                    guide_rad=scene.guide_rad,
                    route_ne_m=self._field.route_ne_m,
                    evaluations=self._evaluations,
                    rank=rank,
                    tries=self._tries,
                    speed_m_s=self._told_m_s(speed_m_s),
                )
            self._broken = self._broken or certificate.broken
        return None


def _scene(request: PlanRequest, field: CostToGo) -> Scene:
    task, settings = request.task, request.task.settings
    limits, scan_ne = task.limits, request.scan_nea_m[:2]
    is_final, end_radius = _end(request)
    radars = task.radars_near(scan_ne, _IN_REACH * settings.scan_range_m)
    zones = packed(task.zones)
    surface = _surface(request, task.search_clearance_m)
    return Scene(
        weights=weights_of(settings.weights),
        motion=task.envelope,
        margin=settings.profile.margin,
        start=rows_of(request.start),
        from_rest=request.from_rest,
        shortest_m=0.0,  # as of its speed: `_at_speed`
        scan_ne_m=scan_ne,
        scan_range_m=float(settings.scan_range_m),
        end_radius_m=float(end_radius),
        is_final=is_final,
        final_ne_m=request.target_ne_m,
        guide_rad=field.leaving_rad(scan_ne, end_radius),
        to_go=field.value,
        needed=field.needed,
        descent_m=float(descent_m(limits.ceiling_amsl_m, task)),
        safety_distance_m=float(settings.safety_distance_m),
        clearance_m=float(task.zone_search_clearance_m),
        surface=surface,
        contact=_surface(request, task.envelope.contact_m) if limits.hovers else surface,
        band_amsl_m=task.band_amsl_m,
        north_m=limits.north_m,
        east_m=limits.east_m,
        radars=radar_table(radars, _RADAR_MARGIN * settings.scan_range_m),
        zones=zones,
        near_polygons=_near_polygons(task),
        at=Workspace.of(_POINTS[0], settings.profile.samples, len(zones.polygons)),
    )


def _strict(scene: Scene) -> Scene:
    """The scene in which what breaks a bound counts more, so that it is not traded for way."""
    times = (_STRICTER if name in ("crash", "constraints") else 1.0 for name in TERMS)
    return scene._replace(weights=tuple(a * b for a, b in zip(scene.weights, times, strict=True)))


def _near_polygons(task: Task) -> NearCells:
    polygons = tuple(zone for zone in task.zones if isinstance(zone, PolygonZone))
    return near_cells(
        polygons, task.limits.north_m, task.limits.east_m, task.zone_search_clearance_m
    )


def _end(request: PlanRequest) -> tuple[bool, float]:
    """Whether the subpath ends at the target, and the radius of the circle on which it ends else.

    When the target is just beyond sight, the end stays so far from it that the last subpath has
    room to turn.
    """
    reach = request.task.end_radius_m
    left = math.dist(request.scan_nea_m[:2], request.target_ne_m)
    if left <= reach and request.known.is_known(*request.target_ne_m):
        return True, reach
    return False, min(reach, max(left - _ROOM * reach, 0.5 * reach))


def _past_target(scene: Scene) -> Scene:
    """The scene of a subpath that does not end at a target within reach, though it could.

    Its end leaves room to turn to the target, or to climb: nearer than that it has to go away
    first.
    """
    room_m, to_go = _ROOM * scene.end_radius_m, scene.to_go
    away_m = np.where(to_go.vertex_m < room_m, 2.0 * room_m - to_go.vertex_m, to_go.vertex_m)
    return scene._replace(is_final=False, to_go=to_go._replace(vertex_m=away_m))


def _surface(request: PlanRequest, clearance_m: float) -> Surface:
    return safe_surface(
        request.around,
        centre_ne_m=request.scan_nea_m[:2],
        reach_m=REACH * request.task.settings.scan_range_m,
        clearance_m=clearance_m,
        unknown_m=request.task.limits.ceiling_amsl_m,
        floor_m=request.task.limits.floor_amsl_m,
    )


def _surroundings(request: PlanRequest, speed_m_s: float) -> Surroundings:
    task, scan_ne_m = request.task.at_speed(speed_m_s), request.scan_nea_m[:2]
    range_m = task.settings.scan_range_m
    radars = task.radars_near(scan_ne_m, _IN_REACH * range_m)
    return task.surroundings(request.known, scan_ne_m, REACH * range_m, radars=radars)
