"""The objective of `flight`, one candidate at a time: plain Python that numba compiles as it is.

As soon as the partial sum exceeds a bound above which the search rejects the candidate anyway, the
cost stops and says infinity: every term is at least zero.
"""

import math

import numpy as np

from companion.geodesy import FloatArray
from companion.objective.scene import Scene
from companion.path.envelope import ending_m_s, flown_on_m, rising_m_s
from companion.world.clearance import Surface
from companion.world.zones import NearCells, polygon_at

# Where control points may lie, in units of R or, where the end is nearer, of a little more than the
# way there: as planner-numbers part E measured.
SPREAD_RAD = math.radians(110.0)  # azimuths of control points, to each side of the tangent
SHORTEST_R2, LONGEST_R2 = 0.02, 0.3  # from the first control point to the second
SHORTEST_S, LONGEST_S = 0.02, 0.6  # from there to the third, along the tangent
SHORTEST_R, LONGEST_R = 0.15, 1.0  # from the first to the others
SHORTEST_UNIT = 1e-3  # of R
SHORTEST_END = 0.2  # of the circle's radius
# What the terms are scaled by, so that each comes to about 100 where it ought not to be.
PER_SAMPLE = 10.0  # sums over samples are scaled to the paper's ten
PER_LENGTH = 100.0 / 2.4  # per R of length (paper 2.6: 100 for a control polygon of 2.4 R)
CRASH_SCALE = 100.0  # per d_s below the surface, one sample
RADAR_SCALE = 30.0  # per unit of detection probability of one sample
CURVATURE_SCALE = 100.0  # per unit of curvature in excess, relative to the limit
ANGLE_SCALE = 100.0  # per radian of climb or dive in excess
OUTSIDE_SCALE = 100.0  # per R / 20 outside the band or the map
SHORT_SCALE = 100.0  # per R that it is shorter than the vehicle needs to stop in
STRAIGHT_SCALE = 2.0  # per unit of squared curvature near the end, relative to the limit
GUIDE_SHARE = 0.2  # of a_3 that the angle of eq. 8 keeps: the cost-to-go does the rest
ENDS_SHORT = 0.25  # of what an end lies short of the circle: from there less is seen than is hoped
# Where the curve is looked at.
END_SHARE = 0.25  # of the curve's parameter, counted from its end, that ought to be straight
MAX_EXCESS = 10.0  # of curvature over its limit that counts
DEAD_MAN_EVERY = 2  # samples
BETWEEN = 3  # points a chord at which terrain and zones count: they are met at their corners
_FAR = 1e12  # m: no zone is as far


LENGTH, HEIGHT, GUIDE, CRASH, RADAR, CONSTRAINTS, TO_GO = range(7)  # places of `TERMS`


def cost(x: FloatArray, bound: float, scene: Scene) -> float:
    """Eq. 5 for one candidate, (D,) in the unit cube; infinity if it would exceed the bound.

    Its terms, unweighted, stay in `scene.at.terms`, in the order of `TERMS`.
    """
    a, terms = scene.weights, scene.at.terms
    control, points, ahead = scene.at.control, scene.at.points, scene.at.ahead
    each = PER_SAMPLE / (len(points) - 1)
    place_control_points(x, control, scene)
    sample(points, control, scene.at.basis)
    terms[LENGTH] = points[-1, 3] * PER_LENGTH / scene.scan_range_m
    terms[HEIGHT] = height(points, scene)
    terms[GUIDE] = guide(control, scene)
    terms[TO_GO] = remaining_m(control, scene) * PER_LENGTH / scene.scan_range_m
    total = a[LENGTH] * terms[LENGTH] + a[HEIGHT] * terms[HEIGHT] + a[GUIDE] * terms[GUIDE]
    total += a[TO_GO] * terms[TO_GO]
    if total > bound:
        return math.inf
    terms[RADAR] = each * RADAR_SCALE * detection(points, scene.radars)
    short_m = max(scene.margin * scene.shortest_m - points[-1, 3], 0.0)
    terms[CONSTRAINTS] = PER_SAMPLE * SHORT_SCALE * short_m / scene.scan_range_m
    terms[CONSTRAINTS] += each * steering(ahead, control, scene.at.basis, scene)
    total += a[RADAR] * terms[RADAR] + a[CONSTRAINTS] * terms[CONSTRAINTS]
    if total > bound:
        return math.inf
    outside = leaving(points, scene)
    scale = a[CONSTRAINTS] * each * OUTSIDE_SCALE
    outside += intruding(points, scene, (bound - total) / max(scale, 1e-12) - outside)
    terms[CONSTRAINTS] += each * OUTSIDE_SCALE * outside
    total += scale * outside
    if total > bound:
        return math.inf
    low_m = too_low_m(points, scene.surface)
    if scene.motion.loiter_m == 0.0:  # a plane circles, and its surface stands off by that
        low_m += dead_man_m(points, ahead, scene)
    terms[CRASH] = each * CRASH_SCALE / scene.safety_distance_m * low_m
    total += a[CRASH] * terms[CRASH]
    return math.inf if total > bound else float(total)


