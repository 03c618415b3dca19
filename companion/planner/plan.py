"""One plan: the next subpath from the known map at p_scan, or a refusal with its reason.

Guidance, search, proof: the best candidate that is proven safe is taken (verify, then commit);
if none is, the search is repeated with more variables, other directions and a nearer end.  Time may
end before all of these searches are done: the next attempt from the same place goes on with the one
that comes next.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from companion.geodesy import FloatArray, wrap_rad
from companion.objective.scene import SPREAD_RAD, FlightScene, control_points, weight
from companion.optimise import refined_de
from companion.optimise.loop import minimise
from companion.optimise.registry import OPTIMISERS
from companion.path.certificate import certify, pack_surroundings
from companion.path.envelope import slowing_m, stopping_m
from companion.path.proof_distance import Surroundings
from companion.path.subpath import Subpath
from companion.planner import kernels
from companion.planner.backtrack import backtrack
from companion.planner.cost_grid import descent_m, sampled
from companion.planner.escape import StartViolation, escape_path, start_violation
from companion.planner.field import CostToGo, cost_to_go
from companion.planner.procedure import Leg, hover_pose
from companion.planner.reachability import blocked_at
from companion.planner.request import REACH, NotPlanned, Planned, PlanOutcome, PlanRequest, Refusal
from companion.planner.settings import Task
from companion.world.clearance import Surface, safe_surface, sees_anything
from companion.world.columns import distance_to_terrain_m
from companion.world.zones import NearCells, PolygonZone, near_cells

_CHUNK = 300  # evaluations between two looks at the clock
_CERTIFIED = 16  # candidates of a search that are tried
_GUIDE_SHARE = 0.2  # of a_3 that the angle of eq. 8 keeps: the cost-to-go does the rest
_RADAR_MARGIN = 1.0 / 800.0  # of R, for what lies between samples
_MUCH_DEARER = 0.5  # of the cost of R: then the search is given more, and what stands looks around
_DEARER = 0.05  # of the cost of R: what a first answer may cost more than was promised
_ENDS_SHORT = 0.25  # of what an end lies short of R: from there, less is seen than is hoped for
_IN_REACH = 1.5  # of R: threats farther away concern no subpath
_SEARCH = refined_de.Settings()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _SearchVariant:
    """A variant of the search: more control points, a turned guide, a nearer end."""

    points: int = 5
    turn_rad: float = 0.0
    reach: float = 1.0


_FIRST = _SearchVariant()
_OTHER_WAYS = (_SearchVariant(points=6), _SearchVariant(reach=0.7), _SearchVariant(reach=0.45))
"""Tried as well if the first result costs more than the cost-to-go predicted."""
_HARDER = tuple(_SearchVariant(points=6, reach=reach) for reach in (0.7, 0.45))
"""Tried if that costs much more, or nothing was proven."""
_SHORT = tuple(_SearchVariant(reach=reach) for reach in (0.3, 0.2))
"""Tried from rest where sight is short: a step forward shows more than a long way back."""
_ANY_WAY = tuple(
    _SearchVariant(turn_rad=side * turn, reach=0.6) for turn in (0.7, 1.4) for side in (1, -1)
)
"""Tried if still nothing was proven, or a vehicle at rest would make a long detour."""
_ALL_ROUND = tuple(_SearchVariant(turn_rad=turn) for turn in (2.2, -2.2, math.pi))
_ASIDE = (*_SHORT, *_ANY_WAY, *_ALL_ROUND)


def plan(request: PlanRequest, stop: Callable[[], bool] = lambda: False) -> PlanOutcome:
    """Search for the next subpath until one is proven safe.

    Or the way back, if that is asked for.
    stop: asked every few hundred evaluations; in real time it tells that time is up, and then the
    best so far is taken, if it can be proven.
    """
    if request.flown is not None:
        prove = kernels.compiled().prove
        return backtrack(request.flown, request.task, request.known, prove, request.plan_id)
    refusal = _impossible(request)
    if refusal is not None:
        return NotPlanned(plan_id=request.plan_id, refusal=refusal)
    found = start_violation(request)
    if found is not None:
        return _escape(request, found)
    refusal = _unreachable(request)
    if refusal is not None:
        return NotPlanned(plan_id=request.plan_id, refusal=refusal)
    patience = _TimeBudget(stop)
    outcome = _Plan(request, patience).outcome()
    return replace(outcome, stopped_after=patience.stopped_after)


def candidates_nea_m(request: PlanRequest, most: int) -> FloatArray:
    """Control points of the best candidates of a plan's first search, best first, to look at them.

    -> (M, points, 3); empty where nothing is searched.
    """
    outward, verified = request.flown is None, request.task.settings.profile.verified
    if not (outward and verified) or _impossible(request) or start_violation(request):
        return np.empty((0, 4, 3))
    search = _Plan(request, _TimeBudget(lambda: False))
    return search.ranked_nea_m(most)


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
    inset_m = task.margins.band_inset_m
    low, high = limits.floor_amsl_m + inset_m, limits.ceiling_amsl_m - inset_m
    if not inside or not low <= altitude <= high:
        return Refusal.START_OUTSIDE
    if not sees_anything(request.known, request.scan_nea_m[:2], task.settings.scan_range_m):
        return Refusal.NOTHING_SEEN
    return None


def _unreachable(request: PlanRequest) -> Refusal | None:
    """Why the target is invalid; None if it is not."""
    task, limits = request.task, request.task.limits
    target = np.array(request.target_ne_m)
    edges = zip(target, (limits.north_m, limits.east_m), strict=True)
    if min(min(at - low, high - at) for at, (low, high) in edges) < task.zone_search_clearance_m:
        return Refusal.TARGET_AT_EDGE
    for zone in task.zones:
        if float(zone.distance_m(target[0], target[1])) < task.zone_search_clearance_m:
            return Refusal.TARGET_IN_KEEP_OUT
    highest = np.array([*request.target_ne_m, task.band_amsl_m[1]])
    required_m = task.required_clearance_m
    if distance_to_terrain_m(request.around, highest, required_m, seen_only=True) < required_m:
        return Refusal.TARGET_IN_TERRAIN
    return None


def _is_sane(request: PlanRequest) -> bool:
    """Whether all numbers are finite, and the limits leave room to plan."""
    limits, task, start = request.task.limits, request.task, request.start
    numbers = (
        *request.scan_nea_m,
        *request.target_ne_m,
        *start.position_nea_m,
        *start.tangent_nea,
        *start.curvature_nea_1_m,
    )
    low, high = task.band_amsl_m
    positive = (
        high - low,
        limits.climb_angle_rad,
        limits.dive_angle_rad,
        limits.speed_m_s,
        limits.acceleration_m_s2,
        limits.turn_radius_m,
        task.settings.safety_distance_m,
        task.settings.scan_range_m,
    )
    return bool(np.isfinite(numbers).all() and np.isfinite(positive).all() and min(positive) > 0.0)


def _escape(request: PlanRequest, found: StartViolation) -> PlanOutcome:
    """The shortest escape path from a place where no certificate can begin."""
    prove = kernels.compiled().prove
    escape = escape_path(request, found, prove) if request.from_rest else None
    if escape is None:
        refusal = Refusal.START_IN_KEEP_OUT if found.zones else Refusal.START_NEAR_TERRAIN
        if not found.zones and request.task.settings.is_near:
            refusal = Refusal.START_NEAR_THINGS
        elif not found.zones and found.unknown:
            refusal = Refusal.START_NEAR_UNKNOWN
        return NotPlanned(plan_id=request.plan_id, refusal=refusal)
    subpath, certificate = escape
    tangent = subpath.pose(0.0).tangent_nea
    return Planned(
        plan_id=request.plan_id,
        kernel=kernels.signature(),
        subpath=subpath,
        reaches_target=False,
        cost=0.0,
        to_go=0.0,
        terms={},
        certificate=certificate,
        guide_rad=math.atan2(tangent[1], tangent[0]),
        route_ne_m=request.route_ne_m,
        evaluations=0,
        rank=0,
        tries=0,
    )


@final
class _Plan:
    """One plan in progress: the common data of its searches."""

    def __init__(self, request: PlanRequest, stop: Callable[[], bool]) -> None:
        self._request, self._stop, self._kernel = request, stop, kernels.compiled()
        self._surroundings = _surroundings(request)
        self._field = cost_to_go(
            request.around,
            request.task,
            request.scan_nea_m[:2],
            request.target_ne_m,
            request.route_ne_m,
        )
        self._scene = _scene(request, self._field)
        motion = request.task.envelope
        self._shortest_m = max(slowing_m(motion, motion.speed_m_s), motion.lead_m)
        settings = request.task.settings
        self._per_metre = settings.weights.length * 100.0 / (2.4 * settings.scan_range_m)
        self._evaluations = self._tries = 0
        self._is_cut = False
        """Whether time was up in the middle of the newest search."""
        self._is_short = False
        """Whether time was up before all searches were made."""
        self._made = self._untried = 0
        self._broken: tuple[str, ...] = ()

    def outcome(self) -> Planned | NotPlanned:
        """The best subpath that is proven, or why there is none."""
        request = self._request
        closed = None
        if not request.task.settings.is_near:  # where a near thing stands is told too widely
            here_ne_m, target_ne_m = request.start.point_nea_m[:2], request.target_ne_m
            closed = blocked_at(request.known, request.task, self._field, here_ne_m, target_ne_m)
        if closed is not None:
            return NotPlanned(plan_id=request.plan_id, refusal=Refusal.NO_WAY, place_ne_m=closed)
        best = self._searched()
        if best is None:
            return self._refused(Refusal.OUT_OF_TIME if self._is_short else Refusal.NOTHING_SAFE)
        if self._is_better_to_stop(best):
            return self._refused(Refusal.BETTER_TO_STOP)
        return replace(best, evaluations=self._evaluations, tries=self._tries)

    def ranked_nea_m(self, most: int) -> FloatArray:
        """Control points of the best candidates of the first search.  -> (M, points, 3)."""
        self._tries += 1
        return control_points(self._search(self._scene)[:most], self._scene)

    def _is_better_to_stop(self, best: Planned) -> bool:
        """Whether it costs less to stop at the end of the current leg and continue from there.

        That plan uses the same map and end circle; in all directions, if continuing costs much more
        than predicted.
        """
        rest, task = self._request.rest, self._request.task
        if rest is None:
            return False
        stop = (rest.length_m + task.stop_m) * self._per_metre
        if self._price(best) <= stop + self._promised_m(rest.end_nea_m) * self._per_metre:
            return False
        start = hover_pose(rest.end_nea_m).facing(self._scene.guide_rad)
        scene = replace(self._scene, start=start, from_rest=True)
        ways: tuple[_SearchVariant, ...] = (_FIRST,)
        if self._excess(best) > _MUCH_DEARER:
            ways += _ANY_WAY + _ALL_ROUND
        leaving = (None if self._stop() else self._attempt(how, scene) for how in ways)
        return any(each and self._price(each) + stop < self._price(best) for each in leaving)

    def _to_edge_of_sight(self) -> tuple[_SearchVariant, ...]:
        """Variants that end where the cheapest route leaves the provable area, within scan range.

        Beyond L; a vehicle at rest may also fly less, and stop again.
        """
        scene, scan = self._scene, np.array(self._request.scan_nea_m[:2])
        route, cell_m = np.array(self._field.route_ne_m), self._request.known.cell_m
        points = sampled(route, cell_m, 2.0 * scene.end_radius_m)
        lowest = scene.surface.altitude_m(points[:, 0], points[:, 1])
        barred = np.flatnonzero(lowest > scene.band_amsl_m[1])
        away = np.hypot(*(points[: barred[0] if len(barred) else None] - scan).T)
        far_m = float(away.max(initial=0.0))
        motion, least_m = self._request.task.envelope, self._request.task.scan_distance_m
        if scene.from_rest:
            least_m = max(stopping_m(motion, motion.speed_m_s), motion.lead_m)
        elif self._request.task.settings.is_near:  # its sight ends at the next tree
            least_m = self._shortest_m
        if not least_m < far_m < scene.end_radius_m:
            return ()
        return (_SearchVariant(reach=far_m / scene.end_radius_m),)

    def _refused(self, refusal: Refusal) -> NotPlanned:
        return NotPlanned(
            plan_id=self._request.plan_id,
            refusal=refusal,
            broken=() if refusal is Refusal.BETTER_TO_STOP else self._broken,
            evaluations=self._evaluations,
            tries=self._made,
            untried=self._untried,
        )

    def _searched(self) -> Planned | None:
        """The cheapest subpath of all searches, until one is cheap enough or time is up.

        Short and turned ones come early among near things, and count if no other is cheap enough.
        """
        ways, before = self._ways(), self._request.tried
        best: Planned | None = None
        aside: Planned | None = None
        for number in range(before, before + len(ways)):
            how, enough = ways[number % len(ways)]
            if how is _ANY_WAY[0] and best is not None and not self._request.from_rest:
                break
            is_aside = how in _ASIDE and self._is_near_at_rest
            so_far = self._cheaper(best, aside) if is_aside else best
            if how is not None and (so_far is None or self._excess(so_far) > enough):
                if self._tries and self._stop():
                    break
                planned = self._attempt(how, wider=1 + number // len(ways))
                if is_aside:
                    aside = self._cheaper(aside, planned)
                else:
                    best = self._cheaper(best, planned)
                if self._is_cut and self._made:
                    break  # it is made again; the only one is not, or no attempt got past it
            self._made += 1
        self._is_short = self._made < len(ways)
        self._untried = max(len(ways) - before - self._made, 0)
        if best is not None and self._excess(best) <= _MUCH_DEARER:
            return best
        return self._cheaper(best, aside)

    def _cheaper(self, one: Planned | None, other: Planned | None) -> Planned | None:
        """Of two subpaths, the first one if they cost the same."""
        if one is None or other is None:
            return one or other
        return other if self._price(other) < self._price(one) else one

    @property
    def _is_near_at_rest(self) -> bool:
        """Whether the vehicle stands among near things."""
        return self._request.from_rest and self._request.task.settings.is_near

    def _ways(self) -> list[tuple[_SearchVariant | None, float]]:
        """All searches in their order, and up to which excess of the best each is left out.

        In costs of R, over the prediction.  Among near things a vehicle at rest tries short and
        turned ones before the others: where sight is short, they are what is left.
        """
        edge = self._to_edge_of_sight() or (None,)
        ways = [(how, _DEARER) for how in (_FIRST, *edge)]
        others = [(how, _DEARER) for how in _OTHER_WAYS] + [(how, _MUCH_DEARER) for how in _HARDER]
        near = self._is_near_at_rest
        turned = [(how, _MUCH_DEARER) for how in ((*_SHORT, *_ANY_WAY) if near else _ANY_WAY)]
        ways += turned + others if near else others + turned
        all_round = _ALL_ROUND if self._request.from_rest else ()
        return ways + [(how, _MUCH_DEARER) for how in all_round]

    def _price(self, planned: Planned) -> float:
        """The cost by which candidates of different searches are compared."""
        task, total = self._request.task, self._cost(planned)
        if planned.reaches_target:
            return total
        scan, end = self._request.scan_nea_m, planned.subpath.control_nea_m[-1]
        short_m = self._scene.end_radius_m - math.hypot(end[0] - scan[0], end[1] - scan[1])
        stop_m = 0.0 if Leg.of(planned, number=1).can_be_left(task) else task.stop_m
        return total + (stop_m + _ENDS_SHORT * short_m) * self._per_metre

    def _excess(self, planned: Planned) -> float:
        """Excess cost of a subpath and what follows over the prediction, in costs of R."""
        range_m = self._request.task.settings.scan_range_m
        cost_of_r = self._per_metre * range_m
        promised_m = self._promised_m(self._request.start.point_nea_m)
        return self._cost(planned) / max(cost_of_r, 1e-9) - promised_m / range_m

    def _cost(self, planned: Planned) -> float:
        """Cost of a subpath and of what follows; the mean of the radar term stands for R."""
        total, settings = planned.cost + planned.to_go, self._request.task.settings
        if planned.reaches_target:
            share = planned.subpath.length_m / settings.scan_range_m
            total -= (1.0 - min(share, 1.0)) * settings.weights.radar * planned.terms["radar"]
        return total

    def _promised_m(self, place_nea_m: tuple[float, float, float]) -> float:
        """The predicted minimum cost from a place to the target, in metres of level flight."""
        north, east, altitude = place_nea_m
        here, task = (np.array(north), np.array(east)), self._request.task
        level_m = float(self._field.at_m(*here))
        needed_m = float(self._field.needed.altitude_m(*here))
        down_m = max(descent_m(altitude, task) - descent_m(needed_m, task), 0.0)
        climb_m = max(needed_m - altitude, 0.0) / math.tan(task.limits.climb_angle_rad)
        return level_m + down_m + climb_m

    def _attempt(
        self, how: _SearchVariant, scene: FlightScene | None = None, *, wider: int = 1
    ) -> Planned | None:
        """One search, and the best of its candidates that has a certificate."""
        self._tries += 1
        scene = _vary(scene or self._scene, how)
        return self._first_proven(self._search(scene, wider), scene)

    def _search(self, scene: FlightScene, wider: int = 1) -> FloatArray:
        """The candidates of one search, best first.  -> (M, D).

        wider: how often the mission's number of evaluations.
        """
        request, settings = self._request, self._request.task.settings
        rng = request.rng(self._tries)
        evaluations, self._is_cut = wider * settings.evaluations, False
        name, seeds = settings.optimiser or settings.profile.optimiser, _seeds(scene)
        if name != "refined-de":
            optimiser = OPTIMISERS[name](scene.variables, evaluations, rng, seeds)
            ranked = minimise(
                optimiser, lambda x: self._kernel.costs(x, scene), evaluations, self._stop
            )
            self._evaluations += ranked.evaluations
            self._is_cut = ranked.evaluations < evaluations
            return ranked.x
        state = refined_de.begin(scene.variables, evaluations, seeds, _SEARCH, rng)
        for until in range(_CHUNK, evaluations + _CHUNK, _CHUNK):
            self._kernel.search(state, scene, min(until, evaluations))
            if self._stop():
                self._is_cut = until < evaluations
                break
        self._evaluations += refined_de.spent(state)
        return refined_de.ranked(state)[0]

    def _first_proven(self, candidates: FloatArray, scene: FlightScene) -> Planned | None:
        """The best candidate with a certificate."""
        request = self._request
        for rank, x in enumerate(candidates[:_CERTIFIED]):
            subpath = Subpath(control_nea_m=control_points(x[None], scene)[0])
            if not scene.from_rest and subpath.length_m < self._shortest_m:
                continue  # the certificate is about a vehicle that can stop (or hold) at the end
            certificate = certify(
                subpath,
                self._surroundings,
                from_rest=scene.from_rest,
                prover=self._kernel.prove,
            )
            if certificate.proven:
                table = self._table(x, scene)
                costs = {name: weight(name, scene) * value for name, value in table.items()}
                return Planned(
                    plan_id=request.plan_id,
                    kernel=kernels.signature(),
                    subpath=subpath,
                    reaches_target=scene.final_ne_m is not None,
                    cost=sum(costs.values()) - costs["to_go"],
                    to_go=costs["to_go"],
                    terms=table,
                    certificate=certificate,
                    guide_rad=scene.guide_rad,
                    route_ne_m=self._field.route_ne_m,
                    evaluations=self._evaluations,
                    rank=rank,
                    tries=self._tries,
                )
            self._broken = self._broken or certificate.broken
        return None

    def _table(self, x: FloatArray, scene: FlightScene) -> dict[str, float]:
        """The cost terms of a candidate of any search, by the guidance of this plan."""
        guided = replace(
            scene,
            to_go=self._scene.to_go,
            needed=self._scene.needed,
            guide_rad=self._scene.guide_rad,
            guide_share=self._scene.guide_share,
        )
        return self._kernel.terms(x, guided)


def _seeds(scene: FlightScene) -> FloatArray:
    """Plausible subpaths to begin with: towards the guide, straight on, and bent aside.  (K, D)."""
    aim = wrap_rad(scene.guide_rad - scene.ahead_rad)
    low, high = scene.band_amsl_m
    level = (float(scene.start.position_nea_m[2]) - low) / (high - low)
    rows = []
    for altitude in (level, 0.0, 0.5):
        for bearing, bend in ((aim, 0.0), (aim, 0.3), (aim, -0.3), (0.0, 0.0), (0.6 * aim, 0.0)):
            row = [0.3, 0.3]
            for k in range(3, scene.points - 1):
                share = (k - 1) / (scene.points - 1)
                row += [share, _azimuth(share * bearing + bend), altitude]
            rows.append([*row, _azimuth(bearing), altitude])
    return np.clip(np.array(rows), 0.0, 1.0)


def _azimuth(bearing_rad: float) -> float:
    """The search variable of a bearing from the tangent."""
    return 0.5 + 0.5 * bearing_rad / SPREAD_RAD


def _scene(request: PlanRequest, field: CostToGo) -> FlightScene:
    task, settings = request.task, request.task.settings
    scan_ne = request.scan_nea_m[:2]
    final, end_radius = _end(request)
    surface = _surface(request, task.search_clearance_m)
    guide = field.leaving_rad(scan_ne, end_radius)
    return FlightScene(
        points=5,
        samples=settings.profile.samples,
        margin=settings.profile.margin,
        weights=settings.weights,
        limits=task.limits,
        motion=task.envelope,
        start=request.start.facing(guide) if request.from_rest else request.start,
        from_rest=request.from_rest,
        scan_ne_m=scan_ne,
        scan_range_m=settings.scan_range_m,
        end_radius_m=end_radius,
        guide_rad=guide,
        guide_share=_GUIDE_SHARE,
        to_go=field.value,
        needed=field.needed,
        look_ahead_m=task.limits.turn_radius_m,
        descent_m=descent_m(task.limits.ceiling_amsl_m, task),
        final_ne_m=request.target_ne_m if final else None,
        safety_distance_m=settings.safety_distance_m,
        clearance_m=task.zone_search_clearance_m,
        surface=surface,
        contact=_surface(request, task.error_m) if task.limits.hovers else surface,
        radar_margin_m=_RADAR_MARGIN * settings.scan_range_m,
        band_amsl_m=task.band_amsl_m,
        radars=task.radars_near(scan_ne, _IN_REACH * settings.scan_range_m),
        zones=task.zones,
        near_polygons=_near_polygons(task),
    )


def _near_polygons(task: Task) -> NearCells | None:
    polygons = tuple(zone for zone in task.zones if isinstance(zone, PolygonZone))
    if not polygons:
        return None
    limits = task.limits
    clearance_m, gaps = task.zone_search_clearance_m, kernels.compiled().zone_gaps
    return near_cells(polygons, limits.north_m, limits.east_m, clearance_m, gaps)


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
    return False, min(reach, max(left - 0.35 * reach, 0.5 * reach))


def _vary(scene: FlightScene, how: _SearchVariant) -> FlightScene:
    """The scene of a search variant; variants with a turned guide do not end at the target.

    A turned guide acts alone: the cost-to-go would lead back to where nothing was found.
    """
    scene = replace(scene, points=how.points)
    if how.turn_rad == 0.0 and how.reach == 1.0:
        return scene
    guide = wrap_rad(scene.guide_rad + how.turn_rad)
    anywhere = replace(scene.to_go, vertex_m=np.zeros_like(scene.to_go.vertex_m))
    to_go, needed = (anywhere, anywhere) if how.turn_rad else (scene.to_go, scene.needed)
    return replace(
        scene,
        guide_rad=guide,
        guide_share=1.0,
        to_go=to_go,
        needed=needed,
        end_radius_m=scene.end_radius_m * how.reach,
        final_ne_m=None,
        start=scene.start.facing(guide) if scene.from_rest else scene.start,
    )


def _surface(request: PlanRequest, clearance_m: float) -> Surface:
    return safe_surface(
        request.around,
        kernels.compiled().dilated_m,
        centre_ne_m=request.scan_nea_m[:2],
        reach_m=REACH * request.task.settings.scan_range_m,
        clearance_m=clearance_m,
        unknown_m=request.task.limits.ceiling_amsl_m,
        floor_m=request.task.limits.floor_amsl_m,
    )


def _surroundings(request: PlanRequest) -> Surroundings:
    task = request.task
    return pack_surroundings(
        request.known,
        task.limits,
        task.radars_near(request.scan_nea_m[:2], _IN_REACH * task.settings.scan_range_m),
        task.zones,
        task.margins,
        centre_ne_m=request.scan_nea_m[:2],
        reach_m=REACH * task.settings.scan_range_m,
    )
