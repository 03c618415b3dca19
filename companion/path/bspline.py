"""Clamped cubic B-splines with uniform inner knots, held as the cubics of their spans.

A clamped B-spline starts at its first control point, along the first leg of the control
polygon, and ends at its last one along the last leg (paper 2.4).  With four control points,
as in the paper, it is the cubic Bezier curve.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from companion.geodesy import FloatArray


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