def place_control_points(x: FloatArray, control: FloatArray, scene: Scene) -> None:
    """Control points of a candidate.  (D,) in the unit cube -> into (points, 3).

    The second at r2 along the tangent; the third at s along it and 3 r2^2 k off it, k the
    curvature vector at p_prog (part E: with uniform inner knots, that continues the curvature);
    the others at (r, phi, z) about p_prog; the last in the circle about p_scan, or at the target.
    From rest the bearing of the tangent is a variable, too.
    """
    last = len(control) - 1
    at, bend = scene.start[0], scene.start[2]
    tangent = (scene.start[1, 0], scene.start[1, 1], scene.start[1, 2])
    height, free = 3 * last - 7, 3 * last - 6
    if scene.from_rest:
        bearing = scene.guide_rad + (2.0 * x[free] - 1.0) * math.pi
        free += 1
        tangent = (math.cos(bearing), math.sin(bearing), 0.0)
    azimuth = math.atan2(tangent[1], tangent[0])
    if scene.is_final:
        control[last, 0], control[last, 1] = scene.final_ne_m
        unit = math.hypot(control[last, 0] - at[0], control[last, 1] - at[1])
    else:
        phi = azimuth + (2.0 * x[free] - 1.0) * SPREAD_RAD
        r = (SHORTEST_END + (1.0 - SHORTEST_END) * x[free + 1]) * scene.end_radius_m
        control[last, 0] = scene.scan_ne_m[0] + r * math.cos(phi)
        control[last, 1] = scene.scan_ne_m[1] + r * math.sin(phi)
        unit = 1.1 * r
    unit = min(max(unit, SHORTEST_UNIT * scene.scan_range_m), scene.scan_range_m)
    r2 = (SHORTEST_R2 + (LONGEST_R2 - SHORTEST_R2) * x[0]) * unit
    s = r2 + (SHORTEST_S + (LONGEST_S - SHORTEST_S) * x[1]) * unit
    for i in range(3):
        control[0, i] = at[i]
        control[1, i] = at[i] + r2 * tangent[i]
        control[2, i] = at[i] + s * tangent[i] + 3.0 * r2 * r2 * bend[i]
    low, high = scene.band_amsl_m
    for k in range(3, last):
        r = (SHORTEST_R + (LONGEST_R - SHORTEST_R) * x[3 * k - 7]) * unit
        phi = azimuth + (2.0 * x[3 * k - 6] - 1.0) * SPREAD_RAD
        control[k, 0] = at[0] + r * math.cos(phi)
        control[k, 1] = at[1] + r * math.sin(phi)
        control[k, 2] = low + x[3 * k - 5] * (high - low)
    control[last, 2] = low + x[height] * (high - low)


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


def remaining_m(control: FloatArray, scene: Scene) -> float:
    """What is left to fly, from a place straight on from the end, and the way there and down.

    No less than from the end itself: straight on may be on the far side of a wall.  Where the end
    is too low for what follows, the way about that it takes to climb; the height that what follows
    needs is no height to come down from.
    """
    if scene.is_final:
        return 0.0
    last = len(control) - 1
    north, east = control[last, 0] - control[last - 1, 0], control[last, 1] - control[last - 1, 1]
    ahead_m = scene.motion.turn_radius_m  # so far: an end that faces terrain is dear
    scale = ahead_m / max(math.sqrt(north * north + east * east), 1e-9)
    there_n, there_e = control[last, 0] + scale * north, control[last, 1] + scale * east
    needed_m = lattice_m(scene.needed, control[last, 0], control[last, 1])
    low, high = scene.band_amsl_m
    above = max(control[last, 2] - low, 0.0) / (high - low)
    asked = max(needed_m - low, 0.0) / (high - low)
    descent_m = scene.descent_m * max(above * above - asked * asked, 0.0)
    climb_m = max(needed_m - control[last, 2], 0.0) / math.tan(scene.motion.climb_angle_rad)
    to_go_m = lattice_m(scene.to_go, there_n, there_e) + ahead_m
    here_m = lattice_m(scene.to_go, control[last, 0], control[last, 1])
    a, b = control[last, 0] - scene.scan_ne_m[0], control[last, 1] - scene.scan_ne_m[1]
    short_m = scene.end_radius_m - math.sqrt(a * a + b * b)
    return max(to_go_m, here_m) + descent_m + climb_m + ENDS_SHORT * max(short_m, 0.0)


def height(points: FloatArray, scene: Scene) -> float:
    """Mean altitude over the floor, 100 at the ceiling."""
    total = 0.0
    for j in range(1, len(points)):
        total += max(points[j, 2] - scene.band_amsl_m[0], 0.0)
    return total / (len(points) - 1) * 100.0 / (scene.band_amsl_m[1] - scene.band_amsl_m[0])


