"""The paper's objective of a subpath, f = sum a_i f_i (eq. 5), term by term.

Where the paper is silent, `docs/lab/paper.md` says how it is settled; its rows are named here.
Samples at u = j / 10, j = 1 .. 10, uniform in u (row 9).
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray, wrap_rad
from companion.path.subpath import Pose, uniform_basis
from companion.planner.settings import Task
from companion.profiles import PAPER
from companion.world.columns import Surface
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

    task: Task  # its weights, R (the unit of r2 and r3), d_s, limits, radars and zones
    start: Pose  # p_prog and the tangent there: the first control point and the line of the second
    scan_ne_m: tuple[float, float]  # p_scan: the centre of the circle on which the subpath ends
    guide_rad: float  # bearing of the guide direction
    final_ne_m: tuple[float, float] | None  # the target, when this subpath ends there
    surface: Surface  # the known terrain


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
    settings, limits = scene.task.settings, scene.task.limits
    control = control_points(x, scene)
    points = uniform_basis(PAPER.samples).value @ control  # (P, 11, 3): the start does not count
    samples = points[:, 1:]
    north, east, altitude = np.moveaxis(samples, -1, 0)  # each (P, 10)

    # eq. 6: the length of the control polygon, 100 for 2.4 R (row 10)
    polygon_m = np.linalg.norm(np.diff(control, axis=1), axis=-1).sum(axis=1)
    length = polygon_m * (100.0 / (2.4 * settings.scan_range_m))
    # eq. 7: the mean altitude, 0 at the floor of the band, 100 at its ceiling
    floor, ceiling = limits.floor_amsl_m, limits.ceiling_amsl_m
    height = (altitude.mean(axis=1) - floor) * (100.0 / (ceiling - floor))
    # eq. 8: the angle at p_scan between the end and the guide direction, in plan view (row 26),
    # 100 for pi
    end = control[:, -1, :2] - np.asarray(scene.scan_ne_m)
    off = np.abs(wrap_rad(np.arctan2(end[:, 1], end[:, 0]) - scene.guide_rad))
    # eq. 9 with eq. 2: how far samples are short of d_s, by the first-order normal distance
    # d = (z - h) / sqrt(1 + |grad h|^2) (row 12), linear below 0 too (row 11).  The terrain is one
    # surface, as the radar shows it, so the sum over peaks has one member (row 27).
    surface, slope2 = scene.surface.altitude_and_slope(north, east)
    d_s, distance_m = settings.safety_distance_m, (altitude - surface) / np.sqrt(1.0 + slope2)
    short = np.maximum(d_s - distance_m, 0.0) / d_s
    # eq. 10 with eq. 3: the detection probabilities of all samples by all radars
    seen = np.zeros(len(x))
    for radar in scene.task.radars:
        seen += detection_probability(radar.distance_m(samples), radar.range_m).sum(axis=1)
    return {
        "length": length,
        "height": height,
        "guide": np.asarray(off * (100.0 / math.pi)),
        "crash": short.sum(axis=1) * _CRASH_SCALE,
        "radar": seen * _RADAR_SCALE,
        "constraints": constraints(points, scene),
    }


def cost(x: FloatArray, scene: Scene) -> FloatArray:
    """Eq. 5.  (P, 6) in the unit cube -> (P,)."""
    table, weights = cost_table(x, scene), scene.task.settings.weights
    return np.asarray(sum(getattr(weights, name) * column for name, column in table.items()))


def constraints(points: FloatArray, scene: Scene) -> FloatArray:
    """Eq. 11: alpha and beta (row 21), f_v.  (P, S + 1, 3), the start included -> (P,)."""
    settings, limits = scene.task.settings, scene.task.limits
    # k1 alpha + k2 beta: what the chords between samples turn, climb and dive too much
    chords = np.diff(points, axis=1)  # (P, S, 3)
    turn = np.abs(wrap_rad(np.diff(np.arctan2(chords[..., 1], chords[..., 0]), axis=1)))
    alpha = np.maximum(turn - _CHORD_TURN_RAD, 0.0).sum(axis=1)
    climb_rad = np.arctan2(chords[..., 2], np.hypot(chords[..., 0], chords[..., 1]))
    beta = _beyond(climb_rad, (-limits.dive_angle_rad, limits.climb_angle_rad))
    angles = _ANGLE_SCALE * (alpha + beta.sum(axis=1))
    # f_v: how far samples lie outside the altitude band or the map (row 22)
    north, east, altitude = np.moveaxis(points[:, 1:], -1, 0)
    beyond = _beyond(altitude, (limits.floor_amsl_m, limits.ceiling_amsl_m))
    beyond = beyond + _beyond(north, limits.north_m) + _beyond(east, limits.east_m)
    outside = beyond.sum(axis=1) * (_OUTSIDE_SCALE / (settings.scan_range_m / 20.0))
    # and how far they are short of d_s from keep-out zones (row 33)
    d_s, short = settings.safety_distance_m, np.zeros(len(points))
    for zone in scene.task.zones:
        short += np.maximum(d_s - zone.distance_m(north, east), 0.0).sum(axis=1)
    return np.asarray(angles + outside + short / d_s * _OUTSIDE_SCALE)


def _beyond(values: FloatArray, bounds: tuple[float, float]) -> FloatArray:
    return np.maximum(bounds[0] - values, 0.0) + np.maximum(values - bounds[1], 0.0)
