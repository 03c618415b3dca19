"""What one subpath is planned in, and what it costs in profile `flight`: the paper's six terms.

What differs from `terms` (the paper as printed), and why, is in design 5.2:

- the curve has five or six control points, of which the third continues the curvature of the
  subpath before it (`planner-numbers` part E), so joins are smooth to the second derivative;
- f1 is the length of the curve, not of its control polygon, and goes on beyond the curve: what is
  left to fly is the cost-to-go at its end, in the same currency;
- f3 pulls towards where the best way to the target leaves the circle;
- f4 counts what lies below a surface that already stands off the terrain, and below that on the
  stretch that the vehicle would cover if the companion died (a plane would circle: the surface
  stands off by its circle too);
- f6 bounds the curvature and the climb of the curve itself.

This is the numpy form: the oracle of `kernel`, and what runs where numba is absent.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.bspline import climb_angle_rad, horizontal_curvature_1_m, uniform_basis
from companion.path.limits import Limits
from companion.path.subpath import Pose
from companion.ranges import NotNegative
from companion.world.clearance import Surface
from companion.world.threats import CircleZone, NearCells, Radar, Zone, detection_probability

SPREAD_RAD = math.radians(110.0)  # azimuths of control points, to each side of the tangent
LONGEST_R2, LONGEST_S, LONGEST_R = 0.3, 0.6, 1.0  # upper limits of r2, s and r, in units of R
SHORTEST_R2, SHORTEST_S, SHORTEST_R = 0.02, 0.02, 0.15
PER_SAMPLE = 10.0  # sums over samples are scaled to the paper's ten
CRASH_SCALE = 100.0  # per d_s below the surface, one sample
RADAR_SCALE = 30.0  # per unit of detection probability of one sample
CURVATURE_SCALE = 100.0  # per unit of curvature in excess, relative to the limit
ANGLE_SCALE = 100.0  # per radian of climb or dive in excess
OUTSIDE_SCALE = 100.0  # per R / 20 outside the band or the map
STRAIGHT_SCALE = 2.0  # per unit of squared curvature near the end, relative to the limit
END_SHARE = 0.25  # of the curve's parameter, counted from its end, that ought to be straight
MAX_EXCESS = 10.0  # of curvature over its limit that counts
DEAD_MAN_EVERY = 2  # samples
BETWEEN = 3  # points a chord at which terrain and zones count: they are met at their corners


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """a_1 .. a_6 of eq. 5; the paper's Fig. 3 (a)."""

    length: NotNegative = 0.1
    height: NotNegative = 0.15
    guide: NotNegative = 0.15
    crash: NotNegative = 0.3
    radar: NotNegative = 0.3
    constraints: NotNegative = 1.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """How literally the paper is taken."""

    name: str
    samples: int
    """Points of the curve at which the terms are computed (the paper: 10)."""
    margin: float
    """Factor on d_s, on the turn radius and on the steepness that the search aims at."""
    verified: bool
    """Whether a subpath needs a certificate before it is flown."""
    optimiser: str
    """What searches, if the mission does not say."""


