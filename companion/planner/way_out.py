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
from companion.planner.field import CostToGo
from companion.planner.kernels import compiled
from companion.planner.request import Planned, PlanRequest
from companion.world.clearance import Surface, safe_surface
from companion.world.known_map import KnownMap
from companion.world.zones import too_near

_ENDS = 24  # of a straight piece that are tried, the farthest first
_NEARER = 0.8  # each is so far away, of the one before
_GAIN_CELLS = 1.0  # of way: a place from which not so much less is left to fly is no better
_SEAM_CELLS = 3.0  # beyond the clearance, of places next to what is unknown
_AFTER = 3  # places that are flown towards, one after the other, if nothing is proven to the first
_CLIMBS = (0.0, 0.95)  # of the climb angle
_BEARINGS, _SHARES = 24, (0.125, 0.25, 0.5, 1.0)  # of climbs, and of the height up to the ceiling

Prove = Callable[[Subpath], Planned | None]
"""The plan of a straight subpath, at the highest speed for which it is proven."""


def way_out(
    request: PlanRequest, field: CostToGo, prove: Prove, *, looks: bool = True
) -> Planned | None:
    """The straight piece to begin with; None if there is no place to go to.

    looks: where no less is left to fly anywhere, it goes to where more is seen.
    """
    start, task = request.start.position_nea_m, request.task
    for climb in _CLIMBS:
        steepness = math.tan(climb * task.limits.climb_angle_rad)
        top_m = float(start[2]) if climb == 0.0 else task.band_amsl_m[1]
        ways = _ways(request, field, top_m, looks=looks)
        ends = [_ends(start, way, steepness, top_m, request.known.cell_m) for way in ways]
        if climb and ways:  # it leads up where nothing does straight on: it climbs first
            ends.append(_all_round(start, steepness, top_m, request))
        for end in itertools.chain(*ends):
            if (planned := prove(straight(start, end))) is not None:
                return planned
    return None


def _all_round(
    start: FloatArray, steepness: float, top_m: float, request: PlanRequest
) -> list[FloatArray]:
    """Places higher up in all directions, the lowest first, those towards the target before."""
    most_m = min((top_m - float(start[2])) / steepness, request.task.end_radius_m)
    north, east = request.target_ne_m
    ahead = math.atan2(east - start[1], north - start[0])
    turns = sorted(np.linspace(-math.pi, math.pi, _BEARINGS, endpoint=False), key=abs)
    result = []
    for share in _SHARES:
        away = share * most_m
        if away >= request.known.cell_m:
            for turn in turns:
                level = away * np.array([math.cos(ahead + turn), math.sin(ahead + turn)])
                result.append(start + np.append(level, away * steepness))
    return result


