"""The objective of `flight`, one candidate at a time: plain Python that numba compiles as it is.

As soon as the partial sum exceeds a bound above which the search rejects the candidate anyway, the
cost stops and says infinity (every term is at least zero).  One more term takes a weight, a line in
`cost` and one in `terms`.
"""

import math
from collections import namedtuple
from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple

import numpy as np

from companion.geodesy import FloatArray
from companion.objective import scene as flight
from companion.objective.scene import FlightScene
from companion.path.bspline import uniform_basis
from companion.path.envelope import Envelope, ending_m_s, flown_on_m, rising_m_s
from companion.path.limits import Limits
from companion.path.subpath import Pose
from companion.profiles import Weights
from companion.world.clearance import Surface
from companion.world.zones import NearCells, ZoneTable, packed, polygon_at

_FAR = 1e12


class Pack(NamedTuple):
    """A `FlightScene` as numba takes it, and workspace."""

    scene: FlightScene  # a record of the same fields and properties; no radars, no zones
    basis: FloatArray  # (3, S + 1, points): values, first and second derivatives
    radars: FloatArray  # (n, 5): north, east, altitude, range, range and margin
    zones: ZoneTable
    gaps: FloatArray  # (n,), workspace: distance of the point before from each polygon
    control: FloatArray  # (points, 3), workspace
    points: FloatArray  # (S + 1, 4), workspace: position and length flown
    ahead: FloatArray  # (S + 1, 3), workspace: first derivatives


def pack(scene: FlightScene) -> Pack:
    """The scene as plain numbers and arrays."""
    at, zones = uniform_basis(scene.samples, scene.points), packed(scene.zones)
    radars = [(*r.centre_nea_m, r.range_m, r.range_m + scene.radar_margin_m) for r in scene.radars]
    return Pack(
        scene=_plain(scene),
        basis=np.stack([at.value, at.first, at.second]),
        radars=np.array(radars, dtype=np.float64).reshape(-1, 5),
        zones=zones,
        gaps=np.empty(len(zones.polygons)),
        control=np.empty((scene.points, 3)),
        points=np.empty((scene.samples + 1, 4)),
        ahead=np.empty((scene.samples + 1, 3)),
    )


_UNUSED = {"radars", "zones", "points", "samples", "variables", "radar_margin_m"}
_UNUSED |= {"point_nea_m", "kind"}


def _record_of(kind: type) -> Any:
    """A named tuple with the fields and the properties of a dataclass."""
    names = [each.name for each in fields(kind)]
    names += [name for name, value in vars(kind).items() if isinstance(value, property)]
    names = [name for name in names if name not in _UNUSED]
    return namedtuple(f"_{kind.__name__}", names, module=__name__)


_FlightScene, _Weights, _Limits = map(_record_of, (FlightScene, Weights, Limits))
_Pose, _Surface, _NearCells = map(_record_of, (Pose, Surface, NearCells))
_NONE = {
    "final_ne_m": (0.0, 0.0),
    "near_polygons": NearCells(
        north_min_m=0.0, east_min_m=0.0, cell_m=1.0, near=np.empty((0, 0), dtype=bool)
    ),
}
"""What stands for None: numba compiles for each type another time."""


def _plain(value: Any) -> Any:
    """Dataclasses as records, numbers as floats, for the same reason; arrays in C order."""
    if is_dataclass(value):
        record = globals()[f"_{type(value).__name__}"]
        found = {name: getattr(value, name) for name in record._fields}
        return record(*(_plain(_NONE[k] if v is None else v) for k, v in found.items()))
    if isinstance(value, Envelope):
        return value
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    if isinstance(value, np.ndarray):
        return np.ascontiguousarray(value, dtype=bool if value.dtype == bool else np.float64)
    return value if isinstance(value, bool) else float(value)


def cost(x: FloatArray, bound: float, pack: Pack) -> float:
    """Eq. 5 for one candidate, (D,) in the unit cube; infinity if it would exceed the bound."""
    scene, weights = pack.scene, pack.scene.weights
    control, points = pack.control, pack.points
    each = flight.PER_SAMPLE / (len(points) - 1)
    place_control_points(x, control, scene)
    sample(points, control, pack.basis)
    to_go_m = remaining_m(control, scene)
    per_metre = 100.0 / (2.4 * scene.scan_range_m)
    total = weights.length * points[-1, 3] * per_metre + weights.length * to_go_m * per_metre
    total += weights.height * height(points, scene) + weights.guide * guide(control, scene)
    if total > bound:
        return math.inf
    total += weights.radar * each * flight.RADAR_SCALE * detection(points, pack.radars)
    total += weights.constraints * each * steering(pack.ahead, control, pack.basis, scene)
    if total > bound:
        return math.inf
    scale = weights.constraints * each * flight.OUTSIDE_SCALE
    total += scale * leaving(points, scene)
    total += scale * intruding(points, pack, (bound - total) / max(scale, 1e-12))
    if total > bound:
        return math.inf
    low_m = too_low_m(points, scene.surface)
    if scene.limits.hovers:  # a plane circles, and its surface stands off by that
        low_m += dead_man_m(points, pack.ahead, scene)
    total += weights.crash * each * flight.CRASH_SCALE / scene.safety_distance_m * low_m
    return math.inf if total > bound else float(total)


