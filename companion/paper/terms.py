"""The paper's objective of a subpath, f = sum a_i f_i (eq. 5), term by term.

Where the paper is silent, `docs/results/paper.md` says how it is settled; its rows are named here.
Samples at u = j / N, j = 1 .. N, uniform in u (row 9); sums over samples are scaled to the paper's
ten, so that a denser sampling leaves the weights as they are.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.bspline import climb_angle_rad, uniform_basis
from companion.path.limits import Limits
from companion.path.subpath import Pose
from companion.profiles import Weights
from companion.world.clearance import Surface
from companion.world.radars import Radar, detection_probability
from companion.world.zones import Zone

VARIABLES = 6  # r2, r3, phi3, z3, phi4, z4
_PAPER_SAMPLES = 10  # 4.1
# Scales to "the common range (0, 100)", which the paper gives no values for: row 28.
_CRASH_SCALE = 100.0  # per unit of collision probability of one sample
_RADAR_SCALE = 30.0  # per unit of detection probability of one sample
_ANGLE_SCALE = 100.0  # k_1, k_2 of eq. 11, per radian
_OUTSIDE_SCALE = 100.0  # f_v per R / 20 (1 km at the paper's scale) outside the planning space
_CHORD_TURN_RAD = math.radians(30.0)  # row 21: between chords of R / 10


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Everything that the paper's cost of one subpath depends on."""

    samples: int
    weights: Weights
    limits: Limits
    start: Pose
    """p_prog and the tangent there: the first control point and the line of the second."""
    scan_ne_m: tuple[float, float]
    """p_scan: the centre of the circle on which the subpath ends."""
    scan_range_m: float
    """R, the unit of r2 and r3."""
    guide_rad: float
    """Bearing of the guide direction."""
    final_ne_m: tuple[float, float] | None
    """The target, when this subpath ends there."""
    safety_distance_m: float
    """d_s."""
    surface: Surface
    """The known terrain."""
    radars: tuple[Radar, ...]
    zones: tuple[Zone, ...]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Candidates:
    """A population of subpaths, sampled."""

    control_nea_m: FloatArray  # (P, 4, 3) north, east, altitude
    points_nea_m: FloatArray  # (P, S + 1, 3): the start is sample 0

    @property
    def samples_nea_m(self) -> FloatArray:
        """The samples that count: all but the start.  (P, S, 3)."""
        return self.points_nea_m[:, 1:]

    @property
    def per_sample(self) -> float:
        """What a sample counts in a sum over samples: 1 for the paper's ten."""
        return _PAPER_SAMPLES / (self.points_nea_m.shape[1] - 1)


def control_points(x: FloatArray, scene: Scene) -> FloatArray:
    """Control points of subpaths.  (P, 6) in the unit cube -> (P, 4, 3) north, east, altitude.

    r2 along the tangent at p_prog; (r3, phi3, z3) about p_prog; the end at azimuth phi4 and
    altitude z4 on the circle about p_scan, or at the target (rows 18 and 20).  Azimuths are
    measured from the tangent at p_prog, +-90 degrees.  On the last subpath r2 and r3 scale with the
    distance that is left.
    """
    r2, r3, phi3, z3, phi4, z4 = np.moveaxis(x, -1, 0)
    start, tangent = scene.start.position_nea_m, scene.start.tangent_nea
    unit = scene.scan_range_m
    if scene.final_ne_m is not None:
        left = math.hypot(scene.final_ne_m[0] - start[0], scene.final_ne_m[1] - start[1])
        unit = min(unit, left)
    r2, r3 = 0.4 * r2 * unit, (0.4 + 0.4 * r3) * unit
    ahead = math.atan2(tangent[1], tangent[0])
    phi3, phi4 = ahead + (phi3 - 0.5) * math.pi, ahead + (phi4 - 0.5) * math.pi
    floor, band = scene.limits.floor_amsl_m, scene.limits.ceiling_amsl_m - scene.limits.floor_amsl_m
    points = np.empty((len(x), 4, 3))
    points[:, 0] = start
    points[:, 1] = start + r2[:, None] * tangent
    points[:, 2, 0] = start[0] + r3 * np.cos(phi3)
    points[:, 2, 1] = start[1] + r3 * np.sin(phi3)
    points[:, 2, 2] = floor + z3 * band
    if scene.final_ne_m is None:
        points[:, 3, 0] = scene.scan_ne_m[0] + scene.scan_range_m * np.cos(phi4)
        points[:, 3, 1] = scene.scan_ne_m[1] + scene.scan_range_m * np.sin(phi4)
    else:
        points[:, 3, :2] = scene.final_ne_m
    points[:, 3, 2] = floor + z4 * band
    return points


def candidates(control_nea_m: FloatArray, samples: int) -> Candidates:
    """Sample curves at u = j / samples, j = 0 .. samples.  (P, 4, 3)."""
    at = uniform_basis(samples, control_nea_m.shape[1])
    return Candidates(control_nea_m=control_nea_m, points_nea_m=at.value @ control_nea_m)


def length(paths: Candidates, scene: Scene) -> FloatArray:
    """Eq. 6: the length of the control polygon, 100 for 2.4 R (row 10).  -> (P,)."""
    legs = np.linalg.norm(np.diff(paths.control_nea_m, axis=1), axis=-1)
    return legs.sum(axis=1) * (100.0 / (2.4 * scene.scan_range_m))


