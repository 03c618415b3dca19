"""The objective of `flight`, one candidate at a time: what numba compiles.

The same sums as `flight.cost`, in plain loops over a pack of arrays; as soon as the partial sum
exceeds a bound above which the search rejects the candidate anyway, it stops and says infinity
(every term is at least zero).
"""

import math
from typing import NamedTuple

import numpy as np

from companion.geodesy import BoolArray, FloatArray
from companion.objective import flight
from companion.objective.flight import FlightScene
from companion.path.bspline import uniform_basis
from companion.path.certificate import pack_zones
from companion.path.proof_distance import ZoneTable, polygon_at

_SPREAD = flight.SPREAD_RAD
_FAR = 1e12


class Pack(NamedTuple):
    """A `FlightScene` as numba takes it."""

    basis: FloatArray  # (3, S + 1, points): values, first and second derivatives
    start: FloatArray  # (3, 3): position, tangent, curvature
    numbers: FloatArray  # by the names below
    weights: FloatArray  # (7,), by flight.TERMS
    surface: FloatArray  # vertices of the lattices; where they lie is among the numbers
    contact: FloatArray
    to_go: FloatArray
    needed: FloatArray
    radars: FloatArray  # (n, 5): north, east, altitude, range, range and margin
    zones: ZoneTable
    gaps: FloatArray  # (n,), workspace: distance of the point before from each polygon
    near: BoolArray  # cells in which polygons need be looked at; of no size: everywhere
    control: FloatArray  # (points, 3), workspace
    points: FloatArray  # (S + 1, 4), workspace: position and length flown
    ahead: FloatArray  # (S + 1, 3), workspace: first derivatives


# Pack.numbers
UNIT, AHEAD, FROM_REST, RANGE, LOOK_AHEAD, SAFETY, CLEARANCE, MARGIN = range(8)
SCAN_N, SCAN_E, END_RADIUS, IS_FINAL, FINAL_N, FINAL_E, GUIDE = range(8, 15)
LOW, HIGH, SOUTH, NORTH, WEST, EAST = range(15, 21)
TURN_RADIUS, CLIMB, DIVE, SPEED, ACCELERATION, DEAD_MAN_S, GUIDE_SHARE = range(21, 28)
SURFACE_AT, CONTACT_AT, TO_GO_AT, NEEDED_AT = range(28, 40, 3)  # SW vertex north, east, and cell
NEAR_AT = 40  # likewise, of the cells' corner
DESCENT, STEEPEST = 43, 44
_COUNT = 45


def pack(scene: FlightScene) -> Pack:
    """The scene as plain arrays."""
    at = uniform_basis(scene.samples, scene.points)
    start = scene.start
    zones = pack_zones(scene.zones)
    near = np.empty((0, 0), dtype=bool)
    if scene.near_polygons is not None:
        near = scene.near_polygons.near
    margin_m = scene.radar_margin_m
    return Pack(
        basis=np.stack([at.value, at.first, at.second]),
        start=np.stack([start.position_nea_m, start.tangent_nea, start.curvature_nea_1_m]),
        numbers=_numbers(scene),
        weights=np.array([flight.weight(name, scene) for name in flight.TERMS]),
        surface=np.ascontiguousarray(scene.surface.vertex_m),
        contact=np.ascontiguousarray(scene.contact.vertex_m),
        to_go=np.ascontiguousarray(scene.to_go.vertex_m),
        needed=np.ascontiguousarray(scene.needed.vertex_m),
        radars=_rows([[*r.centre_nea_m, r.range_m, r.range_m + margin_m] for r in scene.radars], 5),
        zones=zones,
        gaps=np.empty(len(zones.polygons)),
        near=near,
        control=np.empty((scene.points, 3)),
        points=np.empty((scene.samples + 1, 4)),
        ahead=np.empty((scene.samples + 1, 3)),
    )