TERMS = ("length", "height", "guide", "crash", "radar", "constraints", "to_go")


def terms(x: FloatArray, pack: Pack) -> tuple[float, ...]:
    """`TERMS` of one candidate, unweighted: f1 .. f6, and what is left to fly after the end."""
    scene, control, points = pack.scene, pack.control, pack.points
    each = flight.PER_SAMPLE / (len(points) - 1)
    place_control_points(x, control, scene)
    sample(points, control, pack.basis)
    per_metre = 100.0 / (2.4 * scene.scan_range_m)
    steered = steering(pack.ahead, control, pack.basis, scene)
    outside = leaving(points, scene) + intruding(points, pack, math.inf)
    low_m = too_low_m(points, scene.surface)
    if scene.limits.hovers:
        low_m += dead_man_m(points, pack.ahead, scene)
    return (
        points[-1, 3] * per_metre,
        height(points, scene),
        guide(control, scene),
        each * flight.CRASH_SCALE / scene.safety_distance_m * low_m,
        each * flight.RADAR_SCALE * detection(points, pack.radars),
        each * (steered + flight.OUTSIDE_SCALE * outside),
        remaining_m(control, scene) * per_metre,
    )


def place_control_points(x: FloatArray, control: FloatArray, scene: FlightScene) -> None:
    """`scene.control_points` of one candidate."""
    count, unit, ahead = len(control), scene.unit_m, scene.ahead_rad
    at, tangent, bend = (
        scene.start.position_nea_m,
        scene.start.tangent_nea,
        scene.start.curvature_nea_1_m,
    )
    r2 = (flight.SHORTEST_R2 + (flight.LONGEST_R2 - flight.SHORTEST_R2) * x[0]) * unit
    s = r2 + (flight.SHORTEST_S + (flight.LONGEST_S - flight.SHORTEST_S) * x[1]) * unit
    for i in range(3):
        control[0, i] = at[i]
        control[1, i] = at[i] + r2 * tangent[i]
        control[2, i] = at[i] + s * tangent[i] + 3.0 * r2 * r2 * bend[i]
    low, high = scene.band_amsl_m
    for k in range(3, count - 1):
        r = (flight.SHORTEST_R + (flight.LONGEST_R - flight.SHORTEST_R) * x[3 * k - 7]) * unit
        phi = ahead + (2.0 * x[3 * k - 6] - 1.0) * flight.SPREAD_RAD
        control[k, 0] = at[0] + r * math.cos(phi)
        control[k, 1] = at[1] + r * math.sin(phi)
        control[k, 2] = low + x[3 * k - 5] * (high - low)
    if scene.is_final:
        assert scene.final_ne_m is not None
        control[count - 1, 0], control[count - 1, 1] = scene.final_ne_m
    else:
        phi = ahead + (2.0 * x[3 * count - 10] - 1.0) * flight.SPREAD_RAD
        control[count - 1, 0] = scene.scan_ne_m[0] + scene.end_radius_m * math.cos(phi)
        control[count - 1, 1] = scene.scan_ne_m[1] + scene.end_radius_m * math.sin(phi)
    control[count - 1, 2] = low + x[3 * count - 9] * (high - low)


def sample(points: FloatArray, control: FloatArray, basis: FloatArray) -> None:
    """Points of the curve, and the length flown at each by chords."""
    flown = 0.0
    for j in range(len(points)):
        north, east, altitude = 0.0, 0.0, 0.0
        for k in range(len(control)):
            north += basis[0, j, k] * control[k, 0]
            east += basis[0, j, k] * control[k, 1]
            altitude += basis[0, j, k] * control[k, 2]
        if j > 0:
            a, b, c = points[j - 1, 0] - north, points[j - 1, 1] - east, points[j - 1, 2] - altitude
            flown += math.sqrt(a * a + b * b + c * c)
        points[j, 0] = north
        points[j, 1] = east
        points[j, 2] = altitude
        points[j, 3] = flown


