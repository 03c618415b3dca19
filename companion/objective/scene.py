"""What one subpath is planned in, and how six variables become control points (paper 2.5)."""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.limits import Limits
from companion.path.subpath import Pose
from companion.world.clearance import Surface
from companion.world.threats import KeepOut, Radar

VARIABLES = 6  # r2, r3, phi3, z3, phi4, z4


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """a_1 .. a_6 of eq. 5; the paper's Fig. 3 (a)."""

    length: float = 0.1
    height: float = 0.15
    guide: float = 0.15
    crash: float = 0.3
    radar: float = 0.3
    constraints: float = 1.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """How literally the paper is taken."""

    name: str
    samples: int
    """Points of the curve at which the terms are computed (the paper: 10)."""
    shortest_r2: float
    """Lower limit of r2 as a fraction of R (the paper: 0, which makes a corner at each join)."""
    margin: float
    """Factor on d_s, on the turn radius and on the steepness that the search aims at."""
    radar_margin_m: float
    bounds_curvature: bool
    """Whether curvature and climb count along the whole curve, and not just between samples."""
    verified: bool
    """Whether a subpath must pass the dense check before it is flown."""


PAPER = Profile(
    name="paper",
    samples=10,
    shortest_r2=0.0,
    margin=1.0,
    radar_margin_m=0.0,
    bounds_curvature=False,
    verified=False,
)
FLIGHT = Profile(
    name="flight",
    samples=40,
    shortest_r2=0.1,
    margin=1.06,
    radar_margin_m=100.0,
    bounds_curvature=True,
    verified=True,
)
PROFILES = {profile.name: profile for profile in (FLIGHT, PAPER)}


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Everything that the cost of one subpath depends on."""

    profile: Profile
    weights: Weights
    limits: Limits
    start: Pose
    """p_prog and the tangent there: the first control point and the line of the second."""
    scan_ne_m: tuple[float, float]
    """p_scan: the centre of the circle on which the subpath ends."""
    scan_range_m: float
    """R, the unit of r2 and r3."""
    end_radius_m: float
    """Radius of the circle on which the subpath ends: R, or what of it keeps d_s inside."""
    guide_rad: float
    """Bearing of the guide direction."""
    final_ne_m: tuple[float, float] | None
    """The target, when this subpath ends there."""
    safety_distance_m: float
    """d_s."""
    clearance_m: float
    """What the search keeps from keep-outs and, in `flight`, from terrain: a little over d_s."""
    surface: Surface
    """`paper`: the known terrain.  `flight`: the surface that keeps clearance_m from it."""
    radars: tuple[Radar, ...]
    keep_outs: tuple[KeepOut, ...]

    @property
    def floor_amsl_m(self) -> float:
        """Lowest altitude to plan for: the vehicle on the path stays in the band too."""
        return self.limits.floor_amsl_m + self._inset_m

    @property
    def ceiling_amsl_m(self) -> float:
        """Highest altitude to plan for."""
        return self.limits.ceiling_amsl_m - self._inset_m

    @property
    def _inset_m(self) -> float:
        return 1.1 * self.limits.tracking_error_m if self.profile.verified else 0.0


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
    shortest = scene.profile.shortest_r2
    r2 = (shortest + (0.4 - shortest) * r2) * unit
    r3 = (0.4 + 0.4 * r3) * unit
    ahead = math.atan2(scene.start.tangent_nea[1], scene.start.tangent_nea[0])
    phi3 = ahead + (phi3 - 0.5) * math.pi
    phi4 = ahead + (phi4 - 0.5) * math.pi
    band = scene.ceiling_amsl_m - scene.floor_amsl_m
    points = np.empty((len(x), 4, 3))
    points[:, 0] = start
    points[:, 1] = start + r2[:, None] * scene.start.tangent_nea
    points[:, 2, 0] = start[0] + r3 * np.cos(phi3)
    points[:, 2, 1] = start[1] + r3 * np.sin(phi3)
    points[:, 2, 2] = scene.floor_amsl_m + z3 * band
    if scene.final_ne_m is None:
        points[:, 3, 0] = scene.scan_ne_m[0] + scene.end_radius_m * np.cos(phi4)
        points[:, 3, 1] = scene.scan_ne_m[1] + scene.end_radius_m * np.sin(phi4)
    else:
        points[:, 3, :2] = scene.final_ne_m
    points[:, 3, 2] = scene.floor_amsl_m + z4 * band
    return points