def _numbers(scene: FlightScene) -> FloatArray:
    limits = scene.limits
    numbers = np.empty(_COUNT)
    numbers[UNIT:SCAN_N] = (
        scene.unit_m,
        scene.ahead_rad,
        scene.from_rest,
        scene.scan_range_m,
        scene.look_ahead_m,
        scene.safety_distance_m,
        scene.clearance_m,
        scene.margin,
    )
    final = scene.final_ne_m
    numbers[SCAN_N:LOW] = (
        *scene.scan_ne_m,
        scene.end_radius_m,
        final is not None,
        *(final or (0.0, 0.0)),
        scene.guide_rad,
    )
    numbers[LOW:TURN_RADIUS] = *scene.band_amsl_m, *limits.north_m, *limits.east_m
    numbers[TURN_RADIUS:SURFACE_AT] = (
        limits.turn_radius_m,
        limits.climb_angle_rad / scene.margin,
        limits.dive_angle_rad / scene.margin,
        limits.speed_m_s,
        limits.acceleration_m_s2,
        limits.dead_man_s if limits.hovers else -1.0,
        scene.guide_share,
    )
    lattices = (scene.surface, scene.contact, scene.to_go, scene.needed)
    numbers[SURFACE_AT:NEAR_AT] = [
        v for s in lattices for v in (s.north_min_m, s.east_min_m, s.cell_m)
    ]
    near, numbers[NEAR_AT:DESCENT] = scene.near_polygons, 1.0
    if near is not None:
        numbers[NEAR_AT:DESCENT] = near.north_min_m, near.east_min_m, near.cell_m
    numbers[DESCENT], numbers[STEEPEST] = scene.descent_m, math.tan(limits.climb_angle_rad)
    return numbers


def _rows(rows: list[list[float]], columns: int) -> FloatArray:
    return np.array(rows, dtype=np.float64).reshape(len(rows), columns)


def cost(x: FloatArray, bound: float, pack: Pack) -> float:
    """Eq. 5 for one candidate, (D,) in the unit cube; infinity if it would exceed the bound."""
    numbers, weights, control, points = pack.numbers, pack.weights, pack.control, pack.points
    each = flight.PER_SAMPLE / (len(points) - 1)
    place_control_points(x, control, pack.start, numbers)
    sample(points, control, pack.basis)
    to_go_m = remaining_m(control, pack.to_go, pack.needed, numbers)
    per_metre = 100.0 / (2.4 * numbers[RANGE])
    total = weights[0] * points[-1, 3] * per_metre + weights[6] * to_go_m * per_metre
    total += weights[1] * height(points, numbers) + weights[2] * guide(control, numbers)
    if total > bound:
        return math.inf
    total += weights[4] * each * flight.RADAR_SCALE * detection(points, pack.radars)
    total += weights[5] * each * steering(pack.ahead, control, pack.basis, numbers)
    if total > bound:
        return math.inf
    scale = weights[5] * each * flight.OUTSIDE_SCALE
    total += scale * leaving(points, numbers)
    total += scale * intruding(points, pack, numbers, (bound - total) / max(scale, 1e-12))
    if total > bound:
        return math.inf
    low_m = too_low_m(points, pack.surface, numbers)
    if numbers[DEAD_MAN_S] >= 0.0:  # a plane circles, and its surface stands off by that
        low_m += dead_man_m(points, pack.ahead, pack.contact, numbers)
    total += weights[3] * each * flight.CRASH_SCALE / numbers[SAFETY] * low_m
    return math.inf if total > bound else float(total)


def place_control_points(
    x: FloatArray, control: FloatArray, start: FloatArray, numbers: FloatArray
) -> None:
    """`flight.control_points` of one candidate."""
    count, unit, ahead = len(control), numbers[UNIT], numbers[AHEAD]
    r2 = (flight.SHORTEST_R2 + (flight.LONGEST_R2 - flight.SHORTEST_R2) * x[0]) * unit
    s = r2 + (flight.SHORTEST_S + (flight.LONGEST_S - flight.SHORTEST_S) * x[1]) * unit
    for i in range(3):
        control[0, i] = start[0, i]
        control[1, i] = start[0, i] + r2 * start[1, i]
        control[2, i] = start[0, i] + s * start[1, i] + 3.0 * r2 * r2 * start[2, i]
    low, high = numbers[LOW], numbers[HIGH]
    for k in range(3, count - 1):
        r = (flight.SHORTEST_R + (flight.LONGEST_R - flight.SHORTEST_R) * x[3 * k - 7]) * unit
        phi = ahead + (2.0 * x[3 * k - 6] - 1.0) * _SPREAD
        control[k, 0] = start[0, 0] + r * math.cos(phi)
        control[k, 1] = start[0, 1] + r * math.sin(phi)
        control[k, 2] = low + x[3 * k - 5] * (high - low)
    if numbers[IS_FINAL] > 0.0:
        control[count - 1, 0] = numbers[FINAL_N]
        control[count - 1, 1] = numbers[FINAL_E]
    else:
        phi = ahead + (2.0 * x[3 * count - 10] - 1.0) * _SPREAD
        control[count - 1, 0] = numbers[SCAN_N] + numbers[END_RADIUS] * math.cos(phi)
        control[count - 1, 1] = numbers[SCAN_E] + numbers[END_RADIUS] * math.sin(phi)
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


