"""What one subpath is planned in, and the weights of what it costs, in profile `flight`.

What differs from the paper as printed (`paper.terms`), and why, is in design 5.2:

- the curve has five or six control points, of which the third continues the curvature of the
  subpath before it (`planner-numbers` part E), so joins are smooth to the second derivative; its
  end lies anywhere within the circle on whose rim the paper has it, and from rest it leaves in any
  direction;
- f1 is the length of the curve, not of its control polygon, and goes on beyond the curve: what is
  left to fly is the cost-to-go at its end, in the same currency;
- f3 pulls towards where the best way to the target leaves the circle;
- f4 counts what lies below a surface that already stands off the terrain, and below that on the
  stretch that the vehicle would cover if the companion died (a plane would circle: the surface
  stands off by its circle too);
- f6 bounds the curvature and the climb of the curve itself.

The costs themselves are in `kernel`.  One more term takes two places: a row of `Weights` here, from
which the key of the mission file, journal, report and figures derive, and a line in `kernel.cost`.
"""

from dataclasses import fields
from typing import NamedTuple

import numpy as np

from companion.geodesy import FloatArray
from companion.path.bspline import uniform_basis
from companion.path.envelope import Envelope
from companion.path.limits import Limits
from companion.path.subpath import Pose
from companion.profiles import Weights
from companion.world.clearance import Surface
from companion.world.radars import Radar
from companion.world.zones import NearCells, ZoneTable

TERMS = (*(each.name for each in fields(Weights)), "to_go")
"""Names of the terms of the cost; what is left to fly after the end weighs as much as length."""


class Bounds(NamedTuple):
    """Of `Limits` what the cost depends on, as numba takes it."""

    turn_radius_m: float
    climb_angle_rad: float
    dive_angle_rad: float
    hovers: bool
    north_m: tuple[float, float]
    east_m: tuple[float, float]

    @staticmethod
    def of(limits: Limits) -> "Bounds":
        """Those of a vehicle and its map."""
        return Bounds(
            turn_radius_m=float(limits.turn_radius_m),
            climb_angle_rad=float(limits.climb_angle_rad),
            dive_angle_rad=float(limits.dive_angle_rad),
            hovers=limits.hovers,
            north_m=limits.north_m,
            east_m=limits.east_m,
        )


class Workspace(NamedTuple):
    """The shape of a curve of so many control points, and room for one candidate."""

    basis: FloatArray  # (3, S + 1, points): values, first and second derivatives
    control: FloatArray  # (points, 3)
    points: FloatArray  # (S + 1, 4): position and length flown
    ahead: FloatArray  # (S + 1, 3): first derivatives
    terms: FloatArray  # (TERMS,): unweighted, of the candidate before
    gaps: FloatArray  # (polygons,): distance of the point before from each

    @staticmethod
    def of(points: int, samples: int, polygons: int) -> "Workspace":
        """For curves of so many control points, looked at in so many samples."""
        at = uniform_basis(samples, points)
        basis = np.stack([at.value, at.first, at.second])
        sizes = (points, 3), (samples + 1, 4), (samples + 1, 3), (len(TERMS),), (polygons,)
        return Workspace(basis, *map(np.zeros, sizes))


class Scene(NamedTuple):
    """Everything that the cost of one subpath depends on, as numba takes it.

    Positions are north, east, altitude AMSL; metres, radians.
    """

    weights: tuple[float, ...]
    """Of `TERMS`."""
    limits: Bounds
    motion: Envelope
    margin: float
    """Factor on the turn radius and on the steepness that the search aims at."""
    start: FloatArray  # (3, 3): p_prog, the tangent and the curvature there
    from_rest: bool
    """Whether it starts from a hover: slow at first, and in any direction."""
    shortest_m: float
    """The least length: in flight, what the vehicle stops in."""
    scan_ne_m: tuple[float, float]
    """p_scan: the centre of the circle in which the subpath ends."""
    scan_range_m: float
    """R, the unit of distances along the curve."""
    end_radius_m: float
    """Radius of that circle: so much of R that d_s is kept inside."""
    is_final: bool
    """Whether the subpath ends at the target."""
    final_ne_m: tuple[float, float]
    """The target."""
    guide_rad: float
    """Bearing of the guide direction from p_scan."""
    to_go: Surface
    """Cost to the target from each place, in metres of level flight at the floor of the band."""
    needed: Surface
    """The lowest altitude at each place from which the way on can be climbed, AMSL."""
    look_ahead_m: float
    """The cost-to-go counts so far straight on from the end: an end that faces terrain is dear."""
    descent_m: float
    """What it costs to come down from the ceiling to the floor, in metres of level flight."""
    safety_distance_m: float
    """d_s."""
    clearance_m: float
    """What the search keeps from zones."""
    surface: Surface
    """The altitude that keeps the clearance from the terrain."""
    contact: Surface
    """The altitude that the dead-man stretch must keep."""
    band_amsl_m: tuple[float, float]
    """Lowest and highest altitude to plan for: the vehicle on the path stays in the band too."""
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
        samples, polygons = self.at.basis.shape[1] - 1, len(self.at.gaps)
        return self._replace(at=Workspace.of(count, samples, polygons))


def weights_of(weights: Weights) -> tuple[float, ...]:
    """Of `TERMS`."""
    return tuple(float(getattr(weights, "length" if n == "to_go" else n)) for n in TERMS)


def rows_of(pose: Pose) -> FloatArray:
    """Position, tangent and curvature.  -> (3, 3)."""
    return np.stack([pose.position_nea_m, pose.tangent_nea, pose.curvature_nea_1_m]).astype(float)


def radar_table(radars: tuple[Radar, ...], margin_m: float) -> FloatArray:
    """Radars as `Scene.radars`; margin_m: beyond their range, for what lies between samples."""
    rows = [(*each.centre_nea_m, each.range_m, each.range_m + margin_m) for each in radars]
    return np.array(rows, dtype=np.float64).reshape(-1, 5)
