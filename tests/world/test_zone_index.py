"""Distances to many zones at once, against `distance_m` of each zone alone, on every edge."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.world import zone_index
from companion.world.threats import CircleZone, PolygonZone, Zone
from companion.world.zone_field import zone_field
from companion.world.zone_index import index_of

FloatArray = NDArray[np.float64]


def polygon(
    rng: np.random.Generator, corners: int, radius_m: float, *, crossing: bool = False
) -> PolygonZone:
    """Jagged, somewhere; crossing: its corners in any order, so that the even-odd rule matters."""
    turns = np.linspace(0.0, math.tau, corners, endpoint=False)
    turns = rng.permutation(turns) if crossing else turns
    reach = rng.uniform(0.5, 1.0, corners) * radius_m
    middle = rng.uniform(-800.0, 800.0, 2)
    places = middle + reach[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    vertices = tuple((n, e) for n, e in places.tolist())
    return PolygonZone(name="p", vertices_ne_m=vertices, keep_in=bool(rng.random() < 0.2))


def some_zones(rng: np.random.Generator) -> tuple[Zone, ...]:
    zones: list[Zone] = [
        polygon(
            rng,
            int(rng.integers(3, 60)),
            float(rng.uniform(20.0, 600.0)),
            crossing=bool(rng.random() < 0.3),
        )
        for _ in range(rng.integers(0, 8))
    ]
    for _ in range(rng.integers(0, 4)):
        n, e = rng.uniform(-800.0, 800.0, 2).tolist()
        radius_m, keep_in = float(rng.uniform(10.0, 400.0)), bool(rng.random() < 0.2)
        zones.append(CircleZone(name="c", north_m=n, east_m=e, radius_m=radius_m, keep_in=keep_in))
    return tuple(zones)


def brute_force_m(zones: tuple[Zone, ...], points: FloatArray) -> FloatArray:
    gaps = [zone.distance_m(points[:, 0], points[:, 1]) for zone in zones]
    return np.min([np.full(len(points), np.inf), *gaps], axis=0)


@given(seed=st.integers(0, 10**6), within_m=st.sampled_from([0.0, 5.0, 80.0, math.inf]))
def test_the_nearest_zone_is_as_far_as_the_nearest_of_all_edges(seed: int, within_m: float) -> None:
    rng = np.random.default_rng(seed)
    zones, points = some_zones(rng), rng.uniform(-1_500.0, 1_500.0, (60, 2))
    for zone in zones:  # corners and middles of edges are points like any other
        if isinstance(zone, PolygonZone):
            corners = np.array(zone.vertices_ne_m)[:3]
            points = np.concatenate([points, corners, 0.5 * (corners + np.roll(corners, 1, 0))])
    index, truth = index_of(zones), brute_force_m(zones, points)
    told = index.gaps_m(points[:, 0], points[:, 1], within_m)
    assert told == pytest.approx(np.minimum(truth, within_m), abs=1e-6)
    polygons = brute_force_m(tuple(z for z in zones if isinstance(z, PolygonZone)), points)
    forbidden = index.polygons_forbid(points[:, 0], points[:, 1])
    assert (forbidden == (polygons < 0.0))[np.abs(polygons) > 1e-6].all()
    for (north, east), gap_m in zip(points[:5].tolist(), truth[:5].tolist(), strict=True):
        zone, nearest_m = index.nearest(north, east)
        assert nearest_m == pytest.approx(gap_m)
        assert (zone is None) == (not zones)
        near = index.near((north, east), (north, east), 50.0)
        here = np.array([[north, east]])
        assert all(each in near for each in zones if float(brute_force_m((each,), here)[0]) < 50.0)


def test_pairs_come_in_portions_without_a_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    zones = tuple(polygon(rng, 40, 300.0) for _ in range(9))
    points = rng.uniform(-1_200.0, 1_200.0, (300, 2))
    index = index_of(zones)
    whole = index.gaps_m(points[:, 0], points[:, 1])
    monkeypatch.setattr(zone_index, "_AT_ONCE", 70)
    monkeypatch.setattr(zone_index, "_GROUPS_AT_ONCE", 11)
    assert (index.gaps_m(points[:, 0], points[:, 1]) == whole).all()


@given(seed=st.integers(0, 10**6), gap_m=st.sampled_from([-60.0, 0.0, 20.0, 100.0]))
def test_a_field_is_wrong_by_no_more_than_it_says_and_close_calls_are_exact(
    seed: int, gap_m: float
) -> None:
    rng = np.random.default_rng(seed)
    zones, points = some_zones(rng), rng.uniform(-700.0, 700.0, (300, 2))
    truth = brute_force_m(zones, points)
    index = index_of(zones)
    field = zone_field(index, np.array([-700.0, -700.0]), np.array([700.0, 700.0]), 100.0)
    about = field.gaps_m(points[:, 0], points[:, 1])
    allowed = truth > 0.0
    wrong = np.abs(about - np.minimum(truth, 100.0 + field.error_m))
    assert (wrong[allowed] <= field.error_m + 1e-6).all()
    assert (about[~allowed] <= field.error_m).all()
    sure = np.abs(truth - gap_m) > 1e-6
    kept = field.keeps(points[:, 0], points[:, 1], gap_m)
    assert (kept == (truth >= gap_m))[sure].all()


def test_a_corner_that_is_given_twice_and_an_edge_to_the_north_change_nothing() -> None:
    square = ((0.0, 0.0), (0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0))
    index = index_of((PolygonZone(name="s", vertices_ne_m=square),))
    north, east = np.array([50.0, 50.0, -10.0, 50.0]), np.array([50.0, 0.0, 50.0, -30.0])
    assert index.gaps_m(north, east) == pytest.approx([-50.0, 0.0, 10.0, 30.0])
