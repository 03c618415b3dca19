"""A subpath: one B-spline curve, parametrised by the length flown along it."""

import bisect
import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.bspline import Basis, Cubics, basis, uniform_basis

_TABLE = 2000  # chords of the arc-length table: 10 m on a 20 km subpath
_PARAMETERS = np.linspace(0.0, 1.0, _TABLE + 1)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """A point of a curve, the direction in which the curve leaves it, and how it bends there."""

    position_nea_m: FloatArray  # (3,)
    tangent_nea: FloatArray  # (3,), unit length
    curvature_nea_1_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,), across the tangent: the derivative of the tangent by the length flown."""

    @property
    def point_nea_m(self) -> tuple[float, float, float]:
        """The position as plain numbers."""
        north, east, altitude = self.position_nea_m.tolist()
        return north, east, altitude

    def facing(self, bearing_rad: float) -> "Pose":
        """The pose of a vehicle at rest, turned to a bearing: level, and without a bend."""
        tangent = np.array([math.cos(bearing_rad), math.sin(bearing_rad), 0.0])
        return replace(self, tangent_nea=tangent, curvature_nea_1_m=np.zeros(3))


@final
@dataclass(frozen=True, kw_only=True, eq=False)  # no slots: its length is found when asked for
class Subpath:
    """A clamped cubic B-spline and its arc length."""

    control_nea_m: FloatArray  # (points, 3)
    _newest: list[tuple[float, Pose]] = field(init=False, repr=False, default_factory=list)
    """The pose that was asked for last: in flight it is asked for again."""

    @cached_property
    def length_m(self) -> float:
        """Of the curve."""
        return float(self._length_at_m[-1])

    @cached_property
    def _length_at_m(self) -> FloatArray:
        """Length flown at uniform parameters.  -> (_TABLE + 1,)."""
        points = uniform_basis(_TABLE, len(self.control_nea_m)).value @ self.control_nea_m
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=-1))])

    @cached_property
    def _cubics(self) -> Cubics:
        return Cubics(self.control_nea_m)

    def is_longer_than(self, length_m: float) -> bool:
        """Whether its length is more than this: the exact one is only looked for if need be."""
        legs = np.diff(self.control_nea_m, axis=0)
        if float(np.linalg.norm(legs.sum(axis=0))) > length_m:
            return True
        return float(np.linalg.norm(legs, axis=-1).sum()) > length_m < self.length_m

    def _basis_at(self, lengths_m: FloatArray) -> Basis:
        u = np.interp(lengths_m, self._length_at_m, _PARAMETERS)
        return basis(u, len(self.control_nea_m))

    def pose(self, length_m: float) -> Pose:
        """Where the curve is after a length flown, metres from its start (clamped to its ends)."""
        if self._newest and self._newest[0][0] == length_m:
            return self._newest[0][1]
        position, first, second = self._cubics.at(self.parameter_at(length_m))
        speed = math.hypot(*first)
        if speed < 1e-6 * self.length_m:  # control points coincide: the direction is a limit
            inward = 1.0 if 2.0 * length_m < self.length_m else -1.0
            first, second = tuple(inward * each for each in second), (0.0, 0.0, 0.0)
            speed = math.hypot(*first)
        speed = max(speed, 1e-12)
        tangent = np.array(first) / speed
        bend = np.array(second)
        across = bend - (bend @ tangent) * tangent
        pose = Pose(
            position_nea_m=np.array(position),
            tangent_nea=tangent,
            curvature_nea_1_m=across / speed**2,
        )
        self._newest[:] = [(length_m, pose)]
        return pose

    def points_nea_m(self, lengths_m: FloatArray) -> FloatArray:
        """Points of the curve after lengths flown (clamped to its ends).  (S,) -> (S, 3)."""
        return self._basis_at(lengths_m).value @ self.control_nea_m

    def length_at_m(self, u: float) -> float:
        """Length flown at a parameter of the curve, 0 <= u <= 1, metres."""
        return float(np.interp(u, _PARAMETERS, self._length_at_m))

    def parameter_at(self, length_m: float) -> float:
        """The parameter of the curve, 0 to 1, after a length flown."""
        lengths_m = self._length_at_m
        k = bisect.bisect_right(lengths_m, length_m) - 1
        if not 0 <= k < _TABLE:
            return 0.0 if k < 0 else 1.0
        before_m = float(lengths_m[k])
        return (k + (length_m - before_m) / (float(lengths_m[k + 1]) - before_m)) / _TABLE

    def sampled(self, spacing_m: float) -> "Samples":
        """The curve at points of about equal spacing, both ends included."""
        count = max(int(np.ceil(self.length_m / spacing_m)), 2)
        at = self._basis_at(np.linspace(0.0, self.length_m, count + 1))
        return Samples(
            points_nea_m=at.value @ self.control_nea_m,
            first=at.first @ self.control_nea_m,
            second=at.second @ self.control_nea_m,
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Samples:
    """Points of a curve and its derivatives by its parameter, each (S, 3)."""

    points_nea_m: FloatArray
    first: FloatArray
    second: FloatArray


def straight(start_nea_m: FloatArray, end_nea_m: FloatArray) -> Subpath:
    """The straight subpath between two places."""
    shares = np.linspace(0.0, 1.0, 4)[:, None]
    return Subpath(control_nea_m=start_nea_m + shares * (end_nea_m - start_nea_m))
