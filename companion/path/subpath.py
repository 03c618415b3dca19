"""Clamped cubic B-splines with uniform inner knots, and subpaths: one by the length flown along it.

A clamped B-spline starts at its first control point, along the first leg of the control polygon,
and ends at its last one along the last leg (paper 2.4).  With four control points, as in the paper,
it is the cubic Bezier curve.  It is held as the cubics of its spans.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import NamedTuple, final

import numpy as np

from companion.geodesy import FloatArray

_TABLE = 2000  # chords of the arc-length table: 10 m on a 20 km subpath
_PARAMETERS = np.linspace(0.0, 1.0, _TABLE + 1)


class Samples(NamedTuple):
    """Values and the first two derivatives by u, which is 0 to 1 along the spline; each (S, D)."""

    value: FloatArray
    first: FloatArray
    second: FloatArray


def cubics_of(control: FloatArray) -> FloatArray:
    """Coefficients of 1, t, t^2, t^3, 0 <= t <= 1, of each span.  (points, D) -> (spans, 4, D).

    They are taken from the legs of the polygon: where control points coincide the speed is
    exactly 0.
    """
    cubics: FloatArray = _cubics_by_legs(len(control)) @ np.diff(control, axis=0)
    cubics[:, 0] += control[0]
    return cubics


def samples_at(cubics: FloatArray, u: FloatArray) -> Samples:
    """The spline at parameters.  (spans, 4, D), (S,)."""
    spans = len(cubics)
    span = np.minimum((u * spans).astype(np.intp), spans - 1)
    t = (u * spans - span)[:, None]
    c0, c1, c2, c3 = cubics.transpose(1, 0, 2)[:, span]
    return Samples(
        value=c0 + t * (c1 + t * (c2 + t * c3)),
        first=(c1 + t * (2.0 * c2 + t * 3.0 * c3)) * spans,
        second=(2.0 * c2 + t * 6.0 * c3) * spans**2,
    )


@lru_cache(maxsize=64)
def uniform_basis(samples: int, points: int = 4) -> Samples:
    """The basis functions at u = j / samples, j = 0 .. samples; D is the number of points.

    They are the splines whose control points are 0 but for one.
    """
    return samples_at(cubics_of(np.eye(points)), np.linspace(0.0, 1.0, samples + 1))


@lru_cache(maxsize=8)
def _cubics_by_legs(points: int) -> FloatArray:
    """Cubics of the splines of which one leg is 1 long and the others 0.  -> (spans, 4, legs).

    The derivative of a spline is a spline with the differences of its control points, each divided
    by the stretch of knots that it spans (de Boor, A Practical Guide to Splines, chapter X).
    """
    spans = points - 3
    knots = np.clip(np.arange(-3.0, spans + 4.0), 0.0, spans)[:, None]
    control = np.tril(np.ones((points, points - 1)), -1)
    first = 3.0 * np.diff(control, axis=0) / (knots[4:-1] - knots[1:-4])
    second = 2.0 * np.diff(first, axis=0) / (knots[4:-2] - knots[2:-4])  # at the knots
    third = np.diff(second, axis=0)  # on each span
    speed = 0.5 * (first[:-2] + first[1:-1])  # at the knots: inside halfway between two
    speed[0] = first[0]
    moved = speed + second[:-1] / 2.0 + third / 6.0
    start = np.cumsum(moved, axis=0) - moved
    return np.stack([start, speed, second[:-1] / 2.0, third / 6.0], axis=1)


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
        lengths_m = self._length_at_m  # by hand: np.interp takes four times as long for one
        k = int(lengths_m.searchsorted(length_m, side="right")) - 1
        u, spans = float(k >= 0), len(self._axes)
        if 0 <= k < _TABLE:
            before_m, after_m = lengths_m[k : k + 2].tolist()
            u = (k + (length_m - before_m) / (after_m - before_m)) / _TABLE
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
            first, bend = [inward * component for component in second], np.zeros(3)
            speed = math.hypot(*first)
        speed = max(speed, 1e-12)
        tangent = np.array(first) / speed
        return Pose(
            position_nea_m=np.array(position),
            tangent_nea=tangent,
            curvature_nea_1_m=(bend - (bend @ tangent) * tangent) / speed**2,
        )

    def parameters_at(self, lengths_m: FloatArray) -> FloatArray:
        """The parameters of the curve, 0 to 1, after lengths flown, metres.  (S,) -> (S,)."""
        return np.interp(lengths_m, self._length_at_m, _PARAMETERS)

    def length_at_m(self, u: float) -> float:
        """Length flown at a parameter of the curve, 0 <= u <= 1, metres."""
        return float(np.interp(u, _PARAMETERS, self._length_at_m))

    def samples_at(self, lengths_m: FloatArray) -> Samples:
        """Points and derivatives after lengths flown.  (S,) -> (S, 3)."""
        return samples_at(self._cubics, self.parameters_at(lengths_m))

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