PAPER = Profile(name="paper", samples=10, margin=1.0, verified=False, optimiser="improved-de")
FLIGHT = Profile(name="flight", samples=40, margin=1.06, verified=True, optimiser="refined-de")
PROFILES = {profile.name: profile for profile in (FLIGHT, PAPER)}


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlightScene:
    """Everything that the cost of one subpath depends on."""

    points: int
    """Control points: five, or six where five find nothing."""
    samples: int
    margin: float
    """Factor on the turn radius and on the steepness that the search aims at."""
    weights: Weights
    limits: Limits
    start: Pose
    """p_prog, the tangent and the curvature there."""
    from_rest: bool
    """Whether the vehicle starts from a hover: then it is slow at first."""
    scan_ne_m: tuple[float, float]
    """p_scan: the centre of the circle on which the subpath ends."""
    scan_range_m: float
    """R, the unit of distances along the curve."""
    end_radius_m: float
    """Radius of the circle on which the subpath ends: so much of R that d_s is kept inside."""
    guide_rad: float
    """Bearing of the guide direction from p_scan."""
    guide_share: float
    """How much of the guide's pull counts, beside the cost-to-go."""
    to_go: Surface
    """Cost to the target from each place, in metres of level flight at the floor of the band."""
    needed: Surface
    """The lowest altitude at each place from which the way on can be climbed, AMSL."""
    look_ahead_m: float
    """The cost-to-go counts so far straight on from the end: an end that faces terrain is dear."""
    descent_m: float
    """What it costs to come down from the ceiling to the floor, in metres of level flight."""
    final_ne_m: tuple[float, float] | None
    """The target, when this subpath ends there."""
    safety_distance_m: float
    """d_s."""
    clearance_m: float
    """What the search keeps from zones."""
    surface: Surface
    """The altitude that keeps the clearance from the terrain."""
    contact: Surface
    """The altitude that the dead-man stretch must keep."""
    radar_margin_m: float
    band_amsl_m: tuple[float, float]
    """Lowest and highest altitude to plan for: the vehicle on the path stays in the band too."""
    radars: tuple[Radar, ...]
    zones: tuple[Zone, ...]
    near_polygons: NearCells | None = None
    """Where polygons among the zones need be looked at; None: everywhere."""

    @property
    def variables(self) -> int:
        """r2, s; r, phi, z of each free point between; phi, z of the end."""
        return 3 * self.points - 8

    @property
    def is_final(self) -> bool:
        """Whether this subpath ends at the target."""
        return self.final_ne_m is not None

    @property
    def unit_m(self) -> float:
        """R, or less where the end is nearer than that."""
        if self.final_ne_m is None:
            return min(self.scan_range_m, 1.1 * self.end_radius_m)
        start = self.start.position_nea_m
        left = math.hypot(self.final_ne_m[0] - start[0], self.final_ne_m[1] - start[1])
        return min(self.scan_range_m, max(left, 1e-3 * self.scan_range_m))

    @property
    def ahead_rad(self) -> float:
        """Bearing of the tangent at p_prog: azimuth zero."""
        return math.atan2(self.start.tangent_nea[1], self.start.tangent_nea[0])


def control_points(x: FloatArray, scene: FlightScene) -> FloatArray:
    """Control points of subpaths.  (P, D) in the unit cube -> (P, points, 3).

    The second at r2 along the tangent; the third at s along it and 3 r2^2 k off it, k the
    curvature vector at p_prog (part E: with uniform inner knots, that continues the curvature);
    the others at (r, phi, z) about p_prog; the last on the circle about p_scan, or at the target.
    """
    start, tangent = scene.start.position_nea_m, scene.start.tangent_nea
    unit = scene.unit_m
    low, high = scene.band_amsl_m
    points = np.empty((len(x), scene.points, 3))
    r2 = (SHORTEST_R2 + (LONGEST_R2 - SHORTEST_R2) * x[:, 0]) * unit
    s = r2 + (SHORTEST_S + (LONGEST_S - SHORTEST_S) * x[:, 1]) * unit
    points[:, 0] = start
    points[:, 1] = start + r2[:, None] * tangent
    points[:, 2] = start + s[:, None] * tangent
    points[:, 2] += 3.0 * (r2**2)[:, None] * scene.start.curvature_nea_1_m
    for k in range(3, scene.points - 1):
        radius, azimuth, z = (x[:, 3 * k - 7 + i] for i in range(3))
        r = (SHORTEST_R + (LONGEST_R - SHORTEST_R) * radius) * unit
        phi = scene.ahead_rad + (2.0 * azimuth - 1.0) * SPREAD_RAD
        points[:, k, 0] = start[0] + r * np.cos(phi)
        points[:, k, 1] = start[1] + r * np.sin(phi)
        points[:, k, 2] = low + z * (high - low)
    if scene.final_ne_m is None:
        phi = scene.ahead_rad + (2.0 * x[:, -2] - 1.0) * SPREAD_RAD
        points[:, -1, 0] = scene.scan_ne_m[0] + scene.end_radius_m * np.cos(phi)
        points[:, -1, 1] = scene.scan_ne_m[1] + scene.end_radius_m * np.sin(phi)
    else:
        points[:, -1, :2] = scene.final_ne_m
    points[:, -1, 2] = low + x[:, -1] * (high - low)
    return points


def cost_table(x: FloatArray, scene: FlightScene) -> dict[str, FloatArray]:
    """Every term by name, unweighted.  (P, D) in the unit cube -> each (P,).

    f1 .. f6, and what is left to fly after the end.  One more takes a weight, a line here, and its
    scalar form in `kernel.cost`.
    """
    control = control_points(x, scene)
    at = uniform_basis(scene.samples, scene.points)
    points, first, second = (each @ control for each in (at.value, at.first, at.second))
    each = PER_SAMPLE / scene.samples
    return {
        "length": _length(points, scene),
        "height": _height(points, scene),
        "guide": _guide(control, scene),
        "crash": _crash(points, first, scene) * each,
        "radar": detections(points, scene.radars, scene.radar_margin_m) * RADAR_SCALE * each,
        "constraints": (_steering(first, second, scene) + _outside(points, scene)) * each,
        "to_go": _to_go_m(control, scene) * _per_metre(scene),
    }


