"""Heights of ground and bounds of boxes, against equation 1, geodesics and scipy."""

import math
from dataclasses import astuple

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Geod
from scipy.ndimage import map_coordinates

from companion.geodesy import FloatArray, LocalFrame
from companion.world.terrain import ArrayTerrain, GridTerrain, Peak, PeakTerrain

seeds = st.integers(0, 10**6)
PLACES = st.sampled_from([(0.0, 0.0), (36.5, -84.3), (-47.0, 179.99), (68.0, -180.0)])


def drawn_peaks(rng: np.random.Generator, count: int, apart_m: float) -> PeakTerrain:
    """So many, over ground of all heights; their sum every other time."""
    low, high = (-apart_m, -apart_m, 10.0, 200.0, 200.0), (apart_m, apart_m, 3e3, 3e3, 3e3)
    peaks = tuple(Peak(*row) for row in rng.uniform(low, high, (count, 5)).tolist())
    ground_m, adds = float(rng.choice([-350.0, 0.0, 120.0])), bool(rng.random() < 0.5)
    return PeakTerrain(peaks=peaks, ground_amsl_m=ground_m, sum_of_peaks=adds)


@given(seed=seeds, count=st.sampled_from([0, 1, 4, 300]), apart_m=st.sampled_from([2e3, 2e5]))
def test_the_height_is_equation_1_over_the_ground_however_many_peaks_are_far_away(
    seed: int, count: int, apart_m: float
) -> None:
    rng = np.random.default_rng(seed)
    terrain = drawn_peaks(rng, count, apart_m)
    north, east = rng.uniform(-1e4, 1e4, (2, 40))
    rows = np.array([astuple(peak) for peak in terrain.peaks]).reshape(-1, 5)
    x = (north[:, None] - rows[:, 0]) / rows[:, 3]
    y = (east[:, None] - rows[:, 1]) / rows[:, 4]
    each = rows[:, 2] * np.exp(-x * x - y * y)
    each = each.sum(axis=1) if terrain.sum_of_peaks else each.max(axis=1, initial=-np.inf)
    expected = np.maximum(each, terrain.ground_amsl_m) if count else terrain.ground_amsl_m
    np.testing.assert_allclose(terrain.height_m(north, east), expected, rtol=0, atol=2e-9)
    assert (terrain.height_m(north, east) >= expected - 1e-9).all()


@given(seed=seeds, dn=st.floats(1, 2_000), de=st.floats(1, 2_000))
def test_no_point_of_a_box_is_higher_than_the_highest_in_it(
    seed: int, dn: float, de: float
) -> None:
    rng = np.random.default_rng(seed)
    terrain, (n, e) = drawn_peaks(rng, int(rng.integers(1, 5)), 2e3), rng.uniform(-3e3, 3e3, 2)
    north, east = np.meshgrid(np.linspace(n, n + dn, 41), np.linspace(e, e + de, 41))
    bound = terrain.highest_in_box_m(*(np.array(v) for v in (n, n + dn, e, e + de)))
    brute = terrain.height_m(north, east).max()
    assert bound >= brute - 1e-9
    if not terrain.sum_of_peaks or len(terrain.peaks) == 1:
        # between two points of the lattice it rises by its steepest slope, 0.858 of exp(-x^2)
        steps = [(p, dn / p.spread_north_m + de / p.spread_east_m) for p in terrain.peaks]
        assert bound <= brute + max(p.height_amsl_m * 0.858 * apart / 80.0 for p, apart in steps)


# --- height grids and arrays


def random_grid(
    seed: int, latitude_deg: float, longitude_deg: float, step_deg: float = 1 / 1200
) -> GridTerrain:
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(60, 90, 2).tolist()
    return GridTerrain(
        frame=LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg),
        heights_m=rng.integers(-50, 900, (rows, columns)).astype(np.int16),
        south_deg=latitude_deg - 0.5 * rows * step_deg,
        west_deg=longitude_deg - 0.5 * columns * step_deg,
        step_north_deg=step_deg,
        step_east_deg=step_deg,
    )


