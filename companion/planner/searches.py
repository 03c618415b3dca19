"""The searches of one plan: each for the cheapest subpath of a kind that can be proven.

A subpath is drawn, and what it costs is told, by `companion.objective`; here is what it is told of
the map and the task, and in what order the kinds are searched.
"""

import math
from collections.abc import Callable
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
from companion.path.subpath import Pose, Subpath
from companion.planner import kernels
from companion.planner.cost_grid import descent_m
from companion.planner.field import CostToGo
from companion.planner.price import Prices
from companion.planner.request import REACH, Planned, PlanRequest
from companion.planner.seeds import seeds_of, ways_of
from companion.world.columns import Surface, safe_surface
from companion.world.zones import PolygonZone, near_cells, packed

_POINTS = (5, 6)  # control points: six where five find nothing good
_CHUNK = 300  # evaluations between two looks at the clock
_CERTIFIED = 16  # candidates of a search that are tried
_RADAR_MARGIN = 1.0 / 800.0  # of R, for what lies between samples
_DEARER = 0.05  # of the cost of R: what a first answer may cost more than was promised
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

    def guided_by(self, prices: Prices) -> None:
        """From now on, by this guidance."""
        self._prices, self.scene = prices, scene_of(self._request, prices.field)
        self.broken = ()

    def _stop(self) -> bool:
        """Whether time is up: once it is, it stays so."""
        if self.stopped_after is None:
            if not self._asked():
                self._went_on += 1
                return False
            self.stopped_after = self._went_on
        return True

    @property
    def speeds_m_s(self) -> tuple[float, ...]:
        """The speeds at which a subpath may be flown, the fastest first.

        A copter turns the tighter the slower it is, and stops within less.  In flight it is no
        slower than it comes.
        """
        limits, rest = self._request.task.limits, self._request.rest
        fastest, comes_m_s = limits.speed_m_s, None if rest is None else rest.speed_m_s
        least = fastest if comes_m_s is None else min(comes_m_s, fastest)
        least = 0.0 if self._request.from_rest else least
        speeds = (share * fastest for share in (_SLOWER if limits.hovers else (1.0,)))
        return tuple(speed for speed in speeds if speed >= least)

    def at_speed(self, speed_m_s: float) -> Planned | None:
        """The cheapest subpath, until one costs hardly more than was hoped or time is up.

        Where none is proven, what breaks a bound counts more, so that it is not traded for way.
        """
        motion = self._request.task.at_speed(speed_m_s).envelope
        scene = self.scene._replace(motion=motion)
        if not scene.from_rest:
            shortest_m = max(slowing_m(motion, motion.speed_m_s), motion.lead_m)
            scene = scene._replace(shortest_m=float(shortest_m))
        kinds = [(scene, _DEARER), (_strict(scene), math.inf)]
        best: Planned | None = None
        for kind, enough in kinds:
            for points in _POINTS:
                range_m = scene.scan_range_m
                if best is not None and self._prices.excess_m(best) <= enough * range_m:
                    return best
                if self.tries and self._stop():
                    self.is_cut = True
                    return best
                best = self._prices.cheaper(best, self.found(kind.with_points(points)))
        return best

    def leaving(self, start: Pose) -> Planned | None:
        """The cheapest subpath that leaves from rest, at V, by one search if there is time."""
        if self._stop():
            return None
        return self.found(self.scene._replace(start=rows_of(start), from_rest=True))

    def straight(self, subpath: Subpath) -> Planned | None:
        """A straight piece from rest, at the highest speed for which it is proven."""
        for speed_m_s in self.speeds_m_s:
            certificate = self.certified(subpath, speed_m_s, from_rest=True)
            if certificate.proven:
                route = self._prices.field.route_ne_m
                return straight_plan(self._request, subpath, certificate, route)
        return None

    def certified(self, subpath: Subpath, speed_m_s: float, *, from_rest: bool) -> Certificate:
        """What is proven of a subpath that is flown no faster than this."""
        if (here := self._surroundings.get(speed_m_s)) is None:
            here = self._surroundings[speed_m_s] = surroundings_of(self._request, speed_m_s)
        return certify(subpath, here, from_rest=from_rest)

    def found(self, scene: Scene) -> Planned | None:
        """Of one search, the best of its candidates that has a certificate."""
        request, speed_m_s = self._request, scene.motion.speed_m_s
        for rank, x in enumerate(self._ranked(scene)[:_CERTIFIED]):
            subpath = Subpath(control_nea_m=scene.control_points(x))
            if not subpath.is_longer_than(scene.shortest_m):
                continue  # the certificate is about a vehicle that can stop (or hold) at the end
            certificate = self.certified(subpath, speed_m_s, from_rest=scene.from_rest)
            if certificate.proven:
                jit.compiled(kernels.costs)(x[None], scene)
                terms = dict(zip(TERMS, scene.at.terms.tolist(), strict=True))
                weights = zip(TERMS, self.scene.weights, strict=True)
                costs = {name: a * terms[name] for name, a in weights}
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
                    route_ne_m=self._prices.field.route_ne_m,
                    rank=rank,
                    speed_m_s=_told_m_s(request, speed_m_s),
                )
            self.broken = self.broken or certificate.broken
        return None

    def _ranked(self, scene: Scene) -> FloatArray:
        """The candidates of one search, best first.  -> (M, D)."""
        request, settings = self._request, self._request.task.settings
        self.tries += 1
        rng = request.rng(self.tries)
        evaluations = (1 + request.attempt) * settings.evaluations
        name = settings.optimiser or settings.profile.optimiser
        tail = None if request.rest is None else request.rest.end_nea_m
        route_ne_m = self._prices.field.route_ne_m
        seeds = seeds_of(scene, ways_of(scene, route_ne_m, request.known.cell_m, tail))
        if name != "refined-de":
            optimiser = OPTIMISERS[name](scene.variables, evaluations, rng, seeds)
            costs = jit.compiled(kernels.costs)
            ranked = minimise(optimiser, lambda x: costs(x, scene), evaluations, self._stop)
            self.evaluations += ranked.evaluations
            self.is_cut |= ranked.evaluations < evaluations
            return ranked.x
        state = refined_de.begin(scene.variables, evaluations, seeds, refined_de.Settings(), rng)
        for until in range(_CHUNK, evaluations + _CHUNK, _CHUNK):
            jit.compiled(kernels.search)(state, scene, min(until, evaluations))
            if self._stop():
                self.is_cut |= until < evaluations
                break
        self.evaluations += refined_de.spent(state)
        return refined_de.ranked(state)[0]


