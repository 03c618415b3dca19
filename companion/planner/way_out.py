"""A way out, always: straight pieces from where a vehicle hovers, when no search finds a leg.

A flood fill over the map, of places that keep the clearance of the certificate at the altitude of
the vehicle, reaches all that it can come to by straight pieces.  Of these places the one from which
least is left to fly is flown towards; if none is better than where it is, one at the edge of what
has been seen.  The leg goes straight along the way there as far as that is proven, as fast as its
length allows.  It ends at rest, where the next plan sees more.
"""

import itertools
import math
from collections.abc import Callable

import numpy as np
import scipy

from companion.geodesy import BoolArray, FloatArray
from companion.path.subpath import Subpath, straight
from companion.planner.cheapest_ways import IndexArray
from companion.planner.cost_grid import descent_m
from companion.planner.field import CostToGo
from companion.planner.kernels import compiled
from companion.planner.request import Planned, PlanRequest
from companion.world.clearance import safe_surface
from companion.world.known_map import KnownMap
from companion.world.radars import Radar
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
Price = Callable[[Planned], float]
End = tuple[FloatArray, float, float]
"""Of a straight piece, what stops cost behind it, and the way that it is the first piece of."""
Way = tuple[FloatArray, float]
"""Places of it, (N, 2), and what it costs with all that follows."""


def way_out(
    request: PlanRequest, field: CostToGo, prove: Prove, price: Price, *, looks: bool = True
) -> tuple[Planned, float] | None:
    """The straight piece to begin with, level or climbing, and what it costs with all that follows.

    looks: where no less is left to fly anywhere, it goes to where more is seen.  None if there is
    no place to go to.
    """
    found = []
    for climb in _CLIMBS:
        out = _straight(request, field, prove, price, climb, looks=looks)
        found += [out] if out is not None else []
        if found and request.task.settings.is_near:  # near things are not flown over
            break
    return min(found, key=lambda each: each[1], default=None)


def _straight(
    request: PlanRequest,
    field: CostToGo,
    prove: Prove,
    price: Price,
    climb: float,
    *,
    looks: bool,
) -> tuple[Planned, float] | None:
    """The first straight piece that is proven, with a share of the climb angle.

    It costs no less than the way to where it leads at last, which it is the first piece of.
    """
    start, task = request.start.position_nea_m, request.task
    stop_m = max(task.stop_m, _STOP * task.settings.scan_range_m)
    radars = task.radars_near(request.scan_nea_m[:2], 2.0 * task.settings.scan_range_m)
    steepness = math.tan(climb * task.limits.climb_angle_rad)
    top_m = float(start[2]) if climb == 0.0 else task.band_amsl_m[1]
    ways, reached_ne_m = _ways(request, field, top_m, steepness, looks=looks)
    cell_m = request.known.cell_m
    ends = [
        (end, more * stop_m, total_m)
        for way, total_m in ways
        for end, more in _ends(start, way, steepness, top_m, cell_m)
    ]
    if climb and ways:  # it leads up where nothing does straight on: it climbs first
        ends += [(end, 0.0, 0.0) for end in _higher(start, reached_ne_m, steepness, top_m, cell_m)]
    if climb and ends:
        ends = _cheapest_first(ends, request, field, stop_m)
    unseen = [each for each in ends if not _is_seen(start, each[0], radars)]
    for end, stops_m, total_m in unseen + (ends if radars else []):
        if (planned := prove(straight(start, end))) is not None:
            return planned, max(price(planned) + stops_m, total_m)
    return None


def _is_seen(start: FloatArray, end: FloatArray, radars: tuple[Radar, ...]) -> bool:
    """Whether a straight piece comes into the range of a radar."""
    points = start + np.linspace(0.0, 1.0, _LOOKS)[:, None] * (end - start)
    return any(bool((radar.distance_m(points) < radar.range_m).any()) for radar in radars)


