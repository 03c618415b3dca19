"""Ways out for a vehicle at rest where a search cannot begin, or finds nothing; and where none is.

- `escape`: where it is too near to terrain or zones for any certificate to begin.
- `way_out`: a straight piece to begin with, where no search finds a leg.
- `blocked_at`: whether the known map proves that there is no way to the target.

For a plane all distances are those of its loiter circle.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from typing import Any, NamedTuple, final

import numpy as np
import scipy
from numpy.typing import NDArray

from companion import jit
from companion.geodesy import BoolArray, FloatArray
from companion.path.certificate import Certificate, certify
from companion.path.proof import Surroundings
from companion.path.subpath import straight
from companion.planner.cheapest_ways import IndexArray
from companion.planner.cost_grid import Place, sampled
from companion.planner.field import CostToGo
from companion.planner.price import Prices
from companion.planner.request import NotPlanned, Planned, PlanRequest, Refusal
from companion.planner.searches import Searches, plan_of
from companion.planner.settings import Task
from companion.world.columns import (
    dilated_m,
    distance_to_terrain_m,
    distances_to_terrain_m,
    safe_surface,
)
from companion.world.known_map import KnownMap
from companion.world.zones import Zone, gaps_m, packed, too_near

# --- where no certificate can begin

_BEARINGS = 72  # directions of ways, 5 degrees apart: a way out of a circle is 0.1 % too long
_NEAR, _LENGTHS, _LONGER = 0.4, 24, 12
"""Of R, within which all ground is usually seen; lengths of ways up to there, and lengths beyond,
up to where subpaths end: a zone may be as large."""
_STEEP = 0.95  # of the climb or dive angle; or level
_CERTIFIED = 200  # ways that are proven, the shortest first: 1 ms each
_DEEPER = 3.0  # metres of way that count as much as one metre deeper into a zone
_SLACK_M = 0.5  # so much nearer than the vehicle is a way may come: a proof needs a little to spare
_WORTH_M = 1.0  # a place that is less deep in a zone by less than this is no better
_TOUCHING_M = 0.5  # nearer to a zone than this counts as inside
_ROUNDING_M = 1e-3  # a subpath may begin where another just keeps its distance
_PROVABLE = 1.002  # of the required clearance: what a proof needs more than the bound itself
_SAMPLES = 64  # points of a way, to find where the terrain is far enough away
_NO_GROUND_M = -1e4  # altitude AMSL of ground that no proof meets: no ground on earth is as low


def escape(request: PlanRequest) -> Planned | NotPlanned | None:
    """The shortest straight way out of where no certificate can begin; None: one can.

    It is clear of terrain and zones at its end.  Proven: no nearer to the terrain than the vehicle
    is now, and with the whole clearance from where it first has that; no nearer to a zone that it
    is clear of than now.  Out of those that it is in, a way that first leads deeper is only taken
    if it is much shorter; and out of one that is too large, a way as far towards its edge as can be
    seen.  The certificate is that about the terrain.
    """
    task, start, around = request.task, request.start.position_nea_m, request.around
    least_m = task.required_clearance_m
    least_m = least_m * _PROVABLE if request.from_rest else least_m - _ROUNDING_M
    now_m = distance_to_terrain_m(around, start, least_m)
    zones = [zone for zone in task.zones if _gaps_m(request, zone) < least_m]
    if now_m >= least_m and not zones:
        return None
    if request.from_rest:
        inside = tuple(zone for zone in zones if _gaps_m(request, zone) < _TOUCHING_M)
        others = tuple(zone for zone in task.zones if zone not in inside)
        proven = _proofs(request, others, now_m)
        ends = _ends_nea_m(request, inside, others)
        seen = (end for end in ends if distance_to_terrain_m(around, end, least_m) >= least_m)
        for end in islice(seen, _CERTIFIED):
            if (certificate := proven(end)) is not None:
                return plan_of(request, straight(start, end), certificate)
    refusal = Refusal.START_NEAR_TERRAIN
    if zones:
        refusal = Refusal.START_IN_KEEP_OUT
    elif task.settings.is_near:
        refusal = Refusal.START_NEAR_THINGS
    elif distance_to_terrain_m(around, start, least_m, seen_only=True) >= least_m:
        refusal = Refusal.START_NEAR_UNKNOWN
    return request.refused(refusal)


def _proofs(
    request: PlanRequest, others: tuple[Zone, ...], now_m: float
) -> Callable[[FloatArray], Certificate | None]:
    """What proves the straight way to a place: -> the certificate about the terrain, or None.

    others: zones that the vehicle is clear of; now_m: its distance to the known terrain.
    """
    task, known, start = request.task, request.known, request.start.position_nea_m
    required_m = task.required_clearance_m

    def keeping(keep_m: float, known: KnownMap, zones: tuple[Zone, ...] = ()) -> Surroundings:
        here_ne_m, range_m = request.start.point_nea_m[:2], task.settings.scan_range_m
        contact_m = min(task.envelope.contact_m, keep_m)
        around = task.surroundings(known, here_ne_m, range_m, clearance_m=keep_m)
        return around._replace(contact_m=float(contact_m), zones=packed(zones))

    gap_m = float(_gaps_m(request, *others))
    air = replace(known, upper_m=np.full(known.upper_m.shape, _NO_GROUND_M))
    off_zones = keeping(min(max(gap_m - _SLACK_M, 0.5 * gap_m), required_m), air, others)
    clear = ground = keeping(required_m, known)
    if now_m < required_m:
        ground = keeping(min(max(now_m, 1.0) - _SLACK_M, required_m), known)

    def proven(end: FloatArray) -> Certificate | None:
        whole = straight(start, end)
        if others and not certify(whole, off_zones, from_rest=True).proven:
            return None
        along = start + np.linspace(0.0, 1.0, _SAMPLES + 1)[:, None] * (end - start)
        short = distances_to_terrain_m(request.around, along, required_m) < required_m
        if short.any():  # the rest is proven at full speed, as it does not begin there at rest
            rest = straight(along[min(int(np.flatnonzero(short)[-1]) + 1, _SAMPLES)], end)
            if not (certify(rest, clear, from_rest=False).proven or rest.length_m <= 1.0):
                return None
        certificate = certify(whole, ground, from_rest=True)
        return certificate if certificate.proven else None

    return proven


def _ends_nea_m(
    request: PlanRequest, inside: tuple[Zone, ...], others: tuple[Zone, ...]
) -> FloatArray:
    """Places all round, within the band, to escape to, the best first.  -> (N, 3).

    Clear of zones, the shortest way first, what leads deeper into one counting more; else clear of
    those that the vehicle is not inside of, and less deep in the others.
    """
    task, start = request.task, request.start.position_nea_m
    near_m, required_m = _NEAR * task.settings.scan_range_m, task.required_clearance_m * _PROVABLE
    steps = np.linspace(near_m / _LENGTHS, near_m, _LENGTHS)
    longer = np.linspace(near_m, max(task.end_radius_m, near_m), _LONGER + 1)[1:]
    level_m, turn = np.append(steps, longer), np.linspace(0.0, math.tau, _BEARINGS, endpoint=False)
    ahead = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    places = start[:2] + level_m[:, None] * ahead[:, None]  # (bearings, lengths, 2)
    may_end = _gaps_m(request, *others, at_ne_m=places) >= required_m
    gap_m, now_m = _gaps_m(request, *inside, at_ne_m=places), _gaps_m(request, *inside)
    if (may_end & (gap_m >= required_m)).any():
        may_end &= gap_m >= required_m
        rank_m = np.broadcast_to(level_m, gap_m.shape)
        for zone in inside:
            least_m = np.minimum.accumulate(_gaps_m(request, zone, at_ne_m=places), axis=1)
            rank_m = rank_m + _DEEPER * np.maximum(_gaps_m(request, zone) - least_m, 0.0)
    else:
        may_end &= gap_m > now_m + _WORTH_M
        rank_m = -gap_m
    climb, dive = task.limits.climb_angle_rad, task.limits.dive_angle_rad
    steep = np.tan([0.0, _STEEP * climb, -_STEEP * dive])
    up_m, (low, high) = start[2] + level_m[:, None] * steep, task.band_amsl_m  # (lengths, slopes)
    rank_m = rank_m[..., None] + level_m[:, None] * (np.hypot(1.0, steep) - 1.0)
    which = np.nonzero(may_end[..., None] & (up_m >= low) & (up_m <= high))
    ends = np.column_stack([places[which[:2]], up_m[which[1:]]])
    return np.asarray(ends[np.argsort(np.round(rank_m[which], 6), kind="stable")])


def _gaps_m(request: PlanRequest, *zones: Zone, at_ne_m: FloatArray | None = None) -> FloatArray:
    """Distance of points, or of the vehicle, or of the circle about it, to the nearest of zones.

    (..., 2) -> (...).
    """
    at_ne_m = request.start.position_nea_m[:2] if at_ne_m is None else at_ne_m
    gaps = gaps_m(zones, at_ne_m[..., 0], at_ne_m[..., 1])
    return np.asarray(gaps - request.task.limits.loiter_radius_m)


# --- where no search finds a leg

_ENDS = 24  # of a straight piece that are tried, the farthest first
_NEARER = 0.8  # each is so far away, of the one before
_SEAM_CELLS = 3.0  # beyond the clearance, of places next to what is unknown
_SEEN = 7.0  # steps: what one more costs that a radar sees from near (eq. 10, as guidance has it)
_STOP = 0.25  # of R: what a stop costs at least, as another plan may turn back
_ALIKE = 0.2  # of a stop: of pieces whose prices differ by less the longer one is flown
_LOOKS = 50  # along a straight piece, for radars
_AFTER = 3  # places that are flown towards, one after the other, if nothing is proven to the first
_CLIMBS = (0.0, 0.95)  # of the climb angle
_AROUND, _SHARES = 24, (0.0625, 0.125, 0.25, 0.5, 1.0)  # climbs, for each share of the height left


class _End(NamedTuple):
    """Of a straight piece."""

    place_nea_m: FloatArray
    stops_m: float = 0.0  # what the stops cost that are to be expected behind it
    least_m: float = 0.0
    """What the way costs that it is the first piece of; 0: it is a climb for itself."""


def way_out(
    request: PlanRequest, searches: Searches, *, looks: bool, strays: bool
) -> tuple[Planned, float] | None:
    """The straight piece to begin with, level or climbing, and what it costs with all that follows.

    A flood fill over the map, of places that keep the clearance of the certificate at the altitude
    of the vehicle, reaches all that it can come to by straight pieces.  Of these places the one
    from which least is left to fly is flown towards; if none is better than where it is, one at the
    edge of what has been seen.  The leg goes straight along the way there as far as that is proven,
    as fast as its length allows.  It ends at rest, where the next plan sees more.

    looks: where no less is left to fly anywhere, it goes to where more is seen.  strays: it may
    climb where that brings it no nearer at once.  None if there is no place to go to.
    """
    answers = list[tuple[Planned, float]]()
    for climb in _CLIMBS:
        for end in _Pieces(request, searches.prices, climb).ends(looks=looks, strays=strays):
            planned = searches.straight(straight(request.start.position_nea_m, end.place_nea_m))
            if planned is not None:
                price_m = searches.prices.price_m(planned) + end.stops_m
                answers.append((planned, max(price_m, end.least_m)))
                break
        if answers and request.task.settings.is_near:  # near things are not flown over
            break
    return min(answers, key=lambda answer: answer[1], default=None)


@final
class _Pieces:
    """Straight pieces from where the vehicle is, level or with a share of the climb angle."""

    def __init__(self, request: PlanRequest, prices: Prices, climb: float) -> None:
        task, range_m = request.task, request.task.settings.scan_range_m
        self._request, self._prices, self._climbs = request, prices, climb > 0.0
        self._start, self._cell_m = request.start.position_nea_m, request.known.cell_m
        self._steepness = math.tan(climb * task.limits.climb_angle_rad)
        self._top_m = task.band_amsl_m[1] if self._climbs else float(self._start[2])
        self._stop_m = max(task.stop_m, _STOP * range_m)
        self._radars = task.radars_near(request.scan_nea_m[:2], 2.0 * range_m)
        self._left_here_m = float(prices.to_go_m(self._start))

    def ends(self, *, looks: bool, strays: bool) -> list[_End]:
        """The best one first; those that no radar sees before the others."""
        if (reached := self._reached()) is None:
            return []
        places_ne_m, way_m, before = reached
        free, left_m = np.isfinite(way_m), np.full(len(way_m), math.inf)
        left_m[free] = self._prices.to_go_m(self._at(places_ne_m[free], way_m[free]))
        is_nearer = left_m.min(initial=math.inf) <= self._left_here_m - self._cell_m  # by a cell
        goals = _least(left_m) if is_nearer else []
        if looks:
            goals += _least(np.where(self._sees_more(places_ne_m), left_m + way_m, math.inf))
        ends = list[_End]()
        for goal in goals:
            way = [goal]
            while before[way[-1]] >= 0:
                way.append(int(before[way[-1]]))
            ends += self._along(places_ne_m[way[::-1]], float(left_m[goal]))
        if self._climbs and goals:
            ends += self._higher(places_ne_m[free])
        if self._climbs and ends:  # of a single place there are none
            ends = self._cheapest_first(ends, strays=strays)
        return sorted(ends, key=lambda end: self._is_seen(end.place_nea_m))

    def _is_seen(self, end_nea_m: FloatArray) -> bool:
        """Whether a straight piece comes into the range of a radar."""
        points = self._start + np.linspace(0.0, 1.0, _LOOKS)[:, None] * (end_nea_m - self._start)
        return any(bool((radar.distance_m(points) < radar.range_m).any()) for radar in self._radars)

    def _at(self, places_ne_m: FloatArray, away_m: FloatArray) -> FloatArray:
        """Places with the altitudes that are reached there.  (N, 2), (N,) -> (N, 3)."""
        altitude_m = np.minimum(self._start[2] + self._steepness * away_m, self._top_m)
        return np.column_stack([places_ne_m, altitude_m])

    def _away_m(self, places_ne_m: FloatArray) -> FloatArray:
        """How far places are away, level.  (N, 2) -> (N,)."""
        return np.asarray(np.linalg.norm(places_ne_m - self._start[:2], axis=-1))

    def _along(self, way_ne_m: FloatArray, left_m: float) -> list[_End]:
        """Places of a way, the farthest along it first; left_m: the way on from its end."""
        along = np.append(0.0, np.cumsum(np.hypot(*np.diff(way_ne_m, axis=0).T)))
        cost_m = float(along[-1]) + left_m + self._request.task.stop_m
        away_m = self._away_m(way_ne_m)
        places, at_m = self._at(way_ne_m, away_m), float(along[-1])
        result = list[_End]()
        while at_m > 0.0 and len(result) < _ENDS:
            k = int(np.searchsorted(along, at_m - 1e-9))
            if away_m[k] >= self._cell_m:
                more = float(along[-1]) / at_m - 1.0  # such pieces
                result.append(_End(places[k], more * self._stop_m, cost_m))
            at_m = min(_NEARER * at_m, at_m - self._cell_m)
        return result

    def _higher(self, reached_ne_m: FloatArray) -> list[_End]:
        """Places to climb to before it goes on: of those that are reached, rings about here."""
        away_m, most_m = self._away_m(reached_ne_m), self._top_m - float(self._start[2])
        places, result = self._at(reached_ne_m, away_m), list[_End]()
        for share in _SHARES:
            off_m = np.abs(away_m - share * most_m / self._steepness)
            ring = np.flatnonzero(off_m < 0.5 * self._cell_m)
            some = ring[:: max(len(ring) // _AROUND, 1)]
            result += [_End(place) for place in places[some[away_m[some] >= self._cell_m]]]
        return result

    def _cheapest_first(self, ends: list[_End], *, strays: bool) -> list[_End]:
        """The rest of a climb takes as many more stops as it has such pieces.

        Last come climbs after which neither less is left than here nor, by half of them, to climb.
        """
        places = np.array([end.place_nea_m for end in ends])
        away_m = np.linalg.norm(places - self._start, axis=-1)
        left_m, climb_m = self._prices.to_go_m(places), self._prices.climb_m(places)
        gained_m = float(self._prices.climb_m(self._start)) - climb_m
        gets_on = (left_m < self._left_here_m) | (gained_m > 0.5 * away_m)
        gets_on |= np.array([end.least_m > 0.0 for end in ends])
        stops_m = np.maximum(self._stop_m * climb_m / away_m, [end.stops_m for end in ends])
        price_m = np.round((left_m + away_m + stops_m) / (_ALIKE * self._stop_m))
        order = np.lexsort((-away_m, price_m, ~gets_on)).tolist()
        order = [i for i in order if gets_on[i] or strays]
        return [ends[i]._replace(stops_m=float(stops_m[i])) for i in order]

    def _reached(self) -> tuple[FloatArray, FloatArray, IndexArray] | None:
        """All places, the way to each by a flood fill over free ones, and the one before it.

        (N, 2), (N,): infinite where none leads, as radars have it, and (N,): negative at its start.
        None: none is free about the vehicle.
        Between its points the surface is bilinear, so nothing is higher between two of them.
        """
        request, task = self._request, self._request.task
        surface = safe_surface(
            request.around,
            centre_ne_m=request.scan_nea_m[:2],
            reach_m=task.settings.scan_range_m,
            clearance_m=task.required_clearance_m,
            unknown_m=math.inf,
        )
        corner, step_m = surface[:2], surface.cell_m
        kept_m = task.zone_clearance_m + 0.5 * step_m
        free = surface.vertex_m <= self._top_m
        free &= ~too_near(task.zones, corner, step_m, free.shape, kept_m)
        places_ne_m = corner + step_m * np.indices(free.shape).reshape(2, -1).T
        offset_m = np.where(free.ravel(), self._away_m(places_ne_m), math.inf)
        begin = int(np.argmin(offset_m))
        if offset_m[begin] > 2.0 * self._cell_m:
            return None
        at_top, price = np.insert(places_ne_m, 2, self._top_m, axis=-1), np.ones(free.size)
        for radar in self._radars:
            price += _SEEN * (radar.distance_m(at_top) < radar.range_m)
        number = np.arange(free.size, dtype=np.int32).reshape(free.shape)
        both_n, both_e = free[1:] & free[:-1], free[:, 1:] & free[:, :-1]
        a = np.concatenate([number[:-1][both_n], number[:, :-1][both_e]])
        b = np.concatenate([number[1:][both_n], number[:, 1:][both_e]])
        graph = scipy.sparse.csr_array((0.5 * (price[a] + price[b]), (a, b)), (free.size,) * 2)
        steps, before = scipy.sparse.csgraph.dijkstra(
            graph, directed=False, indices=[begin], return_predecessors=True
        )
        return places_ne_m, steps[0] * step_m, before[0]

    def _sees_more(self, places_ne_m: FloatArray) -> BoolArray:
        """Places from where unknown ground next to free ground is as near as may be.

        (N, 2) -> (N,).  What is hidden behind a wall stays hidden.
        """
        known, cell_m = self._request.around, self._cell_m
        seam = np.isinf(known.upper_m) & scipy.ndimage.binary_dilation(known.upper_m < self._top_m)
        near_m = self._request.task.required_clearance_m + _SEAM_CELLS * cell_m
        near = scipy.ndimage.distance_transform_edt(~seam, sampling=cell_m) <= near_m
        corner = known.north_min_m, known.east_min_m
        sees_more = _of_cells(near & seam.any(), places_ne_m, corner, cell_m)
        return np.asarray(sees_more & (self._away_m(places_ne_m) >= cell_m))


def _least(costs: FloatArray) -> list[int]:
    """Which places cost the least, a few of them, the best first.  (N,) -> indices."""
    best = np.argsort(costs, kind="stable")[:_AFTER]
    return list(best[np.isfinite(costs[best])].tolist())


# --- where there is no way

_MOST_PARTS, _MOST_ACROSS = 4e6, 8
"""Parts of cells in a map, and in a cell across: a fill of so many takes a quarter of a second."""


def blocked_at(
    known: KnownMap, task: Task, field: CostToGo, ends_ne_m: tuple[Place, Place]
) -> Place | None:
    """Where the cheapest route meets the barrier, north and east; None: not all are blocked.

    Ground that was not seen is open, and so is what a sight line bounds.  What is closed is so for
    any curve: a part of a cell is barred if everywhere in it, and at any altitude, a certificate
    would break.  So a curve that can be proven comes to no part that is barred, and goes on from
    one to one of the eight next to it: a flood fill finds all that curves can reach.
    """
    if not field.is_barred:
        return None
    across = int(min(max(math.sqrt(_MOST_PARTS / known.upper_m.size), 1.0), _MOST_ACROSS))
    part_m, corner_ne_m = known.cell_m / across, (known.north_min_m, known.east_min_m)
    barred = _barred(known, task, across)
    regions = np.asarray(scipy.ndimage.label(~barred, structure=np.ones((3, 3)))[0])
    start, target = _of_cells(regions, np.array(ends_ne_m), corner_ne_m, part_m).tolist()
    if 0 in (start, target) or start == target:
        return None
    points = sampled(np.array(field.route_ne_m), 0.5 * part_m)
    leaves_at = int((_of_cells(regions, points, corner_ne_m, part_m) != start).argmax())
    north, east = points[leaves_at].tolist()
    return north, east


def _of_cells(
    values: NDArray[Any], places_ne_m: FloatArray, corner_ne_m: Place, cell_m: float
) -> NDArray[Any]:
    """The values of the cells that places lie in; of one off the map, of the nearest.

    (R, C), (N, 2) -> (N,).
    """
    index = np.floor((places_ne_m - corner_ne_m) / cell_m).astype(np.int64)
    row, column = np.clip(index, 0, np.array(values.shape) - 1).T
    return np.asarray(values[row, column])


def _barred(known: KnownMap, task: Task, across: int) -> BoolArray:
    """The parts of cells in which no curve can be proven at any altitude.

    across: parts of a cell, north and east.  -> (rows across, columns across).
    """
    ceiling_m = task.limits.ceiling_amsl_m - task.error_m
    clearance_m, part_m = task.required_clearance_m, known.cell_m / across
    half_m = math.sqrt(0.5) * part_m
    reach = math.ceil(clearance_m / known.cell_m)
    middle = (np.arange((2 * reach + 1) * across) + 0.5) / across - reach  # cell 0 is from 0 to 1
    gap_m = np.maximum(np.abs(middle - 0.5) - 0.5, 0.0) * known.cell_m
    away_m = np.hypot(gap_m[:, None], gap_m[None, :]) + half_m
    rises_m = np.sqrt(np.maximum(clearance_m**2 - away_m**2, 0.0))
    rises_m[away_m >= clearance_m] = -np.inf
    upper_m = np.where(known.surveyed, known.upper_m, -np.inf)
    barred = jit.compiled(dilated_m)(upper_m, rises_m, across, -np.inf) > ceiling_m
    corner_ne_m = known.north_min_m + 0.5 * part_m, known.east_min_m + 0.5 * part_m
    deep_m = task.zone_clearance_m - half_m
    in_zones = too_near(task.zones, corner_ne_m, part_m, barred.shape, deep_m)
    return np.asarray(barred | in_zones)
