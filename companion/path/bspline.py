"""Clamped cubic B-splines, evaluated for whole populations at once.

A clamped B-spline starts at its first control point, along the first leg of the control
polygon, and ends at its last one along the last leg (paper 2.4).  With four control points,
as in the paper, it is the cubic Bezier curve.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import final

import numpy as np
from scipy.interpolate import BSpline

from companion.geodesy import FloatArray


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
    value, first, second = _splines(points)
    return Basis(value=value(u), first=first(u), second=second(u))


@lru_cache(maxsize=8)
def _splines(points: int) -> tuple[BSpline, BSpline, BSpline]:
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, points - 2), np.ones(3)])
    spline = BSpline(knots, np.eye(points), 3)
    return spline, spline.derivative(1), spline.derivative(2)


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
