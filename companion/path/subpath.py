"""A subpath: one B-spline curve, parametrised by the length flown along it."""

import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.bspline import Samples, cubics_of, samples_at, uniform_basis

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


@final
@dataclass(frozen=True, kw_only=True, eq=False)  # no slots: its length is found when asked for
class Subpath:
    """A clamped cubic B-spline and its arc length.  All lengths are clamped to its ends."""

    control_nea_m: FloatArray  # (points, 3)

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
    def _cubics(self) -> FloatArray:
        return cubics_of(self.control_nea_m)

    @cached_property
    def _axes(self) -> list[list[list[float]]]:
        """`_cubics` by span, axis and power, as plain numbers: one pose costs a tenth."""
        axes: list[list[list[float]]] = self._cubics.transpose(0, 2, 1).tolist()
        return axes

    def is_longer_than(self, length_m: float) -> bool:
        """Whether its length is more than this: the exact one is only looked for if need be."""
        legs = np.diff(self.control_nea_m, axis=0)
        if float(np.linalg.norm(legs.sum(axis=0))) > length_m:
            return True
        return float(np.linalg.norm(legs, axis=-1).sum()) > length_m < self.length_m

    @lru_cache(maxsize=4)  # noqa: B019 - in flight the same ones are asked for again
    def pose(self, length_m: float) -> Pose:
        """Where the curve is after a length flown, metres from its start."""
        u, spans = self.parameter_at(length_m), len(self._axes)
        span = min(int(u * spans), spans - 1)
        t, axes = u * spans - span, self._axes[span]
        position, first, second = [], [], []
        for a, b, c, d in axes:  # in one loop, which takes less time than three comprehensions
            position.append(a + t * (b + t * (c + t * d)))
            first.append((b + t * (2.0 * c + t * 3.0 * d)) * spans)
            second.append((2.0 * c + t * 6.0 * d) * spans**2)
        speed, bend = math.hypot(*first), np.array(second)
        if speed < 1e-6 * self.length_m:  # control points coincide: the direction is a limit
            inward = 1.0 if 2.0 * length_m < self.length_m else -1.0
            first, bend = [inward * each for each in second], np.zeros(3)
            speed = math.hypot(*first)
        speed = max(speed, 1e-12)
        tangent = np.array(first) / speed
        return Pose(
            position_nea_m=np.array(position),
            tangent_nea=tangent,
            curvature_nea_1_m=(bend - (bend @ tangent) * tangent) / speed**2,
        )

    def parameter_at(self, length_m: float) -> float:
        """The parameter of the curve, 0 to 1, after a length flown, metres."""
        lengths_m = self._length_at_m  # by hand: np.interp takes four times as long for one
        k = int(lengths_m.searchsorted(length_m, side="right")) - 1
        if not 0 <= k < _TABLE:
            return 0.0 if k < 0 else 1.0
        before_m, after_m = lengths_m[k : k + 2].tolist()
        return (k + (length_m - before_m) / (after_m - before_m)) / _TABLE

    def length_at_m(self, u: float) -> float:
        """Length flown at a parameter of the curve, 0 <= u <= 1, metres."""
        return float(np.interp(u, _PARAMETERS, self._length_at_m))

    def samples_at(self, lengths_m: FloatArray) -> Samples:
        """Points and derivatives after lengths flown.  (S,) -> (S, 3)."""
        return samples_at(self._cubics, np.interp(lengths_m, self._length_at_m, _PARAMETERS))

    def points_nea_m(self, lengths_m: FloatArray) -> FloatArray:
        """Points of the curve after lengths flown.  (S,) -> (S, 3)."""
        return self.samples_at(lengths_m).value

    def sampled(self, spacing_m: float) -> Samples:
        """The curve at points of about equal spacing, both ends included."""
        count = max(math.ceil(self.length_m / spacing_m), 2)
        return self.samples_at(np.linspace(0.0, self.length_m, count + 1))


def straight(start_nea_m: FloatArray, end_nea_m: FloatArray) -> Subpath:
    """The straight subpath between two places."""
    shares = np.linspace(0.0, 1.0, 4)[:, None]
    return Subpath(control_nea_m=start_nea_m + shares * (end_nea_m - start_nea_m))
