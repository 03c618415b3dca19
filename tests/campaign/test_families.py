"""Laws of the families of worlds."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from companion.campaign import drawn_world, families, truth
from companion.campaign.route_cost import Rates, curve_cost
from companion.world.terrain import ArrayTerrain

FloatArray = NDArray[np.float64]


@pytest.mark.parametrize("family", families.FAMILIES)
def test_a_world_follows_from_family_seed_and_index_alone(family: str) -> None:
    families.world.cache_clear()
    last, first = families.world(family, 5, 1), families.world(family, 5, 0)
    families.world.cache_clear()
    assert families.world(family, 5, 0).fingerprint == first.fingerprint
    assert families.world(family, 5, 1).fingerprint == last.fingerprint
    others = {families.world(family, *pair).fingerprint for pair in ((5, 2), (6, 0))}
    assert len(others | {first.fingerprint, last.fingerprint}) == 4


def heights_m(world: drawn_world.DrawnWorld, north: FloatArray, east: FloatArray) -> FloatArray:
    """The companion's own terrain, which the proof of the way does not use."""
    return world.terrain.height_m(north, east)


@pytest.mark.sample(2)
@pytest.mark.parametrize("family", families.FAMILIES)
@pytest.mark.parametrize("index", [0, 1])
def test_every_world_has_a_way_by_an_independent_search(family: str, index: int) -> None:
    world = families.world(family, 5, index)
    task = world.task
    step = task.settings.scan_range_m / 60.0
    axes = [np.arange(low, high, step) for low, high in (task.limits.north_m, task.limits.east_m)]
    north, east = np.meshgrid(*axes, indexing="ij")
    low = heights_m(world, north, east) < world.floor_amsl_m - task.required_clearance_m
    aside = distance_transform_edt(heights_m(world, north, east) < world.floor_amsl_m) * step
    free = low & (aside > task.required_clearance_m)
    for radar in task.radars:
        n, e, z = radar.centre_nea_m
        free &= np.hypot(np.hypot(north - n, east - e), world.floor_amsl_m - z) > radar.range_m
    for zone in task.zones:
        free &= truth.keep_out_distance_m(
            np.stack([north.ravel(), east.ravel(), 0.0 * north.ravel()], axis=-1), zone
        ).reshape(free.shape) > task.required_clearance_m  # fmt: skip
    cell = np.arange(free.size).reshape(free.shape)
    pairs = [(cell[:-1], cell[1:]), (cell[:, :-1], cell[:, 1:])]
    edges = np.concatenate([np.stack([a.ravel(), b.ravel()]) for a, b in pairs], axis=1)
    edges = edges[:, free.ravel()[edges].all(axis=0)]
    graph = csr_array((np.ones(edges.shape[1]), edges), shape=(free.size, free.size))
    _, pools = connected_components(graph, directed=False)
    start, target = (
        cell[tuple(int(np.argmin(np.abs(a - p))) for a, p in zip(axes, end, strict=True))]
        for end in (world.start_nea_m[:2], world.targets_ne_m[0])
    )
    assert pools[start] == pools[target]
    assert not drawn_world.is_straight_line_free(world)


def test_worlds_of_small_vehicles_have_their_clearances_and_cells() -> None:
    for index in range(3):
        task = families.world("copter", 5, index).task
        assert 300.0 <= task.settings.scan_range_m <= 1_500.0
        assert 8.0 <= task.limits.speed_m_s <= 12.0
        assert task.required_clearance_m < 15.0
        assert task.cell_m <= 19.0
        plane = families.world("plane", 5, index).task
        assert 3_000.0 <= plane.settings.scan_range_m <= 5_000.0
        assert 110.0 <= plane.limits.turn_radius_m <= 150.0
        assert not plane.limits.hovers


def test_a_world_at_another_size_costs_the_same() -> None:
    world = families.world("plane", 0, 0)
    larger = drawn_world.scaled(world, 7.0)
    line = np.linspace(world.start_nea_m, (*world.targets_ne_m[0], world.ceiling_amsl_m), 4)
    small, large = (truth.sampled(control, 0.5 * k) for control, k in ((line, 1), (7 * line, 7)))
    assert curve_cost(large, larger) == pytest.approx(curve_cost(small, world), rel=1e-9)
    rates = Rates.of(world), Rates.of(larger)
    assert rates[0].unit == pytest.approx(7.0 * rates[1].unit)
    at = np.array([[1_000.0, 2_000.0]])
    assert truth.height_m(larger.terrain, 7 * at[:, 0], 7 * at[:, 1]) == pytest.approx(
        7.0 * truth.height_m(world.terrain, at[:, 0], at[:, 1])
    )


def test_the_distance_to_an_array_of_heights_is_that_to_its_plane() -> None:
    """A slope of 0.5: the distance is the height over it times cos(atan 0.5)."""
    nodes = 50.0 * np.arange(60.0)
    terrain = ArrayTerrain(heights_m=np.add.outer(0.5 * nodes, 0.0 * nodes), spacing_m=50.0)
    rng = np.random.default_rng(1)
    at = rng.uniform(1_000.0, 2_000.0, (50, 2))
    above = rng.uniform(20.0, 150.0, 50) * np.where(np.arange(50) % 3, 1.0, -1.0)
    points = np.column_stack([at, 0.5 * at[:, 0] + above])
    found = truth.terrain_distance_m(points, terrain, 200.0)
    expected = np.where(above > 0.0, above / math.hypot(1.0, 0.5), above)
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=0.2)
    assert (found >= expected - 1e-6).all()
