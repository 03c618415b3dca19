"""The objective of profile `flight`: what one candidate subpath costs, and all that it depends on.

What differs from the paper as printed (`paper.terms`), and why, is in design 5.2; how control
points are drawn from the search's variables, in `planner-numbers`, part E.

From `cost` on it is plain Python that numba compiles as it is (`companion.jit`), one candidate at a
time.  As soon as the partial sum exceeds a bound above which the search rejects the candidate
anyway, the cost stops and says infinity: every term is at least zero.

One more term is a row of `Weights`, from which the key of the mission file, journal, report, view
and figures derive, and here its number and its line in `cost`; what it has to know of the map is a
field of `Scene`, filled in by `planner.searches`.  If a metre of the way on has a price by it, that
is in `planner.cost_grid` and `planner.price`: without it that is planned badly.
"""

import math
from dataclasses import fields
from typing import NamedTuple

import numpy as np

from companion.geodesy import FloatArray
from companion.path.envelope import SLOWEST, Envelope, ending_m_s, flown_on_m, rising_m_s
from companion.path.subpath import Pose, uniform_basis
from companion.profiles import Weights
from companion.world.columns import Surface
from companion.world.radars import Radar
from companion.world.zones import NearCells, ZoneTable, polygon_at

TERMS = (*(weight.name for weight in fields(Weights)), "to_go")
"""Names of the terms of the cost; what is left to fly after the end weighs as much as length."""
LENGTH, HEIGHT, GUIDE, CRASH, RADAR, CONSTRAINTS, TO_GO = range(len(TERMS))

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
_SURELY = 1.0 + 1e-9  # times a bound: a sum beyond exceeds it however it is rounded


class Workspace(NamedTuple):
    """The shape of a curve of so many control points, and room for one candidate."""

    basis: FloatArray  # (3, S + 1, points): values, first and second derivatives
    control: FloatArray  # (points, 3)
    curve: FloatArray  # (3, S + 1, 3): as of the basis
    flown_m: FloatArray  # (S + 1,): up to each sample, by chords
    terms: FloatArray  # (TERMS,): unweighted, of the candidate before
    gaps_m: FloatArray  # (polygons,): distance of the point before from each

    @staticmethod
    def of(points: int, samples: int, polygons: int) -> "Workspace":
        """For curves of so many control points, looked at in so many samples."""
        basis = np.stack(uniform_basis(samples, points))
        sizes = (points, 3), (3, samples + 1, 3), (samples + 1,), (len(TERMS),), (polygons,)
        return Workspace(basis, *map(np.zeros, sizes))


class Scene(NamedTuple):
    """Everything that the cost of one subpath depends on, as numba takes it.

    Positions are north, east, altitude AMSL; metres, radians.
    """

    weights: tuple[float, ...]  # of `TERMS`
    motion: Envelope
    margin: float  # on the turn radius and on the steepness, a factor that the search aims at
    start: FloatArray  # (3, 3): p_prog, the tangent and the curvature there
    from_rest: bool  # from a hover: slow at first, and in any direction
    shortest_m: float  # the least length: in flight, what the vehicle stops in
    scan_ne_m: tuple[float, float]  # p_scan: the centre of the circle in which the subpath ends
    scan_range_m: float  # R, the unit of distances along the curve
    end_radius_m: float  # of that circle: so much of R that d_s is kept inside
    is_final: bool  # it ends at the target
    final_ne_m: tuple[float, float]  # the target
    guide_rad: float  # bearing of the guide direction from p_scan
    to_go: Surface  # cost to the target from each place, in metres of level flight at the floor
    needed: Surface  # the lowest altitude from which the way on can be climbed, AMSL
    descent_m: float  # cost of coming down from ceiling to floor, in metres of level flight
    safety_distance_m: float  # d_s
    clearance_m: float  # what the search keeps from zones
    surface: Surface  # the altitude that keeps the clearance from the terrain
    contact: Surface  # the altitude that the dead-man stretch must keep
    band_amsl_m: tuple[float, float]  # to plan in: the vehicle on the path stays within limits
    north_m: tuple[float, float]  # southern and northern edge of the map
    east_m: tuple[float, float]
    radars: FloatArray  # (n, 5): north, east, altitude, range, range and margin
    zones: ZoneTable
    near_polygons: NearCells
    at: Workspace

    @property
    def points(self) -> int:
        """Control points: five, or six where five find nothing."""
        return len(self.at.control)

    @property
    def variables(self) -> int:
        """r2, s; r, phi, z of each point between; z of the end.

        Then from rest the bearing of the tangent; and phi, r of the end if it is not the target.
        """
        return 3 * self.points - 9 + self.from_rest + 2 * (not self.is_final)

    def with_points(self, count: int) -> "Scene":
        """The scene for curves of so many control points."""
        samples, polygons = len(self.at.flown_m) - 1, len(self.at.gaps_m)
        return self._replace(at=Workspace.of(count, samples, polygons))

    def control_points(self, x: FloatArray) -> FloatArray:
        """Those of one candidate.  (D,) in the unit cube -> (points, 3)."""
        place_control_points(x, self)
        return self.at.control.copy()


