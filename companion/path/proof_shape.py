"""Bounds of curvature, climb and position of a cubic over whole pieces, for the proof.

With all numerators and denominators as Bernstein coefficients of one degree, a quotient lies
between the least and the largest quotient of coefficients (mediants), and meets them at the ends.
Plain code that numba compiles as it is (see `path.proof`).
"""

import math

import numpy as np

from companion.geodesy import FloatArray

_GOOD = 1e-3  # a bound this near (relative) to a value that the curve does take is tight
_FINEST = 2.0**-20  # of a span: a piece that is not tight by then ends in a cusp
_NOTHING = 1e-14  # rounding of sums, relative
_STRAIGHT = 1e-12  # a span whose curvature is this small, relative to what it could be, is straight
_LOOKS_BACK = 1e-9
"""A leg against the track's direction, or a whole track, this short, relative, is rounding."""
_STACK = 64  # halves that wait, two for each halving: 40 at most
_BUDGET = 3_000  # pieces; what is not within the limit by then is not proven
_CHOOSE_8 = np.array([1.0, 8.0, 28.0, 56.0, 70.0, 56.0, 28.0, 8.0, 1.0])


def product(one: FloatArray, other: FloatArray) -> FloatArray:
    """Product of polynomials by their scaled coefficients.  (M,), (N,) -> (M + N - 1,)."""
    result = np.zeros(len(one) + len(other) - 1)
    for i in range(len(one)):
        for j in range(len(other)):
            result[i + j] += one[i] * other[j]
    return result


def hodograph(cubics: FloatArray, span: int, axis: int, start: float, end: float) -> FloatArray:
    """Scaled Bernstein coefficients of a coordinate's derivative over start <= t <= end; (3,)."""
    c1, c2 = float(cubics[span, 1, axis]), 2.0 * float(cubics[span, 2, axis])
    c3 = 3.0 * float(cubics[span, 3, axis])
    first = c1 + (c2 + c3 * start) * start
    middle = c1 + 0.5 * c2 * (start + end) + c3 * start * end
    last = c1 + (c2 + c3 * end) * end
    nothing = _NOTHING * (abs(c1) + abs(c2) + abs(c3))
    return np.array((
        first if abs(first) > nothing else 0.0,
        2.0 * middle if abs(middle) > nothing else 0.0,
        last if abs(last) > nothing else 0.0,
    ))  # fmt: skip


def speed_squared(cubics: FloatArray, span: int, start: float, end: float) -> FloatArray:
    """Scaled Bernstein coefficients of x'^2 + y'^2 over a piece; (5,)."""
    x = hodograph(cubics, span, 0, start, end)
    y = hodograph(cubics, span, 1, start, end)
    return product(x, x) + product(y, y)


def quotient(above: FloatArray, below: FloatArray) -> tuple[float, float]:
    """Least and largest quotient of coefficients; (0, inf) where a denominator is not positive.

    Where both are 0, at the end of a curve that starts or stops there, they say nothing.
    """
    least, most = math.inf, 0.0
    for k in range(len(above)):
        if below[k] > 0.0:
            least = min(least, above[k] / below[k])
            most = max(most, above[k] / below[k])
        elif below[k] < 0.0 or above[k] > 0.0:
            return 0.0, math.inf
        else:
            least = 0.0
    return max(least, 0.0), most


def size_of(cubics: FloatArray, span: int) -> float:
    """Upper bound of the derivative's coordinates over a span."""
    size = 0.0
    for k in range(1, 4):
        size += k * np.abs(cubics[span, k]).sum()
    return size


def curvature_squared(
    cubics: FloatArray, span: int, start: float, end: float, forward: bool
) -> tuple[float, float]:
    """Upper bound of the squared horizontal curvature over a piece, and its value at an end.

    (x'y'' - y'x'')^2, of degree 4, over (x'^2 + y'^2)^3, of degree 12.
    """
    x1, y1 = float(cubics[span, 1, 0]), float(cubics[span, 1, 1])
    x2, y2 = float(cubics[span, 2, 0]), float(cubics[span, 2, 1])
    x3, y3 = float(cubics[span, 3, 0]), float(cubics[span, 3, 1])
    k0, k1 = 2.0 * (x1 * y2 - y1 * x2), 6.0 * (x1 * y3 - y1 * x3)
    k2 = 6.0 * (x2 * y3 - y2 * x3)
    speed = speed_squared(cubics, span, start, end)
    if max(abs(k0), max(abs(k1), abs(k2))) <= _STRAIGHT * size_of(cubics, span) ** 2:
        may_stop = speed.min() <= 0.0  # and turn back
        return (math.inf if may_stop and not forward else 0.0), 0.0
    middle = 2.0 * k0 + k1 * (start + end) + 2.0 * k2 * start * end
    cross = np.array((k0 + (k1 + k2 * start) * start, middle, k0 + (k1 + k2 * end) * end))
    above = product(product(cross, cross), _CHOOSE_8)
    below = product(product(speed, speed), speed)
    value = 0.0
    for at in (0, 12):
        if below[at] > 0.0:
            value = max(value, above[at] / below[at])
    return quotient(above, below)[1], value