def straight_plan(
    request: PlanRequest,
    subpath: Subpath,
    certificate: Certificate,
    route_ne_m: tuple[tuple[float, float], ...] = (),
) -> Planned:
    """A plan that no search has made: it has no cost."""
    tangent, end = subpath.pose(0.0).tangent_nea, subpath.control_nea_m[-1]
    return Planned(
        plan_id=request.plan_id,
        kernel=kernels.signature(),
        subpath=subpath,
        reaches_target=math.dist(end[:2], request.target_ne_m) < _AT_TARGET_M,
        certificate=certificate,
        guide_rad=math.atan2(tangent[1], tangent[0]),
        route_ne_m=route_ne_m,
        speed_m_s=_told_m_s(request, certificate.speed_m_s),
    )


def _told_m_s(request: PlanRequest, speed_m_s: float) -> float | None:
    """The speed of a plan; None if it is V."""
    return None if speed_m_s >= request.task.limits.speed_m_s else speed_m_s


# --- what subpaths are planned in


def scene_of(request: PlanRequest, field: CostToGo) -> Scene:
    """What the costs of subpaths at V depend on, of five control points."""
    task, limits, settings = request.task, request.task.limits, request.task.settings
    scan_ne, range_m = request.scan_nea_m[:2], settings.scan_range_m
    is_final, end_radius = _end(request)
    zones, clearance_m = packed(task.zones), task.zone_search_clearance_m
    polygons = tuple(zone for zone in task.zones if isinstance(zone, PolygonZone))
    radars = task.radars_near(scan_ne, _IN_REACH * range_m)
    surface = _surface(request, task.search_clearance_m)
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
        contact=_surface(request, task.envelope.contact_m) if limits.hovers else surface,
        band_amsl_m=task.band_amsl_m,
        north_m=limits.north_m,
        east_m=limits.east_m,
        radars=radar_table(radars, _RADAR_MARGIN * range_m),
        zones=zones,
        near_polygons=near_cells(polygons, limits.north_m, limits.east_m, clearance_m),
        at=Workspace.of(_POINTS[0], settings.profile.samples, len(polygons)),
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


def _strict(scene: Scene) -> Scene:
    """The scene in which what breaks a bound counts more, so that it is not traded for way."""
    times = (_STRICTER if name in ("crash", "constraints") else 1.0 for name in TERMS)
    return scene._replace(weights=tuple(a * b for a, b in zip(scene.weights, times, strict=True)))


def _surface(request: PlanRequest, clearance_m: float) -> Surface:
    """The lowest altitudes that keep a clearance."""
    return safe_surface(
        request.around,
        centre_ne_m=request.scan_nea_m[:2],
        reach_m=REACH * request.task.settings.scan_range_m,
        clearance_m=clearance_m,
        unknown_m=request.task.limits.ceiling_amsl_m,
        floor_m=request.task.limits.floor_amsl_m,
    )


def surroundings_of(request: PlanRequest, speed_m_s: float) -> Surroundings:
    """What subpaths that are flown no faster than this are proven against."""
    task, scan_ne_m = request.task.at_speed(speed_m_s), request.scan_nea_m[:2]
    range_m = task.settings.scan_range_m
    radars = task.radars_near(scan_ne_m, _IN_REACH * range_m)
    return task.surroundings(request.known, scan_ne_m, REACH * range_m, radars=radars)