def by_geodesics(terrain: GridTerrain, north: FloatArray, east: FloatArray) -> FloatArray:
    """The same surface by other libraries: geodesics, and scipy's; beyond its edge as there."""
    lat_0, lon_0 = terrain.frame.latitude_deg, terrain.frame.longitude_deg
    ones, azimuth = np.ones_like(north), np.degrees(np.arctan2(east, north))
    lon, lat, _ = Geod(ellps="WGS84").fwd(
        lon_0 * ones, lat_0 * ones, azimuth, np.hypot(north, east)
    )
    rows, columns = terrain.heights_m.shape
    row = (lat - lat_0) / terrain.step_north_deg + 0.5 * rows
    column = ((lon - lon_0 + 180.0) % 360.0 - 180.0) / terrain.step_north_deg + 0.5 * columns
    return np.asarray(
        map_coordinates(terrain.heights_m.astype(float), [row, column], order=1, mode="nearest")
    )


@settings(max_examples=30)
@given(seed=seeds, place=PLACES, step=st.sampled_from([1 / 3600, 1 / 1200, 0.1]))
def test_a_height_grid_is_bilinear_in_latitude_and_longitude_for_points_and_lattices(
    seed: int, place: tuple[float, float], step: float
) -> None:
    """On 200 km, too: between two nodes, 11 km, there are 950 m at most, so 1 mm makes 1e-4 m."""
    terrain = random_grid(seed, *place, step)
    far = min(60.0 * step * 111_000.0 * math.cos(math.radians(place[0])), 1e5)
    north, east = np.random.default_rng(seed).uniform(-far, far, (2, 60))
    expected = by_geodesics(terrain, north, east)
    np.testing.assert_allclose(terrain.height_m(north, east), expected, rtol=0, atol=1e-3)
    lattice = terrain.height_m(north[:, None], east[None, :]).ravel()
    points = (x.ravel() for x in np.meshgrid(north, east, indexing="ij"))
    np.testing.assert_allclose(lattice, terrain.height_m(*points), rtol=0, atol=1e-4)


def array_terrain(seed: int) -> ArrayTerrain:
    heights = np.random.default_rng(seed).uniform(0.0, 300.0, (12, 15))
    return ArrayTerrain(heights_m=heights, spacing_m=40.0, south_m=-100.0, west_m=70.0)


def test_an_array_of_heights_is_bilinear_between_its_nodes_and_goes_on_beyond_them() -> None:
    terrain = array_terrain(5)
    at = np.random.default_rng(6).uniform((-300.0, -100.0), (540.0, 830.0), (400, 2))
    nodes = ((at - (-100.0, 70.0)) / 40.0).T
    expected = map_coordinates(terrain.heights_m, nodes, order=1, mode="nearest")
    np.testing.assert_allclose(terrain.height_m(*at.T), expected, atol=1e-9)


@settings(max_examples=60)
@given(
    seed=seeds,
    place=st.one_of(st.none(), PLACES),
    size_m=st.sampled_from([0.0, 5.0, 19.0, 39.0, 60.0, 150.0, 400.0, 1_500.0]),
)
def test_no_point_of_heights_is_higher_than_the_bound_of_its_box(
    seed: int, place: tuple[float, float] | None, size_m: float
) -> None:
    far, terrain = 500.0, array_terrain(seed)
    if place is not None:
        terrain = random_grid(seed, *place)
        far = max(20.0 / 1200 * 111_000.0 * math.cos(math.radians(place[0])) - size_m, 0.0)
    north, east = np.random.default_rng(seed).uniform(-far, far, (2, 30))
    bound = terrain.highest_in_box_m(north, north + size_m, east, east + size_m)
    inside = np.linspace(0.0, size_m, 25)
    points = north[:, None, None] + inside[:, None], east[:, None, None] + inside
    brute = terrain.height_m(*(x + np.zeros((30, 25, 25)) for x in points)).max(axis=(1, 2))
    assert (bound >= brute - 1e-6).all()
    assert (bound <= terrain.heights_m.max()).all()
    if size_m < 40.0:  # of that the steps may miss a little; of a grid some boxes are wider
        if place is None:
            assert (bound <= brute + 2.0 * 300.0 / 40.0 * size_m / 48.0 + 1e-9).all()
        else:
            assert np.median(bound - brute) < 40.0
