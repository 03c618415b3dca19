"""What one subpath is planned in, and the weights of what it costs, in profile `flight`.

What differs from the paper as printed (`paper.terms`), and why, is in design 5.2; how control
points are drawn from the search's variables, in `planner-numbers`, part E.

The costs themselves are in `kernel`.  One more term takes two places: a row of `Weights`, from
which the key of the mission file, journal, report, view and figures derive, and `kernel`, where it
is named and computed, in `cost`.
"""

from dataclasses import fields
from typing import NamedTuple

import numpy as np

from companion.geodesy import FloatArray
from companion.path.bspline import uniform_basis
from companion.path.envelope import Envelope
from companion.path.subpath import Pose
from companion.profiles import Weights
from companion.world.clearance import Surface
from companion.world.radars import Radar
from companion.world.zones import NearCells, ZoneTable

TERMS = (*(each.name for each in fields(Weights)), "to_go")
"""Names of the terms of the cost; what is left to fly after the end weighs as much as length."""


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