def weights_of(weights: Weights) -> tuple[float, ...]:
    """Of `TERMS`."""
    return tuple(float(getattr(weights, "length" if n == "to_go" else n)) for n in TERMS)


def rows_of(pose: Pose) -> FloatArray:
    """Position, tangent and curvature.  -> (3, 3)."""
    return np.stack([pose.position_nea_m, pose.tangent_nea, pose.curvature_nea_1_m]).astype(float)


def radar_table(radars: tuple[Radar, ...], margin_m: float) -> FloatArray:
    """Radars as `Scene.radars`; margin_m: beyond their range, for what lies between samples."""
    rows = [(*radar.centre_nea_m, radar.range_m, radar.range_m + margin_m) for radar in radars]
    return np.array(rows, dtype=np.float64).reshape(-1, 5)


# --- what is compiled


def cost(x: FloatArray, bound: float, scene: Scene) -> float:
    """Eq. 5 for one candidate, (D,) in the unit cube; infinity if it would exceed the bound.

    Its terms, unweighted, stay in `scene.at.terms`, in the order of `TERMS`.
    """
    a, at, terms, r = scene.weights, scene.at, scene.at.terms, scene.scan_range_m
    per_sample = PER_SAMPLE / (len(at.flown_m) - 1)
    place_control_points(x, scene)
    evaluate(0, at)
    measure(at)
    terms[LENGTH] = at.flown_m[-1] * PER_LENGTH / r
    terms[HEIGHT] = height(scene)
    terms[GUIDE] = guide(scene)
    terms[TO_GO] = remaining_m(scene) * PER_LENGTH / r
    total = a[LENGTH] * terms[LENGTH] + a[HEIGHT] * terms[HEIGHT] + a[GUIDE] * terms[GUIDE]
    total += a[TO_GO] * terms[TO_GO]
    if total > bound:
        return math.inf
    evaluate(1, at)
    evaluate(2, at)
    steered, slower_m = steering(scene)
    terms[LENGTH] += slower_m * PER_LENGTH / r
    total += a[LENGTH] * slower_m * PER_LENGTH / r
    short_m = max(scene.margin * scene.shortest_m - at.flown_m[-1], 0.0)
    terms[RADAR] = per_sample * RADAR_SCALE * detection(scene)
    terms[CONSTRAINTS] = PER_SAMPLE * SHORT_SCALE * short_m / r + per_sample * steered
    total += a[RADAR] * terms[RADAR] + a[CONSTRAINTS] * terms[CONSTRAINTS]
    if total > bound:
        return math.inf
    scale, outside = a[CONSTRAINTS] * per_sample * OUTSIDE_SCALE, leaving(scene)
    outside += intruding(scene, (bound - total) / max(scale, 1e-12) - outside)
    terms[CONSTRAINTS] += per_sample * OUTSIDE_SCALE * outside
    total += scale * outside
    if total > bound:
        return math.inf
    scale = per_sample * CRASH_SCALE / scene.safety_distance_m
    most_m = _SURELY * (bound - total) / max(a[CRASH] * scale, 1e-12)
    low_m = too_low_m(scene, most_m)
    if scene.motion.loiter_m == 0.0:  # a plane circles, and its surface stands off by that
        low_m += dead_man_m(scene, most_m - low_m)
    terms[CRASH] = scale * low_m
    total += a[CRASH] * terms[CRASH]
    return math.inf if total > bound else float(total)