def _cheapest_first(
    ends: list[End], request: PlanRequest, field: CostToGo, stop_m: float
) -> list[End]:
    """Ends of climbs: the rest of the climb takes as many more stops as it has such pieces.

    Without those from where neither less is left than from here nor less is to be climbed.
    """
    place, start = np.array([end for end, _, _ in ends]), request.start.position_nea_m
    climb_m, away_m = _climb_m(request, field, *place.T), np.linalg.norm(place - start, axis=-1)
    left_m = _left_m(request, field, *place.T)
    gained_m = float(_climb_m(request, field, *start)) - climb_m
    gets_on = (left_m < float(_left_m(request, field, *start))) | (gained_m > 0.5 * away_m)
    stops_m = np.maximum(stop_m * climb_m / away_m, [each for _, each, _ in ends])
    order = np.argsort(left_m + away_m + stops_m, kind="stable").tolist()
    return [(ends[i][0], float(stops_m[i]), ends[i][2]) for i in order if gets_on[i] or ends[i][2]]


def _left_m(
    request: PlanRequest, field: CostToGo, north: FloatArray, east: FloatArray, altitude: FloatArray
) -> FloatArray:
    """What is left to fly from places: to come down is to be paid, too."""
    task = request.task
    (low, high), whole_m = task.band_amsl_m, descent_m(task.limits.ceiling_amsl_m, task)
    needed_m = field.needed.altitude_m(north, east)
    share, least = (np.clip((at - low) / (high - low), 0.0, 1.0) for at in (altitude, needed_m))
    down_m = whole_m * np.maximum(share**2 - least**2, 0.0)
    climb_m = _climb_m(request, field, north, east, altitude)
    return field.at_m(north, east) + down_m + climb_m


def _climb_m(
    request: PlanRequest, field: CostToGo, north: FloatArray, east: FloatArray, altitude: FloatArray
) -> FloatArray:
    """The way that it takes to come up to where the way on can be climbed."""
    short_m = field.needed.altitude_m(north, east) - altitude
    return np.maximum(short_m, 0.0) / math.tan(request.task.limits.climb_angle_rad)


def _higher(
    start: FloatArray, reached_ne_m: FloatArray, steepness: float, top_m: float, cell_m: float
) -> list[FloatArray]:
    """Places to climb to in a straight line: of those that are reached, rings about here."""
    away_m = np.hypot(*(reached_ne_m - start[:2]).T)
    most_m = (top_m - float(start[2])) / steepness
    result = []
    for share in _SHARES:
        ring = np.flatnonzero(np.abs(away_m - share * most_m) < 0.5 * cell_m)
        for i in ring[:: max(len(ring) // _AROUND, 1)]:
            if away_m[i] >= cell_m:
                altitude_m = min(float(start[2]) + steepness * away_m[i], top_m)
                result.append(np.append(reached_ne_m[i], altitude_m))
    return result


def _ends(
    start: FloatArray, way_ne_m: FloatArray, steepness: float, top_m: float, cell_m: float
) -> list[tuple[FloatArray, float]]:
    """Places of a way to fly to in a straight line, the farthest along it first.

    And how many more such pieces the way has.
    """
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(way_ne_m, axis=0).T)))
    result: list[tuple[FloatArray, float]] = []
    left = float(along[-1])
    while left > 0.0 and len(result) < _ENDS:
        place = way_ne_m[int(np.searchsorted(along, left - 1e-9))]
        away = math.dist(place, start[:2])
        if away >= cell_m:
            altitude = min(float(start[2]) + steepness * away, top_m)
            more = float(along[-1]) / left - 1.0
            result.append((np.array([place[0], place[1], altitude]), more))
        left = min(_NEARER * left, left - cell_m)
    return result