def height(paths: Candidates, scene: Scene) -> FloatArray:
    """Eq. 7: the mean altitude of the samples, 0 at the floor of the band, 100 at its ceiling."""
    mean = paths.samples_nea_m[..., 2].mean(axis=1)
    floor, ceiling = scene.limits.floor_amsl_m, scene.limits.ceiling_amsl_m
    return (mean - floor) * (100.0 / (ceiling - floor))


def guide(paths: Candidates, scene: Scene) -> FloatArray:
    """Eq. 8: the angle at p_scan between the subpath's end and the guide direction, 100 for pi.

    In plan view (row 26).
    """
    offset = paths.control_nea_m[:, -1, :2] - np.asarray(scene.scan_ne_m)
    off = np.abs(_wrapped(np.arctan2(offset[:, 1], offset[:, 0]) - scene.guide_rad))
    return np.asarray(off * (100.0 / math.pi))


def crash(paths: Candidates, scene: Scene) -> FloatArray:
    """Eq. 9 with eq. 2: how far samples are short of d_s, by the first-order normal distance.

    d = (z - h) / sqrt(1 + |grad h|^2) (row 12), linear below 0 too (row 11).  The terrain is one
    surface, as the radar shows it, so the sum over peaks has one member (row 27).
    """
    north, east, altitude = np.moveaxis(paths.samples_nea_m, -1, 0)  # each (P, S)
    surface, slope2 = scene.surface.altitude_and_slope(north, east)
    distance = (altitude - surface) / np.sqrt(1.0 + slope2)
    short = np.maximum(scene.safety_distance_m - distance, 0.0) / scene.safety_distance_m
    return short.sum(axis=1) * paths.per_sample * _CRASH_SCALE


def radar(paths: Candidates, scene: Scene) -> FloatArray:
    """Eq. 10 with eq. 3: the detection probabilities of all samples by all radars."""
    points = paths.samples_nea_m
    total = np.zeros(len(points))
    for each in scene.radars:
        total += detection_probability(each.distance_m(points), each.range_m).sum(axis=1)
    return total * paths.per_sample * _RADAR_SCALE


def constraints(paths: Candidates, scene: Scene) -> FloatArray:
    """Eq. 11: turning, climbing and diving beyond the limits, and leaving the planning space."""
    return _chord_excess(paths, scene) + _outside(paths, scene) + _keep_out_excess(paths, scene)


def _chord_excess(paths: Candidates, scene: Scene) -> FloatArray:
    """Heading changes and slopes of the chords between samples, beyond the limits (row 21)."""
    chords = np.diff(paths.points_nea_m, axis=1)  # (P, S, 3)
    heading = np.arctan2(chords[..., 1], chords[..., 0])
    turn = np.abs(_wrapped(np.diff(heading, axis=1)))
    alpha = np.maximum(turn - _CHORD_TURN_RAD, 0.0).sum(axis=1)
    slope = climb_angle_rad(chords)
    limits = scene.limits
    beta = np.maximum(slope - limits.climb_angle_rad, 0.0)
    beta = beta + np.maximum(-slope - limits.dive_angle_rad, 0.0)
    return _ANGLE_SCALE * (alpha + beta.sum(axis=1))


def _outside(paths: Candidates, scene: Scene) -> FloatArray:
    """f_v: how far samples lie outside the altitude band or the map (row 22)."""
    limits = scene.limits
    north, east, altitude = np.moveaxis(paths.samples_nea_m, -1, 0)
    beyond = _beyond(altitude, (limits.floor_amsl_m, limits.ceiling_amsl_m))
    beyond = beyond + _beyond(north, limits.north_m) + _beyond(east, limits.east_m)
    total = np.asarray(beyond.sum(axis=1))
    return total * paths.per_sample * (_OUTSIDE_SCALE / (scene.scan_range_m / 20.0))


def _keep_out_excess(paths: Candidates, scene: Scene) -> FloatArray:
    """How far samples are short of d_s from keep-out zones: part of f_v here (row 33)."""
    wanted, points = scene.safety_distance_m, paths.samples_nea_m
    short = np.zeros(len(points))
    for zone in scene.zones:
        gap = zone.distance_m(points[..., 0], points[..., 1])
        short += np.maximum(wanted - gap, 0.0).sum(axis=1)
    return short / wanted * paths.per_sample * _OUTSIDE_SCALE


def _beyond(values: FloatArray, bounds: tuple[float, float]) -> FloatArray:
    return np.maximum(bounds[0] - values, 0.0) + np.maximum(values - bounds[1], 0.0)


def _wrapped(angle_rad: FloatArray) -> FloatArray:
    return np.asarray((angle_rad + math.pi) % (2.0 * math.pi) - math.pi)


TERMS: dict[str, Callable[[Candidates, Scene], FloatArray]] = {
    "length": length,
    "height": height,
    "guide": guide,
    "crash": crash,
    "radar": radar,
    "constraints": constraints,
}


def cost_table(x: FloatArray, scene: Scene) -> dict[str, FloatArray]:
    """Every term of the objective by name, unweighted.  (P, 6) in the unit cube -> each (P,)."""
    paths = candidates(control_points(x, scene), scene.samples)
    return {name: term(paths, scene) for name, term in TERMS.items()}


def cost(x: FloatArray, scene: Scene) -> FloatArray:
    """Eq. 5.  (P, 6) in the unit cube -> (P,)."""
    table, weights = cost_table(x, scene), scene.weights
    return np.asarray(sum(getattr(weights, name) * column for name, column in table.items()))
