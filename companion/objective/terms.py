"""The paper's objective of a subpath, f = sum a_i f_i (eq. 5), term by term.

Where the paper is silent, `planner-numbers` part A decides (its rows are named here): samples at
u = j / N, j = 1 .. N, uniform in u (row 9); sums over samples are scaled to the paper's ten, so
that a denser sampling leaves the weights as they are.  What is flown is searched for by
`objective.flight`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.objective.scene import Scene, control_points
from companion.path.bspline import climb_angle_rad, uniform_basis
from companion.world.threats import detection_probability

_PAPER_SAMPLES = 10
_CRASH_SCALE = 100.0  # per unit of collision probability of one sample
_RADAR_SCALE = 30.0  # per unit of detection probability of one sample
_ANGLE_SCALE = 100.0  # k_1, k_2 of eq. 11, per radian
_OUTSIDE_SCALE = 100.0  # f_v per R / 20 (1 km at the paper's scale) outside the planning space
_CHORD_TURN_RAD = math.radians(30.0)  # row 21: between chords of R / 10

CostTable = dict[str, FloatArray]  # term -> (P,)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Candidates:
    """A population of subpaths, sampled."""

    control_nea_m: FloatArray  # (P, 4, 3)
    points_nea_m: FloatArray  # (P, S + 1, 3): the start is sample 0


def candidates(control_nea_m: FloatArray, samples: int) -> Candidates:
    """Sample curves at u = j / samples, j = 0 .. samples.  (P, 4, 3)."""
    at = uniform_basis(samples, control_nea_m.shape[1])
    return Candidates(
        control_nea_m=control_nea_m,
        points_nea_m=at.value @ control_nea_m,
    )


def length(paths: Candidates, scene: Scene) -> FloatArray:
    """Eq. 6: the length of the control polygon, 100 for 2.4 R.  -> (P,)."""
    legs = np.linalg.norm(np.diff(paths.control_nea_m, axis=1), axis=-1)
    return legs.sum(axis=1) * (100.0 / (2.4 * scene.scan_range_m))


def height(paths: Candidates, scene: Scene) -> FloatArray:
    """Eq. 7: the mean altitude of the samples, 0 at the floor of the band, 100 at its ceiling."""
    mean = paths.points_nea_m[:, 1:, 2].mean(axis=1)
    floor, ceiling = scene.limits.floor_amsl_m, scene.limits.ceiling_amsl_m
    return (mean - floor) * (100.0 / (ceiling - floor))


def guide(paths: Candidates, scene: Scene) -> FloatArray:
    """Eq. 8: the angle at p_scan between the subpath's end and the guide direction, 100 for pi."""
    offset = paths.control_nea_m[:, -1, :2] - np.asarray(scene.scan_ne_m)
    angle = np.arctan2(offset[:, 1], offset[:, 0]) - scene.guide_rad
    angle = np.abs((angle + math.pi) % (2.0 * math.pi) - math.pi)
    return angle * (100.0 / math.pi)


def crash(paths: Candidates, scene: Scene) -> FloatArray:
    """Eq. 9 with eq. 2: how far samples are short of d_s, by the first-order normal distance.

    d = (z - h) / sqrt(1 + |grad h|^2) (row 12), linear below 0 too (row 11).  The terrain is one
    surface, as the radar shows it, so the sum over peaks has one member.
    """
    north, east, altitude = np.moveaxis(paths.points_nea_m[:, 1:], -1, 0)  # each (P, S)
    surface, slope2 = scene.surface.altitude_and_slope(north, east)
    distance = (altitude - surface) / np.sqrt(1.0 + slope2)
    short = np.maximum(scene.safety_distance_m - distance, 0.0) / scene.safety_distance_m
    return short.sum(axis=1) * _per_sample(paths) * _CRASH_SCALE