def _ends(
    start: FloatArray, way_ne_m: FloatArray, steepness: float, top_m: float, cell_m: float
) -> list[FloatArray]:
    """Places of a way to fly to in a straight line, the farthest along it first."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(way_ne_m, axis=0).T)))
    result: list[FloatArray] = []
    left = float(along[-1])
    while left > 0.0 and len(result) < _ENDS:
        place = way_ne_m[int(np.searchsorted(along, left - 1e-9))]
        away = math.dist(place, start[:2])
        if away >= cell_m:
            altitude = min(float(start[2]) + steepness * away, top_m)
            result.append(np.array([place[0], place[1], altitude]))
        left = min(_NEARER * left, left - cell_m)
    return result


def _ways(
    request: PlanRequest, field: CostToGo, altitude_m: float, *, looks: bool
) -> list[FloatArray]:
    """Ways over free places to where less is left to fly, or more is seen.  -> each (N, 2)."""
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
    free, between_n, between_e = _free(surface, known.cell_m, altitude_m)
    step = round(known.cell_m / surface.cell_m)
    first = (step - 1) * surface.cell_m
    north = surface.north_min_m + first + known.cell_m * np.arange(float(free.shape[0]))
    east = surface.east_min_m + first + known.cell_m * np.arange(float(free.shape[1]))
    if task.zones:
        lattice, kept_m = (tuple(north), tuple(east)), task.zone_clearance_m + 0.5 * known.cell_m
        free &= ~too_near(task.zones, *lattice, kept_m, compiled().zone_gaps)
    here = request.start.position_nea_m
    offset_m = np.hypot((north - here[0])[:, None], (east - here[1])[None, :])
    begin = int(np.argmin(np.where(free, offset_m, math.inf)))
    if not free.ravel()[begin] or offset_m.ravel()[begin] > 2.0 * known.cell_m:
        return []
    away, before = _flood(free, between_n, between_e, begin)
    reached = np.isfinite(away).reshape(free.shape)
    left_m = np.where(reached, field.at_m(north[:, None], east[None, :]), math.inf)
    here_m = float(field.at_m(np.array(here[0]), np.array(here[1])))
    goals = np.argsort(left_m, axis=None, kind="stable")[:_AFTER]
    if left_m.ravel()[goals[0]] > here_m - _GAIN_CELLS * known.cell_m:
        goals = np.array([], dtype=np.intp)
    if looks:
        edge = reached & _sees_more(known, north, east, altitude_m, task.required_clearance_m)
        edge &= offset_m >= known.cell_m
        total = np.where(edge, left_m + away.reshape(free.shape), math.inf)
        more = np.argsort(total, axis=None, kind="stable")[:_AFTER]
        goals = np.concatenate([goals, more[np.isfinite(total.ravel()[more])]])
    ways = []
    for goal in goals.tolist():
        index = [goal]
        while before[index[-1]] >= 0:
            index.append(int(before[index[-1]]))
        rows, columns = np.divmod(np.array(index[::-1]), free.shape[1])
        ways.append(np.stack([north[rows], east[columns]], axis=-1))
    return ways


def _sees_more(
    known: KnownMap, north: FloatArray, east: FloatArray, altitude_m: float, clearance_m: float
) -> BoolArray:
    """Places from where unknown ground next to free ground is as near as may be.

    North (rows,), east (columns,) -> (rows, columns).  What is hidden behind a wall stays hidden.
    """
    row, column = known.cell_of(float(north[0]), float(east[0]))
    upper = np.full((len(north), len(east)), -math.inf)  # beyond the map nothing can be seen
    south, west = max(-row, 0), max(-column, 0)
    inside = known.upper_m[max(row, 0) :, max(column, 0) :][
        : len(north) - south, : len(east) - west
    ]
    upper[south : south + inside.shape[0], west : west + inside.shape[1]] = inside
    free = np.isfinite(upper) & (upper < altitude_m)
    seam = np.isinf(upper) & (upper > 0.0) & scipy.ndimage.binary_dilation(free)
    if not seam.any():
        return seam
    near = (clearance_m + _SEAM_CELLS * known.cell_m) / known.cell_m
    return np.asarray(scipy.ndimage.distance_transform_edt(~seam) <= near)


def _free(
    surface: Surface, cell_m: float, altitude_m: float
) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Where the surface may be flown over at an altitude, and where between two such places.

    -> (rows, columns), (rows - 1, columns), (rows, columns - 1).  Between the points of its lattice
    it is bilinear, so nothing is higher between two of them.
    """
    step = round(cell_m / surface.cell_m)
    low = surface.vertex_m <= altitude_m
    first, between = step - 1, step - 1 + step // 2  # the lattice is as fine as the map, or twice
    free = low[first::step, first::step].copy()
    rows, columns = free.shape
    between_n = low[between::step, first::step][: rows - 1, :columns]
    between_e = low[first::step, between::step][:rows, : columns - 1]
    return free, between_n, between_e


def _flood(
    free: BoolArray, between_n: BoolArray, between_e: BoolArray, begin: int
) -> tuple[FloatArray, IndexArray]:
    """Steps to each place from where it begins, infinite where none lead, and the one before."""
    number = np.arange(free.size, dtype=np.int32).reshape(free.shape)
    both_n, both_e = between_n & free[1:] & free[:-1], between_e & free[:, 1:] & free[:, :-1]
    a = np.concatenate([number[:-1][both_n], number[:, :-1][both_e]])
    b = np.concatenate([number[1:][both_n], number[:, 1:][both_e]])
    graph = scipy.sparse.csr_array((np.ones(len(a)), (a, b)), shape=(free.size, free.size))
    away, before = scipy.sparse.csgraph.dijkstra(
        graph, directed=False, indices=[begin], return_predecessors=True, unweighted=True
    )
    return away[0], before[0]
