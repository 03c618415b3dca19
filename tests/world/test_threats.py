import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.objective.kernel import may_be_near
from companion.objective.scene import Near
from companion.world.threats import (
    CircleZone,
    PolygonZone,
    Radar,
    Zone,
    detection_probability,
    is_near,
    near_cells,
)

Polygon = tuple[tuple[float, float], ...]


@st.composite
def stars(draw: st.DrawFn) -> Polygon:
    """Simple polygons, convex or not: a radius at each of a few increasing angles."""
    corners = draw(st.integers(3, 9))
    radii = draw(st.lists(st.floats(50.0, 1_000.0), min_size=corners, max_size=corners))
    turn = draw(st.floats(0.0, 2.0 * math.pi))
    north, east = draw(st.floats(-500, 500)), draw(st.floats(-500, 500))
    backwards = draw(st.booleans())
    points = [
        (north + r * math.cos(turn + a), east + r * math.sin(turn + a))
        for r, a in zip(radii, np.linspace(0.0, 2.0 * math.pi, corners + 1)[:-1], strict=True)
    ]
    return tuple(points[::-1] if backwards else points)


def dense_edge(polygon: Polygon, each: int = 2_000) -> tuple[np.ndarray, float]:
    """Points along all edges, and the greatest step between two of them."""
    ends = (*polygon[1:], polygon[0])
    along = np.linspace(0.0, 1.0, each + 1)[:, None]
    points = [
        np.array(a) + along * (np.array(b) - np.array(a))
        for a, b in zip(polygon, ends, strict=True)
    ]
    step = max(math.dist(a, b) for a, b in zip(polygon, ends, strict=True)) / each
    return np.concatenate(points), step


def winding_number(polygon: Polygon, north: float, east: float) -> int:
    seen = [complex(n - north, e - east) for n, e in polygon]
    turns = [cmath.phase(b / a) for a, b in zip(seen, seen[1:] + seen[:1], strict=True)]
    return round(sum(turns) / (2.0 * math.pi))


def signed_distance(zone: PolygonZone, north: float, east: float) -> float:
    return float(zone.distance_m(np.array(north), np.array(east)))


def test_a_radar_sees_with_certainty_at_its_place_and_half_at_its_range() -> None:
    seen = detection_probability(np.array([0.0, 5_000.0, 10_000.0]), 10_000.0)
    assert seen == pytest.approx([1.0, 1.0 / (1.0 + 1.0 / 16.0), 0.5])


@given(range_m=st.floats(1.0, 1e5), fraction=st.floats(0.0, 1.0))
def test_detection_within_the_range_is_equation_3(range_m: float, fraction: float) -> None:
    d = fraction * range_m
    expected = range_m**4 / (range_m**4 + d**4)
    assert detection_probability(np.array(d), range_m) == pytest.approx(expected)


@given(range_m=st.floats(1.0, 1e5))
def test_detection_falls_from_a_half_to_nothing_at_the_range(range_m: float) -> None:
    d = np.array([range_m, np.nextafter(range_m, np.inf)])
    inside, outside = detection_probability(d, range_m)
    assert inside == 0.5
    assert outside == 0.0


def test_distance_from_a_radar_is_euclidean_for_any_shape_of_points() -> None:
    radar = Radar(name="r", centre_nea_m=(100.0, -200.0, 50.0), range_m=1.0)
    points = np.random.default_rng(1).normal(size=(3, 4, 3)) * 1_000.0
    distance = radar.distance_m(points)
    assert distance.shape == (3, 4)
    for index in np.ndindex(3, 4):
        assert distance[index] == pytest.approx(math.dist(points[index], radar.centre_nea_m))


@given(st.floats(-100, 100), st.floats(-100, 100), st.floats(1, 50))
def test_the_distance_to_a_circle_is_that_to_its_nearest_point(
    north: float, east: float, radius: float
) -> None:
    zone = CircleZone(name="c", north_m=7.0, east_m=-3.0, radius_m=radius)
    angle = np.linspace(0.0, 2.0 * math.pi, 10_001)
    ring = np.hypot(7.0 + radius * np.cos(angle) - north, -3.0 + radius * np.sin(angle) - east)
    inside = math.hypot(north - 7.0, east + 3.0) < radius
    signed = -ring.min() if inside else ring.min()
    assert zone.distance_m(np.array(north), np.array(east)) == pytest.approx(signed, abs=0.05)


