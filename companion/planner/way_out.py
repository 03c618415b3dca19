"""A way out, always: straight pieces from where a vehicle hovers, when no search finds a leg.

A flood fill over the map, of places that keep the clearance of the certificate at the altitude of
the vehicle, reaches all that it can come to by straight pieces.  Of these places the one from which
least is left to fly is flown towards; if none is better than where it is, one at the edge of what
has been seen.  The leg goes straight along the way there as far as that is proven, as fast as its
length allows.  It ends at rest, where the next plan sees more.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy

from companion.geodesy import BoolArray, FloatArray
from companion.path.subpath import Subpath, straight
from companion.planner.cheapest_ways import IndexArray
from companion.planner.price import Prices
from companion.planner.request import Planned, PlanRequest
from companion.world.columns import safe_surface
from companion.world.known_map import KnownMap
from companion.world.zones import too_near

_ENDS = 24  # of a straight piece that are tried, the farthest first
_NEARER = 0.8  # each is so far away, of the one before
_GAIN_CELLS = 1.0  # of way: a place from which not so much less is left to fly is no better
_SEAM_CELLS = 3.0  # beyond the clearance, of places next to what is unknown
_SEEN = 7.0  # steps: what one more costs that a radar sees from near (eq. 10, as guidance has it)
_STOP = 0.25  # of R: what a stop costs at least, as another plan may turn back
_LOOKS = 50  # along a straight piece, for radars
_AFTER = 3  # places that are flown towards, one after the other, if nothing is proven to the first
_CLIMBS = (0.0, 0.95)  # of the climb angle
_AROUND, _SHARES = 24, (0.0625, 0.125, 0.25, 0.5, 1.0)  # climbs, for each share of the height left

Prove = Callable[[Subpath], Planned | None]
"""The plan of a straight subpath, at the highest speed for which it is proven."""
Way = tuple[FloatArray, float]
"""Places (N, 2) from where the vehicle is, and what it costs to fly there and on."""


@final
@dataclass(frozen=True, slots=True)
class _End:
    """Of a straight piece."""

    place_nea_m: FloatArray
    stops_m: float  # what the stops cost that are to be expected behind it
    least_m: float = 0.0
    """What the way costs that it is the first piece of; 0: it is a climb for itself."""


def way_out(
    request: PlanRequest, prices: Prices, prove: Prove, *, looks: bool, strays: bool
) -> tuple[Planned, float] | None:
    """The straight piece to begin with, level or climbing, and what it costs with all that follows.

    looks: where no less is left to fly anywhere, it goes to where more is seen.  strays: it may
    climb where that brings it no nearer at once.  None if there is no place to go to.
    """
    found = []
    for climb in _CLIMBS:
        for end in _Search(request, prices, climb).ends(looks=looks, strays=strays):
            planned = prove(straight(request.start.position_nea_m, end.place_nea_m))
            if planned is not None:
                price_m = prices.price_m(planned) + end.stops_m
                found.append((planned, max(price_m, end.least_m)))
                break
        if found and request.task.settings.is_near:  # near things are not flown over
            break
    return min(found, key=lambda each: each[1], default=None)


@final
class _Search:
    """For places to fly to in a straight line, level or with a share of the climb angle."""

    def __init__(self, request: PlanRequest, prices: Prices, climb: float) -> None:
        task, range_m = request.task, request.task.settings.scan_range_m
        self._request, self._prices, self._climbs = request, prices, climb > 0.0
        self._start, self._cell_m = request.start.position_nea_m, request.known.cell_m
        self._steepness = math.tan(climb * task.limits.climb_angle_rad)
        self._top_m = task.band_amsl_m[1] if self._climbs else float(self._start[2])
        self._stop_m = max(task.stop_m, _STOP * range_m)
        self._radars = task.radars_near(request.scan_nea_m[:2], 2.0 * range_m)
        self._left_here_m = float(self._prices.to_go_m(self._start))

    def ends(self, *, looks: bool, strays: bool) -> list[_End]:
        """The best one first; those that no radar sees before the others."""
        ways, reached_ne_m = self._ways(looks=looks)
        ends = [end for way in ways for end in self._along(way)]
        if self._climbs and ways:
            ends = self._cheapest_first(ends + self._higher(reached_ne_m), strays=strays)
        return sorted(ends, key=lambda end: self._is_seen(end.place_nea_m))

    def _is_seen(self, end_nea_m: FloatArray) -> bool:
        """Whether a straight piece comes into the range of a radar."""
        points = self._start + np.linspace(0.0, 1.0, _LOOKS)[:, None] * (end_nea_m - self._start)
        return any(bool((each.distance_m(points) < each.range_m).any()) for each in self._radars)

    def _at(self, places_ne_m: FloatArray, away_m: FloatArray) -> FloatArray:
        """Places with the altitudes that are reached there.  (..., 2), (...) -> (..., 3)."""
        altitude_m = np.minimum(self._start[2] + self._steepness * away_m, self._top_m)
        return np.concatenate([places_ne_m, altitude_m[..., None]], axis=-1)

    def _along(self, way: Way) -> list[_End]:
        """Places of a way, the farthest along it first."""
        way_ne_m, costs_m = way
        along = np.append(0.0, np.cumsum(np.hypot(*np.diff(way_ne_m, axis=0).T)))
        away_m = np.linalg.norm(way_ne_m - self._start[:2], axis=-1)
        places, left = self._at(way_ne_m, away_m), float(along[-1])
        result = list[_End]()
        while left > 0.0 and len(result) < _ENDS:
            k = int(np.searchsorted(along, left - 1e-9))
            if away_m[k] >= self._cell_m:
                more = float(along[-1]) / left - 1.0  # such pieces
                result.append(_End(places[k], more * self._stop_m, costs_m))
            left = min(_NEARER * left, left - self._cell_m)
        return result

    def _higher(self, reached_ne_m: FloatArray) -> list[_End]:
        """Places to climb to before it goes on: of those that are reached, rings about here."""
        away_m = np.hypot(*(reached_ne_m - self._start[:2]).T)
        places, most_m = self._at(reached_ne_m, away_m), self._top_m - float(self._start[2])
        rings = [
            np.flatnonzero(np.abs(away_m - share * most_m / self._steepness) < 0.5 * self._cell_m)
            for share in _SHARES
        ]
        every = [i for ring in rings for i in ring[:: max(len(ring) // _AROUND, 1)].tolist()]
        return [_End(places[i], 0.0) for i in every if away_m[i] >= self._cell_m]

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
        order = np.lexsort((left_m + away_m + stops_m, ~gets_on)).tolist()
        return [replace(ends[i], stops_m=float(stops_m[i])) for i in order if gets_on[i] or strays]

    def _ways(self, *, looks: bool) -> tuple[list[Way], FloatArray]:
        """Ways over free places to where less is left to fly, or more is seen.

        And all places that are reached, (M, 2).
        """
        task, here, cell_m = self._request.task, self._start, self._cell_m
        free, places_ne_m, step_m = self._free()
        offset_m = np.linalg.norm(places_ne_m - here[:2], axis=-1)
        begin = int(np.argmin(np.where(free, offset_m, math.inf)))
        if not free.ravel()[begin] or offset_m.ravel()[begin] > 2.0 * cell_m:
            return [], np.empty((0, 2))
        at_top = np.insert(places_ne_m, 2, self._top_m, axis=-1)
        seen = np.zeros(free.shape)
        for radar in self._radars:
            seen += radar.distance_m(at_top) < radar.range_m
        steps, before = _flood(free, 1.0 + _SEEN * seen, begin)
        away_m = steps.reshape(free.shape) * step_m
        reached = np.isfinite(away_m)
        there = self._at(places_ne_m, np.where(reached, away_m, 0.0))
        left_m = np.where(reached, self._prices.to_go_m(there), math.inf)
        goals = np.argsort(left_m, axis=None, kind="stable")[:_AFTER].tolist()
        if left_m.ravel()[goals[0]] > self._left_here_m - _GAIN_CELLS * cell_m:
            goals = []
        if looks:
            near_m = task.required_clearance_m + _SEAM_CELLS * cell_m
            edge = _sees_more(self._request.around, places_ne_m, self._top_m, near_m)
            edge &= reached & (offset_m >= cell_m)
            total = np.where(edge, left_m + away_m, math.inf)
            more = np.argsort(total, axis=None, kind="stable")[:_AFTER]
            goals += more[np.isfinite(total.ravel()[more])].tolist()
        ways = list[Way]()
        for goal in goals:
            index = [goal]
            while before[index[-1]] >= 0:
                index.append(int(before[index[-1]]))
            way = places_ne_m.reshape(-1, 2)[index[::-1]]
            along_m = float(np.hypot(*np.diff(way, axis=0).T).sum())
            ways.append((way, along_m + float(left_m.ravel()[goal]) + task.stop_m))
        return ways, places_ne_m[reached]

    def _free(self) -> tuple[BoolArray, FloatArray, float]:
        """Whether places are free up to the top, (N, M); the places, (N, M, 2); how far apart."""
        request, task = self._request, self._request.task
        surface = safe_surface(
            request.around,
            centre_ne_m=request.scan_nea_m[:2],
            reach_m=task.settings.scan_range_m,
            clearance_m=task.required_clearance_m,
            unknown_m=math.inf,
        )
        free = surface.vertex_m <= self._top_m
        north = surface.north_min_m + surface.cell_m * np.arange(float(free.shape[0]))
        east = surface.east_min_m + surface.cell_m * np.arange(float(free.shape[1]))
        if task.zones:
            kept_m = task.zone_clearance_m + 0.5 * surface.cell_m
            free &= ~too_near(task.zones, tuple(north), tuple(east), kept_m)
        places_ne_m = np.stack(np.meshgrid(north, east, indexing="ij"), axis=-1)
        return free, places_ne_m, surface.cell_m


def _sees_more(
    known: KnownMap, places_ne_m: FloatArray, altitude_m: float, near_m: float
) -> BoolArray:
    """Places from where unknown ground next to free ground is as near as may be.

    (..., 2) -> (...).  What is hidden behind a wall stays hidden.
    """
    free = known.upper_m < altitude_m
    seam = np.isinf(known.upper_m) & scipy.ndimage.binary_dilation(free)
    near = scipy.ndimage.distance_transform_edt(~seam, sampling=known.cell_m) <= near_m
    corner = known.north_min_m, known.east_min_m
    index = ((places_ne_m - corner) / known.cell_m).astype(np.int64)
    row, column = np.moveaxis(np.clip(index, 0, np.array(seam.shape) - 1), -1, 0)
    return np.asarray((near & seam.any())[row, column])


def _flood(free: BoolArray, price: FloatArray, begin: int) -> tuple[FloatArray, IndexArray]:
    """Steps to each place from where it begins, infinite where none lead, and the one before.

    price: (rows, columns), of a step there.

    Between its points the surface is bilinear, so nothing is higher between two of them.
    """
    number = np.arange(free.size, dtype=np.int32).reshape(free.shape)
    both_n, both_e = free[1:] & free[:-1], free[:, 1:] & free[:, :-1]
    a = np.concatenate([number[:-1][both_n], number[:, :-1][both_e]])
    b = np.concatenate([number[1:][both_n], number[:, 1:][both_e]])
    steps = 0.5 * (price.ravel()[a] + price.ravel()[b])
    graph = scipy.sparse.csr_array((steps, (a, b)), shape=(free.size, free.size))
    away, before = scipy.sparse.csgraph.dijkstra(
        graph, directed=False, indices=[begin], return_predecessors=True
    )
    return away[0], before[0]
