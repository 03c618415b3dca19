"""Heights of ground and bounds of boxes, against equation 1, geodesics and scipy."""

import math
from dataclasses import astuple, replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS, Geod, Transformer
from rasterio.warp import transform
from scipy.ndimage import map_coordinates

from companion.geodesy import FloatArray, LocalFrame
from companion.world.terrain import ArrayTerrain, GridTerrain, Peak, PeakTerrain

seeds = st.integers(0, 10**6)
DEGREES = [(0.0, 0.0, 0), (36.5, -84.3, 0), (-47.0, 179.99, 0), (68.0, -180.0, 0)]
PROJECTED = [(47.0, 8.0, 32632), (62.0, -6.0, 3035), (40.7, -74.0, 2263), (72.0, 100.0, 3413),
             (-28.0, 29.5, 2053), (5.0, 179.99, 3832)]  # fmt: skip
"""Latitude, longitude, EPSG: of metres, feet, turned by any angle, or over the date line."""
PLACES = st.sampled_from(DEGREES + PROJECTED)


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
    seed: int, latitude_deg: float, longitude_deg: float, epsg: int, step_deg: float = 1 / 1200
) -> GridTerrain:
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(60, 90, 2).tolist()
    x, y, step, projection = longitude_deg, latitude_deg, step_deg, None
    if epsg:
        crs = CRS(epsg)
        projection = Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True)
        x, y = projection.transform(x, y)
        step *= 111_000.0 / crs.axis_info[0].unit_conversion_factor
    return GridTerrain(
        frame=LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg),
        heights_m=rng.integers(-50, 900, (rows, columns)).astype(np.int16),
        south=y - 0.5 * rows * step,
        west=x - 0.5 * columns * step,
        step_north=step,
        step_east=step,
        projection=projection,
    )


def by_geodesics(
    terrain: GridTerrain, epsg: int, north: FloatArray, east: FloatArray
) -> FloatArray:
    """The same surface by other libraries: geodesics, GDAL, scipy's; beyond its edge as there."""
    lat_0, lon_0 = terrain.frame.latitude_deg, terrain.frame.longitude_deg
    ones, azimuth = np.ones_like(north), np.degrees(np.arctan2(east, north))
    x, y, _ = Geod(ellps="WGS84").fwd(lon_0 * ones, lat_0 * ones, azimuth, np.hypot(north, east))
    x_0, y_0 = lon_0, lat_0
    if epsg:
        (x_0, *x), (y_0, *y) = transform("EPSG:4326", f"EPSG:{epsg}", [lon_0, *x], [lat_0, *y])
        away = np.array(x) - x_0
    else:
        away = (x - x_0 + 180.0) % 360.0 - 180.0
    rows, columns = terrain.heights_m.shape
    row = (np.array(y) - y_0) / terrain.step_north + 0.5 * rows
    column = away / terrain.step_east + 0.5 * columns
    return np.asarray(
        map_coordinates(terrain.heights_m.astype(float), [row, column], order=1, mode="nearest")
    )


@settings(max_examples=30)
@given(seed=seeds, place=PLACES, step=st.sampled_from([1 / 3600, 1 / 1200, 0.1]))
def test_a_height_grid_is_bilinear_in_the_coordinates_of_its_file_for_points_and_lattices(
    seed: int, place: tuple[float, float, int], step: float
) -> None:
    """On 200 km, too: between two nodes, 11 km, there are 950 m at most, so 1 mm makes 1e-4 m."""
    terrain = random_grid(seed, *place, step)
    far = min(60.0 * step * 111_000.0 * math.cos(math.radians(place[0])), 1e5)
    north, east = np.random.default_rng(seed).uniform(-far, far, (2, 60))
    expected = by_geodesics(terrain, place[2], north, east)
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
    seed: int, place: tuple[float, float, int] | None, size_m: float
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


@settings(max_examples=30)
@given(seed=seeds, place=PLACES)
def test_the_bound_of_a_box_knows_that_its_sides_bend_in_the_coordinates_of_the_file(
    seed: int, place: tuple[float, float, int]
) -> None:
    """Of a plane that rises to any side, boxes as big as half a cell: some 4 cm."""
    terrain = random_grid(seed, *place, 0.1)
    row, column = np.indices(terrain.heights_m.shape)
    rng = np.random.default_rng(seed)
    north, east = rng.uniform(-5e4, 5e4, (2, 30))
    inside = np.linspace(0.0, 5e3, 25)
    points = north[:, None, None] + inside[:, None], east[:, None, None] + inside
    for heights in (row, -row, column, -column):
        plane = replace(terrain, heights_m=1e3 * heights)
        brute = plane.height_m(*np.broadcast_arrays(*points)).max(axis=(1, 2))
        assert (plane.highest_in_box_m(north, north + 5e3, east, east + 5e3) >= brute - 1e-3).all()
