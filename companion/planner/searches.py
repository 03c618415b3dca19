"""The searches of one plan: each for the cheapest subpath of a kind that can be proven.

A subpath is drawn, and what it costs is told, by `companion.objective`; here is what it is told of
the map and the task, and in what order the kinds are searched.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import final

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
from companion.planner import kernels
from companion.planner.cost_grid import descent_m
from companion.planner.field import CostToGo
from companion.planner.price import Prices
from companion.planner.procedure import hover_pose
from companion.planner.request import REACH, Planned, PlanRequest, Rest
from companion.planner.seeds import seeds_of, ways_of
from companion.world.columns import Surface, safe_surface
from companion.world.zones import PolygonZone, near_cells, packed

_POINTS = (5, 6)  # control points: six where five find nothing good
_CHUNK = 300  # evaluations between two looks at the clock
_CERTIFIED = 16  # candidates of a search that are tried
_RADAR_MARGIN = 1.0 / 800.0  # of R, for what lies between samples
_DEARER = 0.05  # of the cost of R: what a first answer may cost more than was promised
_MUCH_DEARER = 0.5  # likewise: then it is planned more slowly, too
_CLEARLY = 0.9  # of a speed: a lower one makes a difference
_SLOWER = (1.0, 0.5, 0.25)  # of V: turns of a quarter of the radius, and of a sixteenth
_ROOM = 0.35  # of the circle's radius: from ends to a target that is not the end
_STRICTER = 100.0  # times, when nothing was proven
_IN_REACH = 1.5  # of R: threats farther away concern no subpath
_AT_TARGET_M = 1e-6  # arithmetic: an end at the target is copied from it


@final
class Searches:
    """What they have found and spent, one after the other."""

    def __init__(self, request: PlanRequest, stop: Callable[[], bool]) -> None:
        self._request, self._asked, self._went_on = request, stop, 0
        self.stopped_after: int | None = None
        """How often time was not up before it was; None: it never was."""
        self._surroundings: dict[float, Surroundings] = {}
        self.evaluations = self.tries = 0
        self.is_cut = False  # whether time was up before all was searched
        self.broken: tuple[str, ...] = ()
        """The bounds that the first candidate broke that could not be proven."""

    def best(self, prices: Prices) -> Planned | None:
        """The best of all speeds; slower ones count where nothing, or only a long way, is found.

        prices: by these from now on.
        """
        self.prices, self._scene, self.broken = prices, _scene_of(self._request, prices.field), ()
        best: Planned | None = None
        enough_m = math.inf  # from rest among near things a slow leg may beat a long way round
        if self._request.task.settings.is_near and self._request.from_rest:
            enough_m = _MUCH_DEARER * self._scene.scan_range_m
        for speed_m_s in self._speeds_m_s:
            if best is None or self.prices.excess_m(best) > enough_m:
                best = self.prices.cheaper(best, self._at_speed(speed_m_s))
        return best

    @property
    def _speeds_m_s(self) -> list[float]:
        """The speeds at which a subpath may be flown, the fastest first.

        A copter turns the tighter the slower it is, and stops within less.  In flight it is no
        slower than it comes, and as slow if that is clearly slower than these.
        """
        limits, rest = self._request.task.limits, self._request.rest
        speeds = [share * limits.speed_m_s for share in (_SLOWER if limits.hovers else (1.0,))]
        if self._request.from_rest:
            return speeds
        comes_m_s = math.inf if rest is None or rest.speed_m_s is None else rest.speed_m_s
        speeds = [speed for speed in speeds if speed >= min(comes_m_s, limits.speed_m_s)]
        if _SLOWER[-1] * limits.speed_m_s < comes_m_s < _CLEARLY * speeds[-1]:
            speeds.append(comes_m_s)
        return speeds

    def _at_speed(self, speed_m_s: float) -> Planned | None:
        """The cheapest subpath, until one costs hardly more than was hoped or time is up.

        Where none is proven, what breaks a bound counts more, so that it is not traded for way.
        """
        task = self._request.task.at_speed(speed_m_s)
        motion = task.envelope
        scene = self._scene._replace(motion=motion)
        if not scene.from_rest:
            shortest_m = max(slowing_m(motion, motion.speed_m_s), motion.lead_m)
            scene = scene._replace(shortest_m=float(shortest_m))
        best: Planned | None = None
        is_near, hardly_m = task.settings.is_near, _DEARER * scene.scan_range_m
        kinds = [(scene, points, hardly_m) for points in _POINTS]
        if scene.from_rest or not is_near:  # else it is asked again in a moment
            kinds += [(_strict(scene), points, math.inf) for points in _POINTS]
        if is_near and not scene.is_final:  # a shorter leg soon has to be slow
            long = scene._replace(shortest_m=task.shortest_scan_distance_m)
            kinds.insert(0, (long, _POINTS[0], hardly_m))
        for kind, points, enough in kinds:
            if best is not None and self.prices.excess_m(best) <= enough:
                return best
            if self.tries and self._is_time_up():
                self.is_cut = True
                return best
            best = self.prices.cheaper(best, self._best_proven(kind.with_points(points)))
        return best

    def stops_for_less(self, best: Planned, rest: Rest) -> bool:
        """Whether it costs less to stop at the end of the current leg and go on from there.

        By the same map and end circle, in any direction, at V: one search, if there is time.
        """
        prices, price_m = self.prices, self.prices.price_m(best)
        stop_m = rest.length_m + prices.task.stop_m
        if price_m <= stop_m + prices.promised_m(rest.end_nea_m) or self._is_time_up():
            return False
        start = rows_of(hover_pose(rest.end_nea_m))
        leaving = self._best_proven(self._scene._replace(start=start, from_rest=True))
        return leaving is not None and prices.price_m(leaving) + stop_m < price_m

    def straight(self, subpath: Subpath) -> Planned | None:
        """A straight piece from rest, at the highest speed for which it is proven."""
        for speed_m_s in self._speeds_m_s:
            certificate = self._certified(subpath, speed_m_s, from_rest=True)
            if certificate.proven:
                route = self.prices.field.route_ne_m
                return plan_of(self._request, subpath, certificate, route)
        return None

    def _certified(self, subpath: Subpath, speed_m_s: float, *, from_rest: bool) -> Certificate:
        """What is proven of a subpath that is flown no faster than this."""
        request, task = self._request, self._request.task.at_speed(speed_m_s)
        around = self._surroundings.get(speed_m_s)
        if around is None:
            reach_m = REACH * task.settings.scan_range_m
            around = task.surroundings(request.known, request.scan_nea_m[:2], reach_m)
            self._surroundings[speed_m_s] = around
        return certify(subpath, around, from_rest=from_rest)

    def _best_proven(self, scene: Scene) -> Planned | None:
        """Of one search, the best of its candidates that has a certificate."""
        for rank, x in enumerate(self._ranked(scene)[:_CERTIFIED]):
            subpath = Subpath(control_nea_m=scene.control_points(x))
            if not subpath.is_longer_than(scene.shortest_m):
                continue  # the certificate is about a vehicle that can stop (or hold) at the end
            speed_m_s = scene.motion.speed_m_s
            certificate = self._certified(subpath, speed_m_s, from_rest=scene.from_rest)
            if certificate.proven:
                jit.compiled(kernels.costs)(x[None], scene)
                terms = dict(zip(TERMS, scene.at.terms.tolist(), strict=True))
                weights = zip(TERMS, self._scene.weights, strict=True)
                costs = {name: a * terms[name] for name, a in weights}
                return replace(
                    plan_of(self._request, subpath, certificate, self.prices.field.route_ne_m),
                    cost=sum(costs.values()) - costs["to_go"],
                    to_go=costs["to_go"],
                    terms=terms,
                    guide_rad=scene.guide_rad,
                    rank=rank,
                )
            self.broken = self.broken or certificate.broken
        return None

    def _ranked(self, scene: Scene) -> FloatArray:
        """The candidates of one search, best first.  -> (M, D)."""
        request, settings = self._request, self._request.task.settings
        self.tries += 1
        rng = request.rng(self.tries)
        evaluations = (1 + request.attempt) * settings.evaluations
        optimiser = settings.optimiser or settings.profile.optimiser
        tail = None if request.rest is None else request.rest.end_nea_m
        route_ne_m = self.prices.field.route_ne_m
        seeds = seeds_of(scene, ways_of(scene, route_ne_m, request.known.cell_m, tail))
        if optimiser != "refined-de":
            make = OPTIMISERS[optimiser] if isinstance(optimiser, str) else optimiser
            costs = jit.compiled(kernels.costs)
            asked = make(scene.variables, evaluations, rng, seeds)
            ranked = minimise(asked, lambda x: costs(x, scene), evaluations, self._is_time_up)
            self.evaluations += ranked.evaluations
            self.is_cut |= ranked.evaluations < evaluations
            return ranked.x
        state = refined_de.begin(scene.variables, evaluations, seeds, refined_de.Settings(), rng)
        for until in range(_CHUNK, evaluations + _CHUNK, _CHUNK):
            jit.compiled(kernels.search)(state, scene, min(until, evaluations))
            if self._is_time_up():
                self.is_cut |= until < evaluations
                break
        self.evaluations += refined_de.spent(state)
        return refined_de.ranked(state)[0]

    def _is_time_up(self) -> bool:
        """Once it is, it stays so."""
        if self.stopped_after is None:
            if not self._asked():
                self._went_on += 1
                return False
            self.stopped_after = self._went_on
        return True


def plan_of(
    request: PlanRequest,
    subpath: Subpath,
    certificate: Certificate,
    route_ne_m: tuple[tuple[float, float], ...] = (),
) -> Planned:
    """The plan of a subpath, but for what a search knows of it; who was in debt still is."""
    tangent, end = subpath.pose(0.0).tangent_nea, subpath.control_nea_m[-1]
    speed_m_s = certificate.speed_m_s
    return Planned(
        plan_id=request.plan_id,
        kernel=kernels.signature(),
        subpath=subpath,
        reaches_target=math.dist(end[:2], request.target_ne_m) < _AT_TARGET_M,
        certificate=certificate,
        guide_rad=math.atan2(tangent[1], tangent[0]),
        route_ne_m=route_ne_m,
        progress=replace(request.progress, end_m=math.inf),
        speed_m_s=None if speed_m_s >= request.task.limits.speed_m_s else speed_m_s,
    )


# --- what subpaths are planned in


def _scene_of(request: PlanRequest, field: CostToGo) -> Scene:
    """What the costs of subpaths at V depend on, of five control points."""
    task, limits, settings = request.task, request.task.limits, request.task.settings
    scan_ne, range_m, end_radius = request.scan_nea_m[:2], settings.scan_range_m, task.end_radius_m
    left_m = math.dist(scan_ne, request.target_ne_m)
    is_final = left_m <= end_radius and request.known.is_known(*request.target_ne_m)
    if not is_final:  # if the target is just beyond, the last subpath needs room to turn
        end_radius = min(end_radius, max(left_m - _ROOM * end_radius, 0.5 * end_radius))
    zones, clearance_m = packed(task.zones), task.zone_search_clearance_m
    polygons = tuple(zone for zone in task.zones if isinstance(zone, PolygonZone))
    radars = task.radars_near(scan_ne, _IN_REACH * range_m)

    def lowest_that_keeps(kept_m: float) -> Surface:
        return safe_surface(
            request.around,
            centre_ne_m=scan_ne,
            reach_m=REACH * range_m,
            clearance_m=kept_m,
            unknown_m=limits.ceiling_amsl_m,
            floor_m=limits.floor_amsl_m,
        )

    surface = lowest_that_keeps(task.search_clearance_m)
    return Scene(
        weights=weights_of(settings.weights),
        motion=task.envelope,
        margin=settings.profile.margin,
        start=rows_of(request.start),
        from_rest=request.from_rest,
        shortest_m=0.0,
        scan_ne_m=scan_ne,
        scan_range_m=float(range_m),
        end_radius_m=float(end_radius),
        is_final=is_final,
        final_ne_m=request.target_ne_m,
        guide_rad=field.leaving_rad(scan_ne, end_radius),
        to_go=field.value,
        needed=field.needed,
        descent_m=float(descent_m(limits.ceiling_amsl_m, task)),
        safety_distance_m=float(settings.safety_distance_m),
        clearance_m=float(clearance_m),
        surface=surface,
        contact=lowest_that_keeps(task.envelope.contact_m) if limits.hovers else surface,
        band_amsl_m=task.band_amsl_m,
        north_m=limits.north_m,
        east_m=limits.east_m,
        radars=radar_table(radars, _RADAR_MARGIN * range_m),
        zones=zones,
        near_polygons=near_cells(polygons, limits.north_m, limits.east_m, clearance_m),
        at=Workspace.of(_POINTS[0], settings.profile.samples, len(polygons)),
    )


def _strict(scene: Scene) -> Scene:
    """The scene in which what breaks a bound counts more, so that it is not traded for way."""
    times = (_STRICTER if name in ("crash", "constraints") else 1.0 for name in TERMS)
    return scene._replace(weights=tuple(a * b for a, b in zip(scene.weights, times, strict=True)))