def radar(paths: Candidates, scene: Scene) -> FloatArray:
    """Eq. 10 with eq. 3: the detection probabilities of all samples by all radars."""
    points = paths.points_nea_m[:, 1:]
    total = np.zeros(len(points))
    for each in scene.radars:
        distance = each.distance_m(points)
        seen = detection_probability(distance, each.range_m)
        total += seen.sum(axis=1)
    return total * _per_sample(paths) * _RADAR_SCALE


def constraints(paths: Candidates, scene: Scene) -> FloatArray:
    """Eq. 11: turning, climbing and diving beyond the limits, and leaving the planning space."""
    return _chord_excess(paths, scene) + _outside(paths, scene) + _keep_out_excess(paths, scene)


def _chord_excess(paths: Candidates, scene: Scene) -> FloatArray:
    """Heading changes and slopes of the chords between samples, beyond the limits (row 21)."""
    chords = np.diff(paths.points_nea_m, axis=1)  # (P, S, 3)
    heading = np.arctan2(chords[..., 1], chords[..., 0])
    turn = np.abs((np.diff(heading, axis=1) + math.pi) % (2.0 * math.pi) - math.pi)
    alpha = np.maximum(turn - _CHORD_TURN_RAD, 0.0).sum(axis=1)
    slope = climb_angle_rad(chords)
    limits = scene.limits
    beta = np.maximum(slope - limits.climb_angle_rad, 0.0)
    beta = beta + np.maximum(-slope - limits.dive_angle_rad, 0.0)
    return _ANGLE_SCALE * (alpha + beta.sum(axis=1))


def _outside(paths: Candidates, scene: Scene) -> FloatArray:
    """f_v: how far samples lie outside the altitude band or the map."""
    north, east, altitude = np.moveaxis(paths.points_nea_m[:, 1:], -1, 0)
    limits = scene.limits
    beyond = _beyond(altitude, (limits.floor_amsl_m, limits.ceiling_amsl_m))
    beyond = beyond + _beyond(north, limits.north_m) + _beyond(east, limits.east_m)
    scale = _OUTSIDE_SCALE / (scene.scan_range_m / 20.0)
    return beyond.sum(axis=1) * _per_sample(paths) * scale


def _beyond(values: FloatArray, bounds: tuple[float, float]) -> FloatArray:
    return np.maximum(bounds[0] - values, 0.0) + np.maximum(values - bounds[1], 0.0)


def _keep_out_excess(paths: Candidates, scene: Scene) -> FloatArray:
    """How far samples are short of d_s from keep-out zones (not in the paper: a hard bound)."""
    wanted = scene.safety_distance_m
    points = paths.points_nea_m[:, 1:]
    short = np.zeros(len(points))
    for zone in scene.zones:
        gap = zone.distance_m(points[..., 0], points[..., 1])
        short += np.maximum(wanted - gap, 0.0).sum(axis=1)
    return short / wanted * _per_sample(paths) * _OUTSIDE_SCALE


def _per_sample(paths: Candidates) -> float:
    return _PAPER_SAMPLES / (paths.points_nea_m.shape[1] - 1)


TERMS: dict[str, Callable[[Candidates, Scene], FloatArray]] = {
    "length": length,
    "height": height,
    "guide": guide,
    "crash": crash,
    "radar": radar,
    "constraints": constraints,
}


def cost_table(x: FloatArray, scene: Scene) -> CostTable:
    """Every term of the objective by name, unweighted.  (P, 6) in the unit cube -> each (P,)."""
    paths = candidates(control_points(x, scene), scene.samples)
    return {name: term(paths, scene) for name, term in TERMS.items()}


def cost(x: FloatArray, scene: Scene) -> FloatArray:
    """Eq. 5.  (P, 6) in the unit cube -> (P,)."""
    table = cost_table(x, scene)
    weights = scene.weights
    total = sum(getattr(weights, each.name) * table[each.name] for each in fields(weights))
    return np.asarray(total)