def remaining_m(control: FloatArray, scene: FlightScene) -> float:
    """What is left to fly, from a place straight on from the end, and the way there and down.

    No less than from the end itself: straight on may be on the far side of a wall.  Where the end
    is too low for what follows, the way about that it takes to climb; the height that what follows
    needs is no height to come down from.
    """
    if scene.is_final:
        return 0.0
    last = len(control) - 1
    north, east = control[last, 0] - control[last - 1, 0], control[last, 1] - control[last - 1, 1]
    scale = scene.look_ahead_m / max(math.sqrt(north * north + east * east), 1e-9)
    there_n, there_e = control[last, 0] + scale * north, control[last, 1] + scale * east
    needed_m = lattice_m(scene.needed, control[last, 0], control[last, 1])
    low, high = scene.band_amsl_m
    above = max(control[last, 2] - low, 0.0) / (high - low)
    asked = max(needed_m - low, 0.0) / (high - low)
    descent_m = scene.descent_m * max(above * above - asked * asked, 0.0)
    climb_m = max(needed_m - control[last, 2], 0.0) / math.tan(scene.limits.climb_angle_rad)
    to_go_m = lattice_m(scene.to_go, there_n, there_e) + scene.look_ahead_m
    here_m = lattice_m(scene.to_go, control[last, 0], control[last, 1])
    return max(to_go_m, here_m) + descent_m + climb_m


def height(points: FloatArray, scene: FlightScene) -> float:
    """Mean altitude over the floor, 100 at the ceiling."""
    total = 0.0
    for j in range(1, len(points)):
        total += max(points[j, 2] - scene.band_amsl_m[0], 0.0)
    return total / (len(points) - 1) * 100.0 / (scene.band_amsl_m[1] - scene.band_amsl_m[0])


def guide(control: FloatArray, scene: FlightScene) -> float:
    """Angle between the end and the guide direction, seen from p_scan."""
    if scene.is_final:
        return 0.0
    last = len(control) - 1
    scan_n, scan_e = scene.scan_ne_m
    bearing = math.atan2(control[last, 1] - scan_e, control[last, 0] - scan_n)
    angle = abs((bearing - scene.guide_rad + math.pi) % (2.0 * math.pi) - math.pi)
    return angle * scene.guide_share * 100.0 / math.pi


def lattice_m(surface: Surface, north_m: float, east_m: float) -> float:
    """`Surface.altitude_m` of one point."""
    vertex, cell_m = surface.vertex_m, surface.cell_m
    u = min(max((north_m - surface.north_min_m) / cell_m, 0.0), vertex.shape[0] - 1.000001)
    v = min(max((east_m - surface.east_min_m) / cell_m, 0.0), vertex.shape[1] - 1.000001)
    i, j = int(u), int(v)
    u -= i
    v -= j
    south = vertex[i, j] + v * (vertex[i, j + 1] - vertex[i, j])
    north = vertex[i + 1, j] + v * (vertex[i + 1, j + 1] - vertex[i + 1, j])
    return float(south + u * (north - south))


def too_low_m(points: FloatArray, surface: Surface) -> float:
    """How far points of the chords lie under the surface, metres in all."""
    total = 0.0
    for j in range(1, len(points)):
        north, east, altitude = points[j - 1, 0], points[j - 1, 1], points[j - 1, 2]
        dn, de, da = points[j, 0] - north, points[j, 1] - east, points[j, 2] - altitude
        for i in range(1, flight.BETWEEN + 1):
            share = i / flight.BETWEEN
            wanted = lattice_m(surface, north + share * dn, east + share * de)
            total += max(wanted - altitude - share * da, 0.0)
    return total / flight.BETWEEN


def dead_man_m(points: FloatArray, ahead: FloatArray, scene: FlightScene) -> float:
    """How far points of the dead-man stretches lie too low, metres in all.

    Towards its end the vehicle flies no faster than it can stop there, and from a hover no faster
    than it can have become; chords stand for the curve.
    """
    total = 0.0
    for j in range(1, len(points), flight.DEAD_MAN_EVERY):
        speed = ending_m_s(scene.motion, points[-1, 3] - points[j, 3])
        if scene.from_rest:
            speed = min(speed, rising_m_s(scene.motion, points[j, 3]))
        reach = flown_on_m(scene.motion, speed)
        dn, de, da = ahead[j, 0], ahead[j, 1], ahead[j, 2]
        reach /= max(math.sqrt(dn * dn + de * de + da * da), 1e-9)
        for half in range(1, 3):
            step = 0.5 * half * reach
            north, east = points[j, 0] + step * dn, points[j, 1] + step * de
            wanted = lattice_m(scene.contact, north, east)
            total += flight.DEAD_MAN_EVERY * max(wanted - points[j, 2] - step * da, 0.0)
    return total