def place_control_points(x: FloatArray, scene: Scene) -> None:
    """Place the control points of a candidate, (D,) in the unit cube.

    The second at r2 along the tangent; the third at s along it and 3 r2^2 k off it, k the
    curvature vector at p_prog (part E: with uniform inner knots, that continues the curvature);
    the others at (r, phi, z) about p_prog; the last in the circle about p_scan, or at the target.
    From rest the bearing of the tangent is a variable, too.
    """
    control, at, bend = scene.at.control, scene.start[0], scene.start[2]
    last, (low, high) = len(control) - 1, scene.band_amsl_m
    free = 3 * last - 6  # the first variable that not all candidates have
    tangent = (scene.start[1, 0], scene.start[1, 1], scene.start[1, 2])
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
    control[last, 2] = low + x[3 * last - 7] * (high - low)
    unit = min(max(unit, SHORTEST_UNIT * scene.scan_range_m), scene.scan_range_m)
    r2 = (SHORTEST_R2 + (LONGEST_R2 - SHORTEST_R2) * x[0]) * unit
    s = r2 + (SHORTEST_S + (LONGEST_S - SHORTEST_S) * x[1]) * unit
    for i in range(3):
        control[0, i] = at[i]
        control[1, i] = at[i] + r2 * tangent[i]
        control[2, i] = at[i] + s * tangent[i] + 3.0 * r2 * r2 * bend[i]
    for k in range(3, last):
        r = (SHORTEST_R + (LONGEST_R - SHORTEST_R) * x[3 * k - 7]) * unit
        phi = azimuth + (2.0 * x[3 * k - 6] - 1.0) * SPREAD_RAD
        control[k, 0] = at[0] + r * math.cos(phi)
        control[k, 1] = at[1] + r * math.sin(phi)
        control[k, 2] = low + x[3 * k - 5] * (high - low)


def evaluate(derivative: int, at: Workspace) -> None:
    """Compute the curve, or a derivative by its parameter, at all samples."""
    for j in range(len(at.flown_m)):
        north, east, altitude = 0.0, 0.0, 0.0
        for k in range(len(at.control)):
            share = at.basis[derivative, j, k]
            north += share * at.control[k, 0]
            east += share * at.control[k, 1]
            altitude += share * at.control[k, 2]
        at.curve[derivative, j, 0] = north
        at.curve[derivative, j, 1] = east
        at.curve[derivative, j, 2] = altitude


def measure(at: Workspace) -> None:
    """Compute the length flown at each sample."""
    for j in range(1, len(at.flown_m)):
        a = at.curve[0, j - 1, 0] - at.curve[0, j, 0]
        b = at.curve[0, j - 1, 1] - at.curve[0, j, 1]
        c = at.curve[0, j - 1, 2] - at.curve[0, j, 2]
        at.flown_m[j] = at.flown_m[j - 1] + math.sqrt(a * a + b * b + c * c)


def remaining_m(scene: Scene) -> float:
    """What is left to fly, from a place straight on from the end, and the way there and down.

    No less than from the end itself: straight on may be on the far side of a wall.  Where the end
    is too low for what follows, the way about that it takes to climb; the height that what follows
    needs is no height to come down from.
    """
    if scene.is_final:
        return 0.0
    (end_n, end_e, altitude), before = scene.at.control[-1], scene.at.control[-2]
    (low, high), (scan_n, scan_e) = scene.band_amsl_m, scene.scan_ne_m
    north, east = end_n - before[0], end_e - before[1]
    ahead_m = scene.motion.turn_radius_m  # so far: an end that faces terrain is dear
    scale = ahead_m / max(math.sqrt(north * north + east * east), 1e-9)
    to_go_m = lattice_m(scene.to_go, end_n + scale * north, end_e + scale * east) + ahead_m
    here_m = lattice_m(scene.to_go, end_n, end_e)
    needed_m = lattice_m(scene.needed, end_n, end_e)
    above = max(altitude - low, 0.0) / (high - low)
    asked = max(needed_m - low, 0.0) / (high - low)
    descent_m = scene.descent_m * max(above * above - asked * asked, 0.0)
    climb_m = max(needed_m - altitude, 0.0) / math.tan(scene.motion.climb_angle_rad)
    a, b = end_n - scan_n, end_e - scan_e
    short_m = scene.end_radius_m - math.sqrt(a * a + b * b)
    return float(max(to_go_m, here_m) + descent_m + climb_m + ENDS_SHORT * max(short_m, 0.0))