def remaining_m(
    control: FloatArray, to_go: FloatArray, needed: FloatArray, numbers: FloatArray
) -> float:
    """`flight._to_go_m` of one candidate."""
    if numbers[IS_FINAL] > 0.0:
        return 0.0
    last = len(control) - 1
    north, east = control[last, 0] - control[last - 1, 0], control[last, 1] - control[last - 1, 1]
    scale = numbers[LOOK_AHEAD] / max(math.sqrt(north * north + east * east), 1e-9)
    there_n, there_e = control[last, 0] + scale * north, control[last, 1] + scale * east
    needed_m = lattice_m(needed, numbers, NEEDED_AT, control[last, 0], control[last, 1])
    band_m = numbers[HIGH] - numbers[LOW]
    above = max(control[last, 2] - numbers[LOW], 0.0) / band_m
    asked = max(needed_m - numbers[LOW], 0.0) / band_m
    descent_m = numbers[DESCENT] * max(above * above - asked * asked, 0.0)
    climb_m = max(needed_m - control[last, 2], 0.0) / numbers[STEEPEST]
    to_go_m = lattice_m(to_go, numbers, TO_GO_AT, there_n, there_e) + numbers[LOOK_AHEAD]
    here_m = lattice_m(to_go, numbers, TO_GO_AT, control[last, 0], control[last, 1])
    return max(to_go_m, here_m) + descent_m + climb_m


def height(points: FloatArray, numbers: FloatArray) -> float:
    """Mean altitude over the floor, 100 at the ceiling."""
    total = 0.0
    for j in range(1, len(points)):
        total += max(points[j, 2] - numbers[LOW], 0.0)
    return total / (len(points) - 1) * 100.0 / (numbers[HIGH] - numbers[LOW])


def guide(control: FloatArray, numbers: FloatArray) -> float:
    """Angle between the end and the guide direction, seen from p_scan."""
    if numbers[IS_FINAL] > 0.0:
        return 0.0
    last = len(control) - 1
    bearing = math.atan2(control[last, 1] - numbers[SCAN_E], control[last, 0] - numbers[SCAN_N])
    angle = abs((bearing - numbers[GUIDE] + math.pi) % (2.0 * math.pi) - math.pi)
    return angle * numbers[GUIDE_SHARE] * 100.0 / math.pi


def lattice_m(
    vertex: FloatArray, numbers: FloatArray, at: int, north_m: float, east_m: float
) -> float:
    """Bilinear value of a lattice, clamped at its edges."""
    u = min(max((north_m - numbers[at]) / numbers[at + 2], 0.0), vertex.shape[0] - 1.000001)
    v = min(max((east_m - numbers[at + 1]) / numbers[at + 2], 0.0), vertex.shape[1] - 1.000001)
    i, j = int(u), int(v)
    u -= i
    v -= j
    south = vertex[i, j] + v * (vertex[i, j + 1] - vertex[i, j])
    north = vertex[i + 1, j] + v * (vertex[i + 1, j + 1] - vertex[i + 1, j])
    return float(south + u * (north - south))


def too_low_m(points: FloatArray, surface: FloatArray, numbers: FloatArray) -> float:
    """How far points of the chords lie under the surface, metres in all."""
    total = 0.0
    for j in range(1, len(points)):
        north, east, altitude = points[j - 1, 0], points[j - 1, 1], points[j - 1, 2]
        dn, de, da = points[j, 0] - north, points[j, 1] - east, points[j, 2] - altitude
        for i in range(1, flight.BETWEEN + 1):
            share = i / flight.BETWEEN
            wanted = lattice_m(surface, numbers, SURFACE_AT, north + share * dn, east + share * de)
            total += max(wanted - altitude - share * da, 0.0)
    return total / flight.BETWEEN


