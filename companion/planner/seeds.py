"""What a search begins with: plausible subpaths as decision vectors of `objective`."""

import math

import numpy as np

from companion import jit, objective
from companion.geodesy import FloatArray, wrap_rad
from companion.objective import Scene
from companion.planner.cheapest_ways import IndexArray
from companion.planner.cost_grid import Place, sampled

_BENDS_RAD = (0.0, 0.3, -0.3)  # of arcs to the guide
_ROUND_RAD = (0.9, -0.9, 2.0, -2.0, math.pi)  # about the guide: from rest in any of them
_NEAR = 0.5  # of the circle's radius: ends where sight is short, or it is tight
_JUST = 1.15  # times the least length
_FIRST = 0.3  # of their range: r2 and s


def ways_of(
    scene: Scene,
    route_ne_m: tuple[Place, ...],
    cell_m: float,
    tail_nea_m: tuple[float, float, float] | None,
) -> list[FloatArray]:
    """Where guidance and the leg under way lead.  -> each (N, 2), N > 0.

    Along the route (with points so far apart) up to the circle; as far as it is seen to be free;
    and by the end of the leg under way, if there is one.
    """
    points = sampled(np.array(route_ne_m), cell_m, 2.0 * scene.end_radius_m)
    away = np.hypot(*(points - scene.scan_ne_m).T)
    out = int(np.argmax(np.append(away, math.inf) > scene.end_radius_m))
    lowest = scene.surface.altitude_m(*points.T)
    barred = int(np.argmax(np.append(lowest, math.inf) > scene.band_amsl_m[1]))
    ways = [points[:out], points[: min(out, barred)]]
    if tail_nea_m is not None:
        ways.append(np.concatenate([[tail_nea_m[:2]], points[max(out - 1, 0) : out]]))
    return [way for way in ways if len(way)]


def seeds_of(scene: Scene, ways_ne_m: list[FloatArray]) -> FloatArray:
    """Subpaths along some ways, straight to the guide and in arcs.  -> (K, D).

    ways_ne_m: where others have found a way, from p_prog on, each (N, 2).
    """
    at, (low, high) = scene.start[0], scene.band_amsl_m
    level = (at[2] - low) / (high - low)
    ahead = math.atan2(scene.start[1, 1], scene.start[1, 0])
    ways = [(way, z) for way in ways_ne_m for z in (level, _safe(scene, way))]
    arcs = list[tuple[float, ...]]()  # bearing at first, turn, bend, how far, share of the band
    for altitude, rho, bends in (
        (level, 1.0, _BENDS_RAD),
        (0.0, 1.0, _BENDS_RAD),
        (0.5, 1.0, (0.0,)),
        (level, _NEAR, (0.0,)),
    ):
        ends = [(scene.guide_rad, bend) for bend in bends]
        if scene.from_rest and rho < 1.0:
            ends += [(scene.guide_rad + turn, 0.0) for turn in _ROUND_RAD]
        elif not scene.from_rest and altitude == level and rho == 1.0:
            ends += [(ahead, 0.0), (ahead + 0.6 * wrap_rad(scene.guide_rad - ahead), 0.0)]
        for bearing, bend in ends:
            first, far_m = bearing if scene.from_rest else ahead, rho * scene.end_radius_m
            arcs.append((first, wrap_rad(bearing - first), bend, far_m, altitude))
    *drawn, levels = np.array(arcs).T
    first_rad, turn_rad, bend_rad, far_m = (column[:, None] for column in drawn)
    share = np.linspace(0.0, 1.0, scene.points)[1:]
    turned = first_rad + share * turn_rad + bend_rad * (share < 1.0)
    steps = (far_m * share)[..., None] * np.stack([np.cos(turned), np.sin(turned)], axis=-1)
    ways += zip(at[:2] + steps, levels.tolist(), strict=True)
    if scene.shortest_m > 0.0:  # hardly longer than it must be, where nothing else has room
        just_m = _JUST * scene.shortest_m
        for bend in _BENDS_RAD:
            step = np.array([[math.cos(ahead + bend), math.sin(ahead + bend)]])
            ways.append((at[:2] + just_m * step, level))
    shares = np.append((np.arange(scene.points - 4) + 2.0) / (scene.points - 1), 1.0)
    begins = np.cumsum([0] + [1 + len(way) for way, _ in ways])
    steps_ne_m = np.concatenate([part for way, _ in ways for part in (at[None, :2], way)])
    places = jit.compiled(places_along)(steps_ne_m, begins, shares)
    pairs = zip(places, ways, strict=True)
    return np.clip([_variables(scene, ahead, place, z) for place, (_, z) in pairs], 0.0, 1.0)


def places_along(steps_ne_m: FloatArray, begins: IndexArray, shares: FloatArray) -> FloatArray:
    """Places at shares of the lengths of ways, linear between their steps.  -> (K, S, 2).

    Compiled.  begins: of each way the first of its steps, (N, 2), and the end of the last one.
    """
    places = np.empty((len(begins) - 1, len(shares), 2))
    flown_m, steps = np.zeros(len(steps_ne_m)), steps_ne_m[1:] - steps_ne_m[:-1]
    for way in range(len(places)):
        k, last = begins[way], begins[way + 1] - 1
        for i in range(k, last):
            flown_m[i + 1] = flown_m[i] + np.hypot(steps[i, 0], steps[i, 1])
        for i in range(len(shares)):
            at_m = shares[i] * flown_m[last]
            while k < last and flown_m[k + 1] <= at_m:
                k += 1
            places[way, i] = steps_ne_m[k]
            if k < last:
                rate = steps[k] / (flown_m[k + 1] - flown_m[k])
                places[way, i] += rate * (at_m - flown_m[k])
    return places


def _variables(
    scene: Scene, ahead_rad: float, places_ne_m: FloatArray, altitude: float
) -> list[float]:
    """The variables of a subpath through some places, at a share of the band.  (S, 2) -> (D,)."""
    start = scene.start[0, :2]
    if scene.from_rest:
        ahead_rad = math.atan2(places_ne_m[0, 1] - start[1], places_ne_m[0, 0] - start[0])
    north, east = (places_ne_m[-1] - scene.scan_ne_m).tolist()
    rho = math.hypot(north, east) / scene.end_radius_m
    unit = min(1.1 * max(rho * scene.end_radius_m, objective.SHORTEST_UNIT), scene.scan_range_m)
    row = [_FIRST, _FIRST]
    for n, e in (places_ne_m[:-1] - start).tolist():
        r = (math.hypot(n, e) / unit - objective.SHORTEST_R) / (1.0 - objective.SHORTEST_R)
        row += [r, _azimuth(ahead_rad, math.atan2(e, n)), altitude]
    row.append(altitude)
    if scene.from_rest:
        row.append(0.5 + 0.5 * wrap_rad(ahead_rad - scene.guide_rad) / math.pi)
    if not scene.is_final:
        row.append(_azimuth(ahead_rad, math.atan2(east, north)))
        row.append((rho - objective.SHORTEST_END) / (1.0 - objective.SHORTEST_END))
    return row


def _safe(scene: Scene, way_ne_m: FloatArray) -> float:
    """The share of the band at which all of a way is clear of terrain."""
    low, high = scene.band_amsl_m
    most = float(scene.surface.altitude_m(*way_ne_m.T).max())
    return (most - low) / (high - low)


def _azimuth(ahead_rad: float, bearing_rad: float) -> float:
    """The search variable of a bearing."""
    return 0.5 + 0.5 * wrap_rad(bearing_rad - ahead_rad) / objective.SPREAD_RAD