def guide(control: FloatArray, scene: Scene) -> float:
    """Angle between the end and the guide direction, seen from p_scan."""
    if scene.is_final:
        return 0.0
    last = len(control) - 1
    scan_n, scan_e = scene.scan_ne_m
    bearing = math.atan2(control[last, 1] - scan_e, control[last, 0] - scan_n)
    angle = abs((bearing - scene.guide_rad + math.pi) % (2.0 * math.pi) - math.pi)
    return angle * GUIDE_SHARE * 100.0 / math.pi


def lattice_m(surface: Surface, north_m: float, east_m: float) -> float:
    """Value at a point, bilinear; clamped at the edges."""
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
        for i in range(1, BETWEEN + 1):
            share = i / BETWEEN
            wanted = lattice_m(surface, north + share * dn, east + share * de)
            total += max(wanted - altitude - share * da, 0.0)
    return total / BETWEEN


def dead_man_m(points: FloatArray, ahead: FloatArray, scene: Scene) -> float:
    """How far points of the dead-man stretches lie too low, metres in all.

    Towards its end the vehicle flies no faster than it can stop there, and from a hover no faster
    than it can have become; chords stand for the curve.
    """
    total = 0.0
    for j in range(1, len(points), DEAD_MAN_EVERY):
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
            total += DEAD_MAN_EVERY * max(wanted - points[j, 2] - step * da, 0.0)
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


def steering(ahead: FloatArray, control: FloatArray, basis: FloatArray, scene: Scene) -> float:
    """Curvature and steepness beyond the limits, and curvature at all near the end."""
    count = len(ahead) - 1
    near_end = count - round(END_SHARE * count)
    motion = scene.motion
    steepest = motion.climb_angle_rad / scene.margin, motion.dive_angle_rad / scene.margin
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
        curvature = abs(dn * dde - de * ddn) / (slow * slow * slow) * motion.turn_radius_m
        turning += min(max(curvature * scene.margin - 1.0, 0.0), MAX_EXCESS)
        if da > climb * level:
            steep += math.atan2(da, level) - steepest[0]
        elif -da > dive * level:
            steep += math.atan2(-da, level) - steepest[1]
        if j > near_end:
            straight += min(curvature, 1.0) ** 2
    result = CURVATURE_SCALE * turning + ANGLE_SCALE * steep
    return result + STRAIGHT_SCALE * straight


def leaving(points: FloatArray, scene: Scene) -> float:
    """How far samples lie outside the band or the map, in R / 20."""
    total = 0.0
    for j in range(1, len(points)):
        total += beyond(points[j, 2], scene.band_amsl_m)
        total += beyond(points[j, 0], scene.north_m) + beyond(points[j, 1], scene.east_m)
    return total / (scene.scan_range_m / 20.0)


def beyond(value: float, bounds: tuple[float, float]) -> float:
    """How far a value lies outside of bounds."""
    return max(bounds[0] - value, 0.0) + max(value - bounds[1], 0.0)


def intruding(points: FloatArray, scene: Scene, most: float) -> float:
    """How far points of the chords lie too near to zones, in clearances; beyond `most` any sum."""
    circles, polygons, clearance_m = scene.zones.circles, len(scene.at.gaps), scene.clearance_m
    if len(circles) + polygons == 0:
        return 0.0
    total, most = 0.0, most * BETWEEN * clearance_m
    scene.at.gaps.fill(_FAR)  # of the point before
    for j in range(1, len(points)):
        if total > most:
            break
        dn, de = points[j, 0] - points[j - 1, 0], points[j, 1] - points[j - 1, 1]
        step = math.sqrt(dn * dn + de * de) / BETWEEN + 1e-6
        for k in range(1, BETWEEN + 1):
            share = k / BETWEEN
            north, east = points[j - 1, 0] + share * dn, points[j - 1, 1] + share * de
            for i in range(len(circles)):
                a, b = north - circles[i, 0], east - circles[i, 1]
                gap = circles[i, 3] * (math.sqrt(a * a + b * b) - circles[i, 2])
                total += max(clearance_m - gap, 0.0)
            if polygons > 0 and may_be_near(scene.near_polygons, north, east):
                for i in range(polygons):
                    most_m = scene.at.gaps[i] + step
                    gap = polygon_at(scene.zones, i, north, east, clearance_m, most_m)
                    total += max(clearance_m - gap, 0.0)
                    scene.at.gaps[i] = -gap if gap < 0.0 else _FAR
            elif polygons > 0:
                scene.at.gaps.fill(_FAR)
    return total / (BETWEEN * clearance_m)


def may_be_near(cells: NearCells, north: float, east: float) -> bool:
    """Whether zones may be near a point; yes outside of the area."""
    row = math.floor((north - cells.north_min_m) / cells.cell_m)
    column = math.floor((east - cells.east_min_m) / cells.cell_m)
    if 0 <= row < cells.near.shape[0] and 0 <= column < cells.near.shape[1]:
        return bool(cells.near[row, column])
    return True


def control_points(x: FloatArray, scene: Scene) -> FloatArray:
    """Control points of one candidate.  (D,) in the unit cube -> (points, 3)."""
    control = np.empty((scene.points, 3))
    place_control_points(x, control, scene)
    return control