def detection(points: FloatArray, radars: FloatArray) -> float:
    """Eq. 3, summed over samples and radars."""
    total = 0.0
    for i in range(len(radars)):
        north, east, altitude, reach = radars[i, 0], radars[i, 1], radars[i, 2], radars[i, 4]
        scale = 1.0 / (radars[i, 3] * radars[i, 3])
        for j in range(1, len(points)):
            a, b, c = points[j, 0] - north, points[j, 1] - east, points[j, 2] - altitude
            squared = a * a + b * b + c * c
            if squared <= reach * reach:
                ratio = squared * scale
                total += 1.0 / (1.0 + ratio * ratio)
    return total


def steering(
    ahead: FloatArray, control: FloatArray, basis: FloatArray, scene: FlightScene
) -> float:
    """Curvature and steepness beyond the limits, and curvature at all near the end."""
    count = len(ahead) - 1
    near_end = count - round(flight.END_SHARE * count)
    limits = scene.limits
    steepest = limits.climb_angle_rad / scene.margin, limits.dive_angle_rad / scene.margin
    climb, dive = math.tan(steepest[0]), math.tan(steepest[1])
    turning, steep, straight = 0.0, 0.0, 0.0
    for j in range(1, count + 1):
        dn, de, da, ddn, dde = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(len(control)):
            first, second = basis[1, j, k], basis[2, j, k]
            dn += first * control[k, 0]
            de += first * control[k, 1]
            da += first * control[k, 2]
            ddn += second * control[k, 0]
            dde += second * control[k, 1]
        ahead[j, 0] = dn
        ahead[j, 1] = de
        ahead[j, 2] = da
        level = math.sqrt(dn * dn + de * de)
        slow = max(level, 1e-9)
        curvature = abs(dn * dde - de * ddn) / (slow * slow * slow) * limits.turn_radius_m
        turning += min(max(curvature * scene.margin - 1.0, 0.0), flight.MAX_EXCESS)
        if da > climb * level:
            steep += math.atan2(da, level) - steepest[0]
        elif -da > dive * level:
            steep += math.atan2(-da, level) - steepest[1]
        if j > near_end:
            straight += min(curvature, 1.0) ** 2
    result = flight.CURVATURE_SCALE * turning + flight.ANGLE_SCALE * steep
    return result + flight.STRAIGHT_SCALE * straight


def leaving(points: FloatArray, scene: FlightScene) -> float:
    """How far samples lie outside the band or the map, in R / 20."""
    total, limits = 0.0, scene.limits
    low, high = scene.band_amsl_m
    for j in range(1, len(points)):
        north, east, altitude = points[j, 0], points[j, 1], points[j, 2]
        total += max(low - altitude, 0.0) + max(altitude - high, 0.0)
        total += max(limits.north_m[0] - north, 0.0) + max(north - limits.north_m[1], 0.0)
        total += max(limits.east_m[0] - east, 0.0) + max(east - limits.east_m[1], 0.0)
    return total / (scene.scan_range_m / 20.0)


def intruding(points: FloatArray, pack: Pack, most: float) -> float:
    """How far points of the chords lie too near to zones, in clearances; beyond `most` any sum."""
    circles, polygons, clearance_m = pack.zones.circles, len(pack.gaps), pack.scene.clearance_m
    if len(circles) + polygons == 0:
        return 0.0
    total, most = 0.0, most * flight.BETWEEN * clearance_m
    pack.gaps.fill(_FAR)  # of the point before
    for j in range(1, len(points)):
        if total > most:
            break
        dn, de = points[j, 0] - points[j - 1, 0], points[j, 1] - points[j - 1, 1]
        step = math.sqrt(dn * dn + de * de) / flight.BETWEEN + 1e-6
        for k in range(1, flight.BETWEEN + 1):
            share = k / flight.BETWEEN
            north, east = points[j - 1, 0] + share * dn, points[j - 1, 1] + share * de
            for i in range(len(circles)):
                a, b = north - circles[i, 0], east - circles[i, 1]
                gap = circles[i, 3] * (math.sqrt(a * a + b * b) - circles[i, 2])
                total += max(clearance_m - gap, 0.0)
            if polygons > 0 and may_be_near(pack.scene.near_polygons, north, east):
                for i in range(polygons):
                    most_m = pack.gaps[i] + step
                    gap = polygon_at(pack.zones, i, north, east, clearance_m, most_m)
                    total += max(clearance_m - gap, 0.0)
                    pack.gaps[i] = -gap if gap < 0.0 else _FAR
            elif polygons > 0:
                pack.gaps.fill(_FAR)
    return total / (flight.BETWEEN * clearance_m)


def may_be_near(cells: NearCells | None, north: float, east: float) -> bool:
    """Whether zones may be near a point; yes outside of the area."""
    assert cells is not None  # a record always has some
    row = math.floor((north - cells.north_min_m) / cells.cell_m)
    column = math.floor((east - cells.east_min_m) / cells.cell_m)
    if 0 <= row < cells.near.shape[0] and 0 <= column < cells.near.shape[1]:
        return bool(cells.near[row, column])
    return True
