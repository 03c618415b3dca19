"""The paper's problem: what one subpath is planned in, and how six variables become it (2.5)."""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.limits import Limits
from companion.path.subpath import Pose
from companion.ranges import NotNegative
from companion.world.clearance import Surface
from companion.world.threats import Radar, Zone

VARIABLES = 6  # r2, r3, phi3, z3, phi4, z4


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


def control_points(x: FloatArray, scene: Scene) -> FloatArray:
    """Control points of subpaths.  (P, 6) in the unit cube -> (P, 4, 3) north, east, altitude.

    r2 along the tangent at p_prog; (r3, phi3, z3) about p_prog; the end at azimuth phi4 and
    altitude z4 on the circle about p_scan, or at the target (part A, rows 18 and 20).  Azimuths
    are measured from the tangent at p_prog, +-90 degrees.  On the last subpath r2 and r3 scale
    with the distance that is left.
    """
    r2, r3, phi3, z3, phi4, z4 = np.moveaxis(x, -1, 0)
    start = scene.start.position_nea_m
    unit = scene.scan_range_m
    if scene.final_ne_m is not None:
        left = math.hypot(scene.final_ne_m[0] - start[0], scene.final_ne_m[1] - start[1])
        unit = min(unit, left)
    r2 = 0.4 * r2 * unit
    r3 = (0.4 + 0.4 * r3) * unit
    ahead = math.atan2(scene.start.tangent_nea[1], scene.start.tangent_nea[0])
    phi3 = ahead + (phi3 - 0.5) * math.pi
    phi4 = ahead + (phi4 - 0.5) * math.pi
    floor, band = scene.limits.floor_amsl_m, scene.limits.ceiling_amsl_m - scene.limits.floor_amsl_m
    points = np.empty((len(x), 4, 3))
    points[:, 0] = start
    points[:, 1] = start + r2[:, None] * scene.start.tangent_nea
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