def _ways(
    request: PlanRequest, field: CostToGo, altitude_m: float, steepness: float, *, looks: bool
) -> tuple[list[Way], FloatArray]:
    """Ways over free places to where less is left to fly, or more is seen.

    And all places that are reached, (M, 2).
    """
    known, task = request.around, request.task
    reach_m = task.settings.scan_range_m
    surface = safe_surface(
        known,
        compiled().dilated_m,
        centre_ne_m=request.scan_nea_m[:2],
        reach_m=reach_m,
        clearance_m=task.required_clearance_m,
        unknown_m=math.inf,
    )
    free = surface.vertex_m <= altitude_m
    north = surface.north_min_m + surface.cell_m * np.arange(float(free.shape[0]))
    east = surface.east_min_m + surface.cell_m * np.arange(float(free.shape[1]))
    if task.zones:
        lattice, kept_m = (tuple(north), tuple(east)), task.zone_clearance_m + 0.5 * surface.cell_m
        free &= ~too_near(task.zones, *lattice, kept_m, compiled().zone_gaps)
    here = request.start.position_nea_m
    offset_m = np.hypot((north - here[0])[:, None], (east - here[1])[None, :])
    begin = int(np.argmin(np.where(free, offset_m, math.inf)))
    if not free.ravel()[begin] or offset_m.ravel()[begin] > 2.0 * known.cell_m:
        return [], np.empty((0, 2))
    wide = np.meshgrid(north, east, indexing="ij")
    places, seen = np.stack([*wide, np.full(free.shape, altitude_m)], axis=-1), np.zeros(free.shape)
    for radar in task.radars_near(request.scan_nea_m[:2], 2.0 * reach_m):
        seen += radar.distance_m(places) < radar.range_m
    away, before = _flood(free, 1.0 + _SEEN * seen, begin)
    reached = np.isfinite(away).reshape(free.shape)
    away_m = away.reshape(free.shape) * known.cell_m
    there_m = np.minimum(here[2] + steepness * np.where(reached, away_m, 0.0), altitude_m)
    left_m = np.where(reached, _left_m(request, field, *wide, there_m), math.inf)
    here_m = float(_left_m(request, field, *here))
    goals = np.argsort(left_m, axis=None, kind="stable")[:_AFTER]
    if left_m.ravel()[goals[0]] > here_m - _GAIN_CELLS * known.cell_m:
        goals = np.array([], dtype=np.intp)
    if looks:
        edge = reached & _sees_more(known, north, east, altitude_m, task.required_clearance_m)
        edge &= offset_m >= known.cell_m
        total = np.where(edge, left_m + away_m, math.inf)
        more = np.argsort(total, axis=None, kind="stable")[:_AFTER]
        goals = np.concatenate([goals, more[np.isfinite(total.ravel()[more])]])
    ways = []
    for goal in goals.tolist():
        index = [goal]
        while before[index[-1]] >= 0:
            index.append(int(before[index[-1]]))
        rows, columns = np.divmod(np.array(index[::-1]), free.shape[1])
        way = np.stack([north[rows], east[columns]], axis=-1)
        along_m = float(np.hypot(*np.diff(way, axis=0).T).sum())
        ways.append((way, along_m + float(left_m.ravel()[goal]) + task.stop_m))
    rows, columns = np.nonzero(reached)
    return ways, np.stack([north[rows], east[columns]], axis=-1)


def _sees_more(
    known: KnownMap, north: FloatArray, east: FloatArray, altitude_m: float, clearance_m: float
) -> BoolArray:
    """Places from where unknown ground next to free ground is as near as may be.

    North (rows,), east (columns,) -> (rows, columns).  What is hidden behind a wall stays hidden.
    """
    free = known.upper_m < altitude_m
    seam = np.isinf(known.upper_m) & scipy.ndimage.binary_dilation(free)
    near_m = clearance_m + _SEAM_CELLS * known.cell_m
    near = scipy.ndimage.distance_transform_edt(~seam, sampling=known.cell_m) <= near_m
    row, column = (
        np.clip(((at - low) / known.cell_m).astype(np.int64), 0, size - 1)
        for at, low, size in zip(
            (north, east), (known.north_min_m, known.east_min_m), seam.shape, strict=True
        )
    )
    return np.asarray((near & seam.any())[row[:, None], column])


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
