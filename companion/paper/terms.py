"""The paper's objective of a subpath, f = sum a_i f_i (eq. 5), term by term.

Where the paper is silent, `docs/results/paper.md` says how it is settled; its rows are named here.
Samples at u = j / 10, j = 1 .. 10, uniform in u (row 9).
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.bspline import uniform_basis
from companion.path.subpath import Pose
from companion.planner.settings import Task
from companion.profiles import PAPER
from companion.world.clearance import Surface
from companion.world.radars import detection_probability

VARIABLES = 6  # r2, r3, phi3, z3, phi4, z4
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

    task: Task
    """Its weights, R (the unit of r2 and r3), d_s, limits, radars and zones."""
    start: Pose
    """p_prog and the tangent there: the first control point and the line of the second."""
    scan_ne_m: tuple[float, float]
    """p_scan: the centre of the circle on which the subpath ends."""
    guide_rad: float
    """Bearing of the guide direction."""
    final_ne_m: tuple[float, float] | None
    """The target, when this subpath ends there."""
    surface: Surface
    """The known terrain."""


def control_points(x: FloatArray, scene: Scene) -> FloatArray:
    """Control points of subpaths.  (P, 6) in the unit cube -> (P, 4, 3) north, east, altitude.

    r2 along the tangent at p_prog; (r3, phi3, z3) about p_prog; the end at azimuth phi4 and
    altitude z4 on the circle about p_scan, or at the target (rows 18 and 20).  Azimuths are
    measured from the tangent at p_prog, +-90 degrees.  On the last subpath r2 and r3 scale with the
    distance that is left.
    """
    r2, r3, phi3, z3, phi4, z4 = np.moveaxis(x, -1, 0)
    start, tangent = scene.start.position_nea_m, scene.start.tangent_nea
    range_m, limits = scene.task.settings.scan_range_m, scene.task.limits
    unit, final = range_m, scene.final_ne_m
    if final is not None:
        unit = min(range_m, math.hypot(final[0] - start[0], final[1] - start[1]))
    r2, r3 = 0.4 * r2 * unit, (0.4 + 0.4 * r3) * unit
    ahead = math.atan2(tangent[1], tangent[0])
    phi3, phi4 = ahead + (phi3 - 0.5) * math.pi, ahead + (phi4 - 0.5) * math.pi
    floor, band = limits.floor_amsl_m, limits.ceiling_amsl_m - limits.floor_amsl_m
    points = np.empty((len(x), 4, 3))
    points[:, 0] = start
    points[:, 1] = start + r2[:, None] * tangent
    points[:, 2, 0] = start[0] + r3 * np.cos(phi3)
    points[:, 2, 1] = start[1] + r3 * np.sin(phi3)
    points[:, 2, 2] = floor + z3 * band
    if final is None:
        points[:, 3, 0] = scene.scan_ne_m[0] + range_m * np.cos(phi4)
        points[:, 3, 1] = scene.scan_ne_m[1] + range_m * np.sin(phi4)
    else:
        points[:, 3, :2] = final
    points[:, 3, 2] = floor + z4 * band
    return points


def cost_table(x: FloatArray, scene: Scene) -> dict[str, FloatArray]:
    """Every term of the objective by name, unweighted.  (P, 6) in the unit cube -> each (P,)."""
    control = control_points(x, scene)
    points = uniform_basis(PAPER.samples).value @ control  # (P, 11, 3): the start does not count
    samples = points[:, 1:]
    return {
        "length": length(control, scene),
        "height": height(samples, scene),
        "guide": guide(control[:, -1], scene),
        "crash": crash(samples, scene),
        "radar": radar(samples, scene),
        "constraints": turns(points, scene) + outside(samples, scene) + keep_outs(samples, scene),
    }


def cost(x: FloatArray, scene: Scene) -> FloatArray:
    """Eq. 5.  (P, 6) in the unit cube -> (P,)."""
    table, weights = cost_table(x, scene), scene.task.settings.weights
    return np.asarray(sum(getattr(weights, name) * column for name, column in table.items()))


def length(control: FloatArray, scene: Scene) -> FloatArray:
    """Eq. 6: the length of the control polygon, 100 for 2.4 R (row 10).  (P, 4, 3) -> (P,)."""
    legs = np.linalg.norm(np.diff(control, axis=1), axis=-1)
    return legs.sum(axis=1) * (100.0 / (2.4 * scene.task.settings.scan_range_m))


def height(samples: FloatArray, scene: Scene) -> FloatArray:
    """Eq. 7: the mean altitude, 0 at the floor of the band, 100 at its ceiling.  (P, S, 3)."""
    floor, ceiling = scene.task.limits.floor_amsl_m, scene.task.limits.ceiling_amsl_m
    return (samples[..., 2].mean(axis=1) - floor) * (100.0 / (ceiling - floor))


def guide(ends: FloatArray, scene: Scene) -> FloatArray:
    """Eq. 8: the angle at p_scan between the subpath's end and the guide direction, 100 for pi.

    In plan view (row 26).  (P, 3) -> (P,).
    """
    offset = ends[:, :2] - np.asarray(scene.scan_ne_m)
    off = np.abs(_wrapped(np.arctan2(offset[:, 1], offset[:, 0]) - scene.guide_rad))
    return np.asarray(off * (100.0 / math.pi))


def crash(samples: FloatArray, scene: Scene) -> FloatArray:
    """Eq. 9 with eq. 2: how far samples are short of d_s, by the first-order normal distance.

    d = (z - h) / sqrt(1 + |grad h|^2) (row 12), linear below 0 too (row 11).  The terrain is one
    surface, as the radar shows it, so the sum over peaks has one member (row 27).
    """
    wanted, (north, east, altitude) = scene.task.settings.safety_distance_m, _axes(samples)
    surface, slope2 = scene.surface.altitude_and_slope(north, east)
    distance = (altitude - surface) / np.sqrt(1.0 + slope2)
    return (np.maximum(wanted - distance, 0.0) / wanted).sum(axis=1) * _CRASH_SCALE


def radar(samples: FloatArray, scene: Scene) -> FloatArray:
    """Eq. 10 with eq. 3: the detection probabilities of all samples by all radars."""
    total = np.zeros(len(samples))
    for each in scene.task.radars:
        total += detection_probability(each.distance_m(samples), each.range_m).sum(axis=1)
    return total * _RADAR_SCALE


def turns(points: FloatArray, scene: Scene) -> FloatArray:
    """Eq. 11, k1 alpha + k2 beta: what the chords between samples turn, climb and dive too much.

    Row 21.  (P, S + 1, 3) -> (P,).
    """
    chords = np.diff(points, axis=1)  # (P, S, 3)
    turn = np.abs(_wrapped(np.diff(np.arctan2(chords[..., 1], chords[..., 0]), axis=1)))
    alpha = np.maximum(turn - _CHORD_TURN_RAD, 0.0).sum(axis=1)
    limits = scene.task.limits
    climb_rad = np.arctan2(chords[..., 2], np.hypot(chords[..., 0], chords[..., 1]))
    beta = _beyond(climb_rad, (-limits.dive_angle_rad, limits.climb_angle_rad))
    return _ANGLE_SCALE * (alpha + beta.sum(axis=1))


def outside(samples: FloatArray, scene: Scene) -> FloatArray:
    """Eq. 11, f_v: how far samples lie outside the altitude band or the map (row 22)."""
    limits, (north, east, altitude) = scene.task.limits, _axes(samples)
    beyond = _beyond(altitude, (limits.floor_amsl_m, limits.ceiling_amsl_m))
    beyond = beyond + _beyond(north, limits.north_m) + _beyond(east, limits.east_m)
    unit_m = scene.task.settings.scan_range_m / 20.0
    return np.asarray(beyond.sum(axis=1) * (_OUTSIDE_SCALE / unit_m))


def keep_outs(samples: FloatArray, scene: Scene) -> FloatArray:
    """How far samples are short of d_s from keep-out zones: part of f_v here (row 33)."""
    wanted, (north, east, _) = scene.task.settings.safety_distance_m, _axes(samples)
    short = np.zeros(len(samples))
    for zone in scene.task.zones:
        short += np.maximum(wanted - zone.distance_m(north, east), 0.0).sum(axis=1)
    return short / wanted * _OUTSIDE_SCALE


def _axes(points: FloatArray) -> FloatArray:
    """North, east and altitude apart.  (..., 3) -> (3, ...)."""
    return np.moveaxis(points, -1, 0)


def _beyond(values: FloatArray, bounds: tuple[float, float]) -> FloatArray:
    return np.maximum(bounds[0] - values, 0.0) + np.maximum(values - bounds[1], 0.0)


def _wrapped(angle_rad: FloatArray) -> FloatArray:
    return np.asarray((angle_rad + math.pi) % (2.0 * math.pi) - math.pi)