def cost(x: FloatArray, scene: FlightScene) -> FloatArray:
    """Eq. 5, and what is left to fly.  (P, D) in the unit cube -> (P,)."""
    table = cost_table(x, scene)
    return np.asarray(sum(weight(name, scene) * column for name, column in table.items()))


def weight(term: str, scene: FlightScene) -> float:
    """The weight of a term: a_1 .. a_6 of eq. 5; what is left to fly weighs as much as length."""
    return float(getattr(scene.weights, "length" if term == "to_go" else term))


def _per_metre(scene: FlightScene) -> float:
    return 100.0 / (2.4 * scene.scan_range_m)


def _length(points: FloatArray, scene: FlightScene) -> FloatArray:
    chords = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    return chords.sum(axis=1) * _per_metre(scene)


def _to_go_m(control: FloatArray, scene: FlightScene) -> FloatArray:
    """What is left to fly, from a place straight on from the end, and the way there and down.

    No less than from the end itself: straight on may be on the far side of a wall.  Where the end
    is too low for what follows, the way about that it takes to climb; the height that what follows
    needs is no height to come down from.
    """
    if scene.final_ne_m is not None:
        return np.zeros(len(control))
    low, high = scene.band_amsl_m
    end = control[:, -1]
    needed_m = scene.needed.altitude_m(end[:, 0], end[:, 1])
    above, needed = (np.maximum(z - low, 0.0) / (high - low) for z in (end[:, 2], needed_m))
    climb_m = np.maximum(needed_m - end[:, 2], 0.0) / math.tan(scene.limits.climb_angle_rad)
    leg = control[:, -1, :2] - control[:, -2, :2]
    leg = leg / np.maximum(np.linalg.norm(leg, axis=-1), 1e-9)[:, None]
    there = end[:, :2] + scene.look_ahead_m * leg
    to_go_m = scene.to_go.altitude_m(there[:, 0], there[:, 1]) + scene.look_ahead_m
    here_m = scene.to_go.altitude_m(end[:, 0], end[:, 1])
    descent_m = scene.descent_m * np.maximum(above**2 - needed**2, 0.0)
    return np.maximum(to_go_m, here_m) + descent_m + climb_m


def _height(points: FloatArray, scene: FlightScene) -> FloatArray:
    low, high = scene.band_amsl_m
    return np.maximum(points[:, 1:, 2] - low, 0.0).mean(axis=1) * (100.0 / (high - low))


def _guide(control: FloatArray, scene: FlightScene) -> FloatArray:
    if scene.final_ne_m is not None:
        return np.zeros(len(control))
    off_rad = off_guide_rad(control, scene.scan_ne_m, scene.guide_rad)
    return off_rad * (scene.guide_share * 100.0 / math.pi)


def off_guide_rad(
    control: FloatArray, scan_ne_m: tuple[float, float], guide_rad: float
) -> FloatArray:
    """Angle at p_scan between the end and the guide direction.  (P, points, 3) -> (P,)."""
    offset = control[:, -1, :2] - np.asarray(scan_ne_m)
    angle = np.arctan2(offset[:, 1], offset[:, 0]) - guide_rad
    return np.asarray(np.abs((angle + math.pi) % (2.0 * math.pi) - math.pi))


def _crash(points: FloatArray, first: FloatArray, scene: FlightScene) -> FloatArray:
    """How far points of the chords, and of some dead-man stretches, lie too low, in d_s."""
    low = _below(_dense(points), scene.surface) / BETWEEN
    if not scene.limits.hovers:
        return low * (CRASH_SCALE / scene.safety_distance_m)
    some, ahead = points[:, 1::DEAD_MAN_EVERY], first[:, 1::DEAD_MAN_EVERY]
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=-1), 1e-9)[..., None]
    reach = _reach_m(points, scene)[:, 1::DEAD_MAN_EVERY, None]
    for share in (0.5, 1.0):
        low = low + DEAD_MAN_EVERY * _below(some + share * reach * ahead, scene.contact)
    return low * (CRASH_SCALE / scene.safety_distance_m)


def _dense(points: FloatArray) -> FloatArray:
    """Points of the chords between samples, without the start.  (P, S + 1, 3) -> (P, 3 S, 3)."""
    share = np.arange(1, BETWEEN + 1)[:, None] / BETWEEN
    steps = np.diff(points, axis=1)[:, :, None]
    return (points[:, :-1, None] + share * steps).reshape(len(points), -1, 3)