def dead_man_m(
    points: FloatArray, ahead: FloatArray, contact: FloatArray, numbers: FloatArray
) -> float:
    """How far points of the dead-man stretches lie too low, metres in all."""
    total = 0.0
    for j in range(1, len(points), flight.DEAD_MAN_EVERY):
        room = points[-1, 3] - points[j, 3]
        if numbers[FROM_REST] > 0.0:
            room = min(room, points[j, 3])
        speed = min(math.sqrt(2.0 * numbers[ACCELERATION] * room), numbers[SPEED])
        reach = speed * numbers[DEAD_MAN_S] + speed * speed / (2.0 * numbers[ACCELERATION])
        dn, de, da = ahead[j, 0], ahead[j, 1], ahead[j, 2]
        reach /= max(math.sqrt(dn * dn + de * de + da * da), 1e-9)
        for half in range(1, 3):
            step = 0.5 * half * reach
            north, east = points[j, 0] + step * dn, points[j, 1] + step * de
            wanted = lattice_m(contact, numbers, CONTACT_AT, north, east)
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
    ahead: FloatArray, control: FloatArray, basis: FloatArray, numbers: FloatArray
) -> float:
    """Curvature and steepness beyond the limits, and curvature at all near the end."""
    count = len(ahead) - 1
    near_end = count - round(flight.END_SHARE * count)
    climb, dive = math.tan(numbers[CLIMB]), math.tan(numbers[DIVE])
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
        curvature = abs(dn * dde - de * ddn) / (slow * slow * slow) * numbers[TURN_RADIUS]
        turning += min(max(curvature * numbers[MARGIN] - 1.0, 0.0), flight.MOST_EXCESS)
        if da > climb * level:
            steep += math.atan2(da, level) - numbers[CLIMB]
        elif -da > dive * level:
            steep += math.atan2(-da, level) - numbers[DIVE]
        if j > near_end:
            straight += min(curvature, 1.0) ** 2
    result = flight.CURVATURE_SCALE * turning + flight.ANGLE_SCALE * steep
    return result + flight.STRAIGHT_SCALE * straight


def leaving(points: FloatArray, numbers: FloatArray) -> float:
    """How far samples lie outside the band or the map, in R / 20."""
    total = 0.0
    for j in range(1, len(points)):
        north, east, altitude = points[j, 0], points[j, 1], points[j, 2]
        total += max(numbers[LOW] - altitude, 0.0) + max(altitude - numbers[HIGH], 0.0)
        total += max(numbers[SOUTH] - north, 0.0) + max(north - numbers[NORTH], 0.0)
        total += max(numbers[WEST] - east, 0.0) + max(east - numbers[EAST], 0.0)
    return total / (numbers[RANGE] / 20.0)


def intruding(points: FloatArray, pack: Pack, numbers: FloatArray, most: float) -> float:
    """How far points of the chords lie too near to zones, in clearances; beyond `most` any sum."""
    circles, polygons, clearance_m = pack.zones.circles, len(pack.gaps), numbers[CLEARANCE]
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
            if polygons > 0 and may_be_near(pack.near, numbers, north, east):
                for i in range(polygons):
                    most_m = pack.gaps[i] + step
                    gap = polygon_at(pack.zones, i, north, east, clearance_m, most_m)
                    total += max(clearance_m - gap, 0.0)
                    pack.gaps[i] = -gap if gap < 0.0 else _FAR
            elif polygons > 0:
                pack.gaps.fill(_FAR)
    return total / (flight.BETWEEN * clearance_m)


def may_be_near(near: BoolArray, numbers: FloatArray, north: float, east: float) -> bool:
    """`NearCells.at` of one point."""
    row = math.floor((north - numbers[NEAR_AT]) / numbers[NEAR_AT + 2])
    column = math.floor((east - numbers[NEAR_AT + 1]) / numbers[NEAR_AT + 2])
    if 0 <= row < near.shape[0] and 0 <= column < near.shape[1]:
        return bool(near[row, column])
    return True
