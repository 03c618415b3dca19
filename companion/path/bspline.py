"""Clamped cubic B-splines, evaluated for whole populations at once.

A clamped B-spline starts at its first control point, along the first leg of the control
polygon, and ends at its last one along the last leg (paper 2.4).  With four control points,
as in the paper, it is the cubic Bezier curve.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import final

import numpy as np

from companion.geodesy import FloatArray

Triple = tuple[float, ...]
"""One number for each axis."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Basis:
    """Basis functions and their first two derivatives by u at S parameters; each (S, points)."""

    value: FloatArray
    first: FloatArray
    second: FloatArray


@lru_cache(maxsize=64)
def uniform_basis(samples: int, points: int = 4) -> Basis:
    """The basis at u = j / samples, j = 0 .. samples (the start and the end included)."""
    return basis(np.linspace(0.0, 1.0, samples + 1), points)


def basis(u: FloatArray, points: int = 4) -> Basis:
    """The basis of a clamped cubic B-spline with uniform inner knots.  (S,), 0 <= u <= 1."""
    matrices = _span_matrices(points)  # (spans, 4, points)
    spans = len(matrices)
    span = np.minimum((u * spans).astype(np.intp), spans - 1)
    t = u * spans - span
    zero, one = np.zeros_like(t), np.ones_like(t)
    value = np.stack([one, t, t**2, t**3], axis=-1)
    first = np.stack([zero, one, 2.0 * t, 3.0 * t**2], axis=-1) * spans
    second = np.stack([zero, zero, 2.0 * one, 6.0 * t], axis=-1) * spans**2
    here = matrices[span]  # (S, 4, points)
    return Basis(
        value=np.einsum("sk,skn->sn", value, here),
        first=np.einsum("sk,skn->sn", first, here),
        second=np.einsum("sk,skn->sn", second, here),
    )


@final
class Cubics:
    """One curve as a cubic of each span: what a single point costs a tenth of as by `basis`.

    In flight a point is asked for with every position.
    """

    def __init__(self, control: FloatArray) -> None:
        """control: (points, 3)."""
        coefficients = _span_matrices(len(control)) @ control  # (spans, 4, 3)
        self._axes = [tuple(map(tuple, span.T.tolist())) for span in coefficients]

    def at(self, u: float) -> tuple[Triple, Triple, Triple]:
        """Value and first two derivatives by u at one parameter, 0 <= u <= 1."""
        spans = len(self._axes)
        span = min(int(u * spans), spans - 1)
        t = u * spans - span
        value, first, second = [], [], []
        for a, b, c, d in self._axes[span]:
            value.append(a + t * (b + t * (c + t * d)))
            first.append((b + t * (2.0 * c + t * 3.0 * d)) * spans)
            second.append((2.0 * c + t * 6.0 * d) * spans**2)
        return tuple(value), tuple(first), tuple(second)


@lru_cache(maxsize=8)
def _span_matrices(points: int) -> FloatArray:
    """Coefficients of 1, t, t^2, t^3 of each basis function on each span, 0 <= t <= 1.

    Fitted through four values of the Cox-de Boor recursion, which a cubic passes exactly.
    -> (spans, 4, points).  (scipy's BSpline gives the same, and takes 0.6 s to import.)
    """
    spans = points - 3
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, spans + 1), np.ones(3)])
    t = np.linspace(0.0, 1.0, 4)
    powers = np.vander(t, 4, increasing=True)
    return np.stack(
        [np.linalg.solve(powers, _cox_de_boor((k + t) / spans, k, knots)) for k in range(spans)]
    )


def _cox_de_boor(u: FloatArray, span: int, knots: FloatArray) -> FloatArray:
    """Cubic basis functions at parameters of one span (0 is the first).  -> (S, points)."""
    lower = np.zeros((len(u), len(knots) - 1))
    lower[:, span + 3] = 1.0
    for degree in (1, 2, 3):
        count = len(knots) - 1 - degree
        higher = np.zeros((len(u), count))
        for i in range(count):
            rise = knots[i + degree] - knots[i]
            fall = knots[i + degree + 1] - knots[i + 1]
            if rise > 0.0:
                higher[:, i] += (u - knots[i]) / rise * lower[:, i]
            if fall > 0.0:
                higher[:, i] += (knots[i + degree + 1] - u) / fall * lower[:, i + 1]
        lower = higher
    return lower


def horizontal_curvature_1_m(first: FloatArray, second: FloatArray) -> FloatArray:
    """Curvature of the ground track, 1/m.  (..., 3) x2 -> (...).

    |x' y'' - y' x''| / (x'^2 + y'^2)^(3/2): the inverse of the radius that a vehicle turns at.
    first, second: derivatives of the curve by its parameter.
    """
    cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    speed = np.hypot(first[..., 0], first[..., 1])
    return np.abs(cross) / np.maximum(speed, 1e-9) ** 3


def climb_angle_rad(first: FloatArray) -> FloatArray:
    """Climb (positive) or dive (negative) angle of the curve, radians.  (..., 3) -> (...)."""
    return np.arctan2(first[..., 2], np.hypot(first[..., 0], first[..., 1]))