def height(scene: Scene) -> float:
    """Mean altitude over the floor, 100 at the ceiling."""
    (low, high), total = scene.band_amsl_m, 0.0
    for altitude in scene.at.curve[0, 1:, 2]:
        total += max(altitude - low, 0.0)
    return total / (len(scene.at.flown_m) - 1) * 100.0 / (high - low)


def guide(scene: Scene) -> float:
    """Angle between the end and the guide direction, seen from p_scan."""
    if scene.is_final:
        return 0.0
    end, (scan_n, scan_e) = scene.at.control[-1], scene.scan_ne_m
    bearing = math.atan2(end[1] - scan_e, end[0] - scan_n)
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


def too_low_m(scene: Scene, most: float) -> float:
    """How far points of the chords lie under the surface, metres in all; beyond `most` any sum."""
    points, total = scene.at.curve[0], 0.0
    for j in range(1, len(points)):
        if total > most * BETWEEN:
            break
        north, east, altitude = points[j - 1]
        dn, de, da = points[j, 0] - north, points[j, 1] - east, points[j, 2] - altitude
        for i in range(1, BETWEEN + 1):
            share = i / BETWEEN
            wanted = lattice_m(scene.surface, north + share * dn, east + share * de)
            total += max(wanted - altitude - share * da, 0.0)
    return total / BETWEEN


def dead_man_m(scene: Scene, most: float) -> float:
    """How far points of the dead-man stretches lie too low, metres in all; beyond `most` any sum.

    Towards its end the vehicle flies no faster than it can stop there, and from a hover no faster
    than it can have become; chords stand for the curve.  Those that climb are level.
    """
    points, ahead, flown_m = scene.at.curve[0], scene.at.curve[1], scene.at.flown_m
    total = 0.0
    for j in range(1, len(points), DEAD_MAN_EVERY):
        if total > most:
            break
        speed = ending_m_s(scene.motion, flown_m[-1] - flown_m[j])
        if scene.from_rest:
            speed = min(speed, rising_m_s(scene.motion, flown_m[j]))
        dn, de, da = ahead[j]
        reach = flown_on_m(scene.motion, speed)
        reach /= max(math.sqrt(dn * dn + de * de + da * da), 1e-9)
        for half in range(1, 3):
            step = 0.5 * half * reach
            north, east = points[j, 0] + step * dn, points[j, 1] + step * de
            wanted = lattice_m(scene.contact, north, east)
            total += DEAD_MAN_EVERY * max(wanted - points[j, 2] - step * min(da, 0.0), 0.0)
    return total


def detection(scene: Scene) -> float:
    """Eq. 3, summed over samples and radars."""
    total = 0.0
    for north, east, altitude, range_m, reach in scene.radars:
        scale = 1.0 / (range_m * range_m)
        for n, e, z in scene.at.curve[0, 1:]:
            a, b, c = n - north, e - east, z - altitude
            squared = a * a + b * b + c * c
            if squared <= reach * reach:
                ratio = squared * scale
                total += 1.0 / (1.0 + ratio * ratio)
    return total


