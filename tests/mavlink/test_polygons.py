"""Polygons moved by a margin, against brute force: distances to every side, the even-odd rule."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from companion.mavlink.polygons import (
    Point,
    cleaned,
    crosses_itself,
    offset,
)
from companion.world.zones import PolygonZone

SQUARE = ((0.0, 0.0), (0.0, 100.0), (100.0, 100.0), (100.0, 0.0))
margins = st.floats(0.5, 20.0)


@st.composite
def stars(draw: st.DrawFn) -> tuple[Point, ...]:
    """Simple polygons with inlets: corners round a point, at any distance."""
    count = draw(st.integers(3, 10))
    reach = draw(st.lists(st.floats(5.0, 200.0), min_size=count, max_size=count))
    turn = draw(st.sampled_from([1.0, -1.0]))
    return tuple(
        (r * math.cos(turn * k * math.tau / count), r * math.sin(turn * k * math.tau / count))
        for k, r in enumerate(reach)
    )


def meet(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Whether two segments share a point, by their smallest distance on a fine grid of both."""
    t = np.linspace(0.0, 1.0, 201)[:, None]
    one = np.asarray(a) + t * (np.asarray(b) - a)
    other = np.asarray(c) + t * (np.asarray(d) - c)
    gaps = np.hypot(*(one[:, None, :] - other[None, :, :]).transpose(2, 0, 1))
    return float(gaps.min()) < 1e-9


def outside_m(vertices: tuple[Point, ...], points: np.ndarray) -> np.ndarray:
    """Positive outside; as the zones have it, which is tested against brute force elsewhere."""
    zone = PolygonZone(name="", vertices_ne_m=vertices)
    return zone.distance_m(points[:, 0], points[:, 1])


def grid(vertices: tuple[Point, ...], beyond_m: float) -> np.ndarray:
    a = np.asarray(vertices)
    axes = [np.linspace(a[:, k].min() - beyond_m, a[:, k].max() + beyond_m, 61) for k in (0, 1)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


MOUTH = ((100.0, 53.0), (20.0, 53.0), (20.0, 47.0), (100.0, 47.0))
CAVE = ((60.0, 53.0), (60.0, 80.0), (20.0, 80.0), (20.0, 20.0), (60.0, 20.0), (60.0, 47.0))
INLET = (*SQUARE[:3], *MOUTH, SQUARE[3])
BOTTLE = (*SQUARE[:3], (100.0, 53.0), *CAVE, (100.0, 47.0), SQUARE[3])


def test_a_square_grows_and_shrinks_as_it_ought_to() -> None:
    for square in (SQUARE, SQUARE[::-1]):
        for margin_m in (5.0, -5.0):
            low, high = -margin_m, 100.0 + margin_m
            moved = offset(square, margin_m)
            assert moved is not None
            assert set(moved) == {(low, low), (low, high), (high, high), (high, low)}
        assert offset(square, -50.0) is None


@pytest.mark.parametrize("shape", [INLET, BOTTLE])
def test_an_inlet_that_is_too_narrow_is_closed_outwards_and_wide_enough_inwards(
    shape: tuple[Point, ...],
) -> None:
    """The mouth is 6 m wide."""
    for margin_m in (2.0, 4.0, -4.0):
        moved = offset(shape, margin_m)
        assert moved is not None
        assert not crosses_itself(moved)
        points = grid(shape, 10.0)
        moved_m, shape_m = outside_m(moved, points), outside_m(shape, points)
        if margin_m > 0.0:
            assert np.all(moved_m[shape_m < margin_m - 1e-6] < 1e-6)
        else:
            assert np.all(shape_m[moved_m < -1e-6] <= margin_m + 1e-6)
    assert offset(shape, -9.0) is not None
    assert offset(shape, -10.5) is None  # the wall behind it is 20 m thick: it falls into parts


@given(vertices=stars(), margin_m=margins)
def test_what_is_moved_outwards_holds_all_that_is_near(
    vertices: tuple[Point, ...], margin_m: float
) -> None:
    moved = offset(vertices, margin_m)
    assert moved is not None
    points = grid(vertices, 2.0 * margin_m)
    near = outside_m(vertices, points) < margin_m - 1e-6
    assert np.all(outside_m(moved, points)[near] < 1e-6)


@given(vertices=stars(), margin_m=margins)
def test_what_is_moved_inwards_holds_nothing_that_is_near_the_edge(
    vertices: tuple[Point, ...], margin_m: float
) -> None:
    moved = offset(vertices, -margin_m)
    assume(moved is not None)
    assert moved is not None
    points = grid(vertices, 0.0)
    kept = outside_m(moved, points) < -1e-6
    assert np.all(outside_m(vertices, points)[kept] <= -margin_m + 1e-6)


@given(vertices=st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=4, max_size=6))
def test_crossing_sides_are_found(vertices: list[tuple[int, int]]) -> None:
    ring = cleaned([(float(north), float(east)) for north, east in vertices])
    assume(len(ring) > 3 and len(set(ring)) == len(ring))
    count = len(ring)
    sides = [(ring[k], ring[(k + 1) % count]) for k in range(count)]
    crossing = any(
        meet(*sides[i], *sides[j])
        for i in range(count)
        for j in range(i + 2, count)
        if (i, j) != (0, count - 1)
    )
    if crossing:
        assert crosses_itself(ring)


@given(vertices=stars())
def test_stars_do_not_cross_themselves(vertices: tuple[Point, ...]) -> None:
    assert not crosses_itself(vertices)


@pytest.mark.parametrize(
    "ring",
    [
        ((0.0, 0.0), (100.0, 100.0), (100.0, 0.0), (0.0, 100.0)),
        ((0.0, 0.0), (0.0, 100.0), (0.0, 50.0), (50.0, 50.0)),
    ],
)
def test_a_bow_and_a_fold_cross_themselves(ring: tuple[Point, ...]) -> None:
    assert crosses_itself(ring)


def test_corners_that_are_given_twice_count_once() -> None:
    assert cleaned([SQUARE[0], *SQUARE, SQUARE[3], SQUARE[0]]) == SQUARE