@given(polygon=stars(), north=st.floats(-1_500, 1_500), east=st.floats(-1_500, 1_500))
def test_the_distance_to_a_polygon_is_that_to_its_nearest_edge_point(
    polygon: Polygon, north: float, east: float
) -> None:
    edge, step = dense_edge(polygon)
    brute = np.hypot(*(edge - (north, east)).T).min()
    distance = abs(signed_distance(PolygonZone(name="p", vertices_ne_m=polygon), north, east))
    assert distance <= brute + 1e-6
    assert brute <= math.hypot(distance, 0.5 * step) + 1e-6


@given(polygon=stars(), north=st.floats(-1_500, 1_500), east=st.floats(-1_500, 1_500))
def test_the_distance_is_negative_just_where_the_polygon_winds_around_the_point(
    polygon: Polygon, north: float, east: float
) -> None:
    distance = signed_distance(PolygonZone(name="p", vertices_ne_m=polygon), north, east)
    if abs(distance) > 1e-6:
        assert (distance < 0.0) == (winding_number(polygon, north, east) != 0)


def test_a_polygon_that_repeats_its_first_corner_to_close_itself_is_the_same_polygon() -> None:
    open_ = ((0.0, 0.0), (0.0, 100.0), (100.0, 0.0))
    closed = (*open_, open_[0])
    here = np.array([10.0, 200.0]), np.array([10.0, 5.0])
    expected = PolygonZone(name="o", vertices_ne_m=open_).distance_m(*here)
    with np.errstate(all="ignore"):
        found = PolygonZone(name="c", vertices_ne_m=closed).distance_m(*here)
    assert found == pytest.approx(expected)


def fence(corners: int, radius_m: float, seed: int, keep_in: bool) -> PolygonZone:
    """A ragged ring of corners about the origin, some of them at whole hundreds of metres."""
    rng = np.random.default_rng(seed)
    turn = np.sort(rng.uniform(0.0, 2.0 * math.pi, corners))
    far = radius_m * rng.uniform(0.6, 1.0, corners)
    places = np.round(np.stack([far * np.cos(turn), far * np.sin(turn)], -1), int(seed % 4) - 2)
    vertices = tuple((a, b) for a, b in places.tolist())
    return PolygonZone(name="f", vertices_ne_m=vertices, keep_in=keep_in)


@given(stars(), st.floats(-2_000, 2_000), st.floats(-2_000, 2_000))
def test_where_a_keep_out_forbids_a_keep_in_allows(
    polygon: Polygon, north: float, east: float
) -> None:
    out = PolygonZone(name="p", vertices_ne_m=polygon)
    within = PolygonZone(name="p", vertices_ne_m=polygon, keep_in=True)
    assert signed_distance(within, north, east) == -signed_distance(out, north, east)
    circle = CircleZone(name="c", north_m=10.0, east_m=20.0, radius_m=500.0, keep_in=True)
    away = math.hypot(north - 10.0, east - 20.0)
    assert float(circle.distance_m(np.array(north), np.array(east))) == pytest.approx(500.0 - away)


@given(st.integers(3, 60), st.integers(0, 10**6), st.booleans(), st.floats(0.5, 300.0))
def test_a_lattice_of_a_fence_is_that_of_its_distances(
    corners: int, seed: int, keep_in: bool, distance_m: float
) -> None:
    zone = fence(corners, 1_000.0, seed, keep_in)
    north, east = np.arange(-1_300.0, 1_300.0, 50.0), np.arange(-1_200.0, 1_100.0, 70.0)
    expected = zone.distance_m(*np.broadcast_arrays(north[:, None], east[None, :])) < distance_m
    np.testing.assert_array_equal(is_near(zone, north, east, distance_m), expected)


@given(st.integers(0, 10**6), st.floats(20.0, 300.0))
def test_no_place_near_a_zone_is_left_out_of_the_cells_near_zones(
    seed: int, distance_m: float
) -> None:
    zones: tuple[Zone, ...] = (
        fence(40, 1_500.0, seed, keep_in=True),
        CircleZone(name="c", north_m=300.0, east_m=-200.0, radius_m=150.0),
    )
    cells = near_cells(zones, (-2_000.0, 2_000.0), (-1_000.0, 2_000.0), distance_m)
    north, east = np.random.default_rng(seed).uniform(-2_500.0, 2_500.0, (2, 500))
    gap = np.min([zone.distance_m(north, east) for zone in zones], axis=0)
    found = [may_be_near(Near.of(cells), *place) for place in zip(north, east, strict=True)]
    assert np.array(found)[gap < distance_m].all()
    assert not cells.near.all()