def steering(scene: Scene) -> tuple[float, float]:
    """Curvature and steepness beyond the limits, and curvature at all near the end.

    And how much farther it would come at V in the time that a copter loses in bends, metres, as
    `planner.procedure` paces them; none where it flies all that its turn radius allows at V.
    """
    _, first, second = scene.at.curve
    motion, count, flown_m = scene.motion, len(first) - 1, scene.at.flown_m
    near_end = count - round(END_SHARE * count)
    steepest = motion.climb_angle_rad / scene.margin, motion.dive_angle_rad / scene.margin
    climb, dive = math.tan(steepest[0]), math.tan(steepest[1])
    slows = motion.speed_m_s * motion.speed_m_s / (motion.lateral_m_s2 * motion.turn_radius_m)
    turning, steep, straight, slower_m = 0.0, 0.0, 0.0, 0.0
    for j in range(1, count + 1):
        dn, de, da = first[j]
        level = math.sqrt(dn * dn + de * de)
        slow = max(level, 1e-9)
        bend = abs(dn * second[j, 1] - de * second[j, 0])
        curvature = bend / (slow * slow * slow) * motion.turn_radius_m
        turning += min(max(curvature * scene.margin - 1.0, 0.0), MAX_EXCESS)
        if da > climb * level:
            steep += math.atan2(da, level) - steepest[0]
        elif -da > dive * level:
            steep += math.atan2(-da, level) - steepest[1]
        if j > near_end:
            straight += min(curvature, 1.0) ** 2
        if slows > 1.0:
            times = min(math.sqrt(curvature * slows), 1.0 / SLOWEST)
            slower_m += max(times - 1.0, 0.0) * (flown_m[j] - flown_m[j - 1])
    return CURVATURE_SCALE * turning + ANGLE_SCALE * steep + STRAIGHT_SCALE * straight, slower_m


def leaving(scene: Scene) -> float:
    """How far samples lie outside the band or the map, in R / 20."""
    total = 0.0
    for north, east, altitude in scene.at.curve[0, 1:]:
        total += beyond(altitude, scene.band_amsl_m)
        total += beyond(north, scene.north_m) + beyond(east, scene.east_m)
    return total / (scene.scan_range_m / 20.0)


def beyond(value: float, bounds: tuple[float, float]) -> float:
    """How far a value lies outside of bounds."""
    return max(bounds[0] - value, 0.0) + max(value - bounds[1], 0.0)


def intruding(scene: Scene, most: float) -> float:
    """How far points of the chords lie too near to zones, in clearances; beyond `most` any sum."""
    points, gaps_m, clearance_m = scene.at.curve[0], scene.at.gaps_m, scene.clearance_m
    circles, polygons = scene.zones.circles, len(gaps_m)
    if len(circles) + polygons == 0:
        return 0.0
    total, most = 0.0, most * BETWEEN * clearance_m
    gaps_m.fill(_FAR)
    for j in range(1, len(points)):
        if total > most:
            break
        dn, de = points[j, 0] - points[j - 1, 0], points[j, 1] - points[j - 1, 1]
        step = math.sqrt(dn * dn + de * de) / BETWEEN + 1e-6
        for k in range(1, BETWEEN + 1):
            share = k / BETWEEN
            north, east = points[j - 1, 0] + share * dn, points[j - 1, 1] + share * de
            for n, e, radius, sign in circles:
                a, b = north - n, east - e
                gap = sign * (math.sqrt(a * a + b * b) - radius)
                total += max(clearance_m - gap, 0.0)
            if not may_be_near(scene.near_polygons, north, east):
                gaps_m.fill(_FAR)
                continue
            for i in range(polygons):
                gap = polygon_at(scene.zones, i, north, east, clearance_m, gaps_m[i] + step)
                total += max(clearance_m - gap, 0.0)
                gaps_m[i] = -gap if gap < 0.0 else _FAR
    return total / (BETWEEN * clearance_m)


def may_be_near(cells: NearCells, north: float, east: float) -> bool:
    """Whether polygons may be near a point; yes outside of the area."""
    row = math.floor((north - cells.north_min_m) / cells.cell_m)
    column = math.floor((east - cells.east_min_m) / cells.cell_m)
    if 0 <= row < cells.near.shape[0] and 0 <= column < cells.near.shape[1]:
        return bool(cells.near[row, column])
    return True
