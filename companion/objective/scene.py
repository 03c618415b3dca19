"""What one subpath is planned in, and what it costs in profile `flight`: the paper's six terms.

What differs from the paper as printed (`paper.terms`), and why, is in design 5.2:

- the curve has five or six control points, of which the third continues the curvature of the
  subpath before it (`planner-numbers` part E), so joins are smooth to the second derivative;
- f1 is the length of the curve, not of its control polygon, and goes on beyond the curve: what is
  left to fly is the cost-to-go at its end, in the same currency;
- f3 pulls towards where the best way to the target leaves the circle;
- f4 counts what lies below a surface that already stands off the terrain, and below that on the
  stretch that the vehicle would cover if the companion died (a plane would circle: the surface
  stands off by its circle too);
- f6 bounds the curvature and the climb of the curve itself.

The costs themselves are in `kernel`.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.envelope import Envelope
from companion.path.limits import Limits
from companion.path.subpath import Pose
from companion.profiles import Weights
from companion.world.clearance import Surface
from companion.world.radars import Radar
from companion.world.zones import NearCells, Zone

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
    motion: Envelope
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


def weight(term: str, scene: FlightScene) -> float:
    """The weight of a term: a_1 .. a_6 of eq. 5; what is left to fly weighs as much as length."""
    return float(getattr(scene.weights, "length" if term == "to_go" else term))