def climb_tangent(
    cubics: FloatArray, span: int, start: float, end: float, sign: float
) -> tuple[float, float]:
    """Upper bound of the climb (sign 1) or dive (-1), as a tangent, over a piece; value at an end.

    From z'^2 over x'^2 + y'^2, both of degree 4.
    """
    rise = sign * hodograph(cubics, span, 2, start, end)
    speed = speed_squared(cubics, span, start, end)
    least, most = quotient(product(rise, rise), speed)
    bound = math.sqrt(most)
    if rise.max() <= 0.0:
        bound = -math.sqrt(least) if least < math.inf else 0.0
    value = -math.inf
    if speed[0] > 0.0:
        value = rise[0] / math.sqrt(speed[0])
    if speed[4] > 0.0:
        value = max(value, rise[2] / math.sqrt(speed[4]))
    return bound, value


def runs_forward(cubics: FloatArray) -> bool:
    """Whether the ground track never runs against the direction from its start to its end."""
    spans = cubics.shape[0]
    dn, de, size = 0.0, 0.0, 0.0
    for span in range(spans):
        size = max(size, size_of(cubics, span))
        for k in range(1, 4):
            dn += float(cubics[span, k, 0])
            de += float(cubics[span, k, 1])
    chord, moves = math.sqrt(dn * dn + de * de), False
    for span in range(spans):
        x, y = hodograph(cubics, span, 0, 0.0, 1.0), hodograph(cubics, span, 1, 0.0, 1.0)
        for k in range(3):
            moves = moves or x[k] != 0.0 or y[k] != 0.0
            if x[k] * dn + y[k] * de < -_LOOKS_BACK * size * chord:
                return False
    return not moves or chord > _LOOKS_BACK * size


def largest(cubics: FloatArray, what: int, limit: float, accuracy: float) -> tuple[float, int]:
    """Upper bound of a quantity over the whole curve, and the pieces that it took.

    what: 0 squared curvature, 1 climb, -1 dive (as tangents).  Refined until it is within
    `limit`, and until it is good to `accuracy` (absolute), unless a value beyond the limit is met.
    """
    stack = np.empty((_STACK, 2))
    forward = runs_forward(cubics)
    bound, value, count = -math.inf, -math.inf, 0
    for span in range(cubics.shape[0]):
        stack[0, 0], stack[0, 1] = 0.0, 1.0
        depth = 1
        while depth > 0:
            depth -= 1
            start, end = float(stack[depth, 0]), float(stack[depth, 1])
            if what == 0:
                most, reached = curvature_squared(cubics, span, start, end, forward)
            else:
                most, reached = climb_tangent(cubics, span, start, end, float(what))
            count += 1
            value = max(value, reached)
            enough = max(value, 0.0) * (1.0 + 2.0 * accuracy) + accuracy * 0.1 * limit
            if value <= limit:
                enough = min(enough, limit)
            tight = most <= reached + _GOOD * max(abs(reached), 0.1 * limit)
            if most <= enough or tight or end - start < _FINEST or count >= _BUDGET:
                bound = max(bound, most)
            else:
                middle = 0.5 * (start + end)
                stack[depth, 0], stack[depth, 1] = middle, end
                stack[depth + 1, 0], stack[depth + 1, 1] = start, middle
                depth += 2
    return bound, count


def extremes(cubics: FloatArray, axis: int) -> tuple[float, float]:
    """Least and largest value of a coordinate over the whole curve, at the roots of its slope."""
    low, high = math.inf, -math.inf
    for span in range(cubics.shape[0]):
        c0, c1 = float(cubics[span, 0, axis]), float(cubics[span, 1, axis])
        c2, c3 = float(cubics[span, 2, axis]), float(cubics[span, 3, axis])
        root_a, root_b = 0.0, 1.0
        inner = c2 * c2 - 3.0 * c3 * c1
        if inner > 0.0:
            q = -(c2 + math.copysign(math.sqrt(inner), c2))
            root_a = q / (3.0 * c3) if abs(q) < abs(3.0 * c3) else 0.0
            root_b = c1 / q if abs(c1) < abs(q) else 1.0
        for t in (0.0, 1.0, root_a, root_b):
            if 0.0 <= t <= 1.0:
                value = c0 + (c1 + (c2 + c3 * t) * t) * t
                low, high = min(low, value), max(high, value)
    return low, high
