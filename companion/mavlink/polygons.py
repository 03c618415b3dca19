"""Fence polygons made safe for the planner: simple, and moved outwards or inwards by a margin.

Plane geometry: points are (north, east) in metres, polygons implicitly closed.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from companion.geodesy import FloatArray

IntArray = NDArray[np.intp]
Point = tuple[float, float]
_SAME_M = 1e-3
_SHARPEST = 0.02
"""1 + cosine of the turn at a corner: sharper ones have no useful mitre (about 11 deg inside)."""


def cleaned(vertices: Sequence[Point]) -> tuple[Point, ...]:
    """Without corners that are given twice in a row."""
    kept: list[Point] = []
    for vertex in vertices:
        if not kept or math.dist(kept[-1], vertex) > _SAME_M:
            kept.append(vertex)
    while len(kept) > 1 and math.dist(kept[0], kept[-1]) <= _SAME_M:
        kept.pop()
    return tuple(kept)


def signed_area_m2(vertices: Sequence[Point]) -> float:
    """Positive if the corners go round clockwise as seen from above (north to east)."""
    north, east = np.asarray(vertices, dtype=float).T
    return 0.5 * float(np.sum(north * np.roll(east, -1) - np.roll(north, -1) * east))


def crosses_itself(vertices: Sequence[Point]) -> bool:
    """Whether two sides that are not neighbours meet, or neighbours lie on each other."""
    a = np.asarray(vertices, dtype=float)
    b = np.roll(a, -1, axis=0)
    count = len(a)
    along = b - a
    before = np.roll(along, 1, axis=0)
    folded = (np.abs(_cross(before, along)) <= 1e-9) & (np.sum(before * along, axis=1) < 0.0)
    if np.any(folded):
        return True
    first, second = _overlapping(np.minimum(a, b), np.maximum(a, b))
    steps = (second - first) % count
    apart = (steps > 1) & (steps < count - 1)
    first, second = first[apart], second[apart]
    side_1 = _cross(along[first], a[second] - a[first])
    side_2 = _cross(along[first], b[second] - a[first])
    side_3 = _cross(along[second], a[first] - a[second])
    side_4 = _cross(along[second], b[first] - a[second])
    return bool(np.any((side_1 * side_2 <= 0.0) & (side_3 * side_4 <= 0.0)))


def _overlapping(low: FloatArray, high: FloatArray) -> tuple[IntArray, IntArray]:
    """The pairs of boxes that overlap: by sweeping along the axis on which fewer do.

    (N, 2), (N, 2) -> (P,), (P,)
    """
    sweeps = []
    for axis in (0, 1):
        order = np.argsort(low[:, axis], kind="stable")
        after = np.arange(1, len(order) + 1)
        last = np.searchsorted(low[order, axis], high[order, axis], side="right")
        sweeps.append((int(np.sum(last - after)), order, last - after))
    _, order, count = min(sweeps, key=lambda sweep: sweep[0])
    one = np.repeat(np.arange(len(order)), count)
    other = one + 1 + np.arange(len(one)) - np.repeat(np.cumsum(count) - count, count)
    one, other = order[one], order[other]
    meet = np.all((low[one] <= high[other]) & (low[other] <= high[one]), axis=1)
    return one[meet], other[meet]


def _cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]


def hull(vertices: Sequence[Point]) -> tuple[Point, ...]:
    """The convex hull (Andrew's monotone chain); fewer than three corners if there is no area."""
    points = sorted(set(vertices))
    if len(points) < 3:
        return tuple(points)

    def half(ordered: Sequence[Point]) -> list[Point]:
        chain: list[Point] = []
        for point in ordered:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= 0.0:
                chain.pop()
            chain.append(point)
        return chain[:-1]

    return (*half(points), *half(points[::-1]))


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def offset(vertices: Sequence[Point], outwards_m: float) -> tuple[Point, ...] | None:
    """A simple polygon with every side moved outwards (negative: inwards), corners mitred.

    Outwards it holds every point within the distance of the polygon, inwards only points that far
    inside.  None where sides would vanish or the result would cross itself, as in a narrow inlet.
    """
    a = np.asarray(vertices, dtype=float)
    along = np.roll(a, -1, axis=0) - a
    length = np.hypot(along[:, 0], along[:, 1])
    if np.any(length <= _SAME_M):
        return None
    unit = along / length[:, None]
    sign = 1.0 if signed_area_m2(vertices) > 0.0 else -1.0
    normal = sign * np.stack([unit[:, 1], -unit[:, 0]], axis=1)  # outwards
    before = np.roll(normal, 1, axis=0)
    share = 1.0 + np.sum(before * normal, axis=1)
    if np.any(share < _SHARPEST):
        return None
    moved = a + outwards_m * (before + normal) / share[:, None]
    now_along = np.roll(moved, -1, axis=0) - moved
    if np.any(np.sum(now_along * unit, axis=1) <= _SAME_M):
        return None
    result = tuple((float(north), float(east)) for north, east in moved)
    return None if crosses_itself(result) else result
