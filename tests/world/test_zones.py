"""Distances to zones, in each form they have, against shapely and winding numbers; and radars."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from planning import drawn_zones
from planning import zones_distance_m as truth_m

from companion.geodesy import FloatArray
from companion.objective import may_be_near
from companion.world.radars import Radar, detection_probability
from companion.world.zones import (
    PolygonZone,
    Zone,
    gaps_m,
    near_cells,
    near_on_lattice,
    nearest,
    packed,
    polygon_at,
    too_near,
    zone_distance,
)

seeds = st.integers(0, 10**6)


def drawn(seed: int, count: int) -> tuple[np.random.Generator, tuple[Zone, ...], FloatArray]:
    """Zones; and points (N, 2): so many anywhere, then corners and middles of edges."""
    rng = np.random.default_rng(seed)
    zones = drawn_zones(rng, int(rng.integers(0, 12)), 0.0, 800.0, 600.0, 0.2)
    corners = [np.array(zone.vertices_ne_m) for zone in zones if isinstance(zone, PolygonZone)]
    middles = [0.5 * (each + np.roll(each, 1, axis=0)) for each in corners]
    points = [rng.uniform(-1_500.0, 1_500.0, (count, 2)), *(x[:3] for x in corners + middles)]
    return rng, zones, np.concatenate(points)


@given(seed=seeds, within_m=st.sampled_from([0.0, 5.0, 80.0, math.inf]))
def test_the_distance_of_points_is_that_to_the_nearest_edge_negative_inside(
    seed: int, within_m: float
) -> None:
    _, zones, points = drawn(seed, 60)
    truth, (north, east) = truth_m(zones, points), points.T
    with np.errstate(invalid="ignore"):  # of no place it is none
        assert np.isnan(gaps_m(zones, np.array([np.nan]), east[:1])[0])
    told = gaps_m(zones, north, east, within_m)
    assert told == pytest.approx(np.minimum(truth, within_m), abs=1e-6)
    for zone in zones:
        expected = pytest.approx(truth_m((zone,), points), abs=1e-6)
        assert zone.distance_m(north, east) == expected
    for point, gap_m in zip(points[:5], truth.tolist(), strict=False):
        zone, told_m = nearest(zones, *point.tolist())
        assert (zone is None) == (not zones)
        assert told_m == pytest.approx(gap_m, abs=1e-6)
        assert zone is None or told_m == pytest.approx(truth_m((zone,), point[None])[0], abs=1e-6)


@given(seed=seeds)
def test_the_scalar_form_that_is_compiled_tells_the_same(seed: int) -> None:
    _, zones, points = drawn(seed, 10)
    zones = tuple(zone for zone in zones if isinstance(zone, PolygonZone))
    for k, zone in enumerate(zones):
        truth = truth_m((zone,), points)
        for enough, most in ((1e9, 1e9), (80.0, 5.0)):
            at = [polygon_at(packed(zones), k, n, e, enough, most) for n, e in points.tolist()]
            assert at == pytest.approx(np.clip(truth, -most, enough), abs=1e-6)


@given(seed=seeds)
def test_a_segment_is_as_far_as_its_nearest_point_and_no_bound_is_optimistic(seed: int) -> None:
    rng, zones, _ = drawn(seed, 0)
    begin, end = rng.uniform(-1_500.0, 1_500.0, (2, 2))
    end = np.where(rng.random(2) < 0.2, begin, end)  # along an axis, or a point
    way = begin + np.linspace(0.0, 1.0, 2_001)[:, None] * (end - begin)
    truth, step_m = float(truth_m(zones, way).min()), math.dist(begin, end) / 2_000.0
    segment = (*begin.tolist(), 0.0, *(end - begin).tolist(), 0.0)
    lower, upper = zone_distance(packed(zones), segment, 1e9)
    assert lower <= min(truth, 1e9) + 1e-6
    assert upper >= min(truth, 1e9) - step_m - 1e-9
    assert upper <= min(truth_m(zones, way[[0, 1_000]]).min(), 1e9) + 1e-6
    if truth > step_m + 1e-6:  # it is wholly where it may be
        assert lower == upper >= min(truth, 1e9) - step_m - 1e-9
    only = tuple(zone for zone in zones if isinstance(zone, PolygonZone))
    if only and truth_m(only, way).min() > step_m + 1e-6:
        line, rings = shapely.LineString([begin, end]), [z.vertices_ne_m for z in only]
        exact = min(line.distance(shapely.LinearRing(ring)) for ring in rings)
        assert zone_distance(packed(only), segment, 1e9)[0] == pytest.approx(exact, abs=1e-6)


@given(seed=seeds, distance_m=st.floats(-60.0, 300.0))
def test_no_place_near_a_zone_is_left_out_of_a_lattice(seed: int, distance_m: float) -> None:
    rng, zones, _ = drawn(seed, 0)
    corner_ne_m, shape = (-1_300.0, -1_200.0), (29, 33)
    points = np.array(corner_ne_m) + 80.0 * np.argwhere(np.ones(shape))
    truth = truth_m(zones, points).reshape(shape)
    found = too_near(zones, corner_ne_m, 80.0, shape, distance_m)
    sure = np.abs(truth - distance_m) > 1e-6
    assert (found == (truth < distance_m))[sure].all()
    plain = near_on_lattice(packed(zones), corner_ne_m, 80.0, (5, 5), distance_m)
    assert (plain == found[:5, :5]).all()
    if distance_m > 20.0:
        cells = near_cells(zones, (-2_000.0, 2_000.0), (-1_000.0, 2_000.0), distance_m)
        points = rng.uniform(-2_500.0, 2_500.0, (300, 2))
        told = np.array([may_be_near(cells, *point) for point in points])
        assert told[truth_m(zones, points) < distance_m].all()
        assert zones or not cells.near.any()


@given(range_m=st.floats(1.0, 1e5), fraction=st.floats(0.0, 1.0))
def test_detection_is_equation_3_within_the_range_and_nothing_beyond(
    range_m: float, fraction: float
) -> None:
    d = np.array([fraction * range_m, range_m, np.nextafter(range_m, np.inf)])
    told = detection_probability(d, range_m)
    assert told[0] == pytest.approx(range_m**4 / (range_m**4 + d[0] ** 4))
    assert told[1:].tolist() == [0.5, 0.0]
    radar = Radar(name="r", centre_nea_m=(100.0, -200.0, 50.0), range_m=range_m)
    points = np.random.default_rng(1).normal(size=(3, 4, 3)) * 1_000.0
    away = [[math.dist(point, radar.centre_nea_m) for point in row] for row in points.tolist()]
    assert radar.distance_m(points) == pytest.approx(np.array(away))