def _below(points: FloatArray, surface: Surface) -> FloatArray:
    altitude = surface.altitude_m(points[..., 0], points[..., 1])
    return np.maximum(altitude - points[..., 2], 0.0).sum(axis=1)


def _reach_m(points: FloatArray, scene: FlightScene) -> FloatArray:
    """How far the vehicle flies on from each sample if the companion dies there.  (P, S + 1).

    Towards its end it flies no faster than it can stop there, and from a hover no faster than it
    can have become; chords stand for the curve.
    """
    chords = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    flown = np.concatenate([np.zeros((len(points), 1)), np.cumsum(chords, axis=1)], axis=1)
    left, limits = flown[:, -1:] - flown, scene.limits
    braking, flies_on_s = limits.acceleration_m_s2, limits.dead_man_s
    speed = np.minimum(np.sqrt(2.0 * braking * left), limits.speed_m_s)
    if scene.from_rest:
        speed = np.minimum(speed, np.sqrt(2.0 * braking * flown))
    if limits.overrun_m < limits.speed_m_s * flies_on_s:
        within = flies_on_s**2 + 2.0 * (left + limits.overrun_m) / braking
        speed = np.minimum(speed, braking * (np.sqrt(within) - flies_on_s))
    return speed * flies_on_s + speed**2 / (2.0 * braking)


def detections(points: FloatArray, radars: tuple[Radar, ...], margin_m: float = 0.0) -> FloatArray:
    """Eq. 3, summed over samples (without the start) and radars.  (P, S + 1, 3) -> (P,)."""
    total = np.zeros(len(points))
    for each in radars:
        distance = each.distance_m(points[:, 1:])
        total += detection_probability(distance, each.range_m, margin_m).sum(axis=1)
    return total


def _steering(first: FloatArray, second: FloatArray, scene: FlightScene) -> FloatArray:
    """Curvature and steepness beyond the limits, and curvature at all near the end."""
    limits = scene.limits
    curvature = horizontal_curvature_1_m(first, second)[:, 1:] * limits.turn_radius_m
    turning = np.clip(curvature * scene.margin - 1.0, 0.0, MAX_EXCESS).sum(axis=1)
    angle = climb_angle_rad(first[:, 1:])
    steep = np.maximum(angle - limits.climb_angle_rad / scene.margin, 0.0)
    steep += np.maximum(-angle - limits.dive_angle_rad / scene.margin, 0.0)
    near_end = round(END_SHARE * scene.samples)
    bent = np.minimum(curvature[:, -near_end:], 1.0) ** 2
    return (
        CURVATURE_SCALE * turning
        + ANGLE_SCALE * steep.sum(axis=1)
        + STRAIGHT_SCALE * bent.sum(axis=1)
    )


def _outside(points: FloatArray, scene: FlightScene) -> FloatArray:
    """How far samples lie outside the band or the map, or too near to zones."""
    total = beyond_m(points, scene.limits, scene.band_amsl_m) / (scene.scan_range_m / 20.0)
    if scene.zones:
        dense = np.moveaxis(_dense(points)[..., :2], -1, 0)
        near = np.ones(dense.shape[1:], dtype=bool)
        if scene.near_polygons is not None:
            near = scene.near_polygons.at(*dense)
        for zone in scene.zones:
            short = np.zeros(near.shape)
            where = ... if isinstance(zone, CircleZone) else near
            gap = zone.distance_m(dense[0][where], dense[1][where])
            short[where] = np.maximum(scene.clearance_m - gap, 0.0)
            total += short.sum(axis=1) / (BETWEEN * scene.clearance_m)
    return total * OUTSIDE_SCALE


def beyond_m(points: FloatArray, limits: Limits, band_amsl_m: tuple[float, float]) -> FloatArray:
    """How far samples lie outside the band or the map, metres in all.  (P, S + 1, 3) -> (P,)."""
    north, east, altitude = np.moveaxis(points[:, 1:], -1, 0)
    beyond = _beyond(altitude, band_amsl_m)
    beyond = beyond + _beyond(north, limits.north_m) + _beyond(east, limits.east_m)
    return np.asarray(beyond.sum(axis=1))


def _beyond(values: FloatArray, bounds: tuple[float, float]) -> FloatArray:
    return np.maximum(bounds[0] - values, 0.0) + np.maximum(values - bounds[1], 0.0)
